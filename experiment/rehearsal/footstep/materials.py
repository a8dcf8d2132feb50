"""SIMULATED materials: four kinds of crackling noise and the bare panel. No number here was measured on a real object.

A simulated take with a cylinder crackles from first contact on; amplitude and rate of the pulses
rise with the foot's speed. The foot lands on the panel 10 mm later, at once where the panel is bare: a thump through
the panel's modes.

Pulses come per millimetre of crushing, so their rate is linear in speed; their amplitude grows as v^(6/5), as the
peak of a Hertzian impact does (Johnson, Contact Mechanics, 1985, section 11.4). The mode frequencies, exponents and
rates are plausible choices too. Two choices were made with section 3.3 of Okamoto et al. in view, which says that takes
of all materials are most like syntheses of their own speed or one close to it:

- The power 6/5. Where amplitudes grow more slowly than linearly, equation (6) cannot tell the speeds of single takes
  apart. Its sum of absolute differences is least at the median of a random spectrum's magnitude, 16 % below the mean
  that syntheses are made of, so takes look slower than they were, the more so the less amplitudes depend on speed.
- The thump's strength, of which the paper prints nothing. The thump comes 10 mm after first contact with an object and
  at once without, so |C_k| of the two do not cancel in equation (2), and what they leave differs from speed to speed.
  Where that outweighs the crackle of polypropylene, the weakest, its takes are put on other speeds.

The weights of the modes were fitted by least squares so that the mean over many seeds of equation (6) at 200 mm/s is
Table 3. Three takes scatter about that mean by up to 0.017: see `recorded_takes.py`, which chooses among sessions.

Crackling noise, made to order: pulses with power-law energies through damped modes.

Crumpled sheets crackle: bursts whose energies follow a power law, with exponents of 1.3 to 1.6 for paper (Houle and
Sethna, Acoustic emission from crumpling paper, 1996). A take is

- a Poisson process of pulses at a steady rate while the sheet is crushed, dying away while it relaxes;
- each pulse of random sign, its energy from a power law over four decades. Cylinders are alike, so the tail moves
  energy from pulse to pulse but not from take to take: the energies of a take are scaled to their expected sum;
- each pulse rings through the modes of the structure, damped sinusoids.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from experiment.errors import RecordingError, SynthesisError
from experiment.recordings.store import FASTEST_MM_S

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


REFERENCE_SPEED_MM_S = 200.0
CRUSH_MM = 10.0
RELAXATION_S = 0.25
AMPLITUDE_POWER = 1.2
RATE_POWER = 1.0

CRACKLES: Mapping[str, Crackle] = MappingProxyType(
    {
        "copy paper": Crackle(1.4, 3000.0, (Mode(40.0, 0.4, 0.398), Mode(180.0, 0.35, 1.26), Mode(400.0, 0.35, 1.81))),
        "aluminum foil": Crackle(
            1.3, 3000.0, (Mode(60.0, 0.4, 0.305), Mode(200.0, 0.35, 0.422), Mode(420.0, 0.35, 0.464))
        ),
        "polypropylene": Crackle(
            1.6, 3000.0, (Mode(90.0, 0.4, 0.0693), Mode(250.0, 0.35, 0.0659), Mode(450.0, 0.35, 0.0637))
        ),
        "typing paper": Crackle(
            1.5, 3000.0, (Mode(50.0, 0.4, 0.634), Mode(160.0, 0.35, 0.213), Mode(330.0, 0.35, 0.217))
        ),
    }
)

PANEL_MODES = (Mode(18.0, 0.25, 0.88), Mode(55.0, 0.15, 0.48), Mode(160.0, 0.08, 0.2), Mode(310.0, 0.06, 0.1))
LANDING_S = 0.012
LANDING_SPREAD = 0.08
"""Standard deviation of log strength and log duration of the landing foot, from step to step."""


@dataclass(frozen=True)
class SimulatedMaterials:
    """Makes takes of the simulated materials; holds nothing that changes.

    Args:
        rate_hz: sampling rate of the takes, Hz.
        samples: length of a take; time zero is first contact.
    """

    rate_hz: int
    samples: int
    _responses: Mapping[str, NDArray[np.complex128]] = field(init=False, repr=False, compare=False)
    _panel_response: NDArray[np.complex128] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        responses = {name: self._response(crackle.modes) for name, crackle in CRACKLES.items()}
        object.__setattr__(self, "_responses", responses)
        object.__setattr__(self, "_panel_response", self._response(PANEL_MODES))

    def _response(self, modes: tuple[Mode, ...]) -> NDArray[np.complex128]:
        return response(modes, rate_hz=self.rate_hz, samples=self.samples)

    def crinkle_take(self, material: str, *, speed_mm_s: float, rng: np.random.Generator) -> NDArray[np.float64]:
        """A fresh take of a cylinder scrunched on the panel.

        Args:
            material: id of one of `CRACKLES`.
            speed_mm_s: foot speed, mm/s.
            rng: source of this take's chance.

        Returns:
            Acceleration of the panel, m/s^2, shape (samples,).

        Raises:
            RecordingError: no such simulated material.
            SynthesisError: a speed that no foot has (see `moving`).
        """
        crackle = known(material)
        moving(speed_mm_s)
        relative, crush_s = speed_mm_s / REFERENCE_SPEED_MM_S, CRUSH_MM / speed_mm_s
        impulses = relative**AMPLITUDE_POWER * pulses(
            course=Course(
                rate_per_s=crackle.pulses_per_s * relative**RATE_POWER,
                crush_s=crush_s,
                relaxation_s=RELAXATION_S,
                window_s=self.samples / self.rate_hz,
            ),
            exponent=crackle.exponent,
            rate_hz=self.rate_hz,
            samples=self.samples,
            rng=rng,
        )
        landing = self._landing(speed_mm_s=speed_mm_s, at_s=crush_s, rng=rng)
        return ring(impulses, self._responses[material]) + ring(landing, self._panel_response)

    def panel_take(self, *, speed_mm_s: float, rng: np.random.Generator) -> NDArray[np.float64]:
        """A fresh take of the foot landing on the bare panel.

        Args:
            speed_mm_s: foot speed, mm/s.
            rng: source of this take's chance.

        Returns:
            Acceleration of the panel, m/s^2, shape (samples,).

        Raises:
            SynthesisError: a speed that no foot has (see `moving`).
        """
        moving(speed_mm_s)
        return ring(self._landing(speed_mm_s=speed_mm_s, at_s=0.0, rng=rng), self._panel_response)

    def _landing(self, *, speed_mm_s: float, at_s: float, rng: np.random.Generator) -> NDArray[np.float64]:
        """Half a sine of force, as strong as the foot is fast; at 200 mm/s a unit impulse on average."""
        strength, stretch = np.exp(LANDING_SPREAD * rng.normal(size=2))
        duration_s = stretch * LANDING_S
        since_s = np.arange(self.samples) / self.rate_hz - at_s
        shape = np.where((since_s >= 0) & (since_s < duration_s), np.sin(np.pi * since_s / duration_s), 0.0)
        unit = LANDING_S * self.rate_hz * 2 / np.pi
        return np.asarray(strength * speed_mm_s / REFERENCE_SPEED_MM_S * shape / unit)


def known(material: str) -> Crackle:
    """The simulated material with this id.

    Raises:
        RecordingError: there is none.
    """
    try:
        return CRACKLES[material]
    except KeyError:
        raise RecordingError(
            f"material {material!r}: no simulated material of that name; allowed: {', '.join(CRACKLES)}; "
            "rehearse a protocol with these materials, or record the real one"
        ) from None


def moving(speed_mm_s: float) -> None:
    """Refuse a foot that does not come down, or faster than a leg can move.

    Raises:
        SynthesisError: a speed that is not above zero, or above `FASTEST_MM_S`.
    """
    if not 0 < speed_mm_s <= FASTEST_MM_S:
        raise SynthesisError(f"speed_mm_s: got {speed_mm_s}; allowed: above 0, up to {FASTEST_MM_S:g}; check the foot")
