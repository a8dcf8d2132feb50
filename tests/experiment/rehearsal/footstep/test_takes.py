"""Simulated sessions: one way to draw takes, and what the paper says of takes holds whatever the seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.validation import validate
from experiment.protocol.files import load as load_protocol
from experiment.protocol.models import Protocol
from experiment.recordings.manifest import load_all
from experiment.recordings.store import Condition, Plan, plan
from experiment.rehearsal.footstep import recorded_takes
from experiment.rehearsal.footstep.recorder import fresh_takes


@pytest.fixture(scope="module")
def planned(repository_root: Path) -> Plan:
    return plan(protocol_of(repository_root), source=recorded_takes.source(1), simulated=True)


def protocol_of(root: Path) -> Protocol:
    return load_protocol(root / "protocols" / "okamoto2012.toml")


@pytest.mark.parametrize("seed", range(1, 21))
def test_at_least_half_of_the_takes_are_close_for_every_material(planned: Plan, seed: int) -> None:
    """Okamoto et al., section 3.3: "the same or close speed levels", "for all types of materials"."""
    recorded = recorded_takes.session(planned, seed=seed).recordings()
    found = validate.compute(recorded, fresh_takes(recorded, seed=seed))
    assert {one.material: 2 * int(one.close.sum()) >= one.takes for one in found.classified} == dict.fromkeys(
        planned.materials, True
    )


def test_attempts_are_the_same_in_whatever_order_they_are_asked_for(planned: Plan) -> None:
    one, other = (recorded_takes.RecordingSession(planned, seed=3, number=2) for _ in range(2))
    conditions = planned.conditions()[:3]
    there = [one.attempt(c, 2).samples_m_s2 for c in conditions]
    back = [other.attempt(c, 2).samples_m_s2 for c in reversed(conditions)]
    np.testing.assert_array_equal(there, back[::-1])


def test_no_two_attempts_sessions_seeds_or_plans_share_a_draw(planned: Plan) -> None:
    condition = Condition("copy paper", 100.0, 1)
    longer = Plan(**{**vars(planned), "takes": planned.takes + 1})
    drawn = [
        recorded_takes.RecordingSession(p, seed=seed, number=number).attempt(condition, attempt).speed_mm_s
        for p in (planned, longer)
        for seed in (1, 2)
        for number in (0, 1)
        for attempt in (1, 2)
    ]
    assert len(set(drawn)) == 16


def test_speeds_are_those_of_a_foot_that_aims(planned: Plan) -> None:
    """Log-normal about the target: of 1000 attempts the mean log is within 4 standard errors of it."""
    drawn = recorded_takes.RecordingSession(planned, seed=1, number=0)
    target = Condition(None, 200.0, 1)
    logs = np.log([drawn.attempt(target, n).speed_mm_s / 200 for n in range(1, 1001)])
    assert logs.mean() == pytest.approx(0, abs=4 * recorded_takes.AIM_SIGMA / np.sqrt(1000))
    assert logs.std() == pytest.approx(recorded_takes.AIM_SIGMA, rel=0.1)


def test_recordings_on_disk_are_the_sessions_kept_takes(tmp_path: Path, planned: Plan, repository_root: Path) -> None:
    recorded_takes.make_recordings(tmp_path, protocol=protocol_of(repository_root), seed=1)
    drawn = recorded_takes.session(planned, seed=1).recordings()
    for on_disk, kept in zip(load_all(tmp_path).objects.values(), drawn.objects.values(), strict=True):
        np.testing.assert_array_equal(on_disk, kept.astype(np.float32))
