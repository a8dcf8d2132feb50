"""What `palpate doctor` finds of the sensor of a foot's force: zero and spread at rest, dead sensors, and its age."""

from __future__ import annotations

import re
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import doctor, foot_force
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.tracker import frame_runs
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session.kinds.footstep.doctor import omissions
from palpate.experiment.settings import load as settings
from tests.experiment.apparatus.wires.test_foot_force import COUNT_N, RIG, TRACKER, frames_of

NOISE = np.random.default_rng(1).normal(0.0, 1.0, 2000)


def of_counts(counts: NDArray[np.float64]) -> bytes:
    """Frames with these readings of the force; none where they are of shape (0,)."""
    numbers, heights = np.arange(NOISE.size), np.full(NOISE.size, 268)
    readings = np.column_stack([heights, np.rint(counts).astype(int)] if counts.size else [heights])
    return b"\0" + frame_runs.encode(frame_runs.Run(numbers, 1000 * numbers, readings))


@pytest.mark.parametrize("zero_n", [0.0, 12.0, -7.0])
def test_zero_and_spread_of_a_panel_that_nobody_is_on_are_told(zero_n: float) -> None:
    found = foot_force.at_rest(b"\0" + frames_of(zero_n + 0.5 * NOISE), TRACKER)
    told_n, spread_n = map(float, re.findall(r"-?\d+\.\d+", found.what))
    assert (found.check, found.verdict) == ("foot force", "passes")
    assert told_n == pytest.approx(zero_n + 0.5 * NOISE.mean(), abs=COUNT_N)
    assert spread_n == pytest.approx(0.5 * NOISE.std(), abs=COUNT_N)


@pytest.mark.parametrize(
    "counts",
    [
        np.full(NOISE.size, 250.0),
        np.zeros(NOISE.size),
        np.maximum(NOISE, 0.0),
        4095 + 3 * NOISE,
        4500 + 3 * NOISE,
        np.zeros(0),
    ],
    ids=["stuck", "without power", "at the lower end", "at the upper end", "beyond it", "not sent"],
)
def test_a_dead_sensor_is_red(counts: NDArray[np.float64]) -> None:
    found = foot_force.at_rest(of_counts(counts), TRACKER)
    assert (found.check, found.verdict) == ("foot force", "refuses")
    assert "-20 to 307.6 N" in found.allowed


def aged(days: int, holds_days: int | None, *, simulated: bool = False) -> str:
    tracker = TRACKER.model_copy(update={"calibration_days": holds_days})
    rig = RIG.model_copy(update={"rig": RIG.rig.model_copy(update={"simulated": simulated}), "tracker": tracker})
    assert tracker.force is not None
    return foot_force.age(rig, tracker.force, tracker.force.calibrated_on + timedelta(days)).verdict


@pytest.mark.parametrize(("days", "verdict"), [(-1, "refuses"), (0, "passes"), (30, "passes"), (31, "refuses")])
def test_a_calibration_that_is_out_of_date_is_red(days: int, verdict: str) -> None:
    assert aged(days, 30) == verdict
    assert aged(days, None) == "unknown"
    assert aged(days, 30, simulated=True) == "unknown"


def test_a_calibration_without_a_date_is_refused_in_the_rig_file() -> None:
    document = RIG.model_dump(exclude_none=True)
    del document["tracker"]["force"]["calibrated_on"]
    (problem,) = settings.find(Rig, document, {})
    assert problem.field.split(".")[1:] == ["force", "calibrated_on"]


def test_a_rig_without_the_sensor_is_red_for_a_protocol_that_records_it_alone() -> None:
    weight, other = (files.load(shipped(name)) for name in ("weight.toml", "okamoto2012.toml"))
    bare = rigs.load(shipped("rigs/rehearsal.toml"))

    def found(protocol: Protocol, rig: Rig) -> list[str]:
        each = omissions(protocol, rig, shipped("rigs/weight.toml").parent, Path("nowhere"), None)
        return [one.verdict for one in each if one.check == "foot force"]

    assert found(weight, bare) == ["refuses"]
    assert found(weight, RIG) == found(other, bare) == []


def test_the_age_is_told_of_a_rig_with_such_a_sensor_alone() -> None:
    clock, file = MonotonicClock(), shipped("rigs/weight.toml")
    without = RIG.model_copy(update={"tracker": TRACKER.model_copy(update={"force": None})})
    each = [{one.check for one in doctor._rig(rig, file, None, clock)} for rig in (RIG, without)]
    assert each[0] - each[1] == {"foot force age"}
