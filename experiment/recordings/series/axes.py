"""One channel of an accelerometer's several axes: what a skin that feels no direction is given."""

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

Reduction = Literal["dft321", "norm"]


def dft321(axes: Floats) -> Floats:
    """Return one signal, shape (n,), with the power spectrum of all `axes` together, shape (axes, n).

    Each frequency has the root of the sum of the axes' squared magnitudes, and the phase of their sum (Landin, Romano,
    McMahan, Kuchenbecker: Dimensional reduction of high-frequency accelerations for haptic rendering, EuroHaptics 2010,
    equations 1 to 3). The mean of each axis, such as gravity, is taken off first.
    """
    spectra = np.fft.rfft(axes - axes.mean(axis=1, keepdims=True), axis=1)
    magnitudes = np.sqrt((np.abs(spectra) ** 2).sum(axis=0))
    return np.fft.irfft(magnitudes * np.exp(1j * np.angle(spectra.sum(axis=0))), axes.shape[1])


def norm(axes: Floats) -> Floats:
    """Return the length of the acceleration without each axis's mean, shape (n,): never negative, so that a vibration
    along one axis has twice its frequency there."""
    return np.asarray(np.linalg.norm(axes - axes.mean(axis=1, keepdims=True), axis=0))


REDUCTIONS: Mapping[Reduction, Callable[[Floats], Floats]] = {"dft321": dft321, "norm": norm}
