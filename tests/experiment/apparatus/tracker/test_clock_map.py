"""Device time and session time, against simulated truth: drift, jitter, stalls, and a clock that stands still."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker import clock_map
from palpate.experiment.apparatus.tracker.clock_map import ClockState

START_NS = 10**18

drifts = st.floats(-200, 200) | st.sampled_from([ppm for off in (600.0, 2000.0, 5000.0) for ppm in (off, -off)])
seeds = st.integers(0, 2**32 - 1)


@dataclass(frozen=True)
class Reads:
    """Truth and what a driver sees of it; device time starts at `origin_us`, session time at `START_NS`."""

    device_us: NDArray[np.int64]
    true_ns: NDArray[np.int64]
    arrived_ns: NDArray[np.int64]


def simulated(
    *,
    seed: int,
    drift_ppm: float,
    duration_s: float = 10.0,
    pause_s: float = 0.004,
    jitter_us: float = 100.0,
    stalls: tuple[tuple[float, float], ...] = (),
    origin_us: int = 5_000_000,
) -> Reads:
    """Reads whose newest sample is up to one sample at 5 kHz old, with exponential jitter on top, and stalls
    (when, how long; s) that hold up every read in them until they end."""
    rng = np.random.default_rng(seed)
    true_s = np.arange(0.0, duration_s, pause_s)
    delay_s = rng.uniform(0, 200e-6, true_s.size) + rng.exponential(jitter_us * 1e-6, true_s.size)
    for begin_s, length_s in stalls:
        held = (true_s >= begin_s) & (true_s < begin_s + length_s)
        delay_s[held] = np.maximum(delay_s[held], begin_s + length_s - true_s[held])
    arrived_s = np.maximum.accumulate(true_s + delay_s)
    device_us = origin_us + np.rint(true_s * 1e6 / (1 + drift_ppm * 1e-6)).astype(np.int64)
    true_ns = START_NS + np.rint(true_s * 1e9).astype(np.int64)
    return Reads(device_us, true_ns, START_NS + np.rint(arrived_s * 1e9).astype(np.int64))


def states(reads: Reads) -> Iterator[ClockState]:
    """The state after each read."""
    device_us, arrived_ns = reads.device_us.tolist(), reads.arrived_ns.tolist()
    state = clock_map.init(device_us[0], arrived_ns[0])
    yield state
    for newest_us, at_ns in zip(device_us[1:], arrived_ns[1:], strict=True):
        state = clock_map.step(state, newest_us, at_ns)
        yield state


def follow(reads: Reads, until: int | None = None) -> ClockState:
    return list(islice(states(reads), until))[-1]


def random_stalls(seed: int, duration_s: float) -> tuple[tuple[float, float], ...]:
    rng = np.random.default_rng(seed)
    return tuple((float(begin), float(rng.uniform(0.005, 0.031))) for begin in rng.uniform(0, duration_s, 15))


@settings(max_examples=30, deadline=None)
@given(drifts, seeds, st.sampled_from([0.0016, 0.004, 0.012]))
def test_after_5_s_the_error_is_below_a_tenth_of_a_millisecond(drift_ppm: float, seed: int, pause_s: float) -> None:
    stalls = ((0.0, 0.031), *random_stalls(seed, 10.0))
    reads = simulated(seed=seed, drift_ppm=drift_ppm, pause_s=pause_s, stalls=stalls)
    late = reads.true_ns > START_NS + 5e9
    mapped_ns = [
        state.map().session_ns(device_us) if wanted else 0
        for state, device_us, wanted in zip(states(reads), reads.device_us.tolist(), late.tolist(), strict=True)
    ]
    assert np.abs(np.array(mapped_ns) - reads.true_ns)[late].max() < 100_000


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("pause_s", [0.004, 0.012])
@pytest.mark.parametrize(
    ("drift_ppm", "early_us", "late_us"),
    [(200.0, 500, 100), (600.0, 600, 100), (2000.0, 1000, 100), (5000.0, 2000, 100), (20_000.0, 5000, 2500)],
)
def test_the_newest_sample_is_mapped_well_from_the_start_whatever_the_drift(
    drift_ppm: float, early_us: float, late_us: float, sign: int, pause_s: float
) -> None:
    stalls = ((0.0, 0.031), (0.3, 0.031))
    reads = simulated(seed=4, drift_ppm=sign * drift_ppm, duration_s=70.0, pause_s=pause_s, stalls=stalls)
    mapped_ns = [s.map().session_ns(us) for s, us in zip(states(reads), reads.device_us.tolist(), strict=True)]
    error_us, at_s = np.abs(np.array(mapped_ns) - reads.true_ns) / 1e3, (reads.true_ns - START_NS) / 1e9
    assert error_us[at_s > 0.1].max() < early_us
    assert error_us[at_s > 5].max() < late_us


@settings(max_examples=30, deadline=None)
@given(drifts, seeds, st.floats(0.05, 9.9), st.floats(0.001, 0.031))
def test_a_stall_moves_nothing_by_more_than_20_microseconds(
    drift_ppm: float, seed: int, begin_s: float, length_s: float
) -> None:
    calm = follow(simulated(seed=seed, drift_ppm=drift_ppm)).map()
    stalled = follow(simulated(seed=seed, drift_ppm=drift_ppm, stalls=((begin_s, length_s),))).map()
    now_us = 5_000_000 + 10_000_000
    assert abs(stalled.session_ns(now_us) - calm.session_ns(now_us)) < 20_000


@settings(max_examples=40, deadline=None)
@given(drifts, seeds, st.integers(1, 2500))
def test_no_newest_sample_is_put_after_its_arrival(drift_ppm: float, seed: int, until: int) -> None:
    reads = simulated(seed=seed, drift_ppm=drift_ppm, stalls=random_stalls(seed, 10.0))
    newest = follow(reads, until).map()
    assert newest.session_ns(int(reads.device_us[until - 1])) <= reads.arrived_ns[until - 1]


def test_drift_and_span_are_reported() -> None:
    reads = simulated(seed=1, drift_ppm=120.0, duration_s=60.0)
    found = follow(reads).map()
    assert found.drift_ppm == pytest.approx(120.0, abs=1.0)
    assert found.span_s == pytest.approx(60.0, rel=1e-3)


def test_from_the_first_read_on_there_is_a_map() -> None:
    first = clock_map.init(700, START_NS).map()
    assert (first.session_ns(700), first.session_ns(1700)) == (START_NS, START_NS + 1_000_000)
    assert first.drift_ppm == 0.0


def test_until_drift_is_known_a_stalled_beginning_is_late_by_the_least_delay() -> None:
    reads = simulated(seed=2, drift_ppm=0.0, stalls=((0.0, 0.031),), duration_s=0.1)
    during, after = follow(reads, 4).map(), follow(reads).map()
    device_us, true_ns = int(reads.device_us[3]), int(reads.true_ns[3])
    assert 15e6 < during.session_ns(device_us) - true_ns < 31e6
    assert after.session_ns(device_us) - true_ns < 0.3e6


def test_no_resonator_drifts_so_much() -> None:
    reads = simulated(seed=3, drift_ppm=12_000.0)
    assert follow(reads).map().drift_ppm == clock_map.DRIFT_LIMIT_PPM


@given(st.lists(st.tuples(st.integers(1, 10**7), st.integers(0, 10**9)), max_size=200))
def test_simulated_time_may_stand_still(moves: list[tuple[int, int]]) -> None:
    device_us, now_ns = 0, START_NS
    state = clock_map.init(device_us, now_ns)
    for device_step_us, session_step_ns in moves:
        device_us += device_step_us
        now_ns += session_step_ns
        state = clock_map.step(state, device_us, now_ns)
        assert state.map().session_ns(device_us) <= now_ns
        assert abs(state.map().drift_ppm) <= clock_map.DRIFT_LIMIT_PPM


def test_memory_is_bounded() -> None:
    state = clock_map.init(0, START_NS)
    for i in range(1, 1000):
        state = clock_map.step(state, 1_000_000 * i, START_NS + 1_000_000_000 * i)
    assert (len(state.kept), len(state.fine)) == (clock_map.BINS, clock_map.FINE_BINS)


def ahead_ms(reads: Reads, *, jump_us: int = 0, step_s: tuple[float, float] = (2.0, 2.3)) -> float:
    """What `Pace` says of a step, with device time that jumps in its middle."""
    pace = clock_map.Pace()
    jumped = reads.true_ns - START_NS > sum(step_s) / 2 * 1e9
    for device_us, arrived_ns in zip(
        (reads.device_us + jump_us * jumped).tolist(), reads.arrived_ns.tolist(), strict=True
    ):
        pace.read(device_us, arrived_ns)
    assert pace.known
    from_us, until_us = (int(np.interp(at * 1e9, reads.true_ns - START_NS, reads.device_us)) for at in step_s)
    return pace.ahead_ms(from_us, until_us + jump_us)


@settings(max_examples=40, deadline=None)
@given(st.floats(-10_000, 10_000), seeds, st.sampled_from([0.0016, 0.012, 0.04]))
def test_no_clock_within_its_drift_is_doubted_whatever_stalls(drift_ppm: float, seed: int, pause_s: float) -> None:
    stalls = ((0.0, 0.1), (1.95, 0.1), (2.25, 0.1), *random_stalls(seed, 2.4))
    reads = simulated(seed=seed, drift_ppm=drift_ppm, duration_s=2.5, pause_s=pause_s, stalls=stalls)
    assert ahead_ms(reads) == 0.0


@pytest.mark.parametrize(("jump_us", "sign"), [(20_000, 1), (50_000, 1), (1_000_000, 1), (-20_000, -1), (-50_000, -1)])
@pytest.mark.parametrize("drift_ppm", [-5000.0, 0.0, 5000.0])
def test_a_jump_of_the_clock_within_a_step_is_seen(jump_us: int, sign: int, drift_ppm: float) -> None:
    reads = simulated(seed=1, drift_ppm=drift_ppm, duration_s=2.4, stalls=((2.1, 0.1),))
    assert np.sign(ahead_ms(reads, jump_us=jump_us)) == sign


@pytest.mark.parametrize("factor", [2.0, 1.1, 1.03, 0.97, 0.5])
def test_a_clock_that_runs_otherwise_is_seen_over_a_second(factor: float) -> None:
    reads = simulated(seed=1, drift_ppm=(1 / factor - 1) * 1e6, duration_s=2.6, stalls=((2.1, 0.1),))
    assert np.sign(ahead_ms(reads)) == np.sign(factor - 1)


def test_reads_of_less_than_a_second_do_not_know_the_clock() -> None:
    pace = clock_map.Pace()
    assert not pace.known
    for ms in range(0, 1000, 2):
        pace.read(1000 * ms, START_NS + 1_000_000 * ms)
    assert not pace.known


def test_a_pace_is_bounded_however_often_is_read() -> None:
    pace = clock_map.Pace()
    for ms in range(60_000):
        pace.read(1000 * ms, START_NS + 1_000_000 * ms)
    assert len(pace._reads) == clock_map.PACE_SLOTS
