"""Shares over participants: scipy's beta-binomial, Student's t, and how often an interval holds, counted exactly."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from scipy import stats

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import clopper_pearson
from palpate.analysis.statistics.shares import (
    difference_limits,
    first_limits,
    modelled,
    population_limits,
    share_limits,
)


def _credible(right: list[int], trials: list[int]) -> tuple[float, float]:
    """The credible interval by scipy's beta-binomial, over Gauss and Legendre's points of both parameters."""
    nodes, weights = np.polynomial.legendre.leggauss(160)
    points = 4000
    angles = (np.arange(points) + 0.5) / points * math.pi / 2
    mean = (np.sin(angles) ** 2)[:, None]
    roots = (nodes + 1) / 2
    c = 1 / roots**2 - 1
    logs = np.log(roots * weights) + sum(
        often * stats.betabinom.logpmf(k, n, mean * c, (1 - mean) * c)
        for (k, n), often in Counter(zip(right, trials, strict=True)).items()
    )
    below = np.append(0, np.cumsum(np.exp(logs - logs.max()).sum(axis=1)))
    ends = np.interp([0.025, 0.975], below / below[-1], np.linspace(0, math.pi / 2, points + 1))
    low, high = np.sin(ends) ** 2
    return float(low), float(high)


@pytest.mark.parametrize(
    ("right", "trials"),
    [
        ([7, 5, 9, 2], [10] * 4),
        ([8, 9, 3, 7, 10, 6, 1, 8], [10] * 8),
        ([1, 6, 17, 12, 3, 5], [5, 10, 20, 40, 5, 10]),
        ([12, 31], [40, 40]),
    ],
)
def test_the_model_is_that_of_scipys_beta_binomial(right: list[int], trials: list[int]) -> None:
    """In these the interval of the model is wider than Clopper and Pearson's, so that it is what is returned."""
    expected = _credible(right, trials)
    pooled = clopper_pearson(sum(right), sum(trials))
    assert expected[0] < pooled.low
    assert expected[1] > pooled.high
    assert modelled(np.array(right), np.array(trials)) == pytest.approx(expected, abs=1e-6)


def test_the_interval_is_widened_to_all_trials_and_on_one_side_to_the_logit() -> None:
    found = share_limits(np.array([10] * 29 + [9]), np.full(30, 10))
    pooled = clopper_pearson(299, 300)
    assert found.high == pooled.high
    assert share_limits(np.full(30, 9), np.full(30, 10)).high == clopper_pearson(270, 300).high
    unlike = np.array([10] * 20 + [0] * 10)
    low, high = modelled(unlike, np.full(30, 10))
    shares = unlike / 10
    error = stats.sem(shares) / (shares.mean() * (1 - shares.mean()))
    logit = math.log(shares.mean() / (1 - shares.mean())) + stats.t.ppf(0.975, 29) * error
    found = share_limits(unlike, np.full(30, 10))
    assert found.low == low
    assert found.high == pytest.approx(max(high, 1 / (1 + math.exp(-logit))))


def test_where_all_are_right_or_wrong_one_end_is_known() -> None:
    """Four participants with ten trials each: at least 71 %."""
    tens = np.full(4, 10)
    right, wrong = share_limits(tens, tens), share_limits(np.zeros(4, dtype=np.int64), tens)
    assert right.high is None
    assert wrong.low is None
    assert right.low == pytest.approx(0.7083, abs=1e-4)
    assert wrong.high == pytest.approx(1 - 0.7083, abs=1e-4)


def test_a_mirrored_study_has_the_mirrored_interval() -> None:
    right, trials = np.array([3, 9, 12, 4]), np.array([5, 10, 20, 40])
    found, mirrored = share_limits(right, trials), share_limits(trials - right, trials)
    assert (found.low, found.high) == pytest.approx((1 - (mirrored.high or 0), 1 - (mirrored.low or 0)), abs=1e-9)


def test_who_did_no_trial_does_not_count_and_one_participant_has_no_interval() -> None:
    assert share_limits(np.array([3, 0, 5]), np.array([9, 0, 9])) == share_limits(np.array([3, 5]), np.array([9, 9]))
    with pytest.raises(NotDefined):
        share_limits(np.array([3, 0]), np.array([9, 0]))


@pytest.mark.parametrize(("people", "trials"), [(2, 10), (3, 5)])
def test_it_holds_for_every_mean_and_spread_tried(people: int, trials: int) -> None:
    """The probability of every outcome of beta-binomial participants, added up where the interval holds the mean."""
    tried = [(mean, rho) for mean in (0.5, 0.75, 0.9, 0.99) for rho in (0.01, 0.15, 0.4)]
    held = dict.fromkeys(tried, 0.0)
    for outcome in itertools.combinations_with_replacement(range(trials + 1), people):
        limits = share_limits(np.array(outcome), np.full(people, trials))
        often = math.factorial(people) / math.prod(map(math.factorial, Counter(outcome).values()))
        for mean, rho in tried:
            if (limits.low or 0) <= mean <= (limits.high or 1):
                c = 1 / rho - 1
                held[mean, rho] += often * math.prod(stats.betabinom.pmf(outcome, trials, mean * c, (1 - mean) * c))
    assert min(held.values()) > 0.935


