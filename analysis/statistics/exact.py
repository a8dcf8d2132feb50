"""Answer ratios without rounding, for one study or for many at once.

A ratio is an integer over an integer, so over one common denominator a sum of squares loses no digit, and no variance
is exactly zero. One study holds Python's integers, which have any size (as NIST's SmLs07 to SmLs09 need), and all that
is made of them is a fraction until its last step; many studies hold integers of 64 bits, and what follows is float64.
The same functions take both: studies lie along the last axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

Number = int | float | Fraction
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Values = NDArray[Any]
"""Fractions or Python's integers of one study, or float64 or int64 of many; shape (..., studies)."""


class NotDefined(ValueError):
    """A statistic that these values do not define; the text says why."""


def integers(values: Sequence[Number]) -> tuple[list[int], int]:
    """Return the same values as integers over one common denominator; a float stands for exactly what it holds.

    Raises:
        ValueError: for a value that is not finite.
    """
    try:
        ratios = [value.as_integer_ratio() for value in values]
    except (ValueError, OverflowError) as error:
        raise ValueError(f"values must be finite, got {error}") from error
    common = math.lcm(*{denominator for _, denominator in ratios})
    return [numerator * (common // denominator) for numerator, denominator in ratios], common


def mean(values: Sequence[Number]) -> Fraction:
    """Return the arithmetic mean.

    Raises:
        NotDefined: when there is no value.
        ValueError: for a value that is not finite.
    """
    if not values:
        raise NotDefined("no value, no mean")
    whole, common = integers(values)
    return Fraction(sum(whole), common * len(whole))


def sum_of_squares(values: Sequence[Number]) -> Fraction:
    """Return the sum of the squared differences from the mean; errors as `mean`."""
    if not values:
        raise NotDefined("no value, no sum of squares")
    whole, common = integers(values)
    total = sum(whole)
    return Fraction(len(whole) * sum(map(mul, whole, whole)) - total * total, len(whole) * common * common)


def over(above: Any, below: Any) -> Values:
    """Return each quotient: a fraction of Python's integers, a float64 of numpy's."""
    if np.asarray(above).dtype == object:
        return np.asarray(_fractions(above, below), dtype=object)
    return np.asarray(above / below)


_fractions = np.frompyfunc(Fraction, 2, 1)


def floats(values: Any) -> Floats:
    """Return the values as float64, each rounded once."""
    return np.asarray(values, dtype=np.float64)


@dataclass(frozen=True)
class Ratios:
    """The ratios in every cell of a table, by the sums of their numerators.

    Args:
        denominator: of every ratio, or of those of each cell, shape (cells, 1).
        participants: in every cell, or in each, shape (cells, 1).
        sums: of the numerators, shape (..., studies).
        squares: sums of the squared numerators, the same shape.
    """

    denominator: Any
    participants: Any
    sums: Values
    squares: Values

    def __getitem__(self, cells: Any) -> Ratios:
        """Return some of the cells, where all have the same participants and denominator."""
        return Ratios(self.denominator, self.participants, self.sums[cells], self.squares[cells])

    @property
    def exact(self) -> bool:
        """Whether these are one study's, without rounding."""
        return self.sums.dtype == object

    @property
    def means(self) -> Values:
        """The mean ratio of each cell, shape (..., studies)."""
        return over(self.sums, self.participants * self.denominator)

    @property
    def scatter(self) -> Values:
        """Squared differences of the numerators from their mean, summed, times the participants: integers."""
        return np.asarray(self.participants * self.squares - self.sums * self.sums)

    @cached_property
    def within(self) -> Values:
        """Squared differences of the ratios from the mean of their cell, summed over the first axis."""
        return np.asarray(over(self.scatter, self.participants * self.denominator**2).sum(axis=0))


def of_groups(groups: Sequence[Sequence[Number]]) -> Ratios:
    """Return the exact ratios of one study, a cell for each group, shape (groups, 1).

    Raises:
        ValueError: for a value that is not finite.
    """
    whole, common = integers([value for group in groups for value in group])
    ends = np.cumsum([len(group) for group in groups]).tolist()
    parts = [whole[end - len(group) : end] for group, end in zip(groups, ends, strict=True)]
    sizes, sums = ([[function(part)] for part in parts] for function in (len, sum))
    squares = [[sum(map(mul, part, part))] for part in parts]
    return Ratios(common, *(np.array(of, dtype=object) for of in (sizes, sums, squares)))


def of_counts(counts: Integers, trials: int) -> Ratios:
    """Return the ratios of many studies from counts out of `trials`, shape (..., studies, participants)."""
    sums, squares = np.einsum("...i->...", counts), np.einsum("...i,...i->...", counts, counts)
    return Ratios(trials, counts.shape[-1], sums, squares)


@dataclass(frozen=True)
class Tested:
    """A statistic of each study and its P, shape (..., studies); NaN where the values do not define it.

    NaN is there on purpose: no comparison with a level is ever true of it. Whoever asks counts it.
    """

    statistic: Floats
    p: Floats


def undefined(shape: tuple[int, ...]) -> Tested:
    """Return a statistic that no study defines."""
    return Tested(np.full(shape, np.nan), np.full(shape, np.nan))


def ratio(above: Any, below: Any) -> Any:
    """Return each quotient, rounded once; NaN where the denominator is not above zero. A float of two integers."""
    if isinstance(below, int):
        return above / below if below > 0 else math.nan
    defined = np.asarray(below > 0, dtype=np.bool_)
    return np.where(defined, floats(above / np.where(defined, below, 1)), np.nan)


def f_test(effect: Values, within: Values, df1: Any, df2: int) -> Tested:
    """Return F and P of an effect's sum of squares beside that within cells; NaN where that is zero."""
    from scipy.special import fdtrc

    f = ratio(effect * df2, within * df1)
    return Tested(f, fdtrc(df1, max(df2, 1), f))
