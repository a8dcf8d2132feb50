"""A bias and lapse model of answers: each trial is known, or lapses and is guessed by a bias.

P(j | i) = (1 - lapse_i) [j = i] + lapse_i b_j (Townsend 1971, Percept. Psychophys. 9, 40-50). Wrong answers are
quasi-independent (Goodman 1968, J. Am. Stat. Assoc. 63, 1091-1131), fitted by iterative proportional fitting.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import xlogy

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined

TOLERANCE, STEPS = 1e-13, 2000
"""The relative change of a bias at which fitting ends, and the most of its steps."""

SETTLED = 1e-9
"""A bias that moves by more in its last step has not come to rest."""

GUESSES = 2.705543454095404
"""The 90 % quantile of chi-squared on 1 df: below it a likelihood ratio does not show, at 5 %, that somebody knows."""


@dataclass(frozen=True)
class Lapses:
    """Lapses by material, (M,), above 1 where guesses do better, and of all trials; biases, (M,); deviance and df."""

    lapse: float
    lapses: Floats
    biases: Floats
    g2: float
    df: int


def fit(counts: Integers) -> Lapses:
    """Return the fit of counts by presented and answered material, shape (M, M).

    Raises `NotDefined` below three materials, for one without a trial, and where wrong answers leave a bias open.
    """
    materials = len(counts)
    if materials < 3:
        raise NotDefined(f"the lapse model needs 3 materials, got {materials}")
    if not counts.sum(axis=1).all():
        raise NotDefined("a material was never presented")
    a, b = (one[0] for one in fits(counts[None]))
    if not np.isfinite(a).all():
        raise NotDefined(
            "nearly all wrong answers named one material, or there were none, so the biases are not determined"
        )
    wrong = counts - np.diag(np.diag(counts))
    fitted = np.outer(a, b)
    np.fill_diagonal(fitted, 0.0)
    g2 = float(2 * (xlogy(wrong, wrong) - xlogy(wrong, np.where(fitted > 0, fitted, 1.0))).sum())
    trials = counts.sum(axis=1)
    rows, columns = wrong.any(axis=1), wrong.any(axis=0)
    # Cells without their margin are fitted by 0 and deviate from nothing (Bishop, Fienberg and Holland 1975, ch. 5.2).
    cells = int((np.outer(rows, columns) & ~np.eye(materials, dtype=bool)).sum())
    df = max(cells - int(rows.sum()) - int(columns.sum()) + 1, 0)
    return Lapses(float(a.sum() / trials.sum()), a / trials, b, max(g2, 0.0), df)


def fits(counts: Integers) -> tuple[Floats, Floats]:
    """Return the trials guessed by material, and the biases, (..., M), of tables (..., M, M); NaN if undefined."""
    off = 1.0 - np.eye(counts.shape[-1])
    wrong = counts * off
    rows, columns = wrong.sum(axis=-1), wrong.sum(axis=-2)
    # Without two other materials that are named, the guesses at the one that takes all cannot be counted.
    open_ = (np.count_nonzero(columns, axis=-1) < 3) | (np.count_nonzero(rows, axis=-1) < 2)
    b = np.where(open_[..., None], 1.0, columns)
    b /= b.sum(axis=-1, keepdims=True)
    for _ in range(STEPS):
        a = rows / (1 - b)
        reached = a.sum(axis=-1, keepdims=True) - a
        following = columns / np.where(reached > 0, reached, np.inf)
        total = following.sum(axis=-1, keepdims=True)
        following /= np.where(total > 0, total, 1.0)
        moved = np.where(open_, 0.0, np.abs(following - b).max(axis=-1))
        b = np.where(open_[..., None], b, following)
        if moved.max(initial=0.0) < TOLERANCE:
            break
    # A bias that still creeps runs to 1 or 0: the likelihood has no greatest value inside.
    open_ = open_ | (moved >= SETTLED)
    a = np.where(open_[..., None], np.nan, rows / (1 - b))
    return a, np.where(open_[..., None], np.nan, b)


def knowing(right: Integers, trials: Integers, biases: Floats) -> tuple[Floats, Floats]:
    """Return the share of trials that each participant knew, and 2 log likelihood ratios to knowing none.

    Counts have the shape (participants, M), biases (M,).
    """
    low, high = np.zeros(len(right)), np.full(len(right), 1 - 1e-12)
    wrong = (trials - right).sum(axis=1)

    def chances(known: Floats) -> Floats:
        return np.asarray(known[:, None] + (1 - known[:, None]) * biases)

    for _ in range(60):
        middle = (low + high) / 2
        slope = (right * (1 - biases) / chances(middle)).sum(axis=1) - wrong / (1 - middle)
        low, high = np.where(slope > 0, middle, low), np.where(slope > 0, high, middle)
    known = (low + high) / 2

    def height(at: Floats) -> Floats:
        return np.asarray(xlogy(right, chances(at)).sum(axis=1) + xlogy(wrong, 1 - at))

    return known, np.maximum(2 * (height(known) - height(np.zeros(len(right)))), 0.0)
