"""Figures: correct ratios (Okamoto, Fig. 11), confusion matrices, maps of the materials, and confusion against
dissimilarity (Fig. 13).

Colours are told apart with every common colour vision (Okabe and Ito's palette; a map of one hue), and series differ
in hatching as well. The dataset's label stands in every figure.
"""

from __future__ import annotations

import io
import textwrap
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from analysis.results import Results, TaskResult
from experiment.records import NO_ANSWER

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
MARKERS = ("o", "^", "s", "D", "v", "P")
HATCHES = ("", "///", "...", "xxx", "\\\\\\", "++")
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.linewidth": 0.6,
    "svg.fonttype": "path",
    "svg.hashsalt": "palpate",
}


def figures(results: Results, label: str) -> dict[str, Figure]:
    """Every figure, by the name of its files.

    Args:
        results: at least one task.
        label: of the dataset; empty for a study's own data.
    """
    with mpl.rc_context(STYLE):
        found = {"correct-ratios": correct_ratios(results, label), "confusion": heat_maps(results, label)}
        if any(one.scaling for one in results.identifications):
            found["map"] = maps(results, label)
        if any(one.mantel for one in results.identifications):
            found["dissimilarity"] = against_dissimilarity(results, label)
        return found


def svg(figure: Figure) -> bytes:
    """The figure as SVG, the same bytes for the same figure."""
    return _saved(figure, "svg", {"Date": None, "Creator": "palpate"})


def png(figure: Figure) -> bytes:
    """The figure as PNG at 150 dots an inch."""
    return _saved(figure, "png", {"Software": "palpate"})


def correct_ratios(results: Results, label: str) -> Figure:
    """Correct answer ratios for each material and task: mean, SD and every participant (Okamoto, Fig. 11)."""
    materials = results.tasks[0].confusion.materials
    figure = Figure(figsize=(max(6.4, 1.6 * len(materials)), 4.4), layout="constrained")
    axes = figure.add_subplot()
    width = 0.8 / len(results.tasks)
    for index, task in enumerate(results.tasks):
        _bars(axes, task, index, width, (index - (len(results.tasks) - 1) / 2) * width)
    for chance in sorted({task.chance for task in results.tasks}):
        axes.axhline(chance, color="black", linestyle="--", linewidth=1, label=f"chance, {chance:.3g}")
    axes.set_xticks(range(len(materials)), [textwrap.fill(material, 14) for material in materials])
    axes.set_ylim(0, 1.22)
    axes.set_yticks(np.linspace(0, 1, 6))
    axes.set_ylabel("correct answer ratio")
    axes.legend(loc="upper center", ncols=3, frameon=False, fontsize=9)
    _head(figure, "Correct answers: mean ± SD; a dot is a participant", label)
    return figure


def heat_maps(results: Results, label: str) -> Figure:
    """Confusion matrix of every task: mean ratio ± SD among participants."""
    count = len(results.tasks[0].confusion.materials)
    unanswered = any(task.confusion.unanswered for task in results.tasks)
    columns = len(results.tasks) * (count + unanswered)
    figure = Figure(figsize=(max(6.0, 0.82 * columns + 1.7), 0.78 * count + 1.9), layout="constrained")
    names = [textwrap.fill(material, 13) for material in results.tasks[0].confusion.materials]
    for index, task in enumerate(results.tasks):
        axes = figure.add_subplot(1, len(results.tasks), index + 1)
        matrix = task.confusion
        answers = (*matrix.materials, NO_ANSWER)[: count + unanswered]
        means = matrix.means()[:, : len(answers)]
        axes.pcolormesh(means, cmap="Blues", vmin=0, vmax=1, edgecolors="white", linewidth=1)
        axes.invert_yaxis()
        axes.set_aspect("equal")
        for i in range(count):
            for j in range(len(answers)):
                _cell(axes, task, i, j)
        axes.set_xticks(np.arange(len(answers)) + 0.5, [textwrap.fill(a, 13) for a in answers], rotation=30, ha="right")
        axes.set_yticks(np.arange(count) + 0.5, names if index == 0 else [""] * count)
        axes.tick_params(length=0)
        axes.set_xlabel("answered")
        if index == 0:
            axes.set_ylabel("presented")
        axes.set_title(f"{task.task.title} (n = {len(matrix.participants)})", fontsize=10)
        axes.spines[:].set_visible(False)
    _head(figure, "Answer ratios: mean ± SD among participants", label)
    return figure


