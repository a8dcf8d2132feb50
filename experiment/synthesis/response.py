"""A rig's measured response: the amplitude A(f, e) that it answers a sinusoid of e volts at f with, in m/s^2.

Between the nearest measured values A follows straight lines, first in f at each level, then in e, from 0 at 0 V through
the lowest level to the highest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import SynthesisError
from experiment.synthesis.spectra import finite


@dataclass(frozen=True, eq=False)
class Response:
    """A measured frequency response.

    Attributes:
        frequencies_hz: strictly rising, zero or more, shape (F,), F >= 2.
        levels_v: amplitudes of the driving sinusoid (sqrt 2 times its rms), strictly rising, above zero, shape (L,).
        accelerations_m_s2: amplitudes of the answer (half its peak-to-peak), shape (F, L). At each frequency they
            rise strictly with the level from above zero, or are all zero (a null).

    Raises:
        SynthesisError: anything else.
    """

    frequencies_hz: NDArray[np.float64]
    levels_v: NDArray[np.float64]
    accelerations_m_s2: NDArray[np.float64]

    def __post_init__(self) -> None:
        f = finite(self.frequencies_hz, what="frequencies_hz of the response")
        levels = finite(self.levels_v, what="levels_v of the response")
        a = finite(self.accelerations_m_s2, what="accelerations_m_s2 of the response")
        if f.ndim != 1 or f.size < 2 or f[0] < 0 or np.any(np.diff(f) <= 0):
            raise SynthesisError(
                f"frequencies_hz of the response: got {_few(f)}; allowed: two or more, strictly rising, none below 0; "
                "sort the table"
            )
        if levels.ndim != 1 or levels[0] <= 0 or np.any(np.diff(levels) <= 0):
            raise SynthesisError(
                f"levels_v of the response: got {_few(levels)}; allowed: strictly rising, above 0; sort the table"
            )
        if a.shape != (f.size, levels.size):
            raise SynthesisError(
                f"accelerations_m_s2 of the response: got shape {a.shape}; allowed: {(f.size, levels.size)}, one value "
                "for each frequency and level; measure what is missing"
            )
        place = not_rising(a)
        if place is not None:
            i, j = place
            raise SynthesisError(
                f"accelerations_m_s2 of the response: got {a[i, j]:g} at {f[i]:g} Hz and {levels[j]:g} V after "
                f"{a[i, j - 1] if j else 0.0:g}; allowed: strictly rising with the level, for only then is there an "
                "inverse; measure that frequency again"
            )


def not_rising(accelerations_m_s2: NDArray[np.float64]) -> tuple[int, int] | None:
    """Where a response does not rise strictly with the level from above zero; rows of zeros are nulls and allowed.

    Args:
        accelerations_m_s2: one row a frequency, one column a level, shape (F, L).

    Returns:
        The first such place (row, column); None if there is none.

    Raises:
        SynthesisError: values that are not finite.
    """
    a = finite(accelerations_m_s2, what="accelerations_m_s2 of the response")
    before = np.insert(a[:, :-1], 0, 0.0, axis=1)
    wrong = np.argwhere((a <= before) & np.any(a != 0, axis=1, keepdims=True))
    return (int(wrong[0, 0]), int(wrong[0, 1])) if wrong.size else None


@dataclass(frozen=True)
class AtBins:
    """What a response says of some bins.

    Attributes:
        known: the bins within the table, K of N; nothing is known of the others.
        levels_v: 0 V and each level, shape (1 + L,).
        curves: A(f, e) at these for each known bin, shape (1 + L, K).
    """

    known: NDArray[np.intp] | slice
    levels_v: NDArray[np.float64]
    curves: NDArray[np.float64]

    def voltages_v(self, amplitudes_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        """W(f, a) of each known bin, at most the highest level; amplitudes and voltages of shape (K,), none below 0."""
        segment = (self.curves[1:-1] < amplitudes_m_s2).sum(axis=0)
        return _between(amplitudes_m_s2, *self._ends(segment, slice(None)), *self._levels(segment))

    def amplitudes_m_s2(
        self, voltages_v: NDArray[np.float64], some: NDArray[np.intp] | slice = slice(None)
    ) -> NDArray[np.float64]:
        """A(f, e) of some of the known bins, all by default; voltages and amplitudes one a bin, none below 0."""
        segment = np.searchsorted(self.levels_v[1:-1], voltages_v)
        return _between(voltages_v, *self._levels(segment), *self._ends(segment, some))

    def _ends(
        self, segment: NDArray[np.intp], some: NDArray[np.intp] | slice
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Amplitudes at both ends of a segment of some bins' curves."""
        at = segment * self.curves.shape[1] + np.arange(self.curves.shape[1])[some]
        return self.curves.take(at), self.curves.take(at + self.curves.shape[1])

    def _levels(self, segment: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.levels_v.take(segment), self.levels_v.take(segment + 1)


def at_bins(response: Response, frequencies_hz: NDArray[np.float64], *, mean: bool = False) -> AtBins:
    """Look a response up, once for all spectra of the same bins.

    Args:
        response: of the rig.
        frequencies_hz: of each bin, shape (N,).
        mean: whether a bin at 0 Hz counts as known where the table reaches to 0 Hz; it is no oscillation.
    """
    f, at = finite(frequencies_hz, what="frequencies_hz"), response.frequencies_hz
    within = (f >= at[0]) & (f <= at[-1]) & ((f > 0) | mean)
    known = np.flatnonzero(within)
    f = f[known]
    i = np.clip(np.searchsorted(at, f, side="right") - 1, 0, at.size - 2)
    part = ((f - at[i]) / (at[i + 1] - at[i]))[:, None]
    curves = np.zeros((1 + response.levels_v.size, f.size))
    curves[1:] = ((1 - part) * response.accelerations_m_s2[i] + part * response.accelerations_m_s2[i + 1]).T
    one_run = known.size and known[-1] - known[0] == known.size - 1
    return AtBins(
        known=slice(int(known[0]), int(known[-1]) + 1) if one_run else known,
        levels_v=np.concatenate([[0.0], response.levels_v]),
        curves=curves,
    )


def accelerations(voltages_v: ArrayLike, *, frequencies_hz: ArrayLike, response: Response) -> NDArray[np.float64]:
    """A(f, e), the measured response between its points: what `shape` inverts.

    Args:
        voltages_v: amplitudes with their sign, V, shape (N,).
        frequencies_hz: of each, within the measured ones, Hz, shape (N,).
        response: of the rig.

    Returns:
        Amplitudes with the sign of the voltage, m/s^2, shape (N,).

    Raises:
        SynthesisError: values that are not finite, shapes that do not fit, or a frequency or a level beyond the table.
    """
    signed, f = bins_of(voltages_v, frequencies_hz, what="voltages_v")
    lowest, highest, top_v = response.frequencies_hz[0], response.frequencies_hz[-1], response.levels_v[-1]
    if np.any((f < lowest) | (f > highest)) or np.any(np.abs(signed) > top_v):
        raise SynthesisError(
            f"response: got {f.min():g} to {f.max():g} Hz and up to {np.abs(signed).max():g} V; allowed: "
            f"{lowest:g} to {highest:g} Hz and up to {top_v:g} V, as measured; measure further"
        )
    return accelerations_at(signed, at_bins(response, f, mean=True))


def accelerations_at(voltages_v: NDArray[np.float64], at: AtBins) -> NDArray[np.float64]:
    """As `accelerations`, at bins where the response has been looked up; 0 at those beyond it."""
    voltages_v = finite(voltages_v, what="voltages_v")
    volts, moved = voltages_v[at.known], np.zeros_like(voltages_v)
    moved[at.known] = np.copysign(at.amplitudes_m_s2(np.abs(volts)), volts)
    return moved


def bins_of(
    values: ArrayLike, frequencies_hz: ArrayLike, *, what: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A spectrum and the frequency of each bin, checked."""
    signed, f = finite(values, what=what), finite(frequencies_hz, what="frequencies_hz")
    if signed.ndim != 1 or signed.shape != f.shape:
        raise SynthesisError(
            f"{what}: got shape {signed.shape} for frequencies of shape {f.shape}; allowed: one spectrum, shape (N,) "
            "both; pass the frequency of each bin"
        )
    return signed, f


def _between(
    x: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Straight lines from (`low`, `start`) to (`high`, `end`) at `x`, `end` beyond `high`; all of shape (N,)."""
    part = np.divide(np.minimum(x, high) - low, high - low, out=np.ones_like(x), where=high > low)
    between: NDArray[np.float64] = np.minimum(start + (end - start) * part, end)
    return between


def _few(values: NDArray[np.float64]) -> str:
    text = str(values.tolist())
    return text if len(text) <= 80 else f"{text[:77]}..."
