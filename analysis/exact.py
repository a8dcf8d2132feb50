"""Exact arithmetic on answer ratios: means, sums of squares and least squares in rational numbers.

Answer ratios are integers over integers. In rational arithmetic a sum of squares loses no digit, and zero
variance is exactly zero; only the last step, F or t, is a floating-point number.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

Number = int | float | Fraction


class NotDefined(ValueError):
    """A statistic that these values do not define; the text says why."""


def fractions(values: Sequence[Number]) -> list[Fraction]:
    """The same values as rational numbers; a float stands for exactly what it holds.

    Raises:
        ValueError: for a value that is not finite.
    """
    try:
        return [Fraction(value) for value in values]
    except (ValueError, OverflowError) as error:
        raise ValueError(f"values must be finite, got {error}") from error


def mean(values: Sequence[Fraction]) -> Fraction:
    """Arithmetic mean.

    Raises:
        NotDefined: when there is no value.
    """
    if not values:
        raise NotDefined("no value, no mean")
    return sum(values, Fraction(0)) / len(values)


def sum_of_squares(values: Sequence[Fraction]) -> Fraction:
    """Sum of the squared differences from the mean."""
    centre = mean(values)
    return sum(((value - centre) ** 2 for value in values), Fraction(0))


def reduction(design: Sequence[Sequence[int]], weights: Sequence[int], means: Sequence[Fraction]) -> Fraction:
    """Reduction in the sum of squares, R(model), by weighted least squares on cell means.

    Args:
        design: one row a cell, one column a parameter; columns may depend on each other.
        weights: values in each cell.
        means: mean of each cell.
    """
    size = len(design[0])
    cells = list(zip(design, weights, means, strict=True))
    normal = [[Fraction(sum(w * row[i] * row[j] for row, w, _ in cells)) for j in range(size)] for i in range(size)]
    right = [sum((w * row[i] * y for row, w, y in cells), Fraction(0)) for i in range(size)]
    left = list(right)
    total = Fraction(0)
    for pivot in range(size):
        diagonal = normal[pivot][pivot]
        if diagonal == 0:
            continue
        total += left[pivot] ** 2 / diagonal
        for i in range(pivot + 1, size):
            factor = normal[i][pivot] / diagonal
            left[i] -= factor * left[pivot]
            for j in range(pivot, size):
                normal[i][j] -= factor * normal[pivot][j]
    return total
