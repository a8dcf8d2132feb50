"""Statistics as intervals, from means and variances that are known only as far as they are printed.

Functions are monotone in each argument, or bounded by such, so that intervals contain the values of any data.
"""

import functools
import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from palpate.analysis.audit.granularity import Moments
from palpate.analysis.published.printed import Interval, hull, image, outward, point, sum_of
from palpate.analysis.statistics.inference import p_two_tailed


@dataclass(frozen=True)
class Margin:
    """The mean of one level of an effect, with the weight of a mean of `n` values."""

    n: int | Fraction
    mean: Interval


_Span = tuple[int | Fraction, Fraction, Fraction]
"""The weight of a mean, and the ends of its interval."""


def effect(moments: Moments, null: Fraction) -> Interval | None:
    """Return Cohen's d, (mean - null) / SD, or None where there is no spread at all."""
    if moments.variance.high == 0:
        return None
    distance = moments.mean.plus(point(-null))
    low_sd, high_sd = (math.sqrt(end) for end in (moments.variance.low, moments.variance.high))
    low = _over(float(distance.low), low_sd if distance.low < 0 else high_sd)
    high = _over(float(distance.high), low_sd if distance.high > 0 else high_sd)
    return outward(low, high)


@functools.lru_cache(maxsize=4096)
def t_of(effect_size: Interval, n: int) -> Interval:
    """Return Student's t of one sample, d sqrt(n)."""
    return image(lambda d: d * math.sqrt(n), effect_size)


@functools.lru_cache(maxsize=4096)
def p_of_t(t: Interval, df: int) -> Interval:
    """Return the two-tailed P of t."""
    return image(lambda distance: p_two_tailed(distance, df), t.absolute())


def p_of_f(f: Interval, df: tuple[int, int]) -> Interval:
    """Return the P of F."""
    from scipy.special import fdtrc

    # Intervals widened outward may reach just below 0, where there is no F.
    return image(lambda value: float(fdtrc(*df, max(value, 0.0))), f)


def margin(cells: Sequence[Moments]) -> Margin:
    """Return one level's mean over all values of its cells, which an effect that enters first compares."""
    n = sum(cell.n for cell in cells)
    return Margin(n, sum_of(cell.mean.times(Fraction(cell.n, n)) for cell in cells))


def unweighted(cells: Sequence[Moments]) -> Margin:
    """Return one level's mean of its cells' means (type III), with variance as Yates (1934, squares of means)."""
    variance = sum((Fraction(1, cell.n) for cell in cells), Fraction(0)) / len(cells) ** 2
    return Margin(1 / variance, sum_of(cell.mean.times(Fraction(1, len(cells))) for cell in cells))


def between(margins: Sequence[Margin]) -> Interval:
    """Return Σ n (mean - grand mean)², exact below, and around the intervals' middles above."""
    weight = sum(margin.n for margin in margins)
    spans = [(margin.n, Fraction(margin.mean.low), Fraction(margin.mean.high)) for margin in margins]
    centre = sum((n * (low + high) / 2 for n, low, high in spans), Fraction(0)) / weight
    most = sum((n * max(abs(low - centre), abs(high - centre)) ** 2 for n, low, high in spans), Fraction(0))
    return Interval(_least(spans), most)


def within(cells: Sequence[Moments]) -> Interval:
    """Return the sum of squares within cells, Σ (n - 1) variance."""
    low = sum(((cell.n - 1) * cell.variance.low for cell in cells), Fraction(0))
    return Interval(low, sum(((cell.n - 1) * cell.variance.high for cell in cells), Fraction(0)))


def f_of(effect_ss: Interval, residual_ss: Interval, df: tuple[int, int]) -> Interval:
    """Return the F of an effect's and the residual's sums of squares."""
    factor = df[1] / df[0]
    low = _over(float(effect_ss.low), float(residual_ss.high))
    return outward(factor * low, factor * _over(float(effect_ss.high), float(residual_ss.low)))


def quotient(above: Interval, below: Interval) -> Interval:
    """Return every ratio of two numbers that are not negative."""
    low = _over(max(float(above.low), 0.0), float(below.high))
    return outward(low, _over(float(above.high), max(float(below.low), 0.0)))


def together(moments: Sequence[Moments]) -> Moments:
    """Return one pair of intervals around all the means and variances that a cell can have."""
    return Moments(moments[0].n, hull(one.mean for one in moments), hull(one.variance for one in moments))


def _least(spans: Sequence[_Span]) -> Fraction:
    """Return the least sum of squares, convex in the common centre and quadratic between the intervals' ends."""
    ends = sorted({end for _, *both in spans for end in both})
    beyond = bisect_left(ends, Fraction(0), key=lambda at: -sum((n * off for n, off in _off(spans, at)), Fraction(0)))
    centre = (ends[max(beyond - 1, 0)] + ends[beyond]) / 2
    if pulls := _off(spans, centre):
        centre += sum((n * off for n, off in pulls), Fraction(0)) / sum(n for n, _ in pulls)
    return sum((n * off**2 for n, off in _off(spans, centre)), Fraction(0))


def _off(spans: Sequence[_Span], centre: Fraction) -> list[tuple[int | Fraction, Fraction]]:
    """Return how far each interval lies from a centre outside of it, with its weight."""
    return [(n, (low if centre < low else high) - centre) for n, low, high in spans if not low <= centre <= high]


def _over(above: float, below: float) -> float:
    if below == 0:
        return math.copysign(math.inf, above) if above else 0.0
    return above / below
