"""Mean answer ratios against chance: Student's t for one sample, its effect size, and Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from analysis.exact import Number, mean, sum_of_squares

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
    """One-sample, two-tailed t-test of `values`, shape (participants,), against `chance`.

    Raises:
        ValueError: for a value that is not finite.
    """
    null = Fraction(chance)
    n = len(values)
    if n == 0:
        return TTest(0, None, None, float(null), 0, None, None, None, "nobody was presented this material")
    centre = mean(values)
    if n == 1:
        statement = "one participant: SD, t and P are not defined"
        return TTest(1, float(centre), None, float(null), 0, None, None, None, statement)
    variance = sum_of_squares(values) / (n - 1)
    if variance == 0:
        statement = f"every participant's ratio is {float(centre):.3g}: no variance, t and P are not defined"
        return TTest(n, float(centre), 0.0, float(null), n - 1, None, None, None, statement)
    sd = math.sqrt(variance)
    effect = float(centre - null) / sd
    t = effect * math.sqrt(n)
    return TTest(n, float(centre), sd, float(null), n - 1, t, p_two_tailed(t, n - 1), effect)


def holm(p_values: Sequence[float]) -> list[float]:
    """P adjusted for the number of tests in a family (Holm 1979), in the order given.

    The i-th smallest of m values is multiplied by m - i + 1; no adjusted value is below that of a smaller P,
    none above 1.
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted
