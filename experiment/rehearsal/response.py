"""SIMULATED rig response, of the kind that Figure 9 of Okamoto et al. shows; no rig was measured.

The figure has a peak near 360 Hz at 1.0 Vrms, and the text says that acceleration follows the voltage almost linearly
at a fixed frequency. Both hold here by closed form: springs and voice coils pass what lies above `SUSPENSION_HZ`, the
panel resonates at `PANEL_HZ`, and the drive saturates softly,

    A(f, e) = G(f) E asinh(e / E),

2.8 % below its tangent at 1.5 Vrms. The numbers are plausible choices. The simulated panel moves by this form itself,
never by the table, so what shaping makes of the table meets a response that knows nothing of it.
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiment.recordings import response as tables
from experiment.synthesis.rig_response import Response
from experiment.synthesis.spectra import bin_frequencies_hz, inverse, spectrum

SUSPENSION_HZ, SUSPENSION_DAMPING = 35.0, 0.5
PANEL_HZ, PANEL_DAMPING = 360.0, 0.12
GAIN_M_S2_PER_V = 4.0
SOFT_V = 5.0

FREQUENCIES_HZ = (*range(10, 30, 2), *range(30, 605, 5))
"""Where the simulated rig was measured: closer together where the response is steep, relative to itself."""

LEVELS_VRMS = (0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)

COMMENTS = (
    "SIMULATED frequency response of the rehearsal's rig; no rig was measured.",
    "A sinusoid of drive_vrms (V, root mean square) moves the panel by acceleration_pp_m_s2 (m/s^2, peak to peak).",
)


def gain(frequencies_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """G(f), amplitude of acceleration for each volt of amplitude in a small drive, m/s^2/V, shape of the argument."""
    low, high = frequencies_hz / SUSPENSION_HZ, frequencies_hz / PANEL_HZ
    passed = low**2 / np.hypot(1 - low**2, 2 * SUSPENSION_DAMPING * low)
    return np.asarray(GAIN_M_S2_PER_V * passed / np.hypot(1 - high**2, 2 * PANEL_DAMPING * high))


def answered(frequencies_hz: NDArray[np.float64], amplitudes_v: NDArray[np.float64]) -> NDArray[np.float64]:
    """A(f, e), m/s^2, with the sign of e.

    Args:
        frequencies_hz: Hz, broadcast against `amplitudes_v`.
        amplitudes_v: amplitudes of sinusoids, V.
    """
    return np.asarray(gain(frequencies_hz) * SOFT_V * np.arcsinh(amplitudes_v / SOFT_V))


def moved(waveform_v: NDArray[np.float64], *, rate_hz: int) -> NDArray[np.float64]:
    """How the simulated panel moves: each frequency element of the voltage answered on its own.

    Args:
        waveform_v: V, shape (n,).
        rate_hz: its sampling rate, Hz.

    Returns:
        Acceleration, m/s^2, shape (n,).

    Raises:
        SynthesisError: voltages that are not finite.
    """
    coefficients_v = spectrum(waveform_v)
    frequencies_hz = bin_frequencies_hz(bins=coefficients_v.size, rate_hz=rate_hz)
    return inverse(answered(frequencies_hz, coefficients_v))


def measured() -> Response:
    """The response at the frequencies and levels of the shipped table."""
    frequencies_hz, levels_v = np.array(FREQUENCIES_HZ, dtype=np.float64), sqrt(2) * np.array(LEVELS_VRMS)
    return Response(frequencies_hz, levels_v, answered(frequencies_hz[:, None], levels_v))


def write(path: Path) -> None:
    """Write the shipped table: `protocols/rigs/rehearsal-response.csv`."""
    tables.write(path, measured(), comments=COMMENTS)
