"""Zeroing: where the tracker sees a foot that rests on the panel, so that heights count from there.

A sole, a sock, or a sensor that sits otherwise on another foot moves every height by the same amount. What is taken
holds for one participant and one connection: a tracker that was plugged in again may have been moved, or may count from
elsewhere, and is zeroed again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.ports import Rester, Tracker
from experiment.apparatus.tracker.clock_map import ClockMap
from experiment.apparatus.tracker.frames import LinkCounts, Samples
from experiment.errors import TrackerError

REST_S = 0.5
"""How long the resting foot is read, s."""

STILL_MM = 0.5
"""Largest standard deviation of a foot at rest, mm: five times that of a noisy sensor (0.1 mm)."""


@dataclass(frozen=True)
class Zero:
    """What a foot at rest on the panel looked like.

    Attributes:
        offset_mm: its height above contact as the calibration has it, median, mm.
        spread_mm: standard deviation, mm.
        samples: how many it was made from.
    """

    offset_mm: float
    spread_mm: float
    samples: int

    def applied(self, samples: Samples) -> Samples:
        """Return the same samples with heights that count from where the foot rested."""
        return replace(samples, height_mm=samples.height_mm - self.offset_mm)


def zero(heights_mm: NDArray[np.float64], *, contact_mm: float, farthest_mm: float) -> Zero:
    """Return the offset of a foot at rest on the panel.

    Args:
        heights_mm: heights while it rested, mm, shape (n,).
        contact_mm: the protocol's height of contact, mm.
        farthest_mm: largest magnitude of the offset, mm.

    Raises:
        TrackerError: there are too few samples, the foot moved, or the offset is too large.
    """
    if heights_mm.size < 2:
        raise TrackerError(f"zeroing: got {heights_mm.size} samples; allowed: 2 or more; see to the tracker")
    spread_mm = float(np.std(heights_mm, ddof=1))
    if spread_mm > STILL_MM:
        raise TrackerError(
            f"zeroing: got heights that spread by {spread_mm:.2f} mm; allowed: at most {STILL_MM:g} mm; "
            "rest the foot on the panel without moving"
        )
    offset_mm = float(np.median(heights_mm)) - contact_mm
    if abs(offset_mm) > farthest_mm:
        raise TrackerError(
            f"zeroing: got an offset of {offset_mm:.2f} mm; allowed: at most {farthest_mm:g} mm either way "
            "(tracker.zeroing_mm); rest the foot on the bare panel; if it does, see to the sensor's place, then run "
            "palpate calibrate tracker"
        )
    return Zero(offset_mm, spread_mm, heights_mm.size)


def heights(tracker: Tracker, samples: int) -> NDArray[np.float64]:
    """Return the next heights from now on, mm, shape (samples,); `TrackerError` if the tracker failed."""
    tracker.drain()
    read = np.empty(0)
    while read.size < samples:
        read = np.concatenate([read, tracker.read().height_mm])
    return read[:samples]


class ZeroedTracker:
    """Implements `Tracker` on top of another one: heights count from where the foot rested, once it has."""

    def __init__(self, tracker: Tracker, *, contact_mm: float, farthest_mm: float, samples: int) -> None:
        """Take over an opened tracker, not zeroed yet: heights are as calibrated.

        A zeroing takes so many `samples` of a foot that rests at most `farthest_mm` from the protocol's `contact_mm`.
        """
        self._tracker = tracker
        self._contact_mm = contact_mm
        self._farthest_mm = farthest_mm
        self._samples = samples
        self._zero: Zero | None = None

    @property
    def zero(self) -> Zero | None:
        """Where the foot rested when heights began to count from there; None while they are as calibrated."""
        return self._zero

    @property
    def due(self) -> bool:
        """Whether it must still be zeroed, for the first time or since it came back."""
        return self._zero is None

    def settle(self, rester: Rester) -> Zero:
        """Return the zero of a resting foot; a foot that moved, or did not rest on the panel, is read again.

        `rester` has the foot rest, is told why the reading before gave no zero, and gives up by raising.

        Raises:
            TrackerError: the tracker failed.
        """
        why = ""
        while True:
            rester.rest(why=why)
            read_mm = heights(self._tracker, self._samples)
            try:
                self._zero = zero(read_mm, contact_mm=self._contact_mm, farthest_mm=self._farthest_mm)
            except TrackerError as refused:
                why = str(refused)
            else:
                return self._zero

    @property
    def counts(self) -> LinkCounts:
        return self._tracker.counts

    @property
    def clock_map(self) -> ClockMap | None:
        return self._tracker.clock_map

    def drain(self) -> None:
        self._tracker.drain()

    def read(self) -> Samples:
        samples = self._tracker.read()
        return samples if self._zero is None else self._zero.applied(samples)

    def reconnect(self, timeout_s: float) -> None:
        self._zero = None
        self._tracker.reconnect(timeout_s)

    def close(self) -> None:
        self._tracker.close()
