"""One attempt at one trial: lay out, arm, watch the step, put it on disk, ask, and put the answer on disk.

The keys with which the experimenter logs what the participant said.

The states of a session and the one table of what may follow what.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, BinaryIO

from experiment.apparatus.ports import Actuator, Masker, Tracker
from experiment.apparatus.tracker.clock_map import ClockMap
from experiment.apparatus.tracker.gate import GateDetector
from experiment.apparatus.tracker.landing import NOISE_MM, LandingPredictor
from experiment.apparatus.tracker.zeroing import ZeroedTracker
from experiment.clock import Clock, lasted_ms
from experiment.desk.port import Console
from experiment.errors import SessionError, TrackerError, TrackerStopped
from experiment.protocol.models import Protocol
from experiment.records.entries import Answer, AnyEntry, Header, PlannedTrial, Redo, Trace, TrackerOpened, Zeroed
from experiment.session import interrupts, scene
from experiment.session.footstep.stimulus import Sounder
from experiment.session.footstep.watch import Armed, BrokenStep, Feed, Watch, WatchedStep, entry, watch
from experiment.session.masker import KEYS, Masking

if TYPE_CHECKING:
    from experiment.synthesis.waveforms import Basis


def keys(protocol: Protocol) -> dict[str, str]:
    """What each key stands for, as the experimenter reads it: answers first, then what the session understands."""
    spoken = {m.key: m.id + (f" ('{m.spoken[0]}')" if m.spoken[0] != m.id else "") for m in protocol.materials}
    return spoken | {
        protocol.answers.no_answer_key: "no answer",
        protocol.answers.redo_key: "do this trial again",
        protocol.answers.pause_key: "pause",
    }


def material_of(protocol: Protocol, key: str) -> str | None:
    """The material that `key` names; None for the key of no answer.

    Raises:
        KeyError: the key names no answer.
    """
    if key == protocol.answers.no_answer_key:
        return None
    return {m.key: m.id for m in protocol.materials}[key]


class State(StrEnum):
    """Where a session stands; `WAITING` is for a tracker that stopped."""

    READY = "ready"
    FAMILIARISING = "familiarising"
    ARMED = "armed"
    WAITING = "waiting"
    ANSWERING = "answering"
    COMPLETE = "complete"
    PAUSED = "paused"
    FAILED = "failed"


class Event(StrEnum):
    """What happens to a session."""

    BEGIN = "begin"
    RESUME = "resume"
    FAMILIARISED = "familiarised"
    STEPPED = "stepped"
    BROKEN_OFF = "broken-off"
    LOST = "lost"
    FOUND = "found"
    ANSWERED = "answered"
    REDONE = "redone"
    EXHAUSTED = "exhausted"
    PAUSE = "pause"
    FAIL = "fail"


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.READY, Event.BEGIN): State.FAMILIARISING,
    (State.READY, Event.RESUME): State.ARMED,
    (State.READY, Event.PAUSE): State.PAUSED,
    (State.READY, Event.FAIL): State.FAILED,
    (State.FAMILIARISING, Event.FAMILIARISED): State.ARMED,
    (State.FAMILIARISING, Event.PAUSE): State.PAUSED,
    (State.FAMILIARISING, Event.FAIL): State.FAILED,
    (State.ARMED, Event.STEPPED): State.ANSWERING,
    (State.ARMED, Event.BROKEN_OFF): State.ARMED,
    (State.ARMED, Event.LOST): State.WAITING,
    (State.ARMED, Event.EXHAUSTED): State.COMPLETE,
    (State.ARMED, Event.PAUSE): State.PAUSED,
    (State.ARMED, Event.FAIL): State.FAILED,
    (State.WAITING, Event.FOUND): State.ARMED,
    (State.WAITING, Event.PAUSE): State.PAUSED,
    (State.WAITING, Event.FAIL): State.FAILED,
    (State.ANSWERING, Event.ANSWERED): State.ARMED,
    (State.ANSWERING, Event.REDONE): State.ARMED,
    (State.ANSWERING, Event.PAUSE): State.PAUSED,
    (State.ANSWERING, Event.FAIL): State.FAILED,
}
"""Every transition there is; `COMPLETE`, `PAUSED` and `FAILED` end a runner."""


def follow(state: State, event: Event) -> State:
    """The state after `event`. Raises `SessionError` for a transition that the table does not hold."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        allowed = ", ".join(e for s, e in TRANSITIONS if s is state) or "nothing: the session has ended"
        raise SessionError(f"a session that is {state} got {event}; allowed: {allowed}") from None


RECONNECT_S = 300.0
"""How long a session with a participant in the room waits for a tracker that stopped, s."""

CLOCKS_PART_US = 10e6
"""Device and session time may part by this much: a slow step, and what came before the first."""

CLOCKS_DRIFT = 0.01
"""And by this part of the time passed: the largest drift that clock_map.py believes, twice a ceramic resonator's."""


