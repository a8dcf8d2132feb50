"""`verify` reports accidents of other systems as what they are, and none as tampering. All data are SIMULATED."""

from __future__ import annotations

import shutil
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

import palpate
from palpate.experiment import storage
from palpate.experiment.dataset import accidents, build, checks, verify
from palpate.experiment.study import privacy
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.faults.wrong import copied

JOURNAL = "sourcedata/sub-01/sub-01_task-virtual_journal"


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


CASES: dict[str, tuple[str, Callable[[Path], Path], str]] = {
    "line ends of a journal": (f"{JOURNAL}.jsonl", line_ends, "refuses"),
    "line ends of a head": (f"{JOURNAL}.head", line_ends, "refuses"),
    "line ends of the roster": ("sourcedata/roster.jsonl", line_ends, "refuses"),
    "line ends of the seal": ("sourcedata/protocol.seal.toml", line_ends, "refuses"),
    "line ends of a table": ("sub-01/beh/sub-01_task-virtual_events.tsv", line_ends, "refuses"),
    "a file of macOS": (f"{JOURNAL}.jsonl", apple, "unknown"),
    "an annexed file": (f"{JOURNAL}.jsonl", not_fetched, "refuses"),
    "an annexed table": ("sub-01/beh/sub-01_task-virtual_events.tsv", not_fetched, "refuses"),
    "an LFS pointer": ("sourcedata/sub-01/sub-01_task-virtual_foot.cobs", pointer, "refuses"),
    "Dropbox": (f"{JOURNAL}.jsonl", beside(f"{Path(JOURNAL).name} (A's conflicted copy 2026-01-01).jsonl"), "refuses"),
    "Syncthing": (
        f"{JOURNAL}.jsonl",
        beside(f"{Path(JOURNAL).name}.sync-conflict-20260101-120000-ABC.jsonl"),
        "refuses",
    ),
    "a download": ("participants.tsv", beside("participants (1).tsv"), "unknown"),
    "OneDrive": ("participants.tsv", beside("participants-DESKTOP-A1B2.tsv"), "unknown"),
    "another Unicode form": ("sourcedata/protocol.toml", other_form, "refuses"),
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


def test_lost_modes_are_said(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(privacy, "readers_warning", lambda _: "Others can read sourcedata.")
    (found,) = [one for one in verify.verify(root).findings if one.check == accidents.CHECK]
    assert (found.where, found.verdict) == ("sourcedata", "unknown")


def test_what_macos_leaves_stops_no_session_and_no_analysis(root: Path) -> None:
    for path in (root / f"{JOURNAL}.jsonl", root / "sub-01/beh/sub-01_task-virtual_events.tsv"):
        apple(path)
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
    not_fetched(storage.foot_path(root / f"{JOURNAL}.jsonl"))
    apple(root / "participants.tsv")
    beside("participants (1).tsv")(root / "participants.tsv")
    report = verify.verify(root)
    told = [one.sentence() for one in report.findings if one.check == accidents.CHECK]
    assert [*told, *report.verdict] == approved
