"""Bootstrap over participants: against scipy, and where it has no interval."""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import LEAST, RESAMPLES, bca, mean_interval, resamples

COUNTS = [2, 2, 5, 4, 5, 3, 0, 3, 3, 3, 3, 5, 1, 2, 9]
RATIOS = np.array(COUNTS) / 10


def _of_ten(counts: Iterable[int]) -> list[Fraction]:
    return [Fraction(int(count), 10) for count in counts]


def test_the_interval_is_that_of_scipy_within_its_noise() -> None:
    expected = stats.bootstrap((RATIOS,), np.mean, n_resamples=40_000, method="BCa", rng=np.random.default_rng(1))
    found = mean_interval(_of_ten(COUNTS), resamples(RATIOS.size, RESAMPLES, np.random.default_rng(2)))
    assert (found.low, found.high) == pytest.approx(tuple(expected.confidence_interval), abs=0.012)


def test_on_the_same_resamples_it_is_that_of_scipy() -> None:
    drawn = resamples(RATIOS.size, 2000, np.random.default_rng(3)) @ RATIOS / RATIOS.size
    left_out = (RATIOS.sum() - RATIOS) / (RATIOS.size - 1)
    first = stats.bootstrap((RATIOS,), np.mean, n_resamples=0, bootstrap_result=_Drawn(drawn), method="BCa")
    found = bca(float(RATIOS.mean()), drawn, left_out)
    assert (found.low, found.high) == pytest.approx(tuple(first.confidence_interval), abs=2e-3)


@pytest.mark.parametrize(
    "values",
    [
        [Fraction(count, 10) for count in COUNTS],
        [Fraction(count, 7) for count in (7, 6, 3, 5, 5, 7, 2, 6, 4)],
        # Unequal trials, whose common denominator is beyond a float's whole numbers.
        [Fraction(k % 5, n) for k, n in enumerate((97, 89, 83, 79, 73, 71, 67, 61, 59, 53, 47), start=1)],
    ],
)
def test_resamples_with_the_observed_mean_are_ties(values: list[Fraction]) -> None:
    """The share below, the bias and both limits in fractions, by the equations of Efron (1987) and numpy's quantile."""
    weights = resamples(len(values), 999, np.random.default_rng(5))
    means = [
        sum((w * v for w, v in zip(row, values, strict=True)), Fraction(0)) / len(values) for row in weights.tolist()
    ]
    observed = statistics.mean(values)
    below = Fraction(sum(one < observed for one in means) + sum(one <= observed for one in means), 2 * len(means))
    gaps = [value - observed for value in values]  # proportional to the mean less that without this participant
    acceleration = sum(float(gap) ** 3 for gap in gaps) / (6 * sum(float(gap) ** 2 for gap in gaps) ** 1.5)
    bias = stats.norm.ppf(float(below))
    shares = [
        stats.norm.cdf(bias + (bias + z) / (1 - acceleration * (bias + z))) for z in stats.norm.ppf([0.025, 0.975])
    ]
    found = mean_interval(values, weights)
    expected = np.quantile([float(one) for one in means], shares)
    assert (found.low, found.high) == pytest.approx(tuple(expected), abs=1e-12)


class _Drawn:
    """Resamples handed to scipy, which takes those of an earlier call."""

    def __init__(self, drawn: np.ndarray) -> None:
        self.bootstrap_distribution = drawn


def test_a_resample_has_as_many_participants() -> None:
    weights = resamples(7, 100, np.random.default_rng(0))
    assert set(weights.sum(axis=1).tolist()) == {7}


def test_it_covers_about_as_often_as_it_says() -> None:
    """Ratios of 20 participants, binomial with one share: 95 % nominal; 400 tries know their rate to 2 SE = 3.5 %."""
    rng = np.random.default_rng(8)
    hits = 0
    for _ in range(400):
        values = _of_ten(rng.binomial(10, rng.beta(6, 4, size=20)))
        found = mean_interval(values, resamples(20, 1999, rng))
        hits += found.low <= 0.6 <= found.high
    assert 0.88 <= hits / 400 <= 0.98


def test_without_variance_there_is_no_interval() -> None:
    with pytest.raises(NotDefined, match="no variance"):
        mean_interval(_of_ten([4] * 6), resamples(6, 99, np.random.default_rng(0)))


@pytest.mark.parametrize("count", [0, 1, LEAST - 1])
def test_too_few_participants_have_no_interval(count: int) -> None:
    with pytest.raises(NotDefined, match="needs 3 participants"):
        resamples(count, 99, np.random.default_rng(0))
