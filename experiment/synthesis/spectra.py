"""Spectra of accelerations and the way back, equations (1), (5) and (6) of Okamoto et al.

Erratum: the paper puts bin k at F k / N. The basis cos(pi k (i + 1/2) / N) of (1) oscillates at F k / (2 N),
which at F = 5000 Hz and N = 2500 is one bin a hertz. That is used here.
"""

from dataclasses import dataclass
from math import ceil, cos, gcd, inf, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from palpate.experiment.errors import SynthesisError

BAND_HZ = (0.0, 500.0)
"""Where equation (6) sums: above 500 Hz accelerations of crinkles are below the threshold of touch (section 2)."""

POINTS_A_BIN = 10
"""Times for each bin at which `highest` looks at a sum, at the least."""

EVEN = 64
"""It looks at a multiple of this many: transforms by powers of two are the fastest."""

LONGEST_TRANSFORM = 2**26
"""Longest inverse DCT (512 MiB); only incommensurate rates of very long recordings need more."""

QUIET, LIFT = 2.0**-900, 2.0**900
"""Below the one, spectra are transformed after multiplication by the other, lest intermediate results be denormal."""


def finite(values: ArrayLike, *, what: str) -> NDArray[np.float64]:
    """Return `values`, shape (..., N), as float64. Raises `SynthesisError` if there are none, or one is not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.size == 0:
        raise SynthesisError(f"{what}: got shape {array.shape}; allowed: at least one sample; check the recording")
    bad = int(array.size - np.count_nonzero(np.isfinite(array)))
    if bad:
        raise SynthesisError(f"{what}: got {bad} NaN or infinite values; allowed: finite numbers; record again")
    return array


def spectrum(samples: ArrayLike) -> NDArray[np.float64]:
    """Return the amplitude of each frequency element: C_k = (2/N) sum_i y_i cos(pi k (i + 1/2) / N).

    Both y_i and C_k, with its sign, are in m/s^2, shape (..., N); bin k is at `bin_frequencies_hz`. Raises
    `SynthesisError` for no sample, NaN or infinity. Source: Okamoto et al., equation (1).
    """
    y = finite(samples, what="samples")
    coefficients: NDArray[np.float64] = fft.dct(y, type=2, axis=-1) / y.shape[-1]
    return coefficients


def bin_frequencies_hz(*, bins: int, rate_hz: float) -> NDArray[np.float64]:
    """Return the frequencies of N bins, F k / (2 N), Hz, shape (N,). Raises `SynthesisError` for a bad rate F, Hz."""
    if not 0 < rate_hz < inf:
        raise SynthesisError(f"rate_hz: got {rate_hz}; allowed: a finite rate above 0 Hz; correct the manifest")
    return np.arange(bins, dtype=np.float64) * np.float64(rate_hz / (2 * bins))


def inverse(coefficients: ArrayLike) -> NDArray[np.float64]:
    """Return accelerations at the recording's own rate: y_i = sum_{k=1}^{N-1} C_k cos(pi k (i + 1/2) / N).

    Without k = 0, `inverse(spectrum(y))` is y less its mean. C_k and y_i are in m/s^2, shape (..., N). Raises
    `SynthesisError` for no coefficient, NaN or infinity. Source: Okamoto et al., equation (5).
    """
    halved = finite(coefficients, what="coefficients") / 2
    halved[..., 0] = 0.0
    samples: NDArray[np.float64] = fft.dct(halved, type=3, axis=-1)
    return samples


@dataclass(frozen=True)
class Grid:
    """The times (i' + 1/2) / F' at which a recording's spectrum is summed, in whole numbers.

    With N F' / F = p / q in lowest terms, the phase of bin k at sample i' is pi k q (i' + 1/2) / p: bin k is at place k
    q of an inverse DCT of length p. `count` samples lie within the recording; `carried` bins lie below F' / 2.
    """

    p: int
    q: int
    count: int
    carried: int


def grid(*, samples: int, bins: int, rate_hz: int, output_rate_hz: int) -> Grid:
    """Return the grid of an output rate, Hz, for recordings of N samples, Hz. Raises `SynthesisError` for low rates."""
    for name, rate in (("rate_hz", rate_hz), ("output_rate_hz", output_rate_hz)):
        if not 1 <= rate < inf:
            raise SynthesisError(f"{name}: got {rate}; allowed: 1 Hz or more; correct the rig file or the manifest")
    divisor = gcd(samples * output_rate_hz, rate_hz)
    p, q = samples * output_rate_hz // divisor, rate_hz // divisor
    count = ceil(p / q - 0.5)
    if count < 1:
        raise SynthesisError(
            f"output_rate_hz: got {output_rate_hz} for {samples} samples at {rate_hz} Hz; "
            "allowed: a rate at which the waveform has at least one sample; raise the rate"
        )
    return Grid(p=p, q=q, count=count, carried=min(bins, ceil(p / q)))


def rms(amplitudes: NDArray[np.float64], on: Grid) -> NDArray[np.float64]:
    """Return sqrt(sum_k C_k^2 / 2) over the bins 1 to carried - 1: by Parseval the rms of the waveform where q is 1.

    Amplitudes, shape (..., N), may have any scale, 1e300 and denormals too; `SynthesisError` unless they are finite.
    """
    sounding = finite(amplitudes, what="amplitudes")[..., 1 : on.carried]
    largest = np.max(np.abs(sounding), axis=-1, initial=0.0)
    unit = np.where(largest > 0, largest, 1.0)
    relative: NDArray[np.float64] = np.sqrt(np.sum((sounding / unit[..., None]) ** 2, axis=-1) / 2)
    return np.asarray(relative * largest)


@dataclass(frozen=True)
class Bins:
    """A waveform's coefficients by (5): C_k with sign, m/s^2, shape (K,), K <= N, of N `samples` at `rate_hz`."""

    coefficients: NDArray[np.float64]
    samples: int
    rate_hz: int


def transformable(on: Grid) -> None:
    """Refuse a grid that needs a transform longer than `LONGEST_TRANSFORM`. Raises `SynthesisError`."""
    if on.p > LONGEST_TRANSFORM:
        raise SynthesisError(
            f"output_rate_hz: got a rate whose ratio to the recording's rate needs a transform of {on.p} points; "
            f"allowed: at most {LONGEST_TRANSFORM}; use a rounder rate"
        )


def inverse_on(coefficients: ArrayLike, on: Grid) -> NDArray[np.float64]:
    """Return the sum of equation (5) on a grid, by an inverse DCT of length p, zero where no bin stands.

    C_k has its sign, m/s^2, shape (..., K), for the grid's K bins; the sum is in m/s^2, shape (..., count). Raises
    `SynthesisError` above `LONGEST_TRANSFORM`, unless coefficients are finite, or for overflow. Source: Okamoto et al.,
    equation (5).
    """
    c = finite(coefficients, what="coefficients")
    transformable(on)
    sounding = c[..., 1 : on.carried]
    lift = LIFT if np.max(np.abs(sounding), initial=0.0) < QUIET else 1.0
    padded = np.zeros((*c.shape[:-1], on.p))
    padded[..., on.q : on.carried * on.q : on.q] = sounding * (lift / 2)
    samples: NDArray[np.float64] = fft.dct(padded, type=3, axis=-1, overwrite_x=True)[..., : on.count]
    if not np.isfinite(samples).all():
        raise SynthesisError(
            f"coefficients: got magnitudes up to {np.abs(c).max():g}, and their sum overflows; "
            "allowed: a finite waveform; check the recording's unit"
        )
    if lift != 1.0:
        samples /= lift
    return samples


def highest(coefficients: ArrayLike) -> float:
    """Return a bound on the magnitude of the sum of equation (5) at any time, to round-off, m/s^2; C_k as in
    `inverse_on`.

    It is the largest magnitude at P times, at least `POINTS_A_BIN` a bin, divided by cos(pi (K - 1) / (2 P)): the sum
    is a polynomial of degree K - 1 in cos(pi t F / N), sampled at the zeros of a Chebyshev polynomial. So it is at most
    1.3 % too high. Source: Ehlich and Zeller 1964, Math. Zeitschrift 86, 41-44.
    """
    c = finite(coefficients, what="coefficients")
    sounding = np.flatnonzero(c[1:])
    if not sounding.size:
        return 0.0
    c = c[: sounding[-1] + 2]
    points = EVEN * fft.next_fast_len(ceil(POINTS_A_BIN * c.size / EVEN), real=True)
    largest = float(np.abs(inverse_on(c, Grid(p=points, q=1, count=points, carried=c.size))).max())
    return largest / cos(pi * (c.size - 1) / (2 * points))
