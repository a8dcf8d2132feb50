"""Passivity of a force that a servo holds between samples: how much damping of its own a device needs.

The condition is Colgate and Schenkel's, for a spring and a damper whose speed is the difference of two samples, and for
any answer from places to force.
"""

from collections.abc import Callable
from math import inf, pi

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import lowpass

FREQUENCIES = 4096
"""So many are scanned up to pi / T: the worst is often far below it."""

Complexes = NDArray[np.complex128]
Answers = Callable[[Complexes, Complexes], Complexes]

PAPER_RATE_HZ, PAPER_STIFFNESS_N_M, PAPER_DAMPING_N_S_M = 2500.0, 2500.0, 100.0
"""The servo and the block of Wellman and Howe's virtual task; the paper prints no mass, and N/m/s for the damping."""

PAPER_FASTEST_M_S, PAPER_FORCE_N = 0.175, 3.0
"""Its "maximum allowable velocity", and the peak force of its device, which the Virtual Environment Testbed prints."""


def needed_damping_n_s_m(
    *, stiffness_n_m: float, damping_n_s_m: float, period_s: float, delay_s: float = 0.0, crossover_hz: float = inf
) -> float:
    """Return the physical damping b that a device needs for a sampled wall to be passive, N s/m.

    The wall is a spring and a damper by backward difference, whose force is let through up to a crossover (`lowpass`).

    Raises `SynthesisError` unless all are finite, K, C and the delay at least zero, and the period above zero.
    """
    _sampled(stiffness_n_m, damping_n_s_m, period_s, delay_s)
    stays, adds_n_s_m = 0.0, damping_n_s_m
    if crossover_hz < inf:
        stays, adds_n_s_m = lowpass.relaxing(stiffness_n_m, damping_n_s_m, crossover_hz, period_s)

    def answers(before: Complexes, _: Complexes) -> Complexes:
        return (stiffness_n_m + adds_n_s_m * (1.0 - before) / (1.0 - stays * before) / period_s)[:, None]

    return passive_from_n_s_m(answers, period_s=period_s, delay_s=delay_s)


def passive_from_n_s_m(answers: Answers, *, period_s: float, delay_s: float = 0.0, samples: int = 1) -> float:
    """Return the least physical damping b for which a sampled force is passive, N s/m.

    Colgate and Schenkel, "Passivity of a Class of Sampled-Data Systems", Journal of Robotic Systems 14, 1997: for every
    frequency w up to pi / T, with the response H(z) from place to force,

        b > T / 2 / (1 - cos w T) Re{(1 - exp(-j w T)) H(exp(j w T)) exp(-j w d)}

    A force that is held for several samples answers to H at all frequencies that these tell apart, w_q = w + 2 pi q /
    T:

        b > (sqrt(|g|^2 |h|^2 - Im(sum g h)^2) - Re(sum g h)) / 2

    where g holds the shares of the force, and h those of the sampled places. `answers` gives H, N/m, shape (n,
    samples), at 1 / z of the force, shape (n,), and of the samples, shape (samples, n); `period_s` is between samples.
    """
    angle = np.linspace(0.0, pi, FREQUENCIES + 1)[1:]
    before = np.exp(-1j * angle)
    turns = (angle + 2.0 * pi * np.arange(samples)[:, None]) / samples
    late = np.exp(-1j * angle * delay_s / (samples * period_s))
    force = answers(before, np.exp(-1j * turns)) * late[:, None]
    squares = (period_s / 2 / np.sin(turns.T / 2)) ** 2
    given = -(1.0 - before) * (force * squares).sum(axis=1)
    sizes = np.abs(1.0 - before) ** 2 * squares.sum(axis=1) * (np.abs(force) ** 2 * squares).sum(axis=1)
    bound = (np.sqrt(np.maximum(sizes - given.imag**2, 0.0)) - given.real) / (2 * samples * period_s)
    return max(float(bound.max()), 0.0)


def of_the_paper() -> str:
    """Return the verdict on the paper's block, 2500 N/m and 100 N s/m at 2.5 kHz, in whole sentences."""
    period = 1 / PAPER_RATE_HZ
    needed = needed_damping_n_s_m(stiffness_n_m=PAPER_STIFFNESS_N_M, damping_n_s_m=PAPER_DAMPING_N_S_M, period_s=period)
    late = needed_damping_n_s_m(
        stiffness_n_m=PAPER_STIFFNESS_N_M, damping_n_s_m=PAPER_DAMPING_N_S_M, period_s=period, delay_s=period
    )
    lightest = PAPER_DAMPING_N_S_M * period / 2
    return (
        f"The paper's block of {PAPER_STIFFNESS_N_M:g} N/m and {PAPER_DAMPING_N_S_M:g} N s/m at "
        f"{PAPER_RATE_HZ:g} Hz, with the hand's speed as the difference between two samples, is passive only on a "
        f"device with {needed:.4g} N s/m of damping of its own "
        f"({late:.4g} N s/m if the force is a period late). A direct drive built for low friction has "
        "far less, so passivity does not explain why the block was stable. The fingers that held the device, and the "
        "mass of the block, which the paper does not state, may explain it. Most of the damping is needed for the "
        f"block's damper: its spring alone would need {PAPER_STIFFNESS_N_M * period / 2:g} N s/m. With explicit Euler, "
        f"the block itself would be unstable below about {lightest:.3g} kg. At a touch at "
        f"{PAPER_FASTEST_M_S * 1e3:g} mm/s, the damper requires {PAPER_DAMPING_N_S_M * PAPER_FASTEST_M_S:g} N; the "
        f"device produces about {PAPER_FORCE_N:g} N. If a servo estimates motion from the mass of its device's tip and "
        "the force that it sent, 2.4 to 6 N s/m are enough, and `palpate check --rig` computes the force error."
    )


def _sampled(stiffness_n_m: float, damping_n_s_m: float, period_s: float, delay_s: float) -> None:
    given = (stiffness_n_m, damping_n_s_m, delay_s)
    if not (all(0 <= value < inf for value in given) and 0 < period_s < inf):
        raise SynthesisError(
            f"wall: got {stiffness_n_m:g}, {damping_n_s_m:g} N s/m, a period of {period_s:g} s and a delay of "
            f"{delay_s:g} s; allowed: finite numbers of zero or more, and a period above zero; correct them"
        )
