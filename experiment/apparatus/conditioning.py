"""From a stimulus in m/s^2 to the samples of a device, 1.0 being its full scale. Shared by the actuators' drivers.

A device that takes accelerations gets the limited stimulus. One that takes volts gets what frequency shaping makes of
the limited stimulus, limited once more to its full scale: the protocol's limit is one of acceleration, and the same
voltage moves the panel far at one frequency and hardly at another, so it holds for what shaping is asked for; the limit
last before the device bounds the voltage whatever shaping did.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.limiter import limit
from experiment.apparatus.ports import Drive, Played, Spectrum
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

    def __call__(
        self, waveform_m_s2: NDArray[np.float64], spectrum: Callable[[], Spectrum] | None = None
    ) -> tuple[NDArray[np.float32], Played]:
        """Limit, shape and scale a stimulus.

        Args:
            waveform_m_s2: samples at the device's rate, m/s^2, shape (n,), n at least 1.
            spectrum: returns what they are the sum of, where that is known. It is not asked where the limiter changed
                a sample: the sum would be another.

        Returns:
            Samples of the device, little-endian float32, shape (n,); and what became of the stimulus.

        Raises:
            ActuatorError: there is nothing to play.
        """
        if np.ndim(waveform_m_s2) != 1 or np.size(waveform_m_s2) == 0:
            raise ActuatorError(
                f"actuator: got a stimulus of shape {np.shape(waveform_m_s2)}; allowed: one channel, one sample or more"
            )
        bounded_m_s2, limited = limit(waveform_m_s2, self._peak_m_s2)
        driven: Driven | None = None
        if self._drive is None:
            samples = self._scaled(bounded_m_s2, self._peak_m_s2)
            peak_m_s2 = self._peak(samples)
        else:
            waveform_v, shaping = self._drive(bounded_m_s2, None if limited else spectrum)
            bounded_v, limited_v = limit(waveform_v, self._full_scale)
            samples = self._scaled(bounded_v, self._full_scale)
            driven = Driven(shaping=shaping, limited=limited_v, peak_v=self._peak(samples))
            peak_m_s2 = max(float(bounded_m_s2.max()), -float(bounded_m_s2.min()))
        return samples, Played(samples=samples.size, limited=limited, peak_m_s2=peak_m_s2, driven=driven)

    def _highest(self, peak: float) -> np.float32:
        """The largest sample within a peak; rounding to float32 must not lift one over it."""
        highest = np.float32(peak / self._full_scale)
        return np.nextafter(highest, np.float32(0)) if float(highest) * self._full_scale > peak else highest

    def _scaled(self, bounded: NDArray[np.float64], peak: float) -> NDArray[np.float32]:
        highest = self._highest(peak)
        scaled = (bounded / self._full_scale).astype("<f4")
        return np.clip(scaled, -highest, highest, out=scaled)

    def _peak(self, samples: NDArray[np.float32]) -> float:
        return max(float(samples.max()), -float(samples.min())) * self._full_scale