def test_in_the_middle_a_difference_is_students() -> None:
    right = np.array([[14, 22, 9, 25, 17, 12], [20, 30, 28, 31, 19, 13]])
    trials = np.full((2, 6), 40)
    gaps = (right[0] - right[1]) / 40
    found = difference_limits(right, trials, gaps)
    expected = stats.t.interval(0.95, 5, gaps.mean(), stats.sem(gaps))
    assert (found.low, found.high) == pytest.approx(expected)


def test_participants_who_do_not_differ_have_the_error_of_trials() -> None:
    right, trials = np.array([[20] * 5, [24] * 5]), np.full((2, 5), 40)
    found = difference_limits(right, trials, np.full(5, -0.1))
    shares = np.array([101, 121]) / 202
    error = math.sqrt((shares * (1 - shares)).sum() / 40 / 5)
    assert found.low == pytest.approx(-0.1 - stats.t.ppf(0.975, 4) * error)


def test_near_an_end_a_difference_is_squared_and_added() -> None:
    """By hand from the limits of both shares and the correlation 0.5 of participants, lowered as Fisher's z."""
    right, trials = np.array([[10, 9, 10, 8, 10], [6, 6, 9, 5, 8]]), np.full((2, 5), 10)
    found = difference_limits(right, trials, (right[0] - right[1]) / 10)
    (low, high), (other_low, other_high) = modelled(right[0], trials[0]), modelled(right[1], trials[1])
    r = max(0.0, math.tanh(math.atanh(float(stats.pearsonr(*right).statistic)) - 1 / math.sqrt(2)))
    first, second = 0.94, 0.68
    below = (first - low) ** 2 + (other_high - second) ** 2 - 2 * r * (first - low) * (other_high - second)
    above = (high - first) ** 2 + (second - other_low) ** 2 - 2 * r * (high - first) * (second - other_low)
    assert found.low == pytest.approx(0.26 - math.sqrt(below))
    assert found.high == pytest.approx(0.26 + math.sqrt(above))


def test_all_right_in_both_tasks_is_no_difference_of_zero_width() -> None:
    tens = np.full((2, 6), 10)
    found = difference_limits(tens, tens, np.zeros(6))
    assert found.low == pytest.approx(-(found.high or 0))
    assert (found.high or 0) > 0.1
    with pytest.raises(NotDefined):
        difference_limits(tens[:, :1], tens[:, :1], np.zeros(1))


def test_an_interval_for_any_population_has_the_quantiles_of_beta_where_shares_are_0_and_1() -> None:
    """Of k right and the others wrong, the weight of the right is beta with k and the rest, half a participant more."""
    found = population_limits(np.array([10, 10, 10, 0, 0]), np.full(5, 10))
    assert (found.low, found.high) == pytest.approx((stats.beta.ppf(0.025, 3, 2.5), stats.beta.ppf(0.975, 3.5, 2)))
    found = population_limits(np.repeat([10, 0], [3000, 1000]), np.full(4000, 10))
    many = stats.beta.ppf(0.025, 3000, 1000.5), stats.beta.ppf(0.975, 3000.5, 1000)
    assert (found.low, found.high) == pytest.approx(many, abs=1e-9)
    found = population_limits(np.array([5] * 4), np.array([5] * 4))
    assert found.high is None
    assert found.low == pytest.approx(stats.beta.ppf(0.025, 4, 0.5), abs=1e-9)
    with pytest.raises(NotDefined):
        population_limits(np.array([3]), np.array([10]))


def test_an_interval_for_any_population_has_the_quantiles_of_drawn_weights() -> None:
    shares = np.array([0.7, 0.5, 0.9, 0.2])
    drawn = np.random.default_rng(1).dirichlet([1, 1, 1, 1, 0.5], 200_000)
    expected = [np.quantile(drawn @ np.append(shares, end), tail) for end, tail in ((0, 0.025), (1, 0.975))]
    found = population_limits(np.array([7, 5, 9, 2]), np.full(4, 10))
    assert (found.low, found.high) == pytest.approx(expected, abs=2e-3)


def test_what_is_shown_first_allows_for_guessers_among_others_and_for_a_single_participant() -> None:
    tens = np.full(6, 10)
    # 7 of 10 are likelier by the mean of 0.92 (0.917^7 0.083^3 above 0.25^7 0.75^3), 6 of 10 by chance.
    apart, guesser = np.array([10, 9, 10, 10, 9, 7]), np.array([10, 9, 10, 10, 9, 6])
    assert first_limits(apart, tens, 0.25) == share_limits(apart, tens)
    assert first_limits(guesser, tens, 0.25) == population_limits(guesser, tens)
    assert first_limits(guesser - 3, tens, 0.25) == share_limits(guesser - 3, tens)
    lucky = np.array([40] * 5 + [14])
    assert first_limits(lucky, np.full(6, 40), 0.25) == population_limits(lucky, np.full(6, 40))
    found = first_limits(np.array([0, 10]), np.array([0, 10]), 0.25)
    assert (found.low, found.high, found.over) == (clopper_pearson(10, 10).low, None, "trials")
