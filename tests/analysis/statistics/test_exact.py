"""Rational arithmetic: against numpy's least squares and the standard library's statistics."""

from __future__ import annotations

import statistics
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.statistics.exact import integers, of_groups

counts = st.lists(st.integers(0, 40), min_size=2, max_size=12)


@settings(deadline=None)
@given(counts)
def test_mean_and_sum_of_squares_are_those_of_the_standard_library(values: list[int]) -> None:
    exact = [Fraction(value, 10) for value in values]
    found = of_groups([exact])
    assert found.means[0, 0] == statistics.mean(exact)
    assert found.ss_within[0] == statistics.pvariance(exact) * len(exact)


def test_no_digit_is_lost_beside_a_large_constant() -> None:
    values = [Fraction(10**13) + Fraction(k, 10) for k in (4, 3, 5)]
    assert of_groups([values]).ss_within[0] == Fraction(2, 100)


def test_integers_stand_for_the_same_values() -> None:
    values: list[int | float | Fraction] = [Fraction(1, 10), 0.75, 3, np.float64(0.5)]
    whole, common = integers(values)
    assert (whole, common) == ([2, 15, 60, 10], 20)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_values_must_be_finite(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        integers([0.5, value])
