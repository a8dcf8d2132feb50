"""What all figures share: colours, style, the width of a column, the heading, and files.

Colours are those of Okabe and Ito (2008, https://jfly.uni-koeln.de/color/) without the faint yellow, and Brewer's
Blues; marker, hatching or line differ too.
"""

import io
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
MARKERS = ("o", "^", "s", "D", "v", "P")
HATCHES = ("", "///", "...", "xxx", "\\\\\\", "++")
LINES = ("-", "--", "-.", ":")
SHADES = "Blues"
"""The colour map of a ratio from 0 to 1."""

STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False,
    "hatch.linewidth": 0.6, "svg.fonttype": "path", "svg.hashsalt": "palpate", "text.parse_math": False,
}  # fmt: skip
"""A dollar sign is one: what stands between two in a name is no formula."""

COLUMN_MM, PAGE_MM = 85.0, 178.0
"""Widths of one and of two columns of a journal; the second includes the spacing between them."""

COLUMN_STYLE: Any = {
    **STYLE, "font.size": 7, "axes.titlesize": 7, "axes.labelsize": 7, "xtick.labelsize": 7, "ytick.labelsize": 7,
    "legend.fontsize": 7, "legend.frameon": False, "legend.handlelength": 1.5, "legend.columnspacing": 1.2,
    "axes.linewidth": 0.6, "lines.linewidth": 1.0,
}  # fmt: skip
"""No letter is below 7 points at the width at which a journal prints."""

PAGE_INCHES = 9.0
"""The most height of the panels of a figure, which leaves room for a caption on a page of A4 or letter."""

LETTER_INCHES = 0.058
"""A generous average width of a letter of 7 points."""

MARK, LINE = 4.0, 9.0
"""Half of the width of a marker, and the height of a line of letters, points."""

REACHES = (5.0, 12.0, 20.0, 30.0, 45.0, 65.0)
TURNS = tuple(sign * step * np.pi / 8 for step in range(9) for sign in (1, -1))
"""How far a name is from its point, points, and the angles from the first choice, radians: the next one is tried."""

PARTS = tuple(np.linspace(0.2, 1, 9))
"""Where a line from a point to its name is looked at."""

Box = tuple[float, float, float, float]
"""Left, low, right and high end, points."""


@dataclass(frozen=True)
class Sheet:
    """A figure: the name of its files, the slug of its section, and its caption."""

    name: str
    section: str
    caption: str
    figure: Figure


def sheet(rows: Sequence[float], title: str, label: str, width_mm: float = COLUMN_MM) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels, heights in inches, one below the other, under the `label` and the title, if any."""
    width = width_mm / 25.4
    letters = int((width - 0.1) / LETTER_INCHES)
    head = [*textwrap.wrap(label, letters), *textwrap.wrap(title, letters)]
    figure = Figure(figsize=(width, sum(rows) + 0.13 * len(head)), layout="constrained")
    panels = figure.subplots(len(rows), 1, squeeze=False, height_ratios=rows)[:, 0].tolist()
    figure.set_label(label)
    if head:
        figure.suptitle("\n".join(head), fontsize=7, fontweight="bold" if label else "normal")
    return figure, panels


Panel = TypeVar("Panel")


def pages(panels: Sequence[Panel], height: float) -> list[tuple[str, Sequence[Panel]]]:
    """Return the panels, of so many inches each, in runs that a page holds, each with an end of its figure's name."""
    most = max(int(PAGE_INCHES / height), 1)
    starts = range(0, len(panels), most)
    return [("" if start == 0 else f"-{start // most + 1}", panels[start : start + most]) for start in starts]


def key(axes: Axes, columns: int = 2, title: str | None = None) -> None:
    """Draw the legend above the panel, where no value is; a title leads it."""
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, borderaxespad=0.2, title=title, title_fontsize=7
    )


