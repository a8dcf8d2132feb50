"""Takes out of the microphone what we play ourselves: the masker, which is known sample by sample."""

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

from palpate.experiment.errors import VoiceError

TAPS = 1920
"""Of the filter: 120 ms in the band, of which a room and the latency of the device take their parts."""

SHORTEST = 3 * TAPS
"""Fewer samples than these determine no filter: 0.36 s."""

_RIDGE = 1e-6
"""Of the played power, added to the diagonal: where x has no power, as at the band's end, h stays 0."""

_TURNS, _SOLVED = 20, 1e-4
"""Most turns, and the residual of the normal equations at which to stop: it adds about -80 dB of the masker."""


def leak(
    microphone: NDArray[np.float64], played: NDArray[np.float64], counted: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the filter from played samples to the microphone, shape (TAPS,), 0 where nothing was played.

    Both are in the band, at the same moments, shape (n,), with n of `SHORTEST` or more. Samples that are not `counted`,
    shape (n,), are speech, which would add as much error as noise. Raises `VoiceError` for other shapes.
    """
    if microphone.shape != played.shape or microphone.ndim != 1 or microphone.size < SHORTEST:
        raise VoiceError(
            "microphone",
            f"got shape {microphone.shape} beside {played.shape} of the masker",
            "listen for longer before the answer",
            allowed=f"two rows of {SHORTEST} samples or more, {SHORTEST / 16000:g} s",
        )
    weights = np.ones(microphone.size - TAPS + 1) if counted is None else counted[TAPS - 1 :].astype(np.float64)
    y, whole = weights * microphone[TAPS - 1 :], fft.next_fast_len(microphone.size, real=True)
    x = fft.rfft(played, whole)

    def correlated(row: NDArray[np.float64]) -> NDArray[np.float64]:
        correlation: NDArray[np.float64] = fft.irfft(np.conj(fft.rfft(row, whole)) * x, whole)
        return correlation[TAPS - 1 :: -1]

    def filtered(h: NDArray[np.float64]) -> NDArray[np.float64]:
        wave: NDArray[np.float64] = fft.irfft(fft.rfft(h, whole) * x, whole)
        return weights * wave[TAPS - 1 : microphone.size]

    power = fft.irfft(np.abs(x) ** 2, whole)[:TAPS].copy()
    h = np.zeros(TAPS)
    if power[0] == 0:
        return h
    ridge = _RIDGE * power[0]
    power[0] += ridge
    residual = correlated(y)
    enough = _SOLVED * float(np.linalg.norm(residual))
    direction, before = h, 1.0
    for _ in range(_TURNS):
        if np.linalg.norm(residual) <= enough:
            break
        conditioned = linalg.solve_toeplitz(power, residual, check_finite=False)
        now = float(residual @ conditioned)
        direction = conditioned + now / before * direction
        mapped = correlated(filtered(direction)) + ridge * direction
        step = now / float(direction @ mapped)
        h = h + step * direction
        residual = residual - step * mapped
        before = now
    return h


def cancelled(
    microphone: NDArray[np.float64], played: NDArray[np.float64], taps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the microphone less `taps` of the played samples, shape (n,); the first `taps.size` lack the past."""
    if not np.any(taps):
        return microphone
    n = fft.next_fast_len(microphone.size + taps.size, real=True)
    leaked: NDArray[np.float64] = fft.irfft(fft.rfft(played, n) * fft.rfft(taps, n), n)[: microphone.size]
    return microphone - leaked
