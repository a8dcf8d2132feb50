"""Writing results: whole files, and never over what is not ours."""

from __future__ import annotations

from pathlib import Path

import pytest

from analysis.output import MANIFEST, publish
from experiment.errors import DatasetError


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST}


def test_a_second_run_replaces_the_first_and_removes_what_is_stale(tmp_path: Path) -> None:
    publish(tmp_path / "out", {"report.html": b"one", "figures/a.svg": b"old"}, "a label")
    paths = publish(tmp_path / "out", {"report.html": b"two"}, "a label")
    assert paths == (tmp_path / "out" / "report.html",)
    assert _files(tmp_path / "out") == {"report.html": b"two"}


def test_what_others_put_there_stays(tmp_path: Path) -> None:
    publish(tmp_path, {"report.html": b"one"}, "a label")
    (tmp_path / "notes.txt").write_bytes(b"mine")
    publish(tmp_path, {"report.html": b"two"}, "a label")
    assert _files(tmp_path) == {"report.html": b"two", "notes.txt": b"mine"}


def test_a_foreign_file_is_never_overwritten(tmp_path: Path) -> None:
    publish(tmp_path, {"a.csv": b"a"}, "a label")
    (tmp_path / "report.html").write_bytes(b"mine")
    with pytest.raises(DatasetError, match=r"report\.html is no output of palpate.*choose another --out"):
        publish(tmp_path, {"a.csv": b"b", "report.html": b"ours"}, "a label")
    assert _files(tmp_path) == {"a.csv": b"a", "report.html": b"mine"}


def test_a_folder_of_somebody_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "protocol.toml").write_bytes(b"mine")
    with pytest.raises(DatasetError, match="holds files that are not palpate's; choose a new or empty folder"):
        publish(tmp_path, {"a.csv": b"a"}, "a label")
    assert _files(tmp_path) == {"protocol.toml": b"mine"}


def test_a_disk_that_fills_up_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Path, mode: int) -> None:
        if "b.csv" in self.name:
            raise OSError(28, "No space left on device", str(self))

    for out, before in ((tmp_path / "new", {}), (tmp_path / "again", {"a.csv": b"1"})):
        if before:
            publish(out, before, "a label")
        with monkeypatch.context() as patch:
            patch.setattr(Path, "chmod", full)
            with pytest.raises(DatasetError, match=r"cannot write .*b\.csv.*: No space left"):
                publish(out, {"a.csv": b"2", "deep/down/b.csv": b"2"}, "a label")
        assert out.exists() == bool(before)
        assert _files(out) == before


def test_a_file_changed_by_hand_is_never_overwritten(tmp_path: Path) -> None:
    publish(tmp_path, {"report.html": b"ours"}, "a label")
    (tmp_path / "report.html").write_bytes(b"with my notes")
    with pytest.raises(DatasetError, match="was changed since"):
        publish(tmp_path, {"report.html": b"again"}, "a label")
    assert _files(tmp_path) == {"report.html": b"with my notes"}


def test_a_stale_file_changed_by_hand_stays(tmp_path: Path) -> None:
    publish(tmp_path, {"a.csv": b"a", "b.csv": b"b"}, "a label")
    (tmp_path / "b.csv").write_bytes(b"with my notes")
    publish(tmp_path, {"a.csv": b"a"}, "a label")
    assert _files(tmp_path) == {"a.csv": b"a", "b.csv": b"with my notes"}


def test_an_interrupted_run_can_be_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    publish(tmp_path, {"a.csv": b"1", "b.csv": b"1"}, "a label")
    replace = Path.replace

    def fail(self: Path, target: Path) -> Path:
        if Path(target).name == "b.csv":
            raise OSError(28, "No space left on device", str(target))
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fail)
        with pytest.raises(DatasetError, match=r"cannot write .*b\.csv: No space left"):
            publish(tmp_path, {"a.csv": b"2", "b.csv": b"2"}, "a label")
    assert _files(tmp_path) == {"a.csv": b"2", "b.csv": b"1"}
    publish(tmp_path, {"a.csv": b"3", "b.csv": b"3"}, "a label")
    assert _files(tmp_path) == {"a.csv": b"3", "b.csv": b"3"}


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_bytes(b"mine")
    with pytest.raises(DatasetError, match="is a file; choose a folder"):
        publish(tmp_path / "out", {"a.csv": b"a"}, "a label")


@pytest.mark.parametrize("content", ["{", "[]", '{"palpate": 3}', '{"other": {}}'])
def test_a_foreign_manifest_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / MANIFEST).write_text(content)
    with pytest.raises(DatasetError, match="is no manifest of palpate"):
        publish(tmp_path, {"a.csv": b"a"}, "a label")
