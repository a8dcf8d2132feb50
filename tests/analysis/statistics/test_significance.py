"""t against chance and Holm: against scipy and statsmodels, and where they are not defined."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.multitest import multipletests

from palpate.analysis.statistics.inference import holm, p_two_tailed, stars, t_against_chance

correct = st.lists(st.integers(0, 10), min_size=2, max_size=20)


@settings(deadline=None)
@given(correct, st.sampled_from([0.25, 0.5]))
def test_t_and_p_are_those_of_scipy(counts: list[int], chance: float) -> None:
    assume(len(set(counts)) > 1)
    result = t_against_chance([Fraction(count, 10) for count in counts], chance)
    expected = stats.ttest_1samp([count / 10 for count in counts], chance)
    assert result.t == pytest.approx(expected.statistic, rel=1e-9, abs=1e-9)
    assert result.p == pytest.approx(expected.pvalue, rel=1e-8)
    assert result.df == expected.df == len(counts) - 1
    assert result.t == pytest.approx(math.sqrt(len(counts)) * (result.d or 0))


@settings(deadline=None)
@given(correct)
def test_p_does_not_care_for_the_side(counts: list[int]) -> None:
    assume(len(set(counts)) > 1)
    above = t_against_chance([Fraction(count, 10) for count in counts], Fraction(1, 2))
    below = t_against_chance([1 - Fraction(count, 10) for count in counts], Fraction(1, 2))
    assert above.p == below.p
    assert above.t is not None
    assert below.t == -above.t


@pytest.mark.parametrize(
    ("counts", "t", "p"),
    [
        # Okamoto, section 5.2, from a sample with the printed mean 0.29 and SD 0.15 of typing paper, n = 15
        ([2, 2, 5, 4, 5, 3, 0, 3, 3, 3, 3, 5, 1, 2, 2], 0.97, 0.35),
    ],
)
def test_the_printed_test_of_typing_paper(counts: list[int], t: float, p: float) -> None:
    result = t_against_chance([Fraction(count, 10) for count in counts], 0.25)
    assert (round(result.t or 0, 2), round(result.p or 0, 2), result.stars) == (t, p, "")


def test_far_tails_keep_their_digits() -> None:
    assert p_two_tailed(33.7335, 9) == pytest.approx(2 * stats.t.sf(33.7335, 9), rel=1e-10)
    assert p_two_tailed(-400.0, 14) == pytest.approx(2 * stats.t.sf(400.0, 14), rel=1e-10)


@pytest.mark.parametrize("ratio", [Fraction(1, 10), Fraction(1), Fraction(1, 4)])
def test_constant_answers_are_stated_not_computed(ratio: Fraction) -> None:
    result = t_against_chance([ratio] * 15, 0.25)
    assert (result.t, result.p, result.d, result.sd, result.stars) == (None, None, None, 0.0, "")
    assert "no variance" in result.statement


def test_one_participant_is_stated_not_computed() -> None:
    result = t_against_chance([Fraction(1, 2)], 0.25)
    assert (result.mean, result.sd, result.p) == (0.5, None, None)
    assert "one participant" in result.statement


def test_nobody_is_stated_not_computed() -> None:
    assert "not presented" in t_against_chance([], 0.25).statement


@pytest.mark.parametrize(("p", "mark"), [(0.05, ""), (0.0499, "*"), (0.01, "*"), (0.0099, "**"), (0.00099, "***")])
def test_stars_are_strict(p: float, mark: str) -> None:
    assert stars(p) == mark


def test_a_mean_below_chance_earns_no_star() -> None:
    assert t_against_chance([0.0, 0.0, 0.1, 0.0, 0.0], 0.25).stars == ""


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_is_that_of_statsmodels(p_values: list[float]) -> None:
    assert holm(np.array(p_values)).tolist() == pytest.approx(multipletests(p_values, method="holm")[1].tolist())
