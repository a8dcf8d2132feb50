"""Samples that were lost on their way from an accelerometer: seen by when the others came, and told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from palpate.experiment.apparatus.panel.accelerometer import LOST_S, RING_S, SLOW, Gap, Listening
from palpate.experiment.rehearsal.clock import ManualClock

RATE_HZ, PIECE_S, LONG_S, TAKE_S = 1000, 0.01, 3.0, 2.0
START_NS = 10**15

GAPS_S = [0.005, 0.008, 0.05, 0.25]


class Real(ManualClock):
    """A clock of the machine's, which a test moves."""

    simulated = False


def heard(
    *,
    gaps_s: dict[float, float] | None = None,
    held_up_s: float = 0.0,
    lagging_s: float = 0.0,
    lags_for_s: float = 0.3,
    ppm: float = 0.0,
    lasts_s: float = LONG_S,
    clock: ManualClock | None = None,
) -> Listening:
    """A stream whose samples are their own times, s, in pieces that are each up to 2 ms late.

    It has gaps of some lengths after some times; from 2 s on pieces are held up until all come at once, or each of them
    for a while lags by as much.
    """
    listening = Listening(round(TAKE_S * RATE_HZ), rate_hz=RATE_HZ, clock=clock or Real(START_NS))
    rng = np.random.default_rng(1)
    times_s = np.arange(round(lasts_s * RATE_HZ)) / RATE_HZ
    for at_s, gap_s in (gaps_s or {}).items():
        times_s = times_s[(times_s < at_s - 1e-9) | (times_s >= at_s + gap_s - 1e-9)]
    for piece in np.split(times_s, range(10, times_s.size, round(PIECE_S * RATE_HZ))):
        ends_s = (piece[-1] + 1 / RATE_HZ) * (1 + ppm * 1e-6)
        arrived_s = max(ends_s, 2.0 + held_up_s) if ends_s > 2.0 else ends_s
        arrived_s += lagging_s * (2.0 < ends_s < 2.0 + lags_for_s)
        listening.add(piece.astype(np.float32), START_NS + round((arrived_s + rng.uniform(0, 0.002)) * 1e9))
    return listening


def from_s(listening: Listening, begin_s: float, lasts_s: float = 0.5) -> tuple[float, tuple[Gap, ...]]:
    """How late the last sample is of those that are given from a time on, s, and the gaps in them."""
    count = round(lasts_s * RATE_HZ)
    found = listening.samples_from(START_NS + round(begin_s * 1e9), count)
    assert not isinstance(found, str)
    samples, gaps = found
    assert samples.size == count
    for gap in gaps:
        assert not samples[round(gap.at_s * RATE_HZ) : round((gap.at_s + gap.lasts_s) * RATE_HZ)].any()
    return float(samples[-1]) - (begin_s + lasts_s - 1 / RATE_HZ), gaps


@pytest.mark.parametrize("gap_s", GAPS_S)
def test_what_follows_a_gap_keeps_its_time_and_the_take_with_it_is_kept(gap_s: float) -> None:
    listening = heard(gaps_s={1.0: gap_s})
    for begin_s, gaps in ((0.4, 0), (0.9, 1), (1.1 + gap_s, 0)):
        late_s, found = from_s(listening, begin_s)
        assert late_s == pytest.approx(0.0, abs=0.003)
        assert len(found) == gaps
        for gap in found:
            assert gap.at_s == pytest.approx(1.0 - begin_s, abs=0.012)
            assert gap.lasts_s == pytest.approx(gap_s, abs=0.002)


def test_each_of_several_gaps_is_told() -> None:
    listening = heard(gaps_s={0.5: 0.05, 1.0: 0.008, 1.5: 0.25})
    late_s, gaps = from_s(listening, 0.4, 1.8)
    assert late_s == pytest.approx(0.0, abs=0.004)
    assert [gap.lasts_s for gap in gaps] == pytest.approx([0.05, 0.008, 0.25], abs=0.002)


@pytest.mark.parametrize("gap_s", GAPS_S)
def test_a_take_is_whole_with_a_gap_in_it(gap_s: float) -> None:
    for gaps_s, number in (({}, 0), ({1.0: gap_s}, 1)):
        armed = heard(gaps_s=gaps_s).armed()
        assert not isinstance(armed, str)
        taken = heard(gaps_s=gaps_s).take(START_NS + 8 * 10**8, START_NS + 95 * 10**7, level=0.81)
        assert not isinstance(taken, str)
        assert taken[0] is not None
        assert [len(gaps) for _, gaps in (armed, taken[0])] == [number, number]
        assert armed[0].size == TAKE_S * RATE_HZ


@pytest.mark.parametrize(
    "stream",
    [
        {"held_up_s": 0.4},
        {"lagging_s": 0.008},
        {"ppm": 200.0, "lasts_s": RING_S * 2},
        {"ppm": -200.0, "lasts_s": RING_S * 2},
        {"gaps_s": {1.0: LOST_S / 2}},
    ],
)
def test_what_is_held_up_and_a_clock_that_drifts_are_no_gap(stream: dict[str, Any]) -> None:
    late_s, gaps = from_s(heard(**stream), stream.get("lasts_s", LONG_S) - 0.6)
    assert late_s == pytest.approx(0.0, abs=0.006)
    assert not gaps


@pytest.mark.parametrize("slow", [-SLOW, -0.003, 0.003, 0.01, SLOW])
@pytest.mark.parametrize("gaps_s", [{}, {6.0: 0.05}], ids=["whole", "a gap"])
def test_a_sensor_with_a_slow_or_fast_clock_loses_what_was_lost_alone(slow: float, gaps_s: dict[float, float]) -> None:
    """Two parts in a hundred are 16 ms after eight tenths of a second."""
    _, gaps = from_s(heard(gaps_s=gaps_s, ppm=slow * 1e6, lasts_s=9.0), 1.0, 7.5)
    assert [gap.lasts_s for gap in gaps] == pytest.approx(list(gaps_s.values()), abs=0.01)


def test_what_lags_for_a_while_behind_a_gap_does_not_lengthen_it_for_good() -> None:
    late_s, gaps = from_s(heard(gaps_s={2.0: 0.05}, lagging_s=0.02), 1.8, 1.0)
    assert late_s == pytest.approx(0.0, abs=0.004)
    assert [gap.lasts_s for gap in gaps] == pytest.approx([0.05], abs=0.003)


def test_a_gap_that_was_none_leaves_every_sample_there_though_its_zeros_are_no_longer_held() -> None:
    lasts_s = RING_S + 9
    listening = heard(lagging_s=0.02, lags_for_s=RING_S + 5, lasts_s=lasts_s)
    late_s, gaps = from_s(listening, lasts_s - 0.501)
    assert late_s == pytest.approx(0.0, abs=0.003)
    assert not gaps


def test_in_simulated_time_nothing_is_late() -> None:
    assert not from_s(heard(gaps_s={1.0: 0.1}, clock=ManualClock(START_NS)), 1.1)[1]
