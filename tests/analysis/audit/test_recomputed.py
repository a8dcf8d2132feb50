"""Statistics as intervals: they hold the value of any data that the printed means and SDs can stand for."""

from __future__ import annotations

import math
import statistics
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from palpate.analysis.audit.bounds import (
    Margin,
    Moments,
    effect,
    f_of,
    p_of_f,
    p_of_t,
    quotient,
    ss_between,
    ss_within,
    t_of,
    together,
)
from palpate.analysis.audit.intervals import Interval, either, point
from palpate.analysis.published.printed import Printed

DIGITS = st.integers(1, 3)
SAMPLES = st.lists(st.integers(0, 40), min_size=3, max_size=12).filter(lambda values: len(set(values)) > 1)


def _box(values: list[float], digits: int) -> Moments:
    """Mean and variance as the printed mean and SD leave them open."""
    mean, sd = Printed(f"{statistics.mean(values):.{digits}f}"), Printed(f"{statistics.stdev(values):.{digits}f}")
    return Moments(len(values), either(mean), either(sd).squared())


@settings(deadline=None)
@given(SAMPLES, DIGITS, st.integers(0, 40))
def test_t_d_and_p_hold_scipys(values: list[int], digits: int, null: int) -> None:
    box, n = _box([float(value) for value in values], digits), len(values)
    size = effect(box, Fraction(null))
    if size is None:
        return
    true = stats.ttest_1samp(values, null)
    d = (statistics.mean(values) - null) / statistics.stdev(values)
    assert size.meets(Interval(Fraction(d) - Fraction(1, 10**12), Fraction(d) + Fraction(1, 10**12)))
    t = t_of(size, n)
    assert float(t.low) <= true.statistic + 1e-9
    assert float(t.high) >= true.statistic - 1e-9
    p = p_of_t(t, n - 1)
    assert float(p.low) <= true.pvalue * (1 + 1e-8)
    assert float(p.high) >= true.pvalue * (1 - 1e-8)


def _squares(weights: list[int], means: tuple[Fraction, ...]) -> Fraction:
    centre = sum((n * mean for n, mean in zip(weights, means, strict=True)), Fraction(0)) / sum(weights)
    return sum((n * (mean - centre) ** 2 for n, mean in zip(weights, means, strict=True)), Fraction(0))


@settings(deadline=None)
@given(st.lists(SAMPLES, min_size=2, max_size=5), DIGITS)
def test_f_and_its_p_hold_those_of_the_data(groups: list[list[int]], digits: int) -> None:
    boxes = [_box([float(value) for value in group], digits) for group in groups]
    margins = [Margin(box.n, box.mean) for box in boxes]
    df = len(groups) - 1, sum(map(len, groups)) - len(groups)
    f = f_of(ss_between(margins), ss_within(boxes), df)
    exact = [[Fraction(value) for value in group] for group in groups]
    residual = sum((statistics.variance(group) * (len(group) - 1) for group in exact), Fraction(0))
    levels = _squares([len(group) for group in exact], tuple(map(statistics.mean, exact)))
    assert f.holds(levels / df[0] / (residual / df[1]))
    true = float(stats.f.sf(float(levels / df[0] / (residual / df[1])), *df))
    p = p_of_f(f, df)
    assert float(p.low) <= true * (1 + 1e-8)
    assert float(p.high) >= true * (1 - 1e-8)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(-6, 6), st.integers(0, 4)), min_size=2, max_size=4),
)
def test_the_least_and_the_most_between_levels_against_a_grid(levels: list[tuple[int, int, int]]) -> None:
    """Brute force over a grid of each mean: none lies outside, and the least is met as nearly as the grid allows."""
    weights = [n for n, _, _ in levels]
    margins = [Margin(n, Interval(Fraction(low), Fraction(low + width))) for n, low, width in levels]
    found = ss_between(margins)
    # Every combination at once, in whole eighths, orders them as N sum(n m^2) - (sum n m)^2 does.
    grids = np.array(np.meshgrid(*[8 * low + width * np.arange(9) for _, low, width in levels]))
    squares = sum(weights) * np.tensordot(weights, grids**2, 1) - np.tensordot(weights, grids, 1) ** 2
    least, most = (
        _squares(weights, tuple(Fraction(int(grid.flat[place]), 8) for grid in grids))
        for place in (squares.argmin(), squares.argmax())
    )
    assert found.low <= least
    assert found.high >= most
    # A step of the grid moves each mean by at most a half: the square of that, over all weights, bounds the miss.
    steps = sum(n * Fraction(width, 8) ** 2 for n, _, width in levels)
    assert math.sqrt(least) <= math.sqrt(found.low) + math.sqrt(steps)


def test_means_that_can_be_equal_need_not_differ() -> None:
    margins = [Margin(3, Interval(Fraction(0), Fraction(2))), Margin(5, Interval(Fraction(1), Fraction(4)))]
    assert ss_between(margins).low == 0


def test_points_give_points() -> None:
    """Textbook values: means 1, 2, 3 of five each, variance 1; F = 5 at 2 and 12 df."""
    cells = [Moments(5, point(Fraction(k)), point(Fraction(1))) for k in (1, 2, 3)]
    f = f_of(ss_between([Margin(5, cell.mean) for cell in cells]), ss_within(cells), (2, 12))
    assert float(f.low) == pytest.approx(5, rel=1e-8)
    assert float(f.high) == pytest.approx(5, rel=1e-8)
    # F(2, 12) = 5: R, pf(5, 2, 12, lower.tail = FALSE); closed form (1 + 2 f / 12) ** -6 for two degrees of freedom.
    assert float(p_of_f(f, (2, 12)).low) == pytest.approx((1 + 10 / 12) ** -6, rel=1e-7)


def test_no_spread_has_no_effect_size_and_a_spread_that_may_be_none_has_no_bound() -> None:
    mean = point(Fraction(1))
    assert effect(Moments(5, mean, point(Fraction(0))), Fraction(0)) is None
    size = effect(Moments(5, mean, Interval(Fraction(0), Fraction(1))), Fraction(0))
    assert size is not None
    assert size.high == math.inf
    assert p_of_t(t_of(size, 5), 4).low == 0


def test_a_mean_on_both_sides_of_the_null_can_have_p_1() -> None:
    size = effect(Moments(9, Interval(Fraction(-1), Fraction(2)), point(Fraction(1))), Fraction(0))
    assert size is not None
    p = p_of_t(t_of(size, 9), 8)
    assert float(p.high) == pytest.approx(1)
    assert float(p.low) == pytest.approx(float(2 * stats.t.sf(6, 8)), rel=1e-7)


def test_quotients_and_boxes() -> None:
    ratio = quotient(Interval(Fraction(2), Fraction(3)), Interval(Fraction(1), Fraction(4)))
    assert (float(ratio.low), float(ratio.high)) == pytest.approx((0.5, 3.0), rel=1e-8)
    boxes = [Moments(4, point(Fraction(k)), point(Fraction(k * k))) for k in (3, 1, 2)]
    assert together(boxes) == Moments(4, Interval(Fraction(1), Fraction(3)), Interval(Fraction(1), Fraction(9)))


def test_p_of_f_is_that_of_its_definition() -> None:
    """Numerical integration of the density, F(3, 56)."""
    grid = np.linspace(2.12, 400, 2_000_001)
    integral = np.trapezoid(stats.f.pdf(grid, 3, 56), grid)
    assert float(p_of_f(point(Fraction("2.12")), (3, 56)).high) == pytest.approx(float(integral), rel=1e-6)
