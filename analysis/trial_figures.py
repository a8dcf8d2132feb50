"""Figures of the course of a study: learning and speed curves, onset errors, masker levels. One function a figure; each
draws into the axes it is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.course import MaskerLevels, OnsetErrors, SpeedBin, Window
from analysis.figures import COLOURS, HATCHES, LINES, MARKERS, key, pale, told_apart
from analysis.words import number_of

NAMED = 20
"""More participants than this stand in order of their level, without their labels."""

TICK_LETTERS = 12
"""Letters of a participant's label below an axis."""

BINS = 40
"""Most bins of the histogram of onset errors."""


def learning(axes: Axes, curves: Mapping[str, Sequence[Window]], chances: Mapping[str, float]) -> None:
    """Share of right answers in a running window of trials, each point at the window's middle."""
    for index, (task, windows) in enumerate(curves.items()):
        colour, line = COLOURS[index % len(COLOURS)], LINES[index % len(LINES)]
        x = [(one.first + one.last) / 2 for one in windows]
        axes.plot(x, [one.right / one.trials for one in windows], line, color=colour, label=task, marker=_dot(x))
        known = [(place, one.interval) for place, one in zip(x, windows, strict=True) if one.interval]
        if known:
            places = [place for place, _ in known]
            lows, highs = [limits.low for _, limits in known], [limits.high for _, limits in known]
            axes.fill_between(places, lows, highs, color=colour, alpha=0.2, linewidth=0)
    _ratios(axes, chances)
    axes.set_xlabel("trial number, middle of the window")


def speed(axes: Axes, curves: Mapping[str, Sequence[SpeedBin]], chances: Mapping[str, float]) -> None:
    """Share of right answers in bins of the foot's speed, each point at the mean speed of its steps."""
    for index, (task, bins) in enumerate(curves.items()):
        shares = np.array([one.right / one.trials for one in bins])
        lows, highs = (np.array([getattr(one.interval, end) for one in bins]) for end in ("low", "high"))
        axes.errorbar(
            [one.mean_mm_s for one in bins],
            shares,
            yerr=np.abs([shares - lows, highs - shares]),
            color=COLOURS[index % len(COLOURS)],
            linestyle=LINES[index % len(LINES)],
            marker=MARKERS[index % len(MARKERS)],
            markersize=3.5,
            capsize=2,
            label=task,
        )
    _ratios(axes, chances)
    axes.set_xlabel("speed of the foot (mm/s)")


def onset_errors(axes: Axes, found: Mapping[str, OnsetErrors]) -> None:
    """Histogram of measured onset minus contact, the same bins for every task."""
    everything = np.concatenate([one.errors_ms for one in found.values()])
    edges = np.histogram_bin_edges(everything, bins=_bins(everything))
    for index, (task, one) in enumerate(found.items()):
        colour = COLOURS[index % len(COLOURS)]
        spread = "" if one.sd_ms is None else f" ± {one.sd_ms:.2f}"
        axes.hist(
            one.errors_ms,
            bins=edges.tolist(),
            histtype="stepfilled",
            facecolor="none" if index else pale(colour),
            edgecolor=colour,
            hatch=HATCHES[index % len(HATCHES)],
            linestyle=LINES[index % len(LINES)],
            label=f"{task}: {one.mean_ms:.2f}{spread} ms, {number_of(len(one.errors_ms), 'trial')}",
        )
    axes.axvline(0, color="black", linestyle="--", linewidth=0.8)
    axes.set_xlabel("measured onset minus contact (ms)")
    axes.set_ylabel("trials")
    key(axes, columns=1)


def masker_levels(axes: Axes, found: Mapping[str, Sequence[MaskerLevels]]) -> None:
    """Median level of every participant, with the lowest and highest of the trials."""
    order = list(dict.fromkeys(one.participant for levels in found.values() for one in levels))
    named = len(order) <= NAMED
    for index, (task, levels) in enumerate(found.items()):
        shown = levels if named else sorted(levels, key=lambda one: one.median_db_a)
        x = [order.index(one.participant) if named else rank for rank, one in enumerate(shown)]
        middle = np.array([one.median_db_a for one in shown])
        reach = np.array([[m - one.low_db_a, one.high_db_a - m] for m, one in zip(middle, shown, strict=True)]).T
        axes.errorbar(
            np.array(x) + 0.12 * (index - (len(found) - 1) / 2),
            middle,
            yerr=reach,
            fmt=MARKERS[index % len(MARKERS)],
            color=COLOURS[index % len(COLOURS)],
            markersize=3,
            linewidth=0.7,
            label=task,
        )
    if named:
        shown_as = told_apart(order, TICK_LETTERS)
        longest = max(map(len, shown_as))
        turned: Any = {"rotation": 90} if longest * len(order) > 40 else {}
        axes.set_xticks(range(len(order)), shown_as, **turned)
    axes.set_xlabel("participant" if named else "participants, in order of their level")
    axes.set_ylabel("masker (dB(A))")
    key(axes)


def _bins(values: NDArray[np.float64]) -> int:
    """As many as Freedman and Diaconis (1981) would have, a bin 2 IQR / n^(1/3) wide; never more than `BINS`.

    Counted before any is made: one value far out asks for millions.
    """
    low, high = np.quantile(values, (0.25, 0.75))
    width, reach = float(2 * (high - low) / values.size ** (1 / 3)), float(np.ptp(values))
    if width:
        return ceil(min(reach / width, BINS))
    return BINS if reach else 1


def _ratios(axes: Axes, chances: Mapping[str, float]) -> None:
    for chance in sorted(set(chances.values())):
        axes.axhline(chance, color="black", linestyle="--", linewidth=0.8, label=f"chance, {chance:.3g}")
    axes.set_ylim(0, 1.02)
    axes.set_yticks(np.linspace(0, 1, 6))
    axes.set_ylabel("correct answer ratio")
    key(axes)


def _dot(points: Sequence[float]) -> str:
    """A line through a single point would not be seen."""
    return "o" if len(points) == 1 else ""
