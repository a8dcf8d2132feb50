"""Multisines: what is played, and the response that is computed from it, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel import multisine
from palpate.experiment.apparatus.panel.multisine import Estimate, Level

RATE_HZ = 5000
LINES_HZ = multisine.lines(RATE_HZ)
WITHIN = (LINES_HZ >= 10) & (LINES_HZ <= 500)


def resonance(lines_hz: NDArray[np.int64]) -> NDArray[np.complex128]:
    """A seismic mass of 100 Hz: minimum phase."""
    part = 1j * lines_hz / 100.0
    return np.asarray(50.0 * part**2 / (1 + 0.2 * part + part**2))


def estimated(
    response: NDArray[np.complex128], *, noise_m_s2: float, drift_ppm: float = 0.0, follows: bool = True, seed: int = 0
) -> Estimate:
    """What is estimated of four levels, each late by another delay; another panel's multisine does not follow."""
    rng = np.random.default_rng(seed)
    levels = []
    foreign = multisine.drawn(LINES_HZ, rate_hz=RATE_HZ, rng=rng) * 0.2
    for peak in (0.05, 0.1, 0.2, 0.2):
        played = multisine.drawn(LINES_HZ, rate_hz=RATE_HZ, rng=rng) * peak
        late_s = rng.uniform(0, 0.4) + 1e-6 * drift_ppm * np.arange(8)[:, None]
        heard = response * (played if follows else foreign) * np.exp(-2j * np.pi * LINES_HZ * late_s)
        noise = rng.normal(0, noise_m_s2, (2, *heard.shape))
        levels.append(Level(played, heard + noise[0] + 1j * noise[1]))
    return multisine.estimate(levels, LINES_HZ, WITHIN)


def test_a_multisine_repeats_each_second_and_peaks_at_one() -> None:
    played = multisine.drawn(LINES_HZ, rate_hz=RATE_HZ, rng=np.random.default_rng(1))
    second = multisine.period(played, LINES_HZ, rate_hz=RATE_HZ)
    assert second.shape == (RATE_HZ,)
    assert np.abs(second).max() == pytest.approx(1.0)
    assert LINES_HZ[0] == 5
    assert LINES_HZ[-1] <= 0.4 * RATE_HZ
    found = multisine.spectra(np.tile(second, 2), LINES_HZ, rate_hz=RATE_HZ)
    assert found == pytest.approx(np.stack([played, played]), abs=1e-12)


def test_without_noise_the_response_is_that_of_the_panel() -> None:
    found = estimated(resonance(LINES_HZ), noise_m_s2=0.0, drift_ppm=50.0)
    off = found.response_m_s2 / resonance(LINES_HZ)
    assert np.abs(np.abs(off) - 1).max() < 1e-6
    # A delay cannot be known; what is left of one is small.
    assert np.abs(np.degrees(np.angle(off[WITHIN]))).max() < 3
    assert found.drift_ppm == pytest.approx(50.0, abs=1e-3)
    assert found.coherence.min() > 1 - 1e-9
    assert found.gains == pytest.approx((1.0,) * 4)


def test_the_standard_error_is_what_it_is_off_by() -> None:
    squares = []
    for seed in range(5):
        found = estimated(resonance(LINES_HZ), noise_m_s2=0.02, seed=seed)
        off = np.abs(found.response_m_s2) - np.abs(resonance(LINES_HZ))
        squares.append(np.square(off / found.standard_error_m_s2))
    assert 0.25 < float(np.mean(squares)) < 1.3


def test_what_another_panel_plays_does_not_cohere() -> None:
    assert np.median(estimated(resonance(LINES_HZ), noise_m_s2=0.0, follows=False).coherence) < 0.5


def test_a_soft_panel_has_its_gain_for_a_small_drive_beside_those_of_the_levels() -> None:
    rms, gains = [0.1, 0.2, 0.4], [0.99, 0.96, 0.84]
    assert multisine.relative_gains(rms, [3 * gain for gain in gains]) == pytest.approx(tuple(gains))


@pytest.mark.parametrize("poles", [1, 2])
def test_the_least_phase_of_low_passes_is_theirs(poles: int) -> None:
    response = 1 / (1 + 1j * LINES_HZ / 100.0) ** poles
    off = np.angle(response / np.exp(1j * multisine.minimum_phase(LINES_HZ, np.abs(response))))
    assert np.abs(np.degrees(off)).max() < 2.5


def test_the_least_phase_of_a_pure_slope_is_exact() -> None:
    assert multisine.minimum_phase(LINES_HZ, LINES_HZ.astype(np.float64) ** 2) == pytest.approx(np.pi, abs=1e-9)


def test_the_stretch_with_the_most_power_is_found() -> None:
    record = np.concatenate([np.zeros(300), np.resize([1.0, -1.0], 500), np.zeros(99)])
    assert multisine.begins(record, 500) == 300
