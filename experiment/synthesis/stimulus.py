"""A stimulus: what a material's spectra become at one foot speed and one output rate, equation (5) of Okamoto et al."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from experiment.synthesis.crinkle import CrinkleSpectra, SpectrumAtSpeed, at_speed
from experiment.synthesis.spectra import Bins, inverse_on, transformable


@dataclass(frozen=True)
class BinsAtSpeed:
    """What a stimulus is the sum of; call it. Arguments and errors as in `at_speed`."""

    spectra: CrinkleSpectra
    speed_mm_s: float

    @cached_property
    def at(self) -> SpectrumAtSpeed:
        """C'_k(v), computed when it is first asked for."""
        return at_speed(self.spectra, speed_mm_s=self.speed_mm_s)

    def __call__(self) -> Bins:
        return Bins(self.at.coefficients, samples=self.spectra.samples, rate_hz=self.spectra.rate_hz)


@dataclass(frozen=True)
class Synthesised:
    """A stimulus for one step of the foot.

    Attributes:
        summed: returns the sum of the bins at the output rate, m/s^2, shape (n,).
        floored_bins: as in `SpectrumAtSpeed`.
        extrapolated: as in `SpectrumAtSpeed`.
        dropped_bins: bins of the recordings that the output rate cannot carry.
        bins: returns what the waveform is the sum of; it costs some microseconds.
    """

    summed: Callable[[], NDArray[np.float64]]
    floored_bins: int
    extrapolated: bool
    dropped_bins: int
    bins: Callable[[], Bins]

    @cached_property
    def waveform_m_s2(self) -> NDArray[np.float64]:
        """At the output rate, m/s^2, shape (n,); summed when it is first asked for. Raises as `inverse_on`."""
        return self.summed()


def synthesise(spectra: CrinkleSpectra, *, speed_mm_s: float, output_rate_hz: int) -> Synthesised:
    """The stimulus for one step: equations (3), (4) and (5), as long as the recordings were.

    Args:
        spectra: of one material, from `subtract`.
        speed_mm_s: foot speed, mm/s, zero or more.
        output_rate_hz: samples a second that the actuator expects, Hz.

    Raises:
        SynthesisError: as `at_speed`, `grid` and `transformable`.

    Source: Okamoto et al., section 3.1.
    """
    bins = BinsAtSpeed(spectra, speed_mm_s)
    on = spectra.grid(output_rate_hz)
    transformable(on)
    return Synthesised(
        summed=lambda: inverse_on(bins.at.coefficients, on),
        floored_bins=bins.at.floored_bins,
        extrapolated=bins.at.extrapolated,
        dropped_bins=spectra.dropped(on),
        bins=bins,
    )
