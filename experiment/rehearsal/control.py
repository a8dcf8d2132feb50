"""REHEARSAL: the control condition, an actuator that plays silence whatever it is asked for."""

from __future__ import annotations

import numpy as np

from experiment.apparatus.ports import Actuator, Played, Wanted, Waveform
from experiment.stimulus_record import Delivered


class SilentActuator:
    """Implements `Actuator` on top of another one: as many samples, all zero."""

    def __init__(self, actuator: Actuator) -> None:
        self._actuator = actuator

    @property
    def rate_hz(self) -> int:
        return self._actuator.rate_hz

    @property
    def lead_ns(self) -> int:
        return self._actuator.lead_ns

    def prepare(self, wanted: Wanted) -> Played:
        return self._actuator.prepare(Waveform(np.zeros_like(wanted.waveform_m_s2)))

    def aim(self, onset_ns: int) -> bool:
        return self._actuator.aim(onset_ns)

    def landed(self, contact_ns: int) -> None:
        self._actuator.landed(contact_ns)

    def withdraw(self) -> bool:
        return self._actuator.withdraw()

    def delivered(self, contact_ns: int) -> Delivered | None:
        return self._actuator.delivered(contact_ns)

    def close(self) -> None:
        self._actuator.close()