def common_key(figure: Figure, axes: Axes) -> None:
    """Draw one legend below panels that share it."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def colour(index: int) -> str:
    """Return the colour of a series."""
    return COLOURS[index % len(COLOURS)]


def marker(index: int) -> str:
    """Return the marker of a series, shifted at every round of colours, so that no two series look the same."""
    return MARKERS[(index + index // len(COLOURS)) % len(MARKERS)]


def short(name: str, letters: int) -> str:
    """Return the name, cut if it is longer."""
    return name if len(name) <= letters else f"{name[: letters - 1].rstrip()}…"


def width_inches(axes: Axes) -> float:
    """Return the width of the figure of these axes, inches."""
    figure = axes.get_figure(root=True)
    return float(figure.get_figwidth()) if figure else COLUMN_MM / 25.4


def name_below(axes: Axes, places: Sequence[float], names: Sequence[str], room_inches: float) -> None:
    """Write a name below each place of the axes, broken between words.

    Where a word does not fit its room, each other name is one level lower, or two of three are; else they are upright.
    """
    letters = int(room_inches / LETTER_INCHES)
    shown = told_apart(names, 26)
    longest = max((len(word) for name in shown for word in name.split()), default=0)
    levels = next((count for count in (1, 2, 3) if longest <= count * letters), 0)
    if not levels:
        axes.set_xticks(places, shown, rotation=90)
        return
    broken = [textwrap.fill(name, levels * letters) for name in shown]
    lines = [max((name.count("\n") + 1 for name in broken[level::levels]), default=0) for level in range(levels)]
    axes.set_xticks(places, ["\n" * sum(lines[: place % levels]) + name for place, name in enumerate(broken)])


def name_beside(figure: Figure, axes: Axes, names: Sequence[str]) -> bool:
    """Write a name beside each line of the axes, which is a point; return False, and write none, without room for all.

    The figure is laid out first. A name is clear of other names, their lines and points; one that is not next to its
    point, or whose point touches another, has a line to it.
    """
    figure.draw_without_rendering()
    scale = 72 / figure.dpi
    places = [axes.transData.transform(np.ravel(line.get_xydata())) * scale for line in axes.lines]
    (left, low), (right, high) = axes.bbox.get_points() * scale
    marks, taken = [_around(place, 2 * MARK, 2 * MARK) for place in places], list[Box]()
    found: list[tuple[NDArray[np.float64], float]] = []
    for name, place in zip(names, places, strict=True):
        others = sorted((other - place for other in places if other is not place), key=np.hypot.reduce)
        touching = int(bool(others) and np.hypot(*others[0]) < 2 * MARK)
        away = float(np.arctan2(*-others[0][::-1])) if touching else 0.0
        size = np.array([72 * LETTER_INCHES * len(name), LINE])
        for reach, turn in product(REACHES[touching:], TURNS):
            offset = np.array([np.cos(away + turn), np.sin(away + turn)]) * (reach + size / 2)
            box = _around(place + offset, *size)
            pointer = [_around(place + part * offset, 1, 1) for part in PARTS if reach > REACHES[0]]
            inside = left <= box[0] and box[2] <= right and low <= box[1] and box[3] <= high
            if inside and not _meet([box], [*marks, *taken]) and not _meet(pointer, taken):
                taken += [box, *pointer]
                found.append((offset, reach))
                break
        else:
            return False
    for name, line, (offset, reach) in zip(names, axes.lines, found, strict=True):
        drawn = {"arrowstyle": "-", "linewidth": 0.5, "shrinkA": 1, "shrinkB": 0} if reach > REACHES[0] else None
        point = tuple(np.ravel(line.get_xydata()))
        named = axes.annotate(
            name, point, (offset[0], offset[1]), textcoords="offset points", ha="center", va="center", arrowprops=drawn
        )
        named.set_in_layout(False)
    return True


def _around(place: NDArray[np.float64], wide: float, tall: float) -> Box:
    return place[0] - wide / 2, place[1] - tall / 2, place[0] + wide / 2, place[1] + tall / 2


def _meet(some: Sequence[Box], others: Sequence[Box]) -> bool:
    return any(
        one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
        for one, other in product(some, others)
    )


def told_apart(names: Sequence[str], letters: int) -> list[str]:
    """Return the names, cut if they are longer at the place nearest the middle that keeps most of them different."""
    if max(map(len, names), default=0) <= letters:
        return list(names)
    heads = sorted(range(letters), key=lambda head: abs(2 * head - letters + 1))

    def cut(name: str, head: int) -> str:
        return name if len(name) <= letters else f"{name[:head]}…{name[len(name) - (letters - 1 - head) :]}"

    return max(([cut(name, head) for name in names] for head in heads), key=lambda shown: len(set(shown)))


def pale(of: str) -> tuple[float, float, float]:
    """Return the colour on white at 55 %, but opaque: an SVG viewer draws a transparent hatch in the colour below."""
    red, green, blue = (0.45 + 0.55 * part for part in to_rgb(of))
    return red, green, blue


def svg(figure: Figure) -> bytes:
    """Return the figure as SVG, the same bytes for the same figure, with its label in the file's description."""
    return _saved(figure, "svg", {"Date": None, "Creator": "palpate", "Description": figure.get_label() or None})


def png(figure: Figure) -> bytes:
    """Return the figure as PNG at 300 dots an inch."""
    label = figure.get_label()
    return _saved(figure, "png", {"Software": "palpate", **({"Description": label} if label else {})})


def pdf(figure: Figure) -> bytes:
    """Return the figure as PDF, the same bytes for the same figure."""
    return _saved(figure, "pdf", {"CreationDate": None, "Creator": "palpate", "Title": figure.get_label() or None})


def _saved(figure: Figure, kind: str, metadata: Mapping[str, object]) -> bytes:
    file = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(file, format=kind, dpi=300, metadata=dict(metadata))
    return file.getvalue()
