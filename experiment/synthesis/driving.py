"""The voltages of a waveform, within the limits of panel and amplifier: equations (1) and (7) of Okamoto et al."""

from __future__ import annotations

from functools import lru_cache
from math import inf, isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.rig_response import AtBins, Response, at_bins
from experiment.synthesis.shaping import Shaped, shape_at
from experiment.synthesis.spectra import Bins, bin_frequencies_hz, finite, grid, inverse_on, spectrum

ROUND_OFF = 16 * float(np.finfo(np.float64).eps)
"""Coefficients below this part of a waveform's peak are round-off of the transform, and no bin that was asked for."""


def bins_of_waveform(waveform_m_s2: ArrayLike, *, rate_hz: int) -> Bins:
    """What a waveform is the sum of, by (1).

    Args:
        waveform_m_s2: acceleration at the times (i + 1/2) / F, m/s^2, shape (n,).
        rate_hz: its sampling rate F, Hz.

    Returns:
        Its own n bins. A waveform made by (5) has the spectrum it was made from, to round-off (`ROUND_OFF` of its
        peak), at any output rate whose samples fill the same time.

    Raises:
        SynthesisError: a waveform that is not finite.
    """
    y = finite(waveform_m_s2, what="waveform")
    coefficients = spectrum(y)
    coefficients[np.abs(coefficients) <= ROUND_OFF * np.abs(y).max()] = 0.0
    return Bins(coefficients, samples=y.size, rate_hz=rate_hz)


def drive(
    bins: Bins,
    *,
    rate_hz: int,
    response: Response,
    gain_limit_v_per_m_s2: float,
    limit_m_s2: float = inf,
    limit_v: float = inf,
    scale: float = 1.0,
) -> tuple[NDArray[np.float64], Shaped]:
    """The voltages whose oscillations move the rig as a sum of bins asks: `shape`, then (7).

    Shaping drops what the table does not reach, and a waveform without some of its bins can peak higher than the whole.
    So the limits are held on what the response says the voltages will do: where they pass one, all of it is taken down
    and shaped anew. What is lost is counted against what was asked for, not against the smaller one.

    Args:
        bins: what is asked for; the one at 0 Hz is no oscillation.
        rate_hz: sampling rate of the voltages, Hz.
        response: of the rig.
        gain_limit_v_per_m_s2: as in `shape`.
        limit_m_s2: no magnitude of the acceleration that the voltages bring about is larger, at whatever time, above
            zero. The least waveform that is taken down lies as much below it as `highest` is too high.
        limit_v: no voltage is larger in magnitude, above zero.
        scale: as in `shape`; it is lowered further where it has to be.

    Returns:
        V, shape (n,), n being the samples of a waveform made of the bins by (5); and what shaping did.

    Raises:
        SynthesisError: as `shape`, `grid` or `inverse_on`, or a limit that is none.
    """
    for name, limit in (("limit_m_s2", limit_m_s2), ("limit_v", limit_v)):
        if not limit > 0:
            raise SynthesisError(
                f"{name}: got {limit}; allowed: a number above 0; correct the protocol or the rig file"
            )
    on = grid(samples=bins.samples, bins=bins.coefficients.size, rate_hz=bins.rate_hz, output_rate_hz=rate_hz)
    coefficients = finite(bins.coefficients, what="bins")[: on.carried].copy()
    coefficients[0] = 0.0
    at = response_at(response, bins.samples, bins.rate_hz, on.carried)
    # With what rounding may add.
    rounded = 1 + 2 * ROUND_OFF * on.count
    before: tuple[Shaped, float] | None = None
    while True:
        shaped = shape_at(coefficients, at, gain_limit_v_per_m_s2=gain_limit_v_per_m_s2, scale=scale)
        moved_m_s2 = _moved_m_s2(shaped, before, limit_m_s2 / rounded)
        over = moved_m_s2 * rounded / limit_m_s2
        if over <= 1:
            voltages_v = inverse_on(shaped.coefficients_v, on)
            over = float(np.maximum(voltages_v.max(), -voltages_v.min())) / limit_v
            if over <= 1:
                return voltages_v, shaped
        # A response that is not quite linear may need another round; each takes down by a thousandth at the least.
        scale, before = scale / (over * 1.001), (shaped, moved_m_s2)


def _moved_m_s2(shaped: Shaped, before: tuple[Shaped, float] | None, limit_m_s2: float) -> float:
    """What no magnitude of the acceleration passes: the first bound that is within the limit, the cheapest first.

    Args:
        shaped: what is driven.
        before: the round before, where more was asked, and what this function returned for it. Bins that nothing holds
            back go down in proportion, and the others by less.
        limit_m_s2: of the acceleration.
    """
    with np.errstate(over="ignore"):
        bound_m_s2 = float(np.abs(shaped.reached_m_s2).sum())
    if bound_m_s2 > limit_m_s2 and before is not None:
        more, moved_m_s2 = before
        part = shaped.scale / more.scale
        bound_m_s2 = part * moved_m_s2 + float(np.abs(part * more.reached_m_s2 - shaped.reached_m_s2).sum())
    return bound_m_s2 if bound_m_s2 <= limit_m_s2 and isfinite(bound_m_s2) else shaped.peak_m_s2


@lru_cache(maxsize=4)
def response_at(response: Response, samples: int, rate_hz: int, bins: int) -> AtBins:
    """A response at the first bins of recordings of so many samples; looked up once for all their spectra."""
    return at_bins(response, bin_frequencies_hz(bins=samples, rate_hz=rate_hz)[:bins])
