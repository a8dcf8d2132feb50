"""How far spectra are from one another: equation (6) of Okamoto et al."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.spectra import BAND_HZ, finite


def dissimilarity(a: ArrayLike, b: ArrayLike, *, frequencies_hz: ArrayLike) -> NDArray[np.float64]:
    """Return the sum over `BAND_HZ` of the differences of two spectra: d = sum_{f} | |S_a(f)| - |S_b(f)| |, m/s^2.

    The spectra, m/s^2, shape (..., N), are broadcast; the result has shape (...). `frequencies_hz` has shape (N,).
    Raises `SynthesisError` for spectra that are not finite or of another length. Source: Okamoto et al., equation (6).
    """
    first, second = finite(a, what="first spectrum"), finite(b, what="second spectrum")
    f = finite(frequencies_hz, what="frequencies_hz")
    if not first.shape[-1] == second.shape[-1] == f.size:
        raise SynthesisError(
            f"spectra: got {first.shape[-1]} and {second.shape[-1]} bins for {f.size} frequencies; "
            "allowed: equal numbers; compare spectra with the same length and rate"
        )
    within = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    differences: NDArray[np.float64] = np.abs(np.abs(first[..., within]) - np.abs(second[..., within]))
    return np.asarray(differences.sum(axis=-1))


def dissimilarity_matrix(spectra: ArrayLike, *, frequencies_hz: ArrayLike) -> NDArray[np.float64]:
    """Return the dissimilarity of each pair of spectra, divided by the highest, as in Table 3 (section 6.1).

    The spectra are rows, m/s^2, shape (M, N); the matrix is (M, M), all zero if no pair differs. Raises as
    `dissimilarity`.
    """
    rows = finite(spectra, what="spectra")
    matrix = dissimilarity(rows[:, None, :], rows[None, :, :], frequencies_hz=frequencies_hz)
    highest = matrix.max()
    return matrix / highest if highest > 0 else matrix
