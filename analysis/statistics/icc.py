"""Intraclass correlations of a complete targets x raters matrix, in every form.

Formulas and names: Shrout and Fleiss (1979, Psychol. Bull. 86, 420-428); McGraw and Wong (1996, Psychol. Methods 1,
30-46, Tables 4, 7 and 8).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtri

from palpate.analysis.statistics import exact


@dataclass(frozen=True)
class IccForm:
    """One form under both of its names, the test of ICC = 0 and the confidence interval; None where undefined.

    `model` names model, type and unit in words; `value` may be negative; `statement` says why something is None.
    """

    shrout_fleiss: str
    mcgraw_wong: str
    model: str
    value: float | None
    f: float | None
    df1: int
    df2: int
    p: float | None
    low: float | None
    high: float | None
    statement: str


@dataclass(frozen=True)
class Icc:
    """All forms for one matrix of `targets` x `raters`, and the mean squares that they are made of."""

    targets: int
    raters: int
    ms_targets: float
    ms_raters: float
    ms_error: float
    ms_within: float
    confidence: float
    forms: tuple[IccForm, ...]

    def form(self, shrout_fleiss: str) -> IccForm:
        """Return the form with this Shrout-Fleiss name; `KeyError` when there is none."""
        return {form.shrout_fleiss: form for form in self.forms}[shrout_fleiss]


NAMES = {
    "ICC(1,1)": ("ICC(1)", "one-way random, single rater"),
    "ICC(2,1)": ("ICC(A,1)", "two-way random or mixed, absolute agreement, single rater"),
    "ICC(3,1)": ("ICC(C,1)", "two-way random or mixed, consistency, single rater"),
    "ICC(1,k)": ("ICC(k)", "one-way random, mean of k raters"),
    "ICC(2,k)": ("ICC(A,k)", "two-way random or mixed, absolute agreement, mean of k raters"),
    "ICC(3,k)": ("ICC(C,k)", "two-way random or mixed, consistency, mean of k raters"),
}


def icc(ratings: Sequence[Sequence[exact.Number]], confidence: float = 0.95) -> Icc:
    """Return every form for `ratings`, shape (targets, raters), without gaps.

    Raises `NotDefined` below two targets or raters, or without variance, and `ValueError` for unequal lengths or values
    not finite.
    """
    n, k = len(ratings), len(ratings[0]) if ratings else 0
    if any(len(row) != k for row in ratings):
        raise ValueError(f"every rater must rate every target, got row lengths {sorted({len(row) for row in ratings})}")
    if n < 2 or k < 2:
        raise exact.NotDefined(f"an ICC needs two targets and two raters, got {n} and {k}")
    whole, denominator = exact.integers([value for row in ratings for value in row])
    found = _spreads(np.array(whole, dtype=object).reshape(n, 1, k))
    if not found.total[0]:
        raise exact.NotDefined("all ratings are the same, so the ICC is not defined")
    unit = n * k * n * (n - 1) * (k - 1) * denominator**2
    ms_r, ms_c, ms_e, ms_w = (ms / unit for ms in (found.targets, found.raters, found.error, found.within))
    tests = {"1": found.test("1"), "2": (two_way := found.test("2")), "3": two_way}
    forms: dict[str, IccForm] = {}
    for kind in "123":
        single, average = (_known(found.value(kind, size)) for size in "1k")
        tested, df2 = tests[kind]
        f, p = _known(tested.statistic), _known(tested.p)
        if kind == "2":
            limits = _limits_agreement(ms_r, ms_c, ms_e, single, n, k, confidence)
        else:
            limits = _limits_of_f(f, n - 1, df2, k, confidence)
        # Spearman and Brown's step from one rater to the mean of k.
        stepped = tuple(None if x is None or (k - 1) * x <= -1 else k * x / (1 + (k - 1) * x) for x in limits)
        for size, value, ends in (("1", single, limits), ("k", average, stepped)):
            name = f"ICC({kind},{size})"
            statement = _why(kind, value, f, limits, ends)
            forms[name] = IccForm(name, *NAMES[name], value, f, n - 1, df2, p, ends[0], ends[1], statement)
    return Icc(n, k, ms_r, ms_c, ms_e, ms_w, confidence, tuple(forms[name] for name in NAMES))


def icc_tests(counts: exact.Integers, form: str) -> tuple[exact.Floats, exact.Tested]:
    """Return one form, by its Shrout-Fleiss name, and its test, from counts of shape (targets, studies, raters)."""
    n, studies, k = counts.shape
    if n < 2 or k < 2:
        nothing = exact.undefined((studies,))
        return nothing.statistic, nothing
    kind, size = form.removeprefix("ICC(").removesuffix(")").split(",")
    found = _spreads(counts)
    return found.value(kind, size), found.test(kind)[0]


@dataclass(frozen=True)
class _Spreads:
    """Mean squares times n k n (n - 1) (k - 1), shape (studies,): Python's integers of one study, float64 of many."""

    n: int
    k: int
    targets: Any
    raters: Any
    within: Any
    error: Any
    total: Any

    def value(self, kind: str, size: str) -> Any:
        """Return the estimate; NaN where the variance that it is a share of is not above zero."""
        t, n, k = self.targets, self.n, self.k
        noise = self.within if kind == "1" else self.error
        rest = 1 if size == "k" else k
        if kind == "2":
            whole = n * t + n * (rest - 1) * noise + rest * (self.raters - noise)
            return exact.ratio(n * (t - noise), whole)
        return exact.ratio(t - noise, t + (rest - 1) * noise)

    def test(self, kind: str) -> tuple[exact.Tested, int]:
        """Return the test of ICC = 0, and its residual degrees of freedom."""
        df2 = self.n * (self.k - 1) if kind == "1" else (self.n - 1) * (self.k - 1)
        noise = self.within if kind == "1" else self.error
        return exact.f_test(self.targets * (self.n - 1), noise * df2, self.n - 1, df2), df2


