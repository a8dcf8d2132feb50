"""The masker: noise on the headphones that hides the sound of the stimuli, at the level that the participant sets.

One loop plays from the beginning of a session to its end, so that it neither stops nor repeats audibly: its round is
ten seconds, and its end goes over into its beginning. Levels change in ramps. What the headphones bring to the ear is
known from their calibration; no level is above the protocol's limit, and each moment of it counts towards the dose of
the day.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.audio import sound_level
from experiment.apparatus.audio.cues import Block
from experiment.apparatus.audio.stream import AudioStream
from experiment.apparatus.ports import MaskerExposure
from experiment.clock import Clock
from experiment.errors import AudioError

ROUND_S = 10.0
"""Length of a round, s: nobody hears a repetition that far away."""

SOFTEST_DB_A = 30.0
"""Nothing softer masks anything."""


@dataclass(frozen=True)
class MaskerNoise:
    """A loop of noise, and how loud the headphones make it.

    Attributes:
        samples: one round, rms 1, float32, shape (n,).
        full_scale_db_a: level at the ear at a gain of 1, dB(A).
        loudest_db_a: highest level that it may be set to, dB(A).
    """

    samples: Block
    full_scale_db_a: float
    loudest_db_a: float

    def gain(self, level_db_a: float) -> float:
        """What the samples are multiplied by for a level."""
        return float(10 ** ((level_db_a - self.full_scale_db_a) / 20))

    @property
    def ceiling(self) -> float:
        """Largest magnitude of a sample at the loudest level: what the limiter of the headphones' channels holds to."""
        return min(self.gain(self.loudest_db_a) * float(np.max(np.abs(self.samples))) * (1 + 2**-20), 1.0)


def masker_noise(
    samples: NDArray[np.float64], *, rate_hz: int, pink_full_scale_db_a: float, limit_db_a: float
) -> MaskerNoise:
    """Make a masker of noise.

    Args:
        samples: one round of it, of rms 1, shape (n,).
        rate_hz: of the stream.
        pink_full_scale_db_a: level at the ear of pink noise with an rms of full scale, dB(A), from the rig file.
        limit_db_a: the protocol's limit, dB(A).

    Raises:
        AudioError: the headphones cannot play even the softest level.
    """
    power = np.abs(np.fft.rfft(samples)[1:]) ** 2
    f = np.arange(1, power.size + 1) * rate_hz / samples.size
    weighted_db = sound_level.weighted_db(frequency_hz=f, power=power)
    full_scale_db_a = pink_full_scale_db_a + weighted_db - sound_level.pink_weighted_db(rate_hz=rate_hz)
    unclipped_db_a = full_scale_db_a - 20 * float(np.log10(np.max(np.abs(samples))))
    loudest_db_a = min(limit_db_a, unclipped_db_a)
    if loudest_db_a < SOFTEST_DB_A:
        raise AudioError(
            f"masker: got a loudest level of {loudest_db_a:.1f} dB(A); allowed: {SOFTEST_DB_A:g} or more; correct "
            "exposure.masker_level_db_a in the protocol, or use louder headphones"
        )
    return MaskerNoise(samples.astype(np.float32), full_scale_db_a, loudest_db_a)


class Masker:
    """Noise on some channels of a stream, at a level in dB(A)."""

    def __init__(
        self,
        stream: AudioStream,
        made: MaskerNoise,
        *,
        channels: tuple[int, ...],
        clock: Clock,
        dose_before: float = 0.0,
    ) -> None:
        """Begin in silence.

        Args:
            stream: the session's stream.
            made: what to play.
            channels: of the headphones, from 1.
            clock: the session's clock.
            dose_before: what the participant's earlier sessions of the day used up.
        """
        self._noise = made
        self._clock = clock
        self._loop = stream.play_loop(made.samples, tuple(channel - 1 for channel in channels))
        self._level_db_a: float | None = None
        self._dose = dose_before
        self._since_ns = clock.now_ns()

    @property
    def level_db_a(self) -> float | None:
        """The level in force, dB(A); None in silence."""
        return self._level_db_a

    @property
    def limit_db_a(self) -> float:
        """The loudest level: the protocol's limit, or what the headphones can play unclipped, dB(A)."""
        return self._noise.loudest_db_a

    def start(self, level_db_a: float) -> float:
        """Fade in from silence; as `set_level` does."""
        return self._go(level_db_a)

    def set_level(self, level_db_a: float) -> float:
        """Go to another level, in a ramp.

        Args:
            level_db_a: wanted, dB(A).

        Returns:
            The level in force: the one wanted, or the nearest that is allowed.

        Raises:
            AudioError: it is no level, the masker is silent, or the day's dose is used up.
        """
        if self._level_db_a is None:
            raise AudioError("masker: got a level while it is silent; allowed: once it plays; start it first")
        return self._go(level_db_a)

    def stop(self) -> None:
        """Fade out."""
        self._account()
        self._loop.wanted = 0.0
        self._level_db_a = None

    def exposure(self) -> MaskerExposure:
        """What it has done to the ears until now."""
        self._account()
        level = self._level_db_a
        daily = sound_level.daily_level_db_a(dose=self._dose)
        return MaskerExposure(
            level_db_a=level,
            dose=self._dose,
            daily_level_db_a=daily if np.isfinite(daily) else None,
            left_s=None if level is None else sound_level.left_s(dose=self._dose, level_db_a=level),
        )

    def _go(self, level_db_a: float) -> float:
        if not np.isfinite(level_db_a):
            raise AudioError(f"masker: got a level of {level_db_a} dB(A); allowed: a number; set it again")
        self._account()
        if self._dose >= 1:
            self.stop()
            raise AudioError(
                f"masker: got a dose of {self._dose:.2f} for today; allowed: 1, which is {sound_level.ACTION_DB_A:g} "
                "dB(A) for eight hours; go on another day"
            )
        bounded = min(max(level_db_a, SOFTEST_DB_A), self.limit_db_a)
        self._loop.wanted = self._noise.gain(bounded)
        self._level_db_a = bounded
        return bounded

    def _account(self) -> None:
        now_ns = self._clock.now_ns()
        if self._level_db_a is not None:
            lasted_s = (now_ns - self._since_ns) / 1e9
            self._dose += sound_level.dose(level_db_a=self._level_db_a, duration_s=lasted_s)
        self._since_ns = now_ns
