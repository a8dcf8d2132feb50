"""Recording a protocol's materials: the walk through materials, speeds and takes, each step beside its target.

A take that is kept is on disk at once; the same call goes on with an interrupted recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol as Port

from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.gate import Contact, Gate, GateDetector
from experiment.apparatus.ports import Accelerometer, Tracker, Window
from experiment.errors import RecordingError
from experiment.protocol import load
from experiment.recordings import partial
from experiment.recordings.plan import Condition, Plan, plan

SPEED_TOLERANCE = 0.10
"""A step is on target when its speed is within this part of it: less than half the way to the next recorded speed."""


@dataclass(frozen=True)
class Step:
    """A step that was recorded, before it is kept.

    Attributes:
        condition: what it was meant to be.
        achieved_mm_s: mean speed of the foot through the gate, mm/s.
        window: what the accelerometer heard; None for nothing.
    """

    condition: Condition
    achieved_mm_s: float
    window: Window | None

    @property
    def deviation(self) -> float:
        """Of the achieved speed from its target, as a part of the target."""
        return self.achieved_mm_s / self.condition.speed_mm_s - 1

    @property
    def problems(self) -> tuple[str, ...]:
        """What speaks against keeping it; empty for a good take."""
        found = []
        if abs(self.deviation) > SPEED_TOLERANCE:
            found.append(f"speed off by {self.deviation:+.0%}, more than {SPEED_TOLERANCE:.0%}")
        if self.window is None:
            found.append("nothing shook the panel")
        elif self.window.clipped:
            found.append(f"{self.window.clipped} samples beyond the accelerometer's full scale")
        return tuple(found)


class TakesConsole(Port):
    """What the experimenter sees and keys while takes are recorded."""

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        """Have the panel made ready; returns when it is."""
        ...

    def arm(self, condition: Condition, *, attempt: int) -> None:
        """Say that the foot may step; returns at once."""
        ...

    def keeps(self, step: Step) -> bool:
        """Show the step beside its target; whether the experimenter keeps it. One without a window is never kept."""
        ...


def record_on_rig(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path,
    console: TakesConsole,
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
) -> Path:
    """Record on a real rig, or go on with it.

    Args:
        protocol_file: what is recorded.
        rig_file: the rig, with a table `[accelerometer]`.
        out: folder of the recordings; new or empty.
        console: the experimenter's.
        speeds_mm_s: instead of the protocol's; empty for those.
        takes: instead of the protocol's; None for those.

    Returns:
        Path of the manifest.

    Raises:
        PalpateError: a file or a part that cannot be used; the same call goes on where it stopped.
    """
    protocol, rig = load.load(protocol_file), rigs.load(rig_file)
    if rig.rig.simulated:
        raise RecordingError(f"{rig_file}: a simulated rig; allowed: a real one; name another, or record --simulated")
    rigs.check(rig, protocol.step)
    planned = plan(protocol, source=f"rig {rig.rig.name}", simulated=False, speeds_mm_s=speeds_mm_s, takes=takes)
    partial.check(out, planned)
    accelerometer = opening.open_accelerometer(rig, rate_hz=protocol.synthesis.rate_hz)
    try:
        tracker = opening.open_tracker(rig)
        try:
            detector = GateDetector(protocol.step)
            return record(
                planned, out, tracker=tracker, accelerometer=accelerometer, detector=detector, console=console
            )
        finally:
            tracker.close()
    finally:
        accelerometer.close()


def record(
    planned: Plan,
    out: Path,
    *,
    tracker: Tracker,
    accelerometer: Accelerometer,
    detector: GateDetector,
    console: TakesConsole,
) -> Path:
    """Walk through what is not recorded yet, then write the whole.

    Returns:
        Path of the manifest.

    Raises:
        RecordingError: see `partial.check`; or the accelerometer failed.
        TrackerError: the tracker failed.
    """
    folder = partial.begin(planned, out)
    conditions = planned.conditions()
    for place, condition in enumerate(conditions):
        path = partial.take_path(folder, place)
        if path.exists():
            continue
        console.place(condition, done=place, total=len(conditions))
        attempt = 0
        kept = False
        while not kept:
            attempt += 1
            tracker.drain()
            accelerometer.arm(planned.samples)
            console.arm(condition, attempt=attempt)
            achieved_mm_s = _achieved_mm_s(tracker, detector)
            step = Step(condition, achieved_mm_s, accelerometer.window())
            kept = console.keeps(step) and step.window is not None
            if kept and step.window is not None:
                partial.keep(path, step.window, achieved_mm_s)
    return partial.publish(planned, out)


def _achieved_mm_s(tracker: Tracker, detector: GateDetector) -> float:
    """Follow the foot until it is down; its speed through the gate, mm/s, to a thousandth: far below the noise."""
    state = detector.init()
    gate: Gate | None = None
    while True:
        state, events = detector.step(state, tracker.read())
        for event in events:
            if isinstance(event, Gate):
                gate = event
            elif isinstance(event, Contact) and gate is not None:
                return round(gate.speed_mm_s, 3)
