"""SIMULATED surfaces: how each rings when it is tapped, and how high that feels through the skin.

A tap rings as equation (2) of Wellman and Howe, with the surface's frequency in Table 1. Other materials are generic:
their stiffnesses span Table 1 in equal ratios, with the frequency for each. They resemble nothing.

Receptors get the vibration behind a low-pass filter. The Pacinian threshold in displacement falls by 12 dB an octave up
to about 300 Hz (Bolanowski, Gescheider, Verrillo and Checkosky 1988), a constant in acceleration, and rises steeply
above; ours is a Butterworth filter of fourth order. The felt height is the mean frequency of the power that passes, so
aluminum's 4000 Hz hardly arrive; no number of Table 2 is used for that.
"""

import hashlib
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.synthesis.tap import DECAY_PER_S, SURFACES

TABLE_1: Mapping[str, tuple[float, float]] = {
    surface.name.split()[-1]: (surface.stiffness_n_m, surface.attack_hz) for surface in SURFACES
}
"""Material, by the last word of its name, -> stiffness, N/m, and the frequency of its attack, Hz, as printed."""

RATE_HZ = 40_000
"""As the paper samples its recordings."""

RINGS_S = 0.1
"""After so long a tap has decayed to exp(-10) of its peak."""

FELT_BELOW_HZ = 300.0
FILTER_ORDER = 4


FITTED = ((0.0, 1.0), (1.35, 1.0), (1.74, 1.0), (6.31, 7.17), (7.69, 1.0))
"""Hardness of each virtual surface of Table 1, and the error of its judgment, in errors of any surface but plastic.

FITTED to Table 3 by greatest likelihood, 56 answers a pair (Thurstone's case III). The paper does not explain plastic's
large error; its 1000 Hz lie where vibration ceases to be felt.
"""

NOTHING = (-10.0, 1.0)
"""Where nothing is felt: softer than any surface. Ours."""


def frequencies_hz(materials: Sequence[str]) -> tuple[float, ...]:
    """Return the frequency at which each material rings, Hz; `materials` stand from the least to the most stiff."""
    if all(material in TABLE_1 for material in materials):
        return tuple(TABLE_1[material][1] for material in materials)
    stiffness, frequency = np.log(np.array(list(TABLE_1.values()))).T
    wanted = np.linspace(stiffness[0], stiffness[-1], len(materials))
    return tuple(np.exp(np.interp(wanted, stiffness, frequency)).tolist())


def mixed(materials: Sequence[str]) -> list[str]:
    """Return materials that stand in no order from the least to the most stiff, by a hash of their names; ours."""
    return sorted(materials, key=lambda name: hashlib.sha256(name.encode()).digest())


def rings(frequency_hz: float) -> NDArray[np.float64]:
    """Return a tap with a peak amplitude of 1 before it decays, shape (n,), at `RATE_HZ` (equation (2))."""
    seconds = np.arange(round(RINGS_S * RATE_HZ)) / RATE_HZ
    return np.asarray(np.exp(-DECAY_PER_S * seconds) * np.sin(2 * np.pi * frequency_hz * seconds), np.float64)


def felt_hz(vibration: NDArray[np.float64], rate_hz: int) -> float | None:
    """Return how high an acceleration, shape (n,), feels, Hz: the mean frequency past the skin; None for silence."""
    bins_hz = np.fft.rfftfreq(2 * len(vibration), 1 / rate_hz)
    passed = np.abs(np.fft.rfft(vibration, 2 * len(vibration))) ** 2
    passed /= 1 + (bins_hz / FELT_BELOW_HZ) ** (2 * FILTER_ORDER)
    # The first bin begins at 0 Hz, so it is half as wide as the others.
    passed[0] /= 2
    return float(bins_hz @ passed / passed.sum()) if passed.any() else None


@cache
def _fitted() -> NDArray[np.float64]:
    """Return the logarithm of each felt height of Table 1, the lowest first, with its hardness and error: (5, 3)."""
    felt = ((felt_hz(rings(hz), RATE_HZ) or 1.0, *fit) for (_, hz), fit in zip(TABLE_1.values(), FITTED, strict=True))
    return np.array(sorted((float(np.log(hz)), *fit) for hz, *fit in felt))


def virtual_hardness(felt: float | None) -> tuple[float, float]:
    """Return the judged hardness of a virtual surface of this felt height, Hz, and its error, as in `FITTED`.

    Between heights of Table 1 both are linear in the logarithm of the height.
    """
    if felt is None:
        return NOTHING
    heights, hardness, error = _fitted().T
    return float(np.interp(np.log(felt), heights, hardness)), float(np.interp(np.log(felt), heights, error))


def generic(materials: Sequence[str]) -> str:
    """Return a sentence on materials that Table 1 does not have, or on what was fitted to those that it has."""
    strange = [material for material in materials if material not in TABLE_1]
    if not strange:
        return (
            "The SIMULATED participants' judgment of virtual taps is fitted to Table 3 of Wellman and Howe, so "
            "agreement with that table is not evidence. Their judgment of real taps is not fitted."
        )
    return (
        f"Table 1 of Wellman and Howe does not include {', '.join(strange)}, so the simulation of all materials is "
        "generic: it follows their order in the protocol (or a hash, if they have no order) and does not resemble "
        "the real materials."
    )
