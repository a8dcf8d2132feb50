"""The interval of values that a printed number can stand for.

Ends are rational or infinite and may be open; floating point is widened outward, which holds from 1e-300 on, and for 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, reduce

from palpate.analysis.published.printed import Printed

End = Fraction | float
"""A rational number, or an infinity."""

SLACK = Fraction(1, 10**9)
"""Relative width by which a floating-point end is moved outward: far above its error, far below a printed digit."""


@dataclass(frozen=True)
class Interval:
    """The numbers from `low` to `high`; an open end is not among them."""

    low: End
    high: End
    open_low: bool = False
    open_high: bool = False

    def holds(self, value: End) -> bool:
        """Return whether `value` is among the numbers."""
        above = value > self.low or (value == self.low and not self.open_low)
        return above and (value < self.high or (value == self.high and not self.open_high))

    def meets(self, other: Interval) -> bool:
        """Return whether both have a number in common."""
        low, high = max(self.low, other.low), min(self.high, other.high)
        return low < high or (low == high and self.holds(low) and other.holds(low))

    def common(self, other: Interval) -> Interval:
        """Return the numbers of both; they must meet."""
        low, high = max(self.low, other.low), min(self.high, other.high)
        open_low = not (self.holds(low) and other.holds(low))
        open_high = not (self.holds(high) and other.holds(high))
        return Interval(low, high, open_low and low < high, open_high and low < high)

    def times(self, factor: Fraction) -> Interval:
        """Return every number multiplied by `factor`, which is not 0."""
        low, high = self.low * factor, self.high * factor
        if factor < 0:
            return Interval(high, low, self.open_high, self.open_low)
        return Interval(low, high, self.open_low, self.open_high)

    def plus(self, other: Interval) -> Interval:
        """Return every sum of a number of each."""
        open_low, open_high = self.open_low or other.open_low, self.open_high or other.open_high
        return Interval(self.low + other.low, self.high + other.high, open_low, open_high)

    def squared(self) -> Interval:
        """Return the squares of those of its numbers that are not negative; there must be one."""
        high: End = self.high**2
        if self.low < 0:
            return Interval(Fraction(0), high, open_high=self.open_high)
        low: End = self.low**2
        return Interval(low, high, self.open_low, self.open_high)

    def whole(self) -> tuple[End, End]:
        """Return the least and the greatest whole number in the interval, least above greatest where there is none."""
        low: End = self.low if math.isinf(self.low) else Fraction(math.ceil(self.low))
        high: End = self.high if math.isinf(self.high) else Fraction(math.floor(self.high))
        return low + (self.open_low and low == self.low), high - (self.open_high and high == self.high)

    def absolute(self) -> Interval:
        """Return the distances of its numbers from 0."""
        if self.low >= 0:
            return self
        if self.high <= 0:
            return self.times(Fraction(-1))
        return Interval(Fraction(0), max(-self.low, self.high))


def point(value: End) -> Interval:
    """Return the interval of one number alone."""
    return Interval(value, value)


def outward(low: float, high: float) -> Interval:
    """Return the interval from `low` to `high`, both computed in floating point, widened by their error."""
    return Interval(_moved(low, -SLACK), _moved(high, SLACK))


def image(function: Callable[[float], float], span: Interval) -> Interval:
    """Return the values of `function`, which is monotone on the span."""
    return outward(*sorted((function(float(span.low)), function(float(span.high)))))


def hull(spans: Iterable[Interval]) -> Interval:
    """Return the smallest closed interval that holds all spans; there must be a span."""
    held = list(spans)
    return Interval(min(one.low for one in held), max(one.high for one in held))


def sum_of(spans: Iterable[Interval]) -> Interval:
    """Return every sum of one number of each interval."""
    return reduce(Interval.plus, spans, point(Fraction(0)))


def _moved(end: float, by: Fraction) -> End:
    if math.isinf(end):
        return end
    above, below = end.as_integer_ratio()
    return Fraction(above * by.denominator + abs(above) * by.numerator, below * by.denominator)


@cache
def rounded(printed: Printed) -> Interval:
    """Every value that rounding, half up, half down or half to even, prints like the number."""
    if printed.is_bound:
        return Interval(Fraction(0), printed.exact, open_high=True)
    half = printed.exact_unit / 2
    return Interval(printed.exact - half, printed.exact + half)


@cache
def truncated(printed: Printed) -> Interval:
    """Every value that prints like the number when its further digits are cut off."""
    if printed.is_bound:
        return rounded(printed)
    if not printed.exact_unit:
        return point(printed.exact)
    if not printed.exact:
        return Interval(-printed.exact_unit, printed.exact_unit, open_low=True, open_high=True)
    if printed.exact > 0:
        return Interval(printed.exact, printed.exact + printed.exact_unit, open_high=True)
    return Interval(printed.exact - printed.exact_unit, printed.exact, open_low=True)


@cache
def either(printed: Printed) -> Interval:
    """Every value that rounding or truncation prints like the number."""
    both = rounded(printed), truncated(printed)
    low, high = min(both, key=lambda one: (one.low, one.open_low)), max(both, key=lambda one: one.high)
    return Interval(low.low, high.high, low.open_low, high.open_high)


def as_printed(printed: Printed, value: float, further: int = 0) -> str:
    """Return `value` as text, with as many digits as the printed number has, and some `further` ones."""
    number = printed.text.removeprefix("<").strip()
    if "e" in number:
        digits = len(number.partition("e")[0].partition(".")[2]) + further
        mantissa, _, exponent = f"{value:.{digits}e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    if number.endswith("%"):
        return f"{100 * value:.{len(number.removesuffix('%').partition('.')[2]) + further}f}%"
    return f"{value:.{len(number.partition('.')[2]) + further}f}"
