"""Intervals of shares over participants who differ: of a mean share, and of the difference of two.

Counts are beta-binomial, with Jeffreys's prior of the mean and a flat one of the intraclass correlation; such an
interval is short where participants are alike, or very unlike, so it is widened to that of Clopper and Pearson and to
Student's on the logit. Differences: Newcombe (1998, Stat. Med. 17, 2635-2650), Zou and Donner (2008, Stat. Med. 27,
1693-1702). At the ends: Brown, Cai and DasGupta (2001, Stat. Sci. 16, 101-133). Of any population: Gaffke (2005, Math.
Methods Stat. 14, 451-460), with half a participant added; its weights by Imhof (1961, Biometrika 48, 419-426).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly
from scipy.optimize import brentq
from scipy.special import expit, logit, stdtrit, xlogy

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined
from palpate.analysis.statistics.inference import CONFIDENCE, clopper_pearson

ANGLES, ROOTS, COARSE = 400, 64, 48
"""Points of the mean's angle and of the correlation's root; fewer suffice to find where they matter."""

DEPTH = 35.0
"""Logarithms below the greatest density at which it no longer counts."""

GATHERED = 8
"""Factors of the density whose product neither overflows nor underflows."""

LINKED = 1 - 1e-12
"""The largest correlation, either way, that Fisher's z takes."""

EDGE = 0.1
"""Within so much of 0 or 1 a difference is squared and added."""

MOST = 0.8
"""Above this mean share somebody who may guess is of another kind: ours, by rule of thumb."""


@dataclass(frozen=True)
class Limits:
    """An interval over participants at `confidence`; an end that answers all right, or all wrong, leave open is None.

    Where all are right, `low` is the share that can be shown, and `high` None. It is `over` participants who differ in
    one way, over any population of them, or over the trials of one participant.
    """

    low: float | None
    high: float | None
    confidence: float = CONFIDENCE
    over: Literal["participants", "any population", "trials"] = "participants"


def first_limits(right: Integers, trials: Integers, chance: float) -> Limits:
    """Return the interval to be shown first, from right answers and trials, shape (participants,).

    It is that of the trials of a single participant, and that of any population where somebody may guess. Raises
    `NotDefined` where nobody has a trial.
    """
    right, trials = right[trials > 0], trials[trials > 0]
    if right.size == 1:
        exact = clopper_pearson(int(right[0]), int(trials[0]))
        return Limits(exact.low if right[0] else None, exact.high if right[0] < trials[0] else None, over="trials")
    if right.size and may_guess(right, trials, chance):
        return population_limits(right, trials)
    return share_limits(right, trials)


def may_guess(right: Integers, trials: Integers, chance: float) -> NDArray[np.bool_]:
    """Return whether somebody's answers are likelier by `chance` than by the mean share, while that is above `MOST`.

    Counts have the shape (..., participants), each with a trial or more; likelihoods are binomial.
    """
    mean = (right / trials).mean(axis=-1, keepdims=True)
    by_mean = xlogy(right, mean) + xlogy(trials - right, 1 - mean)
    by_chance = xlogy(right, chance) + xlogy(trials - right, 1 - chance)
    return np.asarray((by_chance > by_mean).any(axis=-1) & (mean[..., 0] > MOST))


def population_limits(right: Integers, trials: Integers) -> Limits:
    """Return the interval of the mean share that allows for any population, from counts, shape (participants,).

    Participants have random weights, drawn from Dirichlet(1, ..., 1, 1/2); the last is of half a participant who is
    never right for the lower end, and always for the upper. Where each is always or never right, it covers 87 % or more
    (binomial sums, 2 to 40 participants). Raises `NotDefined` below two participants.
    """
    right, trials = right[trials > 0], trials[trials > 0]
    if right.size < 2:
        raise NotDefined(f"an interval across participants needs two, got {right.size}")
    low, wrong = (_weighted_mean(counts / trials) if counts.any() else None for counts in (right, trials - right))
    return Limits(low, None if wrong is None else 1 - wrong, over="any population")


FIRST, LAST, APART = -12.0, 30.0, 0.2
"""Logarithms of the points of Imhof's integral, where a sum at even steps converges exponentially (Trefethen and
Weideman, 2014, SIAM Review 56, 385-458). Before the first the integrand is a straight line to one part in 10^10."""

RESOLVED = 12
"""So many participants have an integrand that these points resolve; its waves are closer by the root of more."""


