"""Bootstrap over participants: against scipy, and where it has no interval."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from analysis.statistics.exact import NotDefined
from analysis.statistics.inference import LEAST, RESAMPLES, bca, leave_one_out, mean_interval, resamples

RATIOS = np.array([2, 2, 5, 4, 5, 3, 0, 3, 3, 3, 3, 5, 1, 2, 9]) / 10


def test_the_interval_is_that_of_scipy_within_its_noise() -> None:
    expected = stats.bootstrap((RATIOS,), np.mean, n_resamples=40_000, method="BCa", rng=np.random.default_rng(1))
    found = mean_interval(RATIOS, resamples(RATIOS.size, RESAMPLES, np.random.default_rng(2)))
    assert (found.low, found.high) == pytest.approx(tuple(expected.confidence_interval), abs=0.012)


def test_on_the_same_resamples_it_is_that_of_scipy() -> None:
    drawn = resamples(RATIOS.size, 2000, np.random.default_rng(3)) @ RATIOS / RATIOS.size
    left_out = leave_one_out(RATIOS.size) @ RATIOS / (RATIOS.size - 1)
    first = stats.bootstrap((RATIOS,), np.mean, n_resamples=0, bootstrap_result=_Drawn(drawn), method="BCa")
    found = bca(float(RATIOS.mean()), drawn, left_out)
    assert (found.low, found.high) == pytest.approx(tuple(first.confidence_interval), abs=2e-3)


class _Drawn:
    """Resamples handed to scipy, which takes those of an earlier call."""

    def __init__(self, drawn: np.ndarray) -> None:
        self.bootstrap_distribution = drawn


def test_a_resample_has_as_many_participants() -> None:
    weights = resamples(7, 100, np.random.default_rng(0))
    assert set(weights.sum(axis=1).tolist()) == {7}
    assert (leave_one_out(3) == [[0, 1, 1], [1, 0, 1], [1, 1, 0]]).all()


def test_it_covers_about_as_often_as_it_says() -> None:
    """Ratios of 20 participants, binomial with one share: 95 % nominal; 400 tries know their rate to 2 SE = 3.5 %."""
    rng = np.random.default_rng(8)
    hits = 0
    for _ in range(400):
        values = rng.binomial(10, rng.beta(6, 4, size=20)) / 10
        found = mean_interval(values, resamples(20, 1999, rng))
        hits += found.low <= 0.6 <= found.high
    assert 0.88 <= hits / 400 <= 0.98


def test_without_variance_there_is_no_interval() -> None:
    with pytest.raises(NotDefined, match="no variance"):
        mean_interval(np.full(6, 0.4), resamples(6, 99, np.random.default_rng(0)))


@pytest.mark.parametrize("count", [0, 1, LEAST - 1])
def test_too_few_participants_have_no_interval(count: int) -> None:
    with pytest.raises(NotDefined, match="needs 3 participants"):
        resamples(count, 99, np.random.default_rng(0))
