"""`verify` reports accidents of other systems as what they are, and none as tampering. All data are SIMULATED."""

from __future__ import annotations

import hashlib
import os
import shutil
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

import palpate
from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, verify
from palpate.experiment.dataset.outside import accidents
from palpate.experiment.errors import Remedy
from palpate.experiment.study import privacy
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.faults.wrong import copied

JOURNAL, RIG = "sourcedata/sub-01/sub-01_task-virtual_journal", "sourcedata/sub-01/sub-01_task-virtual_rig.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 and 02 did their first tasks."""
    return make_study(tmp_path_factory.mktemp("made") / "study")


@pytest.fixture
def root(made: MadeStudy, tmp_path: Path) -> Path:
    return copied(made, tmp_path / "study").root


def line_ends(path: Path) -> Path:
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    return path


def not_fetched(path: Path) -> Path:
    path.unlink()
    path.symlink_to("../../.git/annex/objects/a1/b2/SHA256E-s10--0/SHA256E-s10--0")
    return path


def pointer(path: Path) -> Path:
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 10\n", "utf-8")
    return path


def beside(name: str) -> Callable[[Path], Path]:
    return lambda path: Path(shutil.copy(path, path.with_name(name)))


def apple(path: Path) -> Path:
    left = path.with_name(f"._{path.name}")
    left.write_bytes(b"\x00\x05\x16\x07")
    return left


def other_form(path: Path) -> Path:
    left = path.with_name(unicodedata.normalize("NFD", "Papier à lettres.toml"))
    left.write_bytes(path.read_bytes())
    return left


def twice(path: Path) -> Path:
    return Path(shutil.copytree(path, path.with_name(f"{path.name} 2")))


CASES: dict[str, tuple[str, Callable[[Path], Path], str]] = {
    "line ends of a journal": (f"{JOURNAL}.jsonl", line_ends, "refuses"),
    "line ends of a head": (f"{JOURNAL}.head", line_ends, "refuses"),
    "line ends of the roster": ("sourcedata/roster.jsonl", line_ends, "refuses"),
    "line ends of a table": ("sub-01/beh/sub-01_task-virtual_events.tsv", line_ends, "refuses"),
    "a file of macOS": (f"{JOURNAL}.jsonl", apple, "unknown"),
    "a git-annex file": (f"{JOURNAL}.jsonl", not_fetched, "refuses"),
    "an annexed table": ("sub-01/beh/sub-01_task-virtual_events.tsv", not_fetched, "refuses"),
    "a pointer to a rig": (RIG, pointer, "refuses"),
    "an LFS pointer": ("sourcedata/sub-01/sub-01_task-virtual_foot.cobs", pointer, "refuses"),
    "Dropbox": (f"{JOURNAL}.jsonl", beside(f"{Path(JOURNAL).name} (A's conflicted copy 2026-01-01).jsonl"), "refuses"),
    "Syncthing": (
        f"{JOURNAL}.jsonl",
        beside(f"{Path(JOURNAL).name}.sync-conflict-20260101-120000-ABC.jsonl"),
        "refuses",
    ),
    "a download": ("participants.tsv", beside("participants (1).tsv"), "unknown"),
    "OneDrive": ("participants.tsv", beside("participants-DESKTOP-A1B2.tsv"), "unknown"),
    "a copy of a folder": ("sourcedata/sub-01", twice, "refuses"),
    "another Unicode form": ("sourcedata/protocol.toml", other_form, "unknown"),
}


@pytest.mark.parametrize("case", CASES)
def test_an_accident_has_its_name_and_no_other_finding_speaks_against_the_dataset(case: str, root: Path) -> None:
    name, harm, verdict = CASES[case]
    harmed = harm(root / name).relative_to(root).as_posix()
    report = verify.verify(root)
    found = [one for one in report.findings if one.check == accidents.CHECK and one.where == harmed]
    assert [(one.verdict, bool(one.remedy)) for one in found] == [(verdict, True)]
    assert [one for one in report.findings if one.verdict == "refuses"] == [
        one for one in found if verdict == "refuses"
    ]


