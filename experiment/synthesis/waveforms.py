"""A stimulus: what a material's spectra become at one foot speed and one output rate, equation (5) of Okamoto et al.

Ways to compute the same stimulus, equations (3) to (5) of Okamoto et al., behind one interface.

The relative error of a waveform is the rms of its difference from the exact one, divided by the rms of the exact one,
both by Parseval: `rms` of the bins that the output rate carries. In extrapolation a spectrum may vanish at a speed;
there the divisor is at least the rms at the nearest measured speed. Rounding of numbers below 1e-307 comes on top: at
most `denormal_error_m_s2`.

Frequency shaping (7) is not linear in amplitude, so no method weights shaped waveforms: every method returns m/s^2, and
the actuator's driver shapes what it is given (`driving.drive`), from the bins that come with it where it can. What it
weights itself, once a rig's response is known, is prepared in `voltages.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import log2, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.crinkle import CrinkleSpectra, SpectrumAtSpeed, at_speed
from experiment.synthesis.spectra import Bins, Grid, finite, inverse_on, transformable


@dataclass(frozen=True)
class BinsAtSpeed:
    """What a stimulus is the sum of; call it. Arguments and errors as in `at_speed`."""

    spectra: CrinkleSpectra
    speed_mm_s: float

    @cached_property
    def at(self) -> SpectrumAtSpeed:
        """C'_k(v), computed when it is first asked for."""
        return at_speed(self.spectra, speed_mm_s=self.speed_mm_s)

    def __call__(self) -> Bins:
        return Bins(self.at.coefficients, samples=self.spectra.samples, rate_hz=self.spectra.rate_hz)


@dataclass(frozen=True)
class Synthesised:
    """A stimulus for one step of the foot.

    Attributes:
        summed: returns the sum of the bins at the output rate, m/s^2, shape (n,).
        floored_bins: as in `SpectrumAtSpeed`.
        extrapolated: as in `SpectrumAtSpeed`.
        dropped_bins: bins of the recordings that the output rate cannot carry.
        bins: returns what the waveform is the sum of; it costs some microseconds.
    """

    summed: Callable[[], NDArray[np.float64]]
    floored_bins: int
    extrapolated: bool
    dropped_bins: int
    bins: Callable[[], Bins]

    @cached_property
    def waveform_m_s2(self) -> NDArray[np.float64]:
        """At the output rate, m/s^2, shape (n,); summed when it is first asked for. Raises as `inverse_on`."""
        return self.summed()


def synthesise(spectra: CrinkleSpectra, *, speed_mm_s: float, output_rate_hz: int) -> Synthesised:
    """The stimulus for one step: equations (3), (4) and (5), as long as the recordings were.

    Args:
        spectra: of one material, from `subtract`.
        speed_mm_s: foot speed, mm/s, zero or more.
        output_rate_hz: samples a second that the actuator expects, Hz.

    Raises:
        SynthesisError: as `at_speed`, `grid` and `transformable`.

    Source: Okamoto et al., section 3.1.
    """
    bins = BinsAtSpeed(spectra, speed_mm_s)
    on = spectra.grid(output_rate_hz)
    transformable(on)
    return Synthesised(
        summed=lambda: inverse_on(bins.at.coefficients, on),
        floored_bins=bins.at.floored_bins,
        extrapolated=bins.at.extrapolated,
        dropped_bins=spectra.dropped(on),
        bins=bins,
    )


ROUNDING = float(np.finfo(np.float64).eps) / 2
"""u, the largest relative error of one rounding of a float64."""

AT_SPEED_ROUNDINGS = 8
"""What equation (3) is allowed: `crinkle.at_speed` rounds a bin seven times at most, and one covers second order."""

COSINE_ROUNDINGS = 13
"""Roundings, of 1, in a cosine of `cosines`: an angle below 2 pi is the product of a whole number below 2^53 and
pi / 2p, and so within 2.4 roundings of itself; its cosine within 2.4 max |x sin x| = 11.6, and one of its own."""

