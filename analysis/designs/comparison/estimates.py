"""A value on a scale of comparisons with its interval over participants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from palpate.analysis.statistics.inference import CONFIDENCE


@dataclass(frozen=True)
class Estimate:
    """A value on a scale with its standard error and interval, from participants as the units; None of one alone."""

    value: float
    se: float | None
    low: float | None
    high: float | None


def estimate(value: float, se: float, people: int) -> Estimate:
    """Return the interval by Student's t with one degree of freedom less than there are participants."""
    if people < 2 or not np.isfinite(se):
        return Estimate(value, None, None, None)
    half = float(stdtrit(people - 1, (1 + CONFIDENCE) / 2)) * se
    return Estimate(value, se, value - half, value + half)
