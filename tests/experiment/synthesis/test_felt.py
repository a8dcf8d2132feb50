"""Third octaves and envelope of a movement beside what was asked for, by closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.synthesis.felt import felt, felt_between

RATE_HZ = 5000
T = np.arange(2500) / RATE_HZ
TONE = np.sin(2 * np.pi * 100 * T)


@pytest.mark.parametrize("gain", [0.5, 1.0, 2.0])
def test_a_gain_is_that_many_decibels_in_both(gain: float) -> None:
    found = felt(TONE, np.pad(gain * TONE, (0, 1000)), rate_hz=RATE_HZ)
    decibels = abs(20 * np.log10(gain))
    assert (found.third_octave_db, found.envelope_db) == pytest.approx((decibels, decibels), abs=1e-9)


def test_a_third_octave_alone_and_a_stretch_in_time_alone() -> None:
    other = 0.5 * np.sin(2 * np.pi * 300 * T)
    spectral = felt(TONE + other, TONE + 2 * other, rate_hz=RATE_HZ)
    assert spectral.third_octave_db == pytest.approx(20 * np.log10(2), abs=0.05)
    # 1 + 1 / 4 parts of energy become 1 + 1.
    assert spectral.envelope_db == pytest.approx(10 * np.log10(2 / 1.25), abs=0.01)
    softer = TONE.copy()
    softer[1000:1100] *= 0.5
    assert felt(TONE, softer, rate_hz=RATE_HZ).envelope_db == pytest.approx(20 * np.log10(2), abs=1e-9)
    assert felt(np.zeros(2500), np.zeros(2600), rate_hz=RATE_HZ).third_octave_db == 0.0


def test_a_coil_between_two_may_err_less_than_either() -> None:
    """Half of the time is 3 dB too loud and half 1 dB too soft; a coil that takes 4 dB makes these -1 and -5 dB."""
    linear = TONE * 10 ** (np.repeat([3.0, -1.0], 1250) / 20)
    found = felt_between(TONE, linear, linear * 10**-0.2, rate_hz=RATE_HZ, drift_db=0.25)
    assert found.envelope_db == pytest.approx(3.0)
    assert found.envelope_between_db == pytest.approx((0.75, 5.25))
    between = [felt(TONE, linear * 10 ** (-db / 20), rate_hz=RATE_HZ).envelope_db for db in (0.0, 1.0, 2.0, 4.0)]
    assert between == pytest.approx([3.0, 2.0, 3.0, 5.0])
