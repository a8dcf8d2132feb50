"""The oracle for `experiment/synthesis/`: exact whole numbers, extended precision, closed forms.

It calls nothing that it judges. Grids are fractions, phases whole numbers, and sums `numpy.longdouble` (64 bits on x86,
see `extended_epsilon`).
"""

from dataclasses import dataclass
from fractions import Fraction
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.shaping import Response

Extended = NDArray[np.longdouble]

RATE_HZ, PAPER_SAMPLES, SPEEDS_MM_S = 5000, 2500, (50.0, 100.0, 200.0, 300.0)
"""F, N and v_i of the recordings (Okamoto et al., sections 2 and 3.1)."""

PI = 4 * np.arctan(np.longdouble(1))

LEAST = 5e-324
"""The smallest float64, m/s^2."""

SUSPENSION_HZ, SUSPENSION_DAMPING, PEAK_HZ, DAMPING, GAIN_M_S2_PER_V, SOFT_V = 35.0, 0.5, 360.0, 0.12, 4.0, 5.0
"""The simulated response: the peak is that of Figure 9 of Okamoto et al., the other values are plausible choices."""


@dataclass(frozen=True)
class Exact:
    """A stimulus in extended precision: samples in m/s^2, or V, shape (n,), of recordings with N = `bins`.

    `scale` divides a relative error, as `experiment/synthesis/waveforms.py` defines it. The line of equation (3) makes
    `floored` bins negative, and the output rate cannot carry `dropped` bins of the recordings.
    """

    samples: Extended
    scale: np.longdouble
    floored: int
    extrapolated: bool
    dropped: int
    bins: int


def extended_epsilon() -> float:
    """Return the distance from 1 to the next number of this platform's extended precision."""
    return float(np.finfo(np.longdouble).eps)


def spectrum_at(spectra: CrinkleSpectra, speed_mm_s: float) -> tuple[Extended, int, int | None]:
    """Return C'_k(v) of (3) and (4), floored at zero, the number of floored bins, and the speed extrapolated from."""
    v = np.longdouble(speed_mm_s)
    speeds, amplitudes = spectra.speeds_mm_s.astype(np.longdouble), spectra.amplitudes.astype(np.longdouble)
    i = max([n for n in range(len(speeds) - 1) if speeds[n] <= v], default=0)
    # The nearer speed, settled in float64 as `crinkle.at_speed` defines it.
    j = i if speed_mm_s - spectra.speeds_mm_s[i] <= spectra.speeds_mm_s[i + 1] - speed_mm_s else i + 1
    line = (amplitudes[i] * (speeds[i + 1] - v) + amplitudes[i + 1] * (v - speeds[i])) / (speeds[i + 1] - speeds[i])
    nearest = 0 if v < speeds[0] else len(speeds) - 1 if v > speeds[-1] else None
    return np.maximum(line, 0) * spectra.signs[j], int(np.count_nonzero(line < 0)), nearest


def stimulus(spectra: CrinkleSpectra, *, speed_mm_s: float, output_rate_hz: int) -> Exact:
    """Return the stimulus of equations (3) to (5) at one speed and output rate."""
    wanted, floored, nearest = spectrum_at(spectra, speed_mm_s)
    # N F' / F samples fill the recording's time; bins below that number lie below half the output rate.
    places = Fraction(spectra.samples * output_rate_hz, spectra.rate_hz)
    carried = min(wanted.size, ceil(places))
    bins = slice(1, carried)
    length = _length(wanted[bins])
    if nearest is not None:
        length = max(length, _length(spectra.amplitudes[nearest, bins].astype(np.longdouble)))
    return _exact(spectra, wanted[:carried], length, places, floored, extrapolated=nearest is not None)


def voltages(
    spectra: CrinkleSpectra,
    *,
    speed_mm_s: float,
    output_rate_hz: int,
    response: Response,
    gain_limit_v_per_m_s2: float,
    scale: float,
) -> Exact:
    """Return the voltages of equation (7) for a stimulus that is taken down by `scale`; samples and scale are in V.

    W(f, a) sums the segments between levels; bins count as measured by `shaping.at_bins`.
    """
    wanted, floored, nearest = spectrum_at(spectra, speed_mm_s)
    places = Fraction(spectra.samples * output_rate_hz, spectra.rate_hz)
    carried = min(wanted.size, ceil(places))
    k, table_hz = np.arange(carried), response.frequencies_hz
    in_float64 = k * (spectra.rate_hz / (2 * spectra.samples))
    measured = np.flatnonzero((k > 0) & (table_hz[0] <= in_float64) & (in_float64 <= table_hz[-1]))
    f = measured.astype(np.longdouble) * spectra.rate_hz / (2 * spectra.samples)
    above = np.clip(np.searchsorted(table_hz, f, side="left"), 1, table_hz.size - 1)
    before_hz, after_hz = (table_hz[row].astype(np.longdouble) for row in (above - 1, above))
    before, after = (response.accelerations_m_s2[row].astype(np.longdouble).T for row in (above - 1, above))
    reached = (before * (after_hz - f) + after * (f - before_hz)) / (after_hz - before_hz)
    a = np.abs(wanted[measured]) * np.longdouble(scale)
    volts, bottom, bottom_v = np.zeros_like(a), np.zeros_like(a), np.longdouble(0)
    for top, top_v in zip(reached, response.levels_v.astype(np.longdouble), strict=True):
        passed = np.divide(a - bottom, top - bottom, out=np.where(a > bottom, 1.0, 0.0).astype(a.dtype), where=top > 0)
        volts += (top_v - bottom_v) * np.clip(passed, 0, 1)
        bottom, bottom_v = top, top_v
    signed = np.zeros(carried, dtype=np.longdouble)
    signed[measured] = np.minimum(volts, a * np.longdouble(gain_limit_v_per_m_s2)) * np.sign(wanted[measured])
    return _exact(spectra, signed, _length(signed), places, floored, extrapolated=nearest is not None)


