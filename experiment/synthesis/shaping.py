"""Frequency shaping: the voltages that move a rig as a spectrum asks, equation (7) of Okamoto et al. and section 4.

A rig answers a sinusoid of e volts at f with one of A(f, e) m/s^2, measured at some frequencies and levels: its
`Response`. Between the nearest measured values A is linear, first in f at each level, then in e, from 0 at 0 V. W(f, a)
is the inverse of A in e: exact at measured points, and rising with a at every f, unlike cubics, which may cross. The
error across a resonance is about h^2 / 8 |A''| / A between frequencies h apart.

What the rig cannot do is left out and counted, each bin once, under what limited it last:

- outside: bins below the lowest or above the highest measured frequency get no voltage;
- bounded: bins that would take more volts per m/s^2 than the rig's stated limit, near nulls, get that limit;
- saturated: bins above what the highest level reaches get the highest level.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.spectra import Bins, bin_frequencies_hz, finite, grid, highest, inverse_on


@dataclass(frozen=True, eq=False)
class Response:
    """A measured frequency response.

    `frequencies_hz` rise strictly from zero or more, shape (F,), F >= 2; `levels_v` are amplitudes (sqrt 2 times the
    rms), strictly rising, above zero, shape (L,). `accelerations_m_s2`, shape (F, L), are amplitudes (half the
    peak-to-peak), at each frequency strictly rising from above zero, or all zero (a null). Raises `SynthesisError`
    otherwise.
    """

    frequencies_hz: NDArray[np.float64]
    levels_v: NDArray[np.float64]
    accelerations_m_s2: NDArray[np.float64]

    def __post_init__(self) -> None:
        f = finite(self.frequencies_hz, what="frequencies_hz of the response")
        levels = finite(self.levels_v, what="levels_v of the response")
        a = finite(self.accelerations_m_s2, what="accelerations_m_s2 of the response")
        if f.ndim != 1 or f.size < 2 or f[0] < 0 or np.any(np.diff(f) <= 0):
            raise SynthesisError(
                f"frequencies_hz of the response: got {_few(f)}; allowed: two or more, strictly rising, 0 or above; "
                "sort the table"
            )
        if levels.ndim != 1 or levels[0] <= 0 or np.any(np.diff(levels) <= 0):
            raise SynthesisError(
                f"levels_v of the response: got {_few(levels)}; allowed: strictly rising, above 0; sort the table"
            )
        if a.shape != (f.size, levels.size):
            raise SynthesisError(
                f"accelerations_m_s2 of the response: got shape {a.shape}; allowed: {(f.size, levels.size)}, one value "
                "for each frequency and level; measure what is missing"
            )
        place = not_rising(a)
        if place is not None:
            i, j = place
            raise SynthesisError(
                f"accelerations_m_s2 of the response: got {a[i, j]:g} at {f[i]:g} Hz and {levels[j]:g} V after "
                f"{a[i, j - 1] if j else 0.0:g}; allowed: strictly rising with the level, because otherwise there "
                "is no inverse; measure that frequency again"
            )


def not_rising(accelerations_m_s2: NDArray[np.float64]) -> tuple[int, int] | None:
    """Return the first (row, column) where a response, shape (F, L), does not rise strictly from above zero, if any.

    Rows of zeros are nulls and allowed. Raises `SynthesisError` if a value is not finite.
    """
    a = finite(accelerations_m_s2, what="accelerations_m_s2 of the response")
    before = np.insert(a[:, :-1], 0, 0.0, axis=1)
    wrong = np.argwhere((a <= before) & np.any(a != 0, axis=1, keepdims=True))
    return (int(wrong[0, 0]), int(wrong[0, 1])) if wrong.size else None


@dataclass(frozen=True)
class AtBins:
    """What a response says of the `known` bins, K of N, within its table.

    `levels_v` are 0 V and each level, shape (1 + L,), and `curves` A(f, e) at these, shape (1 + L, K).
    """

    known: NDArray[np.intp] | slice
    levels_v: NDArray[np.float64]
    curves: NDArray[np.float64]

    def voltages_v(self, amplitudes_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return W(f, a) of each known bin, at most the highest level; both of shape (K,), and none below 0."""
        segment = (self.curves[1:-1] < amplitudes_m_s2).sum(axis=0)
        return _interpolated(amplitudes_m_s2, *self._ends(segment, slice(None)), *self._levels(segment))

    def amplitudes_m_s2(
        self, voltages_v: NDArray[np.float64], some: NDArray[np.intp] | slice = slice(None)
    ) -> NDArray[np.float64]:
        """Return A(f, e) of some of the known bins, all by default; one voltage and amplitude a bin, none below 0."""
        segment = np.searchsorted(self.levels_v[1:-1], voltages_v)
        return _interpolated(voltages_v, *self._levels(segment), *self._ends(segment, some))

    def _ends(
        self, segment: NDArray[np.intp], some: NDArray[np.intp] | slice
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the amplitudes at both ends of a segment of some bins' curves."""
        at = segment * self.curves.shape[1] + np.arange(self.curves.shape[1])[some]
        return self.curves.take(at), self.curves.take(at + self.curves.shape[1])

    def _levels(self, segment: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.levels_v.take(segment), self.levels_v.take(segment + 1)


def at_bins(response: Response, frequencies_hz: NDArray[np.float64]) -> AtBins:
    """Return a rig's response at the bins' frequencies, Hz, shape (N,); 0 Hz is unknown. Raises `SynthesisError`."""
    f, at = finite(frequencies_hz, what="frequencies_hz"), response.frequencies_hz
    within = (f >= at[0]) & (f <= at[-1]) & (f > 0)
    known = np.flatnonzero(within)
    f = f[known]
    i = np.clip(np.searchsorted(at, f, side="right") - 1, 0, at.size - 2)
    part = ((f - at[i]) / (at[i + 1] - at[i]))[:, None]
    curves = np.zeros((1 + response.levels_v.size, f.size))
    curves[1:] = ((1 - part) * response.accelerations_m_s2[i] + part * response.accelerations_m_s2[i + 1]).T
    one_run = known.size and known[-1] - known[0] == known.size - 1
    return AtBins(
        known=slice(int(known[0]), int(known[-1]) + 1) if one_run else known,
        levels_v=np.concatenate([[0.0], response.levels_v]),
        curves=curves,
    )


@dataclass(frozen=True)
class Loss:
    """Bins that one cause kept below what was asked for: how many, and the sum of what they fell short, m/s^2."""

    bins: int
    cost_m_s2: float


@dataclass(frozen=True)
class Shaped:
    """Voltages for a spectrum.

    `coefficients_v` are W(f_k, |C_k|), V, and `reached_m_s2` the acceleration by the response, m/s^2, both with the
    sign of C_k, (N,). Losses are of bins above the highest level (`saturated`), beyond the measured frequencies
    (`outside`) or limited in gain (`bounded`); what the factor `scale`, applied before, takes from others is in none.
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


def shape_at(
    coefficients: NDArray[np.float64], at: AtBins, *, gain_limit_v_per_m_s2: float, scale: float = 1.0
) -> Shaped:
    """Return what `shape` returns, at bins where the response has been looked up."""
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
"""What a transform may add to a magnitude, as a part of it; twice that, for each sample, is kept from the limits."""


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
    """Return voltages whose oscillations move the rig as a sum of bins asks, and what shaping did: `shape`, then (7).

    A waveform without some of its bins can peak higher, so the limits apply to the response to the voltages: above one,
    all is scaled down and shaped again. Losses are counted against the original request.

    The voltages, V, at `rate_hz`, have the shape (n,) of a waveform by (5). At no time is the acceleration above
    `limit_m_s2` in magnitude (waveforms are scaled down from as far below it as `highest` is too high), nor a voltage
    above `limit_v`. `scale`, as in `shape`, is lowered as needed. Raises `SynthesisError` as `shape`, `grid` or
    `inverse_on`, or for a limit that is not above zero.
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
    """Return a bound on the acceleration's magnitude: the first within the limit, the cheapest first.

    `before` is the larger request before and its bound; since then free bins shrank in proportion, the others by less.
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
    """Return a response at the first bins of recordings of so many samples, looked up once for all their spectra."""
    return at_bins(response, bin_frequencies_hz(bins=samples, rate_hz=rate_hz)[:bins])


def _interpolated(
    x: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return straight lines from (`low`, `start`) to (`high`, `end`) at `x`, `end` beyond `high`; all of shape (N,)."""
    part = np.divide(np.minimum(x, high) - low, high - low, out=np.ones_like(x), where=high > low)
    between: NDArray[np.float64] = np.minimum(start + (end - start) * part, end)
    return between


def _few(values: NDArray[np.float64]) -> str:
    text = str(values.tolist())
    return text if len(text) <= 80 else f"{text[:77]}..."
