"""Levels in dB(A), and the dose of a day: pure functions.

The dose is that of Directive 2003/10/EC, articles 2 and 3: levels are referred to eight hours, equal energy (3 dB more
in half the time), and the lower exposure action value of 80 dB(A) is a dose of 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

REFERENCE_S = 8 * 3600.0
"""Working day that levels are referred to, s."""

ACTION_DB_A = 80.0
"""Lower exposure action value of the daily level, dB(A)."""

AUDIBLE_HZ = 20.0
"""Pink noise of a calibration reaches from here to half the sampling rate, as `synthesis.noise` makes it."""

_POLES_HZ = (20.598997, 107.65265, 737.86223, 12194.217)
"""Of the weighting: IEC 61672-1, annex E."""


def a_weighting_db(*, frequency_hz: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """A-weighting of IEC 61672-1, equation (E.6), relative to 1 kHz.

    Args:
        frequency_hz: above 0, shape (n,).

    Returns:
        dB, shape (n,).
    """
    return _unnormalised_db(np.asarray(frequency_hz, np.float64)) - float(_unnormalised_db(np.array([1000.0]))[0])


def _unnormalised_db(f: NDArray[np.float64]) -> NDArray[np.float64]:
    f1, f2, f3, f4 = _POLES_HZ
    response = f4**2 * f**4 / ((f**2 + f1**2) * np.sqrt((f**2 + f2**2) * (f**2 + f3**2)) * (f**2 + f4**2))
    level_db: NDArray[np.float64] = 20 * np.log10(response)
    return level_db


def weighted_db(*, frequency_hz: NDArray[np.floating[Any]], power: NDArray[np.floating[Any]]) -> float:
    """A-weighted level of a sound relative to its unweighted level.

    Args:
        frequency_hz: above 0, shape (n,).
        power: at these frequencies, any unit, shape (n,).

    Returns:
        dB.
    """
    weights = 10 ** (a_weighting_db(frequency_hz=frequency_hz) / 10)
    return float(10 * np.log10(np.sum(weights * power) / np.sum(power)))


def pink_weighted_db(*, rate_hz: int) -> float:
    """`weighted_db` of pink noise from `AUDIBLE_HZ` to half a sampling rate, dB.

    Args:
        rate_hz: sampling rate, Hz.
    """
    f = np.arange(AUDIBLE_HZ, rate_hz / 2, 0.5)
    return weighted_db(frequency_hz=f, power=1 / f)


def dose(*, level_db_a: float, duration_s: float) -> float:
    """Part of a day's dose that a steady level uses up; doses add.

    Args:
        level_db_a: dB(A).
        duration_s: s, not negative.
    """
    return float(duration_s / REFERENCE_S * 10 ** ((level_db_a - ACTION_DB_A) / 10))


def daily_level_db_a(*, dose: float) -> float:
    """Daily exposure level L_EX,8h of a dose, dB(A); -inf for none.

    Args:
        dose: sum over the day, 1 being 80 dB(A) for eight hours.
    """
    return ACTION_DB_A + 10 * float(np.log10(dose)) if dose > 0 else -np.inf


def left_s(*, dose: float, level_db_a: float) -> float:
    """How long a level may go on until the day's dose is 1, s.

    Args:
        dose: used up already.
        level_db_a: dB(A).
    """
    return float(max(1 - dose, 0) * REFERENCE_S / 10 ** ((level_db_a - ACTION_DB_A) / 10))
