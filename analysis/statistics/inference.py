"""Samples of answer ratios: tests against chance, effect sizes, a Bayes factor, and intervals.

Wilson's and Clopper and Pearson's intervals take trials as independent; those over participants are in `shares.py`.
Effect sizes: Steiger and Fouladi (1997; Steiger 2004, Psychol. Methods 9,
164-182). JZS Bayes factor: Rouder et al. (2009, Psychon. Bull. Rev. 16, 225-237, equation (1)).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.special import betaincinv, ncfdtr, nctdtr, ndtri, stdtr

from palpate.analysis.statistics import exact

CONFIDENCE = 0.95

STARS = ((0.001, "***"), (0.01, "**"), (0.05, "*"))
"""The levels of P for stars (note under Okamoto's Table 1)."""


@dataclass(frozen=True)
class TTest:
    """The two-tailed t-test of `n` participants' mean ratio against chance, Cohen's d, and a sample's `sd` (n - 1).

    What the values do not define is None, and `statement` says why.
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
        """The stars of the unadjusted P for a mean above chance; empty otherwise."""
        above = self.mean is not None and self.mean > self.chance
        return stars(self.p) if above and self.p is not None else ""


def stars(p: float, levels: Sequence[tuple[float, str]] = STARS) -> str:
    """Return the stars of the first level that P is below; empty where there is none."""
    return next((mark for level, mark in levels if p < level), "")


def p_two_tailed(t: float, df: int) -> float:
    """Return the probability of a Student t at least as far from 0 as `t`, at `df` degrees of freedom."""
    return float(2 * stdtr(df, -abs(t)))


def t_against_chance(values: Sequence[exact.Number], chance: exact.Number) -> TTest:
    """Return the one-sample, two-tailed t-test of finite `values`, shape (participants,), against `chance`."""
    null = Fraction(chance)
    n = len(values)
    if n == 0:
        return TTest(0, None, None, float(null), 0, None, None, None, "this material was not presented")
    cells = exact.of_groups([values])
    mean = float(cells.means[0, 0])
    if n == 1:
        statement = "with one participant, SD, t and P are not defined"
        return TTest(1, mean, None, float(null), 0, None, None, None, statement)
    if not cells.scatter[0, 0]:
        statement = f"every participant's ratio is {mean:.3g}: there is no variance, so t and P are not defined"
        return TTest(n, mean, 0.0, float(null), n - 1, None, None, None, statement)
    sd, d, tested = _sizes(cells, n, null)
    t, p = float(tested.statistic[0, 0]), float(tested.p[0, 0])
    return TTest(n, mean, float(sd[0, 0]), float(null), n - 1, t, p, float(d[0, 0]))


def t_tests(cells: exact.Ratios, chance: Fraction) -> exact.Tested:
    """Return t and P of each cell of many studies against `chance`; they are undefined where nothing varies."""
    return exact.undefined(cells.sums.shape) if cells.participants < 2 else _sizes(cells, cells.participants, chance)[2]


def _sizes(cells: exact.Ratios, n: int, chance: Fraction) -> tuple[exact.Floats, exact.Floats, exact.Tested]:
    """Return SD, d and t of each cell of `n` participants."""
    variance = exact.floats(exact.quotient(cells.scatter, n * (n - 1) * cells.denominator**2))
    sd = np.sqrt(np.where(variance > 0, variance, np.nan))
    d = exact.floats(cells.means - (chance if cells.exact else float(chance))) / sd
    t = d * math.sqrt(n)
    return sd, d, exact.Tested(t, 2 * stdtr(n - 1, -np.abs(t)))


def holm(p: exact.Floats) -> exact.Floats:
    """Return P adjusted in a family along the first axis (Holm 1979); NaN counts as 1 in it, and stays NaN."""
    family = np.where(np.isnan(p), 1.0, p)
    order = np.argsort(family, axis=0, kind="stable")
    factors = np.arange(len(p), 0, -1).reshape(-1, *[1] * (p.ndim - 1))
    stepped = np.maximum.accumulate(np.minimum(1.0, np.take_along_axis(family, order, axis=0) * factors), axis=0)
    adjusted = np.empty_like(stepped)
    np.put_along_axis(adjusted, order, stepped, axis=0)
    return np.where(np.isnan(p), np.nan, adjusted)


ETA_CONFIDENCE = 0.90
"""The interval of 90 % excludes 0 exactly when P < 0.05, because an F test uses one tail (Steiger 2004)."""

SMALLEST = 1e-100
"""A t nearer to 0 is taken as 0, because scipy's noncentral t has no value there."""


@dataclass(frozen=True)
class EffectSize:
    """An estimate with its limits at `confidence`; a limit that cannot be computed is None."""

    value: float
    low: float | None
    high: float | None
    confidence: float


def partial_eta_squared(f: float, df1: int, df2: int) -> EffectSize:
    """Return the share of the variance left by the other effects that this one takes: df1 F / (df1 F + df2).

    `f` is not negative. The interval's limits are those of the noncentrality L, mapped to L / (L + df1 + df2 + 1).
    """
    found = _noncentralities(lambda nc: float(ncfdtr(df1, df2, nc, f)), ETA_CONFIDENCE, least=0.0)
    low, high = (None if limit is None else limit / (limit + df1 + df2 + 1) for limit in found)
    return EffectSize(df1 * f / (df1 * f + df2), low, high, ETA_CONFIDENCE)


def cohens_d(t: float, df: int) -> EffectSize:
    """Return Cohen's d of a one-sample t, t / sqrt(n) at n = df + 1, with the limits of noncentral t."""
    root = math.sqrt(df + 1)
    observed = 0.0 if abs(t) < SMALLEST else t
    found = _noncentralities(lambda nc: float(nctdtr(df, nc, observed)), CONFIDENCE)
    low, high = (None if limit is None else limit / root for limit in found)
    return EffectSize(t / root, low, high, CONFIDENCE)


def _noncentralities(
    below: Callable[[float], float], confidence: float, least: float = -math.inf
) -> tuple[float | None, float | None]:
    """Return where `below`, which falls with the noncentrality, leaves each tail; None where it cannot be computed."""
    tail = (1 - confidence) / 2
    return _bisected(below, 1 - tail, least), _bisected(below, tail, least)


def _bisected(below: Callable[[float], float], probability: float, least: float) -> float | None:
    """Return where `below` is `probability`, or `least` where it is less already there, by bisection."""

    def gap(noncentrality: float) -> float:
        if math.isnan(value := below(noncentrality)):
            raise exact.NotDefined("the distribution cannot be computed")
        return value - probability

    low, high = max(least, -1.0), 1.0
    try:
        if low == least and gap(least) <= 0:
            return least
        while gap(low) < 0 and low > -(2.0**60):
            low *= 2
        while gap(high) > 0 and high < 2.0**60:
            high *= 2
        if gap(low) < 0 or gap(high) > 0:
            return None
        while low < (middle := (low + high) / 2) < high:
            low, high = (middle, high) if gap(middle) >= 0 else (low, middle)
    except exact.NotDefined:
        return None
    return middle


SCALE = math.sqrt(0.5)
"""The scale of the Cauchy prior, the default of the R package BayesFactor and of JASP; Rouder et al. (2009) took 1."""

STEP = 0.05
LOWEST, HIGHEST = -30.0, 90.0
"""The range of log g: below it the integrand is less than e^(-10^12), above it less than 10^-38 of its mass."""


def log_bayes_factor(t: float, n: int, scale: float = SCALE) -> float:
    """Return the natural logarithm of BF10, the evidence for an effect over that for none, of a two-tailed t.

    The sum at equal steps of log g converges exponentially (Trefethen and Weideman 2014). `n` is at least 2.
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


@dataclass(frozen=True)
class ConfidenceInterval:
    """An interval's limits at `confidence`."""

    low: float
    high: float
    confidence: float


def wilson(count: int, trials: int, confidence: float = CONFIDENCE) -> ConfidenceInterval:
    """Return the score interval without continuity correction (Wilson 1927)."""
    _check(count, trials)
    z = float(ndtri((1 + confidence) / 2))
    centre = count + z * z / 2
    half = z * math.sqrt(count * (trials - count) / trials + z * z / 4)
    low, high = (centre - half) / (trials + z * z), (centre + half) / (trials + z * z)
    return ConfidenceInterval(low if count else 0.0, high if count < trials else 1.0, confidence)


def clopper_pearson(count: int, trials: int, confidence: float = CONFIDENCE) -> ConfidenceInterval:
    """Return the exact interval: neither tail of the binomial exceeds half of 1 - `confidence` (1934)."""
    _check(count, trials)
    tail = (1 - confidence) / 2
    low = float(betaincinv(count, trials - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, trials - count, 1 - tail)) if count < trials else 1.0
    return ConfidenceInterval(low, high, confidence)


def _check(count: int, trials: int) -> None:
    if not 0 <= count <= trials or not trials:
        raise ValueError(f"got {count} of {trials}; allowed: a count from 0 to the trials, of at least one trial")


LEAST = 3
"""The fewest participants that can be resampled."""


def resamples(participants: int, count: int, rng: np.random.Generator) -> exact.Integers:
    """Return how often each participant is in each resample, shape (count, participants); NotDefined for too few."""
    if participants < LEAST:
        raise exact.NotDefined(f"a bootstrap needs {LEAST} participants, got {participants}")
    return np.asarray(
        rng.multinomial(participants, np.full(participants, 1 / participants), size=count), dtype=np.int64
    )
