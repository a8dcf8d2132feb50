"""What `experiment.synthesis` is measured against: exact whole numbers, extended precision, closed forms.

Nothing here calls what it judges. Grids are fractions, phases are reduced in whole numbers, and sums are of
`numpy.longdouble`, which on x86 has 64 bits of mantissa. Where a platform's has no more than a float64, errors near
1e-16 are as much the oracle's as the method's; `extended_epsilon` says which it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from experiment.synthesis.crinkle import CrinkleSpectra

Extended = NDArray[np.longdouble]

RATE_HZ, PAPER_SAMPLES, SPEEDS_MM_S = 5000, 2500, (50.0, 100.0, 200.0, 300.0)
"""F, N and v_i of the recordings (Okamoto et al., sections 2 and 3.1)."""

PI = 4 * np.arctan(np.longdouble(1))

LEAST = 5e-324
"""The smallest float64, m/s^2."""

PEAK_HZ, DAMPING, GAIN_M_S2_PER_V, SOFT_V = 360.0, 0.12, 4.0, 5.0
"""Of the simulated response: the peak is that of Figure 9 of Okamoto et al., the others are plausible choices."""


@dataclass(frozen=True)
class Exact:
    """A stimulus in extended precision.

    Attributes:
        samples: shape (n,), m/s^2.
        scale: what a relative error is divided by, as `experiment.synthesis.waveforms` defines it.
        floored: bins that the line of equation (3) makes negative.
        extrapolated: whether the speed lies outside the measured ones.
        dropped: bins of the recordings that the output rate cannot carry.
        bins: N of the recordings.
    """

    samples: Extended
    scale: np.longdouble
    floored: int
    extrapolated: bool
    dropped: int
    bins: int


def extended_epsilon() -> float:
    """Distance from 1 to the next number of the extended precision at hand."""
    return float(np.finfo(np.longdouble).eps)


def spectrum_at(spectra: CrinkleSpectra, speed_mm_s: float) -> tuple[Extended, int, int | None]:
    """C'_k(v) of equations (3) and (4), with the signed difference, as printed otherwise.

    Returns:
        The spectrum, floored at zero; how many bins were; and, in extrapolation, the place of the nearest speed.
    """
    v = np.longdouble(speed_mm_s)
    speeds, amplitudes = spectra.speeds_mm_s.astype(np.longdouble), spectra.amplitudes.astype(np.longdouble)
    i = max([n for n in range(len(speeds) - 1) if speeds[n] <= v], default=0)
    # The nearer speed, settled in float64 as `crinkle.at_speed` defines it.
    j = i if speed_mm_s - spectra.speeds_mm_s[i] <= spectra.speeds_mm_s[i + 1] - speed_mm_s else i + 1
    line = (amplitudes[i] * (speeds[i + 1] - v) + amplitudes[i + 1] * (v - speeds[i])) / (speeds[i + 1] - speeds[i])
    nearest = 0 if v < speeds[0] else len(speeds) - 1 if v > speeds[-1] else None
    return np.maximum(line, 0) * spectra.signs[j], int(np.count_nonzero(line < 0)), nearest


def stimulus(spectra: CrinkleSpectra, *, speed_mm_s: float, output_rate_hz: int) -> Exact:
    """Equations (3) to (5) at one speed and output rate."""
    wanted, floored, nearest = spectrum_at(spectra, speed_mm_s)
    carried = min(wanted.size, ceil(_places(spectra, output_rate_hz)))
    bins = slice(1, carried)
    length = _length(wanted[bins])
    if nearest is not None:
        length = max(length, _length(spectra.amplitudes[nearest, bins].astype(np.longdouble)))
    return Exact(
        samples=_inverse(wanted[:carried], _places(spectra, output_rate_hz)),
        scale=length / np.sqrt(np.longdouble(2)),
        floored=floored,
        extrapolated=nearest is not None,
        dropped=max(0, spectra.samples - ceil(_places(spectra, output_rate_hz))),
        bins=spectra.samples,
    )


def error(made: NDArray[np.float64], exact: Exact) -> np.longdouble:
    """Rms of the difference from the exact stimulus, m/s^2."""
    return np.longdouble(_length(made - exact.samples) / np.sqrt(np.longdouble(made.size)))


def term_by_term(coefficients: ArrayLike, *, numerators: ArrayLike, denominator: int) -> Extended:
    """Equation (5), one cosine a bin and sample: sum_{k=1} C_k cos(pi k m / d), phases reduced in whole numbers.

    Args:
        coefficients: C_k with its sign, shape (K,).
        numerators: m of each sample, whole, shape (n,).
        denominator: d, whole.

    Returns:
        Shape (n,).
    """
    c = np.asarray(coefficients, dtype=np.longdouble)[1:]
    phases = np.outer(np.asarray(numerators, dtype=np.int64), np.arange(1, c.size + 1, dtype=np.int64))
    phases %= 2 * denominator
    terms = np.cos(phases.astype(np.longdouble) * (PI / denominator))
    return np.asarray(terms @ c)


def forward(samples: ArrayLike) -> Extended:
    """Equation (1) as printed: C_k = (2/N) sum_i y_i cos(pi k (i + 1/2) / N), shape (N,)."""
    y = np.asarray(samples, dtype=np.longdouble)
    n = y.size
    phases = np.outer(np.arange(n, dtype=np.int64), 2 * np.arange(n, dtype=np.int64) + 1) % (4 * n)
    return np.asarray(np.cos(phases.astype(np.longdouble) * (PI / (2 * n))) @ y * 2 / n)


def answered_m_s2(frequencies_hz: NDArray[np.float64], voltages_v: NDArray[np.float64]) -> NDArray[np.float64]:
    """A(f, e) = G(f) E asinh(e / E): a resonance that saturates softly, SIMULATED."""
    return np.asarray(_gain(frequencies_hz) * SOFT_V * np.arcsinh(voltages_v / SOFT_V))


def voltage_v(frequencies_hz: NDArray[np.float64], wanted_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
    """W(f, a) of equation (7) in closed form: the inverse of `answered_m_s2`."""
    return np.asarray(SOFT_V * np.sinh(wanted_m_s2 / (SOFT_V * _gain(frequencies_hz))))


def octave_deviations_db(samples: NDArray[np.float64], *, rate_hz: int, db_per_octave: float) -> NDArray[np.float64]:
    """How far each octave band is from its colour, relative to the band at 1 kHz.

    Args:
        samples: noise, one period of it, shape (n,).
        rate_hz: of it, Hz.
        db_per_octave: by which the levels of octave bands should rise: 0 for pink noise, 10 log10(10^0.3) for white.

    Returns:
        dB, shape (10,), from the band at 31.5 Hz to that at 16 kHz, whose exact centres are 1000 times a power of
        10^0.3 (IEC 61260-1); minus infinity for a band without a bin.
    """
    power = np.abs(np.fft.rfft(samples)) ** 2
    f = np.fft.rfftfreq(samples.size, 1 / rate_hz)
    steps = np.arange(-5, 5)
    centres_hz = 1000.0 * 10.0 ** (0.3 * steps)
    bands = [power[(f >= centre / 10**0.15) & (f < centre * 10**0.15)].sum() for centre in centres_hz]
    with np.errstate(divide="ignore"):
        levels_db = 10 * np.log10(bands)
    return np.asarray(levels_db - levels_db[5] - db_per_octave * steps)


def _length(values: Extended) -> np.longdouble:
    """Euclidean, without overflow or underflow where extended precision has no more exponents than a float64."""
    largest = np.max(np.abs(values), initial=0)
    return np.longdouble(0) if largest == 0 else np.longdouble(largest * np.sqrt(np.sum((values / largest) ** 2)))


def _gain(frequencies_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    part = frequencies_hz / PEAK_HZ
    return np.asarray(GAIN_M_S2_PER_V / np.hypot(1 - part**2, 2 * DAMPING * part))


def _places(spectra: CrinkleSpectra, output_rate_hz: int) -> Fraction:
    """N F' / F: samples that fill the recording's time; bin k is below half the output rate where k is below it."""
    return Fraction(spectra.samples * output_rate_hz, spectra.rate_hz)


def _inverse(coefficients: Extended, places: Fraction) -> Extended:
    p, q = places.numerator, places.denominator
    padded = np.zeros(p, dtype=np.longdouble)
    padded[q : coefficients.size * q : q] = coefficients[1:] / 2
    samples: Extended = fft.dct(padded, type=3)[: ceil(places - Fraction(1, 2))]
    return samples
