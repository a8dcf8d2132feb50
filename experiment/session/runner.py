"""Run one session: one participant doing one task, from familiarisation to the footer."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from experiment import scene as scenes
from experiment.apparatus import opening
from experiment.apparatus.gate import GateDetector
from experiment.apparatus.ports import Actuator, Console, Tracker
from experiment.clock import Clock
from experiment.errors import JournalError, PalpateError, TrackerError
from experiment.protocol.models import Protocol
from experiment.records import (
    Answer,
    Footer,
    FootStep,
    Header,
    Link,
    Phase,
    PlannedTrial,
    Redo,
    Resumed,
    Trace,
    TrackerOpened,
)
from experiment.session import answers, journal
from experiment.session.places import foot_path, journal_path, rig_path
from experiment.session.resume import Progress, progress, spent_ns
from experiment.session.states import Event, State, follow
from experiment.session.step import WatchedStep, watch

MOST_ATTEMPTS = 10
"""Attempts at one trial by one runner, so that a rule which no step satisfies cannot go on for ever."""

CLOCKS_PART_US = 10e6
"""Device and session time may part by this much: a slow step, and the drift of two crystals over a session."""


@dataclass(frozen=True)
class Devices:
    """The opened parts of a session; what its scene leaves out is None."""

    tracker: Tracker
    tracker_port: str
    actuator: Actuator | None
    render: scenes.Render | None
    console: Console
    clock: Clock


def run(*, protocol: Protocol, header: Header, devices: Devices, rig_file: Path, dataset: Path) -> Footer:
    """Run a session, or what remains of it.

    Args:
        protocol: the study.
        header: what this session is. Where a journal exists its own header rules, and must be of the same session.
        devices: the opened parts.
        rig_file: the rig's file, kept beside the journal.
        dataset: folder of the study's dataset.

    Returns:
        The footer that ended the session; that of a session which was already complete, without touching it.

    Raises:
        SessionLocked: another runner holds the participant.
        JournalError: the journal is broken, or belongs to another session.
        PalpateError: a part failed; the footer says so, and the session can be resumed.
    """
    path = journal_path(dataset, header.participant, header.task)
    with journal.locked(path.parent, header.participant):
        contents = journal.read_if_begun(path)
        if contents.lines:
            _check_same_session(path, contents.header, header)
            header = contents.header
        done = progress(contents.entries or (header,))
        if done.footer is not None and done.footer.reason == "complete":
            return done.footer
        if not contents.lines:
            opening.keep(rig_file, rig_path(path))
        foot = foot_path(path).open("ab")
        session = _Session(protocol, header, devices, journal.Journal(path, devices.clock, contents), foot)
        return session.run(contents, done)


def _check_same_session(path: Path, found: Header, asked: Header) -> None:
    identity = ("study", "protocol_sha256", "participant", "task", "seed", "rig_sha256", "recordings_sha256")
    for name in (*identity, "rehearsal", "order"):
        was, now = getattr(found, name), getattr(asked, name)
        if was != now:
            shown = "" if name == "order" else f" ({was} then, {now} now)"
            raise JournalError(
                f"{path}: the session was begun with another {name}{shown}; "
                "go on with what it was begun with, or write to another folder"
            )


class _Session:
    def __init__(
        self, protocol: Protocol, header: Header, devices: Devices, opened: journal.Journal, foot: BinaryIO
    ) -> None:
        self._protocol = protocol
        self._task = protocol.task(header.task)
        self._scene = scenes.plan(protocol=protocol, task_id=header.task)
        self._header = header
        self._devices = devices
        self._journal = opened
        self._foot = foot
        self._keys = answers.keys(protocol)
        self._detector = GateDetector(protocol.step)
        self._state = State.READY
        self._clock_map: TrackerOpened | None = None
        self._answered = 0

    def run(self, contents: journal.Contents, done: Progress) -> Footer:
        self._answered = len(done.answered)
        self._ends_ns = (
            self._devices.clock.now_ns() + int(self._protocol.exposure.session_min * 60e9) - spent_ns(contents)
        )
        try:
            self._begin(contents, done)
            for planned in done.remaining:
                pause = self._trial(planned, done.attempts.get(planned.trial, 0) + 1)
                if pause:
                    return self._end("paused", pause)
            self._follow(Event.EXHAUSTED)
            return self._end("complete")
        except PalpateError as error:
            self._follow(Event.FAIL)
            self._end("error", str(error))
            raise
        except KeyboardInterrupt:
            self._follow(Event.PAUSE)
            return self._end("paused", "interrupted at the keyboard")
        finally:
            self._foot.close()
            self._journal.close()

    def _trial(self, planned: PlannedTrial, first: int) -> str:
        """Attempts at one trial until one counts; returns why the session pauses, or nothing."""
        for attempt in range(first, first + MOST_ATTEMPTS):
            if self._devices.clock.now_ns() > self._ends_ns:
                self._follow(Event.PAUSE)
                return f"the protocol's {self._protocol.exposure.session_min:g} min of a session are over"
            event = self._attempt(planned, attempt)
            if event is not Event.REDONE:
                return "paused by the experimenter" if event is Event.PAUSE else ""
        self._follow(Event.PAUSE)
        return f"trial {planned.trial} was done again {MOST_ATTEMPTS} times; see to the rig, then go on"

    def _follow(self, event: Event) -> None:
        self._state = follow(self._state, event)

    def _end(self, reason: Literal["complete", "paused", "error"], detail: str = "") -> Footer:
        footer = Footer(reason=reason, detail=detail, answered=self._answered)
        # After an interrupt in the middle of a write only a new reading of the journal may add to it.
        if self._journal.accepts:
            self._journal.append(footer)
        return footer

    def _begin(self, contents: journal.Contents, done: Progress) -> None:
        if contents.lines:
            remaining = tuple(planned.trial for planned in done.remaining)
            torn = contents.torn.decode("utf-8", "backslashreplace")
            self._journal.append(Resumed(torn=torn, remaining=remaining))
            if torn:
                self._devices.console.show(f"A torn last line of the journal was dropped: {torn[:60]!r}")
            if done.unanswered is not None:
                trial, attempt = done.unanswered
                reason = "the session was interrupted before the answer"
                self._journal.append(Redo(trial=trial, attempt=attempt, reason=reason))
        else:
            self._journal.append(self._header)
        if done.attempts:
            self._follow(Event.RESUME)
        else:
            self._follow(Event.BEGIN)
            self._familiarise()
            self._follow(Event.FAMILIARISED)

    def _familiarise(self) -> None:
        wanted = self._task.familiarisation
        clock = self._devices.clock
        self._journal.append(Phase(state=self._state))
        begun_ns = clock.now_ns()
        left_s = wanted.min_s
        while True:
            self._devices.console.familiarise(instruction=wanted.instruction, min_s=left_s, max_s=wanted.max_s)
            left_s = wanted.min_s - (clock.now_ns() - begun_ns) / 1e9
            if left_s <= 0:
                break
        lasted_s = (clock.now_ns() - begun_ns) / 1e9
        self._journal.append(Phase(state="familiarised", detail=f"{lasted_s:.1f} s"))

    def _attempt(self, planned: PlannedTrial, attempt: int) -> Event:
        devices = self._devices
        if self._scene.place:
            devices.console.place(trial=planned.trial, material=planned.presented)
        devices.tracker.drain()
        devices.console.arm(trial=planned.trial, attempt=attempt, trials=len(self._header.order))
        seen = watch(
            tracker=devices.tracker,
            detector=self._detector,
            clock=devices.clock,
            material=planned.presented,
            render=devices.render,
            actuator=devices.actuator,
        )
        self._map_clock(seen)
        self._record_step(planned, attempt, seen)
        self._follow(Event.STEPPED)
        reason = self._repeat_reason(seen)
        key = None if reason else devices.console.ask(trial=planned.trial, keys=self._keys)
        if key == self._protocol.answers.pause_key:
            reason = "paused before the answer"
        elif key == self._protocol.answers.redo_key:
            reason = "asked for by the experimenter"
        if key is None or reason is not None:
            self._journal.append(Redo(trial=planned.trial, attempt=attempt, reason=reason or ""))
            event = Event.PAUSE if key == self._protocol.answers.pause_key else Event.REDONE
            self._follow(event)
            return event
        contact_ns = seen.first_t_ns + (seen.contact.us - seen.first_us) * 1e3
        answered = answers.material_of(self._protocol, key)
        self._journal.append(
            Answer(
                trial=planned.trial,
                attempt=attempt,
                presented=planned.presented,
                answered=answered,
                key=key,
                response_time_s=(devices.clock.now_ns() - contact_ns) / 1e9,
            )
        )
        self._answered += 1
        devices.console.confirmed(trial=planned.trial, answer=answered)
        self._follow(Event.ANSWERED)
        return Event.ANSWERED

    def _map_clock(self, seen: WatchedStep) -> None:
        if self._clock_map is None:
            self._clock_map = TrackerOpened(
                port=self._devices.tracker_port, device_us=seen.first_us, t_ns=seen.first_t_ns
            )
            self._journal.append(self._clock_map)
        # Where the foot is late on one clock and early on the other, the device restarted between two steps.
        passed_us = (self._devices.clock.now_ns() - self._clock_map.t_ns) / 1e3
        ahead_us = seen.contact.us - self._clock_map.device_us - passed_us
        if abs(ahead_us) > CLOCKS_PART_US:
            raise TrackerError(
                f"tracker at {self._devices.tracker_port}: its clock and the session's part by {ahead_us / 1e6:.1f} s; "
                "the device restarted, or does not count microseconds; see to it, then resume the session"
            )

    def _record_step(self, planned: PlannedTrial, attempt: int, seen: WatchedStep) -> None:
        offset = self._foot.tell()
        self._foot.write(seen.raw)
        self._foot.flush()
        os.fsync(self._foot.fileno())
        link = seen.link
        self._journal.append(
            FootStep(
                trial=planned.trial,
                attempt=attempt,
                presented=planned.presented,
                gate_top_us=seen.gate.top_us,
                gate_bottom_us=seen.gate.bottom_us,
                contact_us=seen.contact.us,
                speed_mm_s=seen.gate.speed_mm_s,
                link=Link(received=link.received, lost=link.lost, damaged=link.damaged, repeated=link.repeated),
                trace=Trace(offset=offset, length=len(seen.raw), sha256=hashlib.sha256(seen.raw).hexdigest()),
                stimulus=seen.stimulus,
            )
        )

    def _repeat_reason(self, seen: WatchedStep) -> str | None:
        """Why the protocol has this attempt done again, if it has."""
        for rule in self._protocol.exclusion:
            if rule.action != "repeat-trial" or rule.limit is None:
                continue
            broken = {
                "frames-lost": seen.link.lost + seen.link.damaged > rule.limit,
                "speed-below": seen.gate.speed_mm_s < rule.limit,
                "speed-above": seen.gate.speed_mm_s > rule.limit,
            }
            if broken.get(rule.when, False):
                return f"{rule.id}: {rule.reason}"
        return None
