"""Basis waveforms: between measured speeds equations (3) and (4) make a weighted sum of two waveforms.

C'(v) = s_j (C'(v_j) + t (C'(v_l) - C'(v_j))), v_j being the nearer speed of an interval, v_l the other, and
t = (v - v_j) / (v_l - v_j). So the nearer speed's own waveform and, with its signs, the difference of the two are made
beforehand for each half of each interval, 3 S - 2 waveforms for S speeds, and a step costs one product and one sum, in
one new array. At a measured speed t = 0, and its own waveform comes out to the bit.

Beyond the measured speeds the same holds with t < 0, as long as no bin is floored and the two terms stay within
`CANCELLATION` times the vibration at the nearest measured speed. The speeds between which both hold are found
beforehand, and outside them the inverse DCT takes over: one floored bin is one cosine too many in every sample.

How the two terms compare with the result, in rms: let L_j, L_l, D and W be the rms of C'(v_j), of C'(v_l), of their
difference and of C'(v). No amplitude is negative, so D^2 <= L_j^2 + L_l^2 and, where 0 <= t <= 1/2,
W^2 >= (1 - t)^2 L_j^2 + t^2 L_l^2. Hence t D <= W and L_j <= 2 W: between measured speeds the terms are at most 3 W.
Beyond them D <= L_j + L_l, and `_steps_out` keeps L_j + |t| (L_j + L_l) within `CANCELLATION` L_j, and so |t| within
`CANCELLATION` - 1. A term's error, as a part of the term, is that of the transform; four roundings in double precision,
three of t and one of the difference of two amplitudes; and four in the precision held: of the sample held, its weight,
their product and the sum.

No cheaper way past the first floored bin was found that stays small. The sums of `first_block.py`, for 24,000 samples
instead of 64, would take 30 MB a side and material, and then up to 31 cosines a sample. Taking each fallen bin's cosine
out of the weighted sum costs some 30 us a bin, a quarter of the inverse DCT; and of a simulated material's 2,500 bins
up to 13 are floored 10 mm/s beyond the fastest recording, 17 to 34 at 50 mm/s beyond, and 60 to 90 at 100 mm/s.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiment.synthesis.crinkle import CrinkleSpectra, foot_speed
from experiment.synthesis.spectra import inverse_on
from experiment.synthesis.waveforms import (
    LEAST,
    ROUNDING,
    BinsAtSpeed,
    Estimate,
    Synthesised,
    held_bytes,
    rms,
    synthesise,
    transform_error,
)

CANCELLATION = 8.0
"""Largest sum of the two terms' rms in extrapolation, as a multiple of the rms at the nearest measured speed; between
measured speeds the sum is at most 3 times the rms of the result."""

MARGIN = 1e-9
"""How far before the first bin falls to zero, as a part of the way there, the inverse DCT takes over."""


@dataclass(frozen=True, slots=True)
class Weight:
    """How a speed weights the basis: the first waveform of a pair and `of_difference` times the second.

    Attributes:
        interval: i, of the measured speeds v_i and v_i+1.
        nearer: 0 for the pair of v_i, 1 for that of v_i+1.
        of_difference: t, from the nearer speed towards the other: 0 to 1/2 between the two, negative beyond the nearer.
        extrapolated: whether v lies outside the measured speeds.
    """

    interval: int
    nearer: int
    of_difference: float
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
            why=f"each waveform is an inverse DCT, rounded four times in {np.dtype(kind)}; two terms of at most 3 "
            f"times the rms between measured speeds; beyond them at most {CANCELLATION:g} times the rms at the "
            "nearest, or else the inverse DCT",
            memory_bytes=held_bytes(spectra) + (3 * spectra.speeds_mm_s.size - 2) * on.count * np.dtype(kind).itemsize,
        )

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> BasisRenderer:
        on = spectra.grid(output_rate_hz)
        levels = rms(spectra.amplitudes, on)
        amplitudes = spectra.amplitudes[:, : on.carried].copy()
        amplitudes[:, 0] = 0.0  # it sounds in no waveform, and may be larger than what does
        places = range(len(levels))
        scales = [self._scale(amplitudes[at]) for at in places]
        difference_scales = [self._scale(amplitudes[i + 1] - amplitudes[i]) for i in places[:-1]]

        def waveform(scaled: NDArray[np.float64], nearer: int) -> NDArray[Any]:
            scaled *= spectra.signs[nearer, : on.carried]
            return inverse_on(scaled, on).astype(np.float32 if self.single else np.float64)

        def difference(nearer: int, other: int) -> NDArray[Any]:
            scale = difference_scales[min(nearer, other)]
            return waveform((amplitudes[other] - amplitudes[nearer]) / scale, nearer)

        own = [waveform(amplitudes[at] / scales[at], at) for at in places]
        lowest, highest = _holds_between(spectra, levels)
        return BasisRenderer(
            spectra=spectra,
            output_rate_hz=output_rate_hz,
            single=self.single,
            dropped_bins=spectra.dropped(on),
            speeds_mm_s=tuple(spectra.speeds_mm_s.tolist()),
            lowest_mm_s=lowest,
            highest_mm_s=highest,
            pairs=tuple(((own[i], difference(i, i + 1)), (own[i + 1], difference(i + 1, i))) for i in places[:-1]),
            scales=tuple(scales),
            difference_scales=tuple(difference_scales),
        )

    def _scale(self, spectrum: NDArray[np.float64]) -> float:
        """1 in double precision, in single precision a power of two near the largest magnitude."""
        if not self.single:
            return 1.0
        largest = float(np.abs(spectrum).max())
        # Of silence the least: a larger one would outweigh the waveform of a quiet neighbour.
        return float(np.ldexp(1.0, np.frexp(largest)[1] - 1)) if largest > 0 else LEAST


@dataclass(frozen=True)
class BasisRenderer:
    """Implements `Renderer`.

    Attributes:
        spectra: of the material.
        output_rate_hz: samples a second.
        single: whether `pairs` are held in single precision.
        dropped_bins: bins of the recordings that the output rate cannot carry.
        speeds_mm_s: v_i.
        lowest_mm_s: the slowest speed at which the weighted sum holds, mm/s.
        highest_mm_s: the fastest, mm/s.
        pairs: for each interval and each of its speeds v_j, v_l being the other, the waveforms of C'(v_j) and of
            C'(v_l) - C'(v_j), both with the signs of v_j and each divided by its scale.
        scales: a power of two for each speed: 1 in double precision, in single precision the size of its amplitudes.
        difference_scales: the same of the differences, for each interval.
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
    difference_scales: tuple[float, ...]

    def weight(self, speed_mm_s: float) -> Weight | None:
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
        nearer = int(below > above)
        return Weight(i, nearer, (above if nearer else below) / gap, below < 0 or above < 0)

    def weighted(self, where: Weight, samples: slice = slice(None)) -> NDArray[np.float64]:
        """Some samples of the weighted sum, all of them unless told, m/s^2; the same bits in whatever pieces."""
        own, difference = self.pairs[where.interval][where.nearer]
        if not self.single:
            double: NDArray[np.float64] = difference[samples] * where.of_difference
            double += own[samples]
            return double
        large, of_large = own, self.scales[where.interval + where.nearer]
        small, of_small = difference, where.of_difference * self.difference_scales[where.interval]
        if abs(of_small) > of_large:
            large, of_large, small, of_small = small, of_small, large, of_large
        single = small[samples] * np.float32(of_small / of_large)
        single += large[samples]
        widened = single.astype(np.float64)
        widened *= of_large
        return widened

    def __call__(self, speed_mm_s: float) -> Synthesised:
        where = self.weight(speed_mm_s)
        if where is None:
            return synthesise(self.spectra, speed_mm_s=speed_mm_s, output_rate_hz=self.output_rate_hz)
        return self.stimulus(where, speed_mm_s)

    def stimulus(self, where: Weight, speed_mm_s: float) -> Synthesised:
        """The weighted sum as a stimulus; `where` is the weight of the foot's speed, mm/s."""
        return Synthesised(
            summed=partial(self.weighted, where),
            floored_bins=0,
            extrapolated=where.extrapolated,
            dropped_bins=self.dropped_bins,
            bins=BinsAtSpeed(self.spectra, speed_mm_s),
        )


def _holds_between(spectra: CrinkleSpectra, levels: NDArray[np.float64]) -> tuple[float, float]:
    """Slowest and fastest speed at which no bin is floored and the two terms cancel too little to matter, mm/s."""
    slowest, second = spectra.speeds_mm_s[:2]
    fastest = spectra.speeds_mm_s[-1]
    # A floored bin that is left out ends it too, so that no bin need be counted where it holds.
    bins = [spectra.amplitudes] if spectra.left_out is None else [spectra.amplitudes, spectra.left_out]
    every = np.concatenate(bins, axis=1)
    down = _steps_out(every[0], every[1], levels[0], levels[1])
    up = _steps_out(every[-1], every[-2], levels[-1], levels[-2])
    lowest = slowest - down * (second - slowest)
    highest = fastest + up * (fastest - spectra.speeds_mm_s[-2])
    # Rounded inwards: the next number may lie beyond a floor that is nearer than half of its distance.
    return max(float(np.nextafter(lowest, slowest)), 0.0), float(np.nextafter(highest, fastest))


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
