"""Equations (3) to (5) transcribed, (3) and (4) in whole numbers and (5) in extended precision: the suite's oracle.

It shares no line with `analysis/numerics/oracle.py`, the product's, so that each can judge the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.numerics.cases import Way
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.waveforms import denormal_error_m_s2

Extended = NDArray[np.longdouble]

SHIFT = 1074
"""Every float64 is a whole multiple of 2^-1074."""


@dataclass(frozen=True)
class Exact:
    """What a method should return.

    Attributes:
        samples: shape (speeds, n).
        scale: what an error is divided by: the rms of the spectrum, in extrapolation at least that of the nearest.
        floored: bins that the line would make negative, at each speed.
    """

    samples: Extended
    scale: Extended
    floored: list[int]


@lru_cache(maxsize=64)
def _basis(n: int, rate_hz: int, output_rate_hz: int, places: tuple[int, ...] | None) -> Extended:
    """cos(2 pi f_k t_i) at t = (i + 1/2) / F' while t < N / F, bins 1 to N - 1 below F' / 2; shape (bins, samples)."""
    count = 0
    while (2 * count + 1) * rate_hz < 2 * n * output_rate_hz:
        count += 1
    odd = [2 * i + 1 for i in (range(count) if places is None else places)]
    bins = [k for k in range(1, n) if k * rate_hz < n * output_rate_hz]
    half_turns = 2 * n * output_rate_hz
    # 2 f_k t_i half turns are k F (2i + 1) / (2 N F'), reduced to less than two of them in whole numbers.
    phases = [[(k * rate_hz * m) % (2 * half_turns) for m in odd] for k in bins]
    pi = np.longdouble("3.14159265358979323846264338327950288")
    angles = np.array(phases, dtype=np.longdouble).reshape(len(bins), len(odd)) * (pi / half_turns)
    return np.asarray(np.cos(angles))


def _whole(value: float) -> int:
    """A float64 in units of the smallest there is, without rounding."""
    numerator, denominator = float(value).as_integer_ratio()
    return numerator * ((1 << SHIFT) // denominator)


def spectrum_at(s: CrinkleSpectra, v: float) -> tuple[Extended, int, int | None]:
    """C'_k(v) of (3) and (4) in whole numbers, how many bins were floored, and the nearest speed in extrapolation.

    No rounding, but in the sign's tie, which `at_speed` defines in float64, and in the last step.
    """
    speeds = [float(one) for one in s.speeds_mm_s]
    gaps = [(speeds[n], speeds[n + 1]) for n in range(len(speeds) - 1)]
    place = next((n for n, (_, faster) in enumerate(gaps) if v < faster), len(gaps) - 1)
    slower, faster = gaps[place]
    towards_faster = v - slower > faster - v
    after, before, gap = _whole(v) - _whole(slower), _whole(faster) - _whole(v), _whole(faster) - _whole(slower)
    floored, bins = 0, []
    signs = s.signs[place + towards_faster]
    for at_slower, at_faster, sign in zip(s.amplitudes[place], s.amplitudes[place + 1], signs, strict=True):
        height = _whole(at_slower) * before + _whole(at_faster) * after
        if height < 0:
            floored, height = floored + 1, 0
        rounded = height / (gap << SHIFT)
        rest = (height - _whole(rounded) * gap) / (gap << SHIFT)
        bins.append((np.longdouble(rounded) + np.longdouble(rest)) * np.longdouble(sign))
    outside = 0 if v < speeds[0] else len(speeds) - 1 if v > speeds[-1] else None
    return np.array(bins, dtype=np.longdouble), floored, outside


def exact(
    s: CrinkleSpectra, speeds_mm_s: list[float], output_rate_hz: int, places: tuple[int, ...] | None = None
) -> Exact:
    """The stimulus at each speed, all samples or those at `places`."""
    basis = _basis(s.samples, s.rate_hz, output_rate_hz, places)
    bins = slice(1, basis.shape[0] + 1)
    made = [spectrum_at(s, v) for v in speeds_mm_s]
    wanted = np.array([c[bins] for c, _, _ in made], dtype=np.longdouble)
    last = np.array([np.zeros(wanted.shape[1]) if o is None else s.amplitudes[o, bins] for _, _, o in made])
    scale = np.sqrt(np.maximum((wanted**2).sum(axis=1), (last.astype(np.longdouble) ** 2).sum(axis=1)) / 2)
    return Exact(samples=wanted @ basis[: wanted.shape[1]], scale=scale, floored=[f for _, f, _ in made])


def worst_excess(
    way: Way, s: CrinkleSpectra, speeds_mm_s: list[float], output_rate_hz: int, wanted: Exact | None = None
) -> float:
    """Largest relative error of a way over speeds, divided by the bound that it claims; 1 is just kept."""
    wanted = wanted or exact(s, speeds_mm_s, output_rate_hz)
    render, _ = way.prepare(s, output_rate_hz)
    made = np.array([render(v) for v in speeds_mm_s], dtype=np.longdouble)
    assert made.shape == wanted.samples.shape
    error = np.sqrt(((made - wanted.samples) ** 2).mean(axis=1))
    claim = way.claim(s.grid(output_rate_hz))
    return float(np.max(error / (claim * wanted.scale + np.longdouble(denormal_error_m_s2(s.samples)))))


def random_spectra(
    rng: np.random.Generator, *, speeds: int, bins: int, rate_hz: int = 50, v: NDArray[np.float64] | None = None
) -> CrinkleSpectra:
    """Random spectra of any level and density, some bins falling to zero."""
    level = 10.0 ** rng.uniform(-3, 3, size=(speeds, 1)) if rng.random() < 0.5 else 1.0
    amplitudes = level * np.abs(rng.normal(size=(speeds, bins)))
    amplitudes *= rng.random(amplitudes.shape) < rng.uniform(0.2, 1.5)
    return CrinkleSpectra(
        speeds_mm_s=np.cumsum(rng.uniform(1.0, 100.0, speeds)) if v is None else v,
        rate_hz=rate_hz,
        amplitudes=amplitudes,
        signs=rng.choice([-1.0, 1.0], size=(speeds, bins)),
    )
