"""One small Protocol per device. A driver is one file that implements one of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from palpate.experiment.records.stimulus import Delivered

if TYPE_CHECKING:
    from palpate.experiment.apparatus.panel.conditioning import Played
    from palpate.experiment.apparatus.tracker.clock_map import ClockMap
    from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
    from palpate.experiment.synthesis.waveforms import Waveform


class Tracker(Protocol):
    """Where the foot is, by the device's own counter, dated by `clock_map`.

    A driver may have a property `gone`, for any thread: nothing can come until it is reconnected.
    """

    @property
    def counts(self) -> LinkCounts:
        """Frames received, lost, damaged and repeated in all that was read, reconnections included."""

    @property
    def clock_map(self) -> ClockMap | None:
        """Session time of device time, as of the newest sample that has come; None before the first."""

    def drain(self) -> None:
        """Throw away what arrived before now; the gap this leaves is not counted as lost."""

    def read(self) -> Samples:
        """Wait for the next samples, at least one, and return them.

        Raises `TrackerStopped` after at most 200 ms without any, or a lost port, and `TrackerError` for another clock.
        """

    def reconnect(self, timeout_s: float) -> None:
        """Wait until the device is back, with a new `clock_map` and the same `counts`. Raises `TrackerStopped`."""

    def close(self) -> None: ...


class Pedal(Protocol):
    """With what the participant stops everything."""

    def pressed(self) -> bool:
        """Return within 0.1 s whether it was pressed. Raises `PedalError` if nobody could stop with it any more."""

    def close(self) -> None: ...


class Press(Protocol):
    """A button that was pressed."""

    @property
    def key(self) -> str:
        """Its name."""

    @property
    def device_us(self) -> int:
        """When, by the device's own clock, microseconds."""


class Buttons(Protocol):
    """With what the participant answers, dated by `clock_map`."""

    @property
    def clock_map(self) -> ClockMap | None:
        """Session time of device time; None before anything has come."""

    @property
    def error_s(self) -> float | None:
        """The standard error of a press on the session's clock, s; None where nobody knows."""

    @property
    def late_s(self) -> Sequence[float]:
        """How long after `clock_map` says the last that came was there, s."""

    def read(self) -> Sequence[Press]:
        """Return within 0.1 s what was pressed since the last call. Raises `ButtonsError`."""

    def close(self) -> None: ...


class Actuator(Protocol):
    """What shakes the panel: one stimulus at a time, prepared while the foot falls.

    A driver that can schedule sounds at the time it was last aimed at, another when the foot has landed.
    """

    @property
    def rate_hz(self) -> int:
        """Samples a second that `prepare` expects."""

    @property
    def lead_ns(self) -> int:
        """How long before its onset a stimulus can no longer be moved or withdrawn, ns; 0 where `landed` sounds it."""

    def prepare(self, stimulus: Waveform) -> Played:
        """Make a stimulus at `rate_hz` ready, in place of one that has not begun. Raises `ActuatorError`."""

    def aim(self, onset_ns: int) -> bool:
        """Aim the first sample at `onset_ns`, session time; return False, and change nothing, if it is too late."""

    def landed(self, contact_ns: int) -> None:
        """Have a stimulus that was never aimed sound at once, after contact at `contact_ns`. Raises `ActuatorError`."""

    def withdraw(self) -> bool:
        """Take the stimulus back, from any thread and at once, and return whether nothing of it will sound."""

    def is_silent(self) -> bool:
        """Return whether no stimulus sounds, or may still sound after its device failed; this waits for nothing."""

    def delivered(self, contact_ns: int) -> Delivered | None:
        """Return what was heard of the stimulus, once it has ended; None if unmeasured and without a fault.

        `contact_ns` is the latest session time of contact. Raises `ActuatorError` if the device cannot say.
        """

    def close(self) -> None: ...


@dataclass(frozen=True)
class MaskerExposure:
    """What the masker has done to the ears.

    Attributes:
        level_db_a: level now; None for silence.
        dose: of 24 hours, 1 being 80 dB(A) for eight hours (Directive 2003/10/EC, lower action value).
        daily_level_db_a: L_EX,8h of that dose; None for none.
        left_s: how long this level may go on until the dose is 1, s; 0 where the masker fell silent for that, and None
            in another silence.
    """

    level_db_a: float | None
    dose: float
    daily_level_db_a: float | None
    left_s: float | None


class Masker(Protocol):
    """Noise on the headphones that hides the sound of the stimuli; it goes on until it is stopped."""

    @property
    def level_db_a(self) -> float | None:
        """The level in force, dB(A); None in silence."""

    @property
    def limit_db_a(self) -> float:
        """The loudest level allowed, dB(A)."""

    def start(self, level_db_a: float) -> float:
        """Begin at a level, as `set_level` does."""

    def set_level(self, level_db_a: float) -> float:
        """Go to the nearest allowed level, and return it. Raises `DoseUsedUp` if the masker is silent."""

    def stop(self) -> None:
        """Fall silent."""

    def exposure(self) -> MaskerExposure:
        """Return what the masker has done to the ears until now."""
