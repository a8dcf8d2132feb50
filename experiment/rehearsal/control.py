"""REHEARSAL: the control condition, an actuator that plays silence whatever it is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.ports import Actuator, Played


class SilentActuator:
    """Implements `Actuator` on top of another one: as many samples, all zero."""

    def __init__(self, actuator: Actuator) -> None:
        self._actuator = actuator

    @property
    def rate_hz(self) -> int:
        return self._actuator.rate_hz

    def play(self, waveform_m_s2: NDArray[np.float64]) -> Played:
        return self._actuator.play(np.zeros_like(waveform_m_s2))

    def close(self) -> None:
        self._actuator.close()
