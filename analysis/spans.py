"""Spans of numbers with exact ends: what a printed number can stand for, and what follows from it.

Ends are rational numbers (or infinite) and may be open. What is computed in floating point is widened outward, so that
the true value always lies inside; that holds for results of 1e-300 and more in magnitude, and for 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction

End = Fraction | float
"""A rational number, or an infinity."""

SLACK = Fraction(1, 10**9)
"""Relative width by which a floating-point end is moved outward: far above its error, far below a printed digit."""


@dataclass(frozen=True)
class Span:
    """The numbers from `low` to `high`; an open end is not among them."""

    low: End
    high: End
    open_low: bool = False
    open_high: bool = False

    def holds(self, value: End) -> bool:
        """Whether `value` is among the numbers."""
        above = value > self.low or (value == self.low and not self.open_low)
        return above and (value < self.high or (value == self.high and not self.open_high))

    def meets(self, other: Span) -> bool:
        """Whether both have a number in common."""
        low, high = max(self.low, other.low), min(self.high, other.high)
        return low < high or (low == high and self.holds(low) and other.holds(low))

    def common(self, other: Span) -> Span:
        """The numbers of both; they must meet."""
        low, high = max(self.low, other.low), min(self.high, other.high)
        open_low = not (self.holds(low) and other.holds(low))
        open_high = not (self.holds(high) and other.holds(high))
        return Span(low, high, open_low and low < high, open_high and low < high)

    def times(self, factor: Fraction) -> Span:
        """Every number multiplied by `factor`, which is not 0."""
        low, high = self.low * factor, self.high * factor
        if factor < 0:
            return Span(high, low, self.open_high, self.open_low)
        return Span(low, high, self.open_low, self.open_high)

    def plus(self, other: Span) -> Span:
        """Every sum of a number of each."""
        open_low, open_high = self.open_low or other.open_low, self.open_high or other.open_high
        return Span(self.low + other.low, self.high + other.high, open_low, open_high)

    def squared(self) -> Span:
        """The squares of its numbers that are not negative; some must be."""
        high: End = self.high**2
        if self.low < 0:
            return Span(Fraction(0), high, open_high=self.open_high)
        low: End = self.low**2
        return Span(low, high, self.open_low, self.open_high)

    def absolute(self) -> Span:
        """The distances of its numbers from 0."""
        if self.low >= 0:
            return self
        if self.high <= 0:
            return self.times(Fraction(-1))
        farthest: End = max(-self.low, self.high)
        return Span(Fraction(0), farthest)


def point(value: End) -> Span:
    """One number."""
    return Span(value, value)


def outward(low: float, high: float) -> Span:
    """From `low` to `high`, both computed in floating point, widened by their error."""
    return Span(_moved(low, -SLACK), _moved(high, SLACK))


def image(function: Callable[[float], float], span: Span) -> Span:
    """What `function`, monotone on the span, makes of it."""
    ends = sorted((function(float(span.low)), function(float(span.high))))
    return outward(*ends)


def hull(spans: Iterable[Span]) -> Span:
    """The smallest closed interval that holds them all; there must be one."""
    held = list(spans)
    return Span(min(one.low for one in held), max(one.high for one in held))


def _moved(end: float, by: Fraction) -> End:
    if math.isinf(end):
        return end
    exact = Fraction(end)
    return exact + by * abs(exact)
