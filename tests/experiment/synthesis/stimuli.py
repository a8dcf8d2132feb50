"""Stimuli of any waveform, and of any bins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.waveforms import Basis, Stimulus, prepare


@dataclass(frozen=True)
class Given(Stimulus):
    """A stimulus whose waveform is given, NaN and infinity included, and so is how many of its bins were floored."""

    waveform: NDArray[np.float64]
    floored: int

    @property
    def waveform_m_s2(self) -> NDArray[np.float64]:
        return self.waveform

    @property
    def floored_bins(self) -> int:
        return self.floored


def given(waveform_m_s2: ArrayLike, *, rate_hz: int = 5000, material: str = "any", floored: int = 0) -> Given:
    """A stimulus of this waveform; its bins are silent."""
    like = of_bins([0.0], samples=max(np.size(waveform_m_s2), 1), rate_hz=rate_hz, material=material)
    return Given(**vars(like), waveform=np.asarray(waveform_m_s2, dtype=np.float64), floored=floored)


def of_bins(coefficients: ArrayLike, *, samples: int, rate_hz: int, material: str = "any") -> Stimulus:
    """The stimulus of a material that has these bins at every speed, at the rate of its recordings."""
    return basis_of(coefficients, samples=samples, rate_hz=rate_hz, material=material).at(100.0)


def basis_of(coefficients: ArrayLike, *, samples: int, rate_hz: int, material: str = "any") -> Basis:
    """That material, prepared."""
    c = np.broadcast_to(np.asarray(coefficients, dtype=np.float64), (2, np.size(coefficients)))
    spectra = CrinkleSpectra(np.array([100.0, 200.0]), rate_hz, np.abs(c), np.where(c < 0, -1.0, 1.0), recorded=samples)
    return prepare(spectra, material=material, output_rate_hz=rate_hz)


def waveform(spectra: CrinkleSpectra, *, speed_mm_s: float, output_rate_hz: int) -> NDArray[np.float64]:
    """Of the stimulus of a material at one speed, m/s^2."""
    return prepare(spectra, material="any", output_rate_hz=output_rate_hz).at(speed_mm_s).waveform_m_s2
