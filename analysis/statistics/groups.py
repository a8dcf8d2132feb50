"""Two groups of participants: a test by who could have been in which, and the interval of their difference.

All ways to make groups of these sizes count, or are drawn (Pitman 1937, Suppl. J. R. Stat. Soc. 4, 119-130). Their
statistic is Welch's t, so that P is exact where the groups are of one population, and of many participants also holds
where one varies more (Janssen 1997, Stat. Probab. Lett. 36, 9-21; Chung and Romano 2013, Ann. Stat. 41, 484-507).
If the smaller group varies more, P is no less than Welch's t gives on that group's df alone, which bounds it for normal
values (Mickey and Brown 1966, Ann. Math. Stat. 37, 639-642).
Interval: Newcombe (1998, Stat. Med. 17, 873-890).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Number, integers, mean_shares
from palpate.analysis.statistics.shares import Limits, modelled, squared_limits
from palpate.analysis.statistics.sign_flips import DRAWS

DRAWN = 1999
"""So many ways are drawn for many studies at once, where there are more."""


@dataclass(frozen=True)
class Apart:
    """How far the means of two groups of `n` participants in all lie apart, the first less the second.

    `p` is two-sided, and not below `least`; `error` is its Monte Carlo standard error where ways are drawn, else None.
    `loose`: the smaller group varies more than the other, so P is no less than that of its own df.
    """

    n: int
    value: float
    p: float
    least: float
    error: float | None
    loose: bool = False
    interval: Limits | None = None


def difference(one: Sequence[Number], other: Sequence[Number], rng: np.random.Generator) -> Apart:
    """Return the test that two groups of participants, shapes (n,), have one mean.

    Raises `NotDefined` with fewer than two in either, or where all have the same value.
    """
    sizes = len(one), len(other)
    if min(sizes) < 2:
        raise NotDefined(f"it needs two participants in each group, got {sizes[0]} and {sizes[1]}")
    whole, common = integers([*one, *other])
    if len({*whole}) == 1:
        raise NotDefined("all participants of both groups have the same proportion")
    values = np.array([value - whole[0] for value in whole], dtype=np.float64)
    values /= abs(values).max()
    ways = math.comb(people := sum(sizes), sizes[0])
    if ways <= DRAWS:
        chosen = values[np.array(list(combinations(range(people), sizes[0])))]
        sums, squares = chosen.sum(axis=1), (chosen**2).sum(axis=1)
    else:
        sums, squares = regrouped(values, sizes[0], rng)
    reached = float(_welch(values[: sizes[0]].sum(), (values[: sizes[0]] ** 2).sum(), values, sizes[0]))
    hits = int(np.count_nonzero(_welch(sums, squares, values, sizes[0]) >= reached * (1 - 1e-9)))
    p = hits / ways if ways <= DRAWS else (hits + 1) / (DRAWS + 1)
    value = float(sum(whole[: sizes[0]]) / sizes[0] - sum(whole[sizes[0] :]) / sizes[1]) / common
    error = math.sqrt(p * (1 - p) / DRAWS) if ways > DRAWS else None
    bounded, loose = _bounded(np.array(p), values[: sizes[0]], values[sizes[0] :])
    return Apart(people, value, float(bounded), (1 + (sizes[0] == sizes[1])) / ways, error, bool(loose))


def _bounded(p: Floats, one: Floats, other: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return P, no less than Welch's t gives on the df of the smaller group where that varies more, and where."""
    small, large = sorted((one, other), key=lambda of: of.shape[-1])
    few, spread, wide = small.shape[-1], small.var(axis=-1, ddof=1), large.var(axis=-1, ddof=1)
    loose = (spread > wide) & (few < large.shape[-1])
    error = np.sqrt(np.where(loose, spread / few + wide / large.shape[-1], 1.0))
    t = abs(small.mean(axis=-1) - large.mean(axis=-1)) / error
    return np.where(loose, np.maximum(p, 2 * stdtr(few - 1, -t)), p), loose


def regrouped(values: Floats, first: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return sums of values and of their squares over the first so many, in each of `DRAWS` orders of participants.

    How often each value is among them is drawn, which takes no longer for many participants.
    """
    different, often = np.unique(values, return_counts=True)
    counts = rng.multivariate_hypergeometric(often, first, size=DRAWS, method="marginals")
    return counts @ different, counts @ different**2


def _welch(sums: Floats, squares: Floats, values: Floats, first: int) -> Floats:
    """Return the size of Welch's t from sums and sums of squares over the first group: 0 of 0 / 0, infinite of 1 / 0.

    `values` are of all participants, shape (..., participants).
    """
    sizes = first, values.shape[-1] - first
    totals = values.sum(axis=-1, keepdims=sums.ndim > 1), (values**2).sum(axis=-1, keepdims=sums.ndim > 1)
    both = ((sums, squares), (totals[0] - sums, totals[1] - squares))
    spread = sum(
        np.maximum(of_squares - of / size * of, 0.0) / (size * (size - 1))
        for (of, of_squares), size in zip(both, sizes, strict=True)
    )
    gap = abs(sums / sizes[0] - (totals[0] - sums) / sizes[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(spread > 1e-12, gap / np.sqrt(spread), np.inf)
    return np.where(gap > 1e-9, found, 0.0)


def difference_tests(one: Floats, other: Floats) -> Floats:
    """Return P of `difference` of many studies, from values of shape (studies, participants of either group).

    Where there are more than `DRAWN` ways, the same draws serve all studies. NaN if there are fewer than two in either,
    or all have the same value.
    """
    values = np.concatenate([one, other], axis=1)
    people, first = values.shape[1], one.shape[1]
    if min(first, people - first) < 2:
        return np.full(len(values), np.nan)
    drawn = math.comb(people, first) > DRAWN
    if drawn:
        chosen = np.random.default_rng([people, first]).random((DRAWN, people)).argsort(axis=1) < first
    else:
        chosen = np.array([np.isin(range(people), own) for own in combinations(range(people), first)])
    found = _welch(values @ chosen.T, values**2 @ chosen.T, values, first)
    reached = _welch(one.sum(axis=1, keepdims=True), (one**2).sum(axis=1, keepdims=True), values, first)
    p = (np.count_nonzero(found >= reached * (1 - 1e-9), axis=1) + drawn) / (len(chosen) + drawn)
    return np.where(np.ptp(values, axis=1) > 1e-12, _bounded(p, one, other)[0], np.nan)


def compared(right: Integers, trials: Integers, members: Sequence[Sequence[bool]], rng: np.random.Generator) -> Apart:
    """Return the test of two groups' mean shares over materials, with its interval, from counts (materials, people).

    `members` say of all people who is in the first group, and who in the second. Raises `NotDefined` as `difference`.
    """
    (shares,) = mean_shares(right[None], trials[None])
    of = [np.flatnonzero(own) for own in members]
    found = difference(list(shares[of[0]]), list(shares[of[1]]), rng)
    means = float(shares[of[0]].mean()), float(shares[of[1]].mean())
    one, other = (modelled(right[:, own].sum(axis=0), trials[:, own].sum(axis=0)) for own in of)
    return replace(found, interval=squared_limits(found.value, means, (one, other), 0.0))
