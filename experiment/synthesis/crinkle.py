"""The crinkle of a material at any foot speed, from recordings at a few speeds: equations (2) to (4) of Okamoto et al.

Two decisions where the paper leaves room or errs:

- "Average the spectra" of three takes: signed coefficients of incoherent takes cancel by about sqrt(3), so the default
  averages magnitudes and takes the sign from the first take. `average="signed"` averages coefficients.
- *Erratum*: (3) as printed takes |C'(v_i+1) - C'(v_i)|, so a bin that falls with speed rises instead and does not
  meet its own measurement at v_i+1. The default takes the signed difference; `literal=True` gives the printed form.
"""

from dataclasses import dataclass
from math import ceil, inf, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.spectra import BAND_HZ, Grid, bin_frequencies_hz, finite, grid, rms, spectrum

Average = Literal["magnitude", "signed"]

LOUDEST_M_S2 = 1e304
"""Largest sum of the amplitudes at one measured speed, m/s^2; no sum of weighted spectra overflows below it."""

FARTHEST = 1e3
"""How many times `LOUDEST_M_S2` extrapolation may reach."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What is still known of bins that are left out of S spectra.

    `products` are their sums of C'_k(v_i) C'_k(v_j) / 2, (m/s^2)^2, shape (S, S); `sums` those of C'_k(v_i) over the
    ones that equation (6) counts, m/s^2, shape (S,).
    """

    products: NDArray[np.float64]
    sums: NDArray[np.float64]

    def at(self, interval: int, way: float) -> tuple[float, float]:
        """Return rms and sum, m/s^2, a part of the way from v_i to v_i+1; beyond them no bin is floored here."""
        pair, weights = slice(interval, interval + 2), np.array([1 - way, way])
        square = float(weights @ self.products[pair, pair] @ weights)
        return sqrt(max(square, 0.0)), max(float(weights @ self.sums[pair]), 0.0)


@dataclass(frozen=True)
class CrinkleSpectra:
    """The spectra of one material without the panel, at the measured speeds v_i, strictly rising, shape (S,), S >= 2.

    `amplitudes` are C'_k(v_i) >= 0, m/s^2, and `signs` those of C_k,panel+object(v_i), +1 or -1, both (S, K); `rate_hz`
    is the recordings'. `recorded` is their N, None where it is K; `band_hz` are the lowest and highest frequency kept,
    and `left_out` the rest; None where all are kept.
    """

    speeds_mm_s: NDArray[np.float64]
    rate_hz: int
    amplitudes: NDArray[np.float64]
    signs: NDArray[np.float64]
    recorded: int | None = None
    band_hz: tuple[float, float] | None = None
    left_out: LeftOut | None = None

    def __post_init__(self) -> None:
        """Refuse what no equation accepts, so that no method need look again. Raises `SynthesisError`."""
        speeds = rising(self.speeds_mm_s)
        amplitudes, signs = finite(self.amplitudes, what="amplitudes"), finite(self.signs, what="signs")
        if amplitudes.ndim != 2 or len(amplitudes) != speeds.size or amplitudes.shape != signs.shape:
            raise SynthesisError(
                f"amplitudes: got shapes {amplitudes.shape} and {signs.shape} (signs) for {speeds.size} speeds; "
                "allowed: (speeds, bins) for both; make them with `subtract`"
            )
        if amplitudes.min() < 0 or np.any(np.abs(signs) != 1):
            raise SynthesisError(
                f"amplitudes: got a minimum of {amplitudes.min():g} and signs from {signs.min():g} to "
                f"{signs.max():g}; allowed: zero or more, and -1 or +1; make them with `subtract`"
            )
        loudest = float(np.max(np.sum(amplitudes / LOUDEST_M_S2, axis=1)))
        if loudest > 1:
            raise SynthesisError(
                f"amplitudes: got a sum of {loudest:g} times {LOUDEST_M_S2:g} m/s^2 at one speed; "
                "allowed: less, or stimuli would overflow; check the unit of the recordings"
            )
        if self.samples < amplitudes.shape[1]:
            raise SynthesisError(
                f"recorded: got {self.samples} samples for {amplitudes.shape[1]} bins; "
                "allowed: at least as many samples as bins; make them with `subtract`"
            )

    def grid(self, output_rate_hz: int) -> Grid:
        """Return the times of a stimulus at an output rate, Hz. Errors are those of `spectra.grid`."""
        bins = self.amplitudes.shape[1]
        return grid(samples=self.samples, bins=bins, rate_hz=self.rate_hz, output_rate_hz=output_rate_hz)

    def dropped(self, on: Grid) -> int:
        """Return how many bins of the recordings a grid cannot carry."""
        return max(0, self.samples - ceil(on.p / on.q))

    @property
    def samples(self) -> int:
        """N, the samples of a recording."""
        return self.amplitudes.shape[1] if self.recorded is None else self.recorded

    def in_time(self, kept: "CrinkleSpectra") -> "CrinkleSpectra":
        """Return what is `kept` of these, with their phase: that of its signs."""
        return kept

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return self.speeds_mm_s.nbytes + self.amplitudes.nbytes + self.signs.nbytes


