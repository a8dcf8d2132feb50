"""SIMULATED surfaces: how each rings when it is tapped, and how high that feels through the skin.

A tap rings as equation (2) of Wellman and Howe, with the frequency that Table 1 prints for the surface. Any other
material is simulated generically: the materials of a study take stiffnesses from the least to the most of Table 1, in
equal ratios, and ring at the frequency that Table 1 has for their stiffness. It resembles nothing.

What reaches the receptors is the vibration behind a low-pass filter. The threshold of the Pacinian channel in
displacement falls by 12 dB an octave up to about 300 Hz (Bolanowski, Gescheider, Verrillo and Checkosky 1988), which is
a constant threshold in acceleration, and rises steeply above; ours is a Butterworth filter of fourth order there. How
high a vibration feels is the mean frequency of the power that passes. So the 4000 Hz of aluminum hardly arrive, and it
feels no higher than plastic: no number of Table 2 is used for that.

Over three seeds the rehearsed choices correlate with Table 2 by 0.90 to 0.96, and with Table 3 by 0.77 to 0.80
(`tests/experiment/rehearsal/tapping/test_observer.py`). No scale of five surfaces reaches more than 0.93 in Table 3,
and none on which 43 and 50 Hz lie as close together as their logarithms more than 0.82: the table has these two told as
well as others an octave apart. What was tried instead, in expectation: filters of order 1 to 4 with corners from 250 to
1000 Hz, 0.69 to 0.81; with the amplitude weighed in, at most 0.81; an error that grows with the distance from the ends
of the range, up to 0.84, and 0.89 once it is larger than that distance, but then 0.75 in Table 2; half of the judgement
by rank among the five (range and frequency, Parducci 1965), 0.86 in both where the filter is so gentle that aluminum
feels highest, and about 0.03 less in one seed, since a cell has 56 answers. So it is left at what the skin passes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from experiment.synthesis.tap import DECAY_PER_S, SURFACES

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


def frequencies_hz(materials: Sequence[str]) -> tuple[float, ...]:
    """Return the frequency at which each material rings, Hz; `materials` stand from the least to the most stiff."""
    if all(material in TABLE_1 for material in materials):
        return tuple(TABLE_1[material][1] for material in materials)
    stiffness, frequency = np.log(np.array(list(TABLE_1.values()))).T
    wanted = np.linspace(stiffness[0], stiffness[-1], len(materials))
    return tuple(np.exp(np.interp(wanted, stiffness, frequency)).tolist())


def rings(frequency_hz: float) -> NDArray[np.float64]:
    """Return a tap with a peak amplitude of 1 before it decays, shape (n,), at `RATE_HZ` (equation (2))."""
    seconds = np.arange(round(RINGS_S * RATE_HZ)) / RATE_HZ
    return np.asarray(np.exp(-DECAY_PER_S * seconds) * np.sin(2 * np.pi * frequency_hz * seconds), np.float64)


def felt_hz(vibration: NDArray[np.float64], rate_hz: int) -> float | None:
    """Return how high an acceleration, shape (n,), feels: the mean frequency of what passes the skin, Hz.

    It does not depend on the amplitude. Return None for silence.
    """
    bins_hz = np.fft.rfftfreq(2 * len(vibration), 1 / rate_hz)
    passed = np.abs(np.fft.rfft(vibration, 2 * len(vibration))) ** 2
    passed /= 1 + (bins_hz / FELT_BELOW_HZ) ** (2 * FILTER_ORDER)
    # The first bin begins at 0 Hz, so it is half as wide as the others.
    passed[0] /= 2
    return float(bins_hz @ passed / passed.sum()) if passed.any() else None


def generic(materials: Sequence[str]) -> str:
    """Return a sentence on materials that Table 1 does not have; nothing if it has them all."""
    strange = [material for material in materials if material not in TABLE_1]
    if not strange:
        return ""
    return (
        f"Table 1 of Wellman and Howe does not have {', '.join(strange)}, so that all materials are simulated "
        "generically, by their order in the protocol: they resemble nothing."
    )