def maps(results: Results, label: str) -> Figure:
    """Materials as points, the closer the more they were taken for one another; a panel a task."""
    found = [one for one in results.identifications if one.scaling]
    figure = Figure(figsize=(4.2 * len(found) + 0.6, 4.4), layout="constrained")
    for index, one in enumerate(found):
        axes = figure.add_subplot(1, len(found), index + 1)
        points = one.scaling.points if one.scaling else np.zeros((0, 2))
        axes.plot(*points.T, "o", color=COLOURS[index % len(COLOURS)])
        near = 0.15 * float(np.ptp(points, axis=0).max())
        for material, point in zip(results.tasks[0].confusion.materials, points, strict=True):
            close = [other for other in points if 0 < np.hypot(*(other - point)) < near]
            below = any(tuple(other[::-1]) > tuple(point[::-1]) for other in close)
            where = (0, -7 if below else 7)
            upright = "top" if below else "bottom"
            name = textwrap.fill(material, 14)
            axes.annotate(name, tuple(point), where, textcoords="offset points", ha="center", va=upright, fontsize=8)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.25)
        axes.set_title(one.task, fontsize=10)
        axes.set_xlabel("first axis")
        axes.set_ylabel("second axis" if index == 0 else "")
    _head(figure, "Map of the materials: classical scaling of their confusions", label)
    return figure


def against_dissimilarity(results: Results, label: str) -> Figure:
    """Every confusing ratio against the dissimilarity of the two materials (Okamoto, Fig. 13)."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for index, (task, one) in enumerate(zip(results.tasks, results.identifications, strict=True)):
        if one.mantel is None:
            continue
        means, names = task.confusion.means(), task.confusion.materials
        pairs = [(i, j) for i in range(len(names)) for j in range(len(names)) if i != j]
        x = [results.dissimilarities.pairs[frozenset((names[i], names[j]))] for i, j in pairs]
        said = f"{one.task}: Mantel r = {one.mantel.r:.2f}, P = {one.mantel.p_two:.3f}"
        mark, colour = MARKERS[index % len(MARKERS)], COLOURS[index % len(COLOURS)]
        axes.plot(x, [means[i, j] for i, j in pairs], mark, color=colour, alpha=0.8, label=said)
    axes.set_xlabel(f"dissimilarity of the spectra ({results.dissimilarities.source})")
    axes.set_ylabel("confusing answer ratio")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=9)
    _head(figure, "Confusing answers and dissimilarity of spectra", label)
    return figure


def _bars(axes: Axes, task: TaskResult, index: int, width: float, shift: float) -> None:
    matrix = task.confusion
    colour = COLOURS[index % len(COLOURS)]
    for place, test in enumerate(task.tests):
        result = test.result
        if result.mean is None:
            continue
        x = place + shift
        axes.bar(
            x,
            result.mean,
            width * 0.92,
            facecolor=_pale(colour),
            edgecolor=colour,
            hatch=HATCHES[index % len(HATCHES)],
            label=f"{task.task.id} (n = {len(matrix.participants)})" if place == 0 else None,
        )
        values = [float(value) for value in matrix.ratios(place, place).values()]
        spread = np.linspace(-0.28, 0.28, len(values)) * width if len(values) > 1 else np.zeros(1)
        axes.plot(x + spread, values, ".", color="black", markersize=3.5, alpha=0.6, clip_on=False)
        if result.sd is not None:
            axes.errorbar(x, result.mean, yerr=result.sd, color="black", capsize=4, linewidth=1.4)
        top = max(1.0, *values, result.mean + (result.sd or 0.0))
        axes.text(x, top + 0.01, result.stars, ha="center", va="bottom")


def _pale(colour: str) -> tuple[float, float, float]:
    """The colour on white at 55 %: opaque, since an SVG viewer draws a transparent hatch in the colour below it."""
    red, green, blue = (0.45 + 0.55 * part for part in to_rgb(colour))
    return red, green, blue


def _cell(axes: Axes, task: TaskResult, i: int, j: int) -> None:
    mean, sd = task.confusion.mean(i, j), task.confusion.sd(i, j)
    if mean is None:
        axes.text(j + 0.5, i + 0.5, "not\npresented", ha="center", va="center", fontsize=7)
        return
    stars = task.tests[i].result.stars if i == j else ""
    text = f"{mean:.2f}{stars}" + ("" if sd is None else f"\n± {sd:.2f}")
    axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=8, color="white" if mean > 0.7 else "black")


def _head(figure: Figure, title: str, label: str) -> None:
    width = int(figure.get_figwidth() * 11)
    head = "\n".join([*textwrap.wrap(label, width), *textwrap.wrap(title, width)])
    figure.suptitle(head, fontsize=10, fontweight="bold" if label else "normal")


def _saved(figure: Figure, kind: str, metadata: dict[str, str | None]) -> bytes:
    file = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(file, format=kind, dpi=150, metadata=metadata)
    return file.getvalue()
