"""Multidimensional scaling: materials as points whose distances come close to their dissimilarities.

Classical scaling (Torgerson 1952): the leading eigenvectors of the doubly centred squared dissimilarities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.exact import NotDefined


@dataclass(frozen=True)
class Scaling:
    """Result of `classical`.

    Args:
        points: shape (n, 2), centred; turned to the principal axes, the first point's coordinates not negative.
        explained: share of the sum of the positive eigenvalues that the two axes take.
        negative: sum of the negative eigenvalues over the sum of all magnitudes: 0 where distances in some
            dimension would give the dissimilarities exactly.
    """

    points: NDArray[np.float64]
    explained: float
    negative: float


def classical(dissimilarities: NDArray[np.float64]) -> Scaling:
    """Two dimensions of a symmetric table, shape (n, n), diagonal 0.

    Raises:
        NotDefined: with fewer than three objects, a pair that is not finite, or no dissimilarity at all.
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
        raise NotDefined("all dissimilarities are 0: every object is at one point")
    points = vectors[:, :-3:-1] * np.sqrt(np.maximum(values[:-3:-1], 0))
    points *= np.where(points[0] < 0, -1.0, 1.0)
    explained = float(np.maximum(values[:-3:-1], 0).sum() / positive)
    return Scaling(points, explained, abs(float(values[values < 0].sum() / np.abs(values).sum())))


def from_confusions(ratios: NDArray[np.float64]) -> NDArray[np.float64]:
    """Dissimilarity of two materials from answer ratios, shape (n, n): 1 - (p_ij + p_ji) / (p_ii + p_jj).

    Shepard's (1957) ratio of confusions to correct answers, floored at 0. NaN where neither was ever recognised or
    presented.
    """
    correct = np.diag(ratios)
    both = correct[:, None] + correct[None, :]
    confused = ratios + ratios.T
    share = np.divide(confused, both, out=np.full_like(both, np.nan), where=both > 0)
    found: NDArray[np.float64] = np.maximum(1 - share, 0.0)
    np.fill_diagonal(found, 0.0)
    return found
