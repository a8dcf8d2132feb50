"""Figures of answers: correct ratios (Okamoto, Fig. 11), confusion matrices of a task and of each participant, maps of
the materials, and confusion against dissimilarity (Fig. 13).

One function a figure; each draws into the axes it is given.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from analysis.figures import COLUMN_MM, HATCHES, LETTER_INCHES, SHADES, colour, key, marker, pale, short, told_apart
from analysis.identification import Identification
from analysis.results import TaskResult
from experiment.event_columns import NO_ANSWER

ACROSS = 5
"""Participants beside one another on a page of panels."""

PANEL_LETTERS = 10
"""Letters above a participant's panel; where a label leaves no room for the share, that stands below it."""

DOTS = 50
"""More participants than this are not drawn as dots, which would cover the bar."""

DARK = 0.6
"""Above this ratio a cell is so dark that its text is white."""


def correct_ratios(axes: Axes, tasks: Sequence[TaskResult]) -> None:
    """Correct answer ratios for each material and task: mean, SD, stars and every participant."""
    materials = tasks[0].confusion.materials
    width = 0.8 / len(tasks)
    for index, task in enumerate(tasks):
        _bars(axes, task, index, width, (index - (len(tasks) - 1) / 2) * width)
    for chance in sorted({task.chance for task in tasks}):
        axes.axhline(chance, color="black", linestyle="--", linewidth=0.8, label=f"chance, {chance:.3g}")
    _names(axes, materials)
    axes.set_ylim(0, 1.18)
    axes.set_yticks(np.linspace(0, 1, 6))
    axes.set_ylabel("correct answer ratio")
    key(axes)


def confusion(axes: Axes, task: TaskResult, *, unanswered: bool) -> None:
    """Mean answer ratios of one task as a heat map; each cell says mean and SD where there is room for them."""
    matrix = task.confusion
    answers = (*matrix.materials, NO_ANSWER)[: len(matrix.materials) + unanswered]
    axes.pcolormesh(matrix.means()[:, : len(answers)], cmap=SHADES, vmin=0, vmax=1, edgecolors="white", linewidth=1)
    axes.invert_yaxis()
    room = (_width(axes) - 0.9) / len(answers)
    for i in range(len(matrix.materials)):
        for j in range(len(answers)):
            _cell(axes, task, i, j, room)
    letters = max(int(room / LETTER_INCHES), 6)
    slanted = any(len(word) > letters for answer in answers for word in answer.split())
    turned: Any = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if slanted else {}
    shown = [answer if slanted else textwrap.fill(answer, letters) for answer in answers]
    axes.set_xticks(np.arange(len(answers)) + 0.5, [short(name, 26) for name in shown], **turned)
    names = [textwrap.fill(short(material, 26), 14) for material in matrix.materials]
    axes.set_yticks(np.arange(len(names)) + 0.5, names)
    axes.tick_params(length=0)
    axes.set_xlabel("answered")
    axes.set_ylabel("presented")
    axes.set_title(f"{short(task.task.title, 40)} (n = {len(matrix.participants)})")
    axes.spines[:].set_visible(False)


def participants(axes: Axes, task: TaskResult, first: int, last: int) -> None:
    """Every participant's own matrix, from `first` up to but not `last`: label and share right above each.

    Rows are presented materials and columns answers, in the order of the tables; a material that a participant was
    not presented stays white.
    """
    matrix = task.confusion
    size, answers = len(matrix.materials), len(matrix.materials) + bool(matrix.unanswered)
    step = (answers + 1, size + 2.2 * size / 4)
    shown = told_apart(matrix.participants, PANEL_LETTERS)
    between = ": " if max(map(len, shown)) <= PANEL_LETTERS - 5 else "\n"
    for place, index in enumerate(range(first, last)):
        x, y = place % ACROSS * step[0], place // ACROSS * step[1]
        counts, trials = matrix.counts[index, :, :answers], matrix.trials[index]
        ratios = np.where(trials[:, None] > 0, counts / np.maximum(trials, 1)[:, None], np.nan)
        edges = x + np.arange(answers + 1), y + np.arange(size + 1)
        axes.pcolormesh(*edges, ratios, cmap=SHADES, vmin=0, vmax=1, edgecolors="#c9ced6", linewidth=0.25)
        right = float(np.trace(counts[:, :size]) / trials.sum())
        axes.text(x, y - 0.08 * size, f"{shown[index]}{between}{right:.2f}", ha="left", va="bottom")
    axes.set_xlim(-0.1, ACROSS * step[0] - 0.9)
    axes.set_ylim(ceil((last - first) / ACROSS) * step[1] - step[1] + size + 0.1, -0.55 * size)
    axes.set_axis_off()


