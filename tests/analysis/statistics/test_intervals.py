"""Binomial intervals: against print, statsmodels, and their definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.proportion import proportion_confint

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import LEAST, clopper_pearson, resamples, wilson
from tests.analysis.reference import printed


@pytest.mark.parametrize(("count", "trials", "score", "exact"), printed("newcombe")["intervals"])
def test_printed_intervals(count: int, trials: int, score: list[float], exact: list[float]) -> None:
    for found, wanted in ((wilson(count, trials), score), (clopper_pearson(count, trials), exact)):
        assert [found.low, found.high] == pytest.approx(wanted, abs=6e-5)


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


def test_a_resample_has_as_many_participants() -> None:
    weights = resamples(7, 100, np.random.default_rng(0))
    assert set(weights.sum(axis=1).tolist()) == {7}


@pytest.mark.parametrize("count", [0, 1, LEAST - 1])
def test_too_few_participants_cannot_be_resampled(count: int) -> None:
    with pytest.raises(NotDefined):
        resamples(count, 99, np.random.default_rng(0))
