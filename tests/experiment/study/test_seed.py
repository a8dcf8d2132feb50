"""The seed is the one that was drawn before anybody enrolled, or it is refused. All data are SIMULATED."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import checks
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.records import chain
from palpate.experiment.study import enrolment
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.faults.wrong import copied

ANOTHER = "seed.json: is not the seed that was drawn before the first participant enrolled: the roster has"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 and 02 are enrolled, and 01 did a task."""
    return make_study(tmp_path_factory.mktemp("made") / "study", sessions=1)


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


@pytest.fixture
def begun(tmp_path: Path) -> MadeStudy:
    """01 is enrolled, and nobody did a task."""
    return make_study(tmp_path / "begun", enrolled=1, sessions=0)


def kept(study: MadeStudy) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(storage.seed_path(study.root).read_text("utf-8"))
    return found


def change(study: MadeStudy, **facts: object) -> None:
    held = {key: value for key, value in (kept(study) | facts).items() if value is not None}
    storage.seed_path(study.root).write_text(json.dumps(held), "utf-8")


def entries(study: MadeStudy) -> list[dict[str, Any]]:
    return [link.entry for link in chain.read(storage.roster_path(study.root), RosterError).links]


def test_the_first_participants_line_has_the_hash_of_seed_and_salt(study: MadeStudy) -> None:
    held = kept(study)
    assert re.fullmatch("[0-9a-f]{32}", held["salt"])
    wanted = hashlib.sha256(f"{held['salt']}:{held['seed']}".encode()).hexdigest()
    assert [(one["kind"], one.get("seed_sha256")) for one in entries(study)] == [("first", wanted), ("enrolled", None)]
    assert Roster.load(storage.roster_path(study.root)).seed_sha256 == wanted
    assert enrolment.seed_is_proven(study.root)


def test_the_same_seed_has_another_hash_in_another_study_so_that_nobody_can_look_it_up(tmp_path: Path) -> None:
    hashes = {
        entries(make_study(tmp_path / name, enrolled=1, sessions=0, seed=1))[0]["seed_sha256"] for name in ("a", "b")
    }
    assert len(hashes) == 2
    assert hashlib.sha256(b"1").hexdigest() not in hashes


@pytest.mark.parametrize("facts", [{"seed": 2}, {"salt": "0" * 32}, {"seed": 2, "salt": "0" * 32}])
def test_another_seed_or_salt_is_refused_wherever_it_is_read(
    study: MadeStudy, palpate: Palpate, facts: dict[str, object]
) -> None:
    change(study, **facts)
    calls: tuple[Callable[[], object], ...] = (
        lambda: enrolment.seed_of(study.root),
        lambda: enrolling.enrol(study.file, "03", None, root=study.root, seed=None),
        lambda: checks.load_sound(study.root),
    )
    for call in calls:
        with pytest.raises(DatasetError, match=ANOTHER):
            call()
    assert palpate("schedule", study.file, "-p", "02", "--dataset", study.root)[0] == 2
    assert [
        one.clause() for one in verify(study.root).findings if one.verdict == "refuses" and "seed" in one.place()
    ] != []
    assert len(entries(study)) == 2


def test_a_seed_that_is_gone_is_written_anew_from_the_journal_that_is_named(begun: MadeStudy, study: MadeStudy) -> None:
    for one, journals in ((begun, []), (study, storage.journals(study.root)[:1])):
        storage.seed_path(one.root).unlink()
        with pytest.raises(DatasetError) as error:
            enrolment.seed_of(one.root)
        assert re.findall(r"line 1 of (\S+)", str(error.value.finding.remedy)) == [str(path) for path in journals]
    header = json.loads(journals[0].read_text("utf-8").splitlines()[0])["entry"]
    facts = {"format": storage.DATASET_FORMAT, "seed": header["seed"], "purpose": header["purpose"]}
    storage.seed_path(study.root).write_text(json.dumps(facts), "utf-8")
    assert enrolment.seed_of(study.root) == 1
    assert checks.load_sound(study.root).sessions


def test_a_seed_without_its_salt_is_refused_until_a_journal_says_which_it_was(
    begun: MadeStudy, study: MadeStudy
) -> None:
    change(begun, salt=None)
    with pytest.raises(DatasetError, match=ANOTHER):
        enrolment.seed_of(begun.root)
    assert "seed" in [one.place() for one in verify(study.root).findings if one.verdict == "passes"]
    change(study, salt=None)
    assert enrolment.seed_of(study.root) == 1
    assert checks.load_sound(study.root).sessions
    assert not enrolment.seed_is_proven(study.root)
    assert "seed" not in [one.place() for one in verify(study.root).findings]
    change(study, seed=2, salt=None)
    with pytest.raises(DatasetError, match="seed 1; allowed: 2"):
        checks.load_sound(study.root)


def test_a_roster_written_anew_without_the_hash_is_refused(begun: MadeStudy, refuses: Refuses) -> None:
    path = storage.roster_path(begun.root)
    path.unlink()
    chain.head_path(path).unlink()
    Roster(path).enrol("01", None)
    with refuses(DatasetError):
        enrolment.seed_of(begun.root)


def test_a_study_that_began_before_there_was_a_hash_goes_on(begun: MadeStudy) -> None:
    path = storage.roster_path(begun.root)
    path.unlink()
    chain.head_path(path).unlink()
    Roster(path).enrol("01", None)
    change(begun, salt=None)
    enrolling.enrol(begun.file, "02", None, root=begun.root, seed=None)
    assert [one["kind"] for one in entries(begun)] == ["enrolled", "enrolled"]
    assert enrolment.seed_of(begun.root) == 1
    assert not enrolment.seed_is_proven(begun.root)


def test_what_a_kill_left_between_seed_and_roster_is_gone_on_with(begun: MadeStudy) -> None:
    path = storage.roster_path(begun.root)
    path.unlink()
    chain.head_path(path).unlink()
    enrolling.enrol(begun.file, "01", None, root=begun.root, seed=None)
    assert enrolment.seed_is_proven(begun.root)


def test_only_the_first_participant_has_such_a_line(tmp_path: Path) -> None:
    known = Roster(tmp_path / "roster.jsonl")
    known.enrol("01", None, seed_sha256="a" * 64)
    known.enrol("02", None, seed_sha256="b" * 64)
    assert (known.seed_sha256, Roster.load(known.path).seed_sha256) == ("a" * 64, "a" * 64)
