"""Similarity-choice model of a confusion matrix: how alike materials are, apart from which answers are favoured.

p(j | i) = s_ij b_j / sum_k s_ik b_k with s_ij = s_ji and s_ii = 1 (Shepard 1957; Luce 1963). As a model of counts it is
quasi-symmetry (Caussinus 1965), fitted here by iterative proportional fitting to the row sums, the column sums and the
sums n_ij + n_ji: maximum likelihood, no start value, and a similarity of exactly 0 where two materials were never
taken for one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.exact import NotDefined

TOLERANCE = 1e-10
"""Largest relative difference between a fitted sum and the counts' in the last round."""

ROUNDS = 20_000

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Choice:
    """Result of `similarity_choice`.

    Args:
        similarities: shape (M, M), 1 on the diagonal.
        biases: shape (M,), summing to 1; None where the materials fall into groups never taken for one another, between
            which no bias can be told.
        fitted: expected counts, shape (M, M).
        g2: likelihood-ratio statistic against the counts.
        df: (M - 1)(M - 2) / 2, less the cells that cannot but be empty.
        p: of `g2` as chi-squared; None without degrees of freedom.
    """

    similarities: Floats
    biases: Floats | None
    fitted: Floats
    g2: float
    df: int
    p: float | None


def similarity_choice(counts: NDArray[np.int64], materials: Sequence[str]) -> Choice:
    """Fit counts of presented x answered, shape (M, M); trials without an answer are left out before.

    Raises:
        NotDefined: for fewer than two materials, one that was never recognised, or an estimate on the edge.
    """
    count = len(counts)
    if count < 2:
        raise NotDefined(f"a choice model needs two materials, got {count}")
    never = [name for name, right in zip(materials, np.diag(counts), strict=True) if right == 0]
    if never:
        raise NotDefined(f"{', '.join(never)}: never recognised, so no similarity to it is defined")
    similarities, biases, fitted, settled = fit(counts[None])
    if not settled[0]:
        raise NotDefined(f"no fit in {ROUNDS} rounds: an estimate lies on the edge of what the choice model allows")
    seen = counts > 0
    g2 = 2 * float((counts[seen] * np.log(counts[seen] / fitted[0][seen])).sum())
    empty = np.count_nonzero(np.triu(counts + counts.T == 0, k=1))
    df = max((count - 1) * (count - 2) // 2 - int(empty), 0)
    held = biases[0] if _linked(similarities[0]) else None
    return Choice(similarities[0], held, fitted[0], max(g2, 0.0), df, _upper_tail(df, g2) if df else None)


def fit(counts: NDArray[np.int64], tolerance: float = TOLERANCE) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Fit many tables at once, shape (B, M, M), each with a diagonal above zero.

    Returns:
        similarities (B, M, M), biases (B, M), expected counts (B, M, M), and which tables settled (B,).
    """
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


def _linked(similarities: Floats) -> bool:
    """Whether every two materials are joined by a chain of confusions."""
    steps = np.linalg.matrix_power((similarities > 0).astype(np.float64), len(similarities))
    return bool((steps > 0).all())


def _upper_tail(df: int, value: float) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(df, value))
