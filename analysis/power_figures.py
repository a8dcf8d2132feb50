"""The plot of `palpate power`: a panel for each planned test and task, at the width of a column."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures import COLOURS, MARKERS, STYLE
from analysis.planned_tests import Question
from analysis.power import LABEL, Power, Row
from analysis.power_sections import subject, title

WIDTH_IN = 3.5
PANEL_IN = 2.3
QUIET = "#57606a"


def figure(result: Power) -> Figure:
    """Power against participants with its Monte Carlo interval, and how far estimates of reliability lie apart."""
    panels = list(dict.fromkeys((question.plan, question.tasks) for question in result.questions))
    with mpl.rc_context({**STYLE, "font.size": 8}):
        drawn = Figure(figsize=(WIDTH_IN, PANEL_IN * len(panels) + 0.6), layout="constrained")
        every = drawn.subplots(len(panels), 1, squeeze=False)[:, 0]
        for axes, panel in zip(every, panels, strict=True):
            questions = [q for q in result.questions if (q.plan, q.tasks) == panel and not q.adjusted]
            (_powers if questions[0].alpha is not None else _estimates)(axes, result, questions)
            axes.set_title(title(questions[0]), fontsize=8, loc="left")
            axes.set_xlim(0, max(result.participants) * 1.03)
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=2, frameon=False, fontsize=7)
        drawn.suptitle(f"{LABEL}: power, with Monte Carlo interval", fontsize=8, fontweight="bold")
        return drawn


def _powers(axes: Axes, result: Power, questions: Sequence[Question]) -> None:
    for i, question in enumerate(questions):
        rows = _rows(result, question)
        sizes = [row.participants for row in rows]
        limits = [row.interval or (0.0, 0.0) for row in rows]
        colour = COLOURS[i % len(COLOURS)]
        axes.fill_between(sizes, [low for low, _ in limits], [high for _, high in limits], color=colour, alpha=0.25)
        axes.plot(
            sizes,
            [row.power or 0.0 for row in rows],
            color=colour,
            marker=MARKERS[i % len(MARKERS)],
            markersize=max(2.0, 4.5 - 0.8 * i),
            linewidth=1,
            clip_on=False,
            label=textwrap.fill(subject(question), 22),
        )
    for level, style, name in ((result.target, "--", "target"), (questions[0].alpha or 0.0, ":", "alpha")):
        axes.axhline(level, color=QUIET, linestyle=style, linewidth=0.8)
        beside = axes.get_yaxis_transform()
        axes.text(1.01, level, f"{name}\n{level:g}", transform=beside, va="center", fontsize=6, color=QUIET)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("participants of the study", labelpad=1)
    axes.set_ylabel("power")


def _estimates(axes: Axes, result: Power, questions: Sequence[Question]) -> None:
    for i, question in enumerate(questions):
        rows = [row for row in _rows(result, question) if row.quantiles]
        sizes = [row.participants for row in rows]
        bounds = [row.quantiles or (0.0, 0.0, 0.0) for row in rows]
        colour = COLOURS[i % len(COLOURS)]
        axes.fill_between(sizes, [b[0] for b in bounds], [b[2] for b in bounds], color=colour, alpha=0.25)
        axes.plot(
            sizes,
            [b[1] for b in bounds],
            color=colour,
            marker=MARKERS[i % len(MARKERS)],
            markersize=3,
            linewidth=1,
            label=f"{textwrap.fill(question.subject, 40)}:\nmedian and 95 % of studies",
        )
    axes.set_ylim(top=1.02)
    axes.set_xlabel("participants of the study", labelpad=1)
    axes.set_ylabel("estimate")


def _rows(result: Power, question: Question) -> list[Row]:
    return [row for size in result.participants if (row := result.row(question, size))]
