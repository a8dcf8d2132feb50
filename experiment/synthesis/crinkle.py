"""The crinkle of a material at any foot speed, from recordings at a few speeds: equations (2) to (5) of Okamoto et al.

Two decisions where the paper leaves room or errs:

- "Average the spectra" of three takes: signed coefficients of incoherent takes cancel by about sqrt(3), so the default
  averages magnitudes and takes the sign from the first take. `average="signed"` averages coefficients.
- *Erratum*: (3) as printed takes |C'(v_i+1) - C'(v_i)|, so a bin that falls with speed rises instead and does not
  meet its own measurement at v_i+1. The default takes the signed difference; `literal=True` gives the printed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.spectra import finite, inverse_at_rate, spectrum

Average = Literal["magnitude", "signed"]


@dataclass(frozen=True)
class CrinkleSpectra:
    """What is known of one material: its spectra without the panel, at the measured speeds.

    Attributes:
        speeds_mm_s: v_i, strictly rising, shape (S,), S >= 2.
        rate_hz: sampling rate of the recordings, Hz.
        amplitudes: C'_k(v_i) >= 0, m/s^2, shape (S, N).
        signs: sign of C_k,panel+object(v_i), +1 or -1, shape (S, N).
    """

    speeds_mm_s: NDArray[np.float64]
    rate_hz: int
    amplitudes: NDArray[np.float64]
    signs: NDArray[np.float64]


@dataclass(frozen=True)
class SpectrumAtSpeed:
    """C'_k(v).

    Attributes:
        coefficients: with sign, m/s^2, shape (N,).
        floored_bins: bins that extrapolation would have made negative, set to zero.
        extrapolated: whether v lies outside the measured speeds.
    """

    coefficients: NDArray[np.float64]
    floored_bins: int
    extrapolated: bool


@dataclass(frozen=True)
class Synthesised:
    """A stimulus for one step of the foot.

    Attributes:
        waveform_m_s2: at the output rate, m/s^2, shape (n,).
        floored_bins: as in `SpectrumAtSpeed`.
        extrapolated: as in `SpectrumAtSpeed`.
        dropped_bins: bins that the output rate cannot carry.
    """

    waveform_m_s2: NDArray[np.float64]
    floored_bins: int
    extrapolated: bool
    dropped_bins: int


def subtract(
    *,
    speeds_mm_s: ArrayLike,
    rate_hz: int,
    panel_object_takes: ArrayLike,
    panel_takes: ArrayLike,
    average: Average = "magnitude",
) -> CrinkleSpectra:
    """Spectra of the object alone: C'_k = max(|C_k,panel+object| - |C_k,panel|, 0) at each measured speed.

    Args:
        speeds_mm_s: measured speeds, strictly rising, at least two, shape (S,).
        rate_hz: sampling rate of the takes, Hz.
        panel_object_takes: accelerations with the object on the panel, m/s^2, shape (S, T, N).
        panel_takes: accelerations of the bare panel, m/s^2, shape (S, T', N).
        average: over takes, of the `magnitude` of the coefficients (sign from the first take) or of the `signed`
            coefficients (sign of their mean). A coefficient of exactly zero counts as positive.

    Raises:
        SynthesisError: shapes that do not fit, speeds that do not rise, or values that are not finite.

    Source: Okamoto et al., section 3.1 and equation (2).
    """
    speeds = finite(speeds_mm_s, what="speeds_mm_s")
    if speeds.ndim != 1 or speeds.size < 2 or np.any(np.diff(speeds) <= 0):
        raise SynthesisError(
            f"speeds_mm_s: got {speeds.tolist()}; allowed: at least two, strictly rising; correct the protocol"
        )
    both = finite(panel_object_takes, what="takes of panel and object")
    bare = finite(panel_takes, what="takes of the bare panel")
    if both.ndim != 3 or bare.ndim != 3 or both.shape[::2] != bare.shape[::2] or both.shape[0] != speeds.size:
        raise SynthesisError(
            f"takes: got shapes {both.shape} with and {bare.shape} without the object for {speeds.size} speeds; "
            "allowed: (speeds, takes, samples) with equal speeds and samples; record what is missing"
        )
    coefficients = spectrum(both)
    if average == "magnitude":
        signed, with_object = coefficients[:, 0], np.abs(coefficients).mean(axis=1)
        panel = np.abs(spectrum(bare)).mean(axis=1)
    else:
        signed = coefficients.mean(axis=1)
        with_object, panel = np.abs(signed), np.abs(spectrum(bare).mean(axis=1))
    return CrinkleSpectra(
        speeds_mm_s=speeds,
        rate_hz=rate_hz,
        amplitudes=np.maximum(with_object - panel, 0.0),
        signs=np.where(signed < 0, -1.0, 1.0),
    )


def at_speed(spectra: CrinkleSpectra, *, speed_mm_s: float, literal: bool = False) -> SpectrumAtSpeed:
    """C'_k(v): linear in speed between neighbouring measured speeds, sign from the nearer one (tie: the lower).

    Beyond the measured speeds the outermost line goes on, floored at zero. At a measured speed the measured spectrum
    comes back exactly: (3) is printed for speeds strictly between two measured ones.

    Args:
        spectra: of one material, from `subtract`.
        speed_mm_s: foot speed v, mm/s, zero or more.
        literal: use |C'(v_i+1) - C'(v_i)| as printed (see the module's erratum).

    Raises:
        SynthesisError: a speed that is negative, not finite, or so high that the spectrum overflows.

    Source: Okamoto et al., equations (3) and (4).
    """
    v, speeds = float(speed_mm_s), spectra.speeds_mm_s
    if not (np.isfinite(v) and v >= 0):
        raise SynthesisError(f"speed_mm_s: got {v}; allowed: a finite speed of zero or more; check the tracker")
    lower = int(np.clip(np.searchsorted(speeds, v, side="right") - 1, 0, speeds.size - 2))
    measured = np.flatnonzero(speeds == v)
    if measured.size:
        nearest, amplitudes = int(measured[0]), spectra.amplitudes[measured[0]]
    else:
        nearest = lower if v - speeds[lower] <= speeds[lower + 1] - v else lower + 1
        start, change = spectra.amplitudes[lower], spectra.amplitudes[lower + 1] - spectra.amplitudes[lower]
        if literal:
            change = np.abs(change)
        with np.errstate(over="ignore", invalid="ignore"):
            amplitudes = start + change * ((v - speeds[lower]) / (speeds[lower + 1] - speeds[lower]))
    if not np.all(np.isfinite(amplitudes)):
        raise SynthesisError(f"speed_mm_s: got {v}; allowed: speeds at which the spectrum is finite; check the tracker")
    return SpectrumAtSpeed(
        coefficients=np.maximum(amplitudes, 0.0) * spectra.signs[nearest],
        floored_bins=int(np.count_nonzero(amplitudes < 0)),
        extrapolated=not speeds[0] <= v <= speeds[-1],
    )


def synthesise(
    spectra: CrinkleSpectra, *, speed_mm_s: float, output_rate_hz: int, literal: bool = False
) -> Synthesised:
    """The stimulus for one step: equations (3), (4) and (5), as long as the recordings were.

    Args:
        spectra: of one material, from `subtract`.
        speed_mm_s: foot speed, mm/s, zero or more.
        output_rate_hz: samples a second that the actuator expects, Hz.
        literal: as in `at_speed`.

    Raises:
        SynthesisError: as `at_speed` and `inverse_at_rate`.

    Source: Okamoto et al., section 3.1.
    """
    wanted = at_speed(spectra, speed_mm_s=speed_mm_s, literal=literal)
    waveform = inverse_at_rate(wanted.coefficients, rate_hz=spectra.rate_hz, output_rate_hz=output_rate_hz)
    return Synthesised(
        waveform_m_s2=waveform.samples,
        floored_bins=wanted.floored_bins,
        extrapolated=wanted.extrapolated,
        dropped_bins=waveform.dropped_bins,
    )
