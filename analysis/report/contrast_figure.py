"""Marginal means of right answers -> one figure: each material in each task, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import FuncFormatter
from scipy.special import expit, logit

from palpate.analysis.documents.drawing import (
    COLUMN_MM,
    COLUMN_STYLE,
    PAGE_MM,
    Sheet,
    colour,
    key,
    marker,
    name_below,
    sheet,
    width_inches,
)
from palpate.analysis.identification.contrasts import Marginal

FEW = 5
"""The most materials beside one another within a column of a journal; more take the width of two."""

SHARES = (0.001, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.999)


def contrast_sheet(found: Marginal, tasks: Sequence[str], label: str, chances: Sequence[float], titles: bool) -> Sheet:
    """Return the figure of marginal means; `label` stands above it, and its own title if there are to be `titles`."""
    materials = list(dict.fromkeys(one.material for one in found.means))
    width = COLUMN_MM if len(materials) <= FEW else PAGE_MM
    with mpl.rc_context(COLUMN_STYLE):
        figure, (axes,) = sheet([2.4], "Marginal means of right answers" * titles, label, width)
        for index, task in enumerate(tasks):
            of = [one for one in found.means if one.task == task]
            places = [materials.index(one.material) + 0.16 * (index - (len(tasks) - 1) / 2) for one in of]
            odds = np.array([one.log_odds for one in of])
            reach = np.array([[one.log_odds - one.low, one.high - one.log_odds] for one in of]).reshape(-1, 2).T
            axes.errorbar(
                places, odds, yerr=reach, fmt=marker(index), color=colour(index), capsize=2.5, markersize=4, label=task
            )
        for chance in sorted(set(chances)):
            axes.axhline(float(logit(chance)), color="black", linestyle="--", linewidth=0.8)
        low, high = axes.get_ylim()
        axes.set_yticks([value for share in SHARES if low <= (value := float(logit(share))) <= high])
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{expit(value):.3g}"))
        axes.set_ylim(low, high)
        axes.set_ylabel("right answers (on the logit)")
        name_below(axes, range(len(materials)), materials, (width_inches(axes) - 0.6) / len(materials))
        axes.set_xlim(-0.5, len(materials) - 0.5)
        key(axes)
    said = (
        f"Ours: marginal means of right answers of {found.participants} participants, on the logit, with their 95 % "
        "intervals, of a participant in the middle. Dashed: chance. Where intervals of two materials or tasks overlap "
        "they may differ all the same; the tables here test it."
    )
    return Sheet("marginal-means", "contrasts", said, figure)
