"""The masker: noise on the headphones that hides the sound of the stimuli, its level in dB(A), and its dose.

One loop of ten seconds without a seam plays throughout a session. Levels change in ramps. The headphones' calibration
gives the level at the ear, which stays within the protocol's limit and counts towards the dose of 24 hours.

The dose is that of Directive 2003/10/EC, articles 2 and 3: eight hours, equal energy (3 dB more in half the time), and
1 at the lower exposure action value of 80 dB(A).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.audio.mixer import SOMETIME, Block
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.ports import MaskerExposure
from palpate.experiment.clock import Clock
from palpate.experiment.errors import AudioError, DoseUsedUp

REFERENCE_S = 8 * 3600.0
"""Working day that levels are referred to, s."""

ACTION_DB_A = 80.0
"""Lower exposure action value of the daily level, dB(A)."""

AUDIBLE_HZ = 20.0
"""Pink noise of a calibration reaches from here to half the sampling rate, as `synthesis.signals.noise` makes it."""

_POLES_HZ = (20.598997, 107.65265, 737.86223, 12194.217)
"""Of the weighting: IEC 61672-1, annex E."""


def a_weighting_db(*, frequency_hz: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the A-weighting of IEC 61672-1, equation (E.6), relative to 1 kHz, dB, shape (n,), above 0 Hz."""
    return _unnormalised_db(np.asarray(frequency_hz, np.float64)) - float(_unnormalised_db(np.array([1000.0]))[0])


def _unnormalised_db(f: NDArray[np.float64]) -> NDArray[np.float64]:
    f1, f2, f3, f4 = _POLES_HZ
    response = f4**2 * f**4 / ((f**2 + f1**2) * np.sqrt((f**2 + f2**2) * (f**2 + f3**2)) * (f**2 + f4**2))
    level_db: NDArray[np.float64] = 20 * np.log10(response)
    return level_db


def a_weighted_db(*, frequency_hz: NDArray[np.floating[Any]], power: NDArray[np.floating[Any]]) -> float:
    """Return a sound's A-weighted level less its unweighted one, dB, from power at frequencies above 0, shape (n,)."""
    weights = 10 ** (a_weighting_db(frequency_hz=frequency_hz) / 10)
    return float(10 * np.log10(np.sum(weights * power) / np.sum(power)))


def pink_weighted_db(*, rate_hz: int) -> float:
    """Return `a_weighted_db` of pink noise from `AUDIBLE_HZ` to half a sampling rate, dB."""
    f = np.arange(AUDIBLE_HZ, rate_hz / 2, 0.5)
    return a_weighted_db(frequency_hz=f, power=1 / f)


def dose(*, level_db_a: float, duration_s: float) -> float:
    """Return the part of a day's dose that a steady level uses up; doses add."""
    return float(duration_s / REFERENCE_S * 10 ** ((level_db_a - ACTION_DB_A) / 10))


def daily_level_db_a(*, dose: float) -> float:
    """Return the daily exposure level L_EX,8h of a dose, 1 being 80 dB(A) for eight hours, dB(A); -inf for none."""
    return ACTION_DB_A + 10 * float(np.log10(dose)) if dose > 0 else -np.inf


RESERVE_S = 2.0
"""A masker that may go on for no longer is over, s: the dose itself is never reached."""


def left_s(*, dose: float, level_db_a: float) -> float:
    """Return how long a level may go on until the dose, of which some is used up already, is 1, s."""
    return float(max(1 - dose, 0) * REFERENCE_S / 10 ** ((level_db_a - ACTION_DB_A) / 10))


ROUND_S = 10.0
"""Length of a round, s: nobody hears a repetition that far away."""

SOFTEST_DB_A = 30.0
"""Nothing softer masks anything."""


@dataclass(frozen=True)
class MaskerNoise:
    """A loop of noise, rms 1, float32, shape (n,), with its levels at the ear, dB(A), at a gain of 1 and at most."""

    samples: Block
    full_scale_db_a: float
    loudest_db_a: float

    def gain(self, level_db_a: float) -> float:
        """Return what the samples are multiplied by for a level."""
        return float(10 ** ((level_db_a - self.full_scale_db_a) / 20))

    @property
    def ceiling(self) -> float:
        """Largest magnitude of a sample at the loudest level: what the limiter of the headphones' channels holds to."""
        return min(self.gain(self.loudest_db_a) * float(np.max(np.abs(self.samples))) * (1 + 2**-20), 1.0)


