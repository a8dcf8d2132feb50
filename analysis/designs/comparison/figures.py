"""Results of comparisons -> their figures, each with its name, its section and its caption."""

import textwrap
from collections.abc import Iterator, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from palpate.analysis.designs.comparison.results import (
    LAWS,
    Compared,
    Scaled,
    TaskComparisons,
    choices_words,
    more,
    percent,
)
from palpate.analysis.documents import drawing

DARK = 0.6
"""The text of a cell above this share is white."""


def sheets(results: Compared, label: str, *, titles: bool = False) -> tuple[drawing.Sheet, ...]:
    """Return every figure of at least one task, below the dataset's `label`, and with `titles` below what it shows."""
    with mpl.rc_context(drawing.COLUMN_STYLE):
        return tuple(_sheets(results, label, titles=titles))


def _sheets(results: Compared, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    shares = choices_words(results)
    height = min(0.42 * len(results.materials) + 0.9, drawing.PAGE_INCHES)
    for page, tasks in drawing.pages(results.tasks, height):
        figure, panels = drawing.sheet([height] * len(tasks), f"{shares}, percent" if titles else "", label)
        for axes, task in zip(panels, tasks, strict=True):
            choices(axes, task, results.materials)
            if len(results.tasks) == 1 and not titles:
                axes.set_title("")
        said = (
            f"Percentage of {shares.lower()} for each pair in {_people(tasks)}, from 0 (white) to 100 (dark): how "
            f"often the row was named as having {more(results)} than the column. The diagonal, where both samples "
            "were of one material, shows how often the first was named (guessing: 50). Intervals are in the table."
        )
        yield drawing.Sheet(f"{shares.lower().replace(' ', '-')}{page}", "answers", said, figure)
    shown = [(task, one) for task in results.tasks for one in task.scales if one.scale is not None]
    height = min(0.2 * len(results.materials) + 0.8, drawing.PAGE_INCHES)
    for page, scaled in drawing.pages(shown, height):
        figure, panels = drawing.sheet([height] * len(scaled), f"Scale of {results.quality}" if titles else "", label)
        for place, (axes, (task, one)) in enumerate(zip(panels, scaled, strict=True)):
            scale(axes, task, one, results.materials, place)
            if len(results.tasks) == 1 and not titles:
                axes.set_title("")
        said = (
            f"Scales of {results.quality} in {_people([task for task, _ in scaled])}. Whiskers are 95 % intervals "
            "across participants, if there are several; 0 is the mean of the materials."
        )
        yield drawing.Sheet(f"scales{page}", "scales", said, figure)


def _people(tasks: Sequence[TaskComparisons]) -> str:
    """Return the titles of tasks, each with its number of participants."""
    return " and ".join(dict.fromkeys(f"{task.task.title} (n = {len(task.participants)})" for task in tasks))


def choices(axes: Axes, task: TaskComparisons, materials: tuple[str, ...]) -> None:
    """Draw the shares of choices below and on the diagonal, each with its percentage."""
    count = len(materials)
    shares = np.full((count, count), np.nan)
    for pair in task.pairs:
        value = pair.right.value
        if value is not None:
            shares[pair.high, pair.low] = value
            ink = "white" if value > DARK else "black"
            axes.text(pair.low + 0.5, pair.high + 0.5, percent(pair.right), ha="center", va="center", color=ink)
    axes.pcolormesh(shares, cmap=drawing.SHADES, vmin=0, vmax=1, edgecolors="white", linewidth=1)
    axes.invert_yaxis()
    names = [textwrap.fill(drawing.short(material, 26), 14) for material in materials]
    drawing.name_below(
        axes, [place + 0.5 for place in range(count)], materials, (drawing.width_inches(axes) - 0.9) / count
    )
    axes.set_yticks(np.arange(count) + 0.5, names)
    axes.tick_params(length=0)
    axes.set_title(f"{drawing.short(task.task.title, 40)} (n = {len(task.participants)})")
    axes.spines[:].set_visible(False)


def scale(axes: Axes, task: TaskComparisons, one: Scaled, materials: tuple[str, ...], place: int) -> None:
    """Draw the value of each material with its interval, the materials one below the other."""
    rows = np.arange(len(materials))
    for row, value in zip(rows.tolist(), one.values, strict=True):
        if value.low is not None and value.high is not None:
            axes.plot([value.low, value.high], [row, row], "-", color=drawing.colour(place))
        axes.plot([value.value], [row], drawing.marker(place), color=drawing.colour(place), markersize=4)
    axes.axvline(0, color="0.7", linewidth=0.6, zorder=0)
    axes.set_yticks(rows, [drawing.short(material, 26) for material in materials])
    axes.set_ylim(len(materials) - 0.5, -0.5)
    axes.set_xlabel(textwrap.fill(", ".join(LAWS[one.law]), 40))
    axes.set_title(drawing.short(task.task.title, 40))
