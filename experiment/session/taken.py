"""What one attempt took from the tracker: the bytes for the record, the frames counted, and the times they were of.

Clock and counts are kept with each read: a tracker that fails may fail at them too, and a step goes on record all the
same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.samples import LinkCounts, Samples
from experiment.errors import TrackerStopped
from experiment.session.feed import Feed


class Taken:
    """The samples of one attempt, read by read."""

    def __init__(self, feed: Feed) -> None:
        """Begin an attempt.

        Args:
            feed: the tracker's samples.
        """
        self._feed = feed
        self._before = self._counts = feed.tracker.counts
        self._raw = bytearray()
        self._received = 0
        self._newest: Samples | None = None
        self.first_us: int | None = None
        """Device time of the first sample; None before it came."""
        self.newest_us: int | None = None
        """Device time of the newest sample; None before the first."""
        self.clock_map: ClockMap | None = None
        """Session time of device time, as the tracker's clock stood at the newest read; None before the first."""

    def next(self) -> Samples:
        """The next samples. Raises `TrackerError`."""
        self._file()
        samples = self._feed.read()
        if self.first_us is None:
            self.first_us = int(samples.device_us[0])
        self._newest, self.newest_us = samples, int(samples.device_us[-1])
        tracker = self._feed.tracker
        self.clock_map, self._counts = tracker.clock_map or self.clock_map, tracker.counts
        return samples

    def clock(self) -> ClockMap:
        """`clock_map`, where there is one. Raises `TrackerStopped`."""
        if self.clock_map is None:
            raise TrackerStopped("tracker: got no sample since it was opened; see that the device is sampling")
        return self.clock_map

    def session_ns(self, device_us: float) -> int:
        """Session time of a device time, ns, by `clock`. Raises `TrackerStopped`."""
        return self.clock().session_ns(device_us)

    def until(self, device_us: float) -> None:
        """Wait for the first sample at this time or later, and leave what follows it to the next attempt.

        A record then does not depend on how reads were cut. Raises `TrackerError`.
        """
        samples = self._newest if self._newest is not None else self.next()
        while samples.device_us[-1] < device_us:
            samples = self.next()
        self._newest, rest = samples.cut(int(np.searchsorted(samples.device_us, device_us)) + 1)
        self.newest_us = int(self._newest.device_us[-1])
        self._feed.put_back(rest)

    def link(self, device_us: float) -> LinkCounts:
        """Frames counted until the newest read, received ones up to a device time within the newest read."""
        newest = 0 if self._newest is None else int(np.searchsorted(self._newest.device_us, device_us, side="right"))
        return replace(self._counts.since(self._before), received=self._received + newest)

    def raw(self) -> bytes:
        """Every byte taken."""
        self._file()
        return bytes(self._raw)

    def _file(self) -> None:
        if self._newest is not None:
            self._raw += self._newest.raw
            self._received += self._newest.device_us.size
            self._newest = None
