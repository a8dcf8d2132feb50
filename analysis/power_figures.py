"""The plot of `palpate power`: a panel for each planned test and task. One function a kind of panel; each draws into
the axes it is given.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from math import ceil

import matplotlib as mpl
from matplotlib.axes import Axes

from analysis.figures import COLUMN_STYLE, LINES, Sheet, colour, key, marker, sheet
from analysis.planned_tests import Question
from analysis.power import LABEL, Power, Row
from analysis.power_sections import subject, title

PANEL_IN = 1.75
"""Height of a panel without its legend."""

LINE_IN = 0.13
LETTERS = 24
"""Of a line of a legend of two columns."""

QUIET = "#57606a"


def plot(result: Power) -> Sheet:
    """Power against participants with its Monte Carlo interval, and how far estimates of reliability lie apart."""
    panels: dict[tuple[int, tuple[str, ...]], list[Question]] = {}
    for question in result.questions:
        if not question.adjusted:
            panels.setdefault((question.plan, question.tasks), []).append(question)
    with mpl.rc_context(COLUMN_STYLE):
        heights = [PANEL_IN + _legend_in(questions) for questions in panels.values()]
        drawn, every = sheet(heights, "Power, with its Monte Carlo interval", LABEL)
        for axes, questions in zip(every, panels.values(), strict=True):
            (estimates if questions[0].alpha is None else powers)(axes, result, questions)
        said = "Power of each planned test by number of participants; bands: Wilson's 95 % interval."
        return Sheet("power", "power", said, drawn)


def powers(axes: Axes, result: Power, questions: Sequence[Question]) -> None:
    """Power of each question by number of participants, the band its Monte Carlo interval."""
    for i, question in enumerate(questions):
        rows = _rows(result, question)
        limits = [row.interval or (0.0, 0.0) for row in rows]
        values = [(low, row.power or 0.0, high) for row, (low, high) in zip(rows, limits, strict=True)]
        _curve(axes, i, [row.participants for row in rows], values, _name(question))
    for level, style, name in ((result.target, "--", "target"), (questions[0].alpha or 0.0, ":", "alpha")):
        axes.axhline(level, color=QUIET, linestyle=style, linewidth=0.8)
        beside = axes.get_yaxis_transform()
        axes.text(1.01, level, f"{name}\n{level:g}", transform=beside, va="center", color=QUIET)
    axes.set_ylim(0, 1.02)
    _frame(axes, result, questions, "power")


def estimates(axes: Axes, result: Power, questions: Sequence[Question]) -> None:
    """Median of the estimates of each question by number of participants, the band 95 % of the studies."""
    for i, question in enumerate(questions):
        rows = [row for row in _rows(result, question) if row.quantiles]
        values = [row.quantiles or (0.0, 0.0, 0.0) for row in rows]
        _curve(axes, i, [row.participants for row in rows], values, _name(question))
    axes.set_ylim(top=1.02)
    _frame(axes, result, questions, "estimate: median, 95 %")


def _curve(axes: Axes, i: int, sizes: Sequence[int], values: Sequence[tuple[float, float, float]], label: str) -> None:
    axes.fill_between(sizes, [v[0] for v in values], [v[2] for v in values], color=colour(i), alpha=0.25, linewidth=0)
    axes.plot(
        sizes,
        [v[1] for v in values],
        LINES[i % len(LINES)],
        color=colour(i),
        marker=marker(i),
        markersize=3.5,
        clip_on=False,
        label=label,
    )


def _frame(axes: Axes, result: Power, questions: Sequence[Question], what: str) -> None:
    axes.set_xlim(0, max(result.participants) * 1.03)
    axes.set_xlabel("participants of the study", labelpad=1)
    axes.set_ylabel(what)
    key(axes, title=title(questions[0]))


def _name(question: Question) -> str:
    return textwrap.fill(subject(question), LETTERS)


def _legend_in(questions: Sequence[Question]) -> float:
    """Height of the legend: its title, and rows as high as their longest name."""
    lines = [_name(question).count("\n") + 1 for question in questions]
    half = ceil(len(lines) / 2)
    return LINE_IN * (2 + max(sum(lines[:half]), sum(lines[half:])))


def _rows(result: Power, question: Question) -> list[Row]:
    return [row for size in result.participants if (row := result.row(question, size))]
