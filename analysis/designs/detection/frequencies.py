"""Thresholds by frequency, where signals are sinusoids: their means over participants, a table and a figure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator

from palpate.analysis.designs.detection.results import Detections, TaskDetections, Track
from palpate.analysis.documents import drawing
from palpate.analysis.documents.tables import Column, Record, Section, tabulate
from palpate.analysis.statistics.participants import Mean, mean


def _end(sign: str, m_s2: float, beyond: int) -> str:
    """Return an end of the thresholds, with a sign where somebody's lies beyond the levels."""
    return f"{f'{sign} ' if beyond else ''}{m_s2:.4f}"


COLUMNS = (
    Column("task", left=True), Column("frequency_hz", "Hz", show="{:g}".format), Column("n", "participants"),
    Column(("below", "above"), "below, above the levels", show="{}, {}".format),
    Column("m_s2", "m/s² rms", 4), Column(("low", "high"), "95 % CI", 4), Column("sd_db", "SD dB", 2),
    Column(("lowest_m_s2", "below"), "lowest", show=partial(_end, "<")),
    Column(("highest_m_s2", "above"), "highest", show=partial(_end, ">")),
    Column(("floor_m_s2", "below"), "lowest limit", show=partial(_end, "<")),
)  # fmt: skip

NOTE = (
    "Geometric means of the participants' thresholds: rms of the sinusoid between its ramps, from the posterior of "
    "the levels or, without one, from the fit. Interval and SD are across participants, with one mean per "
    "participant of the signals at that frequency. Participants whose threshold is below or above all levels are "
    "counted separately and excluded from the means; a < or > sign marks a value beyond the level shown. The lowest "
    "limit is the lowest of the participants' lower 95 % limits. `palpate export` writes these limits to "
    "thresholds.csv (floor_rms_m_s2), and a footstep protocol can name that file as its floor."
)


@dataclass(frozen=True)
class AtFrequency:
    """Thresholds of one sinusoid, dB re 1 m/s^2 rms: of each participant, shape (n,), and their mean.

    Participants `below` and `above` have a track that stayed at that end of its levels.
    """

    frequency_hz: float
    participants: tuple[str, ...]
    each_db: tuple[float, ...]
    mean_db: Mean
    floor_m_s2: float
    below: tuple[str, ...] = ()
    above: tuple[str, ...] = ()


def by_frequency(task: TaskDetections) -> tuple[AtFrequency, ...]:
    """Return the thresholds of a task's sinusoids, by rising frequency; nothing with fewer than two frequencies."""
    of: dict[float, list[Track]] = {}
    for track in task.tracks:
        if track.frequency_hz is not None:
            of.setdefault(track.frequency_hz, []).append(track)
    of = {hz: tracks for hz, tracks in of.items() if any(one.known_db is not None for one in tracks)}
    return tuple(_at(frequency_hz, of[frequency_hz]) for frequency_hz in sorted(of)) if len(of) > 1 else ()


def _at(frequency_hz: float, tracks: Sequence[Track]) -> AtFrequency:
    known = [(one, db) for one in tracks if (db := one.known_db) is not None]
    peaks = np.array([one.rms_m_s2(0.0) for one, _ in known], dtype=np.float64)
    each: dict[str, list[float]] = {}
    for (one, db), peak in zip(known, peaks, strict=True):
        each.setdefault(one.participant, []).append(20 * float(np.log10(peak)) + db.value)
    theirs = np.array([np.mean(of) for of in each.values()])
    floor = (peaks * 10 ** (np.array([db.low for _, db in known]) / 20)).min()
    below, above = (
        tuple(dict.fromkeys(one.participant for one in tracks if one.beyond.startswith(end)))
        for end in ("below", "above")
    )
    return AtFrequency(frequency_hz, tuple(each), tuple(theirs.tolist()), mean(theirs), float(floor), below, above)


def section(found: Detections) -> Section | None:
    """Return the thresholds by frequency; None where no task has two frequencies."""
    records: list[Record] = [
        {"task": task.task.id, "frequency_hz": one.frequency_hz, "n": one.mean_db.n, "below": len(one.below),
         "above": len(one.above), "m_s2": _m_s2(one.mean_db.value),
         "low": _m_s2(one.mean_db.low), "high": _m_s2(one.mean_db.high), "sd_db": one.mean_db.sd,
         "lowest_m_s2": _m_s2(min(one.each_db)), "highest_m_s2": _m_s2(max(one.each_db)),
         "floor_m_s2": one.floor_m_s2}
        for task in found.tasks
        for one in by_frequency(task)
    ]  # fmt: skip
    if not records:
        return None
    return Section("frequencies", "By frequency", (), (tabulate("Thresholds by frequency", COLUMNS, records, (NOTE,)),))


def _m_s2(db: float | None) -> float | None:
    return None if db is None else float(10 ** (db / 20))


def sheets(found: Detections, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    """Yield a figure of the thresholds by frequency for each task with two frequencies."""
    for place, task in enumerate(found.tasks):
        if not (of := by_frequency(task)):
            continue
        figure, (axes,) = drawing.sheet([2.4], "Thresholds by frequency" if titles else "", label)
        _draw(axes, of)
        axes.set_title(drawing.short(task.task.title, 50))
        said = (
            "Thresholds by frequency, rms: each participant (thin), and the geometric mean with its 95 % interval "
            "across participants."
        )
        name = f"frequencies-{place + 1}" if place else "frequencies"
        yield drawing.Sheet(name, "frequencies" if place else "answers", said, figure)


def _draw(axes: mpl.axes.Axes, of: Sequence[AtFrequency]) -> None:
    x = np.array([one.frequency_hz for one in of])
    for who in dict.fromkeys(name for one in of for name in one.participants):
        theirs = [one for one in of if who in one.participants]
        each = 10 ** (np.array([one.each_db[one.participants.index(who)] for one in theirs]) / 20)
        axes.plot([one.frequency_hz for one in theirs], each, "-", color="0.75", linewidth=0.5, zorder=0)
    means = [one.mean_db for one in of]
    y, low, high = (
        10 ** (np.array([value if value is not None else one.value for one, value in pairs]) / 20)
        for pairs in ([(one, getattr(one, name)) for one in means] for name in ("value", "low", "high"))
    )
    axes.errorbar(x, y, (y - low, high - y), fmt="o-", color=drawing.colour(0), markersize=3, capsize=2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(x, [f"{one:g}" for one in x], minor=False)
    axes.set_xticks([], minor=True)
    # Within a decade there are too few powers of ten to read a threshold by.
    small, large = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if large > 10 * small else MaxNLocator(5))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_yticks([], minor=True)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("threshold (m/s², rms)")
