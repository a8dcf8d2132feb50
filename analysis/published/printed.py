"""A number as it is printed, and the values that it can stand for."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

from analysis.spans import Span, point

POSITIVE = r"([0-9]{1,15}(\.[0-9]{1,15})?|\.[0-9]{1,15})(e-[0-9]{1,2})?%?"
"""The numbers without a sign that `Printed` reads; it reads `-` or `<` before them."""


@dataclass(frozen=True)
class Printed:
    """A number as it is printed: its text tells value and precision.

    `unit` is one unit of the last printed digit. A bare "0" is a count of nothing, with no digit to round: unit 0.
    "<0.001" stands for everything from 0 to below the bound. A percentage is a ratio.
    """

    text: str

    @property
    def value(self) -> float:
        """The number; a percentage as a ratio."""
        return float(self._decimal)

    @property
    def exact(self) -> Fraction:
        """The number as it stands."""
        return Fraction(self._decimal)

    @property
    def unit(self) -> float:
        """One unit of the last printed digit."""
        return float(self.exact_unit)

    @property
    def is_bound(self) -> bool:
        """Whether an upper bound is printed in the place of a number."""
        return self.text.startswith("<")

    @property
    def rounded(self) -> Span:
        """Every value that rounding, half up, half down or half to even, prints like this."""
        if self.is_bound:
            return Span(Fraction(0), self.exact, open_high=True)
        half = self.exact_unit / 2
        return Span(self.exact - half, self.exact + half)

    @property
    def truncated(self) -> Span:
        """Every value that prints like this when further digits are cut off."""
        if self.is_bound:
            return self.rounded
        if not self.exact_unit:
            return point(self.exact)
        if not self.exact:
            return Span(-self.exact_unit, self.exact_unit, open_low=True, open_high=True)
        if self.exact > 0:
            return Span(self.exact, self.exact + self.exact_unit, open_high=True)
        return Span(self.exact - self.exact_unit, self.exact, open_low=True)

    @property
    def either(self) -> Span:
        """Every value that rounding or truncation prints like this."""
        both = self.rounded, self.truncated
        low, high = min(both, key=lambda one: (one.low, one.open_low)), max(both, key=lambda one: one.high)
        return Span(low.low, high.high, low.open_low, high.open_high)

    @property
    def exact_unit(self) -> Fraction:
        """`unit` as it stands."""
        if self.text == "0" or self.is_bound:
            return Fraction(0)
        return Fraction(Decimal(1).scaleb(int(self._decimal.as_tuple().exponent)))

    @property
    def _decimal(self) -> Decimal:
        number = self.text.removeprefix("<").strip()
        if number.endswith("%"):
            return Decimal(number.removesuffix("%")).scaleb(-2)
        return Decimal(number)


def as_printed(printed: Printed, value: float) -> str:
    """`value` with as many digits as the printed number has."""
    number = printed.text.removeprefix("<").strip()
    if "e" in number:
        digits = len(number.partition("e")[0].partition(".")[2])
        mantissa, _, exponent = f"{value:.{digits}e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    if number.endswith("%"):
        return f"{100 * value:.{len(number.removesuffix('%').partition('.')[2])}f}%"
    return f"{value:.{len(number.partition('.')[2])}f}"
