"""The walk through known heights, what it found as lines of text, and the rig file with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, MutableMapping, Sequence
from typing import Any, cast

import tomlkit

from experiment.apparatus import calibration as calibrations
from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.calibration import Calibration
from experiment.apparatus.rig import Rig
from experiment.clock import Clock, day
from experiment.errors import RigError
from experiment.protocol.models import Step


def heights(text: str) -> tuple[float, ...]:
    """Heights as they are typed, such as `0,10,20,50`, mm.

    Raises:
        RigError: not two different numbers or more.
    """
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(set(found)) < 2 or len(set(found)) < len(found) or not all(map(math.isfinite, found)):
        raise RigError(f"--points: got '{text}'; allowed: two or more different heights in mm, such as 0,10,20,50")
    return found


def walk(
    rig: Rig, heights_mm: Sequence[float], *, ask: Callable[[str], str], clock: Clock, port: str | None = None
) -> Calibration:
    """Read the sensor at each height, when the experimenter says that it is there.

    Args:
        rig: the rig; its present calibration does not matter.
        heights_mm: in the order of the walk.
        ask: shows a prompt and returns when Enter was pressed; `input` on a terminal.
        clock: says which day it is.
        port: used instead of the one that the rig names.

    Raises:
        PalpateError: the tracker failed, or the readings are no calibration.
    """
    settings = calibrations.raw(rig.tracker)
    tracker = opening.open_tracker(rig.model_copy(update={"tracker": settings}), clock=clock, port=port)
    try:
        levels = []
        for place, mm in enumerate(heights_mm, start=1):
            ask(f"Height {place} of {len(heights_mm)}: hold the target {mm:g} mm above the panel. Press Enter: ")
            levels.append(calibrations.level(tracker, mm))
    finally:
        tracker.close()
    return calibrations.calibrate(levels, day(clock.now_ns()))


def calibrated(rig: Rig, made: Calibration, days: int) -> Rig:
    """The rig with a new calibration that holds for so many days."""
    tracker = made.settings(rig.tracker).model_copy(update={"calibration_days": days})
    return rig.model_copy(update={"tracker": tracker})


def report(made: Calibration, rig: Rig, step: Step | None) -> Iterator[str]:
    """What was found, line by line.

    Args:
        made: the calibration.
        rig: the rig with it.
        step: gate and contact of the protocol that it is meant for; None if none was named.
    """
    yield "counts      mm   residual mm   noise mm"
    for point in made.points:
        yield f"{point.counts:6d} {point.mm:7.2f} {point.residual_mm:13.3f} {point.noise_mm:10.3f}"
    yield "Residual: from the line through a point's neighbours; about a quarter of it is left between points."
    if step is not None:
        try:
            rigs.check(rig, step)
        except RigError as error:
            yield f"Not far enough: {error}"
        else:
            yield f"It reaches past the gate ({step.gate_top_mm:g} mm) and the panel ({step.contact_mm:g} mm)."


def table(rig: Rig) -> str:
    """What to write under [tracker] in a rig file."""
    document = tomlkit.document()
    _put(document, rig)
    return tomlkit.dumps(document)


def rewritten(text: str, rig: Rig) -> str:
    """A rig file with the calibration of `rig` in place of its own; all else stays, comments too.

    Args:
        text: the rig file.
        rig: the rig with the new calibration.
    """
    document = tomlkit.parse(text)
    _put(cast("MutableMapping[str, Any]", document["tracker"]), rig)
    return tomlkit.dumps(document)


def _put(tracker: MutableMapping[str, Any], rig: Rig) -> None:
    settings = rig.tracker
    tracker.pop("calibration", None)
    tracker["calibrated_on"] = settings.calibrated_on
    tracker["calibration_days"] = settings.calibration_days
    tracker["noise_mm"] = settings.noise_mm
    points = tomlkit.array()
    for point in settings.calibration:
        row = tomlkit.inline_table()
        row.update({"counts": point.counts, "mm": point.mm})
        points.append(row)
    tracker["calibration"] = points.multiline(multiline=True)
