"""The intervals of many studies at once, by which coverage is measured, are those that are printed."""

import numpy as np
import pytest

from palpate.analysis.statistics.shares import difference_limits, population_limits, share_limits
from tests.benchmarks.inference import at_share, mean_share
from tests.benchmarks.many_intervals import difference_ends, holds_any, share_ends

PATTERNS = ([10], [40], [5, 10, 20, 40])


@pytest.mark.parametrize("pattern", PATTERNS, ids=str)
@pytest.mark.parametrize(("people", "share"), [(4, 0.9), (40, 0.99), (10, 0.5)])
def test_the_ends_of_many_studies_are_those_of_each(pattern: list[int], people: int, share: float) -> None:
    random = np.random.default_rng([people, *pattern])
    trials = np.resize(np.array(pattern), people)
    right = random.binomial(trials, random.beta(5 * share, 5 * (1 - share), (3, people)))
    low, high = share_ends(right, trials)
    anyone = [population_limits(row, trials) for row in right]
    for study, row in enumerate(right):
        limits = share_limits(row, trials)
        assert (low[study], high[study]) == pytest.approx(
            (limits.low or 0.0, 1.0 if limits.high is None else limits.high), abs=1e-4
        )
    for value in (0.3, 0.6, 0.85, 0.97):
        held = [(one.low or 0.0) <= value <= (1.0 if one.high is None else one.high) for one in anyone]
        assert holds_any(right, trials, value).tolist() == held


@pytest.mark.parametrize("share", [0.6, 0.95])
def test_differences_of_many_studies_are_those_of_each(share: float) -> None:
    random = np.random.default_rng(39)
    trials = np.array([np.full(10, 10), np.resize([5, 40], 10)])
    right = random.binomial(trials, random.beta(5 * share, 5 * (1 - share), (3, 2, 10)))
    low, high = difference_ends(right, trials)
    for study, own in enumerate(right):
        limits = difference_limits(own, trials, own[0] / trials[0] - own[1] / trials[1])
        assert (low[study], high[study]) == pytest.approx((limits.low, limits.high), abs=1e-4)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
@pytest.mark.parametrize("sd", [0.0, 2.0])
def test_studies_are_drawn_about_the_share_that_intervals_are_to_hold(share: float, sd: float) -> None:
    assert mean_share(at_share(share, sd), sd) == pytest.approx(share, abs=1e-9)
