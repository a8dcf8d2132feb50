"""Impacts in extended precision, straight from the differential equation's exponentials: the oracle of contact."""

from __future__ import annotations

from typing import Any

import mpmath as mp

from palpate.experiment.synthesis.stepping.impact import Collision

mp.mp.dps = 50


class Exact:
    """M r'' + C r' + K r = F from r = 0 at a speed, solved by two exponentials in 50 digits."""

    def __init__(self, of: Collision) -> None:
        k, c, m = mp.mpf(of.stiffness_n_m), mp.mpf(of.damping_n_s_m), mp.mpf(of.mass_kg)
        self.k, self.c = k, c
        self.v, self.p = mp.mpf(of.speed_m_s), mp.mpf(of.force_n) / m
        self.a, self.b = c / (2 * m), k / m
        self.printed = of.law == "printed" or (k == 0 and c == 0)

    def motion(self, t: Any) -> tuple[Any, Any]:
        """Return r and dr/dt at a time, s."""
        a, b, d = self.a, self.b, self.a**2 - self.b
        if d == 0:
            s, left = mp.exp(-a * t) * t, mp.exp(-a * t) * (1 + a * t)
        else:
            root = mp.sqrt(mp.mpc(d))
            up, down = mp.exp((root - a) * t), mp.exp((-root - a) * t)
            s, left = mp.re((up - down) / (2 * root)), mp.re(((a + root) * up - (a - root) * down) / (2 * root))
        free = (t - (1 - mp.exp(-2 * a * t)) / (2 * a)) / (2 * a) if a else t * t / 2
        w = (1 - left) / b if b else free
        return self.v * s + self.p * w, self.v * (left - 2 * a * s) + self.p * s

    def falls(self, t: Any) -> Any:
        """Return what falls through zero at a release: r, or K r + C dr/dt."""
        x, u = self.motion(t)
        return x if self.printed else self.k * x + self.c * u

    def release(self, near: float) -> Any:
        """Return the release between a millionth below and above a time; None where there is none."""
        low, high = near * (1 - mp.mpf(10) ** -6), near * (1 + mp.mpf(10) ** -6)
        if not self.falls(low) > 0 > self.falls(high):
            return None
        for _ in range(130):
            middle = (low + high) / 2
            low, high = (middle, high) if self.falls(middle) > 0 else (low, middle)
        return low
