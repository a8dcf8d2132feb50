"""One step of the foot, from arming to just after contact, and the stimulus it sets off.

When the foot crosses the gate's bottom, its stimulus is synthesised and prepared before the gate is given. While the
foot moves on, every sample is followed, and with each read the stimulus is aimed at the contact that the newest sample
with time left for it predicts. When the foot lands, a stimulus that could not be scheduled sounds at once. Contact goes
on record as the whole approach has it, with its standard error, and predictions and onsets are held against that. If
the foot stops, turns back or hesitates between gate and contact, the stimulus is withdrawn and the step ends. What one
attempt leaves over of the tracker's samples belongs to the next. A step whose tracker contradicts itself, or the
session's clock, breaks off once its tail is on file: it was felt, and does not count.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palpate.experiment.apparatus.host import undisturbed
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.tracker.clock_map import ClockMap, Pace
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector, Scrutiny, Sifted
from palpate.experiment.apparatus.tracker.landing import Falling, Landing, LandingPredictor
from palpate.experiment.clock import Clock
from palpate.experiment.desk.questions import INTERRUPTED
from palpate.experiment.errors import TrackerStopped, cause
from palpate.experiment.records.stimulus import Begun, Onset, Stimulus
from palpate.experiment.session.kind import Limits
from palpate.experiment.session.kinds.footstep.stimulus import Sounder, Sounding

if TYPE_CHECKING:
    from collections.abc import Callable


class Feed:
    """Reads a tracker; samples can be put back. `pace` checks its clock, None in simulated time."""

    def __init__(self, tracker: Tracker, *, simulated_time: bool) -> None:
        self.tracker = tracker
        self.pace = None if simulated_time else Pace()
        self.newest: deque[tuple[int, float]] = deque(maxlen=RECENT)
        """Device time, microseconds, and height, mm, at the end of each of the last reads."""
        self.counts = LinkCounts()
        """The tracker's counts as they were taken last: a driver is asked by one thread alone."""
        self._left: Samples | None = None

    def count(self) -> LinkCounts:
        """Return the tracker's counts as they are now. Raises `TrackerError`."""
        self.counts = self.tracker.counts
        return self.counts

    def begin_anew(self) -> None:
        """Forget how the tracker's clock went: it is another, or not to be believed."""
        self.pace = None if self.pace is None else Pace()

    def drain(self) -> None:
        """Forget what was left over, and throw away what arrived before now. Raises `TrackerStopped`."""
        self._left = None
        self.tracker.drain()

    def read(self) -> Samples:
        """Return what was put back, or the tracker's next samples, at least one. Raises `TrackerError`."""
        left, self._left = self._left, None
        if left is not None:
            return left
        samples = self.tracker.read()
        self.newest.append((int(samples.device_us[-1]), float(samples.height_mm[-1])))
        if self.pace is not None:
            self.pace.read(int(samples.device_us[-1]), samples.arrived_ns)
        return samples

    def put_back(self, samples: Samples) -> None:
        """Have the next `read` begin with these samples, if there are any."""
        self._left = samples if samples.device_us.size else None


class Taken:
    """The samples of one attempt, read by read, with counts, clock and bytes, since a tracker may fail at them too."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._before = self._counts = feed.count()
        self._raw = bytearray()
        self._received = 0
        self._newest: Samples | None = None
        self._filed_us = np.empty(0, np.int64)
        self.first_us: int | None = None
        """Device time of the first sample; None before it came."""
        self.newest_us: int | None = None
        """Device time of the newest sample; None before the first."""
        self.clock_map: ClockMap | None = None
        """Session time of device time, as the tracker's clock stood at the newest read; None before the first."""

    def next(self) -> Samples:
        """Return the next samples. Raises `TrackerError`."""
        self._file()
        samples = self._feed.read()
        if self.first_us is None:
            self.first_us = int(samples.device_us[0])
        self._newest, self.newest_us = samples, int(samples.device_us[-1])
        self.clock_map, self._counts = self._feed.tracker.clock_map or self.clock_map, self._feed.count()
        return samples

    def clock(self) -> ClockMap:
        """Return `clock_map`. Raises `TrackerStopped` if there is none."""
        if self.clock_map is None:
            raise TrackerStopped("tracker", "sent no sample since it was opened", "check that the device is sampling")
        return self.clock_map

    def session_ns(self, device_us: float) -> int:
        """Return the session time of a device time, ns. Raises `TrackerStopped` if the clock is not known."""
        return self.clock().session_ns(device_us)

    def wait_until(self, device_us: float) -> None:
        """Wait for the first sample at this time or later; the rest is the next attempt's. Raises `TrackerError`."""
        samples = self._newest if self._newest is not None else self.next()
        while samples.device_us[-1] < device_us:
            samples = self.next()
        self._newest, rest = samples.cut(int(np.searchsorted(samples.device_us, device_us)) + 1)
        self.newest_us = int(self._newest.device_us[-1])
        self._feed.put_back(rest)

    def link(self, device_us: float) -> LinkCounts:
        """Return the frames counted until the newest read, received ones up to a time in it or in the one before."""
        newest = 0 if self._newest is None else int(np.searchsorted(self._newest.device_us, device_us, side="right"))
        later = self._filed_us.size - int(np.searchsorted(self._filed_us, device_us, side="right"))
        return self._counts.since(self._before)._replace(received=self._received - later + newest)

    def raw(self) -> bytes:
        """Return every byte taken."""
        self._file()
        return bytes(self._raw)

    def _file(self) -> None:
        if self._newest is not None:
            self._raw += self._newest.raw
            self._received += self._newest.device_us.size
            self._filed_us, self._newest = self._newest.device_us, None


