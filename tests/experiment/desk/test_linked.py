"""A desk whose console is another process: which keys count, what may be asked at any moment, and who is missed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk import linked as linked_module
from palpate.experiment.desk import questions
from palpate.experiment.desk.link.standing import standing
from palpate.experiment.desk.link.wire import (
    CLOSED,
    Asked,
    Choose,
    Deed,
    Hello,
    Pause,
    Stop,
    Typed,
    View,
    Write,
)
from palpate.experiment.desk.linked import LinkedConsole
from palpate.experiment.desk.messages import ENTER, ESCAPE, By, Correct, Gauges, Prompt, Repeat, TakeNote
from palpate.experiment.desk.questions import (
    YES,
    Agree,
    Answered,
    Arm,
    At,
    Break,
    Confirm,
    Debrief,
    Familiarise,
    GoOn,
    Instructed,
    Level,
    Notice,
    Place,
    Play,
    Pressed,
    Remark,
    Report,
    Rest,
    Say,
    Silent,
    TrialAnswer,
)
from palpate.experiment.errors import JournalError, LinkError, PauseAsked
from palpate.experiment.records.progress import Progress
from tests.approved import Refuses
from tests.experiment.desk.attended import Desk, Inline, done

ME = Hello(role="console", by="test")
ANSWERS, OTHERS = {"c": "copy paper", "p": "polypropylene"}, {"r": "repeat this trial"}
T = TypeVar("T")


class Attending:
    """Implements `Attended`: keeps what it is told."""

    def __init__(self, linked: LinkedConsole) -> None:
        self.linked = linked
        self.remarks: list[Remark] = []
        self.record: list[tuple[str, str, bool, str]] = []
        self.pauses: list[str] = []
        self.open_when_recorded: list[bool] = []

    def gauges(self) -> Gauges:
        return Gauges(left_s=60.0)

    def done(self) -> Progress:
        return done("PILOT", trials=4, answered=1)

    def remark(self, remark: Remark) -> tuple[bool, str]:
        self.remarks.append(remark)
        return True, "done"

    def pause(self, why: str) -> None:
        self.pauses.append(why)

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        raise AssertionError(f"no screen is there to show {prompt}")

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        self.record.append((by, command, taken, words))
        self.open_when_recorded.append(shown(self.linked).question is not None)


def shown(linked: LinkedConsole) -> View:
    view = linked.message("console")
    assert isinstance(view, View)
    return view


class Bench:
    """A session's thread that asks, and a console's that answers."""

    def __init__(self, alone_s: float = 600.0, *, screen: bool = False) -> None:
        self.linked = Desk(View(study="small"), alone_s=alone_s, screen=screen)
        self.attending = Attending(self.linked)
        self._pool = ThreadPoolExecutor(1)
        self._woken = threading.Event()
        self.linked.wake = self._woken.set
        self.linked.came(1, 0)
        self.linked.attend(self.attending)

    def asks(self, question: Callable[[], T]) -> Future[T]:
        return self._pool.submit(question)

    def question(self, kind: str, after: int = 0) -> Asked:
        """Wait for a question of this kind, after the one with this number."""
        ends_s = time.monotonic() + 10
        while time.monotonic() < ends_s:
            self._woken.clear()
            asked = shown(self.linked).question
            if asked is not None and asked.kind == kind and asked.number > after:
                return asked
            self._woken.wait(1)
        raise AssertionError(f"no {kind} question came: {shown(self.linked)}")

    def do(self, deed: Deed) -> tuple[bool, str]:
        return self.linked.take(ME, deed)

    def press(self, kind: str, key: str, after: int = 0) -> Asked:
        asked = self.question(kind, after)
        assert self.do(Choose(question=asked.number, key=key))[0]
        return asked


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    # Nobody waits any more.
    bench.do(Stop())


def test_an_answer_is_chosen_then_confirmed_each_by_its_own_question(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    asked = bench.press("answer", "c")
    assert [(choice.key, choice.answer) for choice in asked.choices] == [
        ("c", True),
        ("p", True),
        ("n", False),
        ("r", False),
    ]
    assert said.result(10) == "c"
    confirmed = bench.asks(lambda: bench.linked.ask(Confirm("c", "copy paper")).key == ENTER)
    assert bench.press("confirm", "enter").number != asked.number
    assert confirmed.result(10)
    assert shown(bench.linked).question is None


QUESTIONS: dict[str, Callable[[Desk], object]] = {
    "agree": lambda one: one.ask(Agree("Is it 01?", "yes", "no")).key == YES,
    "familiarise": lambda one: one.ask(Familiarise("Feel.", 0, 60, {})).key,
    "level": lambda one: one.ask(Level(50, 80, "Nothing.", probe=False, by="experimenter")).key,
    "say": lambda one: one.ask(Say("copy paper", 1, 2, "")).key == ENTER,
    "rest": lambda one: one.ask(Rest("")),
    "place": lambda one: one.ask(Place(1, ("copy paper",))),
    "play": lambda one: one.ask(Play(1, "experimenter")),
    "answer": lambda one: one.ask(TrialAnswer(1, ANSWERS, "n", OTHERS)).key,
    "confirm": lambda one: one.ask(Confirm("c", "copy paper")).key == ENTER,
    "debrief": lambda one: one.ask(Debrief()),
    "continue": lambda one: one.ask(GoOn("It paused.", begun=True)).key == ENTER,
}


@pytest.mark.parametrize("kind", QUESTIONS)
def test_a_key_pressed_before_a_question_never_answers_it(bench: Bench, kind: str) -> None:
    first = bench.asks(lambda: QUESTIONS[kind](bench.linked))
    before = bench.question(kind)
    key = before.choices[0].key
    typed = {"enter": "\n", "escape": "\x1b"}.get(key, key)
    assert bench.do(Choose(question=before.number, key=key))[0]
    first.result(10)
    second = bench.asks(lambda: QUESTIONS[kind](bench.linked))
    bench.question(kind)
    assert bench.do(Choose(question=before.number, key=key)) == (False, CLOSED)
    assert bench.do(Typed(keys="xx"))[0]
    assert not second.done()
    assert bench.linked.ignored() == f"{typed}xx"
    assert bench.linked.ignored() == ""
    bench.press(kind, key)
    second.result(10)


def test_enter_alone_says_neither_yes_nor_no(bench: Bench, approved: SnapshotAssertion) -> None:
    said = bench.asks(lambda: bench.linked.ask(Agree("Did they sign today?", "yes", "no")).key == YES)
    asked = bench.question("agree")
    assert bench.do(Choose(question=asked.number, key="enter")) == approved
    assert not said.done()
    bench.press("agree", "y")
    assert said.result(10)


def test_one_key_answers_one_question_once(bench: Bench, approved: SnapshotAssertion) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    asked = bench.question("answer")
    assert bench.do(Choose(question=asked.number, key="x")) == approved
    assert not said.done()
    assert bench.do(Choose(question=asked.number, key="c"))[0]
    assert not bench.do(Choose(question=asked.number, key="p"))[0]
    assert said.result(10) == "c"


def test_a_command_is_on_record_before_the_session_goes_on(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    asked = bench.press("answer", "p")
    said.result(10)
    assert bench.attending.record == [("test", f"choose {asked.number} p", True, "")]
    assert bench.attending.open_when_recorded == [True]


def test_notes_and_corrections_are_taken_at_any_moment_and_their_words_stand_in_their_own_entries(
    bench: Bench,
    approved: SnapshotAssertion,
) -> None:
    assert bench.do(TakeNote(text="Coughs.", trial=3))[0]
    assert bench.do(Correct(trial=2, key="p", reason="misheard"))[0]
    assert bench.do(Repeat(trial=1, reason="a door slammed"))[0]
    assert bench.attending.remarks == [
        TakeNote(text="Coughs.", trial=3),
        Correct(trial=2, key="p", reason="misheard"),
        Repeat(trial=1, reason="a door slammed"),
    ]
    assert [command for _, command, _, _ in bench.attending.record] == ["note 3", "correct 2 p", "repeat 1"]
    assert bench.do(TakeNote(text="a\x1bb"))[0] is False
    assert len(bench.attending.remarks) == 3
    told = shown(bench.linked).lines
    assert told == approved


def test_every_console_is_told_of_another_that_is_opened_or_closed(bench: Bench, approved: SnapshotAssertion) -> None:
    bench.linked.came(1, 1)
    # A participant's screen is no console.
    assert shown(bench.linked).lines == ()
    bench.linked.came(2, 1)
    bench.linked.came(1, 1)
    assert shown(bench.linked).lines == approved


def test_a_correction_may_be_that_nothing_was_said(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(1, ANSWERS, "n", OTHERS)).key)
    bench.press("answer", "c")
    said.result(10)
    assert [(one.key, one.words) for one in shown(bench.linked).answers][-1] == ("n", "no answer")


def test_the_instruction_stands_until_a_first_answer_or_a_pause(bench: Bench, approved: SnapshotAssertion) -> None:
    bench.linked.tell(Instructed("Step."))
    assert shown(bench.linked).lines == approved
    bench.linked.ask(Arm(1, 1, 4))
    assert shown(bench.linked).instruction == "Step."
    bench.linked.tell(Answered(1, "copy paper"))
    assert shown(bench.linked).instruction == ""
    bench.linked.tell(Instructed("Step."))
    bench.linked.attend(None)
    assert shown(bench.linked).instruction == ""


def test_a_trial_of_the_training_is_one_of_so_many_until_one_that_counts_is_armed(bench: Bench) -> None:
    bench.linked.ask(Arm(1, 1, 6, training=True))
    assert shown(bench.linked).training == 6
    bench.linked.ask(Arm(1, 1, 4))
    assert shown(bench.linked).training is None


def test_pictures_of_an_instruction_are_named_to_the_experimenter_too(bench: Bench) -> None:
    bench.linked.tell(Instructed("Step.", pictures=("foot.png",)))
    view = shown(bench.linked)
    assert (view.instruction, view.pictures) == ("Step.", ("foot.png",))
    assert "foot.png." in view.lines[-1].split()


def test_a_trial_that_is_armed_again_says_why_until_it_is_asked_or_another_is_armed(
    bench: Bench, approved: SnapshotAssertion
) -> None:
    def again() -> str:
        return shown(bench.linked).again

    bench.linked.ask(Arm(1, 1, 4))
    assert again() == ""
    bench.linked.ask(Arm(1, 2, 4, "the foot stopped"))
    assert again() == "The foot stopped"
    bench.linked.ask(Arm(1, 3, 4))
    # Of a step that was felt, and does not count.
    assert again() == approved
    bench.linked.tell(Silent())
    bench.linked.ask(Arm(1, 4, 4))
    # The device was silent.
    assert again() == ""
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(1, ANSWERS, "n", OTHERS)).key)
    bench.press("answer", "r")
    said.result(10)
    bench.linked.ask(Arm(1, 5, 4))
    # The experimenter had it done again.
    assert again() == ""


@pytest.mark.parametrize(
    ("at", "text", "does", "step"),
    [
        (
            "real",
            "Task real is done. All trials have been answered. Add any remaining notes. Task virtual comes next.",
            "end task real",
            "real",
        ),
        ("virtual", "All trials have been answered. Add any remaining notes.", "end", "debriefing"),
    ],
)
def test_only_the_last_task_ends_with_the_debriefing(bench: Bench, at: str, text: str, does: str, step: str) -> None:
    bench.linked.tell(At(at, ("real", "virtual", "debriefing")))
    ended = bench.asks(lambda: bench.linked.ask(Debrief()))
    asked = bench.press("debrief", "enter")
    ended.result(10)
    assert (asked.text, asked.choices[0].words, shown(bench.linked).step) == (text, does, step)


def test_without_a_session_nothing_is_noted(bench: Bench, approved: SnapshotAssertion) -> None:
    bench.linked.attend(None)
    taken, words = bench.do(TakeNote(text="Coughs."))
    assert not taken
    assert words == approved


def test_what_was_reached_stays_on_the_screen_of_a_pause(bench: Bench) -> None:
    before = shown(bench.linked)
    bench.linked.attend(None)
    after = shown(bench.linked)
    assert (
        (after.label, after.standing) == (before.label, before.standing) == ("PILOT", standing(bench.attending.done()))
    )


def test_a_link_that_failed_ends_what_is_waited_for_and_what_would_be(
    bench: Bench, approved: SnapshotAssertion
) -> None:
    asked = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    bench.question("answer")
    bench.linked.lost("ZeroDivisionError: x")
    for waits in (
        lambda: asked.result(10),
        lambda: bench.linked.ask(GoOn("It paused.", begun=True)).key == ENTER,
        lambda: bench.linked.ask(Arm(4, 1, 4)).waited,
    ):
        with pytest.raises(LinkError, match=r"the link to the consoles failed \(ZeroDivisionError: x\)"):
            waits()
    # A foot that is waited for meanwhile is waited for no longer.
    assert len(bench.attending.pauses) == 1
    assert bench.attending.pauses[0] == approved


def test_an_answer_that_was_confirmed_counts_though_a_pause_came_right_after_it(bench: Bench) -> None:
    confirmed = bench.asks(lambda: bench.linked.ask(Confirm("c", "copy paper")).key == ENTER)
    asked = bench.question("confirm")
    with bench.linked._changed:
        # The session's thread wakes only when both are there.
        assert bench.do(Choose(question=asked.number, key="enter"))[0]
        assert bench.do(Pause())[0]
    assert confirmed.result(10)
    with pytest.raises(PauseAsked):
        bench.linked.ask(Rest(""))


@pytest.mark.parametrize(
    ("deeds", "until", "goes_on"),
    [
        ((Stop(), Pause()), False, False),
        ((Stop(), Pause(minutes=5)), False, False),
        ((Pause(minutes=5), Pause()), True, True),
        ((Pause(), Pause(minutes=5)), True, True),
        ((Pause(minutes=5), Stop()), False, False),
    ],
)
def test_a_later_pause_takes_neither_a_stop_back_nor_a_breaks_length(
    bench: Bench, deeds: tuple[Deed, ...], until: bool, goes_on: bool
) -> None:
    for deed in deeds:
        assert bench.do(deed)[0]
    bench.linked.attend(None)
    asked = bench.asks(lambda: bench.linked.ask(GoOn("It paused.", begun=True)).key == ENTER)
    if goes_on:
        bench.question("continue")
        assert (shown(bench.linked).pause_until_ns is not None) == until
        first = bench.press("continue", "enter")
        if until:
            bench.press("continue", "enter", first.number)
    assert asked.result(10) is goes_on


def test_a_key_answers_only_the_question_that_it_was_pressed_at(bench: Bench) -> None:
    """The first question is closed, by a signal say, while its key goes on record."""
    linked = bench.linked
    with linked._open(Debrief()):
        first = bench.question("debrief")
        recorded = bench.attending.commanded
        closing = linked._open(GoOn("Second?", begun=True))

        def close_meanwhile(**what: Any) -> None:
            recorded(**what)
            closing.__enter__()

        bench.attending.commanded = close_meanwhile  # type: ignore[method-assign]
        assert bench.do(Choose(question=first.number, key="enter")) == (False, CLOSED)
        assert linked._chosen is None
        closing.__exit__(None, None, None)
    bench.attending.commanded = recorded  # type: ignore[method-assign]


@pytest.mark.parametrize("off_ns", [-1, 50_000_001, 10**18, -(10**18)])
def test_a_choice_that_was_made_before_its_question_or_is_still_to_come_is_none(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, off_ns: int
) -> None:
    now = [10**12]
    monkeypatch.setattr(linked_module, "monotonic_ns", lambda: now[0])
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)))
    asked = bench.question("answer")
    now[0] += 50_000_000
    assert not bench.do(Choose(question=asked.number, key="c", t_ns=10**12 + off_ns))[0]
    assert not said.done()
    assert bench.do(Choose(question=asked.number, key="c", t_ns=now[0]))[0]
    assert said.result(10).ago_ns == 0


def test_a_choice_is_timed_when_it_was_made_and_not_when_it_came_or_is_on_record(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [10**12]
    monkeypatch.setattr(linked_module, "monotonic_ns", lambda: now[0])
    recorded = bench.attending.commanded

    def slow_disk(**what: Any) -> None:
        recorded(**what)
        now[0] += 80_000_000

    bench.attending.commanded = slow_disk  # type: ignore[method-assign]
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)))
    asked, pressed_ns = bench.question("answer"), now[0] + 20_000_000
    now[0] += 50_000_000
    assert bench.do(Choose(question=asked.number, key="c", t_ns=pressed_ns))[0]
    assert (said.result(10).key, said.result(10).ago_ns) == ("c", 110_000_000)
    bench.attending.commanded = recorded  # type: ignore[method-assign]


def test_a_pause_takes_effect_while_the_disk_hangs_and_the_key_before_it_counts_once_it_is_on_record(
    bench: Bench,
) -> None:
    linked = LinkedConsole(View(study="small"))
    linked.came(1, 0)
    attending, disk = Attending(linked), threading.Event()
    recorded = attending.commanded

    def hang(**what: Any) -> None:
        assert disk.wait(10)
        recorded(**what)

    attending.commanded = hang  # type: ignore[method-assign]
    linked.attend(attending)
    said = bench.asks(lambda: linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    while (asked := shown(linked).question) is None:
        time.sleep(0.001)
    pressed = linked.take(ME, Choose(question=asked.number, key="c"))
    again = linked.take(ME, Choose(question=asked.number, key="p"))
    paused = linked.take(ME, Pause())
    assert isinstance(paused, tuple)
    assert paused[0]
    assert attending.pauses == [questions.BY_EXPERIMENTER]
    assert isinstance(pressed, Future)
    assert isinstance(again, Future)
    assert not said.done()
    assert not pressed.done()
    assert shown(linked).question == asked
    ended = threading.Thread(target=linked.attend, args=(None,))
    ended.start()
    disk.set()
    assert said.result(10) == "c"
    assert (pressed.result(10), again.result(10)) == ((True, ""), (False, CLOSED))
    ended.join(10)
    # Everything that was asked of the session is on record before another is attended.
    assert [command for _, command, _, _ in attending.record] == ["choose 1 c", "choose 1 p", "pause"]
    with pytest.raises(PauseAsked):
        linked.ask(Confirm("c", "copy paper"))


def test_a_key_whose_record_fails_does_not_count_and_the_session_pauses_instead_of_asking_for_ever(
    bench: Bench,
) -> None:
    def fail(**_: Any) -> None:
        raise JournalError("full")

    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    asked = bench.question("answer")
    bench.attending.commanded = fail  # type: ignore[method-assign]
    assert bench.do(Choose(question=asked.number, key="c")) == (False, "full")
    error = said.exception(10)
    assert isinstance(error, PauseAsked)
    assert error.finding.what == "full"
    assert bench.attending.pauses == ["full"]


def test_what_is_repeated_after_a_key_is_refused_and_nothing_of_it_is_left(
    bench: Bench, approved: SnapshotAssertion
) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    asked = bench.question("answer")
    with bench.linked._changed:
        assert bench.do(Choose(question=asked.number, key="c"))[0]
        assert bench.do(Repeat(trial=3, reason="coughs")) == approved
    assert said.result(10) == "c"
    bench.linked._repeated = Repeat(trial=3, reason="of a session before")
    bench.linked.attend(bench.attending)
    again = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)).key)
    bench.press("answer", "p")
    assert again.result(10) == "p"


@pytest.mark.parametrize("at", ["answer", "confirm"])
def test_a_trial_that_is_repeated_at_its_question_needs_no_key(bench: Bench, at: str) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)))
    if at == "confirm":
        bench.press("answer", "c")
        assert said.result(10).key == "c"
        confirmed = bench.asks(lambda: bench.linked.ask(Confirm("c", "copy paper")).key == ENTER)
        bench.question("confirm")
        assert bench.do(Repeat(trial=3, reason="coughs"))[0]
        assert not confirmed.result(10)
        said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS)))
    else:
        bench.question("answer")
        assert bench.do(Repeat(trial=3, reason="coughs"))[0]
    assert said.result(10).remark == Repeat(trial=3, reason="coughs")
    assert bench.attending.remarks == []


def test_a_trial_that_is_repeated_before_it_is_set_off_needs_no_key(bench: Bench) -> None:
    bench.asks(lambda: bench.linked.ask(Arm(3, 1, 4))).result(10)
    for asked in (Play(3, "experimenter"), Play(3, "participant")):
        said = bench.asks(partial(bench.linked.ask, asked))
        bench.question("play")
        assert bench.do(Repeat(trial=3, reason="coughs"))[0]
        assert said.result(10).key == ESCAPE
    assert bench.attending.remarks == [Repeat(trial=3, reason="coughs")] * 2
    # It is closed once that is on record.
    assert bench.attending.open_when_recorded == [True, True]


@pytest.mark.parametrize("kind", [kind for kind in QUESTIONS if kind != "continue"])
@pytest.mark.parametrize("deed", [Pause(), Stop()])
def test_a_pause_ends_whatever_is_waited_for(bench: Bench, kind: str, deed: Deed) -> None:
    asked = bench.asks(lambda: QUESTIONS[kind](bench.linked))
    bench.question(kind)
    assert bench.do(deed)[0]
    with pytest.raises(PauseAsked, match="by the experimenter"):
        asked.result(10)
    assert bench.attending.pauses == ["by the experimenter"]
    assert shown(bench.linked).question is None


def test_the_participant_stops_while_another_deed_waits_for_the_disk(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    writes, freed = threading.Event(), threading.Event()

    def hangs(_attending: Attending, remark: Remark) -> tuple[bool, str]:
        writes.set()
        assert freed.wait(60)
        return True, "done"

    monkeypatch.setattr(Attending, "remark", hangs)

    def pauses(attending: Attending, why: str) -> None:
        attending.pauses.append(why)
        freed.set()

    monkeypatch.setattr(Attending, "pause", pauses)
    bench.linked._recorder = ThreadPoolExecutor(1)
    noting = threading.Thread(target=bench.do, args=(TakeNote(text="coughs"),))
    noting.start()
    assert writes.wait(60)
    assert bench.linked.take(Hello(role="screen", by="the participant's screen"), Pause())[0]
    noting.join()
    bench.linked._recorder.shutdown()
    bench.linked._recorder = Inline()
    assert bench.attending.pauses == [questions.BY_PARTICIPANT]
    assert questions.STOPPED in shown(bench.linked).lines
    assert [one[:3] for one in bench.attending.record][-1] == ("the participant's screen", "pause", True)
    with pytest.raises(PauseAsked) as paused:
        bench.linked.ask(Agree("Go on?", "yes", "no"))
    assert str(paused.value) == questions.BY_PARTICIPANT


def test_a_pause_goes_on_when_wanted_a_stop_does_not(bench: Bench) -> None:
    for deed, key, goes_on in ((Pause(minutes=5), "enter", True), (Pause(), "s", False), (Stop(), "", False)):
        assert bench.do(deed)[0]
        bench.linked.attend(None)
        asked = bench.asks(lambda: bench.linked.ask(GoOn("It paused.", begun=True)).key == ENTER)
        if key:
            until_ns = (bench.question("continue"), shown(bench.linked).pause_until_ns)[1]
            minutes = deed.minutes if isinstance(deed, Pause) else None
            assert (until_ns is None) == (minutes is None)
            assert until_ns is None or 290 < until_ns / 1e9 - time.time() <= 300
            first = bench.press("continue", key)
            if minutes is not None:
                bench.press("continue", key, first.number)
        assert asked.result(10) is goes_on
        bench.linked.attend(bench.attending)


def test_a_break_asked_for_while_it_is_paused_begins_its_countdown_and_ends_nothing(bench: Bench) -> None:
    bench.linked.attend(None)
    asked = bench.asks(lambda: bench.linked.ask(GoOn("It paused.", begun=False)).key == ENTER)
    first = bench.question("continue")
    # No session had begun.
    assert first.choices[0].words == "continue"
    assert shown(bench.linked).pause_until_ns is None
    assert bench.do(Pause(minutes=5))[0]
    ends_s = time.monotonic() + 10
    while (again := shown(bench.linked)).question in (None, first) and time.monotonic() < ends_s:
        time.sleep(0.01)
    assert again.pause_until_ns is not None
    asked_once = bench.press("continue", "enter")
    bench.press("continue", "enter", asked_once.number)
    assert asked.result(10)


def test_a_break_that_was_asked_for_ends_early_only_when_that_is_meant(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bench.do(Pause(minutes=5))[0]
    bench.linked.attend(None)
    asked = bench.asks(lambda: bench.linked.ask(GoOn("It paused.", begun=True)).key == ENTER)
    number = 0
    for key, text in (("enter", "It paused."), ("escape", "The break is not over. End it now?")) * 2:
        told = bench.question("continue", number)
        assert (told.text, shown(bench.linked).state) == (text, "paused")
        number = bench.press("continue", key, number).number
    bench.question("continue", number)
    until_ns = shown(bench.linked).pause_until_ns
    assert until_ns is not None
    monkeypatch.setattr(linked_module, "wall_ns", lambda: until_ns)
    bench.press("continue", "enter", number)
    # One key goes on once its time is over.
    assert asked.result(10)


@pytest.mark.parametrize(("key", "taken"), [("-", True), ("+", False)])
def test_softer_counts_at_the_level_that_is_asked_for_now(bench: Bench, key: str, taken: bool) -> None:
    """A press that was made for the level before is one for this one."""
    level = Level(60.0, 80.0, "Nothing is heard.", probe=False, by="experimenter")
    asked = bench.asks(lambda: bench.linked.ask(level).key)
    now = bench.question("level")
    assert bench.do(Choose(question=now.number - 1, key=key))[0] is taken
    if not taken:
        bench.press("level", "-")
    assert asked.result(10) == "-"


def test_a_pause_asked_for_while_devices_are_opened_is_not_forgotten(bench: Bench) -> None:
    bench.linked.attend(None)
    assert bench.do(Pause())[0]
    bench.linked.attend(bench.attending)
    assert bench.attending.pauses == ["by the experimenter"]
    with pytest.raises(PauseAsked):
        bench.linked.ask(Rest(""))


def test_a_break_ends_by_itself_and_can_be_stopped(bench: Bench) -> None:
    soon = bench.asks(lambda: bench.linked.ask(Break("Break.", 0.05)))
    soon.result(10)
    long = bench.asks(lambda: bench.linked.ask(Break("Break.", 1000.0)))
    asked = bench.question("break")
    assert not bench.do(Choose(question=asked.number, key="enter"))[0]
    # No key cuts it.
    assert bench.question("break") == asked
    assert bench.do(Stop())[0]
    with pytest.raises(PauseAsked):
        long.result(10)


def test_a_line_of_text_is_written_or_nothing(bench: Bench) -> None:
    for text, kept in (("  It felt real. ", "It felt real."), ("", "")):
        written = bench.asks(lambda: bench.linked.ask(Report("What do they report?")).text)
        asked = bench.question("write")
        assert not bench.do(Write(question=asked.number, text="a\x1bb"))[0]
        assert not bench.do(Write(question=asked.number - 1, text="late"))[0]
        assert bench.do(Write(question=asked.number, text=text))[0]
        assert written.result(10) == kept


def test_a_familiarisation_counts_down_to_the_key_that_ends_it_and_then_to_its_most(
    bench: Bench, approved: SnapshotAssertion
) -> None:
    bench.asks(lambda: bench.linked.ask(Familiarise("Feel.", 100, 580, {})).key)
    early = bench.question("familiarise")
    assert early.text == approved
    until_ns = shown(bench.linked).pause_until_ns
    assert until_ns is not None
    assert 90 < until_ns / 1e9 - time.time() <= 100
    told = "'enter' is not a key here until the countdown is over."
    assert bench.do(Choose(question=early.number, key="enter")) == (False, told)
    assert bench.do(Stop())[0]


def test_once_its_least_has_passed_a_familiarisation_ends_by_enter(bench: Bench) -> None:
    ended = bench.asks(lambda: bench.linked.ask(Familiarise("Feel.", 0.05, 580, {})).key)
    ends_s = time.monotonic() + 10
    while not bench.question("familiarise").choices and time.monotonic() < ends_s:
        time.sleep(0.01)
    until_ns = shown(bench.linked).pause_until_ns
    assert until_ns is not None
    assert 560 < until_ns / 1e9 - time.time() <= 580
    assert not ended.done()
    bench.press("familiarise", "enter")
    ended.result(10)
    assert shown(bench.linked).pause_until_ns is None


def test_a_material_is_counted_before_and_after_the_least_of_a_familiarisation(bench: Bench) -> None:
    for least_s, keys in ((100, ["c"]), (0, ["enter", "c"])):
        handled = bench.asks(partial(bench.linked.ask, Familiarise("Feel.", least_s, 580, {"c": "cork (2)"})))
        assert [choice.key for choice in bench.question("familiarise").choices] == keys
        bench.press("familiarise", "c")
        assert handled.result(10).key == "c"


def armed(bench: Bench) -> Future[bool]:
    return bench.asks(lambda: bench.linked.ask(Arm(1, 1, 4)).waited)


def test_nothing_is_armed_before_the_participants_screen_is_there(approved: SnapshotAssertion) -> None:
    bench = Bench(screen=True)
    waits = armed(bench)
    assert bench.question("agree").text == approved
    assert shown(bench.linked).state == "preparing"
    bench.linked.came(1, 1)
    # Whoever arms is told that it was waited for.
    assert waits.result(10)
    assert shown(bench.linked).state == "armed"
    bench.linked.came(1, 0)
    # A screen that is lost later stops nothing.
    assert armed(bench).result(10) is False


@pytest.mark.parametrize("by", ["key", "time"])
def test_a_session_goes_on_without_a_screen_that_does_not_open(
    by: str, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.setattr(linked_module, "SCREEN_S", 0.02 if by == "time" else 600)
    bench = Bench(screen=True)
    waits = armed(bench)
    if by == "key":
        bench.press("agree", "enter")
    assert waits.result(10)
    assert shown(bench.linked).lines == approved
    # It is waited for once.
    assert armed(bench).result(10) is False


def test_while_nobody_is_at_a_console_nothing_is_armed_and_then_the_session_pauses(refuses: Refuses) -> None:
    bench = Bench(alone_s=0.2)
    bench.linked.came(0, 0)
    with refuses(PauseAsked):
        bench.linked.ask(Arm(1, 1, 4))
    assert shown(bench.linked).state == "preparing"
    with refuses(PauseAsked):
        bench.linked.ask(TrialAnswer(1, ANSWERS, "n", OTHERS))
    bench.linked.came(1, 0)
    assert not bench.linked.ask(Arm(1, 1, 4)).waited
    assert shown(bench.linked).state == "armed"
    bench.linked.tell(Silent())
    assert shown(bench.linked).state == "waiting"


def test_whoever_arms_is_told_that_somebody_had_to_be_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()

    def comes(timeout_s: float) -> bool:
        bench.linked.came(1, 0)
        return True

    monkeypatch.setattr(bench.linked._changed, "wait", comes)
    calls: tuple[Callable[[], bool], ...] = (
        lambda: bench.linked.ask(Arm(1, 1, 4)).waited,
        lambda: bench.linked.ask(Arm(1, 2, 4, "the foot stopped")).waited,
    )
    for armed in calls:
        bench.linked.came(0, 0)
        assert armed()
    assert not bench.linked.ask(Arm(1, 3, 4, "the foot stopped")).waited


@pytest.mark.parametrize(("at_will", "state"), [(False, "armed"), (True, "answering")])
def test_a_pair_that_is_rendered_can_be_felt_at_once(at_will: bool, state: str) -> None:
    one = Desk(View(at_will=at_will))
    one.came(1, 0)
    one.ask(Arm(1, 1, 4))
    assert shown(one).state == state


def test_a_pair_is_tried_until_its_answer_is_pressed(bench: Bench) -> None:
    bench.linked.ask(Arm(1, 1, 4, may="tap"))
    tried: list[str] = []
    for key in ("s", "c"):
        asked = bench.asks(lambda: bench.linked.ask(TrialAnswer(1, {"c": "cork"}, "n", {"s": "the other"})))
        bench.question("answer")
        tried.append(shown(bench.linked).may)
        bench.press("answer", key)
        asked.result(10)
        tried.append(shown(bench.linked).may)
    assert tried == ["tap", "tap", "tap", ""]


def test_another_trial_is_laid_out_without_the_attempts_of_the_last(bench: Bench) -> None:
    bench.linked.ask(Arm(1, 3, 4))
    laid = bench.asks(lambda: bench.linked.ask(Place(2, ("cork",))))
    bench.question("place")
    assert (shown(bench.linked).trial, shown(bench.linked).attempt) == (2, 1)
    bench.press("place", "enter")
    laid.result(10)


def test_a_console_is_told_what_the_session_is_for_and_how_far_it_is(bench: Bench) -> None:
    view = shown(bench.linked)
    assert (view.label, view.standing.remaining) == ("PILOT", 3)
    assert view.gauges == Gauges(left_s=60.0)
    bench.linked.tell(Notice("one\ntwo \x1b[31m"))
    assert shown(bench.linked).lines == ("one two <U+001B>[31m",)


def test_what_was_laid_out_is_not_told_after_the_end(bench: Bench, approved: SnapshotAssertion) -> None:
    laid = bench.asks(lambda: bench.linked.ask(Place(2, ("cork",))))
    bench.question("place")
    assert bench.do(Stop())[0]
    with pytest.raises(PauseAsked):
        laid.result(10)
    for line, again in (("For the lab book: one", True), ("For the lab book: two", True), ("another line", False)):
        bench.linked.tell(Notice(line, again=again))
    bench.linked.ended("It ended.", 0)
    view = shown(bench.linked)
    assert (view.trial, view.lay_out) == (None, "")
    assert view.ended is not None
    # And the number is printed with it.
    assert view.ended.words == approved


THEM = Hello(role="screen", by="the participant's screen")


@pytest.mark.parametrize("by", ["participant", "buttons"])
@pytest.mark.parametrize("screens", [0, 1])
def test_an_answer_that_is_the_participants_is_taken_from_nobody_else(bench: Bench, by: By, screens: int) -> None:
    """Neither from the experimenter, screen or no screen, nor from the participant's other device; the rest is not
    theirs.
    """
    bench.linked.came(1, screens)
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", {**OTHERS, "+": "louder"}, by)))
    asked = bench.question("answer")
    assert [one.key for one in asked.choices] == ["n", "r", "+"]
    assert bench.do(Choose(question=asked.number, key="c")) == (False, linked_module.NOT_THEIRS["experimenter"])
    for key in ("r", "n", "+"):
        assert not bench.linked.take(THEM, Choose(question=asked.number, key=key))[0]
        bench.linked.tell(Pressed(key, device_us=1))
    other: Callable[[], object] = partial(bench.linked.take, THEM, Choose(question=asked.number, key="p"))
    if by == "participant":
        other = partial(bench.linked.tell, Pressed("p"))
    other()
    assert not said.done()
    if by == "buttons":
        bench.linked.tell(Pressed("c", device_us=77, error_s=0.001))
    else:
        assert bench.linked.take(THEM, Choose(question=asked.number, key="c", error_s=0.002))[0]
    reply = said.result(10)
    assert (reply.key, reply.by) == ("c", by)
    assert (reply.device_us, reply.error_s) == ((77, 0.001) if by == "buttons" else (None, 0.002))
    assert [one[2] for one in bench.attending.record].count(True) == 1


def test_a_press_from_before_its_question_answers_nothing_and_the_experimenter_is_told(bench: Bench) -> None:
    bench.linked.tell(Pressed("c", device_us=1))
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS, "buttons")))
    bench.question("answer")
    bench.linked.tell(Pressed("c", ago_ns=10**9, device_us=2))
    assert not said.done()
    assert len(shown(bench.linked).lines) == 2
    assert [one[2] for one in bench.attending.record] == [False, False]
    bench.linked.tell(Pressed("p", device_us=3))
    assert (said.result(10).key, said.result(10).device_us) == ("p", 3)


def test_the_experimenter_has_a_trial_redone_that_the_participant_is_asked_about(bench: Bench) -> None:
    said = bench.asks(lambda: bench.linked.ask(TrialAnswer(3, ANSWERS, "n", OTHERS, "participant")))
    bench.press("answer", "r")
    assert (said.result(10).key, said.result(10).by) == ("r", "experimenter")
