"""Waves that a study declares, in m/s^2: functions of time from 0, sampled at t = i / rate, i = 0, 1, ..., n - 1.

A wave of T seconds has n = round(T rate) samples, at least one. Of the same arguments it is the same function of time
at every rate; noise too, where T rate is whole (elsewhere its frequencies are off by a part of 1 / 2 n at most).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log, pi, sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.spectra import grid, inverse, inverse_on, spectrum
from palpate.experiment.synthesis.waveforms import Ring

Wave = NDArray[np.float64]
"""Accelerations, m/s^2, shape (n,)."""


class Declared(Ring):
    """A stimulus that the protocol declares."""

    occasion: ClassVar[str] = "presentation"
    method: ClassVar[str] = "as declared"


@dataclass(frozen=True)
class Times:
    """When the samples of a wave are, s: `at`, shape (n,), for `lasts_s`."""

    at: Wave
    lasts_s: float
    rate_hz: int


def times(lasts_s: float, rate_hz: int) -> Times:
    """Return the times of a wave's samples."""
    return Times(np.arange(max(round(lasts_s * rate_hz), 1)) / rate_hz, lasts_s, rate_hz)


def sinusoid(at: Times, *, frequency_hz: float, amplitude_m_s2: float) -> Wave:
    """Return a sin(2 pi f t)."""
    return np.asarray(amplitude_m_s2 * np.sin(2 * pi * frequency_hz * at.at))


def decaying(at: Times, *, frequency_hz: float, amplitude_m_s2: float, decay_per_s: float) -> Wave:
    """Return a exp(-B t) sin(2 pi f t): equation (2) of Wellman and Howe, with the amplitude as it is declared."""
    return np.exp(-decay_per_s * at.at) * sinusoid(at, frequency_hz=frequency_hz, amplitude_m_s2=amplitude_m_s2)


def sweep(at: Times, *, from_hz: float, to_hz: float, amplitude_m_s2: float, by_ratio: bool) -> Wave:
    """Return a sin(phi(t)), whose frequency phi'(t) / 2 pi goes from the first to the last, evenly or by even ratios.

    Evenly phi = 2 pi (f t + (g - f) t^2 / 2 T), else phi = 2 pi f T / r (exp(r t / T) - 1) with r = log(g / f).
    """
    t, whole = at.at, at.lasts_s
    if by_ratio and from_hz != to_hz:
        ratio = log(to_hz / from_hz)
        turns = from_hz * whole / ratio * np.expm1(ratio * t / whole)
    else:
        turns = from_hz * t + (to_hz - from_hz) * t**2 / (2 * whole)
    return np.asarray(amplitude_m_s2 * np.sin(2 * pi * turns))


def band_noise(at: Times, *, low_hz: float, high_hz: float, rms_m_s2: float, seed: int) -> Wave:
    """Return sinusoids at every k / T of a band, equally strong, in random phases: an rms as asked for, over T.

    Phases are drawn by PCG64 with the seed, in the order of frequencies. Raises `SynthesisError` for a band without
    any.
    """
    n = at.at.size
    period_s = n / at.rate_hz
    first, last = max(ceil(low_hz * period_s), 1), min(floor(high_hz * period_s), (n - 1) // 2)
    if last < first:
        raise SynthesisError(
            f"a burst of noise from {low_hz:g} to {high_hz:g} Hz for {at.lasts_s:g} s: got no frequency with whole "
            "periods in it; allowed: at least one; make it longer or its band wider"
        )
    phases = 2 * pi * np.random.Generator(np.random.PCG64(seed)).random(last - first + 1)
    bins = np.zeros(n // 2 + 1, np.complex128)
    bins[first : last + 1] = np.exp(1j * phases)
    return np.asarray(rms_m_s2 * n / sqrt(2 * phases.size) * np.fft.irfft(bins, n))


def pulses(at: Times, *, every_s: float, cycle_hz: float, amplitude_m_s2: float) -> Wave:
    """Return one whole cycle of a sinusoid at 0, `every_s`, 2 `every_s` ..., as far as it ends by T; else nothing."""
    place = np.floor(at.at / every_s + 1e-9)
    since = np.maximum(at.at - place * every_s, 0.0)
    whole = place * every_s + 1 / cycle_hz <= at.lasts_s + 1e-9
    return np.asarray(np.where(whole & (since < 1 / cycle_hz), amplitude_m_s2 * np.sin(2 * pi * cycle_hz * since), 0.0))


def resampled(at: Times, samples: Wave, *, recorded_hz: int) -> Wave:
    """Return a recording less its mean, shape (m,), at the times of a wave: by (1) and (5) of Okamoto et al.

    The sums of its bins are those of `spectra.inverse_on`; at its own rate its samples are those that were recorded.
    Raises `SynthesisError` as `spectra.grid`.
    """
    on = grid(samples=samples.size, bins=samples.size, rate_hz=recorded_hz, output_rate_hz=at.rate_hz)
    made = samples - samples.mean() if recorded_hz == at.rate_hz else inverse_on(spectrum(samples)[: on.carried], on)
    return np.asarray(np.pad(made[: at.at.size], (0, max(at.at.size - made.size, 0))))


def uncarried(at: Times, samples: Wave, *, recorded_hz: int) -> Wave:
    """Return what `resampled` leaves out of a recording, at its own rate, shape (m,): from half the wave's rate on.

    Raises as `resampled`.
    """
    on = grid(samples=samples.size, bins=samples.size, rate_hz=recorded_hz, output_rate_hz=at.rate_hz)
    bins = spectrum(samples)
    bins[: on.carried] = 0.0
    return inverse(bins)


def silence(at: Times) -> Wave:
    """Return nothing for so long."""
    return np.zeros(at.at.size)


def ramped(wave: Wave, *, rate_hz: int, ramp_s: float) -> Wave:
    """Return a wave that rises from zero and falls to zero as a raised cosine does, for so long each.

    The factor is (1 - cos(pi t / r)) / 2 at the time t from the beginning, and from the end of the last sample.
    """
    if not ramp_s:
        return wave
    t = np.arange(wave.size) / rate_hz
    left = np.minimum(t, wave.size / rate_hz - t)
    return np.asarray(wave * (1 - np.cos(pi * np.minimum(left / ramp_s, 1.0))) / 2)


def joined(waves: Sequence[Wave]) -> Wave:
    """Return waves one after the other."""
    return np.concatenate(waves)
