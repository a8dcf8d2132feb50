"""A session's desk toward the participant's screen: what it tells it, and the little that it takes from it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.clock import monotonic_ns
from palpate.experiment.desk import linked
from palpate.experiment.desk.messages import (
    ENTER,
    Choose,
    Correct,
    Deed,
    Hello,
    Pause,
    Prompt,
    Question,
    Repeat,
    Shown,
    Stop,
    TakeNote,
    Typed,
    View,
    Write,
)
from palpate.experiment.desk.prompts import Theirs
from palpate.experiment.errors import PauseAsked
from tests.experiment.desk.attended import Desk, Recorded

SCREEN = Hello(role="screen", by="the participant's screen")
CONSOLE = Hello(role="console", by="console")
KEYS = {"+": "masker louder", "-": "masker softer"}


@pytest.fixture
def session() -> Recorded:
    return Recorded()


@pytest.fixture
def desk(session: Recorded) -> Desk:
    made = Desk(View(study="study", participant="01"), theirs=Theirs(frozenset({"level"})), screen=True)
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
    return desk.level(level_db_a=50, limit_db_a=80, criterion="Nothing is heard.", keys=KEYS)


def prompt(desk: Desk) -> Prompt:
    told = desk.tell("screen")
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
    told = desk.tell("console")
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
        lambda desk: desk.agree(text="Is it 01?", yes="yes", no="no"),
        "wait",
        "wait",
    ),
    (
        "familiarise",
        lambda desk: desk.familiarise(instruction="Feel.", min_s=0, max_s=60, handled={}),
        "instructions",
        "wait",
    ),
    ("level", level, "masker", "wait"),
    ("rest", lambda desk: desk.rest(why=""), "rest", "wait"),
    ("place", lambda desk: desk.place(trial=1, presented=("foil",)), "wait", "wait"),
    ("", lambda desk: desk.arm(trial=1, attempt=1, trials=4), "ready", "ready"),
    (
        "answer",
        lambda desk: desk.ask(trial=1, answers={"c": "copy paper"}, others={"n": "no answer"}),
        "answer",
        "answer",
    ),
    ("confirm", lambda desk: desk.confirm(key="c", meaning="copy paper"), "answer", "answer"),
    ("", lambda desk: desk.confirmed(trial=1, answer="copy paper"), "wait", "wait"),
    ("", lambda desk: desk.arm(trial=2, attempt=1, trials=4), "ready", "ready"),
    ("", Desk.waiting, "wait", "wait"),
    ("rest", lambda desk: desk.rest(why=""), "rest", "wait"),
    ("", lambda desk: desk.arm(trial=2, attempt=2, trials=4), "ready", "ready"),
    ("", lambda desk: desk.attend(None), "wait", "wait"),
    ("continue", lambda desk: desk.goes_on(why="It paused."), "break", "wait"),
    ("debrief", Desk.debrief, "finished", "finished"),
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


def test_headphones_may_come_off_after_the_tasks_that_had_a_masker(desk: Desk, session: Recorded) -> None:
    assert not view(desk).masked
    with pytest.raises(PauseAsked):
        desk.take(CONSOLE, Pause())
        level(desk)
    assert view(desk).masked
    desk.attend(None)
    # While the files of its session are written.
    assert view(desk).masked
    desk.attend(session)
    assert not view(desk).masked


def open_question(desk: Desk, kind: str) -> Question:
    changed = threading.Event()
    desk.wake = changed.set
    while (asked := view(desk).question) is None or asked.kind != kind:
        assert changed.wait(5)
        changed.clear()
    return asked


def test_between_two_presses_for_the_masker_the_screen_stays_after_familiarisation_too(
    desk: Desk, aside: ThreadPoolExecutor, now: list[int]
) -> None:
    familiar = aside.submit(desk.familiarise, instruction="Feel.", min_s=0, max_s=60, handled={})
    question = open_question(desk, "familiarise")
    desk.take(CONSOLE, Choose(question=question.number, key=ENTER))
    familiar.result(5)
    shows = []
    for key in ("+", "-"):
        chosen = aside.submit(level, desk)
        question = open_question(desk, "level")
        shows.append(prompt(desk).show)
        desk.take(SCREEN, Choose(question=question.number, key=key))
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
    answered = aside.submit(desk.ask, trial=1, answers={"c": "copy paper"}, others={"-": "masker softer"})
    asked = open_question(desk, "answer")
    for number in (asked.number, asked.number - 1):
        assert not desk.take(SCREEN, Choose(question=number, key="-"))[0]
    desk.take(CONSOLE, Choose(question=asked.number, key="c"))
    assert answered.result(5) == "c"


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
    desk.arm(trial=1, attempt=1, trials=4)
    assert prompt(desk).number == numbers[0][0] + 1


def test_an_answer_to_a_trial_is_not_the_participants(
    desk: Desk, session: Recorded, aside: ThreadPoolExecutor, approved: SnapshotAssertion
) -> None:
    said = aside.submit(desk.ask, trial=3, answers={"c": "copy paper"}, others={"n": "no answer"})
    told = asked(desk, "answer")
    assert (told.question, told.keys) == (None, ())
    number = view(desk).question
    assert number is not None
    refused = desk.take(SCREEN, Choose(question=number.number, key="c"))
    assert refused == approved
    assert session.commands[-1] == ("the participant's screen", f"choose {number.number} c", False)
    assert desk.take(CONSOLE, Choose(question=number.number, key="c"))[0]
    assert said.result(5) == "c"


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
    desk.arm(trial=1, attempt=1, trials=4)
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
    desk.arm(trial=1, attempt=1, trials=4)
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
