"""What a tracker's reading is in mm: calibrating it at known heights.

Two heights make a straight line; more follow a bent sensor. An inner point's residual against its neighbors' line is
about four times the error that remains between points.
"""

import math
import re
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from itertools import pairwise, takewhile
from typing import Any, cast

import numpy as np
import tomlkit
from numpy.typing import NDArray
from tomlkit.items import AoT, Item, Key, SingleKey, Table

from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import DOCTOR, Rig, tracker_of
from palpate.experiment.apparatus.tracker.frames import LinkCounts
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint
from palpate.experiment.apparatus.tracker.zeroing import heights
from palpate.experiment.clock import Clock, day
from palpate.experiment.errors import Finding, Remedy, RigError, TrackerError

Floats = NDArray[np.float64]

READINGS = 1000
"""Readings at each height."""

APART = 6.0
"""Readings at neighbouring heights lie at least this many standard deviations apart."""

BENT_PART, BROKEN_PART = 0.1, 0.5
"""Residual of an inner point over its neighbors' distance: reported above the one, refused above the other. One over
the height has 0.375 at 20 mm between 10 and 50.
"""

NOISY_MM = 0.1
"""A sensor with more noise than this is told of, mm."""

RAW = (CalibrationPoint(counts=0, mm=0.0), CalibrationPoint(counts=65535, mm=65535.0))
"""A calibration under which heights are readings."""


@dataclass(frozen=True)
class Level:
    """Readings at a known height, mm: what the sensor gave, shape (n,)."""

    mm: float
    counts: NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """A calibrated point: median reading, height and noise (sd), mm, and residual to its neighbors' line, if inner."""

    counts: int
    mm: float
    residual_mm: float | None
    noise_mm: float


@dataclass(frozen=True)
class Calibration:
    """Points in the order of their readings, when they were made, and what the link did meanwhile."""

    points: tuple[Point, ...]
    calibrated_on: date
    link: LinkCounts = field(default_factory=LinkCounts)

    @property
    def noise_mm(self) -> float:
        """Noise of the noisiest point, mm."""
        return max(point.noise_mm for point in self.points)


def raw(rig: Rig) -> Rig:
    """Return the rig with a tracker that gives readings in place of heights."""
    return rig.model_copy(update={"tracker": tracker_of(rig).model_copy(update={"calibration": RAW})})


def calibrate(levels: Sequence[Level], calibrated_on: date) -> Calibration:
    """Return the points for a rig file from readings at two heights or more, dated today.

    Raises `TrackerError` for too few heights, readings that do not separate them in one direction, or a broken line.
    """
    by_height = sorted(levels, key=lambda one: one.mm)
    if len(by_height) < 2 or any(lower.mm == upper.mm for lower, upper in pairwise(by_height)):
        got = ", ".join(f"{one.mm:g}" for one in by_height)
        raise TrackerError(
            "calibration", f"got the heights {got} mm", "add heights", allowed="two or more, all different"
        )
    counts = np.array([float(np.median(one.counts)) for one in by_height])
    spreads = np.array([float(np.std(one.counts)) for one in by_height])
    rises = bool((np.sum(np.sign(np.diff(counts))) or counts[-1] - counts[0]) > 0)
    if (at := _unfit(counts, spreads, rises)) is not None:
        way = "rise or all fall" if counts[-1] == counts[0] else "rise" if rises else "fall"
        read = ", ".join(f"{each:g} counts at {one.mm:g} mm" for each, one in zip(counts, by_height, strict=True))
        pair = f"the readings at {by_height[at].mm:g} and {by_height[at + 1].mm:g} mm are inconsistent"
        pair = f"{pair}, with an SD of {max(spreads[at : at + 2]):.1f}"
        raise TrackerError(
            "calibration",
            f"got {read}; {_blame(by_height, counts, spreads, rises) or pair}",
            "make sure nothing moves, or leave out heights that the sensor cannot distinguish",
            allowed=f"readings that all {way} with height, at least {APART:g} SD apart",
        )
    mm = np.array([one.mm for one in by_height])
    order = np.argsort(counts)
    counts, mm, spreads = counts[order], mm[order], spreads[order]
    residuals: list[float | None] = [None] * mm.size
    for i in range(1, mm.size - 1):
        residuals[i] = off_mm = float(mm[i] - np.interp(counts[i], counts[[i - 1, i + 1]], mm[[i - 1, i + 1]]))
        if abs(off_mm) > BROKEN_PART * abs(mm[i + 1] - mm[i - 1]):
            raise TrackerError(
                "calibration",
                f"got {counts[i]:g} counts at {mm[i]:g} mm; the line through its neighbors gives "
                f"{mm[i] - off_mm:.1f} mm",
                "check that nothing moved and the sensor is in place, or add heights in between",
                allowed=f"off by at most {BROKEN_PART:g} of the distance between the neighbors",
            )
    noises = spreads * np.abs(np.gradient(mm, counts))
    rows = zip(np.rint(counts).astype(int).tolist(), mm.tolist(), residuals, noises.tolist(), strict=True)
    return Calibration(tuple(Point(*row) for row in rows), calibrated_on)


def _unfit(counts: Floats, spreads: Floats, rises: bool) -> int | None:
    """Return where, by rising height, a reading and the next go the other way or lie too close together, or None."""
    steps = np.diff(counts)
    least = np.maximum(APART * np.maximum(spreads[1:], spreads[:-1]), 1.0)
    return next(iter(np.flatnonzero((np.abs(steps) < least) | ((steps > 0) != rises)).tolist()), None)