AHEAD_NS = 5_000_000
"""From samples to the actuator takes less, ns."""

TAIL_US = 100_000
"""How long the foot is recorded after contact, so that the landing is on file."""

TAILS = 5
"""Most further tails while the tracker's clock seems behind: delayed reads, by half a second or less, clear it."""

PATH = 4096
"""Reads that are kept of a falling foot: 6 s or more."""

RECENT = 4096
"""Reads whose ends are kept for the desk: 3 s or more."""


@dataclass(frozen=True)
class Watch:
    """What steps are watched with, and how long; `sounder` is None in a task without synthesis."""

    feed: Feed
    scrutiny: Scrutiny
    detector: GateDetector
    predictor: LandingPredictor
    clock: Clock
    limits: Limits
    sounder: Sounder | None
    tail_us: int = TAIL_US


@dataclass(frozen=True)
class WatchedStep:
    """A step that ended in a contact, as it is known afterwards.

    `first_us` is the device time of the first sample after arming, and `clock` the tracker's as it was known at the end
    of the tail, by which `contact_ns` is the session time of the contact. `raw` is every byte of the tracker from
    arming to the end of the tail; `link` counts frames from arming to contact. `stimulus` (what was handed to the
    actuator) and `onset` (how it met the contact) are None in a task without synthesis.
    """

    first_us: int
    clock: ClockMap
    gate: Gate
    contact: Landing
    contact_ns: int
    raw: bytes
    link: LinkCounts
    stimulus: Stimulus | None
    onset: Onset | None


@dataclass(frozen=True)
class BrokenStep:
    """A step that ended before the foot had landed, or before its landing was on file.

    `first_us` and `at_us` are the device times of the first and the newest sample, and `clock` is the tracker's as it
    was known in the end; all are None if no sample came. `gate` is the passage through the gate, if there was one.
    `reason` says why the step ended, and `felt` whether something may have been felt. `stopped` is the tracker's
    silence, if that ended it; `failed` is what else ended it once something may have been felt, to be raised when the
    step is on file. `raw` and `link` reach to that moment. `stimulus` and `begun` are of a scheduled one that played.
    """

    first_us: int | None
    clock: ClockMap | None
    at_us: int | None
    gate: Gate | None
    reason: str
    felt: bool
    stopped: TrackerStopped | None
    failed: BaseException | None
    raw: bytes
    link: LinkCounts
    stimulus: Stimulus | None = None
    begun: Begun | None = None


def watch(
    parts: Watch, material: str, waiting: Callable[[], AbstractContextManager[None]] = nullcontext
) -> WatchedStep | BrokenStep:
    """Wait for a step, and have the stimulus of `material` sound when the foot lands.

    `waiting` is entered while the foot has not landed. Any failure or interrupt is raised only while nothing can have
    been felt; after that it comes with the broken step, so that the step is not lost.
    """
    step = _Step(parts, material)
    try:
        with undisturbed():
            with waiting():
                reason = step.fall()
            return step.broken(reason) if reason else step.land()
    except TrackerStopped as stopped:
        return step.broken(stopped.sentence(), stopped=stopped)
    except BaseException as failed:
        # Nothing may sound once nobody watches.
        why = INTERRUPTED if isinstance(failed, KeyboardInterrupt) else cause(failed)
        broken = step.broken(why, failed=failed)
        if broken.felt:
            return broken
        raise


