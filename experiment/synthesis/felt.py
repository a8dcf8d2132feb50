"""How a movement differs from what was asked for: third octaves, how loud it is over time, and how probably a person
notices that, by a model.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.synthesis.noticing import SOLE, noticed, third_octave_energies
from palpate.experiment.synthesis.spectra import finite

LEAST_SHARE = 1e-3
"""A third octave with less of the energy than this does not count."""

WINDOW_S = 0.02
"""How long the level of a vibration is averaged, s: ours."""

QUIETEST_DB = 20.0
"""A window so far below the loudest one does not count."""


@dataclass(frozen=True)
class Felt:
    """By how much a movement differs from what was asked for at the worst, in magnitude, dB.

    `third_octave_db` is of third octaves, `envelope_db` of the levels of windows in time; each with an interval that
    allows for a soft coil and for drift. The difference is noticed with these probabilities, by the model of
    `noticing.py`.
    """

    third_octave_db: float
    envelope_db: float
    noticed_at_least: float
    noticed_at_most: float
    third_octave_between_db: tuple[float, float] = (0.0, inf)
    envelope_between_db: tuple[float, float] = (0.0, inf)


def felt(asked_m_s2: NDArray[np.float64], moved_m_s2: NDArray[np.float64], *, rate_hz: int) -> Felt:
    """Return how a movement, shape (m,), differs from what was asked for, (n,), from the same moment on; m >= n.

    A request of silence differs from no movement by nothing.
    """
    size = moved_m_s2.size
    energies = (third_octave_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    with np.errstate(divide="ignore"):
        asked_db, moved_db = (10 * np.log10(one / (size * asked_m_s2.size)) for one in energies)
    thirds, envelope = (_highest(np.abs(one)) for one in _errors_db(asked_m_s2, moved_m_s2, rate_hz))
    return Felt(thirds, envelope, *noticed(asked_db, moved_db, SOLE))


def felt_between(
    asked_m_s2: NDArray[np.float64],
    linear_m_s2: NDArray[np.float64],
    soft_m_s2: NDArray[np.float64],
    *,
    rate_hz: int,
    drift_db: float,
) -> Felt:
    """Return the same of the first of two movements, with intervals for every coil between theirs and for drift."""
    finite([drift_db], what="drift_db")
    linear, soft = (_errors_db(asked_m_s2, one, rate_hz) for one in (linear_m_s2, soft_m_s2))
    thirds, envelope = (_interval(one, other, drift_db) for one, other in zip(linear, soft, strict=True))
    return replace(
        felt(asked_m_s2, linear_m_s2, rate_hz=rate_hz), third_octave_between_db=thirds, envelope_between_db=envelope
    )


def _errors_db(
    asked_m_s2: NDArray[np.float64], moved_m_s2: NDArray[np.float64], rate_hz: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return by how much each third octave and each window that counts is too loud, dB."""
    size = moved_m_s2.size
    wanted, found = (third_octave_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    before, after = (_window_energies(one, size, rate_hz) for one in (asked_m_s2, moved_m_s2))
    quietest = float(before.max()) * 10 ** (-QUIETEST_DB / 10)
    return _louder_db(wanted, found, LEAST_SHARE * float(wanted.sum())), _louder_db(before, after, quietest)


def _interval(one_db: NDArray[np.float64], other_db: NDArray[np.float64], drift_db: float) -> tuple[float, float]:
    """Return between what the worst magnitude is if each error is between two values. It may be below both worsts."""
    low, high = np.minimum(one_db, other_db), np.maximum(one_db, other_db)
    return max(_highest(np.maximum(low, -high)) - drift_db, 0.0), _highest(np.maximum(-low, high)) + drift_db


def _highest(magnitudes_db: NDArray[np.float64]) -> float:
    return float(magnitudes_db.max(initial=0.0))


def _window_energies(waveform_m_s2: NDArray[np.float64], size: int, rate_hz: int) -> NDArray[np.float64]:
    """Return the energy of one window after the other."""
    window = round(WINDOW_S * rate_hz)
    whole = -(-size // window) * window
    return np.asarray(np.square(np.pad(waveform_m_s2, (0, whole - waveform_m_s2.size))).reshape(-1, window).sum(axis=1))


def _louder_db(wanted: NDArray[np.float64], found: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    counts = wanted > least if least > 0 else wanted > 0
    return np.asarray(10 * np.log10(np.maximum(found[counts], 1e-12 * wanted[counts]) / wanted[counts]))
