"""Finds where a voice begins, and where it ends, in what is left after cancelling.

The quiet is predicted linearly (J. Makhoul, Proceedings of the IEEE 63 (1975) 561-580): the error is white then, and a
voice stands out. Its energy in frames of 5 ms against the quiet's median finds speech roughly; the onset is the sample
that best parts two stretches of different variance, by Akaike's criterion (N. Maeda, Zisin 38 (1985) 365-379).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

_ORDER = 24
_FRAME, _HOP = 80, 16
"""Samples: 5 ms of energy, every millisecond."""

_LOUD, _HEARD = 10.0, 4.0
"""Energy over that of the quiet: what somebody speaking reaches, and what already belongs to it."""

_LOUD_MS, _WITHIN_MS = 50, 100
"""So long in so long it is loud; a click is shorter."""

_BEFORE_MS, _WITHIN_WORDS_MS = 30, 250
"""Silences that belong to an utterance: before its first loud sound, and within it, as before a plosive."""

_QUIETEST = 0.1
"""Least part of an answer's frames without speech; if louder, they replace the quiet: movement changes the leak."""

_PICKED_BEFORE, _PICKED_AFTER = 240, 160
"""Samples around the rough onset, 15 and 10 ms, of which the best one is picked."""

_CHANGED = 800
"""Samples, 50 ms, on either side of where an answer begins within another sound."""

_FAINTEST = 1e-12
"""Mean square of the faintest quiet, full scale being 1: what is exactly 0 has no energy to compare with."""


@dataclass(frozen=True, eq=False)
class Quiet:
    """What the microphone hears while nobody speaks: its whitening filter, shape (25,), and its energy after that."""

    whitening: NDArray[np.float64]
    energy: float


@dataclass(frozen=True)
class Utterance:
    """A stretch in which somebody speaks, in samples of the band.

    Attributes:
        begins: where sound begins after `_BEFORE_MS` of silence, in order; the first is the beginning of the stretch.
            A click and a word after it are one stretch with two beginnings.
        end: the sample after its last.
    """

    begins: tuple[int, ...]
    end: int


def quiet(samples: NDArray[np.float64]) -> Quiet:
    """Return what is typical of samples in the band, shape (n,): half of them may hold anything else."""
    n = fft.next_fast_len(samples.size + _ORDER + 1, real=True)
    r = fft.irfft(np.abs(fft.rfft(samples, n)) ** 2, n)[: _ORDER + 1]
    r[0] += 1e-9 * r[0] + _FAINTEST * max(samples.size, 1)
    whitening = np.concatenate([[1.0], -linalg.solve_toeplitz(r[:-1], r[1:], check_finite=False)])
    energies = _energies(_whitened(samples, whitening))
    return Quiet(whitening, max(float(np.median(energies)) if energies.size else 0.0, _FAINTEST))


def utterances(samples: NDArray[np.float64], *, after: int, quiet: Quiet) -> tuple[Utterance, ...]:
    """Return every utterance from sample `after` on, where frames begin, in the band, shape (n,), of full scale 1."""
    white = _whitened(samples, quiet.whitening)
    energies = _energies(white[after:])
    if not energies.size:
        return ()
    floor = max(quiet.energy, float(np.quantile(energies, _QUIETEST)))
    loud = np.concatenate([[0], np.cumsum(energies > _LOUD * floor)])
    ends = np.minimum(np.arange(energies.size) + _WITHIN_MS, energies.size)
    sustained = (np.diff(loud) > 0) & (loud[ends] - loud[:-1] >= _LOUD_MS)
    heard = np.flatnonzero(energies > _HEARD * floor)
    found, past = [], 0
    while (ahead := np.flatnonzero(sustained[past:])).size:
        first = past + int(ahead[0])
        end = _last_frame(heard, first)
        begins = [
            _picked(white, after + begin * _HOP + _FRAME // 2)
            for begin in (_first_frame(heard, first, past), *_further_begins(heard, first, end))
        ]
        found.append(Utterance(tuple(sorted(set(begins))), min(after + end * _HOP + _FRAME, white.size)))
        past = end + 1
    return tuple(found)


def _whitened(samples: NDArray[np.float64], whitening: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the error of the prediction, shape (n,)."""
    return np.convolve(samples, whitening)[: samples.size] if samples.size else samples


def risen(samples: NDArray[np.float64], *, near: int, quiet: Quiet) -> int:
    """Return the sample within 50 ms of another at which the sound changes most, in samples in the band, shape (n,)."""
    first = max(near - _CHANGED, 0)
    white = _whitened(samples[max(first - _ORDER, 0) : near + _CHANGED], quiet.whitening)[min(first, _ORDER) :]
    return first + _parted(white)


def _energies(white: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean square of every frame, shape (frames,)."""
    if white.size < _FRAME:
        return np.zeros(0)
    sums = np.concatenate([[0.0], np.cumsum(white**2)])
    energies: NDArray[np.float64] = (sums[_FRAME::_HOP] - sums[:-_FRAME:_HOP]) / _FRAME
    return energies


def _first_frame(heard: NDArray[np.intp], first: int, past: int) -> int:
    """Return the frame at which the sound begins that is loud from `first` on, not before `past`."""
    frames = heard[(heard >= past) & (heard <= first)]
    breaks = np.flatnonzero(np.diff(frames) > _BEFORE_MS)
    return int(frames[breaks[-1] + 1] if breaks.size else frames[0])


def _last_frame(heard: NDArray[np.intp], first: int) -> int:
    """Return the last frame of the utterance that is loud from `first` on."""
    frames = heard[heard >= first]
    breaks = np.flatnonzero(np.diff(frames) > _WITHIN_WORDS_MS)
    return int(frames[breaks[0]] if breaks.size else frames[-1])


def _further_begins(heard: NDArray[np.intp], first: int, end: int) -> list[int]:
    """Return the frames after `first` and up to `end` at which sound begins after a silence."""
    frames = heard[(heard >= first) & (heard <= end)]
    begins: list[int] = frames[1:][np.diff(frames) > _BEFORE_MS].tolist()
    return begins


def _picked(white: NDArray[np.float64], near: int) -> int:
    """Return the sample around a rough onset that is the onset."""
    begin = max(near - _PICKED_BEFORE, 0)
    return begin + _parted(white[begin : near + _PICKED_AFTER])


def _parted(white: NDArray[np.float64]) -> int:
    """Return the sample that parts what is before and what is after it best; 0 where there are too few."""
    energy = np.cumsum(white**2)
    n = energy.size
    k = np.arange(4, n - 4)
    if not k.size:
        return 0
    before, after = energy[k - 1] / k, (energy[-1] - energy[k - 1]) / (n - k)
    criterion = k * np.log(before + _FAINTEST) + (n - k) * np.log(after + _FAINTEST)
    return int(k[np.argmin(criterion)])
