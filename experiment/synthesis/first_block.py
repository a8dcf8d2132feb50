"""First block first: the samples that an actuator needs at once, then the rest.

It is for a driver that can begin to play before the rest is there: `begin` returns the first block, `Begun.complete`
the whole. Sessions do not use it: they limit and shape whole stimuli, and between measured speeds the whole takes some
12 us.

Where the weighted sum of `basis.py` holds, the first block is its first samples. Beyond the measured speeds, where bins
are floored one after the other, it is a sum over the bins that still sound. Bins are kept in the order in which they
fall to zero, with the sums over all bins from every `STRIDE`-th of them on, so that only a few are left to add. The
rest of such a stimulus needs a whole inverse DCT.

How far these sums may err, in units u of one rounding. At g gaps beyond the nearest speed bin k sounds at L_k + g R_k,
R_k being its rise over a gap, and at most M bins sound. R_k is rounded once, g three times, a cosine
`COSINE_ROUNDINGS` times, product and sum within a stride `STRIDE` times, the sum of P strides P times; g R_k, its sum
with L_k, and the sum with the bins between two strides once each. A bin that falls within 5 u of g may be counted or
left out wrongly, by 5 u L_k. That makes E = STRIDE + P + COSINE_ROUNDINGS + 7 roundings, and one more for what is of
second order, of the sum of all L_k + g |R_k|. To this sum a rising bin adds what it sounds at, and a falling one that
still sounds at most 2 L_k. Let r be the rms of the whole, and at least that of all L_k. By the inequality of Cauchy and
Schwarz the sum is at most sqrt(2) r (sqrt(M_rising) + 2 sqrt(M_falling)) <= sqrt(10 M) r, and no sample errs by more
than (E + 1) u sqrt(10 M) r.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from experiment.synthesis.basis import Basis, BasisRenderer, Weight
from experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from experiment.synthesis.spectra import Grid
from experiment.synthesis.waveforms import (
    COSINE_ROUNDINGS,
    LEAST,
    ROUNDING,
    Estimate,
    Synthesised,
    cosines,
    printed_sum_error,
)

FIRST_BLOCK = 64
"""Samples of the first block: 1.3 ms at 48 kHz."""

STRIDE = 32
"""Bins between two sums."""

NEAREST = 1e-290
"""Gaps beyond the measured speeds below which the bins are summed one by one."""

OUTERMOST = 1e3
"""Gaps beyond the measured speeds from which they are again, lest the lines overflow in units of their scale."""

LINE, RISE = 0, 1


@dataclass(frozen=True)
class FirstBlockFirst:
    """Basis waveforms whose first `FIRST_BLOCK` samples can be had before the others, at any speed."""

    @property
    def name(self) -> str:
        return "first block first"

    def estimate(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Estimate:
        on = spectra.grid(output_rate_hz)
        rows = Basis().estimate(spectra, output_rate_hz=output_rate_hz)
        block, sounding = min(FIRST_BLOCK, on.count), on.carried - 1
        outward = max(outward_error(sounding), printed_sum_error(on.carried))
        return replace(
            rows,
            relative_error=rows.relative_error + outward * sqrt(block / on.count),
            why=f"{rows.why}, whose first block is a sum over the bins that sound",
            first_block_error=max(outward, rows.relative_error * sqrt(on.count / block)),
            memory_bytes=rows.memory_bytes + 8 * (block * sounding + 2 * (4 * sounding + 2 * block * _sums(sounding))),
        )

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> FirstBlockRenderer:
        on = spectra.grid(output_rate_hz)
        shared, speeds = _first_cosines(on), spectra.speeds_mm_s
        return FirstBlockRenderer(
            rows=Basis().prepare(spectra, output_rate_hz=output_rate_hz),
            on=on,
            first_cosines=shared,
            below=_outward(spectra, nearest=0, other=1, gap_mm_s=float(speeds[0] - speeds[1]), first_cosines=shared),
            above=_outward(
                spectra, nearest=-1, other=-2, gap_mm_s=float(speeds[-1] - speeds[-2]), first_cosines=shared
            ),
        )


@dataclass(frozen=True)
class Outward:
    """The first block on one side of the measured speeds, where bins fall to zero one after the other.

    Attributes:
        nearest_mm_s: the outermost measured speed.
        gap_mm_s: from the measured speed next to it, negative below.
        falls_after: gaps beyond the nearest speed at which each bin is at zero, rising, shape (K - 1,).
        order: place in `first_cosines` of each, shape (K - 1,).
        scale: a power of two near the largest amplitude at the nearest speed, m/s^2.
        lines: amplitude with sign at the nearest speed, and its change a gap, in units of `scale`, shape (2, K - 1).
        sums: both, times the cosines, summed over the bins from each `STRIDE`-th on, likewise, shape (2, sums, n).
    """

    nearest_mm_s: float
    gap_mm_s: float
    falls_after: NDArray[np.float64]
    order: NDArray[np.intp]
    scale: float
    lines: NDArray[np.float64]
    sums: NDArray[np.float64]

    def first(self, gaps: float, first_cosines: NDArray[np.float64]) -> NDArray[np.float64]:
        """The first block, so many gaps beyond the nearest speed, m/s^2."""
        fallen = int(self.falls_after.searchsorted(gaps))
        place = -(-fallen // STRIDE)
        block: NDArray[np.float64] = self.sums[LINE, place] + gaps * self.sums[RISE, place]
        left = slice(fallen, place * STRIDE)
        block += (self.lines[LINE, left] + gaps * self.lines[RISE, left]) @ first_cosines[self.order[left]]
        block *= self.scale
        return block


@dataclass(frozen=True)
class FirstBlockRenderer:
    """Implements `Renderer`, and `begin` beside it.

    Attributes:
        rows: the basis.
        on: the grid of the output rate.
        first_cosines: of the first block, shared by materials, shape (carried - 1, n).
        below: the first block below the measured speeds.
        above: the first block above them.
    """

    rows: BasisRenderer
    on: Grid
    first_cosines: NDArray[np.float64]
    below: Outward
    above: Outward

    def begin(self, speed_mm_s: float) -> Begun:
        """The first block of the stimulus for one step; `Begun.complete` computes the rest.

        Args:
            speed_mm_s: foot speed, mm/s, zero or more.

        Raises:
            SynthesisError: as `Renderer`.
        """
        where = self.rows.weight(speed_mm_s)
        if where is not None:
            return Begun(self.rows.weighted(where, slice(FIRST_BLOCK)), self, speed_mm_s, where)
        side = self.above if speed_mm_s > self.above.nearest_mm_s else self.below
        gaps = (speed_mm_s - side.nearest_mm_s) / side.gap_mm_s
        if NEAREST <= gaps < OUTERMOST:
            return Begun(side.first(gaps, self.first_cosines), self, speed_mm_s)
        wanted = at_speed(self.rows.spectra, speed_mm_s=speed_mm_s).coefficients[1 : self.on.carried]
        # In rows of terms, which numpy sums pairwise.
        return Begun(np.multiply(self.first_cosines.T, wanted, order="C").sum(axis=1), self, speed_mm_s)

    def __call__(self, speed_mm_s: float) -> Synthesised:
        return self.begin(speed_mm_s).complete()


@dataclass(frozen=True)
class Begun:
    """A stimulus of which the first block is there.

    Attributes:
        first_m_s2: its first `FIRST_BLOCK` samples, or all of a shorter one, m/s^2.
        renderer: what computes the rest.
        speed_mm_s: of the foot.
        where: the speed's weight in the basis; None where none holds.
    """

    first_m_s2: NDArray[np.float64]
    renderer: FirstBlockRenderer
    speed_mm_s: float
    where: Weight | None = None

    def complete(self) -> Synthesised:
        """The whole stimulus; it begins with the very samples of the first block. Raises as `Renderer`."""
        rows = self.renderer.rows
        if self.where is not None:
            return rows.stimulus(self.where, self.speed_mm_s)
        made = rows(self.speed_mm_s)

        def summed() -> NDArray[np.float64]:
            whole = made.summed()
            whole[: self.first_m_s2.size] = self.first_m_s2
            return whole

        return replace(made, summed=summed)


def outward_error(sounding: int) -> float:
    """Bound on the relative error of any sample of `Outward.first` (see the module).

    Args:
        sounding: M.
    """
    roundings = STRIDE + _sums(sounding) + COSINE_ROUNDINGS + 7
    return (roundings + 1) * ROUNDING * sqrt(10 * sounding)


def _sums(sounding: int) -> int:
    return -(-sounding // STRIDE) + 1


def _outward(
    spectra: CrinkleSpectra, *, nearest: int, other: int, gap_mm_s: float, first_cosines: NDArray[np.float64]
) -> Outward:
    bins = slice(1, len(first_cosines) + 1)
    level, rise = spectra.amplitudes[nearest, bins], (spectra.amplitudes[nearest] - spectra.amplitudes[other])[bins]
    falls_after = np.full(level.shape, np.inf)
    with np.errstate(over="ignore"):
        np.divide(level, -rise, out=falls_after, where=rise < 0)
    order = np.argsort(falls_after, kind="stable")
    # What is silent from the first step on has no line: it might fall more steeply than the scale can say.
    at_once = falls_after < NEAREST
    scale = max(float(np.ldexp(1.0, np.frexp(level.max(initial=0.0))[1] - 1)), LEAST)
    lines = np.where(at_once, 0.0, np.stack([level, rise]) * spectra.signs[nearest, bins])[:, order] / scale
    sums = np.zeros((2, _sums(level.size), first_cosines.shape[1]))
    for place in range(sums.shape[1] - 2, -1, -1):
        some = slice(place * STRIDE, (place + 1) * STRIDE)
        sums[:, place] = sums[:, place + 1] + lines[:, some] @ first_cosines[order[some]]
    return Outward(
        nearest_mm_s=float(spectra.speeds_mm_s[nearest]),
        gap_mm_s=gap_mm_s,
        falls_after=falls_after[order],
        order=order,
        scale=scale,
        lines=lines,
        sums=sums,
    )


@lru_cache(maxsize=4)
def _first_cosines(on: Grid) -> NDArray[np.float64]:
    table = np.ascontiguousarray(cosines(on, start=0, stop=min(FIRST_BLOCK, on.count)).T)
    table.flags.writeable = False
    return table
