"""From a stimulus in m/s^2 to the samples of a device, 1.0 being its full scale. Shared by the actuators' drivers.

A device that takes accelerations gets the limited stimulus. One that takes volts gets what frequency shaping makes of
the stimulus: the protocol's limit is one of acceleration, and the same voltage moves the panel far at one frequency and
hardly at another, so shaping holds it on what the panel will do, and takes down the whole of a stimulus that would pass
it. Where only the samples of a stimulus are known, as of none that a session plays, they are clipped before and then
shaped. The limit last before the device bounds the voltage whatever shaping did.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.limiter import limit
from experiment.apparatus.ports import Drive, Played, Voltages, Wanted, Waveform
from experiment.errors import ActuatorError
from experiment.stimulus_record import Driven


class Conditioner:
    """What every stimulus goes through before its device."""

    def __init__(self, *, full_scale: float, limit_m_s2: float, drive: Drive | None = None) -> None:
        """Set the limits.

        Args:
            full_scale: what a sample of 1.0 is: V where there is a `drive`, else m/s^2.
            limit_m_s2: the protocol's limit; the limiter holds to it, or to full scale in m/s^2 where that is lower.
            drive: frequency shaping, for a device that takes volts; None for one that takes accelerations.

        Raises:
            ActuatorError: the limit is no limit.
        """
        limit((), limit_m_s2)
        self._full_scale = full_scale
        self._peak_m_s2 = limit_m_s2 if drive else min(limit_m_s2, full_scale)
        self._drive = drive

    @property
    def ceiling(self) -> float:
        """No sample is larger in magnitude; 1.0 is full scale."""
        return 1.0 if self._drive else float(self._highest(self._peak_m_s2))

    def __call__(self, wanted: Wanted) -> tuple[NDArray[np.float32], Played]:
        """Limit, shape and scale a stimulus.

        Args:
            wanted: the stimulus, at the device's rate.

        Returns:
            Samples of the device, little-endian float32, shape (n,); and what became of the stimulus.

        Raises:
            ActuatorError: there is nothing to play.
        """
        if self._drive is not None and wanted.bins is not None:
            return self._driven(self._drive(wanted), limited=0)
        waveform_m_s2 = wanted.waveform_m_s2
        if np.ndim(waveform_m_s2) != 1 or np.size(waveform_m_s2) == 0:
            raise ActuatorError(
                f"actuator: got a stimulus of shape {np.shape(waveform_m_s2)}; allowed: one channel, one sample or more"
            )
        bounded_m_s2, limited = limit(waveform_m_s2, self._peak_m_s2)
        if self._drive is not None:
            return self._driven(self._drive(Waveform(bounded_m_s2)), limited=limited)
        samples = self._scaled(bounded_m_s2, self._peak_m_s2)
        return samples, Played(samples=samples.size, limited=limited, peak_m_s2=lambda: self._peak(samples))

    def _driven(self, voltages: Voltages, *, limited: int) -> tuple[NDArray[np.float32], Played]:
        bounded_v, limited_v = limit(voltages.waveform_v, self._full_scale)
        samples = self._scaled(bounded_v, self._full_scale)

        def driven() -> Driven:
            return Driven(shaping=voltages.shaping(), limited=limited_v, peak_v=self._peak(samples))

        return samples, Played(samples=samples.size, limited=limited, peak_m_s2=voltages.peak_m_s2, driven=driven)

    def _highest(self, peak: float) -> np.float32:
        """The largest sample within a peak; rounding to float32 must not lift one over it."""
        highest = np.float32(peak / self._full_scale)
        return np.nextafter(highest, np.float32(0)) if float(highest) * self._full_scale > peak else highest

    def _scaled(self, bounded: NDArray[np.float64], peak: float) -> NDArray[np.float32]:
        highest = self._highest(peak)
        scaled = np.empty(bounded.shape, "<f4")
        np.divide(bounded, self._full_scale, out=scaled, casting="same_kind")
        return np.clip(scaled, -highest, highest, out=scaled)

    def _peak(self, samples: NDArray[np.float32]) -> float:
        return max(float(samples.max()), -float(samples.min())) * self._full_scale
