"""The stimulus of one step: equations (3) to (5) of Okamoto et al., from waveforms that are made beforehand.

Between measured speeds (3) and (4) make a weighted sum of two waveforms: C'(v) = s_j (C'(v_j) + t (C'(v_l) - C'(v_j))),
v_j being the nearer speed of an interval, v_l the other, and t = (v - v_j) / (v_l - v_j). So 3 S - 2 waveforms for S
speeds are prepared, and a step costs one product and one sum. At a measured speed the result is exact to the bit.

Beyond them t < 0 is valid as long as no bin that sounds is floored and the two terms stay within `CANCELLATION` times
the vibration at the nearest measured speed. Outside these limits a zero-padded inverse DCT takes over. Subtracting
cosines would cost some 30 us a floored bin, a quarter of the DCT; of a simulated material's 2,500 bins up to 13 are
floored 10 mm/s beyond the fastest recording, and 60 to 90 at 100 mm/s.

The relative error of a waveform is the rms of its difference from the exact one over the rms of that, by Parseval over
the bins that the output rate carries; in extrapolation the divisor is at least the rms at the nearest measured speed.
Rounding of numbers below 1e-307 adds at most `denormal_error_m_s2`. `experiment/decisions.md` has how large the two
terms are beside their sum.

Frequency shaping (7) is not linear in amplitude: `voltages.py` prepares shaped waveforms.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from math import log2, sqrt
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.synthesis.crinkle import CrinkleSpectra, SpectrumAtSpeed, at_speed, foot_speed
from palpate.experiment.synthesis.spectra import Bins, Grid, grid, inverse_on, rms, spectrum, transformable

if TYPE_CHECKING:
    import pandas as pd

ROUNDING = float(np.finfo(np.float64).eps) / 2
"""u, the largest relative error of one rounding of a float64."""

LEAST = 5e-324
"""The smallest float64: what the rounding of a denormal number costs at most, twice."""

CANCELLATION = 8.0
"""Largest sum of the two terms' rms in extrapolation, over the rms at the nearest speed; in between at most 3."""

MARGIN = 1e-9
"""How far before the first bin falls to zero, as a part of the way there, the inverse DCT takes over."""


@dataclass(frozen=True, eq=False)
class Ring:
    """The vibration of one tap as a device is to play it: samples, m/s^2, shape (n,), at a rate, Hz."""

    waveform_m_s2: NDArray[np.float64]
    rate_hz: int
    omitted_m_s2: tuple[float, float] = (0.0, 0.0)
    occasion: ClassVar[str] = "tap"
    method: ClassVar[str] = "equation (2)"
    band: ClassVar[str] = ""
    extrapolated: ClassVar[bool] = False
    floored_bins: ClassVar[int] = 0

    @property
    def mean_m_s2(self) -> float:
        return float(self.waveform_m_s2.mean())

    @property
    def exact(self) -> NDArray[np.float64]:
        return self.waveform_m_s2

    @property
    def bins(self) -> Bins:
        """As many bins as samples. Errors are those of `spectra.spectrum`."""
        return Bins(spectrum(self.waveform_m_s2), samples=self.waveform_m_s2.size, rate_hz=self.rate_hz)

    @property
    def on(self) -> Grid:
        n = self.waveform_m_s2.size
        return grid(samples=n, bins=n, rate_hz=self.rate_hz, output_rate_hz=self.rate_hz)


@dataclass(frozen=True, eq=False)
class Basis:
    """One material, prepared for one output rate; `prepare` makes it.

    `on` is that rate's grid, `speeds_mm_s` are the v_i; sums are valid from `lowest_mm_s` to `highest_mm_s`. `pairs`
    are, for each interval and each of its speeds v_j, the waveforms of C'(v_j) and C'(v_l) - C'(v_j), with the signs of
    v_j, m/s^2, shape (n,).
    """

    material: str
    spectra: CrinkleSpectra
    output_rate_hz: int
    on: Grid
    speeds_mm_s: tuple[float, ...]
    lowest_mm_s: float
    highest_mm_s: float
    pairs: tuple[tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...], ...]

    @property
    def band(self) -> str:
        """The band outside of which bins are left out, as records and plans name it; empty where none are."""
        band_hz = self.spectra.band_hz
        return "" if band_hz is None else f", {band_hz[0]:g} to {band_hz[1]:g} Hz"

    @property
    def nbytes(self) -> int:
        """Memory of the spectra and of the 3 S - 2 waveforms, each of which is held once."""
        return self.spectra.nbytes + (3 * len(self.speeds_mm_s) - 2) * self.pairs[0][0][0].nbytes

    def at(self, speed_mm_s: float) -> Stimulus:
        """Return the stimulus of a step, summed lazily. Raises `SynthesisError` for a negative or infinite speed."""
        v, speeds = float(speed_mm_s), self.speeds_mm_s
        held = self.lowest_mm_s <= v <= self.highest_mm_s
        if not held:
            foot_speed(v)
        i = min(max(bisect_right(speeds, v) - 1, 0), len(speeds) - 2)
        below, above = v - speeds[i], speeds[i + 1] - v
        nearer = int(below > above)
        return Stimulus(self, v, i, nearer, (above if nearer else below) / (speeds[i + 1] - speeds[i]), held)


