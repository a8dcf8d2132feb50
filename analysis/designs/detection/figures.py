"""Results of detection -> figures: each track trial by trial, and the fitted function of each."""

from collections.abc import Iterator

import matplotlib as mpl
import numpy as np

from palpate.analysis.designs.detection import frequencies
from palpate.analysis.designs.detection.results import Detections, Track
from palpate.analysis.documents import drawing

HEIGHT = 1.35

UNTRACKED = ("constant", "one level")
"""Methods of levels that no answer moves, so that their order shows nothing."""


def sheets(found: Detections, label: str, *, titles: bool = False) -> tuple[drawing.Sheet, ...]:
    """Return every figure of at least one task, below the dataset's `label`, and with `titles` below what it shows."""
    with mpl.rc_context(drawing.COLUMN_STYLE):
        return (*frequencies.sheets(found, label, titles=titles), *_sheets(found, label, titles=titles))


def _sheets(found: Detections, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    tracks = [(task.task.title, one) for task in found.tasks for one in task.tracks]
    for name, section, draw, said in (
        (
            "tracks",
            "tracks",
            _track,
            "Level of each trial, dB above level 1: filled if the answer was right, open if wrong, with a ring "
            "at reversals. The line is the threshold by the rule of the levels; the band is the 95 % "
            "interval of the fitted threshold.",
        ),
        (
            "functions",
            "thresholds",
            _function,
            "Proportion correct by level, dB above level 1 (larger symbols: more trials), and the fitted psychometric "
            "function. The band is the 95 % interval of the threshold.",
        ),
    ):
        shown = [one for one in tracks if draw is _function or one[1].estimate.method not in UNTRACKED]
        for page, own in drawing.pages(shown, HEIGHT):
            figure, panels = drawing.sheet([HEIGHT] * len(own), name.capitalize() if titles else "", label)
            for axes, (title, one) in zip(panels, own, strict=True):
                draw(axes, one)
                axes.set_title(drawing.short(f"sub-{one.participant}, {one.signal}, {title}", 50))
            yield drawing.Sheet(f"{name}{page}", section, said, figure)


def _track(axes: mpl.axes.Axes, track: Track) -> None:
    x, y = np.arange(1, len(track.steps) + 1), np.array([one.x_db for one in track.steps])
    right, turned = (np.array([getattr(one, name) for one in track.steps]) for name in ("right", "reversal"))
    axes.plot(x, y, "-", color="0.7", linewidth=0.6, zorder=0)
    for good, fill in ((True, drawing.colour(0)), (False, "white")):
        axes.plot(
            x[right == good], y[right == good], "o", color=drawing.colour(0), markerfacecolor=fill, markersize=2.5
        )
    axes.plot(x[turned], y[turned], "o", color=drawing.colour(4), markerfacecolor="none", markersize=5)
    if track.estimate.db is not None:
        axes.axhline(track.estimate.db, color=drawing.colour(4), linewidth=0.8)
    if track.fit is not None and not track.beyond:
        axes.axhspan(track.fit.threshold.low, track.fit.threshold.high, color="0.9", zorder=-1)
    axes.set_xlabel("trial of the track")
    axes.set_ylabel("level (dB)")


def _function(axes: mpl.axes.Axes, track: Track) -> None:
    levels = np.array([one.x_db for one in track.by_level])
    shares = np.array([one.right / one.trials for one in track.by_level])
    sizes = np.array([one.trials for one in track.by_level])
    axes.scatter(levels, shares, s=4 + 30 * sizes / sizes.max(), color=drawing.colour(0), linewidths=0)
    if track.fit is not None:
        x = np.linspace(levels.min() - 1, levels.max() + 1, 101)
        axes.plot(x, track.fit.share(x), color=drawing.colour(4), linewidth=0.8)
        axes.set_xlim(x[0], x[-1])
    if track.fit is not None and not track.beyond:
        axes.axvspan(track.fit.threshold.low, track.fit.threshold.high, color="0.9", zorder=-1)
    axes.set_ylim(-0.05, 1.08)
    axes.set_xlabel("level (dB)")
    axes.set_ylabel("right")
