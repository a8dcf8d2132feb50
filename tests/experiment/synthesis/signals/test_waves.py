"""Declared waves against their closed forms, transcribed anew, and their moments."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.signals import waves
from palpate.experiment.synthesis.signals.waves import times

RATE_HZ = 4000
AT = times(0.5, RATE_HZ)


def test_a_sinusoid_and_one_that_fades_are_those_of_their_formulas() -> None:
    plain = waves.sinusoid(AT, frequency_hz=60.0, amplitude_m_s2=3.0)
    fading = waves.decaying(AT, frequency_hz=60.0, amplitude_m_s2=3.0, decay_per_s=40.0)
    assert plain.size == fading.size == 2000
    for i in (0, 1, 17, 1999):
        t = i / RATE_HZ
        assert plain[i] == pytest.approx(3 * math.sin(2 * math.pi * 60 * t), abs=1e-12)
        assert fading[i] == pytest.approx(3 * math.exp(-40 * t) * math.sin(2 * math.pi * 60 * t), abs=1e-12)


@pytest.mark.parametrize(
    ("by_ratio", "middle_hz"), [(False, (50 + 800) / 2), (True, math.sqrt(50 * 800))], ids=["evenly", "by octaves"]
)
def test_the_frequency_of_a_sweep_is_where_it_is_said_to_be(by_ratio: bool, middle_hz: float) -> None:
    """Turns between two neighbours in time, of the arcsine's derivative, around the middle and at both ends."""
    fine = times(0.5, 1_000_000)
    wave = waves.sweep(fine, from_hz=50.0, to_hz=800.0, amplitude_m_s2=1.0, by_ratio=by_ratio)
    assert wave[0] == 0
    crossed_s = fine.at[1:][np.signbit(wave[1:]) != np.signbit(wave[:-1])]
    periods_hz = 0.5 / np.diff(crossed_s)
    middle = np.argmin(np.abs(crossed_s - 0.25))
    assert periods_hz[middle] == pytest.approx(middle_hz, rel=0.02)
    assert periods_hz[-1] == pytest.approx(800, rel=0.02)


def test_a_burst_of_noise_has_its_rms_its_band_and_its_seed() -> None:
    burst = waves.band_noise(AT, low_hz=50.0, high_hz=400.0, rms_m_s2=1.5, seed=3)
    assert math.sqrt(np.mean(burst**2)) == pytest.approx(1.5, rel=1e-12)
    power = np.abs(np.fft.rfft(burst)) ** 2
    inside = slice(25, 201)
    assert power[inside].sum() == pytest.approx(power.sum(), rel=1e-12)
    assert np.ptp(power[inside]) < 1e-9 * power.max()
    finer = waves.band_noise(times(0.5, 3 * RATE_HZ), low_hz=50.0, high_hz=400.0, rms_m_s2=1.5, seed=3)
    np.testing.assert_allclose(finer[::3], burst, atol=1e-12)
    assert not np.allclose(burst, waves.band_noise(AT, low_hz=50.0, high_hz=400.0, rms_m_s2=1.5, seed=4), atol=0.1)


def test_a_band_without_a_whole_period_is_refused() -> None:
    with pytest.raises(SynthesisError):
        waves.band_noise(times(0.1, RATE_HZ), low_hz=101.0, high_hz=109.0, rms_m_s2=1.0, seed=1)


def test_a_train_has_as_many_whole_pulses_as_end_in_time() -> None:
    train = waves.pulses(times(0.245, RATE_HZ), every_s=0.05, cycle_hz=200.0, amplitude_m_s2=2.0)
    one = [2 * math.sin(2 * math.pi * 200 * i / RATE_HZ) for i in range(20)]
    for k in range(4):
        np.testing.assert_allclose(train[200 * k : 200 * k + 20], one, atol=1e-9)
        assert np.abs(train[200 * k + 20 : 200 * (k + 1)]).max() < 1e-9
    np.testing.assert_allclose(train[800:820], one, atol=1e-9)
    late = waves.pulses(times(0.204, RATE_HZ), every_s=0.05, cycle_hz=200.0, amplitude_m_s2=2.0)
    assert np.abs(late[800:]).max() < 1e-9


def test_ramps_are_raised_cosines_at_both_ends() -> None:
    ramped = waves.ramped(np.ones(400), rate_hz=RATE_HZ, ramp_s=0.02)
    assert ramped[[0, 40, 80, 200, 320, 360]] == pytest.approx([0, 0.5, 1, 1, 1, 0.5])
    assert waves.ramped(AT.at, rate_hz=RATE_HZ, ramp_s=0.0) is AT.at
    gapped = waves.joined([np.ones(2), waves.silence(times(0.0005, RATE_HZ)), np.ones(1)])
    assert gapped.tolist() == [1, 1, 0, 0, 1]
