"""Mistakes: each made by hand in a textbook sample, then looked for."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable
from fractions import Fraction

import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit import mistakes
from palpate.analysis.audit.bounds import Moments
from palpate.analysis.audit.intervals import Interval, outward, point
from palpate.analysis.audit.mistakes import Layout, Mistake, explain
from palpate.analysis.published.printed import Printed

STUDENT = (0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0)
"""Student 1908, additional hours of sleep with dextro-hyoscyamine: n = 10, t = 1.33, P = 0.2176 (R, t.test(sleep))."""

N = len(STUDENT)
MEAN, SD = statistics.mean(STUDENT), statistics.stdev(STUDENT)
D = MEAN / SD
T = D * math.sqrt(N)
EFFECTS = [outward(D, D)]
MOMENTS = [Moments(N, point(Fraction(MEAN)), point(Fraction(SD) ** 2))]
NULL = 0.3


def _first(value: float, found: Iterable[Mistake], digits: int = 3) -> str:
    return explain(Printed(f"{value:.{digits}f}"), found).partition("; or ")[0]


def test_the_sample_is_students() -> None:
    assert round(T, 4) == 1.3257
    assert round(2 * float(stats.t.sf(T, N - 1)), 4) == 0.2176


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (MEAN * N / 15, "the sum was divided by 15 participants, but n is 10"),
        (100 * MEAN, "it was printed as a percentage"),
        (1 - MEAN, "it is 1 minus the ratio"),
        (MEAN + 0.1, ""),
    ],
)
def test_of_a_mean(value: float, expected: str) -> None:
    assert _first(value, mistakes.of_mean([outward(MEAN, MEAN)], N, [15])) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (statistics.pstdev(STUDENT), "it is the population SD (computed with n, not n - 1)"),
        (SD / math.sqrt(N), "it is the standard error"),
        (statistics.variance(STUDENT), "it is the variance"),
        (SD + 0.1, ""),
    ],
)
def test_of_a_standard_deviation(value: float, expected: str) -> None:
    assert _first(value, mistakes.of_sd(MOMENTS)) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (-T, "its sign is lost"),
        (D, f"the printed t is Cohen's d = {D:.2f}"),
        (MEAN / (statistics.pstdev(STUDENT) / math.sqrt(N)), "it was computed with the population SD"),
        (D * math.sqrt(N - 1), "it was computed with sqrt(n - 1), as if from 9 participants"),
        (D * math.sqrt(15), "it is d * sqrt(15), but n is 10"),
        (T + 0.01, ""),
    ],
)
def test_of_a_t(value: float, expected: str) -> None:
    assert _first(value, mistakes.of_t(EFFECTS, MOMENTS, Printed(f"{value:.3f}"), N, [15])) == expected


def test_of_a_t_against_0_in_the_place_of_chance(approved: SnapshotAssertion) -> None:
    size = (MEAN - NULL) / SD
    found = mistakes.of_t([outward(size, size)], MOMENTS, Printed(f"{T:.3f}"), N, [])
    assert _first(T, found) == approved


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float(stats.t.sf(T, N - 1)), "it is one-tailed"),
        (2 * float(stats.t.sf(T, N)), "it was computed with 10 df, but n is 10"),
        (2 * float(stats.t.sf(T, 14)), "it was computed with 14 df, but n is 10"),
        (2 * float(stats.t.sf(D * math.sqrt(15), 14)), "it is the P of d * sqrt(15) with 14 df, but n is 10"),
        (2 * float(stats.norm.sf(T)), "it is from the normal distribution"),
        (3 * 2 * float(stats.t.sf(T, N - 1)), "it was multiplied by 3, the number of tests in its task"),
        (0.9, ""),
    ],
)
def test_of_a_p(value: float, expected: str) -> None:
    found = mistakes.of_p(EFFECTS, Printed(f"{T:.2f}"), N - 1, N, [15], tests=3, t_agrees=True)
    assert _first(value, found, 5) == expected


def test_of_a_p_that_follows_a_wrong_t(approved: SnapshotAssertion) -> None:
    p = 2 * float(stats.t.sf(2.5, N - 1))
    found = mistakes.of_p(EFFECTS, Printed("2.50"), N - 1, N, [15], tests=3, t_agrees=False)
    assert _first(p, found, 4) == approved


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float(stats.t.sf(2.05, 27)), "it is one-tailed"),
        (2 * float(stats.t.sf(2.05, 28)), "it was computed with 28 df"),
        (2 * float(stats.norm.sf(2.05)), "it is from the normal distribution"),
    ],
)
def test_of_a_lone_p(value: float, expected: str) -> None:
    assert _first(value, mistakes.of_lone_p(Printed("2.0500"), 27), 5) == expected


F, DF = 5.0, (2, 12)
LAYOUT = Layout(DF, 15, 5, (10,))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (math.sqrt(F), "it is the square root of F, that is, t"),
        (F * 15 / 12, "its residual was divided by the number of values"),
        (F * 2 / (F * 2 + 12), "the printed F is eta squared"),
        (F * 14 / 12, "it was computed with its printed df"),
        (F * 10 / 5, "it was computed from 10 participants, but n is 5"),
    ],
)
def test_of_an_f(value: float, expected: str) -> None:
    assert _first(value, mistakes.of_f([point(Fraction(5))], LAYOUT, (2, 14))) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float(stats.f.sf(6, *DF)), "it matches the printed F"),
        (float(stats.f.sf(F, *DF)) / 2, "it is one-tailed"),
        (float(stats.f.sf(F, 2, 15)), "it was computed with 2, 15 df"),
        (float(stats.f.sf(F, 2, 13)), "it was computed with its printed df"),
        (float(stats.f.sf(6, 2, 13)), "it matches the printed F with its printed df"),
        (float(stats.f.sf(10, 2, 27)), "it was computed from 10 participants, but n is 5"),
    ],
)
def test_of_the_p_of_an_f(value: float, expected: str) -> None:
    found = mistakes.of_p_of_f([point(Fraction(5))], Printed("6.000000"), LAYOUT, (2, 13))
    assert _first(value, found, 6) == expected


def test_of_degrees_of_freedom(approved: SnapshotAssertion) -> None:
    found = dict(mistakes.of_df(10, [15]))
    assert list(found) == [10, 14]
    assert list(found.values()) == approved


def test_of_the_degrees_of_freedom_of_an_f(approved: SnapshotAssertion) -> None:
    """By hand: three groups of five, and 2 x 3 cells of five."""
    of_effect, of_residual = dict(mistakes.of_df_of_effect(LAYOUT)), dict(mistakes.of_df_of_residual(LAYOUT))
    assert (list(of_effect), list(of_residual)) == ([3], [14, 15, 13, 27, 8])
    assert (*of_effect.values(), *of_residual.values()) == approved
    crossed = dict(mistakes.of_df_of_residual(Layout((2, 24), 30)))
    assert crossed[30 - 1 - 1 - 2] == approved


def test_every_mistake_that_fits_is_named_the_simplest_first() -> None:
    near = Interval(Fraction("0.49"), Fraction("0.51"))
    assert explain(Printed("0.50"), [Mistake("a", (near,)), Mistake("b", ()), Mistake("c", (near,))]) == "a; or c"


@pytest.mark.parametrize(
    ("printed", "value", "reason"),
    [
        ("7.29", "7.92", "two digits are swapped: 7.92 would fit"),
        ("7.12", "7.92", "one digit is wrong: 7.92 would fit"),
        ("79.2", "7.92", "it is off by a power of ten"),
        ("5.02e-6", "5.02e-7", "it is off by a power of ten"),
        ("1.11", "7.92", ""),
    ],
)
def test_slips_of_a_digit_or_the_point_are_named(printed: str, value: str, reason: str) -> None:
    assert mistakes.slip_of(Printed(printed), [point(Fraction(value))]) == reason


def test_a_moved_point_is_named_beside_what_else_gives_the_number(approved: SnapshotAssertion) -> None:
    reason = mistakes.slip_of(Printed("0.70"), [point(Fraction("0.07"))])
    assert reason == approved
    cited = mistakes.Citation("Text", "one", "glass", "cannot be decided")
    why = [mistakes.Mistake("it is one-tailed", (point(Fraction("0.00423")),))]
    line = cited.number("P", Printed("0.00423"), [point(Fraction("0.0423"))], why)
    assert line.reason == approved


def test_a_number_between_its_values_is_shown_beside_the_nearest() -> None:
    cited = mistakes.Citation("Text", "one", "glass", "cannot be decided")
    values = [point(Fraction(one)) for one in ("4.5", "4.69", "4.75", "4.9")]
    assert cited.number("t(14)", Printed("4.71"), values).recomputed == "4.690 or 4.750, of 4.500 to 4.900"
    assert cited.number("t(14)", Printed("5.71"), values).recomputed == "4.500 to 4.900"
    squares = [point(Fraction(one)) for one in ("0.04", "0.09")]
    assert cited.number("SD", Printed("0.25"), squares, squares=True).recomputed == "0.200 or 0.300, of 0.200 to 0.300"


def test_a_slip_that_a_random_number_would_have_says_so(approved: SnapshotAssertion) -> None:
    """Of two digits: 18 of 100 numbers are one digit off, by counting."""
    reason = mistakes.slip_of(Printed("0.71"), [point(Fraction("0.79"))])
    assert reason == approved


def test_a_mistake_that_random_numbers_make_says_so(approved: SnapshotAssertion) -> None:
    """Values from 1 to 10 are half of the numbers from a tenth to ten times 1, by their logarithms; a point is few."""
    wide = mistakes.Mistake("it is wide", (Interval(Fraction(1), Fraction(10)),))
    narrow = mistakes.Mistake("it is a point", (point(Fraction("1.02")),))
    assert explain(Printed("1.02"), [narrow, wide]) == approved
    assert wide.by_chance(Printed("1.00")) == pytest.approx(0.5, abs=0.01)
