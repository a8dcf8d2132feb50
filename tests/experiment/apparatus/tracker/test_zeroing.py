"""Zeroing: the offset of a foot at rest, and what is no zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment.apparatus.tracker import zeroing
from experiment.apparatus.tracker.frames import Samples
from experiment.apparatus.tracker.zeroing import ZeroedTracker
from experiment.clock import ManualClock
from experiment.errors import TrackerError, TrackerStopped
from tests.experiment.session.scripted import ScriptedTracker, rest_samples


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
        (np.linspace(0, 2, 500), r"heights that spread by 0.58 mm; allowed: at most 0.5 mm; rest the foot"),
        (np.full(500, 40.0), r"an offset of 40.00 mm; allowed: at most 3 mm either way \(tracker.zeroing_mm\); rest"),
        (np.full(500, -3.5), r"an offset of -3.50 mm"),
        (np.zeros(1), r"got 1 samples; allowed: 2 or more"),
    ],
)
def test_what_is_no_zero_is_refused(heights_mm: np.ndarray, message: str) -> None:
    with pytest.raises(TrackerError, match=f"zeroing: got {message}|zeroing: {message}"):
        zeroing.zero(heights_mm, contact_mm=0.0, farthest_mm=3.0)


class Obedient:
    """Implements `Rester`: keeps what it was told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def rest(self, *, why: str) -> None:
        self.told.append(why)


def zeroed(*reads: Samples | TrackerStopped) -> ZeroedTracker:
    tracker = ScriptedTracker(reads, clock=ManualClock(0), comes_back=True)
    return ZeroedTracker(tracker, contact_mm=0.0, farthest_mm=3.0, samples=200)


def test_a_foot_that_moves_or_hangs_in_the_air_is_read_again() -> None:
    moving = replace(rest_samples(0, 0.0), height_mm=np.linspace(5, 0, 200))
    tracker = zeroed(moving, rest_samples(0, 40.0), rest_samples(0, 1.25), rest_samples(0, 21.25))
    rester = Obedient()
    told = rester.told
    assert tracker.due
    assert tracker.settle(rester).offset_mm == 1.25
    assert told[0] == ""
    assert told[1].startswith("zeroing: got heights that spread by 1.45 mm; allowed: at most 0.5 mm; rest the foot")
    assert told[2].startswith("zeroing: got an offset of 40.00 mm")
    assert not tracker.due
    assert tracker.read().height_mm[0] == 20.0


def test_a_tracker_that_came_back_is_zeroed_anew() -> None:
    tracker = zeroed(rest_samples(0, 1.25), rest_samples(0, 30.0), rest_samples(0, -0.5), rest_samples(0, 20.0))
    tracker.settle(Obedient())
    tracker.reconnect(1.0)
    assert tracker.due
    assert tracker.read().height_mm[0] == 30.0
    assert tracker.settle(Obedient()).offset_mm == -0.5
    assert tracker.read().height_mm[0] == 20.5


def test_a_tracker_that_stops_ends_a_zeroing() -> None:
    tracker = zeroed(TrackerStopped("tracker at scripted: no frame for 200 ms"))
    with pytest.raises(TrackerStopped, match="no frame"):
        tracker.settle(Obedient())
    assert tracker.due
