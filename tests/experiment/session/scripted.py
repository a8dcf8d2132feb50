"""Scripted devices for sessions in memory: every port fails a test that asks it for more than was scripted."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.conditioning import Played
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.desk.messages import ENTER, ESCAPE
from palpate.experiment.desk.questions import (
    STOP,
    STOPPED,
    WITHOUT,
    Answered,
    Arm,
    Attended,
    Break,
    Confirm,
    Debrief,
    Event,
    Familiarise,
    GoOn,
    Instructed,
    Level,
    Notice,
    Place,
    Proposed,
    Question,
    Remark,
    Reply,
    Rest,
    Say,
    Silent,
    Stopped,
    TrialAnswer,
)
from palpate.experiment.errors import PalpateError, TrackerStopped
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.synthesis.waveforms import Waveform

START_NS = 10**18


def step_samples(start_us: int, speed_mm_s: float) -> Samples:
    """A foot that comes down from 30 mm at one speed and stays on the panel for 0.2 s, at 1 kHz."""
    seconds = np.arange(0, 30 / speed_mm_s + 0.2, 1e-3)
    height = np.maximum(30 - speed_mm_s * seconds, 0)
    device_us = np.rint(start_us + seconds * 1e6).astype(np.int64)
    return Samples(device_us, height, bytes(len(seconds)), np.arange(len(seconds)) + 1, START_NS)


def rest_samples(start_us: int, height_mm: float) -> Samples:
    """A foot that rests for 0.2 s, at 1 kHz."""
    device_us = start_us + 1000 * np.arange(200)
    return Samples(device_us, np.full(200, height_mm), bytes(200), np.arange(200) + 1, START_NS)


class Endless:
    """Implements `Limits`: everything may be felt."""

    ends_ns = 2**63

    def end_reason(self, ahead_ns: int = 0) -> str:
        return ""

    def skip(self, reason: str) -> None:
        raise AssertionError(reason)

    def skipped(self) -> str:
        return ""


class ScriptedTracker:
    """Implements `Tracker`: one scripted step after each `drain`. Its clock is the session's from the first read on."""

    def __init__(
        self,
        steps: Iterable[Samples | PalpateError],
        lost: Iterable[int] = (),
        *,
        clock: ManualClock,
        comes_back: bool = False,
    ) -> None:
        self._steps = deque(steps)
        self._lost = deque(lost)
        self._clock = clock
        self._comes_back = comes_back
        self.drains: deque[TrackerStopped | None] = deque()
        """What the next calls of `drain` raise, if anything."""
        self.clock_map: ClockMap | None = None
        self.counts = LinkCounts()
        self.gone = False

    def drain(self) -> None:
        if self.drains and (stopped := self.drains.popleft()):
            raise stopped

    def reconnect(self, timeout_s: float) -> None:
        self._clock.sleep_ns(int(timeout_s / 2 * 1e9))
        if not self._comes_back:
            raise TrackerStopped(f"tracker at scripted: not back within {timeout_s:g} s")
        self.clock_map = None

    def read(self) -> Samples:
        if not self._steps:
            raise TrackerStopped("the script is over")
        step = self._steps.popleft()
        if isinstance(step, PalpateError):
            raise step
        lost = self._lost.popleft() if self._lost else 0
        self.counts = self.counts.plus(LinkCounts(received=len(step.device_us), lost=lost))
        self.clock_map = self.clock_map or ClockMap(int(step.device_us[0]), self._clock.now_ns())
        return step

    def close(self) -> None:
        pass


class ScriptedActuator:
    """Implements `Actuator`: keeps what it was asked to play, and says what was scripted of how it was heard."""

    rate_hz = 5000

    def __init__(self) -> None:
        self.lead_ns = 0
        self.played: list[NDArray[np.float64]] = []
        self.aimed: list[list[int]] = []
        """The onsets asked for, of each stimulus."""
        self.withdrawn = 0
        self.sounds_anyway = self.still_plays = False
        self.late: set[int] = set()
        """The stimuli, from 1, that take no aim."""
        self.heard: deque[Delivered | BaseException | None] = deque()
        self._prepared: NDArray[np.float64] | None = None

    def prepare(self, stimulus: Waveform) -> Played:
        self._prepared = stimulus.waveform_m_s2
        self.aimed.append([])
        return Played(stimulus, self._prepared.astype("<f4"), full_scale=1.0, limited=0, method="scripted")

    def aim(self, onset_ns: int) -> bool:
        self.aimed[-1].append(onset_ns)
        return len(self.aimed) not in self.late

    def landed(self, contact_ns: int) -> None:
        assert self._prepared is not None
        self.played.append(self._prepared)
        self._prepared = None

    def withdraw(self) -> bool:
        self.withdrawn += self._prepared is not None
        self._prepared = None
        return not self.sounds_anyway

    def is_silent(self) -> bool:
        return not self.still_plays

    def delivered(self, contact_ns: int) -> Delivered | None:
        heard = self.heard.popleft() if self.heard else None
        if isinstance(heard, BaseException):
            raise heard
        return heard

    def close(self) -> None:
        pass


