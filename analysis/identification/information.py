"""Information that the answers transmit about the materials, in bits, and d' of identification.

Transmitted information is that of a table of counts (Miller and Nicely 1955; Garner and Hake 1951); few trials make it
too large. It is corrected by Miller and Madow's way (Miller 1955) with the answers that occurred, and by that of
Panzeri and Treves (1996, Network 7, 87-107), which estimates how many answers can occur to each material.

d' is that of the strongest of m independent, unbiased alternatives (m-AFC): the share of correct answers is p =
integral of phi(z - d') Phi(z)^(m - 1) (Green and Swets 1966; tabled by Hacker and Ratcliff 1979, Percept. Psychophys.
26, 168-170). Answers with a bias, or materials of which some are more alike than others, do not meet its assumptions:
d' then sums up the share of correct answers, no more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.exact import NotDefined


@dataclass(frozen=True)
class Information:
    """Bits a trial.

    Args:
        trials: number of trials counted.
        presented: entropy of the materials presented: what could be transmitted at most.
        transmitted: of the counts as they are.
        miller_madow: the same, less Miller and Madow's bias.
        panzeri_treves: the same, less Panzeri and Treves's bias.
    """

    trials: int
    presented: float
    transmitted: float
    miller_madow: float
    panzeri_treves: float


def information(counts: NDArray[np.int64]) -> Information:
    """Transmitted information of counts, shape (presented, answered).

    Raises:
        NotDefined: with fewer than two materials presented, or without an answer.
    """
    occurring = counts[counts.sum(axis=1) > 0]
    trials = int(counts.sum())
    if len(occurring) < 2:
        raise NotDefined(f"information needs two materials presented, got {len(occurring)}")
    bits = float(transmitted(occurring))
    rows, column = occurring.sum(axis=1), occurring.sum(axis=0)
    naive = sum(int(np.count_nonzero(row)) - 1 for row in occurring) - (int(np.count_nonzero(column)) - 1)
    possible = int(np.count_nonzero(column))
    estimated = sum(likely_answers(row[column > 0]) - 1 for row in occurring) - (possible - 1)
    unit = 1 / (2 * trials * math.log(2))
    return Information(trials, float(_entropy(rows[None])[0]), bits, bits - naive * unit, bits - estimated * unit)


def transmitted(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Transmitted information of tables of counts, shape (..., presented, answered), without correction; bits (...)."""
    joint = counts.reshape(*counts.shape[:-2], -1)
    return _entropy(counts.sum(axis=-1)) + _entropy(counts.sum(axis=-2)) - _entropy(joint)


def likely_answers(counts: NDArray[np.int64]) -> float:
    """How many of the possible answers can occur to one material (Panzeri and Treves 1996, appendix).

    The number, from those that occurred up to all, under which the expected number of answers occurring in as many
    trials comes closest to the number that did. Under R answers the ones that occurred share what Bayes's rule with a
    flat prior leaves them, the others the rest.

    Args:
        counts: of each possible answer, shape (answers,).
    """
    trials = int(counts.sum())
    occurred = counts[counts > 0]
    least = len(occurred)
    best = least
    distance = abs(least - _expected(occurred / trials, trials))
    for extra in range(1, len(counts) - least + 1):
        unseen = extra * (1 - (trials / (trials + least)) ** (1 / trials))
        shares = (1 - unseen) * (occurred + 1) / (trials + least)
        expected = _expected(shares, trials) + extra * (1 - (1 - unseen / extra) ** trials)
        if abs(least - expected) >= distance:
            break
        best, distance = least + extra, abs(least - expected)
    return float(best)


def _expected(shares: NDArray[np.float64], trials: int) -> float:
    """Expected number of answers that occur at least once."""
    return float((1 - (1 - shares) ** trials).sum())


def _entropy(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Bits of counts, shape (..., n) -> (...)."""
    total = counts.sum(axis=-1, keepdims=True)
    shares = counts / total
    logs = np.log2(shares, out=np.zeros_like(shares), where=shares > 0)
    found: NDArray[np.float64] = -(shares * logs).sum(axis=-1)
    return found


STEP = 0.05
REACH = 12.0
"""The sum over phi runs to so many standard deviations, at such steps: exact to rounding for so smooth a function."""

LARGEST = 20.0
"""|d'| beyond this cannot be told from infinity."""


def proportion_correct(d_prime: float, alternatives: int) -> float:
    """Share of correct answers of an observer with this d' among m alternatives."""
    from scipy.special import ndtr

    x = np.arange(-REACH, REACH + STEP / 2, STEP)
    density = np.exp(-x * x / 2) / np.sqrt(2 * np.pi)
    return float(STEP * (density * ndtr(x + d_prime) ** (alternatives - 1)).sum())


def d_prime(proportion: float, alternatives: int) -> float:
    """d' of a share of correct answers among m alternatives; negative below chance, 1/m.

    Raises:
        NotDefined: for a share of 0 or 1, where d' is infinite.
        ValueError: for a share that is none, or fewer than two alternatives.
    """
    if alternatives < 2 or not 0 <= proportion <= 1:
        raise ValueError(f"got a share of {proportion} among {alternatives}; allowed: 0 to 1 among two or more")
    low, high = -LARGEST, LARGEST
    if not proportion_correct(low, alternatives) < proportion < proportion_correct(high, alternatives):
        raise NotDefined(f"d' is infinite where the share of correct answers is {proportion:.3g}")
    while low < (middle := (low + high) / 2) < high:
        below = proportion_correct(middle, alternatives) < proportion
        low, high = (middle, high) if below else (low, middle)
    return middle


def corrected(count: int, trials: int) -> float:
    """Share of correct answers with 0 and 1 moved in by half a trial (Macmillan and Kaplan 1985)."""
    return min(max(count, 0.5), trials - 0.5) / trials
