"""JZS Bayes factor: against print, other software, and the printed integral in extended precision."""

from __future__ import annotations

import math

import mpmath
import pingouin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.statistics.inference import log_bayes_factor
from tests.analysis.reference import printed


@pytest.mark.parametrize(("t", "n", "wanted"), printed("rouder")["bayes_factors"])
def test_printed_bayes_factors(t: float, n: int, wanted: float) -> None:
    assert math.exp(-log_bayes_factor(t, n, scale=1.0)) == pytest.approx(wanted, abs=0.005)


@pytest.mark.parametrize(
    ("t", "n", "scale"), [(0.97, 15, 0.5**0.5), (8.71, 15, 0.5**0.5), (33.73, 10, 1.0), (0.0, 2, 2.0)]
)
def test_the_printed_integral_in_30_digits(t: float, n: int, scale: float) -> None:
    """Equation (1), with g scaled by r^2."""
    df = n - 1
    with mpmath.workdps(30):

        def integrand(g: mpmath.mpf) -> mpmath.mpf:
            wide = 1 + n * scale**2 * g
            likelihood = (1 + mpmath.mpf(t) ** 2 / (wide * df)) ** (-mpmath.mpf(n) / 2) / mpmath.sqrt(wide)
            return likelihood * g**-1.5 * mpmath.exp(-1 / (2 * g)) / mpmath.sqrt(2 * mpmath.pi)

        ends = [0, 0.01, 0.1, 1, 10, 100, 1e4, mpmath.inf]
        wanted = mpmath.quad(integrand, ends) / (1 + mpmath.mpf(t) ** 2 / df) ** (-mpmath.mpf(n) / 2)
        assert log_bayes_factor(t, n, scale) == pytest.approx(float(mpmath.log(wanted)), abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.floats(-8, 8), st.integers(3, 60))
def test_it_is_that_of_pingouin(t: float, n: int) -> None:
    """To the digits that its quadrature has."""
    expected = float(pingouin.bayesfactor_ttest(t, n, paired=True))
    assert log_bayes_factor(t, n) == pytest.approx(math.log(expected), abs=1e-3)


def test_an_effect_beyond_all_doubt_stays_a_number() -> None:
    assert math.isfinite(log_bayes_factor(1e6, 2000))
