"""Rig files: which devices stand in this laboratory, at which ports, with which calibration.

A sensor's reading becomes a height by straight lines between the calibrated points. It is never extrapolated: a
reading beyond the outermost points stands for the height of the nearest one. `check` therefore asks for points
so far beyond gate and panel that a reading held at either end can decide neither a crossing nor a contact, and that
the noise of a foot at rest on the panel stays inside, and for as much further as zeroing may move heights.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from datetime import date
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import rfc8785
from numpy.typing import NDArray
from pydantic import Field

from experiment.apparatus.frames import FRAME_BYTES
from experiment.apparatus.rig_audio import AudioRig
from experiment.apparatus.rig_panel import REHEARSAL, AccelerometerRig, ActuatorRig
from experiment.errors import ProtocolError, RigError
from experiment.protocol import load as files
from experiment.protocol.models import Confined, Name, Step, Text
from experiment.protocol.rules import Broken, Rules

FRAMES = "palpate-frames"
"""The tracker's driver unless a rig names another."""

ABOVE_GATE_MM = 5.0
"""How far above the gate the calibration must reach, mm: more than a fast foot moves in several samples."""

BELOW_CONTACT_MM = 1.0
"""How far below contact the calibration must reach, mm: the sole gives way and a sensor is noisy."""

_LINE_BITS = 10 * FRAME_BYTES
"""Bits of a frame on the line: start, eight data and stop for each byte."""


def _tracker_rules(table: Any) -> Iterator[Broken]:
    baud, rate_hz = table.get("baud"), table.get("rate_hz")
    if isinstance(baud, int) and isinstance(rate_hz, int) and baud < _LINE_BITS * rate_hz:
        yield Broken(("baud",), f"at least {_LINE_BITS * rate_hz}: {rate_hz} frames of {FRAME_BYTES} bytes a second")
    points = table.get("calibration")
    if not isinstance(points, list | tuple):
        return
    counts = [point.get("counts") if isinstance(point, dict) else None for point in points]
    mm = [point.get("mm") if isinstance(point, dict) else None for point in points]
    for i, (before, after) in enumerate(pairwise(counts), start=1):
        if isinstance(before, int) and isinstance(after, int) and after <= before:
            yield Broken(("calibration", i, "counts"), f"more than at the point before it ({before})")
    heights = [height for height in mm if isinstance(height, int | float)]
    if len(heights) < max(len(mm), 2):
        return
    rises = heights[1] > heights[0]
    for i, (before, after) in enumerate(pairwise(heights), start=1):
        if before == after or (after > before) != rises:
            way = "more" if rises else "less"
            yield Broken(("calibration", i, "mm"), f"{way} than at the point before it ({before}), as heights began")


def _rig_rules(table: Any) -> Iterator[Broken]:
    yield from _audio_rules(table.get("actuator"), table.get("audio"))
    rig = table.get("rig")
    if not isinstance(rig, dict) or rig.get("simulated") is not False:
        return
    named = (("tracker", "port"), ("actuator", "address"), ("accelerometer", "address"), ("audio", "device"))
    for device, key in named:
        settings = table.get(device)
        if isinstance(settings, dict) and settings.get(key) == REHEARSAL:
            yield Broken((device, key), f"a real {key}: '{REHEARSAL}' is for rigs with simulated = true")


def _audio_rules(actuator: Any, audio: Any) -> Iterator[Broken]:
    if not isinstance(actuator, dict) or actuator.get("driver") != "audio":
        return
    if audio is None:
        yield Broken(("audio",), "a table [audio]: actuator.driver is 'audio'")
    elif isinstance(audio, dict) and audio.get("rate_hz") != actuator.get("rate_hz"):
        yield Broken(
            ("actuator", "rate_hz"), f"audio.rate_hz ({audio.get('rate_hz')}): the actuator is a channel of it"
        )


class Identity(Confined):
    """What the rig is called, and whether it is simulated."""

    name: Name
    simulated: bool


class CalibrationPoint(Confined):
    """A reading, and the height at which it was taken."""

    counts: Annotated[int, Field(ge=0, le=65535)]
    mm: float


