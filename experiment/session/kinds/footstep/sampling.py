"""What recordings at a few speeds, a few takes at each, leave open: shares of the rms recorded."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.spectra import spectrum


def interpolation(spectra: CrinkleSpectra) -> NDArray[np.float64]:
    """Return what interpolation between speeds misses, as a share of the rms recorded, at each speed, shape (S,).

    Each inner speed is left out and predicted from its two neighbors; NaN at both ends. With the speed in place,
    curvature contributes about a quarter of this; differences between takes remain.
    """
    v, amplitudes = spectra.speeds_mm_s, spectra.amplitudes[:, 1:]
    way = ((v[1:-1] - v[:-2]) / (v[2:] - v[:-2]))[:, None]
    missed = amplitudes[:-2] * (1 - way) + amplitudes[2:] * way - amplitudes[1:-1]
    return np.pad(_shares(missed, amplitudes[1:-1]), 1, constant_values=np.nan)


def averaging(
    spectra: CrinkleSpectra, *, panel_object_takes: NDArray[np.float64], panel_takes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the standard error of the mean over takes, as a share of the rms recorded, shape (S,); NaN for one take.

    It combines the magnitudes with and without the object, shapes (S, T, N) and (S, T', N), behind `spectra`.
    """
    variance = np.zeros(panel_object_takes.shape[::2])
    for takes in (panel_object_takes, panel_takes):
        if takes.shape[1] < 2:
            return np.full(spectra.speeds_mm_s.size, np.nan)
        variance += np.abs(spectrum(takes)).var(axis=1, ddof=1) / takes.shape[1]
    return _shares(np.sqrt(variance[:, 1:]), spectra.amplitudes[:, 1:])


PROFILE = "profile (5 ms) of the takes", "profile from neighbors", "the same, random phases"
LATE = "energy late or early, ms", "the same, random phases, ms"
"""Lines of profiles in time: as parts of that of the takes, and how far in time."""


def profile_rows(profiles: Sequence[tuple[float | None, ...]], shown: Callable[[float | None], str]) -> list[list[str]]:
    """Return the lines of `signals.phase.profile_error` of each material, shares as `shown`; none without phases."""
    if not any(profiles):
        return []
    shares = [[name, *(shown(one[i]) for one in profiles)] for i, name in enumerate(PROFILE)]
    late = [["unknown" if (ms := one[i]) is None else f"up to {ms:.0f}" for one in profiles] for i in (3, 4)]
    return [*shares, *([name, *each] for name, each in zip(LATE, late, strict=True))]


def _shares(parts: NDArray[np.float64], wholes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rms of each row as a part of that of another, NaN or infinity where that is silent."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(parts, axis=1) / np.linalg.norm(wholes, axis=1))
