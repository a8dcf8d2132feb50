"""How a task went: learning, foot speed, onset errors, timing of the rig, and masker levels.

Trials without an answer are not right. Timing counts every attempt.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from palpate.analysis.documents.tables import plural
from palpate.analysis.reading.study import Study
from palpate.analysis.statistics.exact import defined
from palpate.analysis.statistics.inference import ConfidenceInterval, wilson
from palpate.analysis.statistics.shares import Limits, share_limits

QUANTITIES = {
    "contact, predicted minus actual": "prediction_error_s",
    "onset, measured minus asked": "delivery_error_s",
    "gate to scheduled": "gate_to_scheduled_s",
    "dead time after an answer": "dead_time_s",
}
"""Each quantity and its column."""


@dataclass(frozen=True)
class Timing:
    """One quantity in a task's attempts, ms; percentiles and largest by magnitude, None where values are too few."""

    quantity: str
    attempts: int
    median_ms: float
    sd_ms: float | None
    p99_ms: float | None
    p999_ms: float | None
    largest_ms: float


def timing(study: Study) -> dict[str, tuple[Timing, ...]]:
    """Return the timing of each task; a task without any is left out."""
    used = study.of_analysed()
    found: dict[str, tuple[Timing, ...]] = {}
    for task in study.tasks:
        rows = used[used["task"] == task.id]
        known = {name: 1e3 * rows[column].dropna().to_numpy(np.float64) for name, column in QUANTITIES.items()}
        if spreads := tuple(_spread(name, values_ms) for name, values_ms in known.items() if values_ms.size):
            found[task.id] = spreads
    return found


def _spread(quantity: str, values_ms: NDArray[np.float64]) -> Timing:
    sizes_ms = np.abs(values_ms)
    p99, p999 = (
        float(np.quantile(sizes_ms, share)) if sizes_ms.size >= round(1 / (1 - share)) else None
        for share in (0.99, 0.999)
    )
    return Timing(
        quantity, values_ms.size, float(np.median(values_ms)), _sd(values_ms), p99, p999, float(sizes_ms.max())
    )


def _sd(values: NDArray[np.float64]) -> float | None:
    return float(values.std(ddof=1)) if values.size > 1 else None


WINDOW = 10
"""Trials of the running mean."""

MOST_BINS = 8
BIN_WIDTHS_MM_S = (25, 50, 100, 200, 500, 1000)
"""The bins of the foot's speed are the narrowest of which no more than `MOST_BINS` are needed, or the widest."""

LEARNING, SPEED, ONSET, MASKER, TIMING = "learning curve", "speed curve", "onset errors", "masker levels", "timing"
COLUMNS = {
    SPEED: ("foot_speed_mm_s", "the foot speed is not known"),
    ONSET: ("onset_error_s", "the stimulus onset was not measured"),
    MASKER: ("masker_db_a", "the masker level is not known"),
}
"""What each needs of a trial: its column, and words for having it."""


@dataclass(frozen=True)
class Window:
    """Right answers in a run of trials, over all participants; `interval` is None where `statement` says why."""

    first: int
    last: int
    right: int
    trials: int
    interval: Limits | None
    statement: str


@dataclass(frozen=True)
class SpeedBin:
    """Right answers to steps of from `low_mm_s` up to but not `high_mm_s`, with Wilson's interval."""

    low_mm_s: float
    high_mm_s: float
    mean_mm_s: float
    right: int
    trials: int
    interval: ConfidenceInterval


@dataclass(frozen=True)
class OnsetErrors:
    """Measured onset minus contact of every stimulus of a task, ms; `sd_ms` is None below two."""

    errors_ms: tuple[float, ...]
    mean_ms: float
    sd_ms: float | None
    largest_ms: float


@dataclass(frozen=True)
class MaskerLevels:
    """Median, lowest and highest level of one participant's trials, dB(A)."""

    participant: str
    median_db_a: float
    low_db_a: float
    high_db_a: float


@dataclass(frozen=True)
class TimeCourse:
    """The course of each task; `statements` say why a task lacks one of these.

    `ahead_ms` is how long before contact a stimulus was to begin, for each task of which the protocol says so.
    """

    learning: Mapping[str, tuple[Window, ...]]
    speed: Mapping[str, tuple[SpeedBin, ...]]
    onsets: Mapping[str, OnsetErrors]
    masker: Mapping[str, tuple[MaskerLevels, ...]]
    timing: Mapping[str, tuple[Timing, ...]]
    statements: Mapping[tuple[str, str], str]
    ahead_ms: Mapping[str, float] = field(default_factory=dict)