def masker_noise(
    samples: NDArray[np.float64], *, rate_hz: int, pink_full_scale_db_a: float, limit_db_a: float
) -> MaskerNoise:
    """Return a masker of one round of noise, rms 1 at the stream's rate, shape (n,), up to the protocol's limit, dB(A).

    `pink_full_scale_db_a` is for pink noise with an rms of full scale. Raises `AudioError` if no level can be played.
    """
    power = np.abs(np.fft.rfft(samples)[1:]) ** 2
    f = np.arange(1, power.size + 1) * rate_hz / samples.size
    weighted_db = a_weighted_db(frequency_hz=f, power=power)
    full_scale_db_a = pink_full_scale_db_a + weighted_db - pink_weighted_db(rate_hz=rate_hz)
    unclipped_db_a = full_scale_db_a - 20 * float(np.log10(np.max(np.abs(samples))))
    loudest_db_a = min(limit_db_a, unclipped_db_a)
    if loudest_db_a < SOFTEST_DB_A:
        raise AudioError(
            "masker",
            f"got a maximum level of {loudest_db_a:.1f} dB(A)",
            "correct exposure.masker_level_db_a in the protocol, or use louder headphones",
            allowed=f"{SOFTEST_DB_A:g} or more",
        )
    return MaskerNoise(samples.astype(np.float32), full_scale_db_a, loudest_db_a)


class AudioMasker:
    """Noise on some channels of a stream, at a level in dB(A).

    The stream's callback fades by itself when the level's dose is used up, as at the end of the sound.
    """

    def __init__(
        self,
        stream: AudioStream,
        made: MaskerNoise,
        *,
        channels: tuple[int, ...],
        clock: Clock,
        dose_before: float = 0.0,
    ) -> None:
        """Begin in silence on these channels, from 1; `dose_before` is the participant's of 24 hours."""
        self._noise = made
        self._clock = clock
        self._stream = stream
        self._loop = stream.play_loop(made.samples, tuple(channel - 1 for channel in channels))
        self._level_db_a: float | None = None
        self._used_up = False
        self._dose = dose_before
        self._since_ns = clock.now_ns()

    @property
    def level_db_a(self) -> float | None:
        """The level in force, dB(A); None in silence."""
        self._account()
        return self._level_db_a

    @property
    def limit_db_a(self) -> float:
        """The loudest level: the protocol's limit, or what the headphones can play unclipped, dB(A)."""
        return self._noise.loudest_db_a

    def start(self, level_db_a: float) -> float:
        """Fade in from silence, as `set_level` does."""
        return self._go(level_db_a)

    def set_level(self, level_db_a: float) -> float:
        """Go to the nearest allowed level in a ramp, and return it.

        Raises `AudioError` for no level or a silent masker, `DoseUsedUp` where it falls silent.
        """
        if self._level_db_a is None:
            raise AudioError(
                "masker", "got a level while the masker was off", "start it first", allowed="only while it plays"
            )
        return self._go(level_db_a)

    def stop(self) -> None:
        """Fade out."""
        self._account()
        self._loop.wanted = 0.0
        self._loop.ends_ns = SOMETIME
        self._level_db_a = None

    def exposure(self) -> MaskerExposure:
        """Return what it has done to the ears until now."""
        self._account()
        level = self._level_db_a
        daily = daily_level_db_a(dose=self._dose)
        return MaskerExposure(
            level_db_a=level,
            dose=self._dose,
            daily_level_db_a=daily if np.isfinite(daily) else None,
            left_s=0.0 if self._used_up else None if level is None else left_s(dose=self._dose, level_db_a=level),
        )

    def _go(self, level_db_a: float) -> float:
        if not np.isfinite(level_db_a):
            raise AudioError("masker", f"got a level of {level_db_a} dB(A)", "set it again", allowed="a number")
        self._account()
        bounded = min(max(level_db_a, SOFTEST_DB_A), self.limit_db_a)
        lasts_ns = int((left_s(dose=self._dose, level_db_a=bounded) - RESERVE_S) * 1e9)
        if lasts_ns <= 0 or self._used_up:
            self.stop()
            raise DoseUsedUp(
                "masker",
                f"got a dose of {self._dose:.2f} in 24 hours",
                "continue a day later",
                allowed=f"1, the dose of {ACTION_DB_A:g} dB(A) for eight hours",
            )
        # Between these lines the earlier of both ends holds.
        ends_ns = self._since_ns + lasts_ns
        self._loop.ends_ns = min(self._loop.ends_ns, ends_ns)
        self._loop.wanted = self._noise.gain(bounded)
        self._loop.ends_ns = ends_ns
        self._level_db_a = bounded
        return bounded

    def _account(self) -> None:
        now_ns = self._clock.now_ns()
        if self._level_db_a is not None:
            ends_ns = min(self._loop.ends_ns, self._stream.ends_ns)
            lasted_s = max(min(now_ns, ends_ns) - self._since_ns, 0) / 1e9
            self._dose += dose(level_db_a=self._level_db_a, duration_s=lasted_s)
            if now_ns >= ends_ns:
                self._level_db_a, self._used_up = None, now_ns >= self._loop.ends_ns
        self._since_ns = now_ns