def test_line_ends_that_no_hash_knows_are_no_accident(root: Path) -> None:
    own = [
        "sourcedata/protocol.toml",
        "sourcedata/protocol.seal.toml",
        RIG,
    ]
    for name in own:
        line_ends(root / name)
    (root / "notes.tsv").write_bytes(b"a\r\nb\r\n")
    report = verify.verify(root)
    assert report.refused == 0
    assert not {*own, "notes.tsv"} & {one.where for one in report.findings if one.check == accidents.CHECK}


@pytest.mark.parametrize(("named", "lost"), [(b"1\r\n2\r\n", False), (b"1\n2\n", True)])
def test_line_ends_of_a_labs_own_table_are_those_that_its_rig_file_names(named: bytes, lost: bool, root: Path) -> None:
    table = root / "sourcedata/sub-01/response.csv"
    table.write_bytes(b"1\r\n2\r\n")
    table.with_name("own_rig.toml").write_text(f'response_sha256 = "{hashlib.sha256(named).hexdigest()}"\n', "utf-8")
    found = [one.where for one in accidents.accidents(root)]
    assert (table.relative_to(root).as_posix() in found) is lost


@pytest.mark.parametrize("harm", [pointer, not_fetched])
def test_an_accident_explains_no_edit_of_the_same_session(harm: Callable[[Path], Path], root: Path) -> None:
    harm(root / RIG)
    path = root / f"{JOURNAL}.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"answered"', b'"Answered"', 1))
    report = verify.verify(root)
    refused = {one.where: one.check for one in report.findings if one.refuses}
    assert refused[f"{JOURNAL}.jsonl"] != accidents.CHECK == refused[RIG]


def test_lost_permissions_are_restored_by_a_command_for_that_file(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = root / "participants.tsv"
    monkeypatch.setattr(os, "access", lambda one, _: one != path)
    (found,) = [one for one in accidents.accidents(root) if one.where == "participants.tsv"]
    assert isinstance(found.remedy, Remedy)
    assert (found.verdict, found.remedy.command) == ("refuses", ("chmod", "u+rw", str(path)))


def test_lost_modes_are_said(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(privacy, "readers_warning", lambda _: "Others can read sourcedata.")
    (found,) = [one for one in verify.verify(root).findings if one.check == accidents.CHECK]
    assert (found.where, found.verdict) == ("sourcedata", "unknown")


def test_what_macos_leaves_stops_no_session_and_no_analysis(root: Path) -> None:
    beside = ("sub-01/beh/sub-01_task-virtual_events.tsv", "sourcedata/sub-01/voices/a.wav", "stimuli/recordings/a.wav")
    for name in (f"{JOURNAL}.jsonl", *beside):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        apple(root / name)
    found = {Path(one.where).name for one in accidents.accidents(root)}
    assert found == {f"._{Path(name).name}" for name in (f"{JOURNAL}.jsonl", *beside)}
    assert len(checks.load_sound(root).sessions) == 2
    assert len(palpate.read(root).participants) == 2


def test_a_dataset_tells_git_to_change_no_line_ends_and_keeps_what_a_lab_wrote(root: Path) -> None:
    attributes = root / accidents.ATTRIBUTES
    assert attributes.read_bytes() == accidents.NO_CONVERSION
    attributes.write_bytes(b"* annex.largefiles=anything\n")
    build.build(root)
    assert attributes.read_bytes() == b"* annex.largefiles=anything\n"


def test_accidents_are_told_with_their_remedies(root: Path, approved: SnapshotAssertion) -> None:
    line_ends(root / "sourcedata/roster.jsonl")
    other_form(root / "sourcedata/protocol.toml")
    not_fetched(storage.foot_path(root / f"{JOURNAL}.jsonl"))
    apple(root / "participants.tsv")
    beside("participants (1).tsv")(root / "participants.tsv")
    report = verify.verify(root)
    told = [one.sentence().replace(str(root), "ROOT") for one in report.findings if one.check == accidents.CHECK]
    assert [*told, *report.verdict] == approved
