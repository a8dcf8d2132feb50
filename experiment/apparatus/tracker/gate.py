"""From foot heights to the gate's crossings, the foot's speed and its contact with the panel.

A crossing is where the straight line from a sample above a level to the next one at or below it meets the level, in
device time. Those that count are the last downward crossing of the gate's top before contact, the last one of its
bottom after that, and contact, so the speed is that of the passage to contact. A foot that goes back above the top
starts anew; one that comes back up through the bottom gives a second `Gate`, which replaces the first. Without a whole
passage, and after contact, nothing is given until the foot was above the top again.

A `Gate` is given when a sample lies `SETTLED_MM` below the bottom, so that noise cannot undo it. A `Contact` shows at
the first sample at `NEAR_MM` or lower, and is given once the next one, at twice `NEAR_MM` or lower, confirms it.

A tracker may be wrong: `Scrutiny` drops a lone reading that no foot could reach, and counts a passage only if heights
and times agree with a foot, the rig's rate and the missing frames.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.protocol.models import Step

SETTLED_MM = 1.0
"""Ten standard deviations of a noisy sensor (0.1 mm), so that no pair of samples spans it by chance, mm."""

NEAR_MM = 0.5
"""Height above contact below which the foot counts as landing, mm; a panel may rest that much too high."""

FAR_MM = 3.0
"""Height above contact from which the approach is taken for straight, mm."""

APPROACH_US = 40_000
"""How far back the approach is looked at, microseconds."""

LATEST_US = 20_000.0
"""Contact is at most this long after the first sample at `NEAR_MM` or lower, microseconds."""

FASTEST_MM_S = 1000.0
"""A reading further from the one before than a foot gets at this speed, mm/s, waits until the next one agrees."""

JUMP_MM = 0.2
"""A jump of heights by less moves the speed through a gate of 10 mm by less than 2 %, mm; ours."""

NOISE_TIMES = 10.0
"""Nor is a jump seen that is below so many standard deviations of the sensor: six of what `Scrutiny` looks at."""

SIDE = 4
"""Samples on either side of a pair, from which its speed is expected."""

HOLE_US = 10_000
"""Longest stretch without a sample in which a crossing may lie, microseconds: at 400 mm/s it bends by < 0.1 mm."""

STUCK_US = 500_000
"""A sensor that gives one height inside the gate for so long is stuck, microseconds: a leg trembles."""

RATE_PART = 0.015
"""Part of the rig's rate by which a passage's samples may differ: doctor's and a resonator's 1 %, and below 2 %."""


@dataclass(frozen=True)
class Gate:
    """The foot crossed the gate's top and bottom, device times, microseconds; a later one replaces an earlier one.

    The speed is the mean between; `given_us` is of the sample that gave it.
    """

    top_us: float
    bottom_us: float
    speed_mm_s: float
    given_us: int = field(compare=False)


@dataclass(frozen=True)
class Contact:
    """The foot met the panel at `us`, after the last `Gate` given, as the sample of `given_us` showed; microseconds."""

    us: float
    given_us: int = field(compare=False)


class Sifted(NamedTuple):
    """The last believed reading, the one that waits (device time, us; mm), if any, and how many were dropped."""

    believed: tuple[int, float] | None = None
    held: tuple[int, float] | None = None
    dropped: int = 0


MANY = 32
"""From so many readings on, as a rehearsal has them, they are compared all at once."""


class Scrutiny:
    """What is held against a tracker's readings: a foot's speed, the sensor's noise, and the rate of the frames."""

    def __init__(self, *, rate_hz: int, noise_mm: float, resolution_mm: float = 0.0) -> None:
        """Take what the rig file states: frames a second, noise of the sensor, mm rms, and one count of it, mm."""
        self._period_us = 1e6 / rate_hz
        self._rate_hz = rate_hz
        self._noise_mm = NOISE_TIMES * noise_mm + 1.25 * resolution_mm
        self._apart_mm = max(self._noise_mm, JUMP_MM)

    def sift(self, state: Sifted, samples: Samples) -> tuple[Sifted, Samples]:
        """Return the state after the next samples, and those that are believed by now, however samples are cut.

        A reading that lies further off than a foot could get waits: two that agree are believed, one alone is dropped.
        """
        believed, held, dropped = state
        if held is None and samples.device_us.size >= MANY and self._all_reachable(believed, samples):
            return Sifted((int(samples.device_us[-1]), float(samples.height_mm[-1])), None, dropped), samples
        passed: list[tuple[int, float]] = []
        for read in zip(samples.device_us.tolist(), samples.height_mm.tolist(), strict=True):
            if held is None and (believed is None or not self._reachable(believed, read)):
                held = read
                continue
            if held is not None:
                if self._reachable(held, read):
                    passed.append(held)
                else:
                    dropped += 1
                    if believed is None or not self._reachable(believed, read):
                        held = read
                        continue
                held = None
            passed.append(read)
            believed = read
        after = Sifted(believed, held, dropped)
        if state.held is None and held is None and dropped == state.dropped:
            return after, samples
        us, mm = [read[0] for read in passed], [read[1] for read in passed]
        return after, replace(samples, device_us=np.array(us, np.int64), height_mm=np.array(mm, np.float64))

    def settled_us(self, us: int) -> int:
        """Return the device time until which samples are needed so that a jump at `us` shows, microseconds."""
        return us + math.ceil((SIDE + 1) * self._period_us)

    def fault(self, path: Sequence[Samples], gate: Gate, until_us: int, missing: int) -> str:
        """Return why the passage cannot be counted; empty if nothing speaks against it.

        `path` are the believed samples, read by read, from above the gate until at least `until_us`, when the foot
        landed or hesitated; `missing` counts the frames that are known to be missing.
        """
        reads: list[Samples] = []
        for read in reversed(path):
            reads.insert(0, read)
            if read.device_us.size and read.device_us[0] < gate.top_us - 2 * SIDE * self._period_us:
                break
        us = np.concatenate([read.device_us for read in reads])
        mm = np.concatenate([read.height_mm for read in reads])
        top = max(int(np.searchsorted(us, gate.top_us)) - 1, 0)
        bottom = int(np.searchsorted(us, gate.bottom_us))
        apart_us = np.diff(us)
        fell_us = apart_us[top : int(np.searchsorted(us, until_us))]
        periods = np.rint(fell_us / self._period_us).sum()
        off = 1 - periods * self._period_us / fell_us.sum()
        if abs(off) > RATE_PART:
            return (
                f"the tracker's times are {fell_us.mean():.0f} us apart, but at {self._rate_hz} frames per second they "
                f"should be {self._period_us:.0f} us apart; correct rate_hz, or have the device's clock repaired"
            )
        if periods - fell_us.size > missing:
            frames = f"{periods - fell_us.size:.0f} frames, but only {missing} are missing"
            return f"the tracker's times have gaps for {frames}; restart it, or have its clock repaired"
        longest_us = max(apart_us[top], apart_us[bottom - 1])
        if longest_us > HOLE_US:
            return f"no reading for {longest_us / 1e3:.0f} ms while the foot crossed the gate; use a shorter cable"
        jumps_mm = self._jumps_mm(us, mm, np.arange(max(top, 1), min(bottom, us.size - 2)))
        if jumps_mm.max(initial=0.0) > 0:
            worst = max(top, 1) + int(np.argmax(jumps_mm))
            jump = f"from {mm[worst]:.1f} to {mm[worst + 1]:.1f} mm"
            return f"the tracker's heights jump {jump} inside the gate, which no foot can do; fasten the sensor"
        return ""

    def _reachable(self, one: tuple[int, float], other: tuple[int, float]) -> bool:
        return abs(other[1] - one[1]) <= (other[0] - one[0]) * FASTEST_MM_S / 1e6 + self._apart_mm

    def _all_reachable(self, believed: tuple[int, float] | None, samples: Samples) -> bool:
        """Return whether each reading can be reached from the one before, and the first from what was believed last."""
        us, mm = samples.device_us, samples.height_mm
        begins = believed is None or self._reachable(believed, (int(us[0]), float(mm[0])))
        allowed_mm = (us[1:] - us[:-1]) * FASTEST_MM_S / 1e6 + self._apart_mm
        return begins and bool((np.abs(mm[1:] - mm[:-1]) <= allowed_mm).all())

    def _jumps_mm(self, us: NDArray[np.int64], mm: NDArray[np.float64], at: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return by how much more than allowed the sample after each of `at` is off its neighbors' speed."""
        before, after = np.maximum(at - SIDE, 0), np.minimum(at + 1 + SIDE, us.size - 1)
        apart_us = us[at + 1] - us[at]
        slopes = (mm[at] - mm[before]) / (us[at] - us[before]) + (mm[after] - mm[at + 1]) / (us[after] - us[at + 1])
        # Noise of the neighbours' speed counts for more, the longer the pair is apart.
        weight = apart_us / (2 * SIDE * self._period_us)
        noise_mm = self._noise_mm * np.hypot(weight, 1 + weight) / math.hypot(1 / 8, 9 / 8)
        off_mm: NDArray[np.float64] = np.abs(mm[at + 1] - mm[at] - apart_us * slopes / 2)
        return off_mm - np.maximum(JUMP_MM, noise_mm)


class GateState(NamedTuple):
    """The last samples (device times, microseconds; heights, mm), as far back as contact may need, and what was found.

    That is the last downward crossings of top and, since, bottom, the passage's last gate, and an unconfirmed contact.
    """

    us: tuple[int, ...] = ()
    mm: tuple[float, ...] = ()
    top_us: float | None = None
    bottom_us: float | None = None
    given: Gate | None = None
    landing: Contact | None = None


class GateDetector:
    """Follows a foot through a protocol's gate to contact; immutable, all memory is in the state."""

    def __init__(self, step: Step) -> None:
        self._step = step
        self._levels_mm = (
            step.gate_top_mm,
            step.gate_bottom_mm,
            step.gate_bottom_mm - min(SETTLED_MM, (step.gate_bottom_mm - step.contact_mm) / 2),
            step.contact_mm + min(NEAR_MM, (step.gate_bottom_mm - step.contact_mm) / 4),
        )

    def init(self) -> GateState:
        """Return the state before the first sample."""
        return GateState()

    def speed_mm_s(self, state: GateState) -> float | None:
        """Return the speed of a passage whose end has been seen; a `Gate` with it follows if the foot falls on."""
        if state.top_us is None or state.bottom_us is None:
            return None
        height_mm = self._step.gate_top_mm - self._step.gate_bottom_mm
        return height_mm * 1e6 / (state.bottom_us - state.top_us)

    def stuck(self, mm: float, lasts_us: int) -> str:
        """Return why a foot that gives this height, mm, for so long, microseconds, is none; empty if it may be one."""
        top_mm, bottom_mm = self._levels_mm[:2]
        if lasts_us < STUCK_US or not bottom_mm <= mm <= top_mm:
            return ""
        return f"the tracker's height stays at {mm:.2f} mm inside the gate, which no foot can do; restart the sensor"

    def passes_over(self, state: GateState, samples: Samples) -> int:
        """Return in how many of the next samples, the first of many at once, nothing can happen: all above the gate."""
        if samples.height_mm.size < MANY or state.landing is not None:
            return 0
        within = np.flatnonzero(samples.height_mm <= self._levels_mm[0])
        return int(within[0]) if within.size else samples.height_mm.size

    def step(self, state: GateState, samples: Samples) -> tuple[GateState, tuple[Gate | Contact, ...]]:
        """Return the state after the next samples, and what happened, in order, however samples are cut."""
        us, mm = state.us + tuple(samples.device_us.tolist()), state.mm + tuple(samples.height_mm.tolist())
        events: list[Gate | Contact] = []
        # A read while a foot falls holds few samples: Python's loop over them is faster than numpy's calls.
        for i in range(max(len(state.us) + self.passes_over(state, samples), 1), len(us)):
            above_mm, below_mm = mm[i - 1], mm[i]
            if state.landing is not None:
                if below_mm - self._step.contact_mm <= 2 * (self._levels_mm[3] - self._step.contact_mm):
                    events.append(state.landing)
                    state = state._replace(top_us=None, bottom_us=None, given=None)
                state = state._replace(landing=None)
            if below_mm >= above_mm:
                continue
            for level, level_mm in enumerate(self._levels_mm):
                if above_mm > level_mm >= below_mm:
                    state, event = self._crossed(state, us, mm, i, level)
                    if event is not None:
                        events.append(event)
        keep = bisect_left(us, us[-1] - APPROACH_US) if us else 0
        return state._replace(us=us[keep:], mm=mm[keep:]), tuple(events)

    def _crossed(
        self, state: GateState, us: tuple[int, ...], mm: tuple[float, ...], i: int, level: int
    ) -> tuple[GateState, Gate | None]:
        """Sample `i` is the first at or below one of the levels."""
        if level == 0:
            return state._replace(top_us=self._crossing_us(us, mm, i, level), bottom_us=None), None
        if state.top_us is None:
            return state, None
        if level == 1:
            return state._replace(bottom_us=self._crossing_us(us, mm, i, level)), None
        speed_mm_s = self.speed_mm_s(state)
        if level == 2 and speed_mm_s is not None and state.bottom_us is not None:
            gate = Gate(state.top_us, state.bottom_us, speed_mm_s, us[i])
            return state._replace(given=gate), gate if gate != state.given else None
        if level == 3 and state.given is not None:
            contact = Contact(self._contact_us(us, mm, i, state.given.bottom_us), us[i])
            return state._replace(landing=contact), None
        return state, None

    def _crossing_us(self, us: tuple[int, ...], mm: tuple[float, ...], i: int, level: int) -> float:
        part = (mm[i - 1] - self._levels_mm[level]) / (mm[i - 1] - mm[i])
        return us[i - 1] + part * (us[i] - us[i - 1])

    def _contact_us(self, us: tuple[int, ...], mm: tuple[float, ...], i: int, bottom_us: float) -> float:
        contact_mm, begin = self._step.contact_mm, i
        while begin and us[begin - 1] >= us[i] - APPROACH_US and mm[begin - 1] <= contact_mm + FAR_MM:
            begin -= 1
        t_us, h_mm = np.array(us[begin:i], np.float64) - us[i], np.array(mm[begin:i]) - contact_mm
        straight = h_mm > self._levels_mm[3] - contact_mm
        t_us, h_mm = t_us[straight], h_mm[straight]
        if t_us.size >= 3:
            slope, height_mm = np.polyfit(t_us, h_mm, 1)
            root_us = -height_mm / slope if slope < 0 else np.inf
        else:
            left_mm = mm[i] - contact_mm
            root_us = (us[i] - bottom_us) * left_mm / (self._step.gate_bottom_mm - contact_mm - left_mm)
        latest_us = LATEST_US if mm[i] > contact_mm else 0.0
        return float(us[i] + np.clip(root_us, us[i - 1] - us[i], latest_us))
