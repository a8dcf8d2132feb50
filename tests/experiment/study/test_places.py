"""The place of a participant who withdrew is offered again, in the same order of tasks. All data are SIMULATED."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks
from palpate.experiment.dataset.status import status
from palpate.experiment.errors import RosterError
from palpate.experiment.study import withdrawal
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import find_allocation
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.faults.wrong import copied


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """All 15 are enrolled; 01 is done, and 02 and 03 did their first task."""
    study = make_study(tmp_path_factory.mktemp("made") / "study", enrolled=15, sessions=3, min_s=0)
    study.run(study.header("01", study.tasks[0].tasks[1]))
    build.build(study.root)
    return study


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def withdraw(study: MadeStudy, participant: str, *, erase: bool = False) -> None:
    withdrawal.withdraw(study.file, participant, "asked to stop", root=study.root, rebuild=build.build, erase=erase)


def enrol(study: MadeStudy, participant: str) -> tuple[str, ...]:
    """Enrol a participant and return their tasks."""
    enrolling.enrol(study.file, participant, DAY, root=study.root, seed=None)
    return find_allocation(study.tasks, participant).tasks


def test_places_are_taken_in_order_and_the_orders_stay_balanced(study: MadeStudy, refuses: Refuses) -> None:
    planned = [one.tasks for one in study.tasks]
    withdraw(study, "05")
    withdraw(study, "03", erase=True)
    assert status(study.root, DAY).to_enrol == "16"
    assert enrol(study, "16") == planned[2]
    assert enrol(study, "17") == planned[4]
    with refuses(RosterError):
        enrol(study, "18")
    known = Roster.load(storage.roster_path(study.root))
    assert known.takes == {"16": "03", "17": "05"}
    left = Counter(one.tasks for one in study.tasks if one.participant not in known.withdrawn)
    assert left == Counter(planned)


def test_whoever_takes_a_place_is_run_believed_and_replaced_in_turn(study: MadeStudy, palpate: Palpate) -> None:
    withdraw(study, "02")
    order = enrol(study, "16")
    study.run(study.header("16", order[0]))
    build.build(study.root)
    assert checks.load_sound(study.root).tasks["16"] == order
    assert palpate("verify", study.root)[0] == 0
    assert order[0] in palpate("schedule", study.file, "-p", "16", "--dataset", study.root)[1]
    found = status(study.root, DAY)
    assert (found.planned, len(found.people), found.to_enrol) == (15, 16, None)
    withdraw(study, "16")
    assert enrol(study, "17") == order
    checks.load_sound(study.root)


def test_nobody_takes_the_place_of_one_who_completed_or_is_still_there(study: MadeStudy) -> None:
    for _ in range(2):
        with pytest.raises(RosterError, match="no participant '16'"):
            enrol(study, "16")
        if "01" not in Roster.load(storage.roster_path(study.root)).withdrawn:
            withdraw(study, "01")


def test_while_planned_places_are_left_they_come_first(tmp_path: Path, refuses: Refuses) -> None:
    study = make_study(tmp_path / "study", enrolled=2, sessions=0)
    withdraw(study, "01")
    with refuses(RosterError):
        enrol(study, "16")
    enrol(study, "03")
    assert Roster.load(storage.roster_path(study.root)).takes == {}


@pytest.mark.parametrize("takes", ["04", "02", "99"])
def test_a_roster_that_gives_away_a_place_that_is_not_free_is_refused(
    study: MadeStudy, takes: str, refuses: Refuses
) -> None:
    withdraw(study, "02")
    known = Roster.load(storage.roster_path(study.root))
    known.enrol("16", DAY, "02")
    with refuses(RosterError):
        known.enrol("17", DAY, takes)
    assert Roster.load(storage.roster_path(study.root)).takes == {"16": "02"}


def test_a_planned_label_keeps_its_own_place_whatever_the_roster_says(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", enrolled=1, sessions=0)
    withdraw(study, "01")
    own = study.tasks
    Roster.load(storage.roster_path(study.root)).enrol("02", DAY, "01")
    assert study.tasks == own
