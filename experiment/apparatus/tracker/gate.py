"""From foot heights to the gate's crossings, the foot's speed and its contact with the panel.

A crossing of a level is where the straight line between a sample above it and the next one at or below it meets the
level, in device time. Three of them matter:

- the last downward crossing of the gate's top before contact;
- the last downward crossing of its bottom after that;
- contact.

So the speed is that of the passage which leads to contact. A foot that goes back above the top starts anew. One that
hesitates or turns inside the gate is as slow as it was from top to bottom; one that comes back up through the bottom
gives a second `Gate`, which replaces the first. A foot that lands without having passed the whole gate gives nothing:
it must be lifted above the top again. Nothing is given after contact, bounces included, until the foot has done so.

A `Gate` is given when a sample lies `SETTLED_MM` below the bottom, so that noise cannot take it back.

Contact cannot be read off as a crossing: a foot at rest is near contact height, and noise decides when it crosses. It
is the root of a straight line, fitted by least squares to the samples between `NEAR_MM` and `FAR_MM` above contact in
the last `APPROACH_US` before a sample lies at `NEAR_MM` or lower; that sample gives the `Contact`, so its time may be a
few milliseconds ahead. Where frames are missing and fewer than three samples are left, the line runs from the bottom of
the gate to that sample. A foot that slows down lands later than the line says, by at most d^2 a / (7 v^3) with d =
FAR_MM, speed v and deceleration a at contact: 0.16 ms at 200 mm/s and 1000 mm/s^2. Noise of 0.1 mm rms at 1 kHz adds
up to 0.12 mm / v rms: 0.6 ms at 200 mm/s. Contact is never put more than `LATEST_US` after its sample.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.tracker.frames import Samples
from experiment.protocol.models import Step

SETTLED_MM = 1.0
"""Ten standard deviations of a noisy sensor (0.1 mm), so that no pair of samples spans it by chance, mm."""

NEAR_MM = 0.5
"""Height above contact below which the foot counts as landing, mm; a panel may rest that much too high."""

FAR_MM = 3.0
"""Height above contact from which the approach is taken for straight, mm."""

APPROACH_US = 40_000
"""How far back the approach is looked at, microseconds."""

LATEST_US = 20_000.0
"""Contact is at most this long after the sample that gave it, microseconds."""


@dataclass(frozen=True)
class Gate:
    """The foot crossed the gate's top and bottom; a later one replaces an earlier one. Device times, microseconds.

    The speed is the height of the gate divided by the time between; `given_us` is of the sample that gave it.
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


class GateState(NamedTuple):
    """The last samples, as far back as contact may need: device times, microseconds, and heights, mm.

    Beside them stand the last downward crossing of the gate's top, the last one of its bottom since, and the gate that
    was given last for this passage.
    """

    us: tuple[int, ...] = ()
    mm: tuple[float, ...] = ()
    top_us: float | None = None
    bottom_us: float | None = None
    given: Gate | None = None


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

    def step(self, state: GateState, samples: Samples) -> tuple[GateState, tuple[Gate | Contact, ...]]:
        """Return the state after the next samples, and what happened, in order, however samples are cut."""
        us, mm = state.us + tuple(samples.device_us.tolist()), state.mm + tuple(samples.height_mm.tolist())
        events: list[Gate | Contact] = []
        # A read while a foot falls holds few samples: Python's loop over them is faster than numpy's calls.
        for i in range(max(len(state.us), 1), len(us)):
            above_mm, below_mm = mm[i - 1], mm[i]
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
    ) -> tuple[GateState, Gate | Contact | None]:
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
            contact = Contact(self._contact_us(np.array(us), np.array(mm), i, state.given.bottom_us), us[i])
            return state._replace(top_us=None, bottom_us=None, given=None), contact
        return state, None

    def _crossing_us(self, us: tuple[int, ...], mm: tuple[float, ...], i: int, level: int) -> float:
        part = (mm[i - 1] - self._levels_mm[level]) / (mm[i - 1] - mm[i])
        return us[i - 1] + part * (us[i] - us[i - 1])

    def _contact_us(self, us: NDArray[np.int64], mm: NDArray[np.float64], i: int, bottom_us: float) -> float:
        contact_mm = self._step.contact_mm
        since = int(np.searchsorted(us, us[i] - APPROACH_US))
        far = np.nonzero(mm[since:i] > contact_mm + FAR_MM)[0]
        begin = since + int(far[-1]) + 1 if far.size else since
        near = slice(begin, i)
        t_us, h_mm = (us[near] - us[i]).astype(np.float64), mm[near] - contact_mm
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
