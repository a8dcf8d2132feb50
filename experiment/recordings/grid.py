"""Samples in time: whether they lie on an even grid, how they are brought onto one, and whether they were clipped."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.text.columns import RowLines
from palpate.experiment.settings.delimited import Stated

Floats = NDArray[np.float64]

Lines = Sequence[int] | RowLines
"""The line of each sample in its file, from 1."""

LARGEST_STEP_ERROR = 0.5
"""How far a time step may be from the median step, and a sample from its place on an even grid, in steps."""

SEEN = 1e-3
"""Samples that are no further off the grid, in steps, are not resampled: times are written with so many digits."""

LONGEST_GAP = 8
"""More missing samples in a row are no longer bridged by a curve. Ours: 8 ms at 1 kHz."""

CLIPPED_RUN = 3
"""So many samples in a row at an end of the range look clipped."""

RESTS = 0.5
"""A signal that stands at an end for this share of its samples or more rests there."""


@dataclass(frozen=True)
class Grid:
    """An even grid: its rate, Hz, and the largest departure of a sample from it, in steps."""

    rate_hz: float
    jitter: float


def even(times_s: Floats, lines: Lines, stated: Stated) -> Grid:
    """Return the grid on which samples lie at `times_s`, shape (n,), of these lines of their file.

    Raises `RecordingError` below two samples, and where a step is not even or a sample is off the grid.
    """
    median = _median_step(times_s)
    steps = np.diff(times_s)
    worst = int(np.argmax(np.abs(steps - median)))
    if not (0 < median < np.inf and abs(steps[worst] - median) <= LARGEST_STEP_ERROR * median):
        raise RecordingError(
            f"got a time step of {steps[worst]:g} s",
            remedy=_evenly(times_s, stated, "record without gaps, or cut the file there"),
            allowed=f"within {LARGEST_STEP_ERROR:.0%} of the median step, {median:g} s",
            line=lines[worst + 1],
        )
    grid = _departure(times_s)
    if not grid.jitter <= LARGEST_STEP_ERROR:
        at = int(np.argmax(np.abs(times_s - np.arange(times_s.size) / grid.rate_hz)))
        raise RecordingError(
            f"got a sample {grid.jitter:.2f} steps away from an even grid",
            remedy=_evenly(times_s, stated, "record at a steady rate"),
            allowed=f"{LARGEST_STEP_ERROR} steps",
            line=lines[at],
        )
    return grid


@dataclass(frozen=True)
class Resampled:
    """Samples, shape (m,), on an even grid, and what that cost.

    `error` is how far a spline through every second sample misses the others, rms, as a part of the rms of all about
    their mean. Samples lie twice as far apart for it, so that the error of the result is smaller as a rule; `error` is
    no bound. `bridged` samples were missing, `longest` in a row.
    """

    samples: Floats
    grid: Grid
    error: float
    bridged: int
    longest: int


def resampled(times_s: Floats, samples: Floats, lines: Lines) -> Resampled | None:
    """Return samples at the median rate, by a cubic spline through those at `times_s`, both of shape (n,).

    None where they lie on an even grid already. Raises `RecordingError` for times that do not rise, and for a gap of
    more than `LONGEST_GAP` missing samples.
    """
    median, steps = _median_step(times_s), np.diff(times_s)
    if _departure(times_s).jitter <= SEEN:
        return None
    if not (steps > 0).all():
        at = int(np.argmin(steps > 0))
        raise RecordingError(
            f"got a time step of {steps[at]:g} s", "correct the times", allowed="times that rise", line=lines[at + 1]
        )
    missing = _missing(steps / median)
    if missing.max() > LONGEST_GAP:
        at = int(missing.argmax())
        raise RecordingError(
            f"got a gap of {steps[at]:g} s, in which {missing[at]} samples are missing",
            remedy="cut the file there",
            allowed=f"at most {LONGEST_GAP}, for a curve to bridge them",
            line=lines[at + 1],
        )
    places = np.arange(int(times_s[-1] / median + 1e-9) + 1) * median
    between, rest = slice(1, -1, 2), slice(None, None, 2)
    off = samples[between] - CubicSpline(times_s[rest], samples[rest])(times_s[between])
    spread = float(samples.std())
    error = float(np.sqrt(np.mean(off**2))) / spread if spread > 0 else 0.0
    return Resampled(
        CubicSpline(times_s, samples)(places), Grid(1 / median, 0.0), error, int(missing.sum()), int(missing.max())
    )


@dataclass(frozen=True)
class Clipping:
    """How many samples stand at the ends of the range, in how many runs, and these ends."""

    samples: int
    runs: int
    ends: tuple[float, ...]


def clipping(samples: NDArray[np.generic]) -> Clipping | None:
    """Return how samples, shape (n,), look clipped; None for others.

    They do where they stand at the largest or the smallest value for `CLIPPED_RUN` samples in a row, twice or more,
    though never for `RESTS` of all samples, after a step of more than three times the finest difference of neighbors:
    the top of a slow oscillation in whole counts is flat, too, but no such step leads to it.
    """
    values = samples.astype(np.float64)
    steps = np.abs(np.diff(values))
    if not steps.any():
        return None
    into, ends, lengths = np.concatenate(([0.0], steps, [0.0])), [], []
    least = 3 * float(steps[steps > 0].min())
    for end in (float(values.max()), float(values.min())):
        turns = np.diff(np.concatenate(([0], (values == end).astype(np.int8), [0])))
        begins, stops = np.flatnonzero(turns == 1), np.flatnonzero(turns == -1)
        clipped = (stops - begins >= CLIPPED_RUN) & (np.maximum(into[begins], into[stops]) > least)
        if clipped.any() and (stops - begins)[clipped].sum() < RESTS * values.size:
            ends.append(end)
            lengths += (stops - begins)[clipped].tolist()
    return Clipping(sum(lengths), len(lengths), tuple(ends)) if len(lengths) > 1 else None


def _evenly(times_s: Floats, stated: Stated, otherwise: str) -> Remedy | str:
    """Return what to do about uneven times: resample them, where that is possible."""
    steps, median = np.diff(times_s), _median_step(times_s)
    if (steps > 0).all() and _missing(steps / median).max() <= LONGEST_GAP:
        return stated.remedy(f"{otherwise}, or have it resampled", "--resample")
    return otherwise


def _missing(steps: Floats) -> NDArray[np.int64]:
    """Return how many samples each step leaves out, from steps in units of the median: two samples that were both late
    or early by up to 0.45 of it are neighbors still."""
    return np.maximum(np.floor(steps + 0.1).astype(np.int64) - 1, 0)


def _median_step(times_s: Floats) -> float:
    if times_s.size < 2:
        raise RecordingError(
            f"got {times_s.size} rows", remedy="record longer", allowed="two or more, for a sampling rate"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.median(np.diff(times_s)))


def _departure(times_s: Floats) -> Grid:
    mean = float(times_s[-1] / max(times_s.size - 1, 1))
    if not (mean > 0 and np.isfinite(1 / mean)):
        raise RecordingError(f"got time steps of {mean:g} s", remedy="correct the unit of time", allowed="longer ones")
    return Grid(1 / mean, float(np.abs(times_s - mean * np.arange(times_s.size)).max()) / mean)
