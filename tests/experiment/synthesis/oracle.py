"""Equations (3) to (5) transcribed in extended precision: the oracle of every way to compute a stimulus."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.first_block import FirstBlockRenderer
from experiment.synthesis.methods import Method, denormal_error_m_s2

Extended = NDArray[np.longdouble]


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
    pi = 4 * np.arctan(np.longdouble(1))
    count = 0
    while (2 * count + 1) * rate_hz < 2 * n * output_rate_hz:
        count += 1
    i = np.arange(count) if places is None else np.array(places)
    k = np.array([k for k in range(1, n) if k * rate_hz < n * output_rate_hz], dtype=np.longdouble)
    t = (i + np.longdouble(0.5)) / output_rate_hz
    return np.asarray(np.cos(pi * np.outer(k * rate_hz / n, t)))


def spectrum_at(s: CrinkleSpectra, v: float) -> tuple[Extended, int, int | None]:
    """C'_k(v) of (3) and (4), how many bins were floored, and the nearest speed's place in extrapolation."""
    speeds, amplitudes = s.speeds_mm_s.astype(np.longdouble), s.amplitudes.astype(np.longdouble)
    i = 0 if v < speeds[0] else max(n for n in range(len(speeds) - 1) if speeds[n] <= v)
    j = i if v - s.speeds_mm_s[i] <= s.speeds_mm_s[i + 1] - v else i + 1
    x = np.longdouble(v)
    line = (amplitudes[i] * (speeds[i + 1] - x) + amplitudes[i + 1] * (x - speeds[i])) / (speeds[i + 1] - speeds[i])
    outside = 0 if v < speeds[0] else len(speeds) - 1 if v > speeds[-1] else None
    return np.maximum(line, 0) * s.signs[j], int(np.sum(line < 0)), outside


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
    method: Method, s: CrinkleSpectra, speeds_mm_s: list[float], output_rate_hz: int, wanted: Exact | None = None
) -> float:
    """Largest relative error of a method over speeds, divided by the bound that it claims; 1 is just kept.

    The first block, where there is one, counts by the bound claimed for it.
    """
    wanted = wanted or exact(s, speeds_mm_s, output_rate_hz)
    render = method.prepare(s, output_rate_hz=output_rate_hz)
    claims = method.estimate(s, output_rate_hz=output_rate_hz)
    made = np.array([render(v).waveform_m_s2 for v in speeds_mm_s], dtype=np.longdouble)
    assert made.shape == wanted.samples.shape
    excess = _excess(made, wanted.samples, claims.relative_error, wanted.scale, s.samples)
    if claims.first_block_error is None:
        return excess
    assert isinstance(render, FirstBlockRenderer)
    first = np.array([render.begin(v).first_m_s2 for v in speeds_mm_s], dtype=np.longdouble)
    block = wanted.samples[:, : first.shape[1]]
    return max(excess, _excess(first, block, claims.first_block_error, wanted.scale, s.samples))


def _excess(made: Extended, wanted: Extended, claim: float, scale: Extended, samples: int) -> float:
    error = np.sqrt(((made - wanted) ** 2).mean(axis=1))
    return float(np.max(error / (claim * scale + np.longdouble(denormal_error_m_s2(samples)))))


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