def _weighted_mean(shares: Floats) -> float:
    """Return the value below which the weighted mean of shares, and of half a 0, lies with the lower tail."""
    values, often = np.unique(np.append(shares, 0.0), return_counts=True)
    weights = often - 0.5 * (values == 0)
    apart = APART / math.ceil(math.sqrt(shares.size / RESOLVED))
    steps = np.exp(np.arange(FIRST, LAST, apart))
    before = math.exp(FIRST) / math.expm1(apart)

    def missing(at: float) -> float:
        gaps = (values - at) / np.abs(values - at).max()
        turns = np.outer(steps, gaps)
        waves = np.sin(np.arctan(turns) @ weights) * np.exp(-np.log1p(turns**2) @ weights / 2)
        return 0.5 - apart / math.pi * (float(waves.sum()) + before * float(gaps @ weights)) - (1 - CONFIDENCE) / 2

    return float(brentq(missing, 0.0, float(values[-1]), xtol=1e-12))


def share_limits(right: Integers, trials: Integers) -> Limits:
    """Return the interval of the mean share of participants, from right answers and trials, shape (participants,).

    Those without a trial do not count. Raises `NotDefined` below two participants.
    """
    right, trials = right[trials > 0], trials[trials > 0]
    if (people := right.size) < 2:
        raise NotDefined(f"an interval across participants needs two, got {people}")
    low, high = modelled(right, trials)
    shares = right / trials
    mean = float(shares.mean())
    if 0 < mean < 1:
        error = float(shares.std(ddof=1)) / (math.sqrt(people) * mean * (1 - mean))
        reach = float(stdtrit(people - 1, (1 + CONFIDENCE) / 2)) * error
        low = min(low, float(expit(logit(mean) - reach))) if mean <= 0.5 else low
        high = max(high, float(expit(logit(mean) + reach))) if mean >= 0.5 else high
    return Limits(low if right.any() else None, high if (right < trials).any() else None)


def modelled(right: Integers, trials: Integers) -> tuple[float, float]:
    """Return the limits of the beta-binomial model, widened to those of all trials and to the mean share."""
    pooled = clopper_pearson(int(right.sum()), int(trials.sum()))
    mean = float((right / trials).mean())
    low, high = _credible(tuple(right.tolist()), tuple(trials.tolist()))
    low = min(low, pooled.low, mean) if right.any() else 0.0
    high = max(high, pooled.high, mean) if (right < trials).any() else 1.0
    return low, high


@lru_cache(maxsize=256)
def _credible(right_each: tuple[int, ...], trials_each: tuple[int, ...]) -> tuple[float, float]:
    """Return the central credible interval of the mean m of a beta-binomial distribution.

    With m = sin(angle)^2 the prior is flat in the angle; the correlation is the square of the root.
    """
    right, trials = np.array(right_each), np.array(trials_each)
    most = int(trials.max())
    steps = np.arange(most)
    # How many have a factor (m c + step), ((1 - m) c + step) and (c + step), with c = 1 / correlation - 1.
    ups, downs, both = (
        counts.size - np.cumsum(np.bincount(counts, minlength=most)[:most])
        for counts in (right, trials - right, trials)
    )

    gathered = _gathered(ups), _gathered(downs)

    def density(angles: Floats, roots: Floats) -> Floats:
        """Return the logarithm of the density of angle and root, shape (angles, roots)."""
        alike, unlike = 1 - roots**2, roots**2
        found = np.log(2 * roots) - both @ np.log(alike + steps[:, None] * unlike)
        with np.errstate(divide="ignore", invalid="ignore"):
            for groups, part in zip(gathered, (np.sin(angles) ** 2, np.cos(angles) ** 2), strict=True):
                own = part[:, None] * alike
                for often, alike_often in groups:
                    factors = own + alike_often[0] * unlike
                    for step in alike_often[1:]:
                        factors *= own + step * unlike
                    found = found + often * np.log(factors)
        return np.asarray(found)

    box = np.array([[0.0, math.pi / 2], [0.0, 1.0]])
    while True:
        cell = np.diff(box, axis=1)[:, 0] / COARSE
        grid = box[:, :1] + cell[:, None] * (np.arange(COARSE) + 0.5)
        logs = density(*grid)
        places = np.nonzero(logs > logs.max() - DEPTH)
        ends = np.array([[axis[place.min()], axis[place.max()]] for axis, place in zip(grid, places, strict=True)])
        smaller = np.clip(ends + 1.5 * cell[:, None] * [-1, 1], box[:, :1], box[:, 1:])
        shrunk = np.diff(smaller, axis=1) / np.diff(box, axis=1)
        box = smaller
        if shrunk.min() > 0.7:
            break
    nodes, weights = _nodes()
    roots = box[1, 0] + (nodes + 1) / 2 * (box[1, 1] - box[1, 0])
    angles = np.linspace(box[0, 0], box[0, 1], ANGLES)
    logs = density(angles, roots)
    marginal = np.exp(logs - logs.max()) @ weights
    below = CubicSpline(angles, marginal).antiderivative()
    passed = below(angles)

    def share(tail: float) -> float:
        """Return the share below which so much of the density lies, from the one piece where it is reached."""
        piece = int(np.argmax(passed[1:] >= tail * passed[-1]))
        cubic = PPoly(below.c[:, piece : piece + 1], angles[piece : piece + 2])
        return float(np.sin(cubic.solve(tail * float(passed[-1]), extrapolate=False)[0]) ** 2)

    return share((1 - CONFIDENCE) / 2), share((1 + CONFIDENCE) / 2)


