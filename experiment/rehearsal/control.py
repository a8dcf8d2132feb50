"""REHEARSAL: the control condition, an actuator that plays silence whatever it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.ports import Actuator, Played, Spectrum, Wanted
from experiment.stimulus_record import Delivered
from experiment.synthesis.spectra import Bins


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
        return self._actuator.prepare(_Silent(wanted))

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


@dataclass(frozen=True)
class _Silent:
    """Implements `Wanted`: as long as another, with as many bins, and all of it zero."""

    like: Wanted

    @property
    def waveform_m_s2(self) -> NDArray[np.float64]:
        return np.zeros_like(self.like.waveform_m_s2)

    @property
    def bins(self) -> Callable[[], Spectrum] | None:
        of = self.like.bins
        if of is None:
            return None

        def none() -> Bins:
            like = of()
            return Bins(np.zeros_like(like.coefficients), like.samples, like.rate_hz)

        return none
