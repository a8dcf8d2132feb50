"""Magnitude functions: ratings as a power of what was presented (Stevens 1957, Psychol. Rev. 64, 153-181).

log10(rating) = exponent log10(magnitude) + constant, by least squares over the geometric means of one participant's
ratings of each magnitude. Which numbers a participant likes to give moves the constant alone.
"""

from dataclasses import dataclass

import numpy as np

from palpate.analysis.statistics.exact import Floats, NotDefined


@dataclass(frozen=True)
class Power:
    """Exponent and constant of a power law, and the share of the variance of log10(rating) that it explains."""

    exponent: float
    constant: float
    r_squared: float | None


def power_law(magnitudes: Floats, ratings: Floats) -> Power:
    """Return the power law of ratings, each with its magnitude, both above 0 and of shape (trials,).

    Raises `NotDefined` below two magnitudes, or for a number that is not above 0.
    """
    known = np.unique(magnitudes)
    if len(known) < 2:
        raise NotDefined(f"a power law needs ratings of two magnitudes, got {len(known)}")
    if magnitudes.min() <= 0 or ratings.min() <= 0:
        raise NotDefined("a power law needs magnitudes and ratings above 0")
    x = np.log10(known)
    y = np.array([np.log10(ratings[magnitudes == one]).mean() for one in known])
    exponent, constant = (float(one) for one in np.polyfit(x, y, 1))
    varied = float(((y - y.mean()) ** 2).sum())
    left = float(((y - exponent * x - constant) ** 2).sum())
    return Power(exponent, constant, 1 - left / varied if varied > 0 else None)
