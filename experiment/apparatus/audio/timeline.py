"""Which frame of the stream is which session time, from the times at which callbacks came.

A callback may come late and never early, so of the last callbacks those that came soonest after their frame tell the
time of it: the timeline is the line of the stream's rate that touches them from below. Where several
callbacks in a row all come late by more than a quarter of a block, frames were lost, or the device stood still: that
is a gap, and the line begins anew with the first of them. A frame of the past stands on the line that held when it was
taken, so that a gap after a stimulus does not move it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WINDOW = 64
"""Callbacks that the line rests on."""

IN_A_ROW = 4
"""Late callbacks in a row that make a gap: fewer are a slow machine."""

NONE_NS = 2**63 - 1
"""Offset of a callback that has not come, ns."""

KEPT = 8192
"""Callbacks whose lateness is remembered: 22 s of blocks of 128 frames at 48 kHz, longer than any stimulus."""


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
    """Kept by the callback through `note`, read by the session's thread.

    They share no lock: the callback publishes how many callbacks and gaps there are together and last, and a reader
    takes both at once. Of what a reader then looks at, the callback changes at most the line of the last three. The
    line that holds now is published by itself, for `frame_at`, which takes nothing else.
    """

    def __init__(self, *, rate_hz: float, block: int) -> None:
        """Begin.

        Args:
            rate_hz: frames a second.
            block: frames of a block.
        """
        self._ns_per_frame = 1e9 / rate_hz
        self._quarter_block_ns = 0.25 * block * self._ns_per_frame
        # Of each callback: its first frame, ns less the ns that this frame stands for, and gaps before it.
        self._frames = np.zeros(KEPT, np.int64)
        self._offsets_ns = np.zeros(KEPT, np.int64)
        self._line = np.zeros(KEPT, np.int64)
        # Offsets of the last callbacks on the line that holds now, and the lowest of them.
        self._window_ns = np.full(WINDOW, NONE_NS)
        self._origin_ns = NONE_NS
        self._late = 0
        self._count_and_gaps = (0, 0)

    def note(self, frame: int, now_ns: int) -> None:
        """A callback came. Touches preallocated memory alone.

        Args:
            frame: first frame of its block.
            now_ns: session time.
        """
        count, gaps = self._count_and_gaps
        offset_ns = now_ns - int(frame * self._ns_per_frame)
        self._late = self._late + 1 if offset_ns - self._origin_ns > self._quarter_block_ns else 0
        place = count % KEPT
        self._frames[place], self._offsets_ns[place], self._line[place] = frame, offset_ns, gaps
        self._window_ns[count % WINDOW] = offset_ns
        count += 1
        if self._late == IN_A_ROW:
            gaps += 1
            self._late = 0
            self._window_ns.fill(NONE_NS)
            for back in range(1, IN_A_ROW + 1):
                place = (count - back) % KEPT
                self._line[place] = gaps
                self._window_ns[(count - back) % WINDOW] = self._offsets_ns[place]
        self._origin_ns = int(self._window_ns.min())
        self._count_and_gaps = count, gaps

    @property
    def gaps(self) -> int:
        """Gaps seen."""
        return self._count_and_gaps[1]

    def ns_of(self, frame: float) -> int:
        """Session time at which the stream takes a frame, or took it, ns; the output's latency not included."""
        count, _ = self._count_and_gaps
        places = np.arange(max(count - KEPT, 0), count) % KEPT
        lines = self._line[places]
        at = int(np.searchsorted(self._frames[places], frame, side="right")) - 1
        near = slice(max(at - WINDOW + 1, 0), at + WINDOW) if at >= 0 else slice(1)
        same = self._offsets_ns[places[near]][lines[near] == lines[max(at, 0)]]
        return int(same.min()) + round(frame * self._ns_per_frame)

    def frame_at(self, t_ns: int) -> int:
        """The frame nearest to a session time."""
        return round((t_ns - self._origin_ns) / self._ns_per_frame)

    def fit(self) -> Fit:
        """How well the last callbacks kept to it."""
        count, gaps = self._count_and_gaps
        places = np.arange(max(count - WINDOW, 0), count) % KEPT
        window = self._offsets_ns[places[self._line[places] == gaps]]
        late_ms = (window - window.min()) / 1e6
        return Fit(float(np.median(late_ms)), float(np.percentile(late_ms, 95)), float(late_ms.max()))