@dataclass(frozen=True)
class SpectrumAtSpeed:
    """C'_k(v) with its sign, m/s^2, shape (N,).

    `floored_bins` counts bins that extrapolation would make negative, `extrapolated`: v is outside the measured speeds.
    """

    coefficients: NDArray[np.float64]
    floored_bins: int
    extrapolated: bool


def rising(speeds_mm_s: ArrayLike) -> NDArray[np.float64]:
    """Return speeds, mm/s, shape (S,). Raises `SynthesisError` unless there are two or more that rise strictly."""
    speeds = finite(speeds_mm_s, what="speeds_mm_s")
    if speeds.ndim != 1 or speeds.size < 2 or np.any(np.diff(speeds) <= 0):
        raise SynthesisError(
            f"speeds_mm_s: got {speeds.tolist()}; allowed: at least two, strictly rising; correct the protocol"
        )
    return speeds


def foot_speed(speed_mm_s: float) -> float:
    """Return a foot's speed, mm/s. Raises `SynthesisError` unless it is finite and zero or more."""
    v = float(speed_mm_s)
    if not 0 <= v < inf:
        raise SynthesisError(f"speed_mm_s: got {v}; allowed: a finite speed of zero or more; check the tracker")
    return v


def subtract(
    *,
    speeds_mm_s: ArrayLike,
    rate_hz: int,
    panel_object_takes: ArrayLike,
    panel_takes: ArrayLike,
    average: Average = "magnitude",
) -> CrinkleSpectra:
    """Return the spectra of the object alone: C'_k = max(|C_k,panel+object| - |C_k,panel|, 0) at each measured speed.

    Speeds rise strictly, at least two, shape (S,). Takes are accelerations, m/s^2, at `rate_hz`, with the object, shape
    (S, T, N), and of the bare panel, (S, T', N). They are averaged by `magnitude` (sign of the first take) or as
    `signed` coefficients (sign of their mean); exact zeros count as positive. Raises `SynthesisError` for bad shapes,
    speeds or values. Source: Okamoto et al., section 3.1 and equation (2).
    """
    speeds = rising(speeds_mm_s)
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
    """Return C'_k(v): linear in speed between neighboring measured speeds, sign from the nearer one (tie: the lower).

    Beyond the measured speeds the outermost line continues, floored at zero. At a measured speed its spectrum is
    returned exactly. `literal` uses |C'(v_i+1) - C'(v_i)| as printed (see the module's erratum). The tie is decided in
    float64: the sign is that of v_i+1 if the rounded v - v_i is above the rounded v_i+1 - v, else that of v_i.

    Raises `SynthesisError` if the speed, mm/s, is negative, not finite, or so high that the spectrum overflows. Source:
    Okamoto et al., equations (3) and (4).
    """
    v, speeds = foot_speed(speed_mm_s), spectra.speeds_mm_s
    lower = min(max(int(np.searchsorted(speeds, v, side="right")) - 1, 0), speeds.size - 2)
    below_mm_s, above_mm_s = v - speeds[lower], speeds[lower + 1] - v
    nearest = lower if below_mm_s <= above_mm_s else lower + 1
    extrapolated = not speeds[0] <= v <= speeds[-1]
    gap_mm_s = speeds[lower + 1] - speeds[lower]
    first, second = spectra.amplitudes[lower], spectra.amplitudes[lower + 1]
    with np.errstate(over="ignore", invalid="ignore"):
        if speeds[nearest] == v:
            amplitudes = spectra.amplitudes[nearest]
        elif literal:
            amplitudes = first + np.abs(second - first) * (below_mm_s / gap_mm_s)
        elif extrapolated:
            # From the nearer speed on: from v_i, a bin that falls would cancel to less than its rounding.
            amplitudes = spectra.amplitudes[nearest] + (second - first) * ((v - speeds[nearest]) / gap_mm_s)
        else:
            # Two terms of one sign, so that no bin loses digits, even one that falls to nothing.
            amplitudes = first * (above_mm_s / gap_mm_s) + second * (below_mm_s / gap_mm_s)
        sounding = np.maximum(amplitudes, 0.0)
        total = sounding.sum()
        floored = np.count_nonzero(amplitudes < 0)
    if not total <= LOUDEST_M_S2 * FARTHEST:
        raise SynthesisError(f"speed_mm_s: got {v}; allowed: speeds at which the spectrum is finite; check the tracker")
    return SpectrumAtSpeed(
        coefficients=sounding * spectra.signs[nearest], floored_bins=int(floored), extrapolated=extrapolated
    )


