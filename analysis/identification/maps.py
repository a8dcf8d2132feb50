"""How alike materials are: the similarity-choice model, a map of the materials, and Mantel's test.

The choice model is p(j | i) = s_ij b_j / sum_k s_ik b_k with s_ij = s_ji and s_ii = 1 (Shepard 1957; Luce 1963), fitted
as quasi-symmetry (Caussinus 1965) by iterative proportional fitting. The map is classical scaling (Torgerson 1952).
Mantel's test (1967, Cancer Res. 27, 209-220) permutes rows and columns of one table together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.statistics.exact import Floats, NotDefined

TOLERANCE = 1e-10
"""Largest relative difference between a fitted sum and the counts' in the last round."""

ROUNDS = 20_000


@dataclass(frozen=True)
class Choice:
    """A fitted similarity-choice model.

    `similarities` and expected counts `fitted` have shape (M, M). `biases`, shape (M,), sum to 1; None where groups of
    materials were never taken for one another. `g2` is on `df` = (M - 1)(M - 2) / 2 degrees of freedom, less cells that
    must be empty.
    """

    similarities: Floats
    biases: Floats | None
    fitted: Floats
    g2: float
    df: int


def similarity_choice(counts: NDArray[np.int64], materials: Sequence[str]) -> Choice:
    """Return the model fitted to counts of presented x answered, shape (M, M), without the unanswered trials.

    Raises `NotDefined` for fewer than two materials, one that was never recognised, or an estimate on the edge.
    """
    count = len(counts)
    if count < 2:
        raise NotDefined(f"a choice model needs two materials, got {count}")
    never = [name for name, right in zip(materials, np.diag(counts), strict=True) if right == 0]
    if never:
        raise NotDefined(f"{', '.join(never)}: never recognized, so its similarities are not defined")
    similarities, biases, fitted, settled = fit(counts[None])
    if not settled[0]:
        raise NotDefined(f"no fit in {ROUNDS} iterations: an estimate is on the boundary of the choice model")
    seen = counts > 0
    g2 = 2 * float((counts[seen] * np.log(counts[seen] / fitted[0][seen])).sum())
    empty = np.count_nonzero(np.triu(counts + counts.T == 0, k=1))
    df = max((count - 1) * (count - 2) // 2 - int(empty), 0)
    linked = (np.linalg.matrix_power((similarities[0] > 0).astype(np.float64), count) > 0).all()
    held = biases[0] if linked else None
    return Choice(similarities[0], held, fitted[0], max(g2, 0.0), df)


def fit(counts: NDArray[np.int64], tolerance: float = TOLERANCE) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Return similarities (B, M, M), biases (B, M), fitted counts (B, M, M), and which of the tables settled (B,)."""
    table = counts.astype(np.float64)
    size = len(table)
    both = table + table.swapaxes(1, 2)
    rows, columns = table.sum(axis=2), table.sum(axis=1)
    alike, bias = np.where(both > 0, 1.0, 0.0), np.ones_like(columns)
    scale = np.ones_like(rows)
    open_ = np.arange(size)
    for _ in range(ROUNDS):
        s, b, a = alike[open_], bias[open_], scale[open_]
        a = rows[open_] / (s * b[:, None, :]).sum(axis=2)
        drift = np.abs((a[:, :, None] * s).sum(axis=1) * b / columns[open_] - 1).max(axis=1)
        b = columns[open_] / (a[:, :, None] * s).sum(axis=1)
        expected = a[:, :, None] * s * b[:, None, :]
        ratio = np.divide(both[open_], expected + expected.swapaxes(1, 2), out=np.zeros_like(s), where=both[open_] > 0)
        drift = np.maximum(drift, np.abs(np.where(both[open_] > 0, ratio - 1, 0)).max(axis=(1, 2)))
        alike[open_], bias[open_], scale[open_] = s * ratio, b, a
        open_ = open_[drift > tolerance]
        if not open_.size:
            break
    settled = np.ones(size, dtype=np.bool_)
    settled[open_] = False
    fitted = scale[:, :, None] * alike * bias[:, None, :]
    own = np.sqrt(np.diagonal(alike, axis1=1, axis2=2))
    similarities = alike / (own[:, :, None] * own[:, None, :])
    biases = bias * own
    return similarities, biases / biases.sum(axis=1, keepdims=True), fitted, settled


@dataclass(frozen=True)
class Scaling:
    """A map: points, (n, 2), on the principal axes, and shares of eigenvalues `explained` by both and `negative`."""

    points: NDArray[np.float64]
    explained: float
    negative: float


def classical(dissimilarities: NDArray[np.float64]) -> Scaling:
    """Return the map of a symmetric table of dissimilarities, shape (n, n), with a diagonal of 0.

    Raises `NotDefined` with fewer than three objects, a pair that is not finite, or no dissimilarity at all.
    """
    count = len(dissimilarities)
    if count < 3:
        raise NotDefined(f"scaling needs three objects, got {count}")
    if not np.isfinite(dissimilarities).all():
        raise NotDefined("a dissimilarity is not defined, so neither are the distances")
    centring = np.eye(count) - 1 / count
    values, vectors = np.linalg.eigh(-centring @ dissimilarities**2 @ centring / 2)
    positive = values[values > 0].sum()
    if positive <= 1e-12:
        raise NotDefined("all dissimilarities are 0, so all objects are at one point")
    points = vectors[:, :-3:-1] * np.sqrt(np.maximum(values[:-3:-1], 0))
    points *= np.where(points[0] < 0, -1.0, 1.0)
    explained = float(np.maximum(values[:-3:-1], 0).sum() / positive)
    return Scaling(points, explained, abs(float(values[values < 0].sum() / np.abs(values).sum())))


def from_confusions(ratios: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 - (p_ij + p_ji) / (p_ii + p_jj) of answer ratios, shape (n, n), floored at 0 (Shepard 1957), or NaN."""
    correct = np.diag(ratios)
    both = correct[:, None] + correct[None, :]
    confused = ratios + ratios.T
    share = np.divide(confused, both, out=np.full_like(both, np.nan), where=both > 0)
    found: NDArray[np.float64] = np.maximum(1 - share, 0.0)
    np.fill_diagonal(found, 0.0)
    return found


MOST = 8
"""The most objects of which all orders (40,320) are tried."""

ORDERS = 9999
"""The random orders of more objects; the observed order counts as one more."""


@dataclass(frozen=True)
class Mantel:
    """Pearson's r over the pairs, and the shares of `orders`, all n! if `exact`, with r as low, high, or far from 0."""

    r: float
    pairs: int
    orders: int
    exact: bool
    p_less: float
    p_greater: float
    p_two: float


def mantel(first: NDArray[np.float64], second: NDArray[np.float64], rng: np.random.Generator) -> Mantel:
    """Return the test of two symmetric tables, shape (n, n), without their diagonals: exact up to `MOST` objects.

    Raises `NotDefined` with fewer than three objects, or where the pairs of a table do not vary, and `ValueError` for
    tables of unlike shape, not symmetric, or with a pair that is not finite.
    """
    count = len(first)
    if first.shape != (count, count) or second.shape != first.shape:
        raise ValueError(f"got tables of {first.shape} and {second.shape}; allowed: two square tables of the same size")
    if count < 3:
        raise NotDefined(f"Mantel's test needs 3 objects, got {count}")
    upper = np.triu_indices(count, k=1)
    for table in (first, second):
        if not (np.isfinite(table[upper]).all() and np.array_equal(table[upper], table.T[upper])):
            raise ValueError("a table of pairs must be symmetric and finite")
        if np.ptp(table[upper]) == 0:
            raise NotDefined("the pairs of one table do not vary, so the correlation is not defined")
    exact = count <= MOST
    drawn = permutations(range(count)) if exact else rng.permuted(np.tile(np.arange(count), (ORDERS, 1)), axis=1)
    orders = np.array([*([] if exact else [range(count)]), *drawn])
    fixed = _standard(first[upper])
    moved = second[orders[:, upper[0]], orders[:, upper[1]]]
    all_r = (_standard(moved) * fixed).sum(axis=-1)
    r, slack = float(all_r[0]), 1e-12
    shares = [float(np.mean(hit)) for hit in (all_r <= r + slack, all_r >= r - slack, np.abs(all_r) >= abs(r) - slack)]
    return Mantel(r, len(upper[0]), len(orders), exact, *shares)


def _standard(values: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = values - values.mean(axis=-1, keepdims=True)
    found: NDArray[np.float64] = centred / np.sqrt((centred**2).sum(axis=-1, keepdims=True))
    return found
