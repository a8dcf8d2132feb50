"""Samples in time: whether they lie on an even grid, how they are brought onto one, and whether they were clipped."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.text.shape import Lines
from palpate.experiment.settings.delimited import Stated

Floats = NDArray[np.float64]

LARGEST_STEP_ERROR = 0.5
"""How far a time step may be from the median step, and a sample from its place on an even grid, in steps."""

SEEN = 1e-3
"""Samples that are no further off the grid, in steps, are not resampled: times are written with so many digits."""

LONGEST_GAP = 8
"""More missing samples in a row are no longer bridged by a curve. Ours: 8 ms at 1 kHz."""

FEWEST_TURNS = 10
"""So often the rarer of two steps has to come for times to count as rounded."""

CLIPPED_RUN = 3
"""So many samples in a row at an end of the range look clipped."""

CROWDED = 10
"""So many times more samples at an end than at the value next to it look clipped. Ours."""

MARKED, OVERLOAD, FAR = 99.0, 1e30, 10.0
"""Marks of missing samples are as large as this, a single one as large as that, and so far from the others. Ours."""

PERIODS_S = 2.0**32 * 1e-6, 2.0**32 * 1e-3
"""After so long a counter of 32 bits begins anew, of microseconds and of milliseconds."""

RESTS = 0.5
"""A signal that stands at an end for this share of its samples or more rests there."""


@dataclass(frozen=True)
class Mark:
    """A value that stands for missing samples, and how many."""

    value: float
    samples: int


@dataclass(frozen=True)
class Grid:
    """An even grid: its rate, Hz, and the largest departure of a sample from it, in steps.

    `resolution_s` is that of times that were rounded or cut to less than a step's accuracy; 0 for others.
    """

    rate_hz: float
    jitter: float
    resolution_s: float = 0.0


def even(times_s: Floats, lines: Lines, stated: Stated) -> Grid:
    """Return the grid on which samples lie at `times_s`, shape (n,), of these lines of their file.

    Raises `RecordingError` below two samples, and where a step is not even or a sample is off the grid.
    """
    grid = _departure(times_s) if _has_even_steps(times_s) else None
    if grid is not None and grid.jitter <= LARGEST_STEP_ERROR:
        return grid
    if (rounded := _rounded(times_s)) is not None:
        return rounded
    if grid is None:
        steps, median = _steps(times_s)
        worst = int(np.argmax(np.abs(steps - median)))
        raise RecordingError(
            f"got a time step of {steps[worst]:g} s{_overflow(float(steps[worst]))}",
            remedy=_evenly(times_s, stated, "record without gaps, or truncate the file there"),
            allowed=f"within {LARGEST_STEP_ERROR:.0%} of the median step, {median:g} s",
            line=lines[worst + 1],
        )
    at = int(np.argmax(np.abs(times_s - np.arange(times_s.size) / grid.rate_hz)))
    raise RecordingError(
        f"got a sample {grid.jitter:.2f} steps off an even grid",
        remedy=_evenly(times_s, stated, "record at a constant rate"),
        allowed=f"{LARGEST_STEP_ERROR} steps",
        line=lines[at],
    )


def _overflow(step_s: float) -> str:
    """Return what a step back is like, where it is about that of a counter which began anew."""
    return ", as if a 32-bit counter overflowed" if any(abs(step_s / one + 1) < 0.01 for one in PERIODS_S) else ""


def unwrapped(times_s: Floats) -> tuple[Floats, bool]:
    """Return times, shape (n,), of a counter of 32 bits that ran over, and whether it did; others as they are.

    It counts microseconds or milliseconds, and each step back is one of all its values, give or take
    `LARGEST_STEP_ERROR`.
    """
    if (times_s[1:] >= times_s[:-1]).all():
        return times_s, False
    steps, median = _steps(times_s)
    for period_s in PERIODS_S:
        with np.errstate(over="ignore", invalid="ignore"):
            over = np.abs(steps + period_s - median) <= LARGEST_STEP_ERROR * median
        if over.any():
            return times_s + period_s * np.concatenate(([0], np.cumsum(over))), True
    return times_s, False


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
    """Return samples at their mean rate, gaps apart, by a cubic spline through those at `times_s`, both of shape (n,).

    None where they lie on an even grid already. Raises `RecordingError` for times that do not rise, and for a gap of
    more than `LONGEST_GAP` missing samples.
    """
    steps, median = _steps(times_s)
    if _departure(times_s).jitter <= SEEN or _rounded(times_s) is not None:
        return None
    if not (steps > 0).all():
        at = int(np.argmin(steps > 0))
        raise RecordingError(
            f"got a time step of {steps[at]:g} s",
            remedy="truncate the file there",
            allowed="increasing times",
            line=lines[at + 1],
        )
    missing = _missing(steps / median)
    if missing.max() > LONGEST_GAP:
        at = int(missing.argmax())
        raise RecordingError(
            f"got a gap of {steps[at]:g} s with {missing[at]} missing samples",
            remedy="truncate the file there",
            allowed=f"at most {LONGEST_GAP} missing samples, which can be interpolated",
            line=lines[at + 1],
        )
    step = float(times_s[-1]) / (steps.size + int(missing.sum()))
    places = np.arange(steps.size + int(missing.sum()) + 1) * step
    between, rest = slice(1, -1, 2), slice(None, None, 2)
    off = samples[between] - CubicSpline(times_s[rest], samples[rest])(times_s[between])
    spread = float(samples.std())
    error = float(np.sqrt(np.mean(off**2))) / spread if spread > 0 else 0.0
    return Resampled(
        CubicSpline(times_s, samples)(places), Grid(1 / step, 0.0), error, int(missing.sum()), int(missing.max())
    )


@dataclass(frozen=True)
class Clipping:
    """How many samples stand at the ends of the range, in how many runs, and these ends."""

    samples: int
    runs: int
    ends: tuple[float, ...]


def clipping(samples: NDArray[np.generic]) -> Clipping | None:
    """Return how samples, shape (n,), look clipped; None for others.

    They do where they stand at the largest or the smallest value for `CLIPPED_RUN` samples in a row, twice or more, and
    in `CROWDED` times as many samples as at the value next to it: at the top of an oscillation in whole counts it is
    some 2.4 times, by the arcsine law. A signal that stands at zero, or for `RESTS` of all samples, rests there.
    """
    values = samples.astype(np.float64)
    if np.ptp(values) == 0:
        return None
    ends: list[float] = []
    lengths: list[int] = []
    for end in (float(values.max()), float(values.min())):
        at_end = values == end
        if np.count_nonzero(at_end) < CLIPPED_RUN:
            continue
        turns = np.diff(np.concatenate(([0], at_end.astype(np.int8), [0])))
        runs = np.flatnonzero(turns == -1) - np.flatnonzero(turns == 1)
        runs = runs[runs >= CLIPPED_RUN]
        others = values[~at_end]
        beside = np.count_nonzero(others == (others.max() if end > others[0] else others.min()))
        if end and CROWDED * beside < runs.sum() < RESTS * values.size:
            ends.append(end)
            lengths += runs.tolist()
    return Clipping(sum(lengths), len(lengths), tuple(ends)) if len(lengths) > 1 else None


def mark(samples: NDArray[np.generic]) -> Mark | None:
    """Return a value that stands for missing or overloaded samples, as loggers write -999 and scopes 9.9e37.

    It is a whole number, `MARKED` or more without its sign, further from all other samples than `FAR` times the range
    of these, and stands there twice at least, or is beyond `OVERLOAD`.
    """
    values = samples.astype(np.float64)
    for value in (float(values.max()), float(values.min())):
        others = values[values != value]
        often = values.size - others.size
        if abs(value) < MARKED or not value.is_integer() or others.size < 2:
            continue
        gap = float(np.abs(others - value).min())
        if gap > FAR * float(np.ptp(others)) > 0 and (often > 1 or abs(value) > OVERLOAD):
            return Mark(value, often)
    return None


def _rounded(times_s: Floats) -> Grid | None:
    """Return the grid of even times that were written in too few digits; None for others.

    Their steps are whole multiples of the finest, of two kinds that differ by one, and between two of the rarer kind
    there are as many of the other as always, or one more: so do the digits of any straight line fall. Only times with
    `FEWEST_TURNS` of the rarer kind are looked at, for a missing sample here and there makes such steps, too.
    """
    steps = np.diff(times_s)
    if not (steps >= 0).all() or not (some := steps[steps > 0]).size:
        return None
    finest = float(some.min())
    # The finest step may be two digits long, and another three.
    finest = finest if steps.min() == 0 else float(np.min(some[some > 1.05 * finest] - finest, initial=finest))
    counts = np.rint(steps / finest)
    low = float(counts.min())
    if np.abs(steps / finest - counts).max() > 0.05 or counts.max() != low + 1:
        return None
    rarer = low if 2 * np.count_nonzero(counts == low) < counts.size else low + 1
    apart = np.diff(np.flatnonzero(counts == rarer))
    if apart.size < FEWEST_TURNS or np.ptp(apart) > 1:
        return None
    mean = float(times_s[-1] / steps.size)
    return Grid(1 / mean, float(np.abs(times_s - mean * np.arange(times_s.size)).max()) / mean, finest)


def _evenly(times_s: Floats, stated: Stated, otherwise: str) -> Remedy | str:
    """Return what to do about uneven times: resample them, where that is possible."""
    steps, median = _steps(times_s)
    if (steps >= 0).all() and not (steps > 0).all():
        words = "export times with more digits, or give the sampling rate"
        return stated.remedy(words, "--rate", f"{_roundest_rate(steps):.12g}" if times_s[-1] > 0 else "HZ")
    if (steps > 0).all() and _missing(steps / median).max() <= LONGEST_GAP:
        return stated.remedy(f"{otherwise}, or resample it", "--resample")
    return otherwise


def _roundest_rate(steps_s: Floats) -> float:
    """Return the sampling rate of the fewest digits, Hz, at which rounded times have these steps."""
    span, finest = float(steps_s.sum()), float(steps_s[steps_s > 0].min())
    rates = (float(f"{steps_s.size / span:.{digits}g}") for digits in range(1, 17))
    return next((one for one in rates if abs(steps_s.size / one - span) <= finest), steps_s.size / span)


def _missing(steps: Floats) -> NDArray[np.int64]:
    """Return how many samples each step leaves out, from steps in units of the median: two samples that were both late
    or early by up to 0.45 of it are neighbors still."""
    return np.maximum(np.floor(steps + 0.1).astype(np.int64) - 1, 0)


def _has_even_steps(times_s: Floats) -> bool:
    """Return whether each step is near the median, which is not looked for where all are near the least."""
    steps = _differences(times_s)
    least, most = float(steps.min()), float(steps.max())
    if least > 0 and most - least <= LARGEST_STEP_ERROR * least:
        return True
    median = float(np.median(steps))
    return 0 < median < np.inf and max(most - median, median - least) <= LARGEST_STEP_ERROR * median


def _steps(times_s: Floats) -> tuple[Floats, float]:
    """Return the steps of times, shape (n - 1,), and their median."""
    steps = _differences(times_s)
    return steps, float(np.median(steps))


def _differences(times_s: Floats) -> Floats:
    if times_s.size < 2:
        raise RecordingError(
            f"got {times_s.size} rows", remedy="record longer", allowed="two or more, to derive a sampling rate"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        return np.diff(times_s)


def _departure(times_s: Floats) -> Grid:
    mean = float(times_s[-1] / max(times_s.size - 1, 1))
    if not (mean > 0 and np.isfinite(1 / mean)):
        raise RecordingError(f"got time steps of {mean:g} s", remedy="correct the time unit", allowed="longer ones")
    off = mean * np.arange(times_s.size)
    off -= times_s
    return Grid(1 / mean, max(float(off.max()), -float(off.min())) / mean)
