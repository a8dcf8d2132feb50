"""How often a foot is read: falling or not, whatever the cut of its stream into reads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment.apparatus.tracker import serial_tracker
from experiment.apparatus.tracker.frames import FRAME_BYTES
from experiment.apparatus.tracker.gate import Gate
from experiment.apparatus.tracker.landing import LandingPredictor
from experiment.apparatus.tracker.serial_tracker import MOVED_MM, REFERENCE_US, RISEN_MM, Pace
from experiment.protocol.models import Step

START_US = 7_000_000
STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
NOISE_MM = 0.1
LOWEST_MM = 2.0
"""Where a foot turns back, above the panel."""

LONG_US = REFERENCE_US // 2
"""Reads come at most so far apart: twice the longest pause."""

cuts = st.lists(st.integers(1, LONG_US), min_size=1, max_size=200)
heights = st.lists(st.tuples(st.integers(1, 10**6), st.floats(-100, 100)), min_size=1, max_size=100)


def states(reads: list[tuple[int, float]]) -> Iterator[Pace]:
    """The state after each read of (device time, height)."""
    state = serial_tracker.init(*reads[0])
    yield state
    for device_us, height_mm in reads[1:]:
        state = serial_tracker.step(state, device_us, height_mm)
        yield state


def times_us(steps_us: list[int]) -> list[int]:
    return [START_US, *(START_US + np.cumsum(steps_us)).tolist()]


def test_before_the_second_read_a_foot_counts_as_falling() -> None:
    assert serial_tracker.init(START_US, 0.0).falls


@given(cuts, st.floats(20.001, 1000), st.floats(-100, 100))
def test_a_foot_that_falls_faster_than_20_mm_s_is_seen_to_however_its_stream_is_cut(
    steps_us: list[int], speed_mm_s: float, from_mm: float
) -> None:
    at_us = times_us(steps_us)
    assert all(s.falls for s in states([(us, from_mm - (us - START_US) * speed_mm_s / 1e6) for us in at_us]))


@given(cuts, st.floats(1, 1000), st.floats(-100, 100))
def test_a_foot_that_rises_does_not_fall_from_its_third_millimetre_or_second_reference_on(
    steps_us: list[int], speed_mm_s: float, from_mm: float
) -> None:
    at_us = times_us(steps_us)
    reads = [(us, from_mm + (us - START_US) * speed_mm_s / 1e6) for us in at_us]
    risen = [mm - from_mm >= RISEN_MM or us - START_US > REFERENCE_US for us, mm in reads]
    assert [not state.falls for state in states(reads)] == risen


@given(cuts, st.floats(0, 0.1), st.floats(1000, 10_000))
def test_a_foot_that_turns_to_fall_does_so_once_it_is_3_mm_below_its_highest_reading(
    steps_us: list[int], rises_s: float, a_mm_s2: float
) -> None:
    reads = [(us, -a_mm_s2 / 2 * ((us - START_US) / 1e6 - rises_s) ** 2) for us in times_us(steps_us)]
    highest_mm = -np.inf
    for state, (_, height_mm) in zip(states(reads), reads, strict=True):
        highest_mm = max(highest_mm, height_mm)
        if height_mm <= highest_mm - 3.0:
            assert state.falls


@given(cuts, st.floats(-100, 100), st.data())
def test_a_foot_that_keeps_within_a_millimetre_rests_from_its_second_reference_on(
    steps_us: list[int], about_mm: float, data: st.DataObject
) -> None:
    at_us = times_us(steps_us)
    noise_mm = data.draw(st.lists(st.floats(-0.499, 0.499), min_size=len(at_us), max_size=len(at_us)))
    reads = [(us, about_mm + mm) for us, mm in zip(at_us, noise_mm, strict=True)]
    rests = [not state.falls for state in states(reads)]
    assert rests == [us - START_US > REFERENCE_US for us in at_us]


@given(cuts, st.floats(-0.499, 0.499), st.floats(1000, 10_000))
def test_a_foot_that_falls_from_rest_does_so_once_it_has_fallen_two_and_a_half_millimetres(
    steps_us: list[int], reference_mm: float, a_mm_s2: float
) -> None:
    state = Pace(START_US - REFERENCE_US, reference_mm, falls=False)
    for us in times_us(steps_us):
        fallen_mm = a_mm_s2 / 2 * ((us - START_US) / 1e6) ** 2
        state = serial_tracker.step(state, us, -fallen_mm)
        if fallen_mm >= 2.5:
            assert state.falls


@given(heights)
def test_it_falls_or_rises_where_the_height_is_far_from_the_reference(moves: list[tuple[int, float]]) -> None:
    reads = list(zip(np.cumsum([step_us for step_us, _ in moves]).tolist(), [mm for _, mm in moves], strict=True))
    for (before, after), (device_us, height_mm) in zip(pairwise(states(reads)), reads[1:], strict=True):
        moved_mm = height_mm - before.height_mm
        if moved_mm <= -MOVED_MM or moved_mm >= (RISEN_MM if before.falls else MOVED_MM):
            assert after == Pace(device_us, height_mm, falls=height_mm < before.height_mm)
        else:
            assert after.falls == (before.falls and device_us - before.device_us <= REFERENCE_US)
        assert 0 <= device_us - after.device_us <= REFERENCE_US
        assert -MOVED_MM < height_mm - after.height_mm < (RISEN_MM if after.falls else MOVED_MM)


@given(heights, st.data())
def test_reads_near_a_young_reference_change_nothing(moves: list[tuple[int, float]], data: st.DataObject) -> None:
    reads = list(zip(np.cumsum([step_us for step_us, _ in moves]).tolist(), [mm for _, mm in moves], strict=True))
    *_, state = states(reads)
    left_us = REFERENCE_US - (reads[-1][0] - state.device_us)
    for step_us in data.draw(st.lists(st.integers(0, left_us), max_size=5)):
        assert serial_tracker.step(state, reads[-1][0] + step_us, state.height_mm) is state


@given(st.integers(1000, 5000), st.integers(50, 200))
def test_no_pause_is_above_its_bound(rate_hz: int, stall_ms: int) -> None:
    falling, calm = serial_tracker.pauses(rate_hz=rate_hz, stall_ms=stall_ms)
    assert 1.6e6 <= falling.ns <= 6e6
    assert falling.ns <= calm.ns <= 12e6
    assert calm.ns == falling.ns or calm.ns <= 0.06e6 * stall_ms + 1


@pytest.mark.parametrize(
    ("rate_hz", "stall_ms", "falling_ms", "calm_ms"),
    [(1000, 200, 1.6, 12.0), (5000, 200, 6.0, 12.0), (1000, 50, 1.6, 3.0), (5000, 50, 6.0, 6.0), (5000, 150, 6.0, 9.0)],
)
def test_the_pauses_of_a_rig(rate_hz: int, stall_ms: int, falling_ms: float, calm_ms: float) -> None:
    pauses = serial_tracker.pauses(rate_hz=rate_hz, stall_ms=stall_ms)
    assert (pauses.falling.ns / 1e6, pauses.calm.ns / 1e6) == pytest.approx((falling_ms, calm_ms), abs=1e-5)


@given(st.integers(1000, 5000), st.integers(50, 200))
def test_what_a_pause_brings_is_no_backlog_and_three_times_that_is(rate_hz: int, stall_ms: int) -> None:
    for pause in serial_tracker.pauses(rate_hz=rate_hz, stall_ms=stall_ms):
        brought = pause.ns * 1e-9 * rate_hz
        assert brought + 1 < pause.calm_bytes / FRAME_BYTES < 3 * brought + 3


@pytest.mark.parametrize("rate_hz", [1000, 5000])
@pytest.mark.parametrize("speed_mm_s", [50, 100, 200, 400])
@pytest.mark.parametrize("turns_mm_s2", [5_000, 20_000])
@pytest.mark.parametrize("seed", range(3))
def test_a_foot_that_turned_back_counts_as_falling_until_the_prediction_knows(
    rate_hz: int, speed_mm_s: int, turns_mm_s2: int, seed: int
) -> None:
    """It falls at its speed, and is braked and sent up again just above the panel."""
    rng = np.random.default_rng(seed)
    us = np.arange(-200_000, 100_000, 1_000_000 // rate_hz)
    turned_s = us / 1e6
    left_s = speed_mm_s / turns_mm_s2
    mm = LOWEST_MM + np.where(
        turned_s < -left_s,
        turns_mm_s2 / 2 * left_s**2 - speed_mm_s * (turned_s + left_s),
        turns_mm_s2 / 2 * turned_s**2,
    )
    predictor, gate = LandingPredictor(STEP, noise_mm=NOISE_MM), Gate(0, 0, speed_mm_s, 0)
    falling, pace = predictor.init(), None
    every_us = round(serial_tracker.pauses(rate_hz=rate_hz, stall_ms=200).falling.ns / 1e3)
    read_us = int(us[0]) + int(rng.integers(every_us))
    turned = False
    for at_us, height_mm in zip(us.tolist(), (mm + rng.normal(0, NOISE_MM, us.size)).tolist(), strict=True):
        falling = predictor.step(falling, at_us, height_mm)
        if at_us < read_us:
            continue
        read_us = at_us + every_us
        pace = serial_tracker.init(at_us, height_mm) if pace is None else serial_tracker.step(pace, at_us, height_mm)
        if falling is not None and height_mm < STEP.gate_bottom_mm:
            turned = turned or bool(predictor.hesitates(falling, gate))
            assert turned or pace.falls
    assert turned
    assert pace is not None
    assert not pace.falls


@pytest.mark.parametrize(("rate_hz", "noise_mm"), [(1000, 0.4), (5000, 0.4)])
@pytest.mark.parametrize("speed_mm_s", [50, 100, 200, 400])
def test_a_noisy_sensor_does_not_make_a_falling_foot_rise(rate_hz: int, noise_mm: float, speed_mm_s: int) -> None:
    rng = np.random.default_rng(0)
    every_us = round(serial_tracker.pauses(rate_hz=rate_hz, stall_ms=200).falling.ns / 1e3)
    for _ in range(50):
        reads_us = np.arange(0, round(30e6 / speed_mm_s), every_us)
        mm = 30 - reads_us * speed_mm_s / 1e6 + rng.normal(0, noise_mm, reads_us.size)
        assert all(state.falls for state in states(list(zip(reads_us.tolist(), mm.tolist(), strict=True))))
