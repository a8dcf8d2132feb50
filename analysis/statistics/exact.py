"""Exact arithmetic on answer ratios: means, sums of squares and least squares without rounding.

Answer ratios are integers over integers. Over one common denominator they are integers, in which a sum of squares
loses no digit and zero variance is exactly zero; only the last step, F or t, is a floating-point number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from operator import mul

Number = int | float | Fraction


class NotDefined(ValueError):
    """A statistic that these values do not define; the text says why."""


def integers(values: Sequence[Number]) -> tuple[list[int], int]:
    """The same values as integers over one common denominator; a float stands for exactly what it holds.

    Raises:
        ValueError: for a value that is not finite.
    """
    try:
        ratios = [value.as_integer_ratio() for value in values]
    except (ValueError, OverflowError) as error:
        raise ValueError(f"values must be finite, got {error}") from error
    common = math.lcm(*{denominator for _, denominator in ratios})
    return [numerator * (common // denominator) for numerator, denominator in ratios], common


def squares(values: Sequence[int]) -> int:
    """Number of values times the sum of their squared differences from the mean: an integer, as they are."""
    total, of_squares = sum(values), sum(map(mul, values, values))
    return int(len(values) * of_squares - total * total)


def mean(values: Sequence[Number]) -> Fraction:
    """Arithmetic mean.

    Raises:
        NotDefined: when there is no value.
        ValueError: for a value that is not finite.
    """
    if not values:
        raise NotDefined("no value, no mean")
    whole, common = integers(values)
    return Fraction(sum(whole), common * len(whole))


def sum_of_squares(values: Sequence[Number]) -> Fraction:
    """Sum of the squared differences from the mean.

    Raises:
        NotDefined: when there is no value.
        ValueError: for a value that is not finite.
    """
    if not values:
        raise NotDefined("no value, no sum of squares")
    whole, common = integers(values)
    return Fraction(squares(whole), len(whole) * common * common)


def reductions(normal: Sequence[Sequence[int]], right: Sequence[int], sizes: Sequence[int]) -> list[Fraction]:
    """Reduction in the sum of squares, R(model), by the first so many parameters of a least-squares fit.

    Elimination without fractions (Bareiss 1968) of the normal equations bordered by their right side: every number in
    it is an integer, every division leaves no rest, and the corner over the last pivot is minus the reduction.

    Args:
        normal: the normal equations X'WX, shape (p, p); parameters may depend on each other.
        right: X'Wy, shape (p,).
        sizes: how many parameters each model has, rising, 1..p.
    """
    rows = [[*row, value] for row, value in zip(normal, right, strict=True)]
    width = len(rows) + 1
    corner, before = 0, 1
    found: list[Fraction] = []
    for pivot, row in enumerate(rows):
        diagonal = row[pivot]
        if diagonal:
            for i in range(pivot + 1, len(rows)):
                factor, target = row[i], rows[i]
                rows[i] = [0] * i + [(target[j] * diagonal - factor * row[j]) // before for j in range(i, width)]
            corner = (corner * diagonal - row[-1] * row[-1]) // before
            before = diagonal
        if pivot + 1 == sizes[len(found)]:
            found.append(Fraction(-corner, before))
            if len(found) == len(sizes):
                break
    return found
