"""What a session asks of a calibrated tracker: how old its calibration is, and where a foot that rests is.

Zeroing finds where a foot rests on the panel, since a sole, a sock or another foot moves every height. A zero is valid
for one participant and one connection.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date, timedelta

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.errors import Remedy, RigError, TrackerError

CALIBRATE = ("palpate", "calibrate", "tracker", "--rig", "RIG")

START_READINGS = 100
"""Readings that are looked at before a session."""

HELD_PART = 0.5
"""Largest part of these readings that may lie at an end of the calibration, or beyond."""

REST_S = 0.5
"""How long the resting foot is read, s."""

STILL_MM = 0.5
"""Largest standard deviation of a foot at rest, mm: five times that of a noisy sensor (0.1 mm)."""


def check_age(rig: Rig, today: date) -> None:
    """Refuse a real rig whose calibration is undated, too old, or dated after today, with a `RigError`."""
    tracker, where = tracker_of(rig), f"rig '{rig.rig.name}': tracker"
    made, days = tracker.calibrated_on, tracker.calibration_days
    if rig.rig.simulated:
        return
    if made is None or days is None:
        got = "got a calibration without calibrated_on and calibration_days"
        allowed = "the date, and for how many days it is valid"
        raise RigError(where, got, Remedy("run {}, which writes both", CALIBRATE), allowed=allowed)
    if made > today:
        got, allowed = f"got {made}, which is in the future", f"a date up to today, {today}"
        remedy = Remedy("check that the clock is right, or run {}", CALIBRATE, suffices=False)
        raise RigError(f"{where}.calibrated_on", got, remedy, allowed=allowed)
    if today > made + timedelta(days=days):
        allowed = f"at most {days} days before today, {today}"
        raise RigError(f"{where}.calibrated_on", f"got {made}", Remedy("run {}", CALIBRATE), allowed=allowed)


def check_reading(tracker: Tracker, settings: TrackerRig) -> None:
    """Raise `TrackerError` if half of the readings lie at or beyond an end of the calibration, or for a failure."""
    read_mm = heights(tracker, START_READINGS)
    calibrated = [point.mm for point in settings.calibration]
    for end_mm, held in ((min(calibrated), read_mm <= min(calibrated)), (max(calibrated), read_mm >= max(calibrated))):
        if held.mean() > HELD_PART:
            raise TrackerError(
                "tracker",
                f"got readings at or beyond {end_mm:g} mm, where its calibration ends",
                Remedy("check that the sensor is in place and detects the foot, or run {}", CALIBRATE, suffices=False),
                allowed=f"{min(calibrated):g} to {max(calibrated):g} mm",
            )


@dataclass(frozen=True)
class Zero:
    """A foot at rest, mm: median height above the calibration's contact, standard deviation, and number of samples."""

    offset_mm: float
    spread_mm: float
    samples: int

    def applied(self, samples: Samples) -> Samples:
        """Return the same samples with heights that count from where the foot rested."""
        return replace(samples, height_mm=samples.height_mm - self.offset_mm)


def zero(heights_mm: NDArray[np.float64], *, contact_mm: float, farthest_mm: float) -> Zero:
    """Return the zero from heights of a resting foot, mm, shape (n,).

    Raises `TrackerError` for too few samples, a foot that moved, or an offset above `farthest_mm`.
    """
    if heights_mm.size < 2:
        raise TrackerError("zeroing", f"got {heights_mm.size} samples", "restart the tracker", allowed="2 or more")
    spread_mm = float(np.std(heights_mm, ddof=1))
    if spread_mm > STILL_MM:
        raise TrackerError(
            "zeroing",
            f"got heights that vary by {spread_mm:.2f} mm",
            "rest the foot on the panel and do not move it",
            allowed=f"at most {STILL_MM:g} mm",
        )
    offset_mm = float(np.median(heights_mm)) - contact_mm
    if abs(offset_mm) > farthest_mm:
        raise TrackerError(
            "zeroing",
            f"got an offset of {offset_mm:.2f} mm",
            Remedy(
                "if the foot was on the panel, put the sensor back in place, then run {}", CALIBRATE, suffices=False
            ),
            allowed=f"at most {farthest_mm:g} mm up or down (tracker.zeroing_mm); rest the foot on the bare panel",
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
        """Take over an opened tracker; a zeroing takes `samples` of a foot within `farthest_mm` of `contact_mm`."""
        self._tracker = tracker
        self._contact_mm = contact_mm
        self._farthest_mm = farthest_mm
        self._samples = samples
        self.zero: Zero | None = None
        """Where the foot rested when zeroed; None at first and since the tracker came back."""

    def settle(self, rest: Callable[[str], object]) -> Zero:
        """Return the zero of a resting foot, read again until it is good; `TrackerError` if the tracker failed.

        `rest` has the foot rest on the bare panel, gets the last reading's fault, and gives up by raising.
        """
        why = ""
        while True:
            rest(why)
            read_mm = heights(self._tracker, self._samples)
            try:
                self.zero = zero(read_mm, contact_mm=self._contact_mm, farthest_mm=self._farthest_mm)
            except TrackerError as refused:
                why = refused.finding.sentence()
            else:
                return self.zero

    @property
    def counts(self) -> LinkCounts:
        return self._tracker.counts

    @property
    def gone(self) -> bool:
        return getattr(self._tracker, "gone", False)

    @property
    def clock_map(self) -> ClockMap | None:
        return self._tracker.clock_map

    def drain(self) -> None:
        self._tracker.drain()

    def read(self) -> Samples:
        samples = self._tracker.read()
        return samples if self.zero is None else self.zero.applied(samples)

    def reconnect(self, timeout_s: float) -> None:
        self.zero = None
        self._tracker.reconnect(timeout_s)

    def close(self) -> None:
        self._tracker.close()
