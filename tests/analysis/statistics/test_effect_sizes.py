"""Effect sizes: the definition of their limits in extended precision, published examples, and what must hold."""

from __future__ import annotations

import mpmath
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from palpate.analysis.statistics.inference import EffectSize, cohens_d, partial_eta_squared


def _below_f(f: float, df1: int, df2: int, noncentrality: float) -> float:
    """Noncentral F as a Poisson mixture of central ones, in 30 digits."""
    with mpmath.workdps(30):
        x = mpmath.mpf(df1) * f / (mpmath.mpf(df1) * f + df2)
        half = mpmath.mpf(noncentrality) / 2
        terms = (
            mpmath.exp(-half) * half**j / mpmath.factorial(j)
            * mpmath.betainc(mpmath.mpf(df1) / 2 + j, mpmath.mpf(df2) / 2, 0, x, regularized=True)
            for j in range(int(3 * noncentrality) + 60)
        )  # fmt: skip
        return float(mpmath.fsum(terms))


def _below_t(t: float, df: int, noncentrality: float) -> float:
    """Noncentral t as an integral over the chi distribution of the standard deviation, in 30 digits."""
    with mpmath.workdps(30):
        half = mpmath.mpf(df) / 2
        scale = 2 * half**half / mpmath.gamma(half)

        def density(s: mpmath.mpf) -> mpmath.mpf:
            return mpmath.ncdf(t * s - noncentrality) * scale * s ** (df - 1) * mpmath.exp(-half * s * s)

        return float(mpmath.quad(density, [0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 2, 3, 5]))


@pytest.mark.parametrize(("f", "df1", "df2"), [(7.49, 1, 92), (28.03, 3, 92), (2.12, 3, 56)])
def test_limits_of_eta_squared_stand_at_the_tails(f: float, df1: int, df2: int) -> None:
    found = partial_eta_squared(f, df1, df2)
    for limit, tail in ((found.low, 0.95), (found.high, 0.05)):
        assert limit is not None
        noncentrality = limit * (df1 + df2 + 1) / (1 - limit)
        assert limit == 0 or _below_f(f, df1, df2, noncentrality) == pytest.approx(tail, abs=1e-9)


@pytest.mark.parametrize(("t", "df"), [(8.71, 14), (0.97, 14), (-2.0, 9), (33.73, 9)])
def test_limits_of_d_stand_at_the_tails(t: float, df: int) -> None:
    found = cohens_d(t, df)
    for limit, tail in ((found.low, 0.975), (found.high, 0.025)):
        assert limit is not None
        assert _below_t(t, df, limit * (df + 1) ** 0.5) == pytest.approx(tail, abs=1e-9)


def test_the_interval_of_90_percent_excludes_nothing_exactly_when_p_is_below_5_percent() -> None:
    from scipy.stats import f as central

    critical = float(central.isf(0.05, 3, 56))
    assert partial_eta_squared(critical * 0.999, 3, 56).low == 0
    low = partial_eta_squared(critical * 1.001, 3, 56).low
    assert low is not None
    assert low > 0


@settings(max_examples=50, deadline=None)
@given(st.floats(0, 1e3), st.integers(1, 10), st.integers(1, 200))
def test_eta_squared_lies_in_its_unit_interval(f: float, df1: int, df2: int) -> None:
    found = partial_eta_squared(f, df1, df2)
    assert 0 <= found.value < 1
    if found.low is not None and found.high is not None:
        assert 0 <= found.low <= found.high < 1


def test_what_scipy_cannot_compute_is_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.analysis.statistics.inference.nctdtr", lambda *_: float("nan"))
    assert cohens_d(2.0, 9) == EffectSize(2.0 / 10**0.5, None, None, 0.95)


@settings(max_examples=200, deadline=None)
@example(4.243404978914429e-122, 1)
@given(st.floats(-40, 40), st.integers(1, 60))
def test_d_does_not_care_for_the_side(t: float, df: int) -> None:
    found, other = cohens_d(t, df), cohens_d(-t, df)
    assert found.value == -other.value
    assert (found.low is None) == (other.high is None)
    if found.low is not None and other.high is not None:
        assert found.low == pytest.approx(-other.high, rel=1e-6, abs=1e-6)
