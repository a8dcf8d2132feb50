"""Band-pruned: only the bins that actuator and skin can pass, by whatever other method.

The error is that of the bins left out, by Parseval sqrt(sum_left_out C'_k(v)^2 / sum_all C'_k(v)^2). Its largest value
over all speeds is found from the measured amplitudes:

- between two measured speeds it is a ratio of two quadratics, whose largest value has a closed form;
- beyond them a rising bin goes on and any other falls at most to zero. So what is left out is at most its rising bins
  on their lines and the others as last measured, and what sounds is at least all rising bins on their lines (and, for
  the relative error of `waveforms.py`, at least the rms last measured). Again a ratio of two quadratics.

What pruning saves is memory for spectra and cosines, and terms of the printed sum. A weighted sum of basis waveforms
and an inverse DCT take as long as before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import copysign, inf, isinf, sqrt

import numpy as np
from numpy.typing import NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from experiment.synthesis.spectra import Grid, bin_frequencies_hz
from experiment.synthesis.waveforms import Estimate, Method, Renderer, rms

SLACK = 1e-9
"""Relative rounding of the share that is left out."""

Quadratic = tuple[float, float, float]
"""(a, b, c) of a + 2 b x + c x^2."""


@dataclass(frozen=True)
class BandPruned:
    """Another method, on the bins of a band.

    Args:
        method: the other.
        band_hz: lowest and highest frequency that count, both included, Hz.
    """

    method: Method
    band_hz: tuple[float, float]

    @property
    def name(self) -> str:
        return f"{self.method.name}, {self.band_hz[0]:g} to {self.band_hz[1]:g} Hz"

    def estimate(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Estimate:
        on = spectra.grid(output_rate_hz)
        inner = self.method.estimate(prune(spectra, band_hz=self.band_hz), output_rate_hz=output_rate_hz)
        share = largest_share(spectra, band_hz=self.band_hz, carried=on.carried)
        first = inner.first_block_error
        return replace(
            inner,
            relative_error=inner.relative_error + left_out_error(spectra, band_hz=self.band_hz, on=on),
            # The bins left out may all peak in one sample: their sum is at most sqrt(2 bins) times their rms.
            first_block_error=None if first is None else first + share * sqrt(2 * on.carried),
            why=f"{inner.why}; and the bins left out are at most {share:.2g} of the rms at any speed, as measured",
        )

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Renderer:
        return self.method.prepare(prune(spectra, band_hz=self.band_hz), output_rate_hz=output_rate_hz)


def prune(spectra: CrinkleSpectra, *, band_hz: tuple[float, float]) -> CrinkleSpectra:
    """Spectra without the bins above a band, and silent below it; those that may be floored stay to be counted.

    Args:
        spectra: of one material.
        band_hz: lowest and highest frequency that count, both included, Hz.

    Raises:
        SynthesisError: a band that is none.
    """
    within = _within(spectra, band_hz)
    bins = int(np.flatnonzero(within)[-1]) + 1 if within.any() else 1
    falls = np.minimum(spectra.amplitudes[0] - spectra.amplitudes[1], spectra.amplitudes[-1] - spectra.amplitudes[-2])
    left_out = spectra.amplitudes[:, ~within & (falls < 0)]
    return CrinkleSpectra(
        speeds_mm_s=spectra.speeds_mm_s,
        rate_hz=spectra.rate_hz,
        amplitudes=np.where(within[:bins], spectra.amplitudes[:, :bins], 0.0),
        signs=spectra.signs[:, :bins].copy(),
        recorded=spectra.samples,
        left_out=left_out if left_out.size else None,
    )


def largest_share(spectra: CrinkleSpectra, *, band_hz: tuple[float, float], carried: int) -> float:
    """Largest rms of what a band leaves out, as a part of the rms of all (see the module), over all speeds.

    Args:
        spectra: of one material.
        band_hz: lowest and highest frequency that count, both included, Hz.
        carried: bins that the output rate carries; bin 0 and those from here on sound neither way.

    Raises:
        SynthesisError: a band that is none.
    """
    left_out = ~_within(spectra, band_hz)[1:carried]
    levels = spectra.amplitudes[:, 1:carried]
    if not left_out.any():
        return 0.0
    speeds = spectra.speeds_mm_s
    shares = [_between(a, b, left_out) for a, b in pairwise(levels)]
    shares.append(_beyond(levels[0], levels[1], left_out, float(speeds[0] / (speeds[1] - speeds[0]))))
    shares.append(_beyond(levels[-1], levels[-2], left_out, inf))
    return min(sqrt(max(shares)) * (1 + SLACK), 1.0)


def left_out_error(spectra: CrinkleSpectra, *, band_hz: tuple[float, float], on: Grid) -> float:
    """What leaving out the bins outside a band adds to a relative error, at any speed; arguments as above."""
    return largest_share(spectra, band_hz=band_hz, carried=on.carried) * sqrt(on.p / on.count)


def loudest_outside(spectra: CrinkleSpectra, *, band_hz: tuple[float, float], fastest_mm_s: float) -> float:
    """Largest rms of all that lies outside a band together, at any speed up to `fastest_mm_s`, m/s^2.

    All together, for skin does not feel bins: how much of a vibration falls into one bin depends on the length of the
    take. The rms of the whole does not, as long as the material sounds throughout; and no third octave, nor any other
    part, has more. Rms, for so thresholds of vibration are stated.

    Each bin is convex in speed from one measured speed to the next, and beyond them with the floor, and so is their
    rms: it is largest at a measured speed, at 0 mm/s, or at the fastest.

    Args:
        spectra: of one material.
        band_hz: lowest and highest frequency that count, both included, Hz.
        fastest_mm_s: fastest speed of a foot, mm/s.

    Raises:
        SynthesisError: a band that is none, or a speed at which there is no spectrum.
    """
    outside = ~_within(spectra, band_hz)
    measured = spectra.amplitudes[spectra.speeds_mm_s <= fastest_mm_s]
    ends = [np.abs(at_speed(spectra, speed_mm_s=v).coefficients) for v in (0.0, fastest_mm_s)]
    # On the recordings' own grid, which carries every bin.
    return float(rms(np.vstack([measured, *ends]) * outside, spectra.grid(spectra.rate_hz)).max())


def _within(spectra: CrinkleSpectra, band_hz: tuple[float, float]) -> NDArray[np.bool_]:
    low_hz, high_hz = band_hz
    if not 0 <= low_hz < high_hz:
        raise SynthesisError(f"band_hz: got {low_hz} to {high_hz}; allowed: two rising frequencies; correct the band")
    f = bin_frequencies_hz(bins=spectra.samples, rate_hz=spectra.rate_hz)[: spectra.amplitudes.shape[1]]
    return np.asarray((f >= low_hz) & (f <= high_hz))


def _between(a: NDArray[np.float64], b: NDArray[np.float64], left_out: NDArray[np.bool_]) -> float:
    """Largest share, squared, of a + x b over all x >= 0: of any mixture of two neighbouring spectra."""
    a, b = _unit(a), _unit(b)
    return _largest(_quadratic(a[left_out], b[left_out]), _quadratic(a, b), 0.0, inf)


def _beyond(
    nearest: NDArray[np.float64], other: NDArray[np.float64], left_out: NDArray[np.bool_], most: float
) -> float:
    """Largest share, squared, up to `most` gaps of speed beyond the nearest of the measured ones."""
    rise = np.maximum(nearest - other, 0.0)
    size, rise_size = float(nearest.max()), float(rise.max())
    if size == 0:
        return 0.0
    a, b = nearest / size, _unit(rise) if rise_size else rise
    # In units of x = steps * |rise| / |nearest|, both spectra are of the size of 1.
    reach = float(np.linalg.norm(rise / rise_size)) * (rise_size / size) * most if rise_size and most else 0.0
    sounding = np.where(b > 0, a, 0.0)
    part, lines = _quadratic(a[left_out], b[left_out]), _quadratic(sounding, b)
    last = float(a @ a)
    short = last - lines[0]
    overtakes = short / (lines[1] + sqrt(lines[1] ** 2 + lines[2] * short)) if rise_size and short > 0 else 0.0
    if not rise_size or overtakes >= reach:
        return _value(part, (last, 0.0, 0.0), reach)
    return _largest(part, lines, overtakes, reach)


def _unit(amplitudes: NDArray[np.float64]) -> NDArray[np.float64]:
    largest = amplitudes.max()
    if largest == 0:
        return amplitudes
    relative = amplitudes / largest
    return np.asarray(relative / np.linalg.norm(relative))


def _quadratic(a: NDArray[np.float64], b: NDArray[np.float64]) -> Quadratic:
    """|a + x b|^2."""
    return float(a @ a), float(a @ b), float(b @ b)


def _value(part: Quadratic, whole: Quadratic, x: float) -> float:
    if isinf(x):
        return part[2] / whole[2] if whole[2] else 0.0
    divisor = whole[0] + 2 * whole[1] * x + whole[2] * x * x
    return (part[0] + 2 * part[1] * x + part[2] * x * x) / divisor if divisor else 0.0


def _largest(part: Quadratic, whole: Quadratic, low: float, high: float) -> float:
    """Largest value of part / whole on [low, high], at an end or where its derivative is zero."""
    (pa, pb, pc), (wa, wb, wc) = part, whole
    a, b, c = pc * wb - pb * wc, pc * wa - pa * wc, pb * wa - pa * wb
    q = -(b + copysign(sqrt(max(b * b - 4 * a * c, 0.0)), b)) / 2
    turns = [top / bottom for top, bottom in ((q, a), (c, q)) if bottom]
    return max(_value(part, whole, x) for x in (low, high, *(x for x in turns if low < x < high)))
