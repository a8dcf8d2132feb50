"""Practice at the keys: what a first session explains, and what its participant does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import cast

import pytest

from palpate.experiment.desk.messages import ENTER, ESCAPE
from palpate.experiment.desk.questions import (
    Arm,
    Attended,
    Confirm,
    Console,
    Debrief,
    Event,
    Level,
    Notice,
    Place,
    Proposed,
    Question,
    Reply,
    TrialAnswer,
)
from palpate.experiment.rehearsal import practice
from palpate.experiment.rehearsal.participant import SimulatedPerson
from palpate.experiment.rehearsal.practice import Guided, Practiced

ANSWERS = {"c": "cork", "f": "felt"}
NAMES = {practice.HESITATES: "hesitates", practice.RESTS: "rests", practice.LEAVES: "leaves"}


class Desk(Console):
    """An experimenter who presses these keys, one a question; it keeps what was told and asked, in order."""

    def __init__(self, *keys: str) -> None:
        self.keys, self.told = deque(keys), list[str]()

    def attend(self, session: Attended | None) -> None:
        pass

    def ask(self, question: Question | Arm) -> Reply:
        self.told.append("arm" if isinstance(question, Arm) else question.kind)
        return Reply() if isinstance(question, Arm) else Reply(self.keys.popleft() if self.keys else ENTER)

    def tell(self, event: Event) -> None:
        if isinstance(event, Notice):
            self.told.append(NAMES.get(event.text, event.text))
        elif isinstance(event, Proposed):
            self.told.append(event.words)

    def ignored(self) -> str:
        return ""


class Person:
    """Says cork of everything, and hears the masker until it is loud."""

    box = None

    def says(self, trial: int) -> tuple[str, str]:
        return "c", "cork"

    def wishes(self, question: Level) -> str:
        return "+" if question.level_db_a < 60 else ENTER

    def ask(self, question: Question | Arm) -> Reply:
        return Reply()


def practiced(*keys: str, first: bool = True) -> tuple[Desk, Practiced]:
    desk = Desk(*keys)
    return desk, Practiced(desk=Guided(desk, first=first), participant=cast("SimulatedPerson", Person()))


@pytest.fixture(autouse=True)
def timers(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """After how long something was to happen: at once, before the question is asked."""
    after_s: list[float] = []

    class AtOnce:
        def __init__(self, seconds: float, does: Callable[[], None]) -> None:
            self._does = does
            after_s.append(seconds)

        def start(self) -> None:
            self._does()

        def cancel(self) -> None:
            pass

    monkeypatch.setattr(practice, "Timer", AtOnce)
    return after_s


def run(one: Practiced, trial: int) -> None:
    """Arm a trial, and have it answered and confirmed."""
    one.ask(Arm(trial, 1, 6))
    while True:
        key = one.ask(TrialAnswer(trial, ANSWERS, "n", {})).key
        if one.ask(Confirm(key, ANSWERS.get(key, ""))).key == ENTER:
            return


def test_a_first_session_explains_each_step_once_and_a_later_one_nothing() -> None:
    for first in (True, False):
        desk, one = practiced(*[ENTER, "c", ENTER] * 2, first=first)
        for trial in (1, 2):
            one.ask(Place(trial, ("cork",)))
            run(one, trial)
        one.ask(Debrief())
        guided = [line for line in desk.told if line.startswith("GUIDE")]
        kinds = ("place", practice.ARMED, "answer", "confirm", "debrief") if first else ()
        assert guided == [f"GUIDE  {practice.LESSONS[kind]}" for kind in kinds]
        # It comes before its step.
        assert not first or desk.told[:2] == [guided[0], "place"]


def test_in_a_first_session_the_participant_does_what_participants_do(timers: list[float]) -> None:
    desk, one = practiced(*["c", ENTER] * 2, "c", ESCAPE, "f", ENTER, *["c", ENTER] * 3)
    for trial in range(1, 7):
        run(one, trial)
    assert [line for line in desk.told if line in NAMES.values()] == ["hesitates", "rests", "leaves"]
    assert timers == [practice.HESITATES_S]
    # The answer that was taken back, and the one given in its place.
    said = [line for line in desk.told if "says" in line]
    assert [line.split()[-1] for line in said].count("felt.") == 2
    assert not any("To correct trial" in line for line in desk.told)


@pytest.mark.parametrize("first", [True, False])
def test_an_answer_that_the_participant_did_not_give_is_told_with_its_correction(first: bool) -> None:
    keys = [*["c", ENTER] * 3] if first else [*["c", ENTER] * 2, "f", ENTER]
    desk, one = practiced(*keys, first=first)
    for trial in range(1, 4):
        run(one, trial)
    facts = {"confirmed": "cork", "said": "felt", "key": "f"}
    facts = facts if first else {"confirmed": "felt", "said": "cork", "key": "c"}
    assert desk.told[-1] == practice.DIFFERS.format(trial=3, **facts)


def test_at_the_masker_the_participant_says_that_it_can_be_heard() -> None:
    desk, one = practiced()
    for level_db_a in (40.0, 70.0):
        one.ask(Level(level_db_a, 80.0, "", probe=False, by="participant"))
    said = [line for line in desk.told if "says" in line]
    assert ["still hear" in line for line in said] == [True, False]
