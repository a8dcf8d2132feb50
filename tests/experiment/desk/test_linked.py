"""A desk whose console is another process: which keys count, what may be asked at any moment, and who is missed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import pytest

from experiment.clock import MonotonicClock
from experiment.desk.linked import LinkedConsole
from experiment.desk.messages import (
    Choose,
    Correct,
    Deed,
    Gauges,
    Hello,
    Pause,
    Prompt,
    Question,
    Repeat,
    Standing,
    Stop,
    TakeNote,
    Typed,
    View,
    Write,
)
from experiment.desk.port import Corrected, Noted, Remark, Repeated
from experiment.errors import PauseAsked

ME = Hello(role="console", by="test")
ANSWERS, OTHERS = {"c": "copy paper", "p": "polypropylene"}, {"n": "no answer", "r": "do this trial again"}
T = TypeVar("T")


class Attending:
    """Implements `Attended`: keeps what it is told."""

    def __init__(self, linked: LinkedConsole) -> None:
        self.linked = linked
        self.remarks: list[Remark] = []
        self.record: list[tuple[str, str, bool, str]] = []
        self.pauses = 0
        self.open_when_recorded: list[bool] = []

    def gauges(self) -> Gauges:
        return Gauges(left_s=60.0)

    def standing(self) -> Standing:
        return Standing(task="virtual", purpose="PILOT", trials=4, answered=1, remaining=3)

    def remark(self, remark: Remark) -> tuple[bool, str]:
        self.remarks.append(remark)
        return True, "done"

    def pause(self) -> None:
        self.pauses += 1

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        raise AssertionError(f"no screen is there to show {prompt}")

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        self.record.append((by, command, taken, words))
        self.open_when_recorded.append(shown(self.linked).question is not None)


def shown(linked: LinkedConsole) -> View:
    view = linked.tell("console")
    assert isinstance(view, View)
    return view


class Bench:
    """A session's thread that asks, and a console's that answers."""

    def __init__(self, alone_s: float = 600.0) -> None:
        self.linked = LinkedConsole(View(study="small"), alone_s=alone_s)
        self.attending = Attending(self.linked)
        self._pool = ThreadPoolExecutor(1)
        self._woken = threading.Event()
        self.linked.wake = self._woken.set
        self.linked.came(1, 0)
        self.linked.attend(self.attending)

    def asks(self, question: Callable[[], T]) -> Future[T]:
        return self._pool.submit(question)

    def question(self, kind: str) -> Question:
        """Wait for a question of this kind."""
        ends_s = time.monotonic() + 10
        while time.monotonic() < ends_s:
            self._woken.clear()
            asked = shown(self.linked).question
            if asked is not None and asked.kind == kind:
                return asked
            self._woken.wait(1)
        raise AssertionError(f"no {kind} question came: {shown(self.linked)}")

    def do(self, deed: Deed) -> tuple[bool, str]:
        return self.linked.take(ME, deed)

    def press(self, kind: str, key: str) -> Question:
        asked = self.question(kind)
        assert self.do(Choose(question=asked.number, key=key))[0]
        return asked


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    # Nobody waits any more.
    bench.do(Stop())


def test_an_answer_is_chosen_then_confirmed_each_by_its_own_question(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(trial=3, answers=ANSWERS, others=OTHERS))
    asked = bench.press("answer", "c")
    assert [(choice.key, choice.answer) for choice in asked.choices] == [
        ("c", True),
        ("p", True),
        ("n", False),
        ("r", False),
    ]
    assert said.result(10) == "c"
    confirmed = bench.asks(lambda: bench.linked.confirm(key="c", meaning="copy paper"))
    assert bench.press("confirm", "enter").number != asked.number
    assert confirmed.result(10)
    assert shown(bench.linked).question is None


QUESTIONS: dict[str, Callable[[LinkedConsole], object]] = {
    "agree": lambda one: one.agree(text="Is it 01?", yes="yes", no="no"),
    "familiarise": lambda one: one.familiarise(instruction="Feel.", min_s=0, max_s=60),
    "level": lambda one: one.level(level_db_a=50, limit_db_a=80, criterion="Nothing.", keys={"+": "louder"}),
    "rest": lambda one: one.rest(why=""),
    "place": lambda one: one.place(trial=1, presented=("copy paper",)),
    "answer": lambda one: one.ask(trial=1, answers=ANSWERS, others=OTHERS),
    "confirm": lambda one: one.confirm(key="c", meaning="copy paper"),
    "debrief": lambda one: one.debrief(),
    "continue": lambda one: one.goes_on(why="It paused."),
}


@pytest.mark.parametrize("kind", QUESTIONS)
def test_a_key_pressed_before_a_question_never_answers_it(bench: Bench, kind: str) -> None:
    first = bench.asks(lambda: QUESTIONS[kind](bench.linked))
    before = bench.question(kind)
    key = before.choices[0].key
    assert bench.do(Choose(question=before.number, key=key))[0]
    first.result(10)
    second = bench.asks(lambda: QUESTIONS[kind](bench.linked))
    bench.question(kind)
    assert bench.do(Choose(question=before.number, key=key)) == (
        False,
        "That question is no longer asked; the key answered nothing.",
    )
    assert bench.do(Typed(keys="xx"))[0]
    assert not second.done()
    assert bench.linked.ignored() == f"{key}xx"
    assert bench.linked.ignored() == ""
    bench.press(kind, key)
    second.result(10)


def test_one_key_answers_one_question_once(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(trial=3, answers=ANSWERS, others=OTHERS))
    asked = bench.question("answer")
    assert bench.do(Choose(question=asked.number, key="x")) == (False, "'x' is no key here.")
    assert not said.done()
    assert bench.do(Choose(question=asked.number, key="c"))[0]
    assert not bench.do(Choose(question=asked.number, key="p"))[0]
    assert said.result(10) == "c"


def test_a_command_is_on_record_before_the_session_goes_on(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(trial=3, answers=ANSWERS, others=OTHERS))
    asked = bench.press("answer", "p")
    said.result(10)
    assert bench.attending.record == [("test", f"choose {asked.number} p", True, "")]
    assert bench.attending.open_when_recorded == [True]


def test_notes_and_corrections_are_taken_at_any_moment_and_their_words_stand_in_their_own_entries(
    bench: Bench,
) -> None:
    assert bench.do(TakeNote(text="Coughs.", trial=3))[0]
    assert bench.do(Correct(trial=2, key="p", reason="misheard"))[0]
    assert bench.do(Repeat(trial=1, reason="a door slammed"))[0]
    assert bench.attending.remarks == [
        Noted("Coughs.", 3),
        Corrected(2, "p", "misheard"),
        Repeated(1, "a door slammed"),
    ]
    assert [command for _, command, _, _ in bench.attending.record] == ["note 3", "correct 2 p", "repeat 1"]
    assert bench.do(TakeNote(text="a\x1bb"))[0] is False
    assert len(bench.attending.remarks) == 3


def test_without_a_session_nothing_is_noted(bench: Bench) -> None:
    bench.linked.attend(None)
    assert bench.do(TakeNote(text="Coughs.")) == (False, "No session is under way.")


@pytest.mark.parametrize("at", ["answer", "confirm"])
def test_a_trial_that_is_repeated_at_its_question_needs_no_key(bench: Bench, at: str) -> None:
    said = bench.asks(lambda: bench.linked.ask(trial=3, answers=ANSWERS, others=OTHERS))
    if at == "confirm":
        bench.press("answer", "c")
        assert said.result(10) == "c"
        confirmed = bench.asks(lambda: bench.linked.confirm(key="c", meaning="copy paper"))
        bench.question("confirm")
        assert bench.do(Repeat(trial=3, reason="coughs"))[0]
        assert not confirmed.result(10)
        said = bench.asks(lambda: bench.linked.ask(trial=3, answers=ANSWERS, others=OTHERS))
    else:
        bench.question("answer")
        assert bench.do(Repeat(trial=3, reason="coughs"))[0]
    assert said.result(10) == Repeated(3, "coughs")
    assert bench.attending.remarks == []


@pytest.mark.parametrize("kind", [kind for kind in QUESTIONS if kind != "continue"])
@pytest.mark.parametrize("deed", [Pause(), Stop()])
def test_a_pause_ends_whatever_is_waited_for(bench: Bench, kind: str, deed: Deed) -> None:
    asked = bench.asks(lambda: QUESTIONS[kind](bench.linked))
    bench.question(kind)
    assert bench.do(deed)[0]
    with pytest.raises(PauseAsked, match="by the experimenter"):
        asked.result(10)
    assert bench.attending.pauses == 1
    assert shown(bench.linked).question is None


def test_a_pause_goes_on_when_wanted_a_stop_does_not(bench: Bench) -> None:
    for deed, key, goes_on in ((Pause(minutes=5), "enter", True), (Pause(), "s", False), (Stop(), "", False)):
        assert bench.do(deed)[0]
        bench.linked.attend(None)
        asked = bench.asks(lambda: bench.linked.goes_on(why="It paused."))
        if key:
            until_ns = (bench.question("continue"), shown(bench.linked).pause_until_ns)[1]
            minutes = deed.minutes if isinstance(deed, Pause) else None
            assert (until_ns is None) == (minutes is None)
            assert until_ns is None or 290 < until_ns / 1e9 - time.time() <= 300
            bench.press("continue", key)
        assert asked.result(10) is goes_on
        bench.linked.attend(bench.attending)


def test_a_break_asked_for_while_it_is_paused_begins_its_countdown_and_ends_nothing(bench: Bench) -> None:
    bench.linked.attend(None)
    asked = bench.asks(lambda: bench.linked.goes_on(why="It paused."))
    first = bench.question("continue")
    assert shown(bench.linked).pause_until_ns is None
    assert bench.do(Pause(minutes=5))[0]
    ends_s = time.monotonic() + 10
    while (again := shown(bench.linked)).question in (None, first) and time.monotonic() < ends_s:
        time.sleep(0.01)
    assert again.pause_until_ns is not None
    bench.press("continue", "enter")
    assert asked.result(10)


def test_a_pause_asked_for_while_devices_are_opened_is_not_forgotten(bench: Bench) -> None:
    bench.linked.attend(None)
    assert bench.do(Pause())[0]
    bench.linked.attend(bench.attending)
    assert bench.attending.pauses == 1
    with pytest.raises(PauseAsked):
        bench.linked.rest(why="")


def test_a_break_ends_by_itself_and_can_be_stopped(bench: Bench) -> None:
    clock = MonotonicClock()
    soon = bench.asks(lambda: bench.linked.wait(why="Break.", until_ns=clock.now_ns() + 50_000_000, clock=clock))
    soon.result(10)
    long = bench.asks(lambda: bench.linked.wait(why="Break.", until_ns=clock.now_ns() + 10**12, clock=clock))
    bench.question("break")
    assert bench.do(Stop())[0]
    with pytest.raises(PauseAsked):
        long.result(10)


def test_a_line_of_text_is_written_or_nothing(bench: Bench) -> None:
    for text, kept in (("  It felt real. ", "It felt real."), ("", "")):
        written = bench.asks(lambda: bench.linked.write(text="What do they report?"))
        asked = bench.question("write")
        assert not bench.do(Write(question=asked.number, text="a\x1bb"))[0]
        assert not bench.do(Write(question=asked.number - 1, text="late"))[0]
        assert bench.do(Write(question=asked.number, text=text))[0]
        assert written.result(10) == kept


def test_while_nobody_is_at_a_console_nothing_is_armed_and_then_the_session_pauses() -> None:
    bench = Bench(alone_s=0.2)
    bench.linked.came(0, 0)
    with pytest.raises(PauseAsked, match="nobody was at a console"):
        bench.linked.arm(trial=1, attempt=1, trials=4)
    assert shown(bench.linked).state == "preparing"
    with pytest.raises(PauseAsked, match="nobody was at a console"):
        bench.linked.ask(trial=1, answers=ANSWERS, others=OTHERS)
    bench.linked.came(1, 0)
    bench.linked.arm(trial=1, attempt=1, trials=4)
    assert shown(bench.linked).state == "armed"


def test_a_console_is_told_what_the_session_is_for_and_how_far_it_is(bench: Bench) -> None:
    view = shown(bench.linked)
    assert (view.label, view.standing.remaining) == ("PILOT", 3)
    assert view.gauges == Gauges(left_s=60.0)
    bench.linked.show("one\ntwo \x1b[31m")
    assert shown(bench.linked).lines == ("one two <U+001B>[31m",)
