"""The rig's `[tracker]`: a sensor, the serial port that it speaks through, and its calibration.

A reading becomes a height by straight lines between the calibrated points, and stands for the nearest one beyond them.
"""

from collections.abc import Iterator, Sequence
from datetime import date
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Line, Rules, driver_key

FRAMES = "palpate-frames"
"""The tracker's driver unless a rig names another."""


def _tracker_rules(table: Any) -> Iterator[Broken]:
    """`baud` is at least 120 times `rate_hz`, because a frame takes 120 bits, or 140 times with two readings.

    In a calibration, the counts rise from point to point, and the heights, or positions, always rise or always fall. No
    tracker has both `along_calibration` and `force`.
    """
    from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES

    baud, rate_hz = table.get("baud"), table.get("rate_hz")
    second = [key for key in ("along_calibration", "force") if table.get(key) is not None]
    if len(second) == 2:
        yield Broken(("force",), "no such table with along_calibration: a frame has at most two readings")
    frame = FRAME_BYTES[2 if second else 1]
    if isinstance(baud, int) and isinstance(rate_hz, int) and baud < 10 * frame * rate_hz:
        yield Broken(("baud",), f"at least {10 * frame * rate_hz}: {rate_hz} frames of {frame} bytes per second")
    yield from _rising("calibration", table.get("calibration"), "heights")
    yield from _rising("along_calibration", table.get("along_calibration"), "places")


def _force_rules(table: Any) -> Iterator[Broken]:
    """In the calibration, the counts rise from point to point, and the forces always rise or always fall."""
    yield from _rising("calibration", table.get("calibration"), "forces", "n")


def _rising(key: str, points: Any, called: str, unit: str = "mm") -> Iterator[Broken]:
    if not isinstance(points, list | tuple):
        return
    counts = [point.get("counts") if isinstance(point, dict) else None for point in points]
    mm = [point.get(unit) if isinstance(point, dict) else None for point in points]
    for i, (before, after) in enumerate(pairwise(counts), start=1):
        if isinstance(before, int) and isinstance(after, int) and after <= before:
            yield Broken((key, i, "counts"), f"more than at the previous point ({before})")
    heights = [height for height in mm if isinstance(height, int | float)]
    if len(heights) < max(len(mm), 2):
        return
    rises = heights[1] > heights[0]
    for i, (before, after) in enumerate(pairwise(heights), start=1):
        if before == after or (after > before) != rises:
            way = "more" if rises else "less"
            yield Broken((key, i, unit), f"{way} than at the previous point ({before}), as {called} started")


class CalibrationPoint(Confined):
    """A reading at a known position.

    Attributes:
        counts: reading.
        mm: height above the panel, or position along the face.
    """

    counts: Annotated[int, Field(ge=0, le=65535)]
    mm: float


class ForcePoint(Confined):
    """A reading with a known force on the panel.

    Attributes:
        counts: reading.
        n: force, N.
    """

    counts: Annotated[int, Field(ge=0, le=65535)]
    n: float


class ForceRig(Confined):
    """A force sensor under the panel: the second reading of frames.

    Attributes:
        sensor: what it is and where it is.
        calibration: readings under known forces, such as weights; between two points forces follow a straight line.
        calibrated_on: date.
    """

    RULES: ClassVar[Rules] = _force_rules

    sensor: Line
    calibration: Annotated[tuple[ForcePoint, ...], Field(min_length=2)]
    calibrated_on: date


class TrackerRig(Confined):
    """The sensor and its serial port.

    Attributes:
        driver: palpate's driver for its frames, or a class of a module in this folder or of an installed package.
        port: device path, or URL for pyserial such as `socket://127.0.0.1:4711`.
        baud: bits per second.
        rate_hz: frames per second.
        stall_ms: a tracker silent for this long counts as stopped.
        calibration: readings at known heights; heights between two points follow a straight line.
        calibrated_on: date; required for a real rig.
        calibration_days: validity period; required for a real rig.
        noise_mm: measured rms noise at rest.
        zeroing_mm: heights count from the resting foot, at most this far from contact.
        along_calibration: readings of a planar tracker, whose frames have two, at known places along the face of a
            virtual block; it pushes back along its face too. A step is followed by its height alone.
        force: a force sensor under the panel, read with each height, for a protocol that records the foot's force.
    """

    RULES: ClassVar[Rules] = _tracker_rules

    driver: Annotated[str, driver_key(FRAMES), ONE_LINE] = FRAMES
    port: Line
    baud: Annotated[int, Field(ge=9600, le=12_000_000)]
    rate_hz: Annotated[int, Field(ge=1000, le=5000)]
    stall_ms: Annotated[int, Field(ge=50, le=200)]
    calibration: Annotated[tuple[CalibrationPoint, ...], Field(min_length=2)]
    calibrated_on: date | None = None
    calibration_days: Annotated[int, Field(ge=1, le=3650)] | None = None
    noise_mm: Annotated[float, Field(ge=0)] | None = None
    zeroing_mm: Annotated[float, Field(gt=0, le=10)] | None = None
    along_calibration: Annotated[tuple[CalibrationPoint, ...] | None, Field(min_length=2)] = None
    force: ForceRig | None = Field(None, json_schema_extra={"since": 6})

    @property
    def readings(self) -> int:
        """Return how many readings a frame has: 2 if the tracker is planar, or reads a force."""
        return 1 if self.along_calibration is None and self.force is None else 2

    def height_mm(self, counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the height above the panel of each reading, mm; that of the outermost points beyond them."""
        heights_mm: NDArray[np.float64] = np.interp(counts, *self._points)
        return heights_mm

    def along_mm(self, counts: NDArray[np.integer[Any]]) -> NDArray[np.float64] | None:
        """Return the place along the face of each reading, as `height_mm`; None if the tracker is not planar."""
        return None if self.along_calibration is None else np.interp(counts, *self._second_points)

    def force_n(self, counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the force on the panel of each reading of a tracker with `force`, N; the outermost beyond it."""
        return np.asarray(np.interp(counts, *self._second_points))

    @property
    def resolution_mm(self) -> float:
        """Return what one count is at most, mm."""
        counts, mm = self._points
        return float(np.abs(np.diff(mm) / np.diff(counts)).max())

    @cached_property
    def _points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Readings and heights of the calibration."""
        return _columns(self.calibration)

    @cached_property
    def _second_points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Second readings, and the places, mm, or forces, N, of their calibration."""
        if self.force is None:
            return _columns(self.along_calibration or ())
        points = self.force.calibration
        return np.array([float(point.counts) for point in points]), np.array([point.n for point in points])

    def counts(self, height_mm: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """Return the reading for each height above the panel, mm, shape (n,); the inverse of `height_mm`."""
        return _read(height_mm, *self._points)

    def second_counts(self, second: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """Return the second reading for each place along the face, mm, or force, N, as `counts`."""
        return _read(second, *self._second_points)


def _columns(points: Sequence[CalibrationPoint]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.array([float(point.counts) for point in points]), np.array([point.mm for point in points])


def _read(
    values: NDArray[np.floating[Any]], counts: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.int64]:
    order = np.argsort(points)
    whole: NDArray[np.int64] = np.rint(np.interp(values, points[order], counts[order])).astype(np.int64)
    return whole