def course_of(study: Study) -> TimeCourse:
    """Return the course of the included trials of a study."""
    tasks = {task.id: trials for task in study.tasks if not (trials := study.trials(task.id)).empty}
    said: dict[tuple[str, str], str] = {}
    known: dict[str, dict[str, pd.DataFrame]] = {name: {} for name in COLUMNS}
    for task, trials in tasks.items():
        if not study.ordered:
            what = "a reconstruction has" if study.origin == "RECONSTRUCTION" else "counts have"
            said[task, LEARNING] = f"{what} no trial order"
        for name, (column, what) in COLUMNS.items():
            found = trials[np.isfinite(trials[column].to_numpy(dtype=np.float64))]
            if found.empty:
                said[task, name] = f"{what} for any of {plural(len(trials), 'trial')}"
            else:
                known[name][task] = found
    timed = timing(study)
    said |= {(task, TIMING): "no part of the timing was measured" for task in tasks if task not in timed}
    return TimeCourse(
        {task: _learning(trials) for task, trials in tasks.items() if (task, LEARNING) not in said},
        {task: _speed(trials) for task, trials in known[SPEED].items()},
        {task: _onsets(trials) for task, trials in known[ONSET].items()},
        {task: _masker(trials) for task, trials in known[MASKER].items()},
        timed,
        said,
        {task: ms for task, ms in _ahead_ms(study) if task in known[ONSET]},
    )


def _ahead_ms(study: Study) -> Iterator[tuple[str, float]]:
    """Yield each task whose stimulus begins before contact, and how long before."""
    protocols = [part.protocol for part in study.parts if part.protocol is not None]
    for task in (task for protocol in protocols for task in protocol.tasks):
        if task.ahead is not None:
            yield task.id, -task.ahead.delay_ms


def _learning(trials: pd.DataFrame) -> tuple[Window, ...]:
    """Return the share right in every run of `WINDOW` trial numbers, with its interval over participants."""
    right, done = _by_trial(trials)
    width = min(WINDOW, done.shape[1])
    runs = (np.lib.stride_tricks.sliding_window_view(part, width, axis=1) for part in (right, done))
    numerators, denominators = (run.sum(axis=2) for run in runs)
    windows = []
    for place, (hits, total) in enumerate(zip(numerators.T, denominators.T, strict=True)):
        if total.any():
            limits, why = defined(partial(share_limits, hits, total))
            windows.append(Window(place + 1, place + width, int(hits.sum()), int(total.sum()), limits, why))
    return tuple(windows)


def _by_trial(trials: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return right answers, and trials done, by participant and trial number, each of shape (P, last number)."""
    rows, labels = pd.factorize(trials["participant"])
    columns = trials["trial"].to_numpy(dtype=np.int64) - 1
    done = np.zeros((len(labels), int(columns.max()) + 1), dtype=np.int64)
    right = np.zeros_like(done)
    done[rows, columns] = 1
    right[rows, columns] = trials["presented"].to_numpy() == trials["answered"].to_numpy()
    return right, done


def _speed(known: pd.DataFrame) -> tuple[SpeedBin, ...]:
    speeds = known["foot_speed_mm_s"].to_numpy(dtype=np.float64)
    right = np.asarray(known["presented"].to_numpy() == known["answered"].to_numpy())
    for width in BIN_WIDTHS_MM_S:
        places = np.floor(speeds / width).astype(np.int64)
        if np.ptp(places) < MOST_BINS:
            break
    bins = []
    for place in np.unique(places).tolist():
        inside = places == place
        count, total = int(right[inside].sum()), int(inside.sum())
        mean = float(speeds[inside].mean())
        bins.append(SpeedBin(place * width, (place + 1) * width, mean, count, total, wilson(count, total)))
    return tuple(bins)


def _onsets(known: pd.DataFrame) -> OnsetErrors:
    errors_ms = 1e3 * known["onset_error_s"].to_numpy(dtype=np.float64)
    largest = float(np.abs(errors_ms).max())
    return OnsetErrors(tuple(errors_ms.tolist()), float(errors_ms.mean()), _sd(errors_ms), largest)


def _masker(known: pd.DataFrame) -> tuple[MaskerLevels, ...]:
    levels = known.groupby("participant", sort=False)["masker_db_a"].agg(["median", "min", "max"])
    return tuple(MaskerLevels(str(label), *map(float, of)) for label, *of in levels.itertuples(name=None))
