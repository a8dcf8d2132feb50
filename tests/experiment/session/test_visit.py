"""A visit's tasks, one after the other: what goes on, and what ends it."""

from __future__ import annotations

from collections import deque
from contextlib import nullcontext
from pathlib import Path
from typing import Any, cast

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.desk.messages import ENTER
from palpate.experiment.desk.questions import NO, STOP, Agree, Arm, Attended, GoOn, Question, Reply
from palpate.experiment.errors import Interrupted, PalpateError, PauseAsked, RosterError, TrackerError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Footer
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import run
from palpate.experiment.session.visit import ask_first, ending_words, visit_steps, walk
from palpate.experiment.study.schedule import Allocation
from tests.approved import Refuses
from tests.experiment.session.scripted import START_NS, ScriptedConsole

COMPLETE, PAUSED = Footer(reason="complete", answered=3), Footer(reason="paused", detail="by hand", answered=1)
INTERRUPTED_BY_SIGNAL = Footer(reason="paused", detail="interrupted at the keyboard", answered=1)
"""As the runner ends by Ctrl-C, SIGTERM or SIGHUP; over a link no key of the keyboard is one."""


class Asked(ScriptedConsole):
    """Says, in turn, whether the session goes on."""

    def __init__(self, *says: bool) -> None:
        super().__init__(ManualClock(START_NS), "")
        self.says = deque(says)
        self.whys: list[str] = []

    def ask(self, question: Question | Arm) -> Reply:
        if not isinstance(question, GoOn):
            return super().ask(question)
        self.whys.append(question.text)
        return Reply(ENTER if self.says.popleft() else STOP)


class Sessions:
    """Ends each session that is run as it was told."""

    def __init__(self, *ends: Footer | PalpateError) -> None:
        self.ends = deque(ends)
        self.ran: list[str] = []

    def run(self, task: str) -> Footer:
        self.ran.append(task)
        end = self.ends.popleft()
        if isinstance(end, PalpateError):
            raise end
        return end


@pytest.mark.parametrize(
    ("says", "ends", "ran", "last"),
    [
        ([], [COMPLETE, COMPLETE], ["a", "b"], COMPLETE),
        ([True], [PAUSED, COMPLETE, COMPLETE], ["a", "a", "b"], COMPLETE),
        ([False], [PAUSED], ["a"], PAUSED),
        ([True, False], [COMPLETE, PAUSED, PAUSED], ["a", "b", "b"], PAUSED),
        ([], [INTERRUPTED_BY_SIGNAL], ["a"], INTERRUPTED_BY_SIGNAL),
        ([True], [PauseAsked("in the break"), COMPLETE, COMPLETE], ["a", "a", "b"], COMPLETE),
        ([True], [TrackerError("tracker: gone"), COMPLETE, COMPLETE], ["a", "a", "b"], COMPLETE),
    ],
)
def test_tasks_follow_one_another_and_what_stopped_goes_on_if_wanted(
    says: list[bool], ends: list[Footer | PalpateError], ran: list[str], last: Footer
) -> None:
    console, sessions = Asked(*says), Sessions(*ends)
    assert walk(console=console, tasks=("a", "b"), run=sessions.run, noting=lambda _: None) == last
    assert sessions.ran == ran
    assert not console.says


def test_a_device_that_failed_is_told_and_raised_if_nobody_wants_to_go_on() -> None:
    console = Asked(False)
    with pytest.raises(TrackerError):
        walk(console=console, tasks=("a",), run=Sessions(TrackerError("tracker: gone")).run, noting=lambda _: None)
    assert console.whys == ["Tracker: gone."]


@pytest.mark.parametrize(("says", "asks"), [([True], 2), ([True, True, False], 3)])
def test_a_pause_before_the_first_session_comes_back_to_its_question(
    says: list[bool], asks: int, approved: SnapshotAssertion
) -> None:
    console, times = Asked(*says), []

    def ask() -> None:
        times.append(1)
        if len(times) <= len(says) and (len(times) == 1 or not all(says)):
            raise PauseAsked("by the experimenter")

    with nullcontext() if all(says) else pytest.raises(PauseAsked):
        ask_first(console, ask)
    assert len(times) == asks
    assert set(console.whys) == approved


def test_what_no_second_try_mends_is_raised_at_once() -> None:
    with pytest.raises(RosterError):
        walk(console=Asked(), tasks=("a",), run=Sessions(RosterError("withdrew")).run, noting=lambda _: None)


def test_the_record_says_when_the_identity_was_confirmed_and_when_it_was_not_asked_again(
    tmp_path: Path, protocol: Protocol, approved: SnapshotAssertion, refuses: Refuses
) -> None:
    # The rest of a visit's settings are for what is not asked here.
    clock = ManualClock(START_NS)
    console = ScriptedConsole(clock, "")
    unused: Any = None
    visit = run._Visit(
        protocol_file=tmp_path,
        protocol=protocol,
        rig_file=tmp_path,
        rig=unused,
        root=tmp_path,
        recordings=None,
        allocation=Allocation("01", ("virtual", "real")),
        asked_for=("virtual", "real"),
        seed=1,
        purpose="STUDY",
        anchored_in=None,
        consent_on=None,
        console=console,
        given=(),
        clock=clock,
    )
    said = []
    for _ in range(3):
        visit._identify()
        assert visit._identity is not None
        said.append(visit._identity.text)
    assert said == approved
    visit._identity = None
    console.instead[Agree] = lambda: Reply(NO)
    with refuses(Interrupted):
        visit._identify()


def test_how_a_session_ended_is_said_in_sentences(approved: SnapshotAssertion) -> None:
    over = Footer(reason="paused", detail="the session has reached the protocol's limit of 33 min", answered=0)
    said = [
        ending_words(COMPLETE),
        ending_words(COMPLETE, last=True),
        ending_words(PAUSED),
        ending_words(PAUSED, onward=False),
        ending_words(over),
    ]
    assert said == approved


def test_a_visit_ends_with_its_debriefing() -> None:
    assert visit_steps(("a", "b")) == ("a", "b", "debriefing")


def test_a_console_attends_the_session_that_paused_until_it_goes_on() -> None:
    class Attending(Asked):
        def ask(self, question: Question | Arm) -> Reply:
            assert self.attended[-1] is rests
            return super().ask(question)

    rests = cast("Attended", object())
    console, sessions = Attending(True), Sessions(PAUSED, COMPLETE)
    walk(console=console, tasks=("a",), run=sessions.run, noting={"a": rests}.get)
    assert console.attended == [rests, None]
