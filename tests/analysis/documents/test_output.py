"""Writing results: whole files, and never over what is not ours."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from palpate.analysis.documents.output import MANIFEST, check, publish
from palpate.experiment import storage
from palpate.experiment.errors import DatasetError
from tests.analysis.datasets import balanced, write_dataset
from tests.approved import Refuses
from tests.conftest import Palpate


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST}


def test_a_second_run_replaces_the_first_and_removes_what_is_stale(tmp_path: Path) -> None:
    publish(tmp_path / "out", {"report.html": b"one", "figures/a.svg": b"old"}, "a label", "analyse")
    paths = publish(tmp_path / "out", {"report.html": b"two"}, "a label", "analyse")
    assert paths == (tmp_path / "out" / "report.html",)
    assert _files(tmp_path / "out") == {"report.html": b"two"}


def test_what_others_put_there_stays(tmp_path: Path) -> None:
    publish(tmp_path, {"report.html": b"one"}, "a label", "analyse")
    (tmp_path / "notes.txt").write_bytes(b"mine")
    publish(tmp_path, {"report.html": b"two"}, "a label", "analyse")
    assert _files(tmp_path) == {"report.html": b"two", "notes.txt": b"mine"}


def test_a_foreign_file_is_never_overwritten(tmp_path: Path, refuses: Refuses) -> None:
    publish(tmp_path, {"a.csv": b"a"}, "a label", "analyse")
    (tmp_path / "report.html").write_bytes(b"mine")
    with refuses(DatasetError):
        publish(tmp_path, {"a.csv": b"b", "report.html": b"ours"}, "a label", "analyse")
    assert _files(tmp_path) == {"a.csv": b"a", "report.html": b"mine"}


def test_a_folder_of_somebody_else_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "protocol.toml").write_bytes(b"mine")
    with refuses(DatasetError):
        publish(tmp_path, {"a.csv": b"a"}, "a label", "analyse")
    assert _files(tmp_path) == {"protocol.toml": b"mine"}


def test_a_disk_that_fills_up_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    create = storage.create

    def full(path: Path, content: bytes) -> None:
        if "b.csv" in path.name:
            raise OSError(28, "No space left on device", str(path))
        create(path, content)

    for out, before in ((tmp_path / "new", {}), (tmp_path / "again", {"a.csv": b"1"})):
        if before:
            publish(out, before, "a label", "analyse")
        with monkeypatch.context() as patch:
            patch.setattr(storage, "create", full)
            with pytest.raises(DatasetError, match=r"cannot write .*b\.csv.*: No space left"):
                publish(out, {"a.csv": b"2", "deep/down/b.csv": b"2"}, "a label", "analyse")
        assert out.exists() == bool(before)
        assert _files(out) == before


def test_a_file_changed_by_hand_is_never_overwritten(tmp_path: Path) -> None:
    publish(tmp_path, {"report.html": b"ours"}, "a label", "analyse")
    (tmp_path / "report.html").write_bytes(b"with my notes")
    with pytest.raises(DatasetError, match="was changed later"):
        publish(tmp_path, {"report.html": b"again"}, "a label", "analyse")
    assert _files(tmp_path) == {"report.html": b"with my notes"}


def test_a_stale_file_changed_by_hand_stays(tmp_path: Path) -> None:
    publish(tmp_path, {"a.csv": b"a", "b.csv": b"b"}, "a label", "analyse")
    (tmp_path / "b.csv").write_bytes(b"with my notes")
    publish(tmp_path, {"a.csv": b"a"}, "a label", "analyse")
    assert _files(tmp_path) == {"a.csv": b"a", "b.csv": b"with my notes"}


def test_an_interrupted_run_can_be_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses) -> None:
    publish(tmp_path, {"a.csv": b"1", "b.csv": b"1"}, "a label", "analyse")
    replace = Path.replace

    def fail(self: Path, target: Path) -> Path:
        if Path(target).name == "b.csv":
            raise OSError(28, "No space left on device", str(target))
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fail)
        with refuses(DatasetError):
            publish(tmp_path, {"a.csv": b"2", "b.csv": b"2"}, "a label", "analyse")
    assert _files(tmp_path) == {"a.csv": b"2", "b.csv": b"1"}
    publish(tmp_path, {"a.csv": b"3", "b.csv": b"3"}, "a label", "analyse")
    assert _files(tmp_path) == {"a.csv": b"3", "b.csv": b"3"}


def test_what_a_kill_left_on_its_way_is_no_file_of_somebody_else_and_is_swept(tmp_path: Path) -> None:
    """Killed before the manifest, and again while files took their places: the same command goes on."""
    left = tmp_path / "out" / ".palpate-0123456789abcdef"
    for _ in range(2):
        (left / "figures").mkdir(parents=True)
        (left / "figures" / "a.svg").write_bytes(b"torn")
        publish(tmp_path / "out", {"figures/a.svg": b"whole"}, "a label", "analyse")
        assert _files(tmp_path / "out") == {"figures/a.svg": b"whole"}


@pytest.mark.parametrize("name", ["../precious.csv", "deep/../../precious.csv", "{}/precious.csv", "link/precious.csv"])
def test_no_manifest_and_no_link_takes_a_file_outside(tmp_path: Path, name: str, refuses: Refuses) -> None:
    """A forged manifest names a file elsewhere with its right hash, as one that only an earlier run wrote."""
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "elsewhere" / "out"
    publish(out, {"precious.csv": b"mine"}, "a label", "analyse")
    (out / "precious.csv").rename(elsewhere / "precious.csv")
    (out / "link").symlink_to(elsewhere)
    name = name.format(elsewhere)
    manifest = out / MANIFEST
    manifest.write_text(manifest.read_text().replace('"precious.csv"', json.dumps(name)))
    with refuses(DatasetError):
        publish(out, {"a.csv": b"a"}, "a label", "analyse")
    assert (elsewhere / "precious.csv").read_bytes() == b"mine"
    assert not (out / "a.csv").exists()


def test_nothing_is_written_through_a_link(tmp_path: Path, refuses: Refuses) -> None:
    publish(tmp_path / "out", {"a.csv": b"a"}, "a label", "analyse")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out" / "figures").symlink_to(tmp_path / "elsewhere")
    with refuses(DatasetError):
        publish(tmp_path / "out", {"figures/a.svg": b"a"}, "a label", "analyse")
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "out").write_bytes(b"mine")
    with refuses(DatasetError):
        publish(tmp_path / "out", {"a.csv": b"a"}, "a label", "analyse")


def test_no_command_takes_away_what_another_wrote(tmp_path: Path, refuses: Refuses) -> None:
    publish(tmp_path, {"report.html": b"one"}, "a label", "analyse")
    with refuses(DatasetError):
        publish(tmp_path, {"trials.csv": b"two"}, "a label", "export")
    assert _files(tmp_path) == {"report.html": b"one"}


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"palpate": 3}', '{"command": "analyse", "palpate": 3}', '{"other": {}}']
)
def test_a_foreign_manifest_is_refused(tmp_path: Path, content: str, refuses: Refuses) -> None:
    (tmp_path / MANIFEST).write_text(content)
    with refuses(DatasetError):
        publish(tmp_path, {"a.csv": b"a"}, "a label", "analyse")


@pytest.mark.parametrize("place", [".", "sub-01", "sub-01/beh/x", "sourcedata", "stimuli/x", "derivatives", "new"])
@pytest.mark.parametrize("description", ['{"DatasetType": "raw"}', "{}", "[]", "{ torn"])
def test_nothing_is_written_among_data(tmp_path: Path, place: str, description: str) -> None:
    """BIDS 1.11, dataset_description.json: the type is raw where none is stated."""
    root = tmp_path / "data"
    root.mkdir()
    (root / "dataset_description.json").write_text(description)
    with pytest.raises(DatasetError) as error:
        publish(root / place, {"a.csv": b"a"}, "a label", "analyse")
    assert error.value.finding.where == f"--out {root / place}"
    assert error.value.finding.allowed.endswith(str(root / "derivatives"))
    assert _files(root) == {"dataset_description.json": description.encode()}


def test_a_link_into_a_dataset_is_followed(tmp_path: Path, refuses: Refuses) -> None:
    root = write_dataset(tmp_path / "data", {"01": {"real": balanced(1)}})
    (tmp_path / "link").symlink_to(root / "sub-01")
    with refuses(DatasetError):
        check(tmp_path / "link" / "out", (), "analyse")


@pytest.mark.parametrize("place", ["beside", "data/derivatives/palpate", "data/derivatives/palpate/deeper"])
def test_results_stand_beside_data_or_below_its_derivatives(tmp_path: Path, place: str) -> None:
    write_dataset(tmp_path / "data", {"01": {"real": balanced(1)}})
    description = {"dataset_description.json": b'{"DatasetType": "derivative"}'}
    for _ in range(2):
        publish(tmp_path / place, description, "a label", "analyse")
    assert _files(tmp_path / place) == {"dataset_description.json": b'{"DatasetType": "derivative"}'}


@pytest.mark.parametrize("command", ["analyse", "export", "power", "numerics"])
def test_every_command_keeps_out_of_every_dataset(
    tmp_path: Path, palpate: Palpate, repository_root: Path, command: str
) -> None:
    """Of those that are not analysed too, and before anything is computed."""
    asked = write_dataset(tmp_path / "asked", {"01": {"real": balanced(1)}})
    other = write_dataset(tmp_path / "other", {"01": {"real": balanced(1)}})
    subject: dict[str, tuple[object, ...]] = {
        "power": (repository_root / "protocols" / "okamoto2012.toml", "--studies", 10**6),
        "numerics": (),
    }
    before = sorted(other.rglob("*"))
    code, _, error = palpate(command, *subject.get(command, (asked,)), "--out", other / "sub-01" / "x")
    told = [line for line in error.splitlines() if "these tables have no journals" not in line]
    assert (code, len(told)) == (2, 1)
    assert f"dataset {other}" in told[0]
    assert sorted(other.rglob("*")) == before
