"""The voltages of a waveform, within the limits of panel and amplifier: equations (1) and (7) of Okamoto et al."""

from __future__ import annotations

from functools import lru_cache
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.rig_response import AtBins, Response, accelerations_at, at_bins
from experiment.synthesis.shaping import Shaped, shape_at
from experiment.synthesis.spectra import Bins, bin_frequencies_hz, finite, grid, inverse_on, spectrum

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
    bins: Bins | None = None,
) -> tuple[NDArray[np.float64], Shaped]:
    """The voltages whose oscillations move the rig as a waveform asks: (1), then `shape`, then (7).

    Shaping drops what the table does not reach, and a waveform without some of its bins can peak higher than the whole.
    So the limits are held on what the response says the voltages will do: where they pass one, the whole waveform is
    taken down and shaped anew. What is lost is counted against the waveform that was asked for, not the smaller one.
    No sample of that acceleration is larger than the waveform's peak and all that shaping left out together; only where
    this sum passes the limit is the acceleration itself computed.

    Args:
        waveform_m_s2: acceleration at the times (i + 1/2) / F, m/s^2, shape (n,).
        rate_hz: sampling rate F of the waveform and of the voltages, Hz.
        response: of the rig.
        gain_limit_v_per_m_s2: as in `shape`.
        limit_m_s2: largest magnitude of the acceleration that the voltages bring about, above zero.
        limit_v: largest magnitude of the voltages, above zero.
        bins: what the waveform is the sum of, where that is known: it saves (1), and most of the time.

    Returns:
        V, shape (n,); and what shaping did. A waveform made by (5) has the spectrum it was made from, to round-off
        (`ROUND_OFF` of its peak), at any output rate whose samples fill the same time.

    Raises:
        SynthesisError: as `shape`, a limit that is none, or bins of another waveform.
    """
    for name, limit in (("limit_m_s2", limit_m_s2), ("limit_v", limit_v)):
        if not limit > 0:
            raise SynthesisError(
                f"{name}: got {limit}; allowed: a number above 0; correct the protocol or the rig file"
            )
    y = finite(waveform_m_s2, what="waveform")
    peak_m_s2 = max(float(y.max()), -float(y.min()))
    if bins is None:
        coefficients = spectrum(y)
        coefficients[np.abs(coefficients) <= ROUND_OFF * peak_m_s2] = 0.0
        bins = Bins(coefficients, samples=y.size, rate_hz=rate_hz)
    else:
        coefficients = finite(bins.coefficients, what="bins").copy()
        coefficients[0] = 0.0  # (5) leaves it out of the waveform
    on = grid(samples=bins.samples, bins=bins.coefficients.size, rate_hz=bins.rate_hz, output_rate_hz=rate_hz)
    if on.count != y.size:
        raise SynthesisError(
            f"bins: got those of {on.count} samples at {rate_hz} Hz for a waveform of {y.size}; "
            "allowed: the bins that the waveform was made of; pass none"
        )
    coefficients = coefficients[: on.carried]
    at = _at_bins_of(response, bins.samples, bins.rate_hz, on.carried)
    # With what rounding may add, and the coefficients that were taken for round-off.
    rounded = 1 + 2 * ROUND_OFF * y.size
    scale = 1.0
    while True:
        shaped = shape_at(coefficients, at, gain_limit_v_per_m_s2=gain_limit_v_per_m_s2, scale=scale)
        voltages_v = inverse_on(shaped.coefficients_v, on)
        with np.errstate(over="ignore"):
            moved_m_s2 = (scale * peak_m_s2 + sum(loss.cost_m_s2 for loss in shaped.losses)) * rounded
        if moved_m_s2 > limit_m_s2 or not isfinite(moved_m_s2):
            moved_m_s2 = float(np.abs(inverse_on(accelerations_at(shaped.coefficients_v, at), on)).max())
        over = max(moved_m_s2 / limit_m_s2, np.abs(voltages_v).max() / limit_v)
        if over <= 1:
            return voltages_v, shaped
        # A response that is not quite linear may need another round; each takes down by a thousandth at the least.
        scale /= over * 1.001


@lru_cache(maxsize=4)
def _at_bins_of(response: Response, samples: int, rate_hz: int, bins: int) -> AtBins:
    """A response at the first bins of recordings."""
    return at_bins(response, bin_frequencies_hz(bins=samples, rate_hz=rate_hz)[:bins])
