"""Frequency shaping: the voltages that move a rig as a spectrum asks, equation (7) of Okamoto et al. and section 4.

A rig answers a sinusoid of amplitude e volts at f with a sinusoid of amplitude A(f, e) m/s^2, measured at some
frequencies and drive levels. W(f, a) is the inverse of A in e. Between the nearest measured values A follows straight
lines (rig_response.py). So the inverse is exact at the measured points, undoes A everywhere, and rises with a at every
f, which no smoother interpolation in f promises: cubics through two neighbouring levels may cross.

The price is the error of straight lines across a resonance: about h^2 / 8 |A''| / A between frequencies h apart.

What the rig cannot do is left out, counted, and added up as amplitudes that were asked for and not reached:

- outside: bins below the lowest or above the highest measured frequency get no voltage, for nothing is known there;
- bounded: bins that would take more volts per m/s^2 than the rig's stated limit, near nulls, get that limit;
- saturated: bins above what the highest level reaches get the highest level.

Each bin counts once, under what limited it last.

The voltages of a waveform, within the limits of panel and amplifier: equations (1) and (7) of Okamoto et al.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import inf, isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.response import AtBins, Response, at_bins, bins_of
from experiment.synthesis.spectra import Bins, bin_frequencies_hz, finite, grid, highest, inverse_on, spectrum


@dataclass(frozen=True)
class Loss:
    """Bins that one cause kept below what was asked for.

    Attributes:
        bins: how many.
        cost_m_s2: sum over them of the amplitude asked for minus the one reached, m/s^2.
    """

    bins: int
    cost_m_s2: float


@dataclass(frozen=True)
class Shaped:
    """Voltages for a spectrum.

    Attributes:
        coefficients_v: W(f_k, |C_k|) with the sign of C_k, V, shape (N,).
        reached_m_s2: what the response says these bring about, with the same sign, m/s^2, shape (N,).
        saturated: bins that ask for more than the highest level reaches.
        outside: bins beyond the measured frequencies.
        bounded: bins that the limit of the gain holds back.
        scale: factor by which the whole spectrum was taken down before; what that takes from a bin that nothing else
            held back is in no loss.
    """

    coefficients_v: NDArray[np.float64]
    reached_m_s2: NDArray[np.float64]
    saturated: Loss
    outside: Loss
    bounded: Loss
    scale: float = 1.0

    @cached_property
    def peak_m_s2(self) -> float:
        """No sample of the acceleration is larger in magnitude, at whatever rate: `highest` of `reached_m_s2`."""
        return highest(self.reached_m_s2)

    @property
    def losses(self) -> tuple[Loss, Loss, Loss]:
        """By cause."""
        return self.saturated, self.outside, self.bounded


def shape(
    coefficients: ArrayLike,
    *,
    frequencies_hz: ArrayLike,
    response: Response,
    gain_limit_v_per_m_s2: float,
    scale: float = 1.0,
) -> Shaped:
    """Weight each bin of a spectrum by W(f, a), the inverse of the measured response.

    Bin k = 0 is no oscillation; (5) and (7) leave it out, and so does this where the table reaches to 0 Hz.

    Args:
        coefficients: C_k with its sign, m/s^2, shape (N,).
        frequencies_hz: of each bin, Hz, shape (N,).
        response: of the rig.
        gain_limit_v_per_m_s2: largest voltage that any bin may take for each m/s^2 it asks for, above zero.
        scale: of the spectrum that voltages are found for, above 0, at most 1. Losses count what `coefficients` ask.

    Raises:
        SynthesisError: values that are not finite, shapes that do not fit, or a limit or a scale that is none.

    Source: Okamoto et al., section 4, 'Frequency shaping', and equation (7).
    """
    signed, f = bins_of(coefficients, frequencies_hz, what="coefficients")
    at = at_bins(response, f)
    return shape_at(signed, at, gain_limit_v_per_m_s2=gain_limit_v_per_m_s2, scale=scale)


def shape_at(
    coefficients: NDArray[np.float64], at: AtBins, *, gain_limit_v_per_m_s2: float, scale: float = 1.0
) -> Shaped:
    """As `shape`, at bins where the response has been looked up."""
    if not (np.isfinite(gain_limit_v_per_m_s2) and gain_limit_v_per_m_s2 > 0):
        raise SynthesisError(
            f"gain_limit_v_per_m_s2: got {gain_limit_v_per_m_s2}; allowed: a finite number above 0; "
            "correct the rig file"
        )
    if not 0 < scale <= 1:
        raise SynthesisError(f"scale: got {scale}; allowed: above 0, at most 1; leave it out")
    wanted = np.abs(finite(coefficients, what="coefficients"))
    inside, outside = wanted[at.known].copy(), wanted
    outside[at.known] = 0.0
    a = scale * inside
    free_v = at.voltages_v(a)
    with np.errstate(over="ignore"):
        bound_v = a * gain_limit_v_per_m_s2
    volts = np.minimum(free_v, bound_v)
    bounded = (bound_v < free_v) & (a > 0)
    saturated = ~bounded & (a > at.curves[-1])
    moved = a
    held = np.flatnonzero(bounded | saturated)
    if held.size:
        moved[held] = at.amplitudes_m_s2(volts[held], held)
    short = np.maximum(inside[held] - moved[held], 0.0)
    shaped, reached = np.zeros_like(coefficients), np.zeros_like(coefficients)
    shaped[at.known] = np.copysign(volts, coefficients[at.known])
    reached[at.known] = np.copysign(moved, coefficients[at.known])
    return Shaped(
        coefficients_v=shaped,
        reached_m_s2=reached,
        saturated=_loss(short[saturated[held]]),
        outside=_loss(outside[outside > 0]),
        bounded=_loss(short[bounded[held]]),
        scale=scale,
    )


def _loss(short_m_s2: NDArray[np.float64]) -> Loss:
    if not short_m_s2.size:
        return Loss(bins=0, cost_m_s2=0.0)
    with np.errstate(over="ignore"):
        return Loss(bins=short_m_s2.size, cost_m_s2=float(short_m_s2.sum()))


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