def leave_out(spectra: CrinkleSpectra, *, band_hz: tuple[float, float]) -> CrinkleSpectra:
    """Return spectra, which take less memory, without the bins above a band, and silent below it.

    `band_hz` are its lowest and highest frequency, both included, Hz. Raises `SynthesisError` unless they rise.
    """
    inside = ~_outside(spectra, band_hz)
    f = bin_frequencies_hz(bins=spectra.samples, rate_hz=spectra.rate_hz)[: inside.size]
    gone = np.where(inside | (f == 0), 0.0, spectra.amplitudes)
    counted = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    bins = int(np.flatnonzero(inside)[-1]) + 1 if inside.any() else 1
    return CrinkleSpectra(
        speeds_mm_s=spectra.speeds_mm_s,
        rate_hz=spectra.rate_hz,
        amplitudes=np.where(inside[:bins], spectra.amplitudes[:, :bins], 0.0),
        signs=spectra.signs[:, :bins].copy(),
        recorded=spectra.samples,
        band_hz=band_hz,
        left_out=LeftOut(products=gone @ gone.T / 2, sums=gone[:, counted].sum(axis=1)),
    )


def rms_outside(spectra: CrinkleSpectra, *, band_hz: tuple[float, float], fastest_mm_s: float) -> float:
    """Return the largest rms of all that lies outside a band together, at any speed up to `fastest_mm_s`, m/s^2.

    Bins are taken together, since a bin's part depends on the length of the take; no other part has a larger rms, in
    which thresholds are stated. The rms is convex between measured speeds, so it is largest at one of these, at 0 mm/s
    or at the fastest. `band_hz` are the lowest and highest frequency, both included, Hz. Raises `SynthesisError` unless
    they rise, or for a speed at which there is no spectrum.
    """
    measured = spectra.amplitudes[spectra.speeds_mm_s <= fastest_mm_s]
    ends = [np.abs(at_speed(spectra, speed_mm_s=v).coefficients) for v in (0.0, fastest_mm_s)]
    # On the recordings' own grid, which carries every bin.
    levels = rms(np.vstack([measured, *ends]) * _outside(spectra, band_hz), spectra.grid(spectra.rate_hz))
    return float(levels.max())


def _outside(spectra: CrinkleSpectra, band_hz: tuple[float, float]) -> NDArray[np.bool_]:
    low_hz, high_hz = band_hz
    if not 0 <= low_hz < high_hz:
        raise SynthesisError(f"band_hz: got {low_hz} to {high_hz}; allowed: two rising frequencies; correct the band")
    f = bin_frequencies_hz(bins=spectra.samples, rate_hz=spectra.rate_hz)[: spectra.amplitudes.shape[1]]
    return np.asarray((f < low_hz) | (f > high_hz))
