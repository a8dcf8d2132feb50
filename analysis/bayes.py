"""Bayes factor of a one-sample t-test with the JZS prior: how much the answers speak for or against chance.

The effect size has a Cauchy prior, the variance Jeffreys's (Rouder, Speckman, Sun, Morey and Iverson 2009, Psychon.
Bull. Rev. 16, 225-237, equation (1)).
"""

from __future__ import annotations

import math

import numpy as np

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
