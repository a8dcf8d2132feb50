"""The limiter: last before the device, and it holds for any input."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiment.errors import ActuatorError


def limit(waveform_m_s2: ArrayLike, peak_m_s2: float) -> tuple[NDArray[np.float64], int]:
    """Bound every sample.

    Args:
        waveform_m_s2: any samples, m/s^2, NaN and infinity included, any shape.
        peak_m_s2: largest magnitude that may pass, m/s^2, finite and not negative.

    Returns:
        Samples of the same shape, none larger in magnitude than `peak_m_s2`: NaN becomes 0, all else the nearest
        value allowed. Where none had to be changed they are the samples given, not a copy. And how many were changed.

    Raises:
        ActuatorError: `peak_m_s2` is no limit.
    """
    if not (math.isfinite(peak_m_s2) and peak_m_s2 >= 0):
        raise ActuatorError(f"limiter: got a limit of {peak_m_s2} m/s^2; allowed: a finite number, not negative")
    wanted = np.asarray(waveform_m_s2, dtype=np.float64)
    lowest, highest = wanted.min(initial=0.0), wanted.max(initial=0.0)
    if -peak_m_s2 <= lowest and highest <= peak_m_s2:
        return wanted, 0
    numbers = np.where(np.isnan(wanted), 0.0, wanted) if math.isnan(lowest) else wanted
    bounded = np.clip(numbers, -peak_m_s2, peak_m_s2)
    return bounded, int(np.count_nonzero(bounded != wanted))
