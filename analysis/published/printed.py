"""A number as it is printed."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property

POSITIVE = r"([0-9]{1,15}(\.[0-9]{1,15})?|\.[0-9]{1,15})(e-[0-9]{1,2})?%?"
"""The numbers without a sign that `Printed` reads; `-` or `<` may stand before them."""


@dataclass(frozen=True)
class Printed:
    """A number as printed. A bare "0" has a unit of 0, "<0.001" is 0 to the bound, and a percentage a ratio."""

    text: str

    @property
    def value(self) -> float:
        """The number in floating point; a percentage is a ratio."""
        return float(self._decimal)

    @cached_property
    def exact(self) -> Fraction:
        """The number exactly as it stands."""
        return Fraction(self._decimal)

    @property
    def unit(self) -> float:
        """One unit of the last printed digit."""
        return float(self.exact_unit)

    @property
    def is_bound(self) -> bool:
        """Whether an upper bound is printed in the place of a number."""
        return self.text.startswith("<")

    @cached_property
    def exact_unit(self) -> Fraction:
        """One unit of the last printed digit, exactly."""
        if self.text == "0" or self.is_bound:
            return Fraction(0)
        return Fraction(Decimal(1).scaleb(int(self._decimal.as_tuple().exponent)))

    @property
    def _decimal(self) -> Decimal:
        number = self.text.removeprefix("<").strip()
        if number.endswith("%"):
            return Decimal(number.removesuffix("%")).scaleb(-2)
        return Decimal(number)