class ScriptedConsole:
    """Implements `Console`: gives the scripted keys, and lets a second pass for each."""

    def __init__(
        self, clock: ManualClock, keys: Iterable[str | Remark], before_ask: Callable[[], None] = lambda: None
    ) -> None:
        self._clock = clock
        self._keys = deque(keys)
        self._before_ask = before_ask
        self.placed: list[tuple[int, str]] = []
        self.armed: list[tuple[int, int]] = []
        self.trained: list[int | None] = []
        """Of each attempt: the most trials of its training, None of one that counts."""
        self.rearmed: list[tuple[int, int, str]] = []
        self.shown: list[str] = []
        self.levels: deque[str] = deque()
        """Keys of the masker's level; `.` keeps it."""
        self.confirmations: list[tuple[int, str | None]] = []
        self.confirm_ns = 0
        """How long a confirmation takes."""
        self.confirms: deque[bool] = deque()
        """Whether each choice is confirmed; those that follow are."""
        self.remarks: deque[Remark] = deque()
        """What is said once all trials are answered."""
        self.early: deque[str] = deque()
        """What was typed before each question; before those that follow, nothing."""
        self.familiarised = 0
        self.handles: deque[str] = deque()
        self.counts: list[dict[str, str]] = []
        self.instructed: list[str] = []
        self.pictured: list[tuple[str, ...]] = []
        self.attended: list[Attended | None] = []
        self.said: list[tuple[str, int, str]] = []
        """What the participant was asked to say, as which take, and why again."""
        self.goes_with_microphone = True
        self.proposed: list[str] = []
        self.nobody_there: deque[bool] = deque()
        """Whether somebody had to be waited for at each arming; at those that follow, nobody."""
        self.waited = 0
        """How often a device was told to be silent."""
        self.chosen_before_ns = 0
        """How long before `ask` returned the key was pressed."""
        self.rested: list[str] = []
        """Why the foot was asked to rest, each time."""
        self.instead: dict[type, Callable[[], Reply | None]] = {}
        """What happens first at each question of a class; where that gives a reply, it is the reply."""

    def attend(self, session: Attended | None) -> None:
        self.attended.append(session)

    def tell(self, event: Event) -> None:
        match event:
            case Notice(text=text):
                self.shown.append(text)
            case Stopped():
                self.shown.append(STOPPED)
            case Proposed(words=words):
                self.proposed.append(words)
            case Instructed(instruction=instruction, pictures=pictures):
                self.instructed.append(instruction)
                self.pictured.append(pictures)
            case Silent():
                self.waited += 1
            case Answered(trial=trial, answer=answer):
                self.confirmations.append((trial, answer))

    def ask(self, question: Question | Arm) -> Reply:
        if (instead := self.instead.get(type(question))) and (reply := instead()) is not None:
            return reply
        match question:
            case Arm():
                self._note(question)
                return Reply(waited=self.nobody_there.popleft() if self.nobody_there else False)
            case Familiarise() if self.handles:
                self.counts.append(dict(question.handled))
                return Reply(self.handles.popleft())
            case Familiarise():
                self.familiarised += 1
                self._clock.sleep_ns(100 * 10**9)
            case Level():
                return self._set(question)
            case Say(words=words, take=take, why=why):
                self.said.append((words, take, why))
                return Reply(ENTER if self.goes_with_microphone else WITHOUT)
            case Rest(why=why):
                self.rested.append(why)
            case Place(trial=trial, presented=presented):
                self.placed.append((trial, " | ".join(presented)))
            case TrialAnswer():
                return self._answer(question)
            case Confirm():
                self._clock.sleep_ns(self.confirm_ns)
                return Reply(ENTER if not self.confirms or self.confirms.popleft() else ESCAPE)
            case Debrief():
                return Reply(remark=self.remarks.popleft() if self.remarks else None)
            case Break(left_s=left_s):
                self._clock.sleep_ns(int(left_s * 1e9))
            case GoOn():
                return Reply(STOP)
        return Reply(question.choices[0].key if question.choices else "")

    def _note(self, wanted: Arm) -> None:
        self.trained.append(wanted.trials if wanted.training else None)
        if wanted.broken_off:
            self.rearmed.append((wanted.trial, wanted.attempt, wanted.broken_off))
        else:
            self.armed.append((wanted.trial, wanted.attempt))

    def _set(self, question: Level) -> Reply:
        key = self.levels.popleft()
        if key == ".":
            return Reply(ENTER)
        assert key in {choice.key for choice in question.choices}, f"{key} is not offered"
        self._clock.sleep_ns(10**9)
        return Reply(key)

    def _answer(self, question: TrialAnswer) -> Reply:
        self._before_ask()
        self._clock.sleep_ns(10**9)
        key = self._keys.popleft()
        if not isinstance(key, str):
            return Reply(remark=key)
        assert key in {choice.key for choice in question.choices}
        return Reply(key, ago_ns=self.chosen_before_ns)

    def ignored(self) -> str:
        return self.early.popleft() if self.early else ""
