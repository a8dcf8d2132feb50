"""The stimulus of one step: synthesised at the end of the gate, aimed while the foot falls, sounding at contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiment.apparatus.ports import Actuator
from experiment.apparatus.tracker.gate import Contact
from experiment.apparatus.tracker.landing import Landing
from experiment.clock import lasted_ms
from experiment.records.stimulus import Onset, Stimulus

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from experiment.apparatus.panel.conditioning import Played
    from experiment.clock import Clock
    from experiment.synthesis.waveforms import Basis


@dataclass(frozen=True)
class Sounder:
    """What stimuli are made with: the materials, by their ids, and the actuator that plays them."""

    materials: Mapping[str, Basis]
    actuator: Actuator


class Sounding:
    """Implements one trial's stimulus on an actuator."""

    def __init__(self, sounder: Sounder, material: str, session_ns: Callable[[float], int], clock: Clock) -> None:
        """Nothing is prepared yet.

        Args:
            sounder: materials and actuator.
            material: what is presented.
            session_ns: session time of a device time, us -> ns.
            clock: the session's.
        """
        self._basis = sounder.materials[material]
        self._actuator = sounder.actuator
        self._session_ns = session_ns
        self._clock = clock
        self._aimed: Landing | None = None
        self._given_ns: int | None = None
        self._gate_to_scheduled_ms: float | None = None
        self._scheduled_ns: int | None = None
        self._speed_mm_s: float | None = None
        self._played: Played | None = None

    def prepare(self, speed_mm_s: float) -> None:
        """Synthesise for a foot's speed, mm/s, and have it ready; another speed replaces an earlier one."""
        if speed_mm_s == self._speed_mm_s:
            return
        self._speed_mm_s = speed_mm_s
        self._played = self._actuator.prepare(self._basis.at(speed_mm_s))

    def given(self, speed_mm_s: float, arrived_ns: int) -> None:
        """The gate was given at a speed, mm/s, by a frame that arrived at a session time: have it ready."""
        self._given_ns = arrived_ns
        self.prepare(speed_mm_s)

    @property
    def stimulus(self) -> Stimulus | None:
        """What was prepared; None before the end of the gate. It takes a while to say: ask after contact."""
        return None if self._played is None else self._played.on_record()

    def in_time(self, landing: Landing) -> bool:
        """Whether the onset could still be moved when the newest sample was taken."""
        return (landing.us - landing.from_us) * 1e3 >= self._actuator.lead_ns

    def aim(self, landing: Landing) -> None:
        """Schedule the onset for a predicted contact, or as soon after as can be.

        It stays as it was where that is nearer, or where it is too late to move it.
        """
        contact_ns = self._session_ns(landing.us)
        onset_ns = max(contact_ns, self._clock.now_ns() + self._actuator.lead_ns)
        late_ns = onset_ns - contact_ns
        if late_ns and self._scheduled_ns is not None and abs(self._scheduled_ns - contact_ns) <= late_ns:
            return
        if not self._actuator.aim(onset_ns):
            return
        self._aimed = landing
        if not self._actuator.lead_ns:
            return
        if self._scheduled_ns is None and self._given_ns is not None:
            self._gate_to_scheduled_ms = lasted_ms(self._clock, self._given_ns)
        self._scheduled_ns = onset_ns

    def landed(self, contact: Contact) -> None:
        """The foot is down. Raises `ActuatorError`."""
        self._actuator.landed(self._session_ns(contact.us))

    def withdraw(self) -> bool:
        """Whether nothing of it sounds."""
        return self._played is None or self._actuator.withdraw()

    def onset(self, contact: Contact, contact_ns: int) -> Onset:
        """How onset and contact met, once the stimulus has ended.

        Args:
            contact: the contact.
            contact_ns: its session time.

        Raises:
            ActuatorError: the device cannot say.
        """
        aimed = self._aimed
        return Onset(
            predicted_us=aimed.us if aimed else None,
            standard_error_ms=aimed.standard_error_us / 1e3 if aimed else None,
            predicted_from_us=aimed.from_us if aimed else None,
            prediction_error_ms=(aimed.us - contact.us) / 1e3 if aimed else None,
            contact_ns=contact_ns,
            scheduled_ns=self._scheduled_ns,
            gate_to_scheduled_ms=self._gate_to_scheduled_ms,
            delivered=self._actuator.delivered(contact_ns),
        )
