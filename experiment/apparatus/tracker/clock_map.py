"""Which session time a device's time is: offset and drift of its clock, from when its samples arrived.

A sample arrives after it was taken: arrival = true time + delay, with a heavy tail. A busy system holds a read up for
31 ms and then passes on a burst. So the true line lies along the lower edge of what is seen:

- only the newest sample of each read counts, for it waited least;
- of each `FINE_US` of device time the read with the least delay is kept for `FINE_BINS` of them, and of each `BIN_US`
  the one with the least of all for `BINS` of them;
- drift is the median of the slopes between every two reads kept of `BIN_US` (Theil 1950; Sen 1968, J. Am. Stat. Assoc.
  63), and until `TRUSTED_BINS` of them are kept, of those kept of `FINE_US`. It is zero until `TRUSTED_FINE_BINS` are
  kept, and within `DRIFT_LIMIT_PPM`, which no resonator exceeds;
- the offset is the largest that puts no kept read, nor any read since, before its own sample; while drift is unknown or
  beyond the limit, only those of the last two `FINE_US` count.

A map trusts the device. `Pace` says whether a clock with a drift of at most `PACE_PART` can have brought the reads
before and after a step, whose least delays may differ by `PACE_US`. `experiment/decisions.md` has the errors of a map.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

BIN_US = 1_000_000
"""Of each such stretch of device time one read is kept, microseconds."""

BINS = 64
"""Reads that are kept: about a minute, in which a crystal's rate changes by less than can be seen."""

TRUSTED_BINS = 3
"""Fewer say less about drift than the reads kept of `FINE_US` do."""

FINE_US = 100_000
"""Of each such stretch, microseconds, one read is kept for a while: three longest stalls, and a part of `BIN_US`."""

FINE_BINS = 30
"""Reads that are kept of `FINE_US`: as long as it takes until `TRUSTED_BINS` are."""

TRUSTED_FINE_BINS = 5
"""Fewer say nothing about drift: a stall would tilt the line."""

DRIFT_LIMIT_PPM = 10_000.0
"""Largest drift that is believed: twice what a ceramic resonator is sold with, parts per million."""

PACE_PART = 0.015
"""Half more than `DRIFT_LIMIT_PPM`, and still below the 2 % by which no speed may be wrong."""

PACE_US = 5_000.0
"""Half the delay in which `palpate doctor` wants 99 of 100 reads of a device, microseconds; the least is far less."""

PACE_KNOWN_US = 1_000_000
"""Reads over less of the device's time cannot tell `PACE_PART` from delays, microseconds."""

PACE_NEAR_US = 300_000
"""Reads before a step that a jump of the clock within it is seen against, microseconds: three long stalls."""

PACE_SLOT_US, PACE_SLOTS = 20_000, 512
"""Of each such stretch of device time the read with the least delay is kept, microseconds, for 10 s or more."""


@dataclass(frozen=True)
class ClockMap:
    """A straight line from device time to session time.

    Attributes:
        anchor_us: device time of the newest sample that it was made from, microseconds.
        anchor_ns: session time of that sample, ns.
        drift_ppm: how much longer a microsecond of the device is than one of the session, parts per million.
        span_s: device time between the first sample that it was made from and the last, s; 0 for a map that was given.
    """

    anchor_us: int
    anchor_ns: int
    drift_ppm: float = 0.0
    span_s: float = 0.0

    def session_ns(self, device_us: float) -> int:
        """Return the session time, ns, of a device time, microseconds, which may lie outside the samples."""
        elapsed_us = device_us - self.anchor_us
        return self.anchor_ns + round(elapsed_us * 1000) + round(elapsed_us * self.drift_ppm * 1e-3)


class ClockState(NamedTuple):
    """What was seen of one device since it was opened; a tuple, because one is made with every read.

    Since the first read and in microseconds, `x` is device time and `y` by how much arrivals have fallen behind it.

    Attributes:
        origin_us: device time of the first read, microseconds.
        origin_ns: its arrival, ns.
        newest_x: of the newest read.
        kept: (x, y) of the read with the least delay of each `BIN_US` that is over.
        fine: the same of each `FINE_US` that is over.
        low: (x, y) of the one of the present `FINE_US`.
        known: whether drift is known, and within the limit.
        slope: y per x.
        level: y at x = 0.
    """

    origin_us: int
    origin_ns: int
    newest_x: float
    kept: tuple[tuple[float, float], ...]
    fine: tuple[tuple[float, float], ...]
    low: tuple[float, float]
    known: bool
    slope: float
    level: float

    def map(self) -> ClockMap:
        """Return the line as it stands."""
        lead_us = self.level + self.slope * self.newest_x
        return ClockMap(
            anchor_us=self.origin_us + round(self.newest_x),
            anchor_ns=self.origin_ns + round((self.newest_x + lead_us) * 1000),
            drift_ppm=self.slope * 1e6,
            span_s=self.newest_x / 1e6,
        )