def material_map(axes: Axes, one: Identification, materials: Sequence[str]) -> None:
    """Materials as points, the closer the more they were taken for one another."""
    points = one.scaling.points if one.scaling else np.zeros((0, 2))
    for index, (material, point) in enumerate(zip(materials, points, strict=True)):
        axes.plot(*point, marker(index), color=colour(index), label=short(material, 24))
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.15)
    axes.set_xlabel("first axis")
    axes.set_ylabel(f"{one.task}: second axis")


def against_dissimilarity(axes: Axes, found: Mapping[str, Sequence[tuple[float, float]]], source: str) -> None:
    """Confusing ratios against the dissimilarity of the two materials.

    Args:
        axes: to draw into.
        found: name of a series -> dissimilarity and ratio of each of its points.
        source: of the dissimilarities.
    """
    for index, (name, points) in enumerate(found.items()):
        x, y = zip(*points, strict=True)
        axes.plot(x, y, marker(index), color=colour(index), markersize=4, alpha=0.8, label=name, clip_on=False)
    said = f"dissimilarity of the spectra ({source})"
    axes.set_xlabel(textwrap.fill(said, int((_width(axes) - 0.6) / LETTER_INCHES)))
    axes.set_ylabel("confusing answer ratio")
    axes.set_xlim(0)
    axes.set_ylim(0)
    key(axes, columns=1)


def _bars(axes: Axes, task: TaskResult, index: int, width: float, shift: float) -> None:
    matrix = task.confusion
    hue = colour(index)
    named = False
    for place, test in enumerate(task.tests):
        result = test.result
        if result.mean is None:
            continue
        x = place + shift
        axes.bar(
            x,
            result.mean,
            width * 0.92,
            facecolor=pale(hue),
            edgecolor=hue,
            hatch=HATCHES[index % len(HATCHES)],
            label=None if named else f"{task.task.id} (n = {len(matrix.participants)})",
        )
        named = True
        values = [float(value) for value in matrix.ratios(place, place).values()]
        if len(values) <= DOTS:
            spread = np.linspace(-0.28, 0.28, len(values)) * width if len(values) > 1 else np.zeros(1)
            axes.plot(x + spread, values, ".", color="black", markersize=2.5, alpha=0.6, clip_on=False)
        if result.sd is not None:
            axes.errorbar(x, result.mean, yerr=result.sd, color="black", capsize=2.5, linewidth=1.0)
        top = max(1.0, *values, min(result.mean + (result.sd or 0.0), 1.1))
        axes.text(x, top + 0.01, result.stars, ha="center", va="bottom")


def _cell(axes: Axes, task: TaskResult, i: int, j: int, room: float) -> None:
    mean, sd = task.confusion.mean(i, j), task.confusion.sd(i, j)
    whole = room >= 8 * LETTER_INCHES
    if mean is None:
        text = "not\nshown" if whole else "-"
    elif room < 4.5 * LETTER_INCHES:
        return
    else:
        stars = task.tests[i].result.stars if i == j and whole else ""
        text = f"{mean:.2f}{stars}" + ("" if sd is None or not whole else f"\n± {sd:.2f}")
    ink = "white" if mean is not None and mean > DARK else "black"
    axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", color=ink)


def _names(axes: Axes, materials: Sequence[str]) -> None:
    """Names of the materials below their places: broken between words where that does, else slanted."""
    letters = int((_width(axes) - 0.5) / len(materials) / LETTER_INCHES) - 1
    shown = [short(material, 26) for material in materials]
    if any(len(word) > letters for name in shown for word in name.split()):
        axes.set_xticks(range(len(shown)), shown, rotation=40, ha="right", rotation_mode="anchor")
    else:
        axes.set_xticks(range(len(shown)), [textwrap.fill(name, letters) for name in shown])


def _width(axes: Axes) -> float:
    figure = axes.get_figure(root=True)
    return float(figure.get_figwidth()) if figure else COLUMN_MM / 25.4
