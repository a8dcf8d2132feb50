"""SIMULATED voice: says any word as sounds that are its own, louder than the room and like nobody's speech.

Letters draw buzzes with two resonances and hisses. Speakers differ in pitch and resonances, and each time a little in
pace and pitch. It says nothing of real participants.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.rehearsal.wires.mouth import Mouth

SOUNDS = 5
"""Of every word."""

LOUD = 0.05
"""Rms of a word, full scale being 1; ours: what a microphone's input that is set well shows of a voice."""

_EDGE_S = 0.015
_HIGHEST_HZ = 6000.0


@dataclass(frozen=True)
class Voice:
    """One speaker; `pitch_hz` is that of the buzz, and `tract` scales every resonance."""

    pitch_hz: float
    tract: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Voice:
        """Return a speaker."""
        return cls(pitch_hz=float(rng.uniform(95, 220)), tract=float(rng.uniform(0.9, 1.15)))

    def says(self, word: str, *, rate_hz: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return a word as it is said this time, 1 being full scale, shape (n,)."""
        sounds = np.random.default_rng(list(hashlib.sha256(word.encode()).digest()))
        pace, pitch_hz = rng.uniform(0.92, 1.08), self.pitch_hz * rng.uniform(0.97, 1.03)
        said: list[NDArray[np.float64]] = []
        for number in range(SOUNDS):
            lasts_s = sounds.uniform(0.09, 0.16) / pace
            t = np.arange(round(lasts_s * rate_hz)) / rate_hz
            low_hz, high_hz = sounds.uniform(280, 850) * self.tract, sounds.uniform(950, 2600) * self.tract
            buzz = _buzz(t, pitch_hz * sounds.uniform(0.9, 1.1), (low_hz, high_hz))
            hiss = _hiss(t.size, sounds.uniform(1500, 5500) * self.tract, rate_hz, rng)
            edge = np.minimum(np.minimum(t, t[::-1]) / _EDGE_S, 1.0)
            said.append(edge * (buzz if number % 2 else hiss))
        wave = np.concatenate(said)
        return np.asarray(LOUD * wave / np.sqrt(np.mean(wave**2)), np.float32)


class Speaker:
    """One simulated participant who speaks, with a mouth."""

    def __init__(self, mouth: Mouth, *, rate_hz: int, entropy: tuple[int, ...]) -> None:
        """Be the speaker that `entropy` draws; the same in every session."""
        self._mouth = mouth
        self._rate_hz = rate_hz
        self._voice = Voice.drawn(np.random.default_rng([*entropy, 0]))
        self._rng = np.random.default_rng([*entropy, 1])

    def say(self, word: str, after_s: float = 0.0) -> float:
        """Begin to say a word so long from now on, and return when it will have been said, s from now on."""
        said = self._voice.says(word, rate_hz=self._rate_hz, rng=self._rng)
        self._mouth.say(np.concatenate([np.zeros(round(after_s * self._rate_hz), np.float32), said]))
        return after_s + said.size / self._rate_hz


def _buzz(t: NDArray[np.float64], pitch_hz: float, resonances_hz: tuple[float, ...]) -> NDArray[np.float64]:
    """Return harmonics that fall by 6 dB an octave but near the resonances, rms 1, shape (n,)."""
    f = np.arange(pitch_hz, _HIGHEST_HZ, pitch_hz)
    strong = sum(1 / (1 + ((f - each) / (0.08 * each)) ** 2) for each in resonances_hz)
    wave: NDArray[np.float64] = (strong / f) @ np.sin(2 * np.pi * np.outer(f, t))
    return np.asarray(wave / np.sqrt(np.mean(wave**2)))


def _hiss(n: int, centre_hz: float, rate_hz: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return noise around a frequency, rms 0.5, shape (n,)."""
    f = np.fft.rfftfreq(n, 1 / rate_hz)
    wave = np.fft.irfft(np.fft.rfft(rng.normal(size=n)) / (1 + ((f - centre_hz) / (0.2 * centre_hz)) ** 2), n)
    return np.asarray(0.5 * wave / np.sqrt(np.mean(wave**2)))