@dataclass(frozen=True)
class Stimulus:
    """What one step of the foot calls for; `Basis.at` makes it.

    The speed lies between or beside v_i and v_i+1, i being the `interval`; `nearer` is 0 for v_i, 1 for v_i+1.
    `of_difference` is t, from the nearer speed to the other: 0 to 1/2 between, negative beyond. `held`: a sum is valid.
    """

    basis: Basis
    speed_mm_s: float
    interval: int
    nearer: int
    of_difference: float
    held: bool
    occasion: ClassVar[str] = "step"
    mean_m_s2: ClassVar[float] = 0.0

    def __repr__(self) -> str:
        beyond = ", extrapolated" if self.extrapolated else ""
        samples, hz = len(self.waveform_m_s2), self.rate_hz
        return f"<Stimulus {self.basis.material} at {self.speed_mm_s:g} mm/s{beyond}: {samples} samples at {hz} Hz>"

    def to_frame(self) -> pd.DataFrame:
        """Return the waveform: time_s from the first sample, and acceleration_m_s2."""
        import pandas as pd

        times_s = np.arange(len(self.waveform_m_s2)) / self.rate_hz
        return pd.DataFrame({"time_s": times_s, "acceleration_m_s2": self.waveform_m_s2})

    @property
    def extrapolated(self) -> bool:
        """Whether the speed lies outside the measured ones."""
        return not self.basis.speeds_mm_s[0] <= self.speed_mm_s <= self.basis.speeds_mm_s[-1]

    @property
    def floored_bins(self) -> int:
        """How many of the bins held extrapolation would have made negative. Errors are those of `at_speed`."""
        return self.spectrum.floored_bins if self.extrapolated else 0

    @cached_property
    def spectrum(self) -> SpectrumAtSpeed:
        """C'_k(v), worked out when it is first asked for. Errors are those of `at_speed`."""
        return at_speed(self.basis.spectra, speed_mm_s=self.speed_mm_s)

    @property
    def rate_hz(self) -> int:
        return self.basis.output_rate_hz

    @property
    def on(self) -> Grid:
        return self.basis.on

    @property
    def method(self) -> str:
        return "basis waveforms" if self.held else "inverse DCT"

    @property
    def band(self) -> str:
        return self.basis.band

    @property
    def exact(self) -> NDArray[np.float64]:
        return self.spectrum.coefficients

    @property
    def omitted_m_s2(self) -> tuple[float, float]:
        left_out, speeds = self.basis.spectra.left_out, self.basis.speeds_mm_s
        if left_out is None:
            return 0.0, 0.0
        slow, fast = speeds[self.interval : self.interval + 2]
        return left_out.at(self.interval, (self.speed_mm_s - slow) / (fast - slow))

    @property
    def bins(self) -> Bins:
        """The bins whose sum the waveform is. Errors are those of `at_speed`."""
        of = self.basis.spectra
        return Bins(self.spectrum.coefficients, samples=of.samples, rate_hz=of.rate_hz)

    @cached_property
    def waveform_m_s2(self) -> NDArray[np.float64]:
        """The waveform, m/s^2, shape (n,), summed when it is first asked for. Errors are those of `at_speed`."""
        if not self.held:
            return inverse_on(self.spectrum.coefficients, self.basis.on)
        own, difference = self.basis.pairs[self.interval][self.nearer]
        summed: NDArray[np.float64] = difference * self.of_difference
        summed += own
        return summed


