"""What an utterance sounds like from moment to moment: mel-frequency cepstral coefficients, in the band of a voice.

The band is 30 Hz to 8 kHz, at 16,000 samples a second, by one Fourier transform without folding or delay. Differences
in time, and subtracting the noise's energies, changed no measured figure.
"""

from functools import lru_cache
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

FRAME, HOP = 400, 160
"""Samples: frames of 25 ms, every 10 ms."""

COEFFICIENTS = 12

_TRANSFORM = 512
_BANDS = 26
_LOWEST_HZ, _HIGHEST_HZ = 100.0, 7200.0
_EMPHASIS = 0.97
"""Of the sample before, taken off every sample: speech falls by 6 dB an octave."""

_FLOOR = 1e-4
"""Of the utterance's largest energy in a band, added to each: 40 dB below it nothing counts, and nothing is 0."""

_NOTHING = 1e-30
"""Added where the whole utterance is 0."""


def cepstra(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of every frame, shape (frames, COEFFICIENTS), of an utterance in the band, shape (n,).

    Frames begin every `HOP` samples, a short one is filled up with zeros. They do not depend on the level.
    """
    x = np.pad(samples, (0, max(FRAME - samples.size, 0)))
    x = np.append(x[:1], x[1:] - _EMPHASIS * x[:-1])
    frames = np.lib.stride_tricks.sliding_window_view(x, FRAME)[::HOP] * np.hamming(FRAME)
    energies = np.abs(fft.rfft(frames, _TRANSFORM)) ** 2 @ _bands().T
    logarithms = np.log(energies + _FLOOR * np.max(energies) + _NOTHING)
    coefficients: NDArray[np.float64] = fft.dct(logarithms, type=2, norm="ortho", axis=1)[:, 1 : COEFFICIENTS + 1]
    coefficients -= np.mean(coefficients, axis=0)
    return coefficients


@lru_cache(maxsize=1)
def _bands() -> NDArray[np.float64]:
    """Return the weight of every bin in every band, shape (_BANDS, bins)."""
    lowest, highest = (2595 * np.log10(1 + f / 700) for f in (_LOWEST_HZ, _HIGHEST_HZ))
    edges = 700 * (10 ** (np.linspace(lowest, highest, _BANDS + 2) / 2595) - 1)
    f = np.arange(_TRANSFORM // 2 + 1) * RATE_HZ / _TRANSFORM
    low, middle, high = edges[:-2, None], edges[1:-1, None], edges[2:, None]
    weights: NDArray[np.float64] = np.clip(np.minimum((f - low) / (middle - low), (high - f) / (high - middle)), 0, 1)
    return weights


def banded(samples: NDArray[np.floating[Any]], *, rate_hz: int) -> NDArray[np.float64]:
    """Return a channel of the stream in the band, any unit, shape (ceil(n RATE_HZ / rate_hz),), for samples of (n,).

    Raises `VoiceError` unless samples are a finite row, and for a rate below `RATE_HZ`.
    """
    x = np.asarray(samples, np.float64)
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise VoiceError("microphone", f"got shape {x.shape}", "check the driver", allowed="one row of finite samples")
    if rate_hz < RATE_HZ:
        raise VoiceError(
            "rate_hz",
            f"got {rate_hz}",
            "correct the rig file",
            allowed=f"{RATE_HZ} Hz or more, because speech reaches 8 kHz",
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
