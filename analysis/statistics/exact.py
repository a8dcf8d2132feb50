"""Answer ratios without rounding, for one study or for many at once.

One study has Python's integers over a common denominator (NIST's SmLs07 to SmLs09); many, along the last axis, integers
of 64 bits, then float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from operator import mul
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

T = TypeVar("T")
Number = int | float | Fraction
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Values = NDArray[Any]
"""Fractions or Python's integers of one study, or float64 or int64 of many; shape (..., studies)."""

_fractions = np.frompyfunc(Fraction, 2, 1)


class NotDefined(ValueError):
    """These values do not define the statistic; the text says why."""


def defined(compute: Callable[[], T]) -> tuple[T | None, str]:
    """Return what is computed and no reason, or None and why it is not defined."""
    try:
        return compute(), ""
    except NotDefined as reason:
        return None, str(reason)


class Statements(dict[str, str]):
    """Why statistics are missing, by their names."""

    def compute(self, what: str, compute: Callable[[], T]) -> T | None:
        """Return what is computed; where it is not defined, None, and keep why."""
        found, why = defined(compute)
        if why:
            self[what] = why
        return found


def integers(values: Sequence[Number]) -> tuple[list[int], int]:
    """Return finite values as integers over one common denominator; a float counts as exactly what it holds."""
    try:
        ratios = [value.as_integer_ratio() for value in values]
    except (ValueError, OverflowError) as error:
        raise ValueError(f"values must be finite, got {error}") from error
    common = math.lcm(*{denominator for _, denominator in ratios})
    return [numerator * (common // denominator) for numerator, denominator in ratios], common


def quotient(above: Any, below: Any) -> Values:
    """Return each quotient: a fraction of Python's integers, a float64 of numpy's."""
    if np.asarray(above).dtype == object:
        return np.asarray(_fractions(above, below), dtype=object)
    return np.asarray(above / below)


def mean_shares(right: Integers, trials: Integers) -> Any:
    """Return the mean share of right answers of each participant over materials, fractions of shape (tasks, people).

    Both have shape (tasks, materials, people), and every trial counts.
    """
    shares = _fractions(right.astype(object), trials.astype(object))
    return shares.sum(axis=1) / shares.shape[1]


def mean_gaps(right: Integers, trials: Integers) -> list[Fraction]:
    """Return how much more often each participant is right in the first task than in the second: `mean_shares`."""
    first, second = mean_shares(right, trials)
    return list(first - second)


def floats(values: Any) -> Floats:
    """Return the values as float64, each rounded once."""
    return np.asarray(values, dtype=np.float64)


@dataclass(frozen=True)
class Ratios:
    """Ratios of every cell, by sums of numerators and of their squares, shape (..., studies).

    Denominator and participants are one number, or one a cell, shape (cells, 1).
    """

    denominator: Any
    participants: Any
    sums: Values
    squares: Values

    def __getitem__(self, cells: Any) -> Ratios:
        """Return some of the cells of a table in which all have the same participants and denominator."""
        return Ratios(self.denominator, self.participants, self.sums[cells], self.squares[cells])

    @property
    def exact(self) -> bool:
        """Whether these are the ratios of one study, without rounding."""
        return self.sums.dtype == object

    @property
    def means(self) -> Values:
        """The mean ratio of each cell, shape (..., studies)."""
        return quotient(self.sums, self.participants * self.denominator)

    @property
    def scatter(self) -> Values:
        """Squared differences of the numerators from their mean, summed, times the participants: integers."""
        return np.asarray(self.participants * self.squares - self.sums * self.sums)

    @cached_property
    def ss_within(self) -> Values:
        """Squared differences of the ratios from the mean of their cell, summed over the first axis."""
        if self.exact:
            common = math.lcm(*self.participants.ravel().tolist())
            return quotient((common // self.participants * self.scatter).sum(axis=0), common * self.denominator**2)
        return np.asarray(quotient(self.scatter, self.participants * self.denominator**2).sum(axis=0))


def of_groups(groups: Sequence[Sequence[Number]]) -> Ratios:
    """Return the exact ratios of one study, from finite values, with a cell for each group, shape (groups, 1)."""
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
    """A statistic of each study and its P, shape (..., studies); NaN where the values do not define them."""

    statistic: Floats
    p: Floats


def undefined(shape: tuple[int, ...]) -> Tested:
    """Return a statistic that no study defines, and its P."""
    return Tested(np.full(shape, np.nan), np.full(shape, np.nan))


def ratio(above: Any, below: Any) -> Any:
    """Return each quotient, rounded once; NaN where the denominator is not above zero. Two integers give a float."""
    if isinstance(below, int):
        return above / below if below > 0 else math.nan
    if below.dtype == object:
        return floats(_quotients(above, below))
    defined = below > 0
    return np.where(defined, above / np.where(defined, below, 1), np.nan)


_quotients = np.frompyfunc(
    lambda a, b: a.numerator * b.denominator / (a.denominator * b.numerator) if b > 0 else math.nan, 2, 1
)


def f_test(effect: Values, within: Values, df1: Any, df2: int) -> Tested:
    """Return F and P of an effect's sum of squares against that within cells; NaN where that is zero."""
    f = ratio(effect * df2, within * df1)
    return Tested(f, fdtrc(df1, max(df2, 1), f))
