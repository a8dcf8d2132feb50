"""Answers of many simulated participants at once: counts drawn from a choice model, from uniform numbers alone."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.choice_models import Answers

Counts = NDArray[np.int64]
Floats = NDArray[np.float64]

GUIDE = 1024
"""Cells of the unit interval; a power of 2, so that a number is put into its cell without rounding."""

MOST_GUIDED = 40
"""Trials up to which a guide, which is kept, is of less than 350 kB; more are searched."""


def draw(answers: Answers, *, trials: int, participants: int, studies: int, random: np.random.Generator) -> Counts:
    """Counts of every answer, Dirichlet-multinomial (multinomial without spread).

    One answer after the other is beta-binomial given those before it, and is found from a uniform number in the table
    of its distribution: the same counts wherever the generator's uniform numbers are the same.

    Args:
        answers: of one task.
        trials: of each material, for each participant.
        participants: in a study.
        studies: how many.
        random: source of uniform numbers.

    Returns:
        Shape (M, M + 1, studies, participants): presented, answered, the last answer "no material named".
    """
    materials = len(answers.shares)
    counts = np.zeros((materials, materials + 1, studies, participants), dtype=np.int64)
    for row, shares, spread in zip(counts, answers.shares.tolist(), answers.spread.tolist(), strict=True):
        left = np.full((studies, participants), trials, dtype=np.int64)
        for answer, share in enumerate(shares):
            rest = sum(shares[answer + 1 :])
            if share == 0:
                continue
            if rest == 0:
                row[answer] = left
                break
            inverse = _guided if trials <= MOST_GUIDED else Inverse
            row[answer] = inverse(trials, share, rest, spread).counts(left, random.random(left.shape))
            left -= row[answer]
    return counts


class Inverse:
    """Finds the counts that uniform numbers stand for, by search in the table of `distribution`."""

    def __init__(self, trials: int, share: float, rest: float, spread: float) -> None:
        self._row = trials + 1
        self._table = distribution(trials, share, rest, spread)

    def counts(self, left: Counts, uniform: Floats) -> Counts:
        """Of this answer, in `left` remaining trials; same shape."""
        # Row r of the table begins at r (trials + 1) and its values lie from r to r + 1.
        places = np.searchsorted(self._table, left + uniform, side="right")
        return np.asarray(np.minimum(places - left * self._row, left), dtype=np.int64)


class Guided(Inverse):
    """The same counts, most of them without a search (Chen and Asau 1974, On generating random variates from an
    empirical distribution, AIIE Transactions 6, 163-166).

    The unit interval is cut into cells for every number of remaining trials. Where both ends of a cell stand for one
    count, so does every number between them; only the others are searched.
    """

    def __init__(self, trials: int, share: float, rest: float, spread: float) -> None:
        super().__init__(trials, share, rest, spread)
        left = np.arange(trials + 1)[:, None]
        ends = super().counts(left, np.arange(GUIDE + 1) / GUIDE)
        self._guide = np.where(ends[:, :-1] == ends[:, 1:], ends[:, :-1], -1).ravel()

    def counts(self, left: Counts, uniform: Floats) -> Counts:
        """Of this answer, in `left` remaining trials; same shape."""
        cells = (uniform * GUIDE).astype(np.int64)
        cells += left * GUIDE
        found = self._guide.take(cells)
        searched = np.flatnonzero(found < 0)
        np.put(found, searched, super().counts(left.take(searched), uniform.take(searched)))
        return found


_guided = lru_cache(maxsize=256)(Guided)


def distribution(trials: int, share: float, rest: float, spread: float) -> NDArray[np.float64]:
    """Cumulative distribution of the count of one answer in 0..`trials` remaining trials, row after row.

    Args:
        trials: most trials that may remain.
        share: of this answer.
        rest: of all answers after it.
        spread: intraclass correlation; 0 makes it binomial.

    Returns:
        Shape ((trials + 1)^2,), rising: place r (trials + 1) + k holds r + P(count <= k | r remain).
    """
    from scipy.special import betaln, xlog1py, xlogy

    left, count = np.arange(trials + 1.0)[:, None], np.arange(trials + 1.0)[None, :]
    inside = count <= left
    missed = np.where(inside, left - count, 0.0)
    ways = -np.log(left + 1) - betaln(missed + 1, count + 1)
    if spread > 0:
        a, b = share * (1 / spread - 1), rest * (1 / spread - 1)
        log_p = ways + betaln(count + a, missed + b) - betaln(a, b)
    else:
        p = share / (share + rest)
        log_p = ways + xlogy(count, p) + xlog1py(missed, -p)
    below = np.cumsum(np.where(inside, np.exp(log_p), 0.0), axis=1)
    below[count >= left] = 1.0
    return np.asarray(np.ravel(left + np.minimum(below, 1.0)), dtype=np.float64)