class TrackerRig(Confined):
    """The foot's sensor, and the serial port that it speaks through.

    `port` is a device path, or a URL that pyserial opens such as `socket://127.0.0.1:4711`. After `stall_ms` without a
    frame the tracker counts as stopped. `calibration` has two points or more, both columns strictly monotone; a real
    rig says when it was made and for how many days it holds. `driver` is palpate's own for the frames of frames.py, or
    `package.module:Class` for a class that is called as `SerialTracker` is. With `zeroing_mm` heights count from where
    the participant's foot rests on the panel, which may lie so far from the protocol's contact at most.
    """

    RULES: ClassVar[Rules] = _tracker_rules

    driver: Annotated[
        str,
        Field(
            pattern=r"^(palpate-frames|[A-Za-z_][\w.]*:[A-Za-z_]\w*)$",
            description="palpate-frames, or package.module:Class of a driver of your own",
        ),
    ] = FRAMES
    port: Text
    baud: Annotated[int, Field(ge=9600, le=12_000_000)]
    rate_hz: Annotated[int, Field(ge=1000, le=5000)]
    stall_ms: Annotated[int, Field(ge=50, le=200)]
    calibration: Annotated[tuple[CalibrationPoint, ...], Field(min_length=2)]
    calibrated_on: date | None = None
    calibration_days: Annotated[int, Field(ge=1, le=3650)] | None = None
    noise_mm: Annotated[float, Field(ge=0)] | None = None
    zeroing_mm: Annotated[float, Field(gt=0, le=10)] | None = None

    def height_mm(self, counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Height above the panel of each reading, mm; beyond the outermost points that of the nearest one.

        Args:
            counts: readings, shape (n,).
        """
        heights_mm: NDArray[np.float64] = np.interp(counts, *self._points)
        return heights_mm

    @cached_property
    def _points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Readings and heights of the calibration."""
        points = self.calibration
        return np.array([float(point.counts) for point in points]), np.array([point.mm for point in points])

    def counts(self, height_mm: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """The reading that stands for each height, as the sensor would give it; the inverse of `height_mm`.

        Args:
            height_mm: heights above the panel, mm, shape (n,).
        """
        points = sorted(self.calibration, key=lambda point: point.mm)
        readings = np.interp(height_mm, [p.mm for p in points], [p.counts for p in points])
        whole: NDArray[np.int64] = np.rint(readings).astype(np.int64)
        return whole


class Rig(Confined):
    """A whole rig; the accelerometer is needed by `palpate record` alone, `audio` where sound is."""

    RULES: ClassVar[Rules] = _rig_rules

    format: Literal[1]
    rig: Identity
    tracker: TrackerRig
    actuator: ActuatorRig
    accelerometer: AccelerometerRig | None = None
    audio: AudioRig | None = None


def load(path: Path) -> Rig:
    """Read the rig file at `path`.

    Raises:
        RigError: with every problem of the file, one a line; of its syntax, the first.
    """
    try:
        return files.read(path, Rig)
    except ProtocolError as error:
        raise RigError(str(error)) from error


def sha256(rig: Rig) -> str:
    """SHA-256 of the RFC 8785 JSON of what the rig file states, 64 hexadecimal digits.

    Without ports and addresses: a device that comes back under another name is the same device.
    """
    where = {"tracker": {"port"}, "actuator": {"address"}, "accelerometer": {"address"}, "audio": {"device"}}
    return hashlib.sha256(rfc8785.dumps(rig.model_dump(mode="json", exclude_none=True, exclude=where))).hexdigest()


def reach_mm(rig: Rig, step: Step) -> tuple[float, float]:
    """The lowest and the highest height that a protocol needs calibrated, mm.

    Args:
        rig: the rig; zeroing moves heights either way.
        step: gate and contact of the protocol.
    """
    moved_mm = rig.tracker.zeroing_mm or 0.0
    return step.contact_mm - BELOW_CONTACT_MM - moved_mm, step.gate_top_mm + ABOVE_GATE_MM + moved_mm


def check(rig: Rig, step: Step) -> None:
    """Refuse a calibration that does not reach past the gate and the panel of a protocol.

    Args:
        rig: the rig.
        step: gate and contact of the protocol.

    Raises:
        RigError: the calibrated heights do not reach far enough.
    """
    heights = [point.mm for point in rig.tracker.calibration]
    lowest, highest = reach_mm(rig, step)
    if min(heights) > lowest or max(heights) < highest:
        raise RigError(
            f"rig '{rig.rig.name}': tracker.calibration reaches from {min(heights):g} to {max(heights):g} mm; this "
            f"protocol needs {lowest:g} to {highest:g} mm, because readings are never extrapolated; calibrate further"
        )
