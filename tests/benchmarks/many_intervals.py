"""The intervals of `statistics.shares` of many studies with the same numbers of trials at once, to see how they cover.

The density of the beta-binomial model is the product of a table's entry for each participant, on one grid for all
studies: coarser than that of the product, so that limits differ by some 1e-5. Whether the interval for any population
holds a value is read from Imhof's integral at that value, without looking for its ends.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import betaincinv, expit, logit, stdtrit

from palpate.analysis.statistics.exact import Floats, Integers
from palpate.analysis.statistics.inference import CONFIDENCE
from palpate.analysis.statistics.shares import EDGE, LINKED

ANGLES, ROOTS = 400, 48
FLAT = -1e5
"""The logarithm of a density of zero, which none of nothing may turn into a number that is not one."""

CHUNK, BLOCK = 1000, 32
"""Studies whose splines, and whose densities, are held at once."""

GLIMPSE, DEPTH = 7, 30.0
"""Each of so many angles is looked at first; farther than one from where the logarithm lies so deep, density is 0."""

HALVINGS = 50

STEPS = np.arange(-30.0, 30.0, 0.1)
"""Logarithms of the points of Imhof's integral: all of them, for up to 100 participants."""

Ends = tuple[Floats, Floats]
"""Low and high ends, shape (studies,)."""


def _grid() -> tuple[Floats, Floats, Floats]:
    """Return the mean's angles, the correlation's roots and the weights of these, by Gauss and Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(ROOTS)
    roots = (nodes + 1) / 2
    return np.linspace(0, math.pi / 2, ANGLES), roots, weights * roots


@lru_cache(maxsize=8)
def _logs(trials: int) -> NDArray[np.float32]:
    """Return log likelihoods of 0 to `trials` right answers below their maxima, shape (trials + 1, angles, roots)."""
    angles, roots, _ = _grid()
    alike, unlike, steps = 1 - roots**2, roots**2, np.arange(trials)[:, None, None]
    with np.errstate(divide="ignore"):
        ups, downs = (
            np.cumsum(np.log(part[:, None] * alike + steps * unlike), axis=0)
            for part in (np.sin(angles) ** 2, np.cos(angles) ** 2)
        )
    ups, downs = (np.concatenate([np.zeros_like(part[:1]), np.maximum(part, FLAT)]) for part in (ups, downs))
    both = np.log(alike + steps[:, 0] * unlike).sum(axis=0)
    logs = ups + downs[::-1] - both
    return np.asarray(logs - logs.max(axis=(1, 2), keepdims=True), dtype=np.float32)


def _histogram(right: Integers, trials: Integers) -> tuple[Integers, Integers, Integers]:
    """Return how many participants of each study have each outcome, and the right answers and trials of outcomes."""
    kinds = np.unique(trials)
    starts = np.concatenate([[0], np.cumsum(kinds + 1)])
    places = starts[np.searchsorted(kinds, trials)] + right + starts[-1] * np.arange(len(right))[:, None]
    often = np.bincount(places.ravel(), minlength=len(right) * starts[-1]).reshape(len(right), -1)
    return often, np.concatenate([np.arange(kind + 1) for kind in kinds]), np.repeat(kinds, kinds + 1)


def _credible(often: Integers, of: Integers) -> Ends:
    """Return the limits of the mean share, given how often each outcome, of so many trials, is."""
    angles, _, weights = _grid()
    logs = np.concatenate([_logs(int(kind)) for kind in np.unique(of)])
    glimpsed = np.ascontiguousarray(logs[:, ::GLIMPSE]).reshape(len(logs), -1)
    marginal = np.zeros((len(often), ANGLES))
    # Studies with alike numbers of right answers have their densities in the same place.
    places = np.argsort(often @ np.concatenate([np.arange(kind + 1) for kind in np.unique(of)]))
    for first in range(0, len(often), BLOCK):
        own = places[first : first + BLOCK]
        counts = often[own].astype(np.float32)
        seen = (counts @ glimpsed).reshape(len(own), -1, ROOTS).max(axis=2)
        near = np.flatnonzero((seen > seen.max(axis=1, keepdims=True) - DEPTH).any(axis=0))
        part = slice(max(near[0] - 1, 0) * GLIMPSE, (near[-1] + 1) * GLIMPSE + 1)
        block = counts @ logs[:, part].reshape(len(logs), -1)
        block = np.exp(block - block.max(axis=1, keepdims=True))
        marginal[own, part] = block.reshape(len(own), -1, ROOTS) @ weights.astype(np.float32)
    below = CubicSpline(angles, marginal.T).antiderivative()
    passed = below(angles)
    ends = []
    for tail in ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2):
        wanted = tail * passed[-1]
        piece = np.argmax(passed[1:] >= wanted, axis=0)
        terms = below.c[:, piece, np.arange(len(often))]
        low, high = np.zeros(len(often)), np.full(len(often), angles[1])
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            under = (((terms[0] * middle + terms[1]) * middle + terms[2]) * middle + terms[3]) * middle + terms[
                4
            ] < wanted
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        ends.append(np.sin(angles[piece] + low) ** 2)
    return ends[0], ends[1]


def modelled_ends(right: Integers, trials: Integers) -> Ends:
    """Return the ends of `shares.modelled` of each study; `right` has shape (studies, people), `trials` (people,)."""
    often, _, of = _histogram(right, trials)
    different, back = np.unique(often, axis=0, return_inverse=True)
    parts = [_credible(different[first : first + CHUNK], of) for first in range(0, len(different), CHUNK)]
    low, high = (np.concatenate(part)[back.ravel()] for part in zip(*parts, strict=True))
    count, total, mean = right.sum(axis=1), int(trials.sum()), (right / trials).mean(axis=1)
    tail = (1 - CONFIDENCE) / 2
    least = betaincinv(np.maximum(count, 1), total - count + 1, tail)
    most = betaincinv(count + 1, np.maximum(total - count, 1), 1 - tail)
    low = np.where(count > 0, np.minimum(np.minimum(low, least), mean), 0.0)
    return low, np.where(count < total, np.maximum(np.maximum(high, most), mean), 1.0)


def share_ends(right: Integers, trials: Integers) -> Ends:
    """Return the ends of `shares.share_limits` of each study, shapes as in `modelled_ends`; an open one is 0 or 1."""
    low, high = modelled_ends(right, trials)
    shares = right / trials
    people, mean = right.shape[1], shares.mean(axis=1)
    inside = (mean > 0) & (mean < 1)
    own = np.where(inside, mean, 0.5)
    error = shares.std(axis=1, ddof=1) / (math.sqrt(people) * own * (1 - own))
    reach = stdtrit(people - 1, (1 + CONFIDENCE) / 2) * error
    low = np.where(inside & (mean <= 0.5), np.minimum(low, expit(logit(own) - reach)), low)
    return low, np.where(inside & (mean >= 0.5), np.maximum(high, expit(logit(own) + reach)), high)


def student_ends(values: Floats) -> Ends:
    """Return Student's limits of the means of values, shape (studies, people)."""
    people, mean = values.shape[1], values.mean(axis=1)
    reach = stdtrit(people - 1, (1 + CONFIDENCE) / 2) * values.std(axis=1, ddof=1) / math.sqrt(people)
    return mean - reach, mean + reach