@dataclass(frozen=True)
class Devices:
    """The opened parts of a session; what its scene leaves out is None.

    Attributes:
        tracker: where the foot is; a `ZeroedTracker` is zeroed before the first attempt, and when it has come back.
        tracker_port: what the journal calls its port.
        noise_mm: of the tracker's sensor, mm rms; None where the rig file does not state it.
        actuator: what shakes the panel.
        masker: noise on the headphones; None where the rig has no sound.
        materials: what stimuli are made of, by the ids of the materials.
        console: the experimenter's screen.
        clock: the session's.
        reconnect_s: how long a session waits for a tracker that stopped, s; then it is paused.
        priority: of the session's threads, in words; empty where it does not matter, in simulated time.
    """

    tracker: Tracker
    tracker_port: str
    noise_mm: float | None
    actuator: Actuator | None
    materials: Mapping[str, Basis] | None
    console: Console
    clock: Clock
    masker: Masker | None
    reconnect_s: float
    priority: str = ""


@dataclass(frozen=True)
class _Parted:
    """The tracker's clock has parted from the session's: the one to go by, and why the session cannot go on."""

    clock: ClockMap
    error: TrackerError


class Attempts:
    """The attempts of one session, one after the other."""

    def __init__(
        self,
        *,
        protocol: Protocol,
        header: Header,
        devices: Devices,
        write: Callable[[AnyEntry], None],
        foot: BinaryIO,
        masking: Masking | None,
    ) -> None:
        """Set up before the first attempt.

        Args:
            protocol: the study.
            header: what the session is.
            devices: the opened parts.
            write: puts an entry into the journal and returns when it is on disk.
            foot: takes the tracker's raw frames.
            masking: the session's masker, if it has one.
        """
        self._protocol = protocol
        self._trials = len(header.order)
        self._scene = scene.plan(protocol=protocol, task_id=header.task)
        self._devices = devices
        self._write = write
        self._foot = foot
        self._masking = masking
        self._keys = keys(protocol) | (KEYS if masking is not None else {})
        self._feed = Feed(devices.tracker)
        noise_mm = NOISE_MM if devices.noise_mm is None else devices.noise_mm
        self._watch = Watch(
            feed=self._feed,
            detector=GateDetector(protocol.step),
            predictor=LandingPredictor(protocol.step, noise_mm=noise_mm),
            clock=devices.clock,
            sounder=Sounder(devices.materials, devices.actuator) if devices.materials and devices.actuator else None,
        )
        self._opened: TrackerOpened | None = None
        self._broken: BrokenStep | None = None
        self._answered_ns: int | None = None
        self._outage = ""
        self._undelivered = 0

    def run(self, planned: PlannedTrial, attempt: int) -> Event:
        """One attempt.

        Args:
            planned: the trial.
            attempt: its number, from 1.

        Returns:
            `ANSWERED`, `REDONE`, `BROKEN_OFF`, `LOST` (the tracker stopped; see `outage`), or `PAUSE`.

        Raises:
            PalpateError: a part failed.
        """
        try:
            armed = Armed(planned, attempt, self._arm(planned, attempt))
        except TrackerStopped as stopped:
            # No step had begun: nothing is on file of it, and the same attempt is armed again.
            self._outage = str(stopped)
            return Event.LOST
        # Whatever goes wrong, the step is put on disk first: it may have been felt.
        with interrupts.held() as interrupt:
            seen = watch(self._watch, planned.presented, interrupt.let_through)
            parted = self._parted(seen)
            if parted is not None:
                seen = _by(parted.clock, seen)
            self._write(entry(armed, seen, self._keep(seen.raw)))
            if failed := (isinstance(seen, BrokenStep) and seen.failed) or (parted and parted.error):
                raise failed
        if isinstance(seen, BrokenStep):
            self._broken = seen
            self._outage = seen.reason if seen.stopped else ""
            return Event.LOST if seen.stopped else Event.BROKEN_OFF
        heard = seen.onset.delivered if seen.onset is not None else None
        if heard is not None:
            self._undelivered = 0 if heard.delivered else self._undelivered + 1
        if reason := self._repeat_reason(seen):
            self._write(Redo(trial=planned.trial, attempt=attempt, reason=reason, put_off=True))
            self._devices.console.show(f"Trial {planned.trial} comes again at the end of its block: {reason}.")
            return Event.REDONE
        return self._ask(planned, attempt, seen)

    @property
    def outage(self) -> str:
        """Why the last attempt was lost."""
        return self._outage

    @property
    def undelivered(self) -> int:
        """How many steps in a row, up to the last, had a stimulus that was not delivered."""
        return self._undelivered

    def reconnected(self) -> None:
        """The tracker is back: its device time may be another."""
        self._opened, self._broken, self._outage = None, None, ""

    def _arm(self, planned: PlannedTrial, attempt: int) -> float | None:
        """Have the trial stepped. After a step that broke off the foot is still watched, so that nothing is missed.

        Returns:
            The dead time since the answer just before, ms; None without one.

        Raises:
            TrackerStopped: it cannot be watched.
        """
        devices, broken, answered_ns = self._devices, self._broken, self._answered_ns
        self._broken = self._answered_ns = None
        if isinstance(devices.tracker, ZeroedTracker) and devices.tracker.due:
            self._zero(devices.tracker)
        if broken is not None and not broken.felt:
            devices.console.rearm(trial=planned.trial, attempt=attempt, reason=broken.reason)
            return None
        laid_ns = 0
        if self._scene.place:
            begun_ns = devices.clock.now_ns()
            devices.console.place(trial=planned.trial, material=planned.presented)
            laid_ns = devices.clock.now_ns() - begun_ns
        self._feed.drain()
        devices.console.arm(trial=planned.trial, attempt=attempt, trials=self._trials)
        return None if answered_ns is None else lasted_ms(devices.clock, answered_ns + laid_ns)

    def _zero(self, tracker: ZeroedTracker) -> None:
        zero = tracker.settle(self._devices.console)
        self._write(Zeroed(offset_mm=zero.offset_mm, spread_mm=zero.spread_mm, samples=zero.samples))
        self._devices.console.show(f"Zeroed: the foot rests at {zero.offset_mm:+.2f} mm from contact.")

    def _ask(self, planned: PlannedTrial, attempt: int, seen: WatchedStep) -> Event:
        devices, spoken = self._devices, self._protocol.answers
        key = devices.console.ask(trial=planned.trial, keys=self._keys)
        while self._masking is not None and self._masking.change(key):
            key = devices.console.ask(trial=planned.trial, keys=self._keys)
        if key in (spoken.pause_key, spoken.redo_key):
            pauses = key == spoken.pause_key
            reason = "paused before the answer" if pauses else "asked for by the experimenter"
            self._write(Redo(trial=planned.trial, attempt=attempt, reason=reason, put_off=False))
            return Event.PAUSE if pauses else Event.REDONE
        self._answered_ns = devices.clock.now_ns()
        answered = material_of(self._protocol, key)
        self._write(
            Answer(
                trial=planned.trial,
                attempt=attempt,
                presented=planned.presented,
                answered=answered,
                key=key,
                response_time_s=(self._answered_ns - seen.contact_ns) / 1e9,
            )
        )
        devices.console.confirmed(trial=planned.trial, answer=answered)
        return Event.ANSWERED

    def _parted(self, seen: WatchedStep | BrokenStep) -> _Parted | None:
        """Journal the tracker's first frame; returns whether its clock has parted from the session's since."""
        if seen.first_us is None or seen.clock is None:
            return None
        port, now_ns = self._devices.tracker_port, self._devices.clock.now_ns()
        at_us = (seen.at_us or 0) if isinstance(seen, BrokenStep) else int(seen.contact.us)
        if self._opened is None:
            first_ns = seen.clock.session_ns(seen.first_us)
            self._opened = TrackerOpened(port=port, device_us=seen.first_us, t_ns=first_ns)
            self._write(self._opened)
        # Where the foot is late on one clock and early on the other, the device restarted between two steps.
        passed_us = (now_ns - self._opened.t_ns) / 1e3
        ahead_us = at_us - self._opened.device_us - passed_us
        if abs(ahead_us) <= CLOCKS_PART_US + CLOCKS_DRIFT * abs(passed_us):
            return None
        error = TrackerError(
            f"tracker at {port}: its clock and the session's part by {ahead_us / 1e6:.1f} s; "
            "the device restarted, or does not count microseconds; see to it, then resume the session"
        )
        # The step was now, whatever its device says.
        return _Parted(ClockMap(at_us, now_ns), error)

    def _keep(self, raw: bytes) -> Trace:
        """Put raw frames on disk; says where they stand."""
        offset = self._foot.tell()
        self._foot.write(raw)
        self._foot.flush()
        os.fsync(self._foot.fileno())
        return Trace(offset=offset, length=len(raw), sha256=hashlib.sha256(raw).hexdigest())

    def _repeat_reason(self, seen: WatchedStep) -> str | None:
        """Why the protocol has this attempt done again, if it has."""
        heard = seen.onset.delivered if seen.onset is not None else None
        for rule in self._protocol.exclusion:
            if rule.action != "repeat-trial":
                continue
            limit = rule.limit or 0.0
            broken = {
                "frames-lost": seen.link.lost + seen.link.damaged > limit,
                "speed-below": seen.gate.speed_mm_s < limit,
                "speed-above": seen.gate.speed_mm_s > limit,
                "undelivered": heard is not None and not heard.delivered,
            }
            if broken.get(rule.when, False):
                return f"{rule.id}: {rule.reason}"
        return None


def _by(clock: ClockMap, seen: WatchedStep | BrokenStep) -> WatchedStep | BrokenStep:
    """The step by another clock."""
    if isinstance(seen, BrokenStep):
        return replace(seen, clock=clock)
    contact_ns = clock.session_ns(seen.contact.us)
    onset = seen.onset.model_copy(update={"contact_ns": contact_ns}) if seen.onset is not None else None
    return replace(seen, clock=clock, contact_ns=contact_ns, onset=onset)
