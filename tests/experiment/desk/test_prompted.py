"""A session's desk toward the participant's screen: what it tells it, and the little that it takes from it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.clock import monotonic_ns
from palpate.experiment.desk import linked
from palpate.experiment.desk.link import Line, Link
from palpate.experiment.desk.link.wire import Asked, Choose, Deed, Hello, Pause, Reply, Shown, Stop, Typed, View, Write
from palpate.experiment.desk.messages import ENTER, Correct, Kind, Prompt, Repeat, TakeNote
from palpate.experiment.desk.questions import (
    STEP,
    YES,
    Agree,
    Answered,
    Arm,
    Confirm,
    Debrief,
    Familiarise,
    GoOn,
    Level,
    Place,
    Play,
    Rest,
    Silent,
    TrialAnswer,
    keyed,
)
from palpate.experiment.errors import PauseAsked
from tests.experiment.desk.attended import Desk, Recorded

SCREEN = Hello(role="screen", by="the participant's screen")
CONSOLE = Hello(role="console", by="console")


@pytest.fixture
def session() -> Recorded:
    return Recorded()


@pytest.fixture
def desk(session: Recorded) -> Desk:
    made = Desk(View(study="study", participant="01"), screen=True)
    made.came(1, 1)
    made.attend(session)
    return made


@pytest.fixture
def aside(desk: Desk) -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool
        # Whatever still waits for a key, after a test that failed, ends.
        desk.take(CONSOLE, Stop())


def level(desk: Desk) -> str:
    return desk.ask(Level(50, 80, "Nothing is heard.", probe=False, by="participant")).key


def prompt(desk: Desk) -> Prompt:
    told = desk.message("screen")
    assert isinstance(told, Prompt)
    return told


def asked(desk: Desk, show: str, after: int = 0) -> Prompt:
    """Wait until the desk shows this, for a question after the one with this number, and return it."""
    shown = threading.Event()
    desk.wake = shown.set
    while (told := prompt(desk)).show != show or (told.question or after + 1) <= after:
        assert shown.wait(5)
        shown.clear()
    return told


def view(desk: Desk) -> View:
    told = desk.message("console")
    assert isinstance(told, View)
    return told


def test_the_participant_sets_the_masker(desk: Desk, session: Recorded, aside: ThreadPoolExecutor) -> None:
    chosen: Future[str] = aside.submit(level, desk)
    told = asked(desk, "masker")
    assert told.keys == ("+", "-", ENTER)
    assert desk.take(SCREEN, Choose(question=told.question or 0, key="+")) == (True, "")
    assert chosen.result(5) == "+"
    assert session.commands == [("the participant's screen", f"choose {told.question} +", True)]


ORDER: tuple[tuple[str, Callable[[Desk], object], str, str], ...] = (
    (
        "agree",
        lambda desk: desk.ask(Agree("Is it 01?", "yes", "no")).key == YES,
        "wait",
        "wait",
    ),
    (
        "familiarise",
        lambda desk: desk.ask(Familiarise("Feel.", 0, 60, {})).key,
        "instructions",
        "wait",
    ),
    ("level", level, "masker", "wait"),
    ("rest", lambda desk: desk.ask(Rest("")), "rest", "wait"),
    ("place", lambda desk: desk.ask(Place(1, ("foil",))), "wait", "wait"),
    ("", lambda desk: desk.ask(Arm(1, 1, 4, may=STEP)).waited, "ready", "ready"),
    ("play", lambda desk: desk.ask(Play(1, "experimenter")), "coming", "ready"),
    (
        "answer",
        lambda desk: desk.ask(TrialAnswer(1, {"c": "copy paper"}, "n", {})).key,
        "answer",
        "answer",
    ),
    ("confirm", lambda desk: desk.ask(Confirm("c", "copy paper")).key == ENTER, "answer", "answer"),
    ("", lambda desk: desk.tell(Answered(1, "copy paper")), "wait", "wait"),
    ("", lambda desk: desk.ask(Arm(2, 1, 4, may=STEP)).waited, "ready", "ready"),
    ("", lambda desk: desk.tell(Silent()), "wait", "wait"),
    ("rest", lambda desk: desk.ask(Rest("")), "rest", "wait"),
    ("", lambda desk: desk.ask(Arm(2, 2, 4, may=STEP)).waited, "ready", "ready"),
    ("", lambda desk: desk.attend(None), "wait", "wait"),
    ("continue", lambda desk: desk.ask(GoOn("It paused.", begun=True)).key == ENTER, "break", "wait"),
    ("debrief", lambda desk: desk.ask(Debrief()), "finished", "finished"),
)
"""What a session asks of its desk, in a real order: what the participant sees meanwhile, and afterwards."""


def test_the_participants_screen_tells_what_is_so_through_a_whole_session(
    desk: Desk, aside: ThreadPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(linked, "PATIENCE_NS", 0)
    for kind, step, meanwhile, afterwards in ORDER:
        done = aside.submit(step, desk)
        if kind:
            question = open_question(desk, kind)
            assert prompt(desk).show == meanwhile, kind
            desk.take(CONSOLE, Choose(question=question.number, key=question.choices[0].key))
        done.result(5)
        assert prompt(desk).show == afterwards, kind


class Silenced(Recorded):
    """A session that is paused: nothing is measured."""

    def gauges(self) -> None:  # type: ignore[override]
        return None


def test_headphones_may_come_off_after_the_tasks_that_had_a_masker(desk: Desk, session: Recorded) -> None:
    assert not view(desk).masked
    with pytest.raises(PauseAsked):
        desk.take(CONSOLE, Pause())
        level(desk)
    assert view(desk).masked
    desk.attend(None)
    # While the files of its session are written.
    assert view(desk).masked
    desk.attend(Silenced())
    assert view(desk).masked
    desk.attend(session)
    assert not view(desk).masked


def open_question(desk: Desk, kind: str) -> Asked:
    changed = threading.Event()
    desk.wake = changed.set
    while (asked := view(desk).question) is None or asked.kind != kind:
        assert changed.wait(5)
        changed.clear()
    return asked


def test_between_two_presses_for_the_masker_the_screen_stays_after_familiarisation_too(
    desk: Desk, aside: ThreadPoolExecutor, now: list[int]
) -> None:
    familiar = aside.submit(desk.ask, Familiarise("Feel.", 0, 60, {}))
    question = open_question(desk, "familiarise")
    desk.take(CONSOLE, Choose(question=question.number, key=ENTER, t_ns=now[0]))
    familiar.result(5)
    shows = []
    for key in ("+", "-"):
        chosen = aside.submit(level, desk)
        question = open_question(desk, "level")
        shows.append(prompt(desk).show)
        desk.take(SCREEN, Choose(question=question.number, key=key, t_ns=now[0]))
        chosen.result(5)
        shows.append(prompt(desk).show)
    assert shows == ["masker"] * 4


def test_what_the_participant_presses_too_late_is_nothing_that_the_experimenter_typed(
    desk: Desk, session: Recorded
) -> None:
    assert not desk.take(SCREEN, Choose(question=7, key=ENTER))[0]
    assert session.commands == [("the participant's screen", "choose 7 enter", False)]
    assert desk.ignored() == ""
    assert not desk.take(CONSOLE, Choose(question=7, key=ENTER))[0]
    assert desk.ignored() == "\n"


def test_softer_at_the_participants_screen_changes_nothing_that_is_not_theirs_to_answer(
    desk: Desk, aside: ThreadPoolExecutor
) -> None:
    answered = aside.submit(desk.ask, TrialAnswer(1, {"c": "copy paper"}, "n", {"-": "masker softer"}))
    asked = open_question(desk, "answer")
    for number in (asked.number, asked.number - 1):
        assert not desk.take(SCREEN, Choose(question=number, key="-"))[0]
    desk.take(CONSOLE, Choose(question=asked.number, key="c"))
    assert answered.result(5).key == "c"


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    moment = [monotonic_ns()]
    monkeypatch.setattr(linked, "monotonic_ns", lambda: moment[0])
    return moment


def test_between_two_questions_the_screen_stays_as_it_is(desk: Desk, aside: ThreadPoolExecutor, now: list[int]) -> None:
    chosen = aside.submit(level, desk)
    told = asked(desk, "masker")
    desk.take(SCREEN, Choose(question=told.question or 0, key="-"))
    chosen.result(5)
    assert prompt(desk) == told
    now[0] += linked.PATIENCE_NS - 1
    assert prompt(desk) == told
    now[0] += 1
    assert prompt(desk).show == "wait"


def test_the_same_look_keeps_its_number_and_another_gets_its_own(desk: Desk, aside: ThreadPoolExecutor) -> None:
    numbers = []
    for before in (0, 1):
        chosen = aside.submit(level, desk)
        told = asked(desk, "masker", before)
        numbers.append((told.number, told.question))
        desk.take(SCREEN, Choose(question=told.question or 0, key="-"))
        chosen.result(5)
    assert numbers == [(numbers[0][0], 1), (numbers[0][0], 2)]
    desk.ask(Arm(1, 1, 4, may=STEP))
    assert prompt(desk).number == numbers[0][0] + 1


@dataclass(frozen=True)
class Shared:
    """A question of which the participant answers, and the experimenter pauses: it is one of the test."""

    kind: ClassVar[Kind] = "level"
    text = "Which one?"
    choices = (*keyed({"+": "this one"}, answer=True, by="participant"), *keyed({"q": "pause"}))


def at_the_wire(path: Path, hello: Hello, key: str, number: int) -> Reply:
    """Return what a session replies to a key that is sent to its socket, whatever its sender was offered."""
    with closing(Line(path, hello)) as there:
        there.send(Choose(question=number, key=key))
        return next(said for said in there.messages() if isinstance(said, Reply))


def test_nobody_answers_for_another_at_the_wire(desk: Desk, aside: ThreadPoolExecutor, tmp_path: Path) -> None:
    """A participant's screen that may answer sends the key for a pause; a console sends the participant's answer."""
    with closing(Link(tmp_path / "s", desk)), closing(Line(tmp_path / "s", SCREEN)) as screen:
        said = aside.submit(desk.ask, Shared())
        number = open_question(desk, "level").number
        offered = next(one for one in screen.messages() if isinstance(one, Prompt) and one.question == number)
        assert offered.keys == ("+",)
        for hello, key in ((SCREEN, "q"), (CONSOLE, "+")):
            assert not at_the_wire(tmp_path / "s", hello, key, number).taken
        assert not said.done()
        assert at_the_wire(tmp_path / "s", SCREEN, "+", number).taken
        assert said.result(5).key == "+"


def test_the_experimenter_keys_what_the_participant_says_only_without_a_screen(
    desk: Desk, aside: ThreadPoolExecutor
) -> None:
    chosen = aside.submit(level, desk)
    asked = open_question(desk, "level")
    assert [choice.key for choice in asked.choices] == ["-"]
    louder = Choose(question=asked.number, key="+")
    assert not desk.take(CONSOLE, louder)[0]
    desk.came(1, 0)
    assert [choice.key for choice in open_question(desk, "level").choices] == ["+", "-", ENTER]
    assert desk.take(CONSOLE, louder)[0]
    assert chosen.result(5) == "+"


def test_a_masker_that_the_participant_sets_is_softer_by_either(desk: Desk, aside: ThreadPoolExecutor) -> None:
    for hello in (SCREEN, CONSOLE):
        chosen = aside.submit(level, desk)
        asked = open_question(desk, "level")
        assert desk.take(hello, Choose(question=asked.number, key="-"))[0]
        assert chosen.result(5) == "-"


def test_an_answer_to_a_trial_is_not_the_participants(
    desk: Desk, session: Recorded, aside: ThreadPoolExecutor, approved: SnapshotAssertion
) -> None:
    said = aside.submit(desk.ask, TrialAnswer(3, {"c": "copy paper"}, "n", {}))
    told = asked(desk, "answer")
    assert (told.question, told.keys) == (None, ())
    number = view(desk).question
    assert number is not None
    refused = desk.take(SCREEN, Choose(question=number.number, key="c"))
    assert refused == approved
    assert session.commands[-1] == ("the participant's screen", f"choose {number.number} c", False)
    assert desk.take(CONSOLE, Choose(question=number.number, key="c"))[0]
    assert said.result(5).key == "c"


def test_a_screen_may_ask_for_nothing_else(desk: Desk, session: Recorded, approved: SnapshotAssertion) -> None:
    deeds: list[Deed] = [
        TakeNote(text="a"),
        Correct(trial=1, key="c", reason="a"),
        Repeat(trial=1, reason="a"),
        Stop(),
        Typed(keys="c"),
        Write(question=1, text="a"),
    ]
    assert [(deed.do, *desk.take(SCREEN, deed)) for deed in deeds] == approved
    assert [(by, taken) for by, _, taken in session.commands] == [("the participant's screen", False)] * len(deeds)
    assert desk.ignored() == ""


def test_what_is_shown_goes_on_record_with_its_time(desk: Desk, session: Recorded) -> None:
    desk.ask(Arm(1, 1, 4, may=STEP))
    told = prompt(desk)
    assert desk.take(SCREEN, Shown(number=told.number, t_ns=monotonic_ns() - 1_000_000)) == (True, "")
    ((shown, ago_ns),) = session.shows
    assert shown == told
    assert 1_000_000 <= ago_ns < 1_000_000_000
    assert session.commands == []


def test_what_cannot_have_been_shown_is_refused(desk: Desk, session: Recorded) -> None:
    number = prompt(desk).number
    refused = (False, "The participant's screen cannot have shown that.")
    assert desk.take(SCREEN, Shown(number=number, t_ns=monotonic_ns() + 10**12)) == refused
    assert desk.take(SCREEN, Shown(number=number + 1, t_ns=0)) == refused
    assert desk.take(SCREEN, Shown(number=number, t_ns=monotonic_ns() - 60 * 10**9)) == refused
    assert desk.take(SCREEN, Shown(number=number, t_ns=-(10**30))) == refused
    assert not desk.take(CONSOLE, Shown(number=number, t_ns=0))[0]
    assert session.shows == []


def test_a_screen_that_comes_late_hears_where_the_session_is(desk: Desk) -> None:
    desk.ask(Arm(1, 1, 4, may=STEP))
    assert prompt(desk).show == "ready"
    desk.attend(None)
    desk.ended("The session is complete.", 0)
    assert prompt(desk).show == "thanks"


def test_the_console_has_a_lamp_for_the_screen(desk: Desk, approved: SnapshotAssertion) -> None:
    def lamp() -> tuple[bool | None, str]:
        gauges = view(desk).gauges
        assert gauges is not None
        (found,) = [lamp for lamp in gauges.lamps if lamp.name == "screen"]
        return found.good, found.words

    desk.came(1, 0)
    assert lamp() == approved
    desk.came(1, 1)
    assert lamp() == (True, "connected")


def test_a_rig_without_a_screen_has_no_lamp_until_one_comes(session: Recorded) -> None:
    desk = Desk(View())
    desk.attend(session)
    assert view(desk).gauges == session.measured
    desk.came(1, 1)
    desk.came(1, 0)
    gauges = view(desk).gauges
    assert gauges is not None
    assert [lamp.good for lamp in gauges.lamps] == [False]