def _exact(
    of: CrinkleSpectra, bins: Extended, length: np.longdouble, places: Fraction, floored: int, *, extrapolated: bool
) -> Exact:
    """Return the samples of these bins, a vector of this `length`, at `places` samples in the recording's time."""
    scale, dropped = length / np.sqrt(np.longdouble(2)), max(0, of.samples - ceil(places))
    return Exact(_inverse(bins, places), scale, floored, extrapolated, dropped, of.samples)


def error(made: NDArray[np.float64], exact: Exact) -> np.longdouble:
    """Return the rms of the difference from the exact samples, in their unit."""
    return np.longdouble(_length(made - exact.samples) / np.sqrt(np.longdouble(made.size)))


def term_by_term(coefficients: ArrayLike, *, numerators: ArrayLike, denominator: int) -> Extended:
    """Return equation (5), sum_{k=1} C_k cos(pi k m / d), shape (n,), one cosine for each bin and sample.

    `coefficients` are the signed C_k, (K,), `numerators` the whole m, (n,), and `denominator` d.
    """
    c = np.asarray(coefficients, dtype=np.longdouble)[1:]
    phases = np.outer(np.asarray(numerators, dtype=np.int64), np.arange(1, c.size + 1, dtype=np.int64))
    phases %= 2 * denominator
    terms = np.cos(phases.astype(np.longdouble) * (PI / denominator))
    return np.asarray(terms @ c)


def forward(samples: ArrayLike) -> Extended:
    """Return equation (1) as printed: C_k = (2/N) sum_i y_i cos(pi k (i + 1/2) / N), shape (N,)."""
    y = np.asarray(samples, dtype=np.longdouble)
    n = y.size
    phases = np.outer(np.arange(n, dtype=np.int64), 2 * np.arange(n, dtype=np.int64) + 1) % (4 * n)
    return np.asarray(np.cos(phases.astype(np.longdouble) * (PI / (2 * n))) @ y * 2 / n)


def answered_m_s2(frequencies_hz: NDArray[np.float64], voltages_v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return A(f, e) = G(f) E asinh(e / E): a SIMULATED panel on springs, whose resonance saturates softly."""
    return np.asarray(_gain(frequencies_hz) * SOFT_V * np.arcsinh(voltages_v / SOFT_V))


def voltage_v(frequencies_hz: NDArray[np.float64], wanted_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return W(f, a) of equation (7) in closed form: the inverse of `answered_m_s2`."""
    return np.asarray(SOFT_V * np.sinh(wanted_m_s2 / (SOFT_V * _gain(frequencies_hz))))


def octave_deviations_db(samples: NDArray[np.float64], *, rate_hz: int, db_per_octave: float) -> NDArray[np.float64]:
    """Return the deviation of each octave band of periodic noise from its color, dB relative to that at 1 kHz.

    Shape (10,), 31.5 Hz to 16 kHz (IEC 61260-1), minus infinity without a bin. `db_per_octave` is 0 for pink noise, 10
    log10(10^0.3) for white.
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
    """Return the Euclidean length, safe where extended precision has no more exponents than a float64."""
    largest = np.max(np.abs(values), initial=0)
    return np.longdouble(0) if largest == 0 else np.longdouble(largest * np.sqrt(np.sum((values / largest) ** 2)))


def _gain(frequencies_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    low, part = frequencies_hz / SUSPENSION_HZ, frequencies_hz / PEAK_HZ
    passed = low**2 / np.hypot(1 - low**2, 2 * SUSPENSION_DAMPING * low)
    return np.asarray(GAIN_M_S2_PER_V * passed / np.hypot(1 - part**2, 2 * DAMPING * part))


def _inverse(coefficients: Extended, places: Fraction) -> Extended:
    p, q = places.numerator, places.denominator
    padded = np.zeros(p, dtype=np.longdouble)
    padded[q : coefficients.size * q : q] = coefficients[1:] / 2
    samples: Extended = fft.dct(padded, type=3)[: ceil(places - Fraction(1, 2))]
    return samples


@dataclass(frozen=True)
class ExactImpact:
    """A mass thrown back by a spring and a damper whose force never pulls: s, m/s and m; what is left of its energy."""

    release_s: np.longdouble
    rebound_m_s: np.longdouble
    penetration_m: np.longdouble
    kept: np.longdouble


def impact(*, stiffness: float, damping_ratio: float, mass: float, speed: float) -> ExactImpact:
    """Return the closed form of an impact, N/m, kg and m/s; C is the float64 that is nearest to 2 z sqrt(K M).

    With phi = acos z and w = sqrt(K / M), release is at 2 phi / (w sin phi), and the rebound v exp(-2 z phi / sin phi);
    above critical damping phi = acosh z, and its hyperbolic sine. The deepest place is at half that time, by dr/dt = 0.
    """
    k, m, v = np.longdouble(stiffness), np.longdouble(mass), np.longdouble(speed)
    w = np.sqrt(k / m)
    z = np.longdouble(2 * damping_ratio * float(np.sqrt(stiffness * mass))) / (2 * np.sqrt(k * m))
    one = np.longdouble(1)
    if z < one:
        turned = np.arccos(z) / np.sqrt((one - z) * (one + z))
    elif z > one:
        turned = np.arccosh(z) / np.sqrt((z - one) * (z + one))
    else:
        turned = one
    rebound = v * np.exp(-2 * z * turned)
    kept = (rebound / v) ** 2 * (1 + 4 * z * z)
    return ExactImpact(2 * turned / w, rebound, v / w * np.exp(-z * turned), kept)