class _Step:
    def __init__(self, parts: Watch, material: str) -> None:
        self._parts = parts
        self._taken = Taken(parts.feed)
        self._gate: Gate | None = None
        self._contact: Contact | None = None
        self._falling: Falling | None = None
        self._sifted = Sifted()
        self._path: deque[Samples] = deque(maxlen=PATH)
        self._still: tuple[float, int] | None = None
        self._withdrawn: bool | None = None
        self._sounding: Sounding | None = None
        if parts.sounder is not None:
            self._sounding = Sounding(parts.sounder, material, self._taken.session_ns, parts.clock)

    def fall(self) -> str:
        """Follow the foot to its contact; return why it will not land, or nothing."""
        detector, predictor, sounding = self._parts.detector, self._parts.predictor, self._sounding
        state, falling = detector.init(), predictor.init()
        ahead_ns = AHEAD_NS + (self._parts.sounder.actuator.lead_ns if self._parts.sounder is not None else 0)
        while True:
            samples = self._next()
            # What is asked for from here on can be taken back until its lead before it sounds.
            if reason := self._parts.limits.end_reason(ahead_ns):
                return reason
            if reason := detector.stuck(*self._same_for(samples)):
                return reason
            over = detector.passes_over(state, samples) if self._gate is None else 0
            state, events = detector.step(state, samples)
            upcoming = deque(events)
            followed: list[Falling] = []
            if over:
                # What a loop over them would leave behind.
                self._falling = falling = predictor.init()
            for us, mm in zip(samples.device_us[over:].tolist(), samples.height_mm[over:].tolist(), strict=True):
                if state.landing is not None and us == state.landing.given_us:
                    # The next sample tells whether this is contact.
                    break
                self._falling, falling = falling, predictor.step(falling, us, mm)
                while upcoming and upcoming[0].given_us <= us and self._contact is None:
                    self._passed(upcoming.popleft(), samples.arrived_ns)
                if self._gate is None:
                    continue
                if self._contact is not None:
                    break
                if reason := predictor.hesitates(falling, self._gate):
                    return self._blamed(us, self._gate) or reason
                if falling is not None:
                    followed.append(falling)
            if sounding is not None:
                # The newest prediction that still comes in time counts.
                landings = (predictor.landing(one) for one in reversed(followed))
                aim_at = next((one for one in landings if one is not None and sounding.in_time(one)), None)
                # A read that comes late could not take back what may no longer be felt.
                if aim_at is not None and self._taken.session_ns(aim_at.us) <= self._parts.limits.ends_ns:
                    sounding.aim(aim_at)
            if self._contact is not None:
                return ""
            if self._gate is None and sounding is not None:
                # A millimetre before the gate is given its speed is known.
                speed_mm_s = detector.speed_mm_s(state)
                if speed_mm_s is not None:
                    sounding.prepare(speed_mm_s)

    def _next(self) -> Samples:
        """Return the next samples that are believed, none perhaps. Raises `TrackerError`."""
        self._sifted, samples = self._parts.scrutiny.sift(self._sifted, self._taken.next())
        self._path.append(samples)
        return samples

    def _same_for(self, samples: Samples) -> tuple[float, int]:
        """Return the newest height, mm, and for how long it is the same, microseconds."""
        us, mm = samples.device_us, samples.height_mm
        if us.size and (self._still is None or (mm != self._still[0]).any()):
            self._still = float(mm[-1]), int(us[-1])
        height_mm, since_us = self._still or (math.inf, 0)
        return height_mm, (self._taken.newest_us or 0) - since_us

    def _blamed(self, us: int, gate: Gate) -> str:
        """Return why it is the tracker, and not the foot, that seems to hesitate at `us`; empty if it is the foot."""
        if self._sounding is not None and self._sounding.plays_on:
            self._withdrawn = False
        self.withdraw()
        settled_us = self._parts.scrutiny.settled_us(us)
        while (self._taken.newest_us or 0) < settled_us:
            self._next()
        self._taken.wait_until(settled_us)
        return self._fault(gate, us, self._taken.link(settled_us))

    def _fault(self, gate: Gate, until_us: int, link: LinkCounts) -> str:
        missing = link.lost + link.damaged + self._sifted.dropped
        return self._parts.scrutiny.fault(self._path, gate, until_us, missing)

    def land(self) -> WatchedStep | BrokenStep:
        """Have the stimulus sound, and record the tail; a step whose tracker cannot be believed is broken off."""
        gate, contact, taken = self._gate, self._contact, self._taken
        if gate is None or contact is None or taken.first_us is None:
            raise RuntimeError("no step lands before it has fallen")
        if reason := self._parts.limits.end_reason():
            return self.broken(reason)
        if self._sounding is not None:
            self._sounding.landed(contact)
        met = self._met(contact)
        # Contact may lie ahead of the newest sample that is believed.
        while (taken.newest_us or 0) < met.us:
            self._next()
        link = taken.link(met.us)
        taken.wait_until(met.us + self._parts.tail_us)
        if fault := self._fault(gate, contact.given_us, link) or self._parted(gate, contact):
            return self.broken(fault)
        clock = taken.clock()
        contact_ns = clock.session_ns(met.us)
        onset = self._sounding.onset(met, contact_ns) if self._sounding is not None else None
        heard = onset.delivered if onset is not None else None
        if heard is not None and not heard.delivered and (reason := self._parts.limits.end_reason()):
            return self.broken(reason)
        return WatchedStep(
            first_us=taken.first_us,
            clock=clock,
            gate=gate,
            contact=met,
            contact_ns=contact_ns,
            raw=taken.raw(),
            link=link,
            stimulus=self._sounding.stimulus if self._sounding is not None else None,
            onset=onset,
        )

    def _met(self, contact: Contact) -> Landing:
        """Return when the foot met the panel, as the samples until then have it. Raises `TrackerError`."""
        predictor = self._parts.predictor
        touch = predictor.touching(self._falling, contact)
        reads = [read for read in self._path if read.device_us.size and read.device_us[-1] >= contact.given_us]
        while True:
            for read in reads:
                since = int(np.searchsorted(read.device_us, contact.given_us))
                for us, mm in zip(read.device_us[since:].tolist(), read.height_mm[since:].tolist(), strict=True):
                    touch = predictor.touch(touch, us, mm, contact)
                    if touch.done:
                        return touch.landing
            reads = [self._next()]

    def _parted(self, gate: Gate, contact: Contact) -> str:
        """Return why the tracker's clock cannot be believed; empty if it kept pace with the session's."""
        feed, taken = self._parts.feed, self._taken
        if feed.pace is None:
            return ""
        ahead_ms = feed.pace.ahead_ms(gate.top_us, contact.given_us)
        tails = 0
        while not feed.pace.known or (ahead_ms < 0 and tails < TAILS):
            taken.wait_until((taken.newest_us or 0) + TAIL_US)
            tails += 1
            ahead_ms = feed.pace.ahead_ms(gate.top_us, contact.given_us)
        if not ahead_ms:
            return ""
        feed.begin_anew()
        return (
            f"the tracker's clock {'ran ahead of' if ahead_ms > 0 else 'fell behind'} the session's by "
            f"{abs(ahead_ms):.0f} ms, too much for clock drift; ask its builder to check the unit of its counter"
        )

    def withdraw(self) -> bool:
        """Take the stimulus back, once; return whether nothing of it sounds."""
        if self._withdrawn is None:
            self._withdrawn = self._sounding is None or self._sounding.withdraw()
        return self._withdrawn

    def broken(
        self, reason: str, *, stopped: TrackerStopped | None = None, failed: BaseException | None = None
    ) -> BrokenStep:
        """Return the step without a contact, or without the rest of its record."""
        withdrawn, taken = self.withdraw(), self._taken
        begun = self._sounding.begun if self._sounding is not None and not withdrawn else None
        return BrokenStep(
            first_us=taken.first_us,
            clock=taken.clock_map,
            at_us=taken.newest_us,
            gate=self._gate,
            reason=reason,
            felt=self._contact is not None or not withdrawn,
            stopped=stopped,
            failed=failed,
            raw=taken.raw(),
            link=taken.link(taken.newest_us or 0),
            stimulus=self._sounding.stimulus if self._sounding is not None and begun is not None else None,
            begun=begun,
        )

    def _passed(self, event: Gate | Contact, arrived_ns: int) -> None:
        if isinstance(event, Contact):
            self._contact = event
            return
        self._gate = event
        if self._sounding is not None:
            self._sounding.prepare_for_gate(event.speed_mm_s, arrived_ns)