def difference_ends(right: Integers, trials: Integers) -> Ends:
    """Return the ends of `shares.difference_limits`; `right` has shape (studies, 2, people), `trials` (2, people)."""
    shares = right / trials
    people, means, gaps = right.shape[2], shares.mean(axis=2), shares[:, 0] - shares[:, 1]
    gap, total = gaps.mean(axis=1), trials.sum(axis=1)
    smoothed = (right.sum(axis=2) + 1) / (total + 2)
    by_trials = np.sqrt((smoothed * (1 - smoothed) * (1 / trials).sum(axis=1)).sum(axis=1)) / people
    error = np.maximum(gaps.std(axis=1, ddof=1) / math.sqrt(people), by_trials)
    reach = stdtrit(people - 1, (1 + CONFIDENCE) / 2) * error
    spreads = shares.std(axis=2)
    varied = spreads.min(axis=1) > 0
    together = (shares[:, 0] * shares[:, 1]).mean(axis=1) - means.prod(axis=1)
    observed = together / np.where(varied, spreads.prod(axis=1), 1.0)
    turned = np.tanh(np.arctanh(np.clip(observed, -LINKED, LINKED)) - 1 / math.sqrt(max(people - 3, 0.5)))
    linked = np.where(varied, np.maximum(turned, 0.0), 0.0)
    one, other = (modelled_ends(right[:, task], trials[task]) for task in (0, 1))
    down, up, other_down, other_up = (
        means[:, 0] - one[0],
        one[1] - means[:, 0],
        means[:, 1] - other[0],
        other[1] - means[:, 1],
    )
    below = np.sqrt(down**2 + other_up**2 - 2 * linked * down * other_up)
    above = np.sqrt(up**2 + other_down**2 - 2 * linked * up * other_down)
    middle = (means.min(axis=1) >= EDGE) & (means.max(axis=1) <= 1 - EDGE)
    low = np.where(middle, np.maximum(gap - reach, -1.0), gap - below)
    return low, np.where(middle, np.minimum(gap + reach, 1.0), gap + above)


def holds_any(right: Integers, trials: Integers, value: float) -> NDArray[np.bool_]:
    """Return whether `shares.population_limits` of each study hold a value, of shapes as in `modelled_ends`."""
    return _lies_above(right, trials, value) & _lies_above(trials - right, trials, 1 - value)


def _lies_above(right: Integers, trials: Integers, value: float) -> NDArray[np.bool_]:
    often, count, of = _histogram(right, trials)
    weights = np.hstack([often, np.full((len(right), 1), 0.5)])
    gaps = np.append(count / of, 0.0) - value
    turns = np.outer(np.exp(STEPS) / abs(gaps).max(), gaps)
    waves = np.sin(weights @ np.arctan(turns).T) * np.exp(-(weights @ np.log1p(turns**2).T) / 2)
    return np.asarray((0.5 - 0.1 * waves.sum(axis=1) / math.pi >= (1 - CONFIDENCE) / 2) | ~right.any(axis=1))