def _gathered(often: Integers) -> list[tuple[int, Integers]]:
    """Return each count but 0 with its steps, at most `GATHERED` together: their product has one logarithm."""
    counts = np.unique(often[often > 0])
    each = (np.flatnonzero(often == count) for count in counts)
    return [
        (int(count), steps[start : start + GATHERED])
        for count, steps in zip(counts, each, strict=True)
        for start in range(0, steps.size, GATHERED)
    ]


@lru_cache(maxsize=1)
def _nodes() -> tuple[Floats, Floats]:
    """Return nodes and weights of Gauss and Legendre for the correlation's root."""
    nodes, weights = np.polynomial.legendre.leggauss(ROOTS)
    return nodes, weights


def difference_limits(right: Integers, trials: Integers, gaps: Floats) -> Limits:
    """Return the interval of the mean of `gaps`, the share of one task less that of the other, shape (participants,).

    `right` and `trials` have shape (2, participants). In the middle it is Student's, but never shorter than trials
    allow; else the distances to the limits of both shares are squared and added, less what goes together. Raises
    `NotDefined` below two participants.
    """
    if (people := gaps.size) < 2:
        raise NotDefined(f"an interval across participants needs two, got {people}")
    shares: Floats = right / trials
    means: Floats = shares.mean(axis=1)
    gap = float(gaps.mean())
    if means.min() >= EDGE and means.max() <= 1 - EDGE:
        total, all_right = trials.sum(axis=1), right.sum(axis=1)
        smoothed = (all_right + 1) / (total + 2)
        by_trials = math.sqrt(float((smoothed * (1 - smoothed) * (1 / trials).sum(axis=1)).sum())) / people
        error = max(float(gaps.std(ddof=1)) / math.sqrt(people), by_trials)
        reach = float(stdtrit(people - 1, (1 + CONFIDENCE) / 2)) * error
        return Limits(max(gap - reach, -1.0), min(gap + reach, 1.0))
    spreads = shares.std(axis=1)
    linked = 0.0
    if spreads.min() > 0:
        observed = float((shares[0] * shares[1]).mean() - means.prod()) / float(spreads.prod())
        z = math.atanh(min(max(observed, -LINKED), LINKED))
        linked = max(0.0, math.tanh(z - 1 / math.sqrt(max(people - 3, 0.5))))
    (one, other) = (modelled(*counts) for counts in zip(right, trials, strict=True))
    return squared_limits(gap, (float(means[0]), float(means[1])), (one, other), linked)


def near_edges(shares: Floats) -> NDArray[np.bool_]:
    """Return where a mean over people, of shares (tasks, ..., people), is so near 0 or 1 that gaps are skewed."""
    return np.asarray((abs(shares.mean(axis=-1) - 0.5) > 0.5 - EDGE + 1e-9).any(axis=0))


def squared_limits(
    gap: float, means: tuple[float, float], both: tuple[tuple[float, float], tuple[float, float]], linked: float
) -> Limits:
    """Return the interval of a difference from the means and the limits of both shares, which correlate as `linked`."""
    (low, high), (other_low, other_high) = both
    down, up = means[0] - low, high - means[0]
    other_down, other_up = means[1] - other_low, other_high - means[1]
    below = math.sqrt(down**2 + other_up**2 - 2 * linked * down * other_up)
    above = math.sqrt(up**2 + other_down**2 - 2 * linked * up * other_down)
    return Limits(gap - below, gap + above)
