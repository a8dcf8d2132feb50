"""How often a foot is read: moving or resting, whatever the cut of its stream into reads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment.apparatus import pace as paces
from experiment.apparatus.frames import FRAME_BYTES
from experiment.apparatus.pace import MOVED_MM, REFERENCE_US, Pace

START_US = 7_000_000
LONG_US = REFERENCE_US // 2
"""Reads come at most so far apart: twice the longest pause."""

cuts = st.lists(st.integers(1, LONG_US), min_size=1, max_size=200)
heights = st.lists(st.tuples(st.integers(1, 10**6), st.floats(-100, 100)), min_size=1, max_size=100)


def states(reads: list[tuple[int, float]]) -> Iterator[Pace]:
    """The state after each read of (device time, height)."""
    state = paces.init(*reads[0])
    yield state
    for device_us, height_mm in reads[1:]:
        state = paces.step(state, device_us, height_mm)
        yield state


def times_us(steps_us: list[int]) -> list[int]:
    return [START_US, *(START_US + np.cumsum(steps_us)).tolist()]


def test_before_the_second_read_a_foot_counts_as_moving() -> None:
    assert not paces.init(START_US, 0.0).rests


@given(cuts, st.floats(20.001, 1000), st.floats(-100, 100), st.sampled_from([1, -1]))
def test_a_foot_above_20_mm_s_never_rests_however_its_stream_is_cut(
    steps_us: list[int], speed_mm_s: float, from_mm: float, way: int
) -> None:
    at_us = times_us(steps_us)
    assert not any(s.rests for s in states([(us, from_mm + way * (us - START_US) * speed_mm_s / 1e6) for us in at_us]))


@given(cuts, st.floats(-100, 100), st.data())
def test_a_foot_that_keeps_within_a_millimetre_rests_from_its_second_reference_on(
    steps_us: list[int], about_mm: float, data: st.DataObject
) -> None:
    at_us = times_us(steps_us)
    noise_mm = data.draw(st.lists(st.floats(-0.499, 0.499), min_size=len(at_us), max_size=len(at_us)))
    reads = [(us, about_mm + mm) for us, mm in zip(at_us, noise_mm, strict=True)]
    rests = [state.rests for state in states(reads)]
    assert rests == [us - START_US > REFERENCE_US for us in at_us]


@given(cuts, st.floats(-0.499, 0.499), st.floats(1000, 10_000))
def test_a_foot_that_falls_from_rest_moves_once_it_has_fallen_two_and_a_half_millimetres(
    steps_us: list[int], reference_mm: float, a_mm_s2: float
) -> None:
    state = Pace(START_US - REFERENCE_US, reference_mm, rests=True)
    for us in times_us(steps_us):
        fallen_mm = a_mm_s2 / 2 * ((us - START_US) / 1e6) ** 2
        state = paces.step(state, us, -fallen_mm)
        if fallen_mm >= 2.5:
            assert not state.rests


@given(heights)
def test_it_moves_where_the_height_is_far_from_the_reference(moves: list[tuple[int, float]]) -> None:
    reads = list(zip(np.cumsum([step_us for step_us, _ in moves]).tolist(), [mm for _, mm in moves], strict=True))
    for (before, after), (device_us, height_mm) in zip(pairwise(states(reads)), reads[1:], strict=True):
        if abs(height_mm - before.height_mm) >= MOVED_MM:
            assert after == Pace(device_us, height_mm, rests=False)
        assert 0 <= device_us - after.device_us <= REFERENCE_US
        assert abs(height_mm - after.height_mm) < MOVED_MM
        assert after.rests <= (before.rests or device_us - before.device_us > REFERENCE_US)


@given(heights, st.data())
def test_reads_near_a_young_reference_change_nothing(moves: list[tuple[int, float]], data: st.DataObject) -> None:
    reads = list(zip(np.cumsum([step_us for step_us, _ in moves]).tolist(), [mm for _, mm in moves], strict=True))
    *_, state = states(reads)
    left_us = REFERENCE_US - (reads[-1][0] - state.device_us)
    for step_us in data.draw(st.lists(st.integers(0, left_us), max_size=5)):
        assert paces.step(state, reads[-1][0] + step_us, state.height_mm) is state


@given(st.integers(1000, 5000), st.integers(50, 200))
def test_no_pause_is_above_its_bound(rate_hz: int, stall_ms: int) -> None:
    moving, resting = paces.pauses(rate_hz=rate_hz, stall_ms=stall_ms)
    assert 1.6e6 <= moving.ns <= 6e6
    assert moving.ns <= resting.ns <= 12e6
    assert resting.ns == moving.ns or resting.ns <= 0.06e6 * stall_ms + 1


@pytest.mark.parametrize(
    ("rate_hz", "stall_ms", "moving_ms", "resting_ms"),
    [(1000, 200, 1.6, 12.0), (5000, 200, 6.0, 12.0), (1000, 50, 1.6, 3.0), (5000, 50, 6.0, 6.0), (5000, 150, 6.0, 9.0)],
)
def test_the_pauses_of_a_rig(rate_hz: int, stall_ms: int, moving_ms: float, resting_ms: float) -> None:
    pauses = paces.pauses(rate_hz=rate_hz, stall_ms=stall_ms)
    assert (pauses.moving.ns / 1e6, pauses.resting.ns / 1e6) == pytest.approx((moving_ms, resting_ms), abs=1e-5)


@given(st.integers(1000, 5000), st.integers(50, 200))
def test_what_a_pause_brings_is_no_backlog_and_three_times_that_is(rate_hz: int, stall_ms: int) -> None:
    for pause in paces.pauses(rate_hz=rate_hz, stall_ms=stall_ms):
        brought = pause.ns * 1e-9 * rate_hz
        assert brought + 1 < pause.calm_bytes / FRAME_BYTES < 3 * brought + 3
