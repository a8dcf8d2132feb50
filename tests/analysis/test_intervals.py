"""Binomial intervals: against print, statsmodels, and their definition."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.proportion import proportion_confint

from analysis.intervals import clopper_pearson, wilson

# Newcombe (1998), Statist. Med. 17, 857-872, Table I: count, trials, Wilson (method 3), Clopper-Pearson (method 5)
PRINTED = [
    (81, 263, (0.2553, 0.3662), (0.2527, 0.3676)),
    (15, 148, (0.0624, 0.1605), (0.0578, 0.1617)),
    (0, 20, (0.0000, 0.1611), (0.0000, 0.1684)),
    (1, 29, (0.0061, 0.1718), (0.0009, 0.1776)),
]


@pytest.mark.parametrize(("count", "trials", "score", "exact"), PRINTED)
def test_printed_intervals(count: int, trials: int, score: tuple[float, float], exact: tuple[float, float]) -> None:
    for found, printed in ((wilson(count, trials), score), (clopper_pearson(count, trials), exact)):
        assert (found.low, found.high) == pytest.approx(printed, abs=6e-5)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 400), st.floats(0, 1), st.sampled_from([0.8, 0.95, 0.99]))
def test_they_are_those_of_statsmodels(trials: int, share: float, confidence: float) -> None:
    count = round(share * trials)
    for found, method in (
        (wilson(count, trials, confidence), "wilson"),
        (clopper_pearson(count, trials, confidence), "beta"),
    ):
        expected = proportion_confint(count, trials, alpha=1 - confidence, method=method)
        assert (found.low, found.high) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize(("count", "trials"), [(3, 10), (149, 150), (40, 100)])
def test_the_exact_limits_have_their_tails(count: int, trials: int) -> None:
    found = clopper_pearson(count, trials)
    assert stats.binom.sf(count - 1, trials, found.low) == pytest.approx(0.025)
    assert stats.binom.cdf(count, trials, found.high) == pytest.approx(0.025)


@pytest.mark.parametrize(("count", "trials"), [(0, 0), (3, 2), (-1, 4)])
def test_impossible_counts_are_refused(count: int, trials: int) -> None:
    for interval in (wilson, clopper_pearson):
        with pytest.raises(ValueError, match="allowed: a count"):
            interval(count, trials)
