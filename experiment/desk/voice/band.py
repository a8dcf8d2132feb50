"""The band in which a voice is looked at: up to 8 kHz, at 16,000 samples a second, without what lies below 30 Hz.

One Fourier transform takes the band and its rate at once, so no frequency is folded and nothing is delayed.
"""

from math import gcd
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from palpate.experiment.errors import VoiceError

RATE_HZ = 16_000

_RISES_HZ = (30.0, 90.0)
_FALLS_HZ = (7200.0, 8000.0)
_APART_S = 0.1
"""Silence between end and beginning, which a Fourier transform takes for neighbours."""


def banded(samples: NDArray[np.floating[Any]], *, rate_hz: int) -> NDArray[np.float64]:
    """Return a channel of the stream in the band, any unit, shape (ceil(n RATE_HZ / rate_hz),), for samples of (n,).

    Raises `VoiceError` for anything but a row of finite samples, and for a rate below `RATE_HZ`.
    """
    x = np.asarray(samples, np.float64)
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise VoiceError(f"microphone: got shape {x.shape}; allowed: one row of finite samples; look at the driver")
    if rate_hz < RATE_HZ:
        raise VoiceError(
            f"rate_hz: got {rate_hz}; allowed: {RATE_HZ} Hz or more, for a voice reaches up to 8 kHz; correct the rig "
            "file"
        )
    if not x.size:
        return x
    common = gcd(rate_hz, RATE_HZ)
    up, down = RATE_HZ // common, rate_hz // common
    kept = -(-x.size * up // down)
    blocks = fft.next_fast_len(-(-(x.size + round(_APART_S * rate_hz)) // down), real=True)
    made = blocks * up
    f = np.arange(made // 2 + 1) * RATE_HZ / made
    passed = _raised((f - _RISES_HZ[0]) / np.diff(_RISES_HZ)) * _raised((_FALLS_HZ[1] - f) / np.diff(_FALLS_HZ))
    # What a microphone adds that is constant would end in a step, which reaches into the band.
    bins = fft.rfft(x - np.mean(x), blocks * down)[: f.size] * passed
    wave: NDArray[np.float64] = fft.irfft(bins, made)[:kept]
    return wave * (up / down)


def _raised(part: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(part, 0.0, 1.0))
