"""The tracker's samples, attempt after attempt: what one attempt leaves over belongs to the next."""

from __future__ import annotations

from experiment.apparatus.ports import Tracker
from experiment.apparatus.samples import Samples


class Feed:
    """Reads a tracker; samples can be put back."""

    def __init__(self, tracker: Tracker) -> None:
        """Read from `tracker`; nothing is left over yet."""
        self.tracker = tracker
        self._left: Samples | None = None

    def drain(self) -> None:
        """Forget what was left over, and throw away what arrived before now. Raises `TrackerStopped`."""
        self._left = None
        self.tracker.drain()

    def read(self) -> Samples:
        """What was put back, or the tracker's next samples, at least one. Raises `TrackerError`."""
        left, self._left = self._left, None
        return left if left is not None else self.tracker.read()

    def put_back(self, samples: Samples) -> None:
        """Have the next `read` begin with these; none is nothing."""
        self._left = samples if samples.device_us.size else None
