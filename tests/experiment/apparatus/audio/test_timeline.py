"""Frames and session times: callbacks that come late, clocks that part, and frames that are lost."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus.audio import stream
from palpate.experiment.apparatus.audio.stream import IN_A_ROW, WINDOW, Timeline
from tests.experiment.apparatus.audio import interleaved

RATE_HZ, BLOCK = 48_000, 256
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = BLOCK / RATE_HZ * 1e9


def ran(late_ms: np.ndarray, *, drift: float = 0.0) -> Timeline:
    """A timeline whose callbacks came this late, on a device whose crystal is off by `drift`."""
    line = Timeline(rate_hz=RATE_HZ, block=BLOCK)
    for number, late in enumerate(late_ms):
        line.note(number * BLOCK, START_NS + round(number * PERIOD_NS * (1 + drift) + late * 1e6))
    return line


def test_late_callbacks_do_not_move_it() -> None:
    rng = np.random.default_rng(1)
    late_ms = rng.exponential(0.2, 1000)
    late_ms[500:502] = 20.0
    line = ran(late_ms)
    frame = 1000 * BLOCK
    # The least of 64 exponentials of mean 0.2 ms is below 0.05 ms but once in ten million.
    assert abs(line.ns_of(frame) - (START_NS + round(1000 * PERIOD_NS))) < 50_000
    assert line.frame_at(line.ns_of(frame)) == frame
    assert line.gaps == 0
    assert line.fit().median_ms == pytest.approx(0.2 * np.log(2), abs=0.1)


@given(late_us=st.lists(st.integers(0, 1300), min_size=1, max_size=3 * WINDOW), frame=st.integers(-(10**6), 10**6))
def test_it_rests_on_the_earliest_of_the_last_callbacks(late_us: list[int], frame: int) -> None:
    line = ran(np.array(late_us) / 1e3)
    origin_ns = START_NS + min(late_us[-WINDOW:]) * 1000
    assert line.frame_at(round(origin_ns + frame * PERIOD_NS / BLOCK)) == frame
    assert abs(line.ns_of(len(late_us) * BLOCK) - origin_ns - len(late_us) * PERIOD_NS) <= 2


@pytest.mark.parametrize("drift", [-100e-6, 100e-6])
def test_it_follows_a_crystal_that_is_off(drift: float) -> None:
    count = 20_000
    line = ran(np.zeros(count), drift=drift)
    truth_ns = START_NS + round((count - 1) * PERIOD_NS * (1 + drift))
    # A line that rests on the last 64 callbacks is behind by no more than they part.
    assert abs(line.ns_of((count - 1) * BLOCK) - truth_ns) <= abs(drift) * WINDOW * PERIOD_NS
    assert line.gaps == 0


@pytest.mark.parametrize("lost_ms", [2.0, 20.0, 3000.0])
def test_lost_frames_are_noticed_at_once(lost_ms: float) -> None:
    late_ms = np.zeros(200)
    late_ms[150:] = lost_ms
    line = ran(late_ms)
    assert line.gaps == 1
    assert line.ns_of(200 * BLOCK) == START_NS + round(200 * PERIOD_NS + lost_ms * 1e6)


@pytest.mark.parametrize("lost_ms", [2.0, 94.0])
def test_a_gap_moves_no_frame_that_was_taken_before_it(lost_ms: float) -> None:
    late_ms = np.zeros(400)
    late_ms[150:] = lost_ms
    line = ran(late_ms)
    taken = np.arange(400)
    found_ns = np.array([line.ns_of(int(callback) * BLOCK) for callback in taken])
    truth_ns = START_NS + np.round(taken * PERIOD_NS + late_ms * 1e6)
    assert np.max(np.abs(found_ns - truth_ns)) <= 1


LOST_MS = 20.0
BEFORE, AFTER = START_NS + round(100 * PERIOD_NS), START_NS + round(100 * PERIOD_NS + LOST_MS * 1e6)


def about_to_find_a_gap() -> Timeline:
    late_ms = np.zeros(99 + IN_A_ROW)
    late_ms[100:] = LOST_MS
    return ran(late_ms)


def goes_on(line: Timeline, callbacks: range) -> None:
    for number in callbacks:
        line.note(number * BLOCK, START_NS + round(number * PERIOD_NS + LOST_MS * 1e6))


READERS: list[Callable[[Timeline], object]] = [
    Timeline.fit,
    lambda line: line.frame_at(BEFORE),
    lambda line: line.ns_of(100 * BLOCK),
    lambda line: line.ns_of(102 * BLOCK),
]


def test_whoever_reads_while_a_gap_is_found_reads_the_line_before_it_or_the_one_after() -> None:
    line = about_to_find_a_gap()
    read: list[int] = []

    def look(_point: int) -> None:
        line.fit()
        read.extend((line.ns_of(100 * BLOCK), line.ns_of(102 * BLOCK) - round(2 * PERIOD_NS)))
        assert line.frame_at(BEFORE) in (100 * BLOCK, 100 * BLOCK - round(LOST_MS / 1e3 * RATE_HZ))

    interleaved.points((stream,), lambda: goes_on(line, range(103, 104)), look)
    assert line.gaps == 1
    assert all(min(abs(each - BEFORE), abs(each - AFTER)) <= 2 for each in read)
    assert abs(read[0] - BEFORE) <= 2
    assert abs(line.ns_of(100 * BLOCK) - AFTER) <= 2


@pytest.mark.parametrize("callbacks", [range(103, 104), range(103, 103 + 2 * WINDOW)])
@pytest.mark.parametrize("reader", READERS)
def test_a_gap_that_is_found_while_somebody_reads_leaves_something_to_read(
    reader: Callable[[Timeline], object], callbacks: range
) -> None:
    still = about_to_find_a_gap()
    for point in range(interleaved.points((stream,), lambda: reader(still), lambda _: None)):
        line = about_to_find_a_gap()

        def meanwhile(at: int, line: Timeline = line, point: int = point) -> None:
            if at == point:
                goes_on(line, callbacks)

        interleaved.points((stream,), partial(reader, line), meanwhile)
        assert line.gaps == 1