def _spreads(ratings: Any) -> _Spreads:
    """Return the mean squares of whole ratings, shape (targets, studies, raters)."""
    n, _, k = ratings.shape
    total = ratings.sum(axis=(0, 2))
    everything = n * k * np.einsum("isk,isk->s", ratings, ratings) - total**2
    targets = n * (ratings.sum(axis=2) ** 2).sum(axis=0) - total**2
    raters = k * (ratings.sum(axis=0) ** 2).sum(axis=1) - total**2
    parts = (targets, raters, everything - targets, everything - targets - raters)
    # The differences are exact; their multiples may be too large for 64 bits.
    t, c, w, e = (part[0] for part in parts) if ratings.dtype == object else map(exact.floats, parts)
    return _Spreads(n, k, t * n * (k - 1), c * n * (n - 1), w * (n - 1), e * n, everything)


def _known(value: Any) -> float | None:
    return None if math.isnan(value) else float(value)


Limits = tuple[float | None, ...]


def _why(kind: str, value: float | None, f: float | None, single: Limits, ends: Limits) -> str:
    """Return why a form lacks its value, its test or its interval; empty where it has all of them."""
    said = []
    if value is None:
        said.append("its denominator variance is estimated as zero or less, so it is not defined")
    if f is None:
        what = "within targets" if kind == "1" else "other than that of targets and raters"
        said.append(f"there is no variance {what}, so F and P are not defined")
    if None not in ends:
        return "; ".join(said)
    if said:
        said.append("nor is the interval")
    elif None in single:
        said.append("the degrees of freedom of its interval are near zero, so the interval is not defined")
    else:
        said.append("a limit for one rater is too low to convert to the mean of k, so the interval is not defined")
    return "; ".join(said)


def _limits_of_f(f: float | None, df1: int, df2: int, k: int, confidence: float) -> Limits:
    """Return the limits of the forms that depend on one F alone (Shrout and Fleiss, p. 424)."""
    if f is None:
        return None, None
    tail = 1 - (1 - confidence) / 2
    low, high = f / float(fdtri(df1, df2, tail)), f * float(fdtri(df2, df1, tail))
    return (low - 1) / (low + k - 1), (high - 1) / (high + k - 1)


def _limits_agreement(
    ms_r: float, ms_c: float, ms_e: float, value: float | None, n: int, k: int, confidence: float
) -> Limits:
    """Return the limits of ICC(A,1) with Satterthwaite's df (McGraw and Wong, Table 7), None near df of zero."""
    if value is None or value >= 1 or (ms_c == 0 and ms_e == 0):
        return None, None
    a = k * value / (n * (1 - value))
    b = 1 + k * value * (n - 1) / (n * (1 - value))
    spread = (a * ms_c) ** 2 / (k - 1) + (b * ms_e) ** 2 / ((n - 1) * (k - 1))
    if spread == 0:
        return None, None
    v = (a * ms_c + b * ms_e) ** 2 / spread
    tail = 1 - (1 - confidence) / 2
    f_low, f_high = float(fdtri(n - 1, v, tail)), float(fdtri(v, n - 1, tail))
    if not (math.isfinite(f_low) and math.isfinite(f_high)):
        return None, None
    mixed = k * ms_c + (k * n - k - n) * ms_e
    low = n * (ms_r - f_low * ms_e) / (f_low * mixed + n * ms_r)
    high = n * (f_high * ms_r - ms_e) / (mixed + n * f_high * ms_r)
    return (low, high) if low <= value <= high else (None, None)
