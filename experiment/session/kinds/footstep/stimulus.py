"""The stimulus of one step: synthesised at the end of the gate, aimed while the foot falls, sounding at contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.tracker.gate import Contact
from palpate.experiment.apparatus.tracker.landing import Landing
from palpate.experiment.clock import lasted_ms
from palpate.experiment.records.stimulus import Begun, Onset, Stimulus

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from palpate.experiment.apparatus.panel.conditioning import Played
    from palpate.experiment.clock import Clock
    from palpate.experiment.protocol.models import Ahead
    from palpate.experiment.synthesis.waveforms import Basis


@dataclass(frozen=True)
class Sounder:
    """The materials by their ids, the actuator that plays their stimuli, and how they come before contact, if so."""

    materials: Mapping[str, Basis]
    actuator: Actuator
    ahead: Ahead | None = None


class Sounding:
    """The stimulus of one trial on an actuator."""

    def __init__(self, sounder: Sounder, material: str, session_ns: Callable[[float], int], clock: Clock) -> None:
        """Begin with nothing prepared; `session_ns` returns the session time, ns, of a device time, us."""
        self._basis = sounder.materials[material]
        self._actuator = sounder.actuator
        self._ahead = sounder.ahead
        self._ahead_ns = 0 if self._ahead is None else round(-self._ahead.delay_ms * 1e6)
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
        # What replaces another was never aimed, whatever that one was aimed at.
        self._aimed = self._scheduled_ns = self._gate_to_scheduled_ms = None
        self._played = self._actuator.prepare(self._basis.at(speed_mm_s))

    def prepare_for_gate(self, speed_mm_s: float, arrived_ns: int) -> None:
        """Have the stimulus ready for the gate's speed, mm/s, given by a frame that arrived at a session time."""
        self._given_ns = arrived_ns
        self.prepare(speed_mm_s)

    @property
    def stimulus(self) -> Stimulus | None:
        """What was prepared; None before the end of the gate. It takes a while to say: ask after contact."""
        return None if self._played is None else self._played.on_record()

    def in_time(self, landing: Landing) -> bool:
        """Return whether the onset could still be moved when the newest sample was taken."""
        return (landing.us - landing.from_us) * 1e3 >= self._actuator.lead_ns + self._ahead_ns

    def aim(self, landing: Landing) -> None:
        """Schedule the onset as a predicted contact has it or soon after, unless it is nearer already or too late."""
        due_ns = self._session_ns(landing.us) - self._ahead_ns
        onset_ns = max(due_ns, self._clock.now_ns() + self._actuator.lead_ns)
        late_ns = onset_ns - due_ns
        if late_ns and self._scheduled_ns is not None and abs(self._scheduled_ns - due_ns) <= late_ns:
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
        """Have the stimulus sound now if it was not scheduled. Raises `ActuatorError`."""
        self._actuator.landed(self._session_ns(contact.us))

    def withdraw(self) -> bool:
        """Take the stimulus back, and return whether nothing of it sounds."""
        return self._played is None or self._actuator.withdraw()

    @property
    def plays_on(self) -> bool:
        """Whether a step that breaks off now gets its stimulus all the same."""
        return self._ahead is not None and self._ahead.broken_off == "vibration" and self._scheduled_ns is not None

    @property
    def begun(self) -> Begun | None:
        """What the stimulus was aimed at; None where it was not scheduled."""
        aimed, scheduled_ns = self._aimed, self._scheduled_ns
        if aimed is None or scheduled_ns is None:
            return None
        error_ms = aimed.standard_error_us / 1e3
        return Begun(predicted_us=aimed.us, standard_error_ms=error_ms, scheduled_ns=scheduled_ns)

    def onset(self, contact: Landing, contact_ns: int) -> Onset:
        """Return how onset and contact met, once the stimulus has ended. Raises `ActuatorError`."""
        aimed = self._aimed
        # Whoever asks for an onset before contact bounds the prediction's error in the protocol, not in the rig.
        due_ns = self._scheduled_ns if self._ahead is not None and self._scheduled_ns is not None else contact_ns
        return Onset(
            predicted_us=aimed.us if aimed else None,
            standard_error_ms=aimed.standard_error_us / 1e3 if aimed else None,
            predicted_from_us=aimed.from_us if aimed else None,
            prediction_error_ms=(aimed.us - contact.us) / 1e3 if aimed else None,
            contact_ns=contact_ns,
            scheduled_ns=self._scheduled_ns,
            gate_to_scheduled_ms=self._gate_to_scheduled_ms,
            delivered=self._actuator.delivered(due_ns),
            ahead_ms=None if self._ahead is None else -self._ahead.delay_ms,
        )
