"""Basis waveforms: between measured speeds equations (3) and (4) make a weighted sum of two waveforms.

C'(v) = s_j ((v_i+1 - v) C'(v_i) + (v - v_i) C'(v_i+1)) / (v_i+1 - v_i), and the signs s_j of the nearer speed are those
of v_i in the lower half of an interval and those of v_i+1 in the upper. So two waveforms for each half of each interval
are summed beforehand, 3 S - 2 of them for S speeds, and a step costs two products and a sum.

Beyond the measured speeds the same holds, as long as no bin is floored and the two terms, of opposite sign, stay within
`CANCELLATION` times the vibration at the nearest measured speed. The speeds between which both hold are found
beforehand, and outside them the inverse DCT takes over: one floored bin is one cosine too many in every sample.

No cheaper way past the first floored bin was found that stays small. The sums of `first_block.py`, for 24,000 samples
instead of 64, would take 30 MB a side and material, and then up to 31 cosines a sample. Taking each fallen bin's cosine
out of the weighted sum costs some 30 us a bin, a quarter of the inverse DCT; and of a simulated material's 2,500 bins
up to 13 are floored 10 mm/s beyond the fastest recording, 17 to 34 at 50 mm/s beyond, and 60 to 90 at 100 mm/s.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiment.synthesis.crinkle import CrinkleSpectra, Synthesised, foot_speed, synthesise
from experiment.synthesis.methods import LEAST, ROUNDING, Estimate, held_bytes, rms, transform_error
from experiment.synthesis.spectra import inverse_on

CANCELLATION = 8.0
"""Largest sum of the two terms' rms in extrapolation, as a multiple of the rms at the nearest measured speed."""

MARGIN = 1e-9
"""How far before the first bin falls to zero, as a part of the way there, the inverse DCT takes over."""


@dataclass(frozen=True, slots=True)
class Weights:
    """How a speed weights the basis: `lower` times the first waveform of a pair and `upper` times the second.

    Attributes:
        interval: i, of the measured speeds v_i and v_i+1.
        sign: 0 for the signs of v_i, 1 for those of v_i+1.
        lower: (v_i+1 - v) / (v_i+1 - v_i).
        upper: (v - v_i) / (v_i+1 - v_i).
        extrapolated: whether v lies outside the measured speeds.
    """

    interval: int
    sign: int
    lower: float
    upper: float
    extrapolated: bool


