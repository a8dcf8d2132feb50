"""The vibration of a tap: equations (1) to (3) of Wellman and Howe, and the curves that they take from recordings.

    A(V) = L D V                         (1)
    Q(t) = A(V) exp(-B t) sin(W t)       (2)
    W = 2 pi f                           (3)

Table 1 gives aluminum's stiffness as more than 160,000 N/m; here it is 160,000 N/m.
"""

from dataclasses import dataclass
from math import exp, inf, log, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.spectra import finite
from palpate.experiment.synthesis.waveforms import Ring

DECAY_PER_S = 100.0
"""B, as the paper held it constant."""

REFERENCE_M_S = 0.2
"""The speed of impact that Table 1 states amplitudes for."""

FADED = 1e-3
"""Part of the amplitude to which a vibration has decayed where it ends, unless its length is given. Ours: -60 dB."""


@dataclass(frozen=True)
class Surface:
    """A surface that is tapped: its stiffness, N/m; L, a part of aluminum's; D, s/m; f, Hz; and B, 1/s."""

    name: str
    stiffness_n_m: float
    amplitude: float
    attack_hz: float
    per_speed_s_m: float = 1 / REFERENCE_M_S
    decay_per_s: float = DECAY_PER_S


SURFACES = (
    Surface("collapsed polystyrene", 4_500.0, 0.033, 43.0),
    Surface("RTV silicone", 5_800.0, 0.034, 50.0),
    Surface("basswood", 19_000.0, 0.113, 100.0),
    Surface("plastic", 140_000.0, 0.472, 1000.0),
    Surface("aluminum", 160_000.0, 1.000, 4000.0),
)
"""Table 1."""


def amplitude(surface: Surface, *, speed_m_s: float) -> float:
    """Return A(V) (1), as a part of aluminum's at 0.2 m/s. Raises `SynthesisError` for a bad speed, m/s."""
    if not 0 <= speed_m_s < inf:
        raise SynthesisError(f"speed: got {speed_m_s} m/s; allowed: finite, and zero or more; check the tracker")
    return surface.amplitude * surface.per_speed_s_m * speed_m_s


def waveform(
    surface: Surface, *, speed_m_s: float, rate_hz: float, aluminum_m_s2: float, length_s: float | None = None
) -> NDArray[np.float64]:
    """Return Q(t) (2) at t = 0, 1 / `rate_hz`, ..., m/s^2, shape (n,), from the moment of touch.

    `aluminum_m_s2` is A of aluminum at 0.2 m/s. By default it ends where the envelope is `FADED`. Raises
    `SynthesisError` as `amplitude`, for a rate that cannot carry f, or a length that is not above zero and finite.
    """
    if not (2 * surface.attack_hz < rate_hz < inf):
        raise SynthesisError(
            f"rate: got {rate_hz} Hz for {surface.name}, which vibrates at {surface.attack_hz:g} Hz; allowed: more "
            "than twice that, and finite; use a device with a higher rate, or leave out the surface"
        )
    length = log(1 / FADED) / surface.decay_per_s if length_s is None else length_s
    if not 0 < length < inf:
        raise SynthesisError(f"length: got {length} s; allowed: a finite time above zero; correct it")
    t = np.arange(max(1, round(length * rate_hz))) / rate_hz
    grown = amplitude(surface, speed_m_s=speed_m_s) * aluminum_m_s2
    return np.asarray(grown * np.exp(-surface.decay_per_s * t) * np.sin(2 * pi * surface.attack_hz * t))


@dataclass(frozen=True, eq=False)
class Rings:
    """The vibrations of one surface at any speed, made beforehand: `unit` is that of 1 m/s."""

    unit: Ring

    def at(self, speed_m_s: float) -> Ring:
        """Return the vibration of a tap at a speed, m/s, zero or more: it is linear in the speed (1)."""
        return Ring(speed_m_s * self.unit.waveform_m_s2, self.unit.rate_hz)

    def later(self, seconds: float) -> "Rings":
        """Return the same vibrations after a silence of so long, s, zero or more, to the nearest sample."""
        silence = np.zeros(round(seconds * self.unit.rate_hz))
        return Rings(Ring(np.concatenate([silence, self.unit.waveform_m_s2]), self.unit.rate_hz))

    def above(self, crossover_hz: float) -> "Rings":
        """Return the same vibrations high-passed at a crossover, Hz (first order, bilinear)."""
        from scipy.signal import butter, lfilter

        b, a = butter(1, crossover_hz, "highpass", fs=self.unit.rate_hz)
        return Rings(Ring(np.asarray(lfilter(b, a, self.unit.waveform_m_s2)), self.unit.rate_hz))

    def scaled(self, factor: float) -> "Rings":
        """Return the same vibrations, each multiplied by a factor."""
        return Rings(Ring(factor * self.unit.waveform_m_s2, self.unit.rate_hz))


