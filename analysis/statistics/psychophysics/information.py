"""The information that answers transmit, in bits a trial (Miller and Nicely 1955; Garner and Hake 1951).

It is corrected by Miller and Madow (Miller 1955) and by Panzeri and Treves (1996, Network 7, 87-107).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import entr, stdtrit

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import CONFIDENCE
from palpate.analysis.statistics.participants import Jackknife


@dataclass(frozen=True)
class Information:
    """Bits a trial: the entropy of the materials presented, and what answers transmit, uncorrected and corrected."""

    trials: int
    presented: float
    transmitted: float
    miller_madow: float
    panzeri_treves: float


def information(counts: NDArray[np.int64]) -> Information:
    """Return the information of counts, shape (presented, answered); NotDefined below two materials presented."""
    occurring = counts[counts.sum(axis=1) > 0]
    trials = int(counts.sum())
    if len(occurring) < 2:
        raise NotDefined(f"information needs two presented materials, got {len(occurring)}")
    bits = float(transmitted(occurring))
    rows, column = occurring.sum(axis=1), occurring.sum(axis=0)
    naive = sum(int(np.count_nonzero(row)) - 1 for row in occurring) - (int(np.count_nonzero(column)) - 1)
    possible = int(np.count_nonzero(column))
    estimated = sum(likely_answers(row[column > 0]) - 1 for row in occurring) - (possible - 1)
    unit = 1 / (2 * trials * math.log(2))
    return Information(trials, float(_entropy(rows[None])[0]), bits, bits - naive * unit, bits - estimated * unit)


RIGHT = 0.9
"""Where more are right, few errors say little of how they spread, and Fano's bound counts."""


def information_limits(counts: NDArray[np.int64], found: Information, right: tuple[float, float]) -> Jackknife:
    """Return the jackknife over participants of counts, shape (P, presented, answered), with its interval.

    Its error is at least that of trials; `right` are the limits of the share of right answers. Value and limits lie
    from 0 to the bits presented. Raises `NotDefined` below two participants.
    """
    people, trials = len(counts), found.trials
    if people < 2:
        raise NotDefined(f"a jackknife needs 2 participants, got {people}")
    pooled = counts.sum(axis=0)
    left_out = transmitted(pooled - counts)
    materials = int(np.count_nonzero(pooled.sum(axis=1)))
    shares = pooled[pooled > 0] / trials
    alone = np.outer(pooled.sum(axis=1), pooled.sum(axis=0))[pooled > 0] / trials**2
    logs = np.log2(shares / alone)
    spread = float((shares * logs**2).sum() - (shares * logs).sum() ** 2) / trials
    spread += 2 * (materials - 1) ** 2 / (2 * trials * math.log(2)) ** 2
    error = max(math.sqrt((people - 1) * float(left_out.var())), math.sqrt(max(spread, 0.0)))
    value = people * found.transmitted - (people - 1) * float(left_out.mean())
    reach = float(stdtrit(people - 1, (1 + CONFIDENCE) / 2)) * error
    low, high = value - reach, value + reach
    if np.trace(pooled[:, : len(pooled)]) > RIGHT * trials:
        bounds = [fano(max(share, 1 / materials), materials, found.presented) for share in right]
        low, high = min(low, *bounds), max(high, *bounds)
    value, low, high = (min(max(one, 0.0), found.presented) for one in (value, low, high))
    return Jackknife(value, error, low, high, CONFIDENCE)


def fano(share: float, materials: int, presented: float) -> float:
    """Return the fewest bits that a share of right answers transmits, of so many presented (Fano 1961)."""
    wrong = 1 - share
    return presented - float(entr([share, wrong]).sum()) / math.log(2) - wrong * math.log2(materials - 1)


def transmitted(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the uncorrected bits, shape (...), of tables of counts, shape (..., presented, answered)."""
    joint = counts.reshape(*counts.shape[:-2], -1)
    return _entropy(counts.sum(axis=-1)) + _entropy(counts.sum(axis=-2)) - _entropy(joint)


def likely_answers(counts: NDArray[np.int64]) -> float:
    """Return how many answers can occur to a material, of counts (answers,) (Panzeri and Treves 1996, appendix)."""
    trials = int(counts.sum())
    occurred = counts[counts > 0]
    least = len(occurred)
    best, distance = least, abs(least - _expected(occurred / trials, trials))
    for extra in range(1, len(counts) - least + 1):
        unseen = extra * (1 - (trials / (trials + least)) ** (1 / trials))
        shares = (1 - unseen) * (occurred + 1) / (trials + least)
        expected = _expected(shares, trials) + extra * (1 - (1 - unseen / extra) ** trials)
        if abs(least - expected) >= distance:
            break
        best, distance = least + extra, abs(least - expected)
    return float(best)


def _expected(shares: NDArray[np.float64], trials: int) -> float:
    """Return the expected number of answers that occur at least once."""
    return float((1 - (1 - shares) ** trials).sum())


def _entropy(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the bits of counts, shape (..., n) -> (...)."""
    shares = counts / counts.sum(axis=-1, keepdims=True)
    logs = np.log2(shares, out=np.zeros_like(shares), where=shares > 0)
    return np.asarray(-(shares * logs).sum(axis=-1))
