"""Cepstra against sums over bins, bands and coefficients as the textbook prints them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.desk.voice.features import COEFFICIENTS, cepstra


def by_sums(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Davis and Mermelstein by loops: 25 ms every 10 ms, 26 bands of 100 to 7200 Hz, coefficients 1 to 12."""
    emphasised = [float(samples[0])] + [float(b - 0.97 * a) for a, b in pairwise(samples)]
    frames = [emphasised[i : i + 400] for i in range(0, len(emphasised) - 399, 160)]
    window = [0.54 - 0.46 * math.cos(2 * math.pi * n / 399) for n in range(400)]

    def mel(f: float) -> float:
        return 2595 * math.log10(1 + f / 700)

    edges = [700 * (10 ** ((mel(100) + i * (mel(7200) - mel(100)) / 27) / 2595) - 1) for i in range(28)]
    n = np.arange(400)
    energies = []
    for frame in frames:
        tapered = np.array(frame) * window
        power = [abs(np.sum(tapered * np.exp(-2j * np.pi * k * n / 512))) ** 2 for k in range(257)]
        row = []
        for low, middle, high in zip(edges, edges[1:], edges[2:], strict=False):
            band = 0.0
            for k, each in enumerate(power):
                f = k * 16_000 / 512
                if low < f <= middle:
                    band += each * (f - low) / (middle - low)
                elif middle < f < high:
                    band += each * (high - f) / (high - middle)
            row.append(band)
        energies.append(row)
    floor = 1e-4 * max(max(row) for row in energies)
    found = [
        [
            math.sqrt(2 / 26)
            * sum(math.log(e + floor) * math.cos(math.pi * q * (m + 0.5) / 26) for m, e in enumerate(row))
            for q in range(1, 13)
        ]
        for row in energies
    ]
    return np.asarray(np.array(found) - np.mean(found, axis=0))


def speech_like(samples: int, seed: int = 0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / 16_000
    return (
        np.sin(2 * np.pi * (300 + 900 * t) * t)
        + 0.3 * np.sin(2 * np.pi * 2500 * t**1.5)
        + 0.05 * rng.normal(size=samples)
    )


@pytest.mark.parametrize("samples", [400, 559, 560, 2000])
def test_they_are_those_of_the_textbook(samples: int) -> None:
    made = speech_like(samples)
    assert cepstra(made) == pytest.approx(by_sums(made), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("scale", [1e-6, -3.0, 1e6])
def test_loudness_does_not_matter(scale: float) -> None:
    made = speech_like(3000)
    assert cepstra(scale * made) == pytest.approx(cepstra(made), rel=1e-9, abs=1e-9)


def test_another_microphone_hardly_matters() -> None:
    """A response that is smooth within bands adds a constant to every frame, which its mean takes off."""
    made = speech_like(8000)
    coloured = np.convolve(made, [1.0, 0.5])[: made.size]
    apart = np.linalg.norm(cepstra(coloured) - cepstra(made), axis=1)
    other = np.linalg.norm(cepstra(speech_like(8000)[::-1].copy()) - cepstra(made), axis=1)
    assert np.median(apart) < 0.1 * np.median(other)


@pytest.mark.parametrize("samples", [0, 1, 2, 399])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_too_short_silent_and_constant_sounds_have_finite_ones(samples: int, value: float) -> None:
    found = cepstra(np.full(samples, value))
    assert found.shape == (1, COEFFICIENTS)
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize("made", [np.zeros(5000), np.ones(5000), np.full(5000, 1e150), np.eye(1, 5000, 2500)[0]])
def test_extreme_sounds_have_finite_ones(made: NDArray[np.float64]) -> None:
    assert np.all(np.isfinite(cepstra(made)))