def rings(surface: Surface, *, rate_hz: int, aluminum_m_s2: float) -> Rings:
    """Return the vibrations of a surface; arguments and errors are those of `waveform`."""
    return Rings(Ring(waveform(surface, speed_m_s=1.0, rate_hz=rate_hz, aluminum_m_s2=aluminum_m_s2), rate_hz))


@dataclass(frozen=True)
class Exponential:
    """f = `at_zero_hz` exp(K / `per_n_m`); `misfits` are ln f measured less ln f fitted, `r2` that of ln f."""

    at_zero_hz: float
    per_n_m: float
    misfits: tuple[float, ...]
    r2: float

    def at(self, stiffness_n_m: float) -> float:
        """Return the frequency for a stiffness, Hz."""
        return self.at_zero_hz * exp(stiffness_n_m / self.per_n_m)


def frequency_curve(stiffness_n_m: ArrayLike, frequencies_hz: ArrayLike) -> Exponential:
    """Return the exponential of frequencies over stiffness, least squares of ln f; both of shape (n,), n >= 2.

    The paper calls the attack "approximately exponential" in stiffness. Raises `SynthesisError` unless frequencies are
    above zero, and two or more stiffnesses differ.
    """
    k, f = finite(stiffness_n_m, what="stiffness"), finite(frequencies_hz, what="frequencies")
    if k.ndim != 1 or k.shape != f.shape or np.unique(k).size < 2 or np.any(f <= 0):
        raise SynthesisError(
            f"curve: got {k.tolist()} N/m and {f.tolist()} Hz; allowed: as many frequencies above zero as stiffnesses, "
            "at least two of them different; tap on another surface"
        )
    logs = np.log(f)
    slope, start = np.polynomial.polynomial.polyfit(k, logs, 1)[::-1]
    misfits = logs - (start + slope * k)
    total = float(np.sum((logs - logs.mean()) ** 2))
    return Exponential(
        at_zero_hz=exp(float(start)),
        per_n_m=1 / float(slope) if slope else inf,
        misfits=tuple(misfits.tolist()),
        r2=1 - float(np.sum(misfits**2)) / total if total else 1.0,
    )


@dataclass(frozen=True)
class Scaling:
    """L and D of one surface: its amplitude at 0.2 m/s in the recordings' unit, and 1/s of m.

    `misfits` are measured amplitudes less L D V, as parts of L.
    """

    amplitude: float
    per_speed_s_m: float
    misfits: tuple[float, ...]


def scaling(speeds_m_s: ArrayLike, amplitudes: ArrayLike) -> Scaling:
    """Return L and D of one surface from its amplitudes at several speeds, both of shape (n,): equation (1).

    L is the amplitude at 0.2 m/s on the fitted line, as in Table 1. L D is the slope of the line through the origin;
    where the two lines differ, D is not 1 / 0.2. Raises `SynthesisError` unless there are two or more speeds above
    zero.
    """
    v, a = finite(speeds_m_s, what="speeds"), finite(amplitudes, what="amplitudes")
    if v.ndim != 1 or v.shape != a.shape or np.unique(v).size < 2 or np.any(v <= 0):
        raise SynthesisError(
            f"scaling: got speeds of {v.tolist()} m/s; allowed: two or more different speeds above zero, each with an "
            "amplitude; tap at other speeds"
        )
    slope = float(np.dot(v, a) / np.dot(v, v))
    line = np.polynomial.polynomial.polyfit(v, a, 1)
    level = float(line[0] + line[1] * REFERENCE_M_S)
    if level <= 0:
        raise SynthesisError(f"scaling: got an amplitude of {level:g} at 0.2 m/s; allowed: above zero; tap again")
    return Scaling(level, slope / level, tuple(((a - slope * v) / level).tolist()))
