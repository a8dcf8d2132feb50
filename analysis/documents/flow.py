"""The flow of a study's participants as a figure."""

import textwrap
from collections.abc import Sequence
from itertools import product
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from palpate.analysis.documents.drawing import COLOURS, COLUMN_STYLE, LETTER_INCHES, PAGE_MM, pale


def flow(label: str, title: str, aside: str, stages: Sequence[tuple[str, Sequence[str]]]) -> Figure:
    """Return a flow of participants: stages from the top, each a name and the texts of its boxes.

    Stages of as many boxes are joined box by box, others fork or meet; `aside` is a box between the first two.
    """
    line, pad, gap, name, width = 0.15, 0.12, 0.34, 0.3, PAGE_MM / 25.4
    lines = [max(text.count("\n") + 1 for text in boxes) for _, boxes in stages]
    letters = [len(stage) for stage, _ in stages]
    heights = [max(n * line + 2 * pad, m * LETTER_INCHES + pad) for n, m in zip(lines, letters, strict=True)]
    beside = (aside.count("\n") + 1) * line + 2 * pad
    gaps = [0.0, beside + 1.5 * gap, *[gap] * len(stages)]
    heads, titles = textwrap.wrap(label, 90), textwrap.wrap(title, 100)
    head = 0.16 * (len(heads) + len(titles)) + 0.1
    tall = sum(heights) + sum(gaps[: len(stages)]) + head + 0.05
    with mpl.rc_context(COLUMN_STYLE):
        figure = Figure(figsize=(width, tall))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, width), ylim=(0, tall))
        axes.set_axis_off()
        axes.text(width / 2, tall - 0.05, "\n".join(heads), ha="center", va="top", fontsize=8, fontweight="bold")
        axes.text(width / 2, tall - 0.05 - 0.16 * len(heads), "\n".join(titles), ha="center", va="top", fontsize=8)
        above: list[float] = []
        top = tall - head
        for (stage, boxes), high, space in zip(stages, heights, gaps, strict=False):
            top -= space
            column = (width - name - 0.1) / len(boxes)
            places = [name + 0.05 + column * (index + 0.5) for index in range(len(boxes))]
            _box(axes, name / 2, top, name - 0.1, high, stage, 90, facecolor=pale(COLOURS[5]))
            for place, text in zip(places, boxes, strict=True):
                _box(axes, place, top, min(column - 0.15, 2.6), high, text)
            pairs = zip(above, places, strict=True) if len(above) == len(places) else product(above, places)
            for start, end in pairs:
                turn = top + gap / 2
                axes.plot([start, start, end, end], [top + space, turn, turn, top + 0.06], color="black", linewidth=0.8)
                axes.plot(end, top + 0.04, "v", color="black", markersize=4)
            above = places
            top -= high
            if stage == stages[0][0]:
                right, middle = width - 1.35, top - gap / 2 - beside / 2
                axes.plot([places[0], right - 1.3], [middle, middle], color="black", linewidth=0.8)
                axes.plot(right - 1.32, middle, ">", color="black", markersize=4)
                _box(axes, right, middle + beside / 2, 2.5, beside, aside)
    figure.set_label(label)
    return figure


def _box(axes: Axes, x: float, top: float, wide: float, high: float, text: str, turn: int = 0, **style: Any) -> None:
    edge: Any = {"facecolor": "white", "edgecolor": "black", "linewidth": 0.8, **style}
    axes.add_patch(Rectangle((x - wide / 2, top - high), wide, high, **edge))
    axes.text(x, top - high / 2, text, ha="center", va="center", rotation=turn, linespacing=1.3)
