"""d' of identification by the strongest of m independent, unbiased alternatives (m-AFC).

The share of correct answers is p = integral of phi(z - d') Phi(z)^(m - 1) (Green and Swets 1966; tabled by Hacker and
Ratcliff 1979, Percept. Psychophys. 26, 168-170). Answers with a bias, or materials of which some are more alike than
others, do not meet its assumptions: d' then sums up the share of correct answers, no more.
"""

from __future__ import annotations

import numpy as np

from analysis.exact import NotDefined

STEP = 0.05
REACH = 12.0
"""The sum over phi runs to so many standard deviations, at such steps: exact to rounding for so smooth a function."""

LARGEST = 20.0
"""|d'| beyond this cannot be told from infinity."""


def proportion_correct(d_prime: float, alternatives: int) -> float:
    """Share of correct answers of an observer with this d' among m alternatives."""
    from scipy.special import ndtr

    x = np.arange(-REACH, REACH + STEP / 2, STEP)
    density = np.exp(-x * x / 2) / np.sqrt(2 * np.pi)
    return float(STEP * (density * ndtr(x + d_prime) ** (alternatives - 1)).sum())


def d_prime(proportion: float, alternatives: int) -> float:
    """d' of a share of correct answers among m alternatives; negative below chance, 1/m.

    Raises:
        NotDefined: for a share of 0 or 1, where d' is infinite.
        ValueError: for a share that is none, or fewer than two alternatives.
    """
    if alternatives < 2 or not 0 <= proportion <= 1:
        raise ValueError(f"got a share of {proportion} among {alternatives}; allowed: 0 to 1 among two or more")
    low, high = -LARGEST, LARGEST
    if not proportion_correct(low, alternatives) < proportion < proportion_correct(high, alternatives):
        raise NotDefined(f"d' is infinite where the share of correct answers is {proportion:.3g}")
    while low < (middle := (low + high) / 2) < high:
        below = proportion_correct(middle, alternatives) < proportion
        low, high = (middle, high) if below else (low, middle)
    return middle


def corrected(count: int, trials: int) -> float:
    """Share of correct answers with 0 and 1 moved in by half a trial (Macmillan and Kaplan 1985)."""
    return min(max(count, 0.5), trials - 0.5) / trials
