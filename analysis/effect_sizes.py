"""Effect sizes with confidence intervals: partial eta squared from F, Cohen's d from t.

Both intervals invert the noncentral distribution of the statistic (Steiger and Fouladi 1997; Steiger 2004, Psychol.
Methods 9, 164-182): a limit is the noncentrality at which the observed value stands at the tail of the interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from analysis.exact import NotDefined
from analysis.intervals import CONFIDENCE

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