@dataclass(frozen=True)
class Basis:
    """Precomputed basis waveforms.

    Args:
        single: hold and weight them in single precision, in half the memory.
    """

    single: bool = False

    @property
    def name(self) -> str:
        return "single precision" if self.single else "basis waveforms"

    def estimate(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Estimate:
        on = spectra.grid(output_rate_hz)
        kind = np.float32 if self.single else np.float64
        roundings = 4 * float(np.finfo(kind).eps) / 2 * sqrt(on.p / on.count)
        return Estimate(
            relative_error=CANCELLATION * (roundings + 4 * ROUNDING + transform_error(on)),
            why=f"each waveform is an inverse DCT, rounded four times in {np.dtype(kind)}; two terms of one sign "
            f"between measured speeds; beyond them at most {CANCELLATION:g} times the rms at the nearest, "
            "or else the inverse DCT",
            memory_bytes=held_bytes(spectra) + (3 * spectra.speeds_mm_s.size - 2) * on.count * np.dtype(kind).itemsize,
        )

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> BasisRenderer:
        on = spectra.grid(output_rate_hz)
        levels = rms(spectra.amplitudes, on)
        scales = np.ones(len(levels))
        amplitudes = spectra.amplitudes[:, : on.carried].copy()
        amplitudes[:, 0] = 0.0  # it sounds in no waveform, and may be larger than what does
        if self.single:
            largest = amplitudes.max(axis=1)
            # Of silence the least: a larger one would outweigh the waveform of a quiet neighbour.
            scales = np.where(largest > 0, np.ldexp(1.0, np.frexp(largest)[1] - 1), LEAST)

        @cache
        def waveform(at: int, sign: int) -> NDArray[Any]:
            samples = inverse_on(amplitudes[at] / scales[at] * spectra.signs[sign, : on.carried], on)
            return samples.astype(np.float32 if self.single else np.float64)

        lowest, highest = _holds_between(spectra, levels)
        return BasisRenderer(
            spectra=spectra,
            output_rate_hz=output_rate_hz,
            single=self.single,
            dropped_bins=spectra.amplitudes.shape[1] - on.carried,
            speeds_mm_s=tuple(spectra.speeds_mm_s.tolist()),
            lowest_mm_s=lowest,
            highest_mm_s=highest,
            pairs=tuple(
                tuple((waveform(i, sign), waveform(i + 1, sign)) for sign in (i, i + 1)) for i in range(len(levels) - 1)
            ),
            scales=tuple(scales.tolist()),
        )


@dataclass(frozen=True)
class BasisRenderer:
    """Implements `Renderer`.

    Attributes:
        spectra: of the material.
        output_rate_hz: samples a second.
        single: whether `pairs` are held in single precision.
        dropped_bins: bins that the output rate cannot carry.
        speeds_mm_s: v_i.
        lowest_mm_s: the slowest speed at which the weighted sum holds, mm/s.
        highest_mm_s: the fastest, mm/s.
        pairs: for each interval and each sign (of v_i, of v_i+1) the waveforms of C'(v_i) and C'(v_i+1), each divided
            by its scale.
        scales: a power of two for each speed: 1 in double precision, in single precision the size of its amplitudes.
    """

    spectra: CrinkleSpectra
    output_rate_hz: int
    single: bool
    dropped_bins: int
    speeds_mm_s: tuple[float, ...]
    lowest_mm_s: float
    highest_mm_s: float
    pairs: tuple[tuple[tuple[NDArray[Any], NDArray[Any]], ...], ...]
    scales: tuple[float, ...]

    def weights(self, speed_mm_s: float) -> Weights | None:
        """Where a speed lies among the measured ones; None where the weighted sum does not hold.

        Args:
            speed_mm_s: foot speed, mm/s, zero or more.

        Raises:
            SynthesisError: a speed that is negative or not finite.
        """
        v, speeds = foot_speed(speed_mm_s), self.speeds_mm_s
        if not self.lowest_mm_s <= v <= self.highest_mm_s:
            return None
        i = min(max(bisect_right(speeds, v) - 1, 0), len(speeds) - 2)
        below, above, gap = v - speeds[i], speeds[i + 1] - v, speeds[i + 1] - speeds[i]
        return Weights(i, int(below > above), above / gap, below / gap, below < 0 or above < 0)

    def weighted(self, where: Weights, samples: slice = slice(None)) -> NDArray[np.float64]:
        """Some samples of the weighted sum, all of them unless told, m/s^2; the same bits in whatever pieces."""
        first, second = self.pairs[where.interval][where.sign]
        lower, upper = where.lower, where.upper
        if not self.single:
            double: NDArray[np.float64] = first[samples] * lower
            double += second[samples] * upper
            return double
        lower, upper = lower * self.scales[where.interval], upper * self.scales[where.interval + 1]
        largest = max(abs(lower), abs(upper)) or 1.0
        single = first[samples] * np.float32(lower / largest)
        single += second[samples] * np.float32(upper / largest)
        widened = single.astype(np.float64)
        widened *= largest
        return widened

    def __call__(self, speed_mm_s: float) -> Synthesised:
        where = self.weights(speed_mm_s)
        if where is None:
            return synthesise(self.spectra, speed_mm_s=speed_mm_s, output_rate_hz=self.output_rate_hz)
        return Synthesised(self.weighted(where), 0, where.extrapolated, self.dropped_bins)


def _holds_between(spectra: CrinkleSpectra, levels: NDArray[np.float64]) -> tuple[float, float]:
    """Slowest and fastest speed at which no bin is floored and the two terms cancel too little to matter, mm/s."""
    slowest, second = spectra.speeds_mm_s[:2]
    fastest = spectra.speeds_mm_s[-1]
    down = _steps_out(spectra.amplitudes[0], spectra.amplitudes[1], levels[0], levels[1])
    up = _steps_out(spectra.amplitudes[-1], spectra.amplitudes[-2], levels[-1], levels[-2])
    lowest = slowest - down * (second - slowest)
    return max(float(lowest), 0.0), float(fastest + up * (fastest - spectra.speeds_mm_s[-2]))


def _steps_out(
    nearest: NDArray[np.float64], next_nearest: NDArray[np.float64], level: float, next_level: float
) -> float:
    """How far beyond the nearest measured speed the weighted sum holds, in gaps between these two speeds."""
    falling = nearest < next_nearest
    with np.errstate(over="ignore"):
        until_floor = np.min(nearest[falling] / (next_nearest[falling] - nearest[falling]), initial=np.inf)
    if level == 0:
        return 0.0
    until_cancelled = (CANCELLATION - 1) * level / (level + next_level)
    return float(min(until_floor * (1 - MARGIN), until_cancelled))
