"""m-AFC d': examples of other software, the closed form for two alternatives, quadrature in 30 digits."""

from __future__ import annotations

import mpmath
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from palpate.analysis.identification.confusion import corrected, d_prime, proportion_correct
from palpate.analysis.statistics.exact import NotDefined
from tests.analysis.reference import printed


@pytest.mark.parametrize(("proportion", "wanted"), printed("palamedes")["d_prime_of_10"])
def test_the_example_of_palamedes(proportion: float, wanted: float) -> None:
    """Its search ends within 1e-4."""
    assert d_prime(proportion, 10) == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize(("value", "wanted"), printed("palamedes")["share_of_25"])
def test_the_other_example_of_palamedes(value: float, wanted: float) -> None:
    assert proportion_correct(value, 25) == pytest.approx(wanted, abs=6e-5)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.001, 0.999))
def test_two_alternatives_have_a_closed_form(proportion: float) -> None:
    """Green and Swets (1966): sqrt 2 times the normal quantile."""
    assert d_prime(proportion, 2) == pytest.approx(2**0.5 * stats.norm.ppf(proportion), abs=1e-10)


@pytest.mark.parametrize(("value", "alternatives"), [(0.93, 4), (-1.5, 4), (3.2, 7)])
def test_the_integral_in_30_digits(value: float, alternatives: int) -> None:
    with mpmath.workdps(30):
        wanted = mpmath.quad(
            lambda z: mpmath.npdf(z - value) * mpmath.ncdf(z) ** (alternatives - 1), [-12, -4, 0, 2, 5, 16]
        )
        assert proportion_correct(value, alternatives) == pytest.approx(float(wanted), abs=1e-13)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.01, 0.99), st.integers(2, 12))
def test_there_and_back(proportion: float, alternatives: int) -> None:
    value = d_prime(proportion, alternatives)
    assert proportion_correct(value, alternatives) == pytest.approx(proportion, abs=1e-12)
    assert (value > 1e-9) == (proportion > 1 / alternatives + 1e-9) or abs(proportion * alternatives - 1) < 1e-6


@pytest.mark.parametrize("proportion", [0.0, 1.0])
def test_an_infinite_value_is_not_defined(proportion: float) -> None:
    with pytest.raises(NotDefined, match="infinite"):
        d_prime(proportion, 4)


@pytest.mark.parametrize(("proportion", "alternatives"), [(1.2, 4), (float("nan"), 4), (0.5, 1)])
def test_what_is_no_share_is_refused(proportion: float, alternatives: int) -> None:
    with pytest.raises(ValueError, match="allowed: 0 to 1"):
        d_prime(proportion, alternatives)


def test_extremes_move_by_half_a_trial() -> None:
    assert [corrected(n, 40) for n in (0, 17, 40)] == [0.5 / 40, 17 / 40, 39.5 / 40]
