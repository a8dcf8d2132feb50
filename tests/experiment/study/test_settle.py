"""What stands in a study's folder before it begins: what locks nobody out, and what belongs to something else."""

from __future__ import annotations

from contextlib import nullcontext
from datetime import date
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.protocol import files
from palpate.experiment.records import chain
from palpate.experiment.study import enrolment, roster, withdrawal
from palpate.experiment.study.people import enrolling
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL

DAY = date(2020, 6, 1)


@pytest.fixture
def protocol_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL, "utf-8")
    return path


def test_consent_before_enrolment_is_refused_and_locks_nobody_out(
    tmp_path: Path, protocol_file: Path, refuses: Refuses
) -> None:
    with refuses(RosterError):
        enrolment.consent(protocol_file, "01", DAY, root=tmp_path / "study")
    assert not (tmp_path / "study").exists()
    path = enrolling.enrol(protocol_file, "01", DAY, root=tmp_path / "study", seed=1)
    said = "participant '02' is not enrolled; allowed: 01; the next label is 02"
    with pytest.raises(RosterError, match=said):
        enrolment.consent(protocol_file, "02", DAY, root=tmp_path / "study")
    assert roster.Roster.load(path).consent_on == {"01": DAY}


@pytest.mark.parametrize("command", ["consent", "withdraw", "withdraw --erase"])
def test_from_another_folder_the_place_is_named_where_no_dataset_stands(
    tmp_path: Path,
    protocol_file: Path,
    palpate: Palpate,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    more = ("--consent-on", DAY) if command == "consent" else ("--reason", "asked to stop")
    code, out, err = palpate(*command.split(), protocol_file, "-p", "01", *more)
    place = enrolment.default_root(files.load(protocol_file))
    assert (code, out) == (2, "")
    assert (err.count("\n"), f" {place} " in err) == (1, True)
    assert [*tmp_path.iterdir()] == [protocol_file]


@pytest.mark.parametrize("command", ["enrol", "consent", "withdraw"])
def test_the_same_command_brings_up_the_head_that_a_kill_left_behind(
    tmp_path: Path, protocol_file: Path, command: str
) -> None:
    root = tmp_path / "study"
    head = chain.head_path(enrolling.enrol(protocol_file, "01", None, root=root, seed=1))
    before = b""

    def act() -> None:
        nonlocal before
        before = head.read_bytes()
        if command == "enrol":
            enrolling.enrol(protocol_file, "02", None, root=root, seed=None)
        elif command == "consent":
            enrolment.consent(protocol_file, "01", DAY, root=root)
        else:
            withdrawal.withdraw(protocol_file, "01", "asked to stop", root=root, rebuild=Path.unlink)

    act()
    after = head.read_bytes()
    assert after != before
    head.write_bytes(before)
    with nullcontext() if command == "withdraw" else pytest.raises(RosterError, match="already"):
        act()
    assert head.read_bytes() == after


@pytest.mark.parametrize("left", ["sourcedata/.palpate-0123456789abcdef", ".palpate-0123456789abcdef"])
def test_what_a_kill_left_on_its_way_locks_nobody_out(tmp_path: Path, protocol_file: Path, left: str) -> None:
    (tmp_path / "study" / "sourcedata").mkdir(parents=True)
    (tmp_path / "study" / left).write_bytes(b"torn")
    enrolling.enrol(protocol_file, "01", DAY, root=tmp_path / "study", seed=1)
    assert enrolment.seed_of(tmp_path / "study") == 1


@pytest.mark.parametrize("there", ["notes.txt", "sourcedata/notes.txt", ".hidden", "deep/.palpate-0123456789abcdef"])
def test_a_folder_of_something_else_is_refused_and_stays_as_it_is(
    tmp_path: Path, protocol_file: Path, there: str, refuses: Refuses
) -> None:
    path = tmp_path / "study" / there
    path.parent.mkdir(parents=True)
    path.write_bytes(b"mine")
    with refuses(DatasetError):
        enrolling.enrol(protocol_file, "01", DAY, root=tmp_path / "study", seed=1)
    assert path.read_bytes() == b"mine"
    assert not storage.roster_path(tmp_path / "study").exists()


def test_nobody_enrols_consents_or_withdraws_in_a_rehearsal(tmp_path: Path, protocol_file: Path) -> None:
    root = tmp_path / "rehearsal"
    storage.write_json(storage.plan_path(root), {"label": "REHEARSAL"})
    (root / "sourcedata" / "sub-01").mkdir()
    said = "practice or rehearsal dataset with simulated participants: nobody enrolls"
    with pytest.raises(DatasetError, match=said):
        enrolling.enrol(protocol_file, "01", DAY, root=root, seed=1)
    with pytest.raises(DatasetError, match=said):
        enrolment.consent(protocol_file, "01", DAY, root=root)
    with pytest.raises(DatasetError, match=said):
        withdrawal.withdraw(protocol_file, "01", "asked to stop", root=root, rebuild=Path.unlink)
