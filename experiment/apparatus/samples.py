"""What a tracker gives: samples of the foot's position, and counts of the link they came by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Samples:
    """A run of foot positions, in the order the device sent them.

    Attributes:
        device_us: device time of each sample, microseconds, int64, shape (n,), strictly rising.
        height_mm: height of the sole above the panel, mm, float64, shape (n,).
        raw: the bytes taken from the line since the samples before, damaged frames included. Joined in order
            they decode to the same samples; a frame may be torn between two of them. A device that sends anything but
            the frames of frames.py has its driver encode them, for a session keeps its traces so.
        ends: where in `raw` each sample's frame ends, int64, shape (n,).
        arrived_ns: session time at which the last of them came, ns.
    """

    device_us: NDArray[np.int64]
    height_mm: NDArray[np.float64]
    raw: bytes
    ends: NDArray[np.int64]
    arrived_ns: int

    def cut(self, count: int) -> tuple[Samples, Samples]:
        """The first `count` of them, and the others."""
        end = int(self.ends[count - 1]) if count else 0
        return (
            replace(
                self,
                device_us=self.device_us[:count],
                height_mm=self.height_mm[:count],
                raw=self.raw[:end],
                ends=self.ends[:count],
            ),
            replace(
                self,
                device_us=self.device_us[count:],
                height_mm=self.height_mm[count:],
                raw=self.raw[end:],
                ends=self.ends[count:] - end,
            ),
        )


@dataclass(frozen=True)
class LinkCounts:
    """What a serial link did since it was opened, in frames.

    Attributes:
        received: good frames, repeated ones not among them.
        lost: missing sequence numbers that left no damaged frame behind, so that a frame is never counted twice.
        damaged: stretches of the stream that are no frame.
        repeated: frames that came twice; the second was dropped.
    """

    received: int = 0
    lost: int = 0
    damaged: int = 0
    repeated: int = 0

    def plus(self, more: LinkCounts) -> LinkCounts:
        """Counts of both."""
        return LinkCounts(
            self.received + more.received,
            self.lost + more.lost,
            self.damaged + more.damaged,
            self.repeated + more.repeated,
        )

    def since(self, earlier: LinkCounts) -> LinkCounts:
        """Counts from `earlier` until now."""
        return LinkCounts(
            self.received - earlier.received,
            self.lost - earlier.lost,
            self.damaged - earlier.damaged,
            self.repeated - earlier.repeated,
        )