def init(device_us: int, arrived_ns: int) -> ClockState:
    """Return the state after the first read: device time of its newest sample, and session time of its arrival."""
    return ClockState(device_us, arrived_ns, 0.0, (), (), (0.0, 0.0), False, 0.0, 0.0)


def step(state: ClockState, device_us: int, arrived_ns: int) -> ClockState:
    """Return the state after the next read; the device time is later than any before."""
    origin_us, origin_ns, _, kept, fine, low, known, slope, level = state
    x = float(device_us - origin_us)
    y = (arrived_ns - origin_ns) / 1000 - x
    if x // FINE_US == low[0] // FINE_US:
        if y - slope * x < low[1] - slope * low[0]:
            low = (x, y)
        level = min(level, y - slope * x)
    else:
        fine = (*fine, low)[-FINE_BINS:]
        if x // BIN_US != low[0] // BIN_US:
            over = [read for read in fine if read[0] // BIN_US == low[0] // BIN_US]
            kept = (*kept, min(over, key=lambda read: read[1] - slope * read[0]))[-BINS:]
        low = (x, y)
        trusted = kept if len(kept) >= TRUSTED_BINS else fine if len(fine) >= TRUSTED_FINE_BINS else ()
        if trusted is not state.kept:
            known, slope = _slope(trusted)
        counted = (*kept, *fine, low) if known else (fine[-1], low)
        level = min(at_y - slope * at_x for at_x, at_y in counted)
    return ClockState(origin_us, origin_ns, x, kept, fine, low, known, slope, level)


class Pace:
    """When the reads of a device came, by which its clock is held against the session's."""

    def __init__(self) -> None:
        self._reads: deque[tuple[int, float]] = deque(maxlen=PACE_SLOTS)

    def read(self, device_us: int, arrived_ns: int) -> None:
        """Take the device time of a read's newest sample, microseconds, and the session time of its arrival."""
        delay_us = arrived_ns / 1e3 - device_us
        if self._reads and self._reads[-1][0] // PACE_SLOT_US == device_us // PACE_SLOT_US:
            if delay_us >= self._reads[-1][1]:
                return
            self._reads.pop()
        self._reads.append((device_us, delay_us))

    @property
    def known(self) -> bool:
        """Whether the reads last long enough to judge by."""
        return bool(self._reads) and self._reads[-1][0] - self._reads[0][0] >= PACE_KNOWN_US

    def ahead_ms(self, from_us: float, until_us: float) -> float:
        """Return by how much more than allowed the device's clock ran ahead over a step between device times, ms.

        Negative: it fell behind, or every read since was late, and a later one may clear it. Zero: neither.
        """
        x, y = np.array(self._reads).T
        since = x >= until_us
        near = (x <= from_us) & (x >= from_us - PACE_NEAR_US)
        far = x <= min(x[0] + PACE_KNOWN_US, x[-1] - PACE_KNOWN_US)
        for before in (near, far):
            if not before.any() or not since.any():
                continue
            least = [
                float((y + part * x)[since].min() - (y + part * x)[before].min()) for part in (PACE_PART, -PACE_PART)
            ]
            if least[0] < -PACE_US:
                return -(least[0] + PACE_US) / 1e3
            if least[1] > PACE_US:
                return -(least[1] - PACE_US) / 1e3
        return 0.0


def _slope(reads: tuple[tuple[float, float], ...]) -> tuple[bool, float]:
    """Return whether drift is known and within the limit, and the slope to go by."""
    if not reads:
        return False, 0.0
    x, y = np.array(reads).T
    first, second = np.triu_indices(x.size, 1)
    slope = float(np.median((y[second] - y[first]) / (x[second] - x[first])))
    limit = DRIFT_LIMIT_PPM * 1e-6
    return abs(slope) < limit, min(max(slope, -limit), limit)
