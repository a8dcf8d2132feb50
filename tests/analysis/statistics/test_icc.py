"""Intraclass correlations: the published example, the definition of the intervals, and invariants."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pingouin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.icc import icc
from tests.analysis.reference import printed
from tests.approved import Refuses

EXAMPLE = printed("shrout_fleiss")["ratings"]
PUBLISHED = printed("shrout_fleiss")["forms"]
PSYCH = {name: line for name, line in printed("shrout_fleiss_in_r").items() if name != "source"}


def _table(seed: int) -> list[list[int]]:
    random = np.random.default_rng(seed)
    table = random.integers(0, 11, size=random.integers(3, 8, size=2))
    table[0, 0] = 20
    return [[int(value) for value in row] for row in table]


ratings = st.integers(0, 2**32 - 1).map(_table)
"""Random tables, none of them constant."""


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_published_example(name: str) -> None:
    value = icc(EXAMPLE).form(name).value
    assert value is not None
    assert round(value, 2) == PUBLISHED[name]


@pytest.mark.parametrize("name", PSYCH)
def test_f_p_and_limits_of_the_published_example(name: str) -> None:
    form = icc(EXAMPLE).form(name)
    f, df1, df2, p, low, high = PSYCH[name]
    assert (form.df1, form.df2) == (df1, df2)
    assert form.f == pytest.approx(f, abs=0.05)
    assert form.p == pytest.approx(p, abs=5e-6)
    assert form.low == pytest.approx(low, abs=5e-4)
    assert form.high == pytest.approx(high, abs=5e-3)


def test_every_form_stands_under_both_names() -> None:
    names = [(form.shrout_fleiss, form.mcgraw_wong) for form in icc(EXAMPLE).forms]
    assert names == [
        ("ICC(1,1)", "ICC(1)"),
        ("ICC(2,1)", "ICC(A,1)"),
        ("ICC(3,1)", "ICC(C,1)"),
        ("ICC(1,k)", "ICC(k)"),
        ("ICC(2,k)", "ICC(A,k)"),
        ("ICC(3,k)", "ICC(C,k)"),
    ]


@pytest.mark.parametrize("name", ["ICC(1,1)", "ICC(3,1)"])
@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_at_a_limit_the_observed_f_has_the_tail_of_the_interval(name: str, confidence: float) -> None:
    """F / (1 + k rho / (1 - rho)) follows F(df1, df2) when rho is true: the definition of the limits."""
    form = icc(EXAMPLE, confidence).form(name)
    assert form.f is not None
    assert form.low is not None
    assert form.high is not None
    for rho, tail in ((form.low, (1 - confidence) / 2), (form.high, (1 + confidence) / 2)):
        assert stats.f.sf(form.f / (1 + 4 * rho / (1 - rho)), form.df1, form.df2) == pytest.approx(tail)


@settings(deadline=None)
@given(ratings)
def test_averages_follow_from_single_ratings_by_spearman_brown(table: list[list[int]]) -> None:
    result = icc(table)
    for kind in "123":
        single, average = result.form(f"ICC({kind},1)").value, result.form(f"ICC({kind},k)").value
        if single is not None and average is not None:
            stepped = result.raters * single / (1 + (result.raters - 1) * single)
            assert average == pytest.approx(stepped, rel=1e-9, abs=1e-9)


@settings(deadline=None)
@given(ratings)
def test_consistency_ignores_how_strict_a_rater_is(table: list[list[int]]) -> None:
    shifted = [[value + 3 * index for index, value in enumerate(row)] for row in table]
    for name in ("ICC(3,1)", "ICC(3,k)"):
        assert icc(table).form(name).value == pytest.approx(icc(shifted).form(name).value)


@settings(deadline=None)
@given(ratings)
def test_mean_squares_add_up(table: list[list[int]]) -> None:
    result = icc(table)
    n, k = result.targets, result.raters
    parts = result.ms_targets * (n - 1) + result.ms_raters * (k - 1) + result.ms_error * (n - 1) * (k - 1)
    assert parts == pytest.approx(float(np.var(table)) * n * k)


@settings(deadline=None)
@given(ratings)
def test_limits_enclose_the_estimate(table: list[list[int]]) -> None:
    for form in icc(table).forms:
        if form.low is not None and form.high is not None and form.shrout_fleiss.endswith("1)"):
            assert form.value is not None
            assert form.low <= form.value + 1e-9
            assert form.value <= form.high + 1e-9


@settings(deadline=None)
@given(ratings)
def test_a_form_says_why_exactly_when_it_lacks_something(table: list[list[int]]) -> None:
    for form in icc(table).forms:
        assert bool(form.statement) == (None in (form.value, form.f, form.p, form.low, form.high))


@pytest.mark.parametrize(
    ("table", "name", "why"),
    [
        ([[0, 1, 0], [1, 0, 1], [0, 1, 0], [1, 0, 1]], "ICC(1,1)", ""),
        ([[0, 1], [1, 0]], "ICC(1,k)", "its denominator variance is estimated as zero or less"),
        (
            [[1, 1], [2, 2], [3, 3]],
            "ICC(1,1)",
            "there is no variance within targets, so F and P are not defined; nor is the",
        ),
        (
            [[1, 2], [2, 3], [3, 4]],
            "ICC(3,1)",
            "there is no variance other than that of targets and raters, so F and P are not",
        ),
    ],
)
def test_the_reason_is_that_of_the_mean_squares(table: list[list[int]], name: str, why: str) -> None:
    assert icc(table).form(name).statement.startswith(why)
    assert bool(icc(table).form(name).statement) == bool(why)


def test_limits_that_fall_together_beside_the_estimate_are_none(approved: SnapshotAssertion) -> None:
    table = [[20, 0, 3, 3, 9], [10, 8, 8, 0, 9], [7, 6, 10, 7, 4], [10, 7, 10, 2, 6]]
    agreement = next(form for form in icc(table).forms if form.mcgraw_wong == "ICC(A,1)")
    # pingouin 0.7.0 gives the same estimate, and [-0.1744, -0.1744] for its interval.
    assert agreement.value == pytest.approx(-0.173859, abs=1e-6)
    assert (agreement.low, agreement.high) == (None, None)
    assert agreement.statement == approved


def test_perfect_agreement_is_one_without_an_interval() -> None:
    for form in icc([[1, 1, 1], [2, 2, 2], [5, 5, 5]]).forms:
        assert form.value == 1
        assert (form.f, form.p, form.low, form.high) == (None, None, None, None)


@pytest.mark.parametrize("table", [[[1, 2, 3]], [[1], [2]], []])
def test_too_small_a_matrix_is_not_defined(table: list[list[int]], refuses: Refuses) -> None:
    with refuses(NotDefined):
        icc(table)


def test_constant_ratings_are_not_defined(refuses: Refuses) -> None:
    with refuses(NotDefined):
        icc([[1, 1], [1, 1], [1, 1]])


def test_a_gap_is_refused() -> None:
    with pytest.raises(ValueError, match="every rater"):
        icc([[1, 2], [3]])


@settings(max_examples=10, deadline=None)
@given(ratings)
def test_every_form_is_that_of_pingouin(table: list[list[int]]) -> None:
    """pingouin.intraclass_corr; it rounds its limits to two digits, ours are held to print above."""
    long = pd.DataFrame(
        [(t, r, value) for t, row in enumerate(table) for r, value in enumerate(row)], columns=["t", "r", "y"]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = pingouin.intraclass_corr(long, targets="t", raters="r", ratings="y")
    for form, (_, line) in zip(icc(table).forms, expected.iterrows(), strict=True):
        assert (form.df1, form.df2) == (line["df1"], line["df2"])
        for value, other in ((form.value, line["ICC"]), (form.f, line["F"]), (form.p, line["pval"])):
            if value is not None and np.isfinite(other):
                assert value == pytest.approx(other, rel=1e-9, abs=1e-10)
