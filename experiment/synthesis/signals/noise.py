"""Noise with an exact spectrum, which masks the sound of the stimuli.

Each bin of an inverse FFT gets the colour's amplitude and a random phase, so the samples are nearly normal and loop
without a seam.
"""

from math import inf
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError

Colour = Literal["pink", "white"]
"""Power that falls as 1/f, equal in every octave; or power that is equal in every hertz."""

LOWEST_HZ = 20.0
"""Nothing sounds below: headphones would spend excursion on what masks nothing."""

CLAIMED_DB, CLAIMED_FROM_S = 0.5, 0.5
"""How far an octave band from 31.5 Hz to 16 kHz is from its colour at most, and from which length of noise on."""


def noise(*, colour: Colour, samples: int, rate_hz: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return noise of mean 0 and rms 1 from `LOWEST_HZ` to half the sampling rate, shape (n,); `rng` draws the phases.

    n is `samples`. At rates from 44.1 kHz octave bands are within `CLAIMED_DB` of their colour for `CLAIMED_FROM_S` or
    more. Raises `SynthesisError` for an unknown colour, a rate below 4 `LOWEST_HZ`, or less than a period of that.
    """
    if colour not in get_args(Colour):
        raise SynthesisError(f"colour: got {colour!r}; allowed: {' or '.join(get_args(Colour))}; correct the protocol")
    if not 4 * LOWEST_HZ <= rate_hz < inf:
        raise SynthesisError(
            f"rate_hz: got {rate_hz}; allowed: {4 * LOWEST_HZ:g} Hz or more, an octave above the lowest frequency; "
            "correct the rig file"
        )
    shortest = int(np.ceil(rate_hz / LOWEST_HZ))
    if not shortest <= samples < inf:
        raise SynthesisError(
            f"samples: got {samples}; allowed: {shortest} or more at {rate_hz} Hz, a period of {LOWEST_HZ:g} Hz; "
            "request longer noise"
        )
    k = np.arange(samples // 2 + 1)
    # A bin at exactly half the rate has no phase to draw; without it every bin has the amplitude asked for.
    sounding = (k * rate_hz >= LOWEST_HZ * samples) & (2 * k < samples)
    amplitudes = np.zeros(k.size)
    amplitudes[sounding] = k[sounding] ** -0.5 if colour == "pink" else 1.0
    phases = rng.uniform(0.0, 2 * np.pi, k.size)
    wave: NDArray[np.float64] = np.fft.irfft(amplitudes * np.exp(1j * phases), n=samples)
    wave *= samples / np.sqrt(2 * np.sum(amplitudes**2))
    return wave
