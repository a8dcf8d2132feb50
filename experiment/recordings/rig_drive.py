"""The voltages that a rig's device is given for a stimulus, by the response table that the rig file names."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.ports import Drive, Voltages, Wanted
from experiment.apparatus.rig_panel import ActuatorRig, response_table
from experiment.recordings.response import parse
from experiment.stimulus_record import Shaping
from experiment.synthesis.driven_basis import DrivenBasis, prepare
from experiment.synthesis.driving import bins_of_waveform, drive
from experiment.synthesis.shaping import Shaped
from experiment.synthesis.spectra import Bins
from experiment.synthesis.stimulus import BinsAtSpeed


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