Waveform: TypeAlias = Stimulus | Ring
"""What a device is asked to play, with one face: samples, m/s^2, at `rate_hz`, which are the sum of `bins` on the grid
`on` and `mean_m_s2`, what stands at 0 Hz. The bins lack `omitted_m_s2` because it is not felt: its rms, and its sum in
the band of equation (6). `exact` are the numbers that say what is asked for without rounding. `method`, `band` and
`occasion` are for records: what makes the samples, the band outside of which bins are omitted, and for what."""


def prepare(spectra: CrinkleSpectra, *, material: str, output_rate_hz: int) -> Basis:
    """Return the prepared waveforms of one material at `output_rate_hz`, Hz: Okamoto et al., section 3.1, (3) to (5).

    Raises as `spectra.grid` and `spectra.inverse_on`.
    """
    on = spectra.grid(output_rate_hz)
    transformable(on)
    amplitudes, signs = spectra.amplitudes[:, : on.carried].copy(), spectra.signs[:, : on.carried]
    amplitudes[:, 0] = 0.0  # it sounds in no waveform, and may be larger than what does
    own = [inverse_on(amplitudes[j] * signs[j], on) for j in range(len(amplitudes))]

    def pair(j: int, other: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return own[j], inverse_on((amplitudes[other] - amplitudes[j]) * signs[j], on)

    # Between the lowest and the highest speed no bin is floored, and too little cancels to matter. The amplitudes of
    # bins that do not sound end nothing.
    speeds, levels = spectra.speeds_mm_s, rms(spectra.amplitudes, on)
    down = _steps_out(amplitudes[0], amplitudes[1], levels[0], levels[1])
    up = _steps_out(amplitudes[-1], amplitudes[-2], levels[-1], levels[-2])
    lowest, highest = speeds[0] - down * (speeds[1] - speeds[0]), speeds[-1] + up * (speeds[-1] - speeds[-2])
    return Basis(
        material=material,
        spectra=spectra,
        output_rate_hz=output_rate_hz,
        on=on,
        speeds_mm_s=tuple(spectra.speeds_mm_s.tolist()),
        # Rounded inwards: the next number may lie beyond a floor that is nearer than half of its distance.
        lowest_mm_s=max(float(np.nextafter(lowest, speeds[0])), 0.0),
        highest_mm_s=float(np.nextafter(highest, speeds[-1])),
        pairs=tuple((pair(i, i + 1), pair(i + 1, i)) for i in range(len(own) - 1)),
    )


def relative_error(on: Grid) -> float:
    """Return the bound on the relative error of `Stimulus.waveform_m_s2` at any speed, on a grid (see the module)."""
    return CANCELLATION * (4 * ROUNDING * sqrt(on.p / on.count) + 4 * ROUNDING + transform_error(on))


def denormal_error_m_s2(samples: int) -> float:
    """Return the error that rounding of numbers below 1e-307 adds, m/s^2, with N samples of the recordings.

    Weights round twice a bin, by `LEAST` at most; waveforms, of normal numbers (`spectra.LIFT`), once a sample,
    weighted by 8 at most (`CANCELLATION`).
    """
    return (2 * samples + 16) * LEAST


def transform_error(on: Grid) -> float:
    """Return the bound on the relative error of an inverse DCT on a grid.

    For powers of two the error's norm is within about 7 log2(length) roundings of the result's (Higham, Accuracy and
    Stability of Numerical Algorithms, theorem 24.2); 8 and two steps more cover the other passes. For other lengths,
    such as 24,000, the bound is measured. `count` of p samples may hold all of the error.
    """
    return 8 * log2(4 * on.p) * ROUNDING * sqrt(on.p / on.count)


def _steps_out(
    nearest: NDArray[np.float64], next_nearest: NDArray[np.float64], level: float, next_level: float
) -> float:
    """Return how far beyond the nearest measured speed the weighted sum holds, in gaps between these two speeds."""
    falling = nearest < next_nearest
    with np.errstate(over="ignore"):
        until_floor = np.min(nearest[falling] / (next_nearest[falling] - nearest[falling]), initial=np.inf)
    if level == 0:
        return 0.0
    until_cancelled = (CANCELLATION - 1) * level / (level + next_level)
    return float(min(until_floor * (1 - MARGIN), until_cancelled))
