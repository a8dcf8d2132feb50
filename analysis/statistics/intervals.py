"""Intervals of a ratio of counts, and of any statistic by a bootstrap over participants.

Wilson's interval and the exact one of Clopper and Pearson take every trial as independent of the others, which trials
of one participant are not. The bootstrap draws whole participants again with replacement, never single trials; its
intervals are BCa, bias-corrected and accelerated (Efron 1987, J. Am. Stat. Assoc. 82, 171-185), the acceleration by
leaving out one participant at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.exact import NotDefined

CONFIDENCE = 0.95


@dataclass(frozen=True)
class ConfidenceInterval:
    """Limits at `confidence`."""

    low: float
    high: float
    confidence: float


def wilson(count: int, trials: int, confidence: float = CONFIDENCE) -> ConfidenceInterval:
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
    return ConfidenceInterval(low if count else 0.0, high if count < trials else 1.0, confidence)


def clopper_pearson(count: int, trials: int, confidence: float = CONFIDENCE) -> ConfidenceInterval:
    """Exact interval: neither tail of the binomial beyond the count exceeds half of what is left (1934).

    Raises:
        ValueError: without trials, or for more successes than trials.
    """
    from scipy.special import betaincinv

    _check(count, trials)
    tail = (1 - confidence) / 2
    low = float(betaincinv(count, trials - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, trials - count, 1 - tail)) if count < trials else 1.0
    return ConfidenceInterval(low, high, confidence)


def _check(count: int, trials: int) -> None:
    if not 0 <= count <= trials or not trials:
        raise ValueError(
            f"got {count} of {trials}; allowed: a count from 0 to the trials, of which there is one at least"
        )


RESAMPLES = 4999
LEAST = 3
"""Fewer participants than this leave nothing to draw again."""

Floats = NDArray[np.float64]


def resamples(participants: int, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """How often each participant stands in each resample, shape (count, participants).

    Raises:
        NotDefined: with too few participants.
    """
    if participants < LEAST:
        raise NotDefined(f"a bootstrap needs {LEAST} participants, got {participants}")
    return np.asarray(
        rng.multinomial(participants, np.full(participants, 1 / participants), size=count), dtype=np.int64
    )


def leave_one_out(participants: int) -> NDArray[np.int64]:
    """The same for leaving out each participant in turn, shape (participants, participants)."""
    return np.ones((participants, participants), dtype=np.int64) - np.eye(participants, dtype=np.int64)


def bca(observed: float, drawn: Floats, left_out: Floats, confidence: float = CONFIDENCE) -> ConfidenceInterval:
    """BCa interval of one statistic.

    Args:
        observed: its value in the sample.
        drawn: its values in the resamples, shape (B,).
        left_out: its values with each participant left out, shape (P,).
        confidence: of the interval.

    Raises:
        NotDefined: where the resamples do not vary, or all lie on one side of the observed value.
    """
    from scipy.special import ndtr, ndtri

    if np.ptp(drawn) <= 1e-12 * np.abs(drawn).max():
        raise NotDefined("no variance among participants: the bootstrap has no interval")
    below = (np.count_nonzero(drawn < observed) + np.count_nonzero(drawn <= observed)) / (2 * drawn.size)
    if not 0 < below < 1:
        raise NotDefined("every resample lies on one side of the value: the bootstrap has no BCa interval")
    differences = left_out.mean() - left_out
    scale = float((differences**2).sum()) ** 1.5
    acceleration = float((differences**3).sum()) / (6 * scale) if scale else 0.0
    bias = float(ndtri(below))
    normal = bias + ndtri(np.array([(1 - confidence) / 2, (1 + confidence) / 2]))
    shares = ndtr(bias + normal / (1 - acceleration * normal))
    low, high = np.quantile(drawn, shares)
    return ConfidenceInterval(float(low), float(high), confidence)


def mean_interval(values: Floats, weights: NDArray[np.int64], confidence: float = CONFIDENCE) -> ConfidenceInterval:
    """BCa interval of the mean among participants, values of shape (P,), from resamples of shape (B, P).

    Raises:
        NotDefined: see `bca`.
    """
    left_out = leave_one_out(values.size) @ values / (values.size - 1)
    return bca(float(values.mean()), weights @ values / values.size, left_out, confidence)
