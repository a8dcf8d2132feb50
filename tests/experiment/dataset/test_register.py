"""Anchors of a dataset, and the registers that keep them."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, register
from palpate.experiment.dataset.register import LOG, Anchor
from palpate.experiment.errors import DatasetError
from palpate.experiment.study.roster import Roster
from tests.conftest import Palpate
from tests.experiment.dataset.studies import make_study


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_study(tmp_path_factory.mktemp("study") / "made").root


@pytest.fixture
def dataset(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "dataset"))


def test_an_anchor_has_the_length_and_the_last_hash_of_every_journal(dataset: Path) -> None:
    anchor = checks.anchor(dataset)
    assert [prefix.file for prefix in anchor.prefixes] == [
        path.relative_to(dataset).as_posix() for path in (storage.roster_path(dataset), *storage.journals(dataset))
    ]
    for prefix in anchor.prefixes:
        lines = (dataset / prefix.file).read_bytes().removesuffix(b"\n").split(b"\n")
        assert (prefix.lines, prefix.sha256) == (len(lines), hashlib.sha256(lines[-1]).hexdigest())
    assert (anchor.study, anchor.purpose, len(anchor.prefixes)) == ("okamoto2012", "STUDY", 3)


def test_its_number_is_the_hash_of_its_canonical_json(dataset: Path) -> None:
    anchor, _ = checks.keep_anchor(dataset)
    stated = json.loads((dataset / LOG).read_bytes())["anchor"]
    # Plain ASCII and whole numbers: sorted keys without blanks are RFC 8785.
    canonical = json.dumps(stated, sort_keys=True, separators=(",", ":")).encode()
    assert anchor.number == hashlib.sha256(canonical).hexdigest()[:16]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d okamoto2012 STUDY( [0-9a-f]{4}(-[0-9a-f]{4}){3})", anchor.line)
    assert anchor.line.split()[-1].replace("-", "") == anchor.number


def test_a_torn_line_is_not_anchored_and_a_session_that_never_began_is_left_out(dataset: Path) -> None:
    before = checks.anchor(dataset).prefixes
    begun = storage.journals(dataset)[0]
    begun.with_name(f"sub-01_task-{'real' if 'virtual' in begun.name else 'virtual'}_journal.jsonl").touch()
    with begun.open("ab") as file:
        file.write(b'{"n": 17, "t_')
    assert checks.anchor(dataset).prefixes == before


def test_what_is_broken_is_not_anchored(dataset: Path) -> None:
    path = storage.journals(dataset)[0]
    path.write_bytes(path.read_bytes().replace(b"familiarising", b"familiarisinG"))
    with pytest.raises(DatasetError, match="does not follow"):
        checks.keep_anchor(dataset)
    assert not (dataset / LOG).exists()


def test_a_roster_is_anchored_before_the_first_session(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", sessions=0)
    anchor = checks.anchor(study.root)
    assert [prefix.file for prefix in anchor.prefixes] == ["sourcedata/roster.jsonl"]
    assert (anchor.study, anchor.purpose) == ("okamoto2012", "STUDY")


def test_a_register_is_no_other_file(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("mine", "utf-8")
    with pytest.raises(DatasetError, match="is not a register: it has no anchors"):
        register.enter(checks.anchor(dataset), dataset, tmp_path / "notes", None)
    assert (tmp_path / "notes").read_text("utf-8") == "mine"


def test_a_register_keeps_every_anchor_and_tells_when_it_is_new(dataset: Path, tmp_path: Path) -> None:
    to = tmp_path / "register"
    first, _ = checks.keep_anchor(dataset)
    assert register.enter(first, dataset, to, None) == f"Anchored in {to}. This register is a new file."
    Roster.load(storage.roster_path(dataset)).withdraw("02", "asked to stop")
    second, _ = checks.keep_anchor(dataset)
    assert register.enter(second, dataset, to, None) == f"Anchored in {to}."
    for path in (to, dataset / LOG):
        kept, broken = register.read(path)
        assert ([one.anchor for one in kept], broken) == ([first, second], ())


def test_a_line_that_was_never_finished_hides_no_other(dataset: Path, tmp_path: Path) -> None:
    to = tmp_path / "register"
    anchor = checks.anchor(dataset)
    register.enter(anchor, dataset, to, None)
    whole = to.read_bytes()
    for length in range(1, len(whole) - 1, 97):
        to.write_bytes(whole + whole[:length])
        register.enter(anchor, dataset, to, None)
        kept, broken = register.read(to)
        assert ([one.anchor for one in kept], broken) == ([anchor, anchor], (2,))


def test_a_register_is_outside_of_the_dataset_and_in_a_folder_that_is_there(dataset: Path, tmp_path: Path) -> None:
    anchor = checks.anchor(dataset)
    (tmp_path / "link").symlink_to(dataset)
    for inside in (dataset / "register", tmp_path / "link" / "register"):
        with pytest.raises(DatasetError, match="inside the dataset"):
            register.enter(anchor, dataset, inside, None)
    # A share that is not mounted is no reason to begin a register in its mount point's place.
    with pytest.raises(DatasetError, match="cannot be written"):
        register.enter(anchor, dataset, tmp_path / "absent" / "register", None)
    assert not (tmp_path / "absent").exists()


@pytest.mark.parametrize(
    "file", ["../../secret", "/etc/passwd", "sourcedata/../x.jsonl", "sourcedata/sub-01/a/b.jsonl"]
)
def test_an_anchor_names_only_files_of_a_dataset(dataset: Path, tmp_path: Path, file: str) -> None:
    document = checks.anchor(dataset).model_dump(mode="json")
    document["prefixes"][0]["file"] = file
    (tmp_path / "register").write_text(json.dumps({"anchor": document}) + "\n")
    assert register.read(tmp_path / "register") == ((), (1,))


def test_the_command_prints_the_line_for_the_lab_book(dataset: Path, tmp_path: Path, palpate: Palpate) -> None:
    code, out, _ = palpate("anchor", dataset)
    kept, _ = register.read(dataset / LOG)
    assert (code, out) == (0, f"For the lab book: {kept[0].anchor.line}\n")
    to = tmp_path / "register"
    code, out, _ = palpate("anchor", dataset, "--to", to)
    assert (code, out.splitlines()[1]) == (0, f"Anchored in {to}. This register is a new file.")
    code, _, err = palpate("anchor", dataset, "--sign", "key")
    assert (code, err.count("\n"), "--to" in err) == (2, 1, True)
    assert len(register.read(to)[0]) == 1


def test_no_older_state_is_anchored_beside_a_newer_one(tmp_path: Path) -> None:
    study, to = make_study(tmp_path / "study"), tmp_path / "register"
    register.enter(checks.anchor(study.root), study.root, to, None)
    backup = Path(shutil.copytree(study.root, tmp_path / "backup"))
    one = study.tasks[0]
    study.run(study.header(one.participant, one.tasks[1]))
    build.build(study.root)
    register.enter(checks.anchor(study.root), study.root, to, None)
    known = to.read_bytes()
    with pytest.raises(
        DatasetError,
        match=r"a different state of this dataset: the first \d+ lines of .*_journal.jsonl differ",
    ):
        register.enter(checks.anchor(backup), backup, to, None)
    assert to.read_bytes() == known
    register.enter(checks.anchor(backup), backup, tmp_path / "new", None)
    register.check_state(study.root, to, ("okamoto2012", "STUDY"))
    register.check_state(backup, to, ("okamoto2012", "PILOT"))


def test_anchors_survive_json(dataset: Path) -> None:
    anchor = checks.anchor(dataset)
    assert Anchor.model_validate_json(anchor.model_dump_json()) == anchor


def test_a_pipe_is_no_key_and_nothing_waits_for_it(dataset: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "key")
    with pytest.raises(DatasetError, match="key: is not a file; allowed: a private SSH key"):
        register.enter(checks.anchor(dataset), dataset, tmp_path / "register", tmp_path / "key")
    assert not (tmp_path / "register").exists()
