"""Which frame of the stream is which session time, from the times at which callbacks came.

A callback may come late and never early, so of the last callbacks those that came soonest after their frame tell the
time of it: the timeline is the line of the stream's rate that touches them from below. Where several
callbacks in a row all come late by more than a quarter of a block, frames were lost, or the device stood still: that
is a gap, and the line begins anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WINDOW = 64
"""Callbacks that the line rests on."""

IN_A_ROW = 4
"""Late callbacks in a row that make a gap: fewer are a slow machine."""


@dataclass(frozen=True)
class Fit:
    """How well callbacks keep to the timeline.

    Attributes:
        median_ms: lateness of a callback, median.
        p95_ms: 95th percentile.
        worst_ms: the worst.
    """

    median_ms: float
    p95_ms: float
    worst_ms: float


class Timeline:
    """Kept by the callback through `note`, read by the session's thread."""

    def __init__(self, *, rate_hz: float, block: int) -> None:
        """Begin.

        Args:
            rate_hz: frames a second.
            block: frames of a block.
        """
        self.gaps = 0
        """Gaps seen."""
        self._ns_per_frame = 1e9 / rate_hz
        self._quarter_block_ns = 0.25 * block * self._ns_per_frame
        # ns of a callback less the ns that its first frame stands for.
        self._offsets_ns = np.zeros(WINDOW, np.int64)
        self._count = 0
        self._late = 0

    def note(self, frame: int, now_ns: int) -> None:
        """A callback came. Touches preallocated memory alone.

        Args:
            frame: first frame of its block.
            now_ns: session time.
        """
        offset_ns = now_ns - int(frame * self._ns_per_frame)
        if self._count and offset_ns - self._origin_ns() > self._quarter_block_ns:
            self._late += 1
        else:
            self._late = 0
        if self._late == IN_A_ROW:
            self.gaps += 1
            self._late = 0
            self._count = 0
        self._offsets_ns[self._count % WINDOW] = offset_ns
        self._count += 1

    @property
    def known(self) -> bool:
        """Whether a callback has come."""
        return self._count > 0

    def ns_of(self, frame: float) -> int:
        """Session time at which the stream takes a frame, ns; the output's latency not included."""
        return self._origin_ns() + round(frame * self._ns_per_frame)

    def frame_at(self, t_ns: int) -> int:
        """The frame nearest to a session time."""
        return round((t_ns - self._origin_ns()) / self._ns_per_frame)

    def fit(self) -> Fit:
        """How well the last callbacks kept to it."""
        late_ms = (self._window() - self._origin_ns()) / 1e6
        return Fit(float(np.median(late_ms)), float(np.percentile(late_ms, 95)), float(late_ms.max()))

    def _window(self) -> NDArray[np.int64]:
        return self._offsets_ns[: min(self._count, WINDOW)]

    def _origin_ns(self) -> int:
        return int(self._window().min())
