"""The band against sinusoids in closed form, at the rates of audio devices."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.desk.voice.features import RATE_HZ, banded
from palpate.experiment.errors import VoiceError


@pytest.mark.parametrize("rate_hz", [16_000, 22_050, 44_100, 48_000, 96_000, 192_000])
@pytest.mark.parametrize("frequency_hz", [100.0, 1000.0, 7000.0])
def test_a_sinusoid_in_the_band_keeps_amplitude_and_phase(rate_hz: int, frequency_hz: float) -> None:
    t = np.arange(rate_hz) / rate_hz
    found = banded(np.sin(2 * np.pi * frequency_hz * t), rate_hz=rate_hz)
    assert found.shape == (RATE_HZ,)
    inside = slice(RATE_HZ // 4, 3 * RATE_HZ // 4)
    wanted = np.sin(2 * np.pi * frequency_hz * np.arange(RATE_HZ) / RATE_HZ)
    assert np.max(np.abs(found - wanted)[inside]) < 5e-3


@pytest.mark.parametrize("frequency_hz", [0.0, 10.0, 8500.0, 12_000.0, 17_000.0])
def test_what_lies_outside_is_neither_kept_nor_folded(frequency_hz: float) -> None:
    t = np.arange(96_000) / 48_000
    found = banded(np.cos(2 * np.pi * frequency_hz * t), rate_hz=48_000)
    assert np.max(np.abs(found[8000:-8000])) < 5e-3


@pytest.mark.parametrize("samples", [0, 1, 2, 3, 100, 4799])
def test_the_length_is_that_of_the_same_time(samples: int) -> None:
    found = banded(np.ones(samples), rate_hz=48_000)
    assert found.shape == (-(-samples // 3),)
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize(
    ("samples", "rate_hz", "message"),
    [
        (np.array([0.0, np.nan]), 48_000, r"got shape \(2,\); allowed: one row of finite samples"),
        (np.array([0.0, np.inf]), 48_000, "finite samples"),
        (np.zeros((2, 2)), 48_000, r"got shape \(2, 2\)"),
        (np.zeros(8), 8000, "rate_hz: got 8000; allowed: 16000 Hz or more"),
    ],
)
def test_what_is_no_channel_is_refused(samples: np.ndarray, rate_hz: int, message: str) -> None:
    with pytest.raises(VoiceError, match=message):
        banded(samples, rate_hz=rate_hz)
