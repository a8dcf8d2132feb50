"""The sum of equation (5) at another rate: a grid, and the inverse on it, as every renderer calls them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.synthesis.spectra import grid, inverse_on


def resampled(coefficients: ArrayLike, *, rate_hz: int, output_rate_hz: int) -> NDArray[np.float64]:
    """Samples at the output rate."""
    bins = np.shape(coefficients)[-1]
    return inverse_on(coefficients, grid(samples=bins, bins=bins, rate_hz=rate_hz, output_rate_hz=output_rate_hz))
