"""How stiff a block may be: stability of the steppers.

In contact a stepper multiplies (r, h dr/dt) by one matrix a step, its amplification matrix. It is stable while no
eigenvalue of it is larger than 1. All matrices are written in K h^2 / M and C h / M, h being the step.
"""

from collections.abc import Callable
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact.oscillator import carry, oscillator
from palpate.experiment.synthesis.stepping.steppers import EXACT, stepper

UNSTABLE = 1e-14
"""By how much the largest eigenvalue may be above 1 by rounding."""


class Matrix(NamedTuple):
    """A matrix of two rows: (r, h dr/dt) after a step from those before it."""

    rr: float
    ru: float
    ur: float
    uu: float

    @property
    def radius(self) -> float:
        """The magnitude of its largest eigenvalue."""
        half, det = (self.rr + self.uu) / 2, self.rr * self.uu - self.ru * self.ur
        inside = ((self.rr - self.uu) / 2) ** 2 + self.ru * self.ur
        return abs(half) + sqrt(inside) if inside >= 0 else sqrt(max(det, 0.0))


def amplification(method: str, *, stiffness: float, damping: float) -> Matrix:
    """Return the amplification matrix at K h^2 / M and C h / M. Raises `SynthesisError` for an unknown method."""
    stepper(method)
    k, c = stiffness, damping
    if method == "euler":
        return Matrix(1.0, 1.0, -k, 1 - c)
    if method == "semi-implicit euler":
        return Matrix(1 - k, 1 - c, -k, 1 - c)
    if method == "implicit midpoint":
        under = 1 + c / 2 + k / 4
        return Matrix((1 + c / 2 - k / 4) / under, 1 / under, -k / under, (1 - c / 2 - k / 4) / under)
    if method.startswith("rk4"):
        one = np.array([[0.0, 1.0], [-k, -c]])
        powers = np.eye(2) + one @ (np.eye(2) + one / 2 @ (np.eye(2) + one / 3 @ (np.eye(2) + one / 4)))
        return Matrix(*powers.ravel().tolist())
    by = carry(oscillator(stiffness_n_m=k, damping_n_s_m=c, mass_kg=1.0), 1.0)
    return Matrix(by.kept + by.of_y, by.s_s, -by.pull_per_s, by.kept + by.of_speed)


def stable(method: str, *, stiffness_n_m: float, damping_n_s_m: float, mass_kg: float, step_s: float) -> bool:
    """Return whether a stepper is stable in contact, at this length of its step."""
    size, damping = step_s * step_s / mass_kg, damping_n_s_m * step_s / mass_kg
    if method in (EXACT, "exponential", "implicit midpoint"):
        # Every eigenvalue is exp of, or a Cayley transform of, what has no positive real part.
        return True
    if not (stiffness_n_m * size < 9 and damping < 6):
        # An eigenvalue times the step is 3 or more, where no explicit method here is stable.
        return False
    return amplification(method, stiffness=stiffness_n_m * size, damping=damping).radius <= 1 + UNSTABLE


def limit(method: str, *, damping_ratio: float) -> float:
    """Return the largest stable h w, w = sqrt(K / M), by bisection; infinity where every step is stable, 0 for none.

    Raises `SynthesisError` for an unknown method or a damping ratio that is not finite and at least zero.
    """
    stepper(method)
    if not 0 <= damping_ratio < inf:
        raise SynthesisError(f"damping ratio: got {damping_ratio}; allowed: finite, zero or more; correct it")

    def holds(h_w: float) -> bool:
        damping = 2 * damping_ratio * h_w
        return stable(method, stiffness_n_m=h_w * h_w, damping_n_s_m=damping, mass_kg=1.0, step_s=1.0)

    fast = max(damping_ratio + sqrt(max(damping_ratio**2 - 1, 0.0)), 1.0)
    return _last(holds, 1e-5 / fast, 1e3 / fast)


def _last(holds: Callable[[float], bool], first: float, last: float) -> float:
    """Return where a rising series first ceases to hold, bisected; infinity if it never does, 0 if it never did."""
    good = 0.0
    for bad in np.geomspace(first, last, 400).tolist():
        if not holds(bad):
            break
        good = bad
    else:
        return inf
    if not good:
        return 0.0
    while bad - good > 1e-12 * bad:
        middle = (good + bad) / 2
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return float(good)
