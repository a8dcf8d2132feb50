"""What a session asks of a calibrated tracker: its age, readings within it, and where a foot at rest is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker import zeroing
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.errors import RigError, TrackerError, TrackerStopped
from palpate.experiment.rehearsal.clock import ManualClock
from tests.approved import Refuses
from tests.experiment.session.scripted import ScriptedTracker, rest_samples

TODAY = date(2026, 5, 4)


@pytest.fixture(scope="session")
def rehearsal_file(repository_root: Path) -> Path:
    return repository_root / "protocols" / "rigs" / "rehearsal.toml"


@pytest.fixture(scope="session")
def rehearsal(rehearsal_file: Path) -> Rig:
    return rigs.load(rehearsal_file)


def real(rig: Rig, **tracker: object) -> Rig:
    identity = rig.rig.model_copy(update={"simulated": False})
    return rig.model_copy(update={"rig": identity, "tracker": tracker_of(rig).model_copy(update=tracker)})


class Heights:
    """Implements `Tracker`: a foot at the same heights for ever."""

    counts = LinkCounts()
    clock_map = ClockMap(anchor_us=0, anchor_ns=0)

    def __init__(self, heights_mm: Iterable[float]) -> None:
        self._heights_mm = np.array(list(heights_mm), dtype=float)

    def drain(self) -> None: ...

    def read(self) -> Samples:
        n = self._heights_mm.size
        return Samples(np.arange(n), self._heights_mm, bytes(n), np.arange(n) + 1, 0)

    def reconnect(self, timeout_s: float) -> None: ...

    def close(self) -> None: ...


def zeroed(*reads: Samples | TrackerStopped) -> ZeroedTracker:
    tracker = ScriptedTracker(reads, clock=ManualClock(0), comes_back=True)
    return ZeroedTracker(tracker, contact_mm=0.0, farthest_mm=3.0, samples=200)


def test_the_age_of_a_calibration_is_checked(rehearsal: Rig, refuses: Refuses) -> None:
    zeroing.check_age(rehearsal, TODAY)
    for day_of in (date(2026, 4, 4), TODAY):
        zeroing.check_age(real(rehearsal, calibrated_on=day_of, calibration_days=30), TODAY)
    with refuses(RigError):
        zeroing.check_age(real(rehearsal, calibrated_on=date(2026, 4, 3), calibration_days=30), TODAY)
    with refuses(RigError):
        zeroing.check_age(real(rehearsal, calibrated_on=date(2026, 5, 5), calibration_days=30), TODAY)
    with refuses(RigError):
        zeroing.check_age(real(rehearsal), TODAY)


def test_a_sensor_beyond_its_calibration_is_refused(rehearsal: Rig) -> None:
    zeroing.check_reading(Heights([70.0, 69.0, 100.0]), tracker_of(rehearsal))
    for held in (-5.0, 100.0):
        with pytest.raises(
            TrackerError, match=f"at or beyond {held:g} mm, .*allowed: -5 to 100 mm; check that the sensor"
        ):
            zeroing.check_reading(Heights([held, held, 30.0]), tracker_of(rehearsal))


@given(st.floats(-2.5, 2.5), st.integers(0, 1000))
def test_the_offset_of_a_foot_at_rest_is_found(offset_mm: float, seed: int) -> None:
    rested_mm = 1.0 + offset_mm + np.random.default_rng(seed).normal(0, 0.1, 500)
    found = zeroing.zero(rested_mm, contact_mm=1.0, farthest_mm=3.0)
    # The median of n normal values has the standard error 1.25 sigma / sqrt(n), 0.0056 mm; six of them.
    assert found.offset_mm == pytest.approx(offset_mm, abs=0.034)
    assert found.spread_mm == pytest.approx(0.1, rel=0.2)
    assert found.samples == 500


def test_heights_count_from_where_the_foot_rested() -> None:
    found = zeroing.zero(np.full(100, 0.75), contact_mm=0.0, farthest_mm=3.0)
    samples = Samples(np.arange(2), np.array([0.75, 20.75]), b"ab", np.array([1, 2]), 7)
    applied = found.applied(samples)
    assert applied.height_mm.tolist() == [0.0, 20.0]
    assert (applied.raw, applied.arrived_ns) == (samples.raw, 7)


@pytest.mark.parametrize(
    ("heights_mm", "message"),
    [
        (np.linspace(0, 2, 500), r"heights that vary by 0.58 mm; allowed: at most 0.5 mm; rest the foot"),
        (np.full(500, 40.0), r"an offset of 40.00 mm; allowed: at most 3 mm up or down \(tracker.zeroing_mm\); rest"),
        (np.full(500, -3.5), r"an offset of -3.50 mm"),
        (np.zeros(1), r"got 1 samples; allowed: 2 or more"),
    ],
)
def test_what_is_no_zero_is_refused(heights_mm: np.ndarray, message: str) -> None:
    with pytest.raises(TrackerError, match=f"zeroing: got {message}|zeroing: {message}"):
        zeroing.zero(heights_mm, contact_mm=0.0, farthest_mm=3.0)


def test_a_foot_that_moves_or_hangs_in_the_air_is_read_again(approved: SnapshotAssertion) -> None:
    moving = replace(rest_samples(0, 0.0), height_mm=np.linspace(5, 0, 200))
    tracker = zeroed(moving, rest_samples(0, 40.0), rest_samples(0, 1.25), rest_samples(0, 21.25))
    told: list[str] = []
    assert tracker.zero is None
    assert tracker.settle(told.append).offset_mm == 1.25
    assert told[0] == ""
    assert told[1:3] == approved
    assert tracker.zero is not None
    assert tracker.read().height_mm[0] == 20.0


def test_a_tracker_that_came_back_is_zeroed_anew() -> None:
    tracker = zeroed(rest_samples(0, 1.25), rest_samples(0, 30.0), rest_samples(0, -0.5), rest_samples(0, 20.0))
    tracker.settle(str)
    tracker.reconnect(1.0)
    assert tracker.zero is None
    assert tracker.read().height_mm[0] == 30.0
    assert tracker.settle(str).offset_mm == -0.5
    assert tracker.read().height_mm[0] == 20.5


def test_a_tracker_that_stops_ends_a_zeroing() -> None:
    tracker = zeroed(TrackerStopped("tracker at scripted: no frame for 200 ms"))
    with pytest.raises(TrackerStopped, match="no frame"):
        tracker.settle(str)
    assert tracker.zero is None
