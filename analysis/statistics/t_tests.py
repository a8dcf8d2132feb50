"""Mean answer ratios against chance: t, P and stars, Holm's correction, effect sizes, and a Bayes factor.

Intervals of effect sizes invert the noncentral distribution of the statistic (Steiger and Fouladi 1997; Steiger 2004,
Psychol. Methods 9, 164-182): a limit is the noncentrality at which the observed value stands at the tail of the
interval. The Bayes factor has the JZS prior: a Cauchy distribution of the effect size, Jeffreys's of the variance
(Rouder, Speckman, Sun, Morey and Iverson 2009, Psychon. Bull. Rev. 16, 225-237, equation (1)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from analysis.statistics.exact import Floats, NotDefined, Number, Ratios, Tested, floats, of_groups, over, undefined
from analysis.statistics.intervals import CONFIDENCE

STARS = ((0.001, "***"), (0.01, "**"), (0.05, "*"))
"""Levels below which P earns stars (note under Okamoto's Table 1)."""


@dataclass(frozen=True)
class TTest:
    """Result of `t_against_chance`; what the values do not define is None, and `statement` says why.

    Args:
        n: participants.
        mean: mean ratio.
        sd: sample standard deviation (n - 1).
        chance: the ratio under the null hypothesis.
        df: degrees of freedom, n - 1.
        t: (mean - chance) / (sd / sqrt(n)).
        p: two-tailed.
        d: Cohen's d, (mean - chance) / sd.
        statement: empty when everything is defined.
    """

    n: int
    mean: float | None
    sd: float | None
    chance: float
    df: int
    t: float | None
    p: float | None
    d: float | None
    statement: str = ""

    @property
    def stars(self) -> str:
        """Stars for a mean above chance, after the unadjusted P; empty otherwise."""
        above = self.mean is not None and self.mean > self.chance
        return stars(self.p) if above and self.p is not None else ""


def stars(p: float, levels: Sequence[tuple[float, str]] = STARS) -> str:
    """The stars of the first level that P is below, `*`, `**`, `***` for 0.05, 0.01, 0.001; empty otherwise."""
    return next((mark for level, mark in levels if p < level), "")


def p_two_tailed(t: float, df: int) -> float:
    """Probability of a Student t at least as far from 0 as `t`, at `df` degrees of freedom."""
    from scipy.special import stdtr

    return float(2 * stdtr(df, -abs(t)))


def t_against_chance(values: Sequence[Number], chance: Number) -> TTest:
    """Return the one-sample, two-tailed t-test of `values`, shape (participants,), against `chance`.

    Raises:
        ValueError: for a value that is not finite.
    """
    null = Fraction(chance)
    n = len(values)
    if n == 0:
        return TTest(0, None, None, float(null), 0, None, None, None, "nobody was presented this material")
    cells = of_groups([values])
    mean = float(cells.means[0, 0])
    if n == 1:
        statement = "one participant: SD, t and P are not defined"
        return TTest(1, mean, None, float(null), 0, None, None, None, statement)
    if not cells.scatter[0, 0]:
        statement = f"every participant's ratio is {mean:.3g}: no variance, t and P are not defined"
        return TTest(n, mean, 0.0, float(null), n - 1, None, None, None, statement)
    sd, d, tested = _sizes(cells, n, null)
    t, p = float(tested.statistic[0, 0]), float(tested.p[0, 0])
    return TTest(n, mean, float(sd[0, 0]), float(null), n - 1, t, p, float(d[0, 0]))


def t_tests(cells: Ratios, chance: Fraction) -> Tested:
    """Return the t and P of each cell of many studies against `chance`; undefined where nothing varies."""
    return undefined(cells.sums.shape) if cells.participants < 2 else _sizes(cells, cells.participants, chance)[2]


def _sizes(cells: Ratios, n: int, chance: Fraction) -> tuple[Floats, Floats, Tested]:
    """SD, d and t of each cell of `n` participants."""
    from scipy.special import stdtr

    variance = floats(over(cells.scatter, n * (n - 1) * cells.denominator**2))
    sd = np.sqrt(np.where(variance > 0, variance, np.nan))
    d = floats(cells.means - (chance if cells.exact else float(chance))) / sd
    t = d * math.sqrt(n)
    return sd, d, Tested(t, 2 * stdtr(n - 1, -np.abs(t)))


def holm(p: Floats) -> Floats:
    """Return P adjusted for the tests of a family (Holm 1979), which lie along the first axis.

    The i-th smallest of m values is multiplied by m - i + 1; no adjusted value is below that of a smaller P, none above
    1. NaN, a test that is not defined, counts as 1 in its family, since it was planned; it stays NaN.
    """
    family = np.where(np.isnan(p), 1.0, p)
    order = np.argsort(family, axis=0, kind="stable")
    factors = np.arange(len(p), 0, -1).reshape(-1, *[1] * (p.ndim - 1))
    stepped = np.maximum.accumulate(np.minimum(1.0, np.take_along_axis(family, order, axis=0) * factors), axis=0)
    adjusted = np.empty_like(stepped)
    np.put_along_axis(adjusted, order, stepped, axis=0)
    return np.where(np.isnan(p), np.nan, adjusted)


ETA_CONFIDENCE = 0.90
"""An F test at 5 % uses one tail: its interval that excludes 0 exactly when P < 0.05 is that of 90 % (Steiger 2004)."""


SMALLEST = 1e-100
"""A t nearer to 0 is taken as 0: scipy's noncentral t has no value there."""


@dataclass(frozen=True)
class EffectSize:
    """An estimate with its limits at `confidence`; a limit that cannot be computed is None."""

    value: float
    low: float | None
    high: float | None
    confidence: float


def partial_eta_squared(f: float, df1: int, df2: int, confidence: float = ETA_CONFIDENCE) -> EffectSize:
    """Share of the variance left by the other effects that this one takes: df1 F / (df1 F + df2).

    Args:
        f: of the effect, not negative.
        df1, df2: its degrees of freedom, and those of the residual.
        confidence: of the interval, noncentrality L mapped to L / (L + df1 + df2 + 1).
    """
    from scipy.special import ncfdtr

    value = df1 * f / (df1 * f + df2)
    tail = (1 - confidence) / 2
    limits = []
    for probability in (1 - tail, tail):
        limit = _noncentrality(lambda nc: float(ncfdtr(df1, df2, nc, f)), probability, 0.0)
        limits.append(None if limit is None else limit / (limit + df1 + df2 + 1))
    return EffectSize(value, limits[0], limits[1], confidence)


def cohens_d(t: float, df: int, confidence: float = CONFIDENCE) -> EffectSize:
    """Cohen's d of a one-sample t, t / sqrt(n) at n = df + 1, with the limits of noncentral t.

    Args:
        t: the statistic.
        df: degrees of freedom, n - 1.
        confidence: of the interval.
    """
    from scipy.special import nctdtr

    root = math.sqrt(df + 1)
    observed = 0.0 if abs(t) < SMALLEST else t
    tail = (1 - confidence) / 2
    limits = []
    for probability in (1 - tail, tail):
        limit = _noncentrality(lambda nc: float(nctdtr(df, nc, observed)), probability, None)
        limits.append(None if limit is None else limit / root)
    return EffectSize(t / root, limits[0], limits[1], confidence)


def _noncentrality(below: Callable[[float], float], probability: float, least: float | None) -> float | None:
    """Where `below`, falling in the noncentrality, is `probability`; `least` where it is less already there.

    Bisection down to neighbouring numbers. None where the distribution cannot be computed.
    """
    try:
        return _bisected(lambda nc: _number(below(nc)), probability, least)
    except NotDefined:
        return None


def _number(value: float) -> float:
    if math.isnan(value):
        raise NotDefined("the distribution cannot be computed")
    return value


def _bisected(below: Callable[[float], float], probability: float, least: float | None) -> float | None:
    if least is not None and below(least) <= probability:
        return least
    low, high = (least if least is not None else -1.0), 1.0
    for _ in range(60):
        if below(low) >= probability:
            break
        low *= 2
    for _ in range(60):
        if below(high) <= probability:
            break
        high *= 2
    if not below(low) >= probability >= below(high):
        return None
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if below(middle) >= probability else (low, middle)
    return middle


SCALE = math.sqrt(0.5)
"""Scale of the Cauchy prior, the default of the R package BayesFactor and of JASP; Rouder et al. (2009) took 1."""

STEP = 0.05
LOWEST, HIGHEST = -30.0, 90.0
"""Range of log g: below it the integrand is below e^(-10^12), above it below 10^-38 of its mass."""


def log_bayes_factor(t: float, n: int, scale: float = SCALE) -> float:
    """Natural logarithm of BF10, the evidence for an effect over that for none.

    The integral over g is the sum at equal steps of log g, which converges exponentially for such integrands (Trefethen
    and Weideman 2014).

    Args:
        t: one-sample t, two-tailed.
        n: participants, at least 2.
        scale: of the Cauchy prior on the effect size.
    """
    df = n - 1
    log_g = np.arange(LOWEST, HIGHEST, STEP) + 2 * math.log(scale)
    spread = np.log1p(n * np.exp(log_g))
    likelihood = -spread / 2 - n / 2 * np.log1p(t * t / df * np.exp(-spread))
    prior = math.log(scale) - math.log(2 * math.pi) / 2 - log_g / 2 - scale * scale / 2 * np.exp(-log_g)
    logs = likelihood + prior
    largest = float(logs.max())
    integral = largest + math.log(STEP * float(np.exp(logs - largest).sum()))
    return integral + n / 2 * math.log1p(t * t / df)
