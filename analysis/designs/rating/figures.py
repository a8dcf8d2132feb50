"""Results of ratings -> their figure: means of each task with those of each participant."""

from collections.abc import Iterator

import matplotlib as mpl
import numpy as np

from palpate.analysis.designs.rating.results import Ratings, TaskRatings
from palpate.analysis.documents import drawing


def sheets(found: Ratings, label: str, *, titles: bool = False) -> tuple[drawing.Sheet, ...]:
    """Return every figure of at least one task, below the dataset's `label`, and with `titles` below what it shows."""
    with mpl.rc_context(drawing.COLUMN_STYLE):
        return tuple(_sheets(found, label, titles=titles))


def _sheets(found: Ratings, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    height = min(0.25 * len(found.materials) + 0.9, drawing.PAGE_INCHES)
    for page, tasks in drawing.pages(found.tasks, height):
        figure, panels = drawing.sheet([height] * len(tasks), f"Ratings of {found.quality}" if titles else "", label)
        for axes, task in zip(panels, tasks, strict=True):
            _means(axes, task, found.quality)
        said = (
            f"Mean ratings of {found.quality}; each participant in gray. Whiskers are 95 % intervals across "
            "participants, if there are several."
        )
        yield drawing.Sheet(f"ratings{page}", "ratings", said, figure)


def _means(axes: mpl.axes.Axes, task: TaskRatings, quality: str) -> None:
    rows = np.arange(len(task.rated))
    for person in task.people:
        means = [np.nan if value is None else value for value in person.means]
        axes.plot(means, rows, color="0.8", linewidth=0.6, zorder=0)
    for row, one in zip(rows.tolist(), task.rated, strict=True):
        if one.mean is not None:
            if one.mean.low is not None and one.mean.high is not None:
                axes.plot([one.mean.low, one.mean.high], [row, row], "-", color=drawing.colour(0))
            axes.plot([one.mean.value], [row], drawing.marker(0), color=drawing.colour(0), markersize=4)
    axes.set_yticks(rows, [drawing.short(one.material, 26) for one in task.rated])
    axes.set_ylim(len(task.rated) - 0.5, -0.5)
    axes.set_xlabel(f"rating of {quality}")
    axes.set_title(f"{drawing.short(task.task.title, 40)} (n = {len(task.people)})")
