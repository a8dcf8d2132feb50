"""The force of a block up to a crossover: a low-pass filter of first order of its law, which stays passive.

With w = 2 pi times the crossover, what the filter makes of a spring and a damper is

    w (K + C s) / (s (s + w)) = K / s + (C w - K) / (s + w)

times the speed into the block: the spring K beside a spring C w - K that relaxes by w. It stores

    K r^2 / 2 + G^2 / (2 (C w - K))

G the relaxing spring's force, and so gives no more than it got where C w is at least K; a filter of a spring alone
does. Leaving the face lets go of G, and the force stays from 0 N to the limit by what G may be: filtered after that
limit, it would push on behind a hand that leaves. Both lower what is stored.
"""

from __future__ import annotations

from math import exp, pi

from palpate.experiment.synthesis.contact.block import Block


def relaxing(stiffness_n_m: float, damping_n_s_m: float, crossover_hz: float, dt_s: float) -> tuple[float, float]:
    """Return which part of G stays over a step of so long, s, and what a speed in it adds, N s/m."""
    turns = 2 * pi * crossover_hz
    stays = exp(-turns * dt_s)
    return stays, (damping_n_s_m - stiffness_n_m / turns) * (1.0 - stays)


def step(
    block: Block, relaxing_n: float, *, deep_m: float, deep_m_s: float, dt_s: float, limit_n: float
) -> tuple[float, float]:
    """Return G and the force along the normal, N, once the hand is so deep, m, after a step of `dt_s` at a speed, m/s.

    `relaxing_n` is G before. Of a step that begins outside, what lies inside counts.
    """
    if not deep_m > 0.0:
        return 0.0, 0.0
    k, c = block.stiffness_n_m[0], block.damping_n_s_m[0]
    stays, adds_n_s_m = relaxing(k, c, block.crossover_hz, dt_s)
    spring_n = min(k * deep_m, limit_n)
    relaxing_n = stays * relaxing_n + adds_n_s_m * min(deep_m_s, deep_m / dt_s)
    relaxing_n = min(max(relaxing_n, -spring_n), limit_n - spring_n)
    return relaxing_n, spring_n + relaxing_n
