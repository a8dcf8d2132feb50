"""Intervals of a ratio of counts: Wilson's, and the exact one of Clopper and Pearson.

Both take every trial as independent of the others, which trials of one participant are not: the interval that counts
participants is in `analysis.bootstrap`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """Limits at `confidence`."""

    low: float
    high: float
    confidence: float


def wilson(count: int, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Score interval without continuity correction (Wilson 1927).

    Raises:
        ValueError: without trials, or for more successes than trials.
    """
    from scipy.special import ndtri

    _check(count, trials)
    z = float(ndtri((1 + confidence) / 2))
    centre = count + z * z / 2
    half = z * math.sqrt(count * (trials - count) / trials + z * z / 4)
    low, high = (centre - half) / (trials + z * z), (centre + half) / (trials + z * z)
    return Interval(low if count else 0.0, high if count < trials else 1.0, confidence)


def clopper_pearson(count: int, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Exact interval: neither tail of the binomial beyond the count exceeds half of what is left (1934).

    Raises:
        ValueError: without trials, or for more successes than trials.
    """
    from scipy.special import betaincinv

    _check(count, trials)
    tail = (1 - confidence) / 2
    low = float(betaincinv(count, trials - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, trials - count, 1 - tail)) if count < trials else 1.0
    return Interval(low, high, confidence)


def _check(count: int, trials: int) -> None:
    if not 0 <= count <= trials or not trials:
        raise ValueError(
            f"got {count} of {trials}; allowed: a count from 0 to the trials, of which there is one at least"
        )
