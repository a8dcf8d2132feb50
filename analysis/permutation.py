"""Mantel's test: do two tables of pairwise values go together, over every order of the objects.

The P is exact: rows and columns of one table are permuted together in all n! ways (Mantel 1967, Cancer Res. 27,
209-220), the order as it is among them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from math import factorial

import numpy as np
from numpy.typing import NDArray

from analysis.exact import NotDefined

MOST = 8
"""Objects of which all orders, 40,320, are tried."""


@dataclass(frozen=True)
class Mantel:
    """Result of `mantel`.

    Args:
        r: Pearson's correlation over the pairs.
        pairs: how many there are.
        orders: how many orders were tried, n!.
        p_less: share of orders with r at least as low; `p_greater` at least as high; `p_two` at least as far from 0.
    """

    r: float
    pairs: int
    orders: int
    p_less: float
    p_greater: float
    p_two: float


def mantel(first: NDArray[np.float64], second: NDArray[np.float64]) -> Mantel:
    """Exact test of two symmetric tables, shape (n, n), their diagonals left out.

    Raises:
        NotDefined: with fewer than three or more than `MOST` objects, or where the pairs of a table do not vary.
        ValueError: for tables of unlike shape, not symmetric, or with a pair that is not finite.
    """
    count = len(first)
    if first.shape != (count, count) or second.shape != first.shape:
        raise ValueError(f"got tables of {first.shape} and {second.shape}; allowed: two square ones of one size")
    if not 3 <= count <= MOST:
        raise NotDefined(f"an exact Mantel test needs 3 to {MOST} objects, got {count}")
    upper = np.triu_indices(count, k=1)
    for table in (first, second):
        if not (np.isfinite(table[upper]).all() and np.array_equal(table[upper], table.T[upper])):
            raise ValueError("a table of pairs must be symmetric and finite")
        if np.ptp(table[upper]) == 0:
            raise NotDefined("the pairs of one table do not vary: no correlation is defined")
    orders = np.array(list(permutations(range(count))))
    fixed = _standard(first[upper])
    moved = second[orders[:, upper[0]], orders[:, upper[1]]]
    all_r = (_standard(moved) * fixed).sum(axis=-1)
    r, slack = float(all_r[0]), 1e-12
    shares = [float(np.mean(hit)) for hit in (all_r <= r + slack, all_r >= r - slack, np.abs(all_r) >= abs(r) - slack)]
    return Mantel(r, len(upper[0]), factorial(count), *shares)


def _standard(values: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = values - values.mean(axis=-1, keepdims=True)
    found: NDArray[np.float64] = centred / np.sqrt((centred**2).sum(axis=-1, keepdims=True))
    return found
