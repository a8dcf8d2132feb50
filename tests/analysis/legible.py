"""Is a figure legible at the width of a column: no letters over letters or beyond the edge, none too small?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from palpate.analysis.documents.drawing import COLUMN_MM, PAGE_MM, Sheet


def check(found: Sequence[Sheet]) -> None:
    """Every figure is; an assertion names the letters that are not."""
    for one in found:
        width = one.figure.get_figwidth() * 25.4
        assert round(width, 1) in (COLUMN_MM, PAGE_MM), one.name
        letters = _letters(one.figure)
        right, top = one.figure.bbox.width, one.figure.bbox.height
        for text, corners in letters:
            inside = corners.min() >= -1 and corners[:, 0].max() <= right + 1 and corners[:, 1].max() <= top + 1
            assert inside, (one.name, text)
        for i, j in _near(np.array([corners for _, corners in letters])):
            assert not _overlap(letters[i][1], letters[j][1]), (one.name, letters[i][0], letters[j][0])
        sizes = [float(text.get_fontsize()) for text in one.figure.findobj(Text) if text.get_text().strip()]
        assert min(sizes) >= 7, one.name


def _letters(figure: Figure) -> list[tuple[str, np.ndarray]]:
    """Every text that is drawn, with its corners, pixels."""
    # matplotlib gives its canvas and figures no types.
    canvas: Any = FigureCanvasAgg(figure)
    lay_out: Any = figure.draw_without_rendering
    lay_out()
    drawn: list[Text] = []
    draw = Text.draw

    def spy(self: Text, renderer: RendererBase, *more: object, **named: object) -> None:
        drawn.append(self)
        draw(self, renderer)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", spy)
        lay_out()
    renderer = canvas.get_renderer()
    shown = [text for text in dict.fromkeys(drawn) if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), _corners(text, renderer)) for text in shown]


def _near(corners: np.ndarray) -> Iterator[tuple[int, int]]:
    """The pairs of which the upright boxes around the corners, shape (texts, 4, 2), meet: no other can overlap."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    for i in range(len(corners) - 1):
        meets = np.all((low[i] <= high[i + 1 :]) & (low[i + 1 :] <= high[i]), axis=1)
        yield from ((i, i + 1 + int(j)) for j in np.flatnonzero(meets))


def _corners(text: Text, renderer: RendererBase) -> np.ndarray:
    turn = text.get_rotation()
    # An annotation's own extent would have its line in it, which may pass between other letters.
    box = Text.get_window_extent(text, renderer)
    if turn % 90 == 0:
        # Empty lines above move a name to a lower level and cover nothing.
        lines = text.get_text().split("\n")
        empty = next(place for place, line in enumerate(lines) if line.strip())
        box.y1 -= (box.y1 - box.y0) * empty / len(lines)
        return np.array([[box.x0, box.y0], [box.x1, box.y0], [box.x1, box.y1], [box.x0, box.y1]])
    text.set_rotation(0)
    flat = Text.get_window_extent(text, renderer)
    text.set_rotation(turn)
    angle = np.deg2rad(turn)
    along, up = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    middle = np.array([(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2])
    half = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return np.array([middle + i * along * flat.width / 2 + j * up * flat.height / 2 for i, j in half])


def _overlap(one: np.ndarray, other: np.ndarray) -> bool:
    """Two convex boxes overlap unless a line along some side keeps them apart (separating axis theorem)."""
    for box in (one, other):
        for start, end in zip(box, np.roll(box, -1, axis=0), strict=True):
            normal = np.array([start[1] - end[1], end[0] - start[0]])
            normal = normal / np.linalg.norm(normal)
            a, b = one @ normal, other @ normal
            if a.max() <= b.min() + 1 or b.max() <= a.min() + 1:
                return False
    return True
