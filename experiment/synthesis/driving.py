"""The voltages of a waveform, within the limits of panel and amplifier: equations (1) and (7) of Okamoto et al."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.shaping import Response, Shaped, accelerations, shape
from experiment.synthesis.spectra import bin_frequencies_hz, finite, inverse, spectrum

ROUND_OFF = 16 * float(np.finfo(np.float64).eps)
"""Coefficients below this part of a waveform's peak are round-off of the transform, and no bin that was asked for."""


def drive(
    waveform_m_s2: ArrayLike,
    *,
    rate_hz: int,
    response: Response,
    gain_limit_v_per_m_s2: float,
    limit_m_s2: float = np.inf,
    limit_v: float = np.inf,
) -> tuple[NDArray[np.float64], Shaped]:
    """The voltages whose oscillations move the rig as a waveform asks: (1), then `shape`, then (7).

    Shaping drops what the table does not reach, and a waveform without some of its bins can peak higher than the whole.
    So the limits are held on what the response says the voltages will do: where they pass one, the whole waveform is
    taken down and shaped anew. What is lost is counted against the waveform that was asked for, not the smaller one.

    Args:
        waveform_m_s2: acceleration at the times (i + 1/2) / F, m/s^2, shape (n,).
        rate_hz: sampling rate F of the waveform and of the voltages, Hz.
        response: of the rig.
        gain_limit_v_per_m_s2: as in `shape`.
        limit_m_s2: largest magnitude of the acceleration that the voltages bring about, above zero.
        limit_v: largest magnitude of the voltages, above zero.

    Returns:
        V, shape (n,); and what shaping did. A waveform made by (5) has the spectrum it was made from, to round-off
        (`ROUND_OFF` of its peak), at any output rate whose samples fill the same time.

    Raises:
        SynthesisError: as `shape`, or a limit that is none.
    """
    for name, limit in (("limit_m_s2", limit_m_s2), ("limit_v", limit_v)):
        if not limit > 0:
            raise SynthesisError(
                f"{name}: got {limit}; allowed: a number above 0; correct the protocol or the rig file"
            )
    y = finite(waveform_m_s2, what="waveform")
    coefficients = spectrum(y)
    coefficients[np.abs(coefficients) <= ROUND_OFF * np.abs(y).max()] = 0.0
    f = bin_frequencies_hz(bins=y.size, rate_hz=rate_hz)
    scale = 1.0
    while True:
        shaped = shape(
            coefficients,
            frequencies_hz=f,
            response=response,
            gain_limit_v_per_m_s2=gain_limit_v_per_m_s2,
            scale=scale,
        )
        voltages_v = inverse(shaped.coefficients_v)
        sounding = np.flatnonzero(shaped.coefficients_v)
        moved = np.zeros(y.size)
        if sounding.size:
            voltages = shaped.coefficients_v[sounding]
            moved[sounding] = accelerations(voltages, frequencies_hz=f[sounding], response=response)
        moved_m_s2 = inverse(moved)
        over = max(np.abs(moved_m_s2).max() / limit_m_s2, np.abs(voltages_v).max() / limit_v)
        if over <= 1:
            return voltages_v, shaped
        # A response that is not quite linear may need another round; each takes down by a thousandth at the least.
        scale /= over * 1.001