LEAST = 5e-324
"""The smallest float64: what the rounding of a denormal number costs at most, twice."""

CHUNK_BYTES = 2**20
"""Memory for the terms that `PrintedSum` sums at a time, bytes; their phases take as much again, twice."""


@dataclass(frozen=True)
class Estimate:
    """What a method promises for one material at one output rate, known before anything is prepared.

    Attributes:
        relative_error: bound on the relative error (see the module) at any speed.
        why: what the bound rests on, in words.
        memory_bytes: what the prepared renderer holds, the spectra among it.
        first_block_error: the same for the first block by itself, where a method hands it out before the rest; the
            divisor is that of the whole stimulus.
    """

    relative_error: float
    why: str
    memory_bytes: int
    first_block_error: float | None = None


class Renderer(Protocol):
    """One material, prepared for one output rate."""

    def __call__(self, speed_mm_s: float) -> Synthesised:
        """The stimulus for one step.

        Args:
            speed_mm_s: foot speed, mm/s, zero or more.

        Raises:
            SynthesisError: a speed that is negative, not finite, or so high that the spectrum overflows.
        """
        ...


class Method(Protocol):
    """A way to compute stimuli."""

    @property
    def name(self) -> str:
        """As tables and plots print it."""
        ...

    def estimate(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Estimate:
        """What this method promises; costs next to nothing. Raises as `spectra.grid`."""
        ...

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Renderer:
        """Do beforehand what does not depend on the speed. Raises as `spectra.grid` and `spectra.inverse_on`."""
        ...


@dataclass(frozen=True)
class PrintedSum:
    """Equation (5) as printed, one cosine a bin and sample: slow, and the oracle of the others."""

    name: str = "printed sum"

    def estimate(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Estimate:
        bins = spectra.grid(output_rate_hz).carried
        return Estimate(
            relative_error=printed_sum_error(bins),
            why=f"each cosine within {COSINE_ROUNDINGS} roundings, its phase reduced in whole numbers; pairwise sums; "
            "and the sum of the amplitudes is at most sqrt(2 bins) times the rms",
            memory_bytes=held_bytes(spectra) + 3 * CHUNK_BYTES,
        )

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Renderer:
        return _PrintedSum(spectra, spectra.grid(output_rate_hz))


@dataclass(frozen=True)
class InverseDct:
    """Zero-padded inverse DCT: exact and band-limited, at any speed."""

    name: str = "inverse DCT"

    def estimate(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Estimate:
        on = spectra.grid(output_rate_hz)
        return Estimate(
            relative_error=AT_SPEED_ROUNDINGS * ROUNDING + transform_error(on),
            why="rounding of a fast transform grows with the logarithm of its length",
            memory_bytes=held_bytes(spectra),
        )

    def prepare(self, spectra: CrinkleSpectra, *, output_rate_hz: int) -> Renderer:
        transformable(spectra.grid(output_rate_hz))
        return _InverseDct(spectra, output_rate_hz)


@dataclass(frozen=True)
class _PrintedSum:
    spectra: CrinkleSpectra
    on: Grid

    def __call__(self, speed_mm_s: float) -> Synthesised:
        bins, on = BinsAtSpeed(self.spectra, speed_mm_s), self.on

        def summed() -> NDArray[np.float64]:
            samples = np.empty(on.count)
            rows = max(1, CHUNK_BYTES // (8 * on.carried))
            for start in range(0, on.count, rows):
                stop = min(start + rows, on.count)
                terms = cosines(on, start=start, stop=stop)
                terms *= bins.at.coefficients[1 : on.carried]
                samples[start:stop] = terms.sum(axis=1)
            return samples

        return Synthesised(
            summed=summed,
            floored_bins=bins.at.floored_bins,
            extrapolated=bins.at.extrapolated,
            dropped_bins=self.spectra.dropped(on),
            bins=bins,
        )


@dataclass(frozen=True)
class _InverseDct:
    spectra: CrinkleSpectra
    output_rate_hz: int

    def __call__(self, speed_mm_s: float) -> Synthesised:
        return synthesise(self.spectra, speed_mm_s=speed_mm_s, output_rate_hz=self.output_rate_hz)


def printed_sum_error(bins: int) -> float:
    """Bound on the relative error of any sample of a printed sum, equation (3) included.

    Each term is within the roundings of its amplitude, its cosine and its product, and of a sum of blocks of 128 terms
    in eight running sums, then pairwise: 19 + log2(bins). The amplitudes add up to at most sqrt(2 bins) times the rms.
    """
    return (AT_SPEED_ROUNDINGS + COSINE_ROUNDINGS + 20 + log2(bins)) * ROUNDING * sqrt(2 * bins)


def denormal_error_m_s2(samples: int) -> float:
    """What the rounding of numbers below 1e-307 may add to an error, m/s^2.

    Equation (3), or the weights of scaled waveforms, round twice a bin, by `LEAST` at most. The waveforms are made of
    normal numbers (`spectra.LIFT`), rounded once a sample, and weighted by 8 at most (`basis.CANCELLATION`).

    Args:
        samples: N of the recordings.
    """
    return (2 * samples + 16) * LEAST


def cosines(on: Grid, *, start: int, stop: int) -> NDArray[np.float64]:
    """cos(pi k q (i + 1/2) / p) of bins 1 to carried - 1 at some samples, each within `COSINE_ROUNDINGS` of 1.

    Args:
        on: the grid.
        start: first sample i.
        stop: one past the last.

    Returns:
        Shape (stop - start, carried - 1).

    Raises:
        SynthesisError: a grid whose phases overflow whole numbers of 64 bits.
    """
    if 2 * on.carried * on.q * stop >= 2**63:
        raise SynthesisError(
            f"output_rate_hz: got one whose ratio to the recording's is {on.p}/{on.q} samples; "
            "allowed: phases below 2^63; use a rounder rate"
        )
    odd = 2 * np.arange(start, stop, dtype=np.int64)[:, None] + 1
    phases = odd * (np.arange(1, on.carried, dtype=np.int64) * on.q)
    phases %= 4 * on.p
    return np.asarray(np.cos(phases * (np.pi / (2 * on.p))))


def rms(amplitudes: NDArray[np.float64], on: Grid) -> NDArray[np.float64]:
    """sqrt(sum_k C_k^2 / 2) over the bins 1 to carried - 1: by Parseval the rms of the waveform where q is 1.

    Args:
        amplitudes: of any scale, 1e300 and denormals included, shape (..., N).
        on: their grid.

    Returns:
        Shape (...).

    Raises:
        SynthesisError: one that is NaN or infinite.
    """
    sounding = finite(amplitudes, what="amplitudes")[..., 1 : on.carried]
    largest = np.max(np.abs(sounding), axis=-1, initial=0.0)
    unit = np.where(largest > 0, largest, 1.0)
    relative: NDArray[np.float64] = np.sqrt(np.sum((sounding / unit[..., None]) ** 2, axis=-1) / 2)
    return np.asarray(relative * largest)


def transform_error(on: Grid) -> float:
    """Bound on the relative error of an inverse DCT on a grid.

    For lengths that are powers of two, the norm of the error of a fast transform stays within about 7 log2(length)
    roundings of the norm of its result (Higham, Accuracy and Stability of Numerical Algorithms, theorem 24.2); 8 and
    two steps more cover the passes before and after it. For other lengths, such as the 24,000 points of 0.5 s at 48
    kHz, the bound is not derived but measured: every error that `palpate numerics` and the tests take stays within it.
    The grid may hold `count` of its p samples only, and all of the error.
    """
    return 8 * log2(4 * on.p) * ROUNDING * sqrt(on.p / on.count)


def held_bytes(spectra: CrinkleSpectra) -> int:
    """Memory of one material's spectra, bytes."""
    left_out = 0 if spectra.left_out is None else spectra.left_out.nbytes
    return spectra.speeds_mm_s.nbytes + spectra.amplitudes.nbytes + spectra.signs.nbytes + left_out
