"""Where the hand is and how fast it goes, from samples with noise and from the force that the servo itself sent.

An alpha-beta-gamma filter of place, speed and acceleration, whose acceleration is the hand's own. What the force that
was sent does to the device is added to it, as if that alone had to be moved: the hand only adds mass.

Gains are those of the steady Kalman filter of a changing acceleration: Kalata, "The Tracking Index", IEEE Transactions
on Aerospace and Electronic Systems 20, 1984.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from palpate.experiment.synthesis.contact.block import Pair, new

CHANGES_M_S2 = 0.1
"""By how much the hand's own acceleration changes from sample to sample, SD, m/s^2. Ours, by simulation of hands that
the force moves: less follows taps late, more trembles when the hand rests inside (`tests/benchmarks/force.py`)."""


class Seen(NamedTuple):
    """The hand along the normal, then along the face: place, m, speed, m/s, and its own acceleration, m/s^2."""

    m: float
    along_m: float
    m_s: float = 0.0
    along_m_s: float = 0.0
    m_s2: float = 0.0
    along_m_s2: float = 0.0


@dataclass(frozen=True)
class Observer:
    """What a servo believes of its hand.

    Attributes:
        period_s: between two samples.
        noise_m: SD of a sample, with the rounding to counts.
        mass_kg: the mass that it is told; at most the device's own.
    """

    period_s: float
    noise_m: float
    mass_kg: float

    @cached_property
    def gains(self) -> tuple[float, float, float]:
        """Of place, of speed (times the period), and of acceleration (times its square)."""
        index = CHANGES_M_S2 * self.period_s**2 / self.noise_m
        roots = np.roots([1.0, index / 2 - 3.0, index / 2 + 3.0, -1.0])
        (s,) = (one.real for one in roots if abs(one.imag) < 1e-9 and 0.0 < one.real < 1.0)
        beta = 2.0 * (1.0 - s) ** 2
        return float(1.0 - s * s), float(beta), float(beta * beta / (2.0 * (1.0 - s * s)))

    def step(self, seen: Seen, at_m: Pair, dt_s: float, sent_n: Pair) -> Seen:
        """Return what follows from a sample at (height, along the face), m, `dt_s` after the one before.

        `sent_n` is the force that was sent since then, N, out of the block and along its face. It is told at once,
        however late the device is: told late, a period of delay doubles the tremor and asks for five times the damping.
        """
        alpha, beta, gamma = self.gains
        out, along, out_s, along_s, out_s2, along_s2 = seen
        pushed, beside = out_s2 + sent_n[0] / self.mass_kg, along_s2 + sent_n[1] / self.mass_kg
        ahead = out + (out_s + pushed * dt_s / 2) * dt_s
        ahead_along = along + (along_s + beside * dt_s / 2) * dt_s
        off, off_along = at_m[0] - ahead, at_m[1] - ahead_along
        beta, gamma = beta / dt_s, gamma / (dt_s * dt_s)
        after = (
            ahead + alpha * off,
            ahead_along + alpha * off_along,
            out_s + pushed * dt_s + beta * off,
            along_s + beside * dt_s + beta * off_along,
            out_s2 + gamma * off,
            along_s2 + gamma * off_along,
        )
        return new(Seen, after)