def _blame(by_height: Sequence[Level], counts: Floats, spreads: Floats, rises: bool) -> str:
    """Return which height alone does not fit the three or more others, or nothing."""
    every = np.arange(counts.size)
    alone = [i for i in every.tolist() if _unfit(counts[every != i], spreads[every != i], rises) is None]
    if counts.size < 4 or len(alone) != 1:
        return ""
    return f"only the reading at {by_height[alone[0]].mm:g} mm does not fit the others"


def heights_asked(text: str) -> tuple[float, ...]:
    """Return heights as they are typed, such as `0,10,20,50`, mm; `RigError` unless two or more, all different."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(set(found)) < 2 or len(set(found)) < len(found) or not all(map(math.isfinite, found)):
        raise RigError("--points", f"got '{text}'", allowed="two or more different heights in mm, such as 0,10,20,50")
    return found


def walk(tracker: Tracker, heights_mm: Sequence[float], *, ask: Callable[[str], str], clock: Clock) -> Calibration:
    """Return a calibration: the sensor is read at each height when the experimenter says that the target is there.

    `ask` shows a prompt until Enter. Raises `PalpateError` if the tracker failed, or the readings make no calibration.
    """
    levels, link = [], LinkCounts()
    for place, mm in enumerate(heights_mm, start=1):
        ask(f"Height {place} of {len(heights_mm)}: hold the target {mm:g} mm above the panel, then press Enter: ")
        # Frames that came and went before Enter was pressed say nothing of the line.
        tracker.drain()
        before = tracker.counts
        levels.append(Level(mm, heights(tracker, READINGS)))
        link = link.plus(tracker.counts.since(before))
    return replace(calibrate(levels, day(clock.now_ns())), link=link)


def calibrated(rig: Rig, made: Calibration, days: int) -> Rig:
    """Return the rig with a new calibration that holds for so many days."""
    points = tuple(CalibrationPoint(counts=point.counts, mm=point.mm) for point in made.points)
    tracker = {
        "calibration": points,
        "calibrated_on": made.calibrated_on,
        "noise_mm": round(made.noise_mm, 4),
        "calibration_days": days,
    }
    return rig.model_copy(update={"tracker": tracker_of(rig).model_copy(update=tracker)})


def report(made: Calibration) -> Iterator[str]:
    """Yield the results of a calibration line by line, and then what to question."""
    yield "counts      mm   residual mm   noise mm"
    for point in made.points:
        residual = "-" if point.residual_mm is None else f"{point.residual_mm:.3f}"
        yield f"{point.counts:6d} {point.mm:7.2f} {residual:>13} {point.noise_mm:10.3f}"
    yield "Residual: distance from the line through a point's neighbors; between points, about a quarter remains."
    yield from (f"Check: {one.sentence()}." for one in doubts(made))


def doubts(made: Calibration) -> Iterator[Finding]:
    """Yield what is to be questioned in a calibration."""
    for before, point, after in zip(made.points, made.points[1:], made.points[2:], strict=False):
        if abs(point.residual_mm or 0.0) > BENT_PART * abs(after.mm - before.mm):
            mend = "check that the target was at that height, or add heights"
            yield Finding(f"the point at {point.mm:g} mm is far from that line", remedy=mend, verdict="warns")
    for point in made.points:
        if point.noise_mm > NOISY_MM:
            what = f"the noise at {point.mm:g} mm is above {NOISY_MM:g} mm"
            yield Finding(what, remedy="fasten the sensor, and keep the target still", verdict="warns")
    if any(made.link[1:]):
        lost = f"{made.link.lost} frames were lost, {made.link.damaged} damaged and {made.link.repeated} repeated"
        remedy = Remedy("use a shorter cable or another USB port; {} will show this in red", DOCTOR, suffices=False)
        yield Finding(f"{lost}; {made.link.received} were received", remedy=remedy, verdict="warns")


def table(rig: Rig) -> str:
    """Return what to write under [tracker] in a rig file."""
    document = tomlkit.document()
    _write_calibration(document, rig)
    return tomlkit.dumps(document)


def rewritten(text: str, rig: Rig) -> str:
    """Return a rig file's text with the calibration of `rig`, and without its line NOT CALIBRATED."""
    document = tomlkit.parse(re.sub("(?m)^# NOT CALIBRATED: `palpate calibrate tracker`.*\n", "", text))
    tracker = cast("Table", document["tracker"])
    behind: list[tuple[Key | None, Item]] = []
    if isinstance(points := tracker["calibration"], AoT):
        # What stands between the last point and the next table is about that.
        behind = list(takewhile(lambda pair: pair[0] is None, reversed(points[-1].value.body)))[::-1]
        tracker.remove("calibration")
        if (along := tracker.pop("along_calibration", None)) is not None:
            behind.append((SingleKey("along_calibration"), along))
    _write_calibration(tracker, rig)
    for key, item in behind:
        tracker.append(key, item)
    return tomlkit.dumps(document)


def _write_calibration(tracker: MutableMapping[str, Any], rig: Rig) -> None:
    settings = tracker_of(rig)
    tracker["calibrated_on"] = settings.calibrated_on
    tracker["calibration_days"] = settings.calibration_days
    tracker["noise_mm"] = settings.noise_mm
    points = tomlkit.array()
    for point in settings.calibration:
        row = tomlkit.inline_table()
        row.update({"counts": point.counts, "mm": point.mm})
        points.append(row)
    tracker["calibration"] = points.multiline(multiline=True)
