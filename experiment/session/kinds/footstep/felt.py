"""What a measured panel makes of a stimulus beside what was asked for: third octaves, and how loud it is over time.

Both follow from the panel's complex response, so that what its phase does to a vibration is in them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

THIRDS_HZ = 10 ** (np.arange(10, 28) / 10)
"""Middles of third octaves, nominally 10 to 500 Hz (IEC 61260-1)."""

LEAST_SHARE = 1e-3
"""A third octave with less of the energy than this does not count."""

WINDOW_S = 0.02
"""How long the level of a vibration is averaged, s: ours."""

QUIETEST_DB = 20.0
"""A window so far below the loudest one does not count."""


@dataclass(frozen=True)
class Felt:
    """By how much a movement differs from what was asked for at the worst, in magnitude, dB.

    `third_octave_db` is of third octaves, `envelope_db` of the levels of windows in time.
    """

    third_octave_db: float
    envelope_db: float


def felt(asked_m_s2: NDArray[np.float64], moved_m_s2: NDArray[np.float64], *, rate_hz: int) -> Felt:
    """Return how a movement, shape (m,), differs from what was asked for, (n,), from the same moment on; m >= n.

    A request of silence differs from no movement by nothing.
    """
    size = moved_m_s2.size
    wanted, found = (_third_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    thirds = _worst_db(wanted, found, LEAST_SHARE * float(wanted.sum()))
    before, after = (_window_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    return Felt(thirds, _worst_db(before, after, float(before.max()) * 10 ** (-QUIETEST_DB / 10)))


def _third_energies(waveform_m_s2: NDArray[np.float64], size: int, rate_hz: int) -> NDArray[np.float64]:
    """Return the energy in each third octave, shape (18,)."""
    power = np.square(np.abs(np.fft.rfft(waveform_m_s2, 2 * size)))
    ends = np.searchsorted(np.fft.rfftfreq(2 * size, 1 / rate_hz), [*(THIRDS_HZ / 10**0.05), THIRDS_HZ[-1] * 10**0.05])
    return np.diff(np.concatenate([[0.0], np.cumsum(power)])[ends])


def _window_energies(waveform_m_s2: NDArray[np.float64], size: int, rate_hz: int) -> NDArray[np.float64]:
    """Return the energy of one window after the other."""
    window = round(WINDOW_S * rate_hz)
    whole = -(-size // window) * window
    return np.asarray(np.square(np.pad(waveform_m_s2, (0, whole - waveform_m_s2.size))).reshape(-1, window).sum(axis=1))


def _worst_db(wanted: NDArray[np.float64], found: NDArray[np.float64], least: float) -> float:
    counts = wanted > least if least > 0 else wanted > 0
    if not counts.any():
        return 0.0
    return float(np.abs(10 * np.log10(np.maximum(found[counts], 1e-12 * wanted[counts]) / wanted[counts])).max())
