"""Scripted devices that takes are recorded with, and the folder that they leave."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus.panel.accelerometer import Heard, Window
from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import GateDetector
from palpate.experiment.protocol.models import Step
from palpate.experiment.recordings import workflow
from palpate.experiment.recordings.store import Condition, Plan
from palpate.experiment.rehearsal.clock import ManualClock

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
HELD_UP_NS = 7_000_000
"""How long after a frame the host reads it."""

PLAN = Plan("rig bench", "a" * 64, "b" * 64, False, ("copy paper",), (100.0, 200.0), 2, 1000, 8)


class World:
    """Tracker, accelerometer and experimenter in one: every step goes at `speeds`' next speed, mm/s."""

    rate_hz = 1000
    counts = LinkCounts()
    clock_map = None

    def __init__(self, speeds: Iterator[float], *, windows: Iterator[Window | None] | None = None) -> None:
        self.clock = ManualClock(0)
        self.asked: list[tuple[int, int]] = []
        self.knock_ns: Callable[[int], int | None] = lambda _: None
        self.speeds = speeds
        self.windows = windows
        self.log: list[str] = []
        self.kept: list[workflow.Step] = []
        self._next = 0.0
        self._us = 0

    def drain(self) -> None:
        self.log.append("drain")

    def read(self) -> Samples:
        t_us = np.arange(0, int(40e6 / self._next), 1000)
        height_mm = 30.0 - self._next * (t_us / 1e6)
        begin_us, self._us = self._us, self._us + int(t_us[-1]) + 1000
        self.clock.sleep_ns((begin_us + int(t_us[-1])) * 1000 + HELD_UP_NS - self.clock.now_ns())
        return Samples(t_us + begin_us, height_mm, b"", np.zeros(t_us.size, np.int64), self.clock.now_ns())

    def reconnect(self, timeout_s: float) -> None: ...

    def close(self) -> None: ...

    def arm(self, wanted: object, *, attempt: int = 0) -> None:
        if isinstance(wanted, Condition):
            self.log.append(f"arm {attempt}")
            self._next = next(self.speeds)
        else:
            assert wanted == PLAN.samples
            self.log.append("listen")

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        self.asked.append((earliest_ns, latest_ns))
        window = Window(np.full(8, self._next), clipped=0) if self.windows is None else next(self.windows)
        return Heard(window, earliest_ns + 100, self.knock_ns(earliest_ns))

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        self.log.append(f"{done + 1}/{total} {condition.material} {condition.speed_mm_s:g} {condition.number}")

    def keeps(self, step: workflow.Step) -> bool:
        if step.problems:
            return False
        self.kept.append(step)
        return True


def good() -> Iterator[float]:
    """Steps that all hit their targets, in the plan's order."""
    yield from (c.speed_mm_s for c in PLAN.conditions())


class Worn:
    """Implements `Tracker`: gives `reads` first, and then a world's steps, all `sole_mm` too high."""

    def __init__(self, world: World, reads: Iterator[Samples], sole_mm: float) -> None:
        self.world = world
        self.reads = reads
        self.sole_mm = sole_mm
        self.counts, self.clock_map = world.counts, world.clock_map
        self.drain, self.reconnect, self.close = world.drain, world.reconnect, world.close

    def read(self) -> Samples:
        for rested in self.reads:
            return rested
        samples = self.world.read()
        return replace(samples, height_mm=samples.height_mm + self.sole_mm)


def record(world: World, out: Path, planned: Plan = PLAN, *, tracker: Tracker | None = None) -> Path:
    return workflow.record(
        planned,
        out,
        tracker=tracker or world,
        accelerometer=world,
        detector=GateDetector(STEP),
        console=world,
        clock=world.clock,
    )


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def interrupted(out: Path, after: int, error: type[BaseException] = KeyboardInterrupt) -> None:
    def speeds() -> Iterator[float]:
        for place, v in enumerate(good()):
            if place == after:
                raise error("stopped")
            yield v

    with pytest.raises(error):
        record(World(speeds()), out)
