"""Crackling noise, made to order: pulses with power-law energies through damped modes.

Crumpled sheets crackle: bursts whose energies follow a power law, with exponents of 1.3 to 1.6 for paper (Houle and
Sethna, Acoustic emission from crumpling paper, 1996). A take is

- a Poisson process of pulses at a steady rate while the sheet is crushed, dying away while it relaxes;
- each pulse of random sign, its energy from a power law over four decades. Cylinders are alike, so the tail moves
  energy from pulse to pulse but not from take to take: the energies of a take are scaled to their expected sum;
- each pulse rings through the modes of the structure, damped sinusoids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

ENERGY_DECADES = 4.0


@dataclass(frozen=True)
class Mode:
    """A damped sinusoid with which a structure answers a unit impulse.

    Attributes:
        frequency_hz: of the ringing.
        damping: ratio to critical damping.
        weight_m_s2: amplitude at the impulse.
    """

    frequency_hz: float
    damping: float
    weight_m_s2: float


@dataclass(frozen=True)
class Crackle:
    """One crackling material.

    Attributes:
        exponent: of the power law of pulse energies.
        pulses_per_s: while it is crushed at the reference speed.
        modes: its resonances; a pulse of mean energy is a unit impulse to them.
    """

    exponent: float
    pulses_per_s: float
    modes: tuple[Mode, ...]


@dataclass(frozen=True)
class Course:
    """How often pulses come: steadily, then dying away.

    Attributes:
        rate_per_s: until `crush_s`.
        crush_s: how long the sheet is crushed, s.
        relaxation_s: time constant of dying away, s.
        window_s: no pulse comes later, s.
    """

    rate_per_s: float
    crush_s: float
    relaxation_s: float
    window_s: float

    @property
    def expected(self) -> float:
        """Expected number of pulses."""
        relaxed_s = max(self.window_s - self.crush_s, 0.0)
        dying_s = self.relaxation_s * -float(np.expm1(-relaxed_s / self.relaxation_s))
        return self.rate_per_s * (min(self.crush_s, self.window_s) + dying_s)

    def times_s(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Times of a Poisson process, by inverting its cumulative rate, s, unsorted."""
        passed = rng.random(rng.poisson(self.expected)) * self.expected / self.rate_per_s
        dying = np.maximum(passed - self.crush_s, 0.0)
        later = self.crush_s - self.relaxation_s * np.log1p(-dying / self.relaxation_s)
        return np.minimum(np.where(passed < self.crush_s, passed, later), np.nextafter(self.window_s, 0))


def power_law_energies(*, exponent: float, size: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Energies with density proportional to E^-exponent, from 1 to 10^`ENERGY_DECADES`; shape (size,)."""
    power = 1 - exponent
    return np.asarray((1 + rng.random(size) * (10 ** (ENERGY_DECADES * power) - 1)) ** (1 / power))


def pulses(
    *, course: Course, exponent: float, rate_hz: int, samples: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Impulses of a take: as many, and with as much energy, as `course` expects of pulses of energy 1.

    Args:
        course: when pulses come.
        exponent: of the power law of their energies.
        rate_hz: sampling rate, Hz.
        samples: length of the take.
        rng: source of this take's chance.

    Returns:
        Sum of the impulses in each sample, shape (samples,).
    """
    times_s = course.times_s(rng)
    energies = power_law_energies(exponent=exponent, size=times_s.size, rng=rng)
    signs = rng.choice((-1.0, 1.0), times_s.size)
    if not times_s.size:
        return np.zeros(samples)
    amplitudes = signs * np.sqrt(energies * course.expected / energies.sum())
    places = np.minimum((times_s * rate_hz).astype(np.intp), samples - 1)
    return np.bincount(places, weights=amplitudes, minlength=samples).astype(np.float64)


def response(modes: tuple[Mode, ...], *, rate_hz: int, samples: int) -> NDArray[np.complex128]:
    """Transfer function of the modes, for `ring`.

    Args:
        modes: of one structure.
        rate_hz: sampling rate, Hz.
        samples: length of the takes.
    """
    t = np.arange(samples) / rate_hz
    impulse = np.zeros(samples)
    for mode in modes:
        w = 2 * np.pi * mode.frequency_hz
        impulse += mode.weight_m_s2 * np.exp(-mode.damping * w * t) * np.sin(w * t)
    return np.asarray(fft.rfft(impulse, fft.next_fast_len(2 * samples)), dtype=np.complex128)


def ring(impulses: NDArray[np.float64], transfer: NDArray[np.complex128]) -> NDArray[np.float64]:
    """What a structure does under impulses: their convolution with its impulse response.

    Args:
        impulses: shape (samples,).
        transfer: from `response`, for as many samples.

    Returns:
        m/s^2, shape (samples,).
    """
    length = fft.next_fast_len(2 * impulses.size)
    return np.asarray(fft.irfft(fft.rfft(impulses, length) * transfer, length)[: impulses.size])
