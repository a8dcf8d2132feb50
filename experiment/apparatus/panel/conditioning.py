"""From a stimulus in m/s^2 to the samples of a device, 1.0 being its full scale. Shared by the actuators' drivers.

A device that takes accelerations gets the limited stimulus. One that takes volts gets what frequency shaping makes of
the stimulus: the protocol's limit is one of acceleration, and the same voltage moves the panel far at one frequency and
hardly at another, so shaping holds it on what the panel will do, and takes down the whole of a stimulus that would pass
it. Where only the samples of a stimulus are known, as of none that a session plays, they are clipped before and then
shaped. The limit last before the device bounds the voltage whatever shaping did.

The voltages that a rig's device is given for a stimulus, by the response table that the rig file names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.panel.response_table import parse
from experiment.apparatus.ports import Drive, Played, Voltages, Wanted, Waveform
from experiment.apparatus.rig import ActuatorRig, response_table
from experiment.errors import ActuatorError
from experiment.records.stimulus import Driven, Shaping
from experiment.synthesis.limiter import limit
from experiment.synthesis.shaping import Shaped, bins_of_waveform, drive
from experiment.synthesis.spectra import Bins
from experiment.synthesis.voltages import DrivenBasis, prepare
from experiment.synthesis.waveforms import BinsAtSpeed


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


def open_drive(folder: Path, actuator: ActuatorRig, *, limit_m_s2: float, like: Iterable[Wanted] = ()) -> Drive | None:
    """What turns accelerations into voltages for the actuator of a rig; None for one that takes accelerations.

    Args:
        folder: which holds the rig file; the response table stands there.
        actuator: of the rig.
        limit_m_s2: the protocol's limit for the magnitude of the acceleration that is delivered, m/s^2.
        like: a stimulus of each material that will be asked for, at any speed. What the voltages of their like need is
            prepared here, so that they are there sooner: of stimuli whose `bins` are `BinsAtSpeed` of the same spectra,
            not of equal ones.

    Raises:
        RigError: the table is not the one that the rig file names.
        RecordingError: the table cannot be used.
    """
    settings = actuator.shaping
    if settings is None:
        return None
    response = parse(folder / settings.response, response_table(folder, settings))
    rate_hz, gain_limit = actuator.rate_hz, settings.gain_limit_v_per_m_s2
    whole = partial(drive, rate_hz=rate_hz, response=response, gain_limit_v_per_m_s2=gain_limit)
    limited = partial(whole, limit_m_s2=limit_m_s2, limit_v=settings.full_scale_v)
    held = {
        id(asked.spectra): prepare(
            asked.spectra,
            rate_hz=rate_hz,
            response=response,
            gain_limit_v_per_m_s2=gain_limit,
            limit_m_s2=limit_m_s2,
            limit_v=settings.full_scale_v,
        )
        for asked in (stimulus.bins for stimulus in like)
        if isinstance(asked, BinsAtSpeed)
    }
    return _RigDrive(rate_hz, limit_m_s2, whole, limited, held)


@dataclass(frozen=True)
class _RigDrive:
    """Implements `Drive`.

    Attributes:
        rate_hz: of the device.
        limit_m_s2: of the acceleration.
        whole: `drive` on this rig, no limit set.
        limited: the same within the limits of panel and amplifier.
        held: what is prepared, by the identity of the spectra, which it holds.
    """

    rate_hz: int
    limit_m_s2: float
    whole: Callable[..., tuple[NDArray[np.float64], Shaped]]
    limited: Callable[..., tuple[NDArray[np.float64], Shaped]]
    held: dict[int, DrivenBasis]

    def __call__(self, wanted: Wanted) -> Voltages:
        asked = wanted.bins
        if isinstance(asked, BinsAtSpeed) and id(asked.spectra) in self.held:
            found = self.held[id(asked.spectra)](asked.speed_mm_s)
            if found is not None:
                waveform_v, scale = found
                # Nothing is taken down again, for the limits hold already: `driven_basis` says why.
                return self._said(waveform_v, cache(lambda: self.whole(asked(), scale=scale)[1]))
        if asked is None:
            bins = bins_of_waveform(wanted.waveform_m_s2, rate_hz=self.rate_hz)
        else:
            known = asked()
            bins = Bins(known.coefficients, known.samples, known.rate_hz)
        waveform_v, did = self.limited(bins)
        return self._said(waveform_v, lambda: did)

    def _said(self, waveform_v: NDArray[np.float64], did: Callable[[], Shaped]) -> Voltages:
        def shaping() -> Shaping:
            lost = did()
            return Shaping(
                saturated_bins=lost.saturated.bins,
                saturated_cost_m_s2=lost.saturated.cost_m_s2,
                outside_bins=lost.outside.bins,
                outside_cost_m_s2=lost.outside.cost_m_s2,
                bounded_bins=lost.bounded.bins,
                bounded_cost_m_s2=lost.bounded.cost_m_s2,
                scale=lost.scale,
            )

        # `highest` may lie above the peak, and so above a limit that is known to hold.
        return Voltages(waveform_v, shaping, peak_m_s2=lambda: min(did().peak_m_s2, self.limit_m_s2))
