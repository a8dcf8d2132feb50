"""Zeroing: where the tracker sees a foot that rests on the panel, so that heights count from there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.ports import Tracker
from experiment.apparatus.samples import Samples
from experiment.errors import TrackerError

SAMPLES = 500
"""Samples of a zeroing: half a second at 1 kHz."""

STILL_MM = 0.5
"""Largest standard deviation of a foot at rest, mm: five times that of a noisy sensor (0.1 mm)."""

FARTHEST_MM = 3.0
"""Largest offset that is taken for a sole, a sock or a sensor that was touched, mm."""


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
        """The same samples with heights that count from where the foot rested."""
        return replace(samples, height_mm=samples.height_mm - self.offset_mm)


def zero(
    heights_mm: NDArray[np.float64],
    *,
    contact_mm: float,
    still_mm: float = STILL_MM,
    farthest_mm: float = FARTHEST_MM,
) -> Zero:
    """The offset of a foot at rest on the panel.

    Args:
        heights_mm: heights while it rested, mm, shape (n,).
        contact_mm: the protocol's height of contact, mm.
        still_mm: largest standard deviation, mm.
        farthest_mm: largest magnitude of the offset, mm.

    Raises:
        TrackerError: too few samples, a foot that moved, or an offset that is no zero.
    """
    if heights_mm.size < 2:
        raise TrackerError(f"zeroing: got {heights_mm.size} samples; allowed: 2 or more; see to the tracker")
    spread_mm = float(np.std(heights_mm, ddof=1))
    if spread_mm > still_mm:
        raise TrackerError(
            f"zeroing: got heights that spread by {spread_mm:.2f} mm; allowed: at most {still_mm:g} mm; "
            "rest the foot on the panel without moving, then zero again"
        )
    offset_mm = float(np.median(heights_mm)) - contact_mm
    if abs(offset_mm) > farthest_mm:
        raise TrackerError(
            f"zeroing: got an offset of {offset_mm:.2f} mm; allowed: at most {farthest_mm:g} mm either way; "
            "see that the foot rests on the panel and the sensor is in its place, then calibrate the tracker anew"
        )
    return Zero(offset_mm, spread_mm, heights_mm.size)


def heights(tracker: Tracker, samples: int = SAMPLES) -> NDArray[np.float64]:
    """The next heights, mm, shape (samples,), from now on.

    Args:
        tracker: the tracker.
        samples: how many.

    Raises:
        TrackerError: the tracker failed.
    """
    tracker.drain()
    read = np.empty(0)
    while read.size < samples:
        read = np.concatenate([read, tracker.read().height_mm])
    return read[:samples]
