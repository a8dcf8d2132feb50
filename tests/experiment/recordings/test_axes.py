"""Several axes as one: a naive transform after Landin et al. (2010), powers, and what a norm does to one axis."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from palpate.experiment.recordings.series.axes import dft321, norm


def _naive(axes: list[list[float]]) -> list[float]:
    """Transcribe equations 1 to 3 of the source, bin by bin, for an odd number of samples."""
    n = len(axes[0])
    made = [0j] * n
    for k in range(n):
        bins = [sum(x * cmath.exp(-2j * math.pi * k * i / n) for i, x in enumerate(axis)) for axis in axes]
        if k:
            made[k] = cmath.rect(math.sqrt(sum(abs(one) ** 2 for one in bins)), cmath.phase(sum(bins)))
    return [sum(made[k] * cmath.exp(2j * math.pi * k * i / n) for k in range(n)).real / n for i in range(n)]


def test_one_signal_has_the_power_of_all_axes_and_the_phase_of_their_sum() -> None:
    axes = np.random.default_rng(1).normal(size=(3, 41))
    made = dft321(axes)
    assert made == pytest.approx(_naive(axes.tolist()), abs=1e-12)
    centred = axes - axes.mean(axis=1, keepdims=True)
    assert float(made @ made) == pytest.approx(float((centred**2).sum()))


def test_gravity_counts_for_nothing_and_one_axis_alone_stays_as_it_is() -> None:
    wave = np.sin(np.arange(64) * 0.3) - np.sin(np.arange(64) * 0.3).mean()
    axes = np.stack([wave, np.full(64, 9.81), np.zeros(64)])
    assert dft321(axes) == pytest.approx(wave, abs=1e-12)
    assert norm(axes) == pytest.approx(np.abs(wave), abs=1e-12)
