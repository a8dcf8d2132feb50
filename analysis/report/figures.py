"""Results -> every figure of an analysis, with its name, its section and its caption."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from math import ceil
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray
from scipy.special import expit, logit

from palpate.analysis.documents import drawing
from palpate.analysis.documents.tables import plural
from palpate.analysis.identification.companion_tests import Marginal
from palpate.analysis.identification.identify import Identification
from palpate.analysis.identification.results import Results, TaskResult, bracketed
from palpate.analysis.identification.time_course import MaskerLevels, OnsetErrors, SpeedBin, Window
from palpate.experiment.records.events import NO_ANSWER

FEW = 5
"""The most materials beside one another within a column of a journal; more take the width of two."""

SHARES = (0.001, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.999)
"""Ticks of an axis of log odds."""

ACROSS = 5
"""The number of participants beside one another on a page of panels."""

PANEL_LETTERS = 10
"""Letters above a participant's panel; the share stands below a label that leaves no room for it."""

DARK = 0.6
"""The text of a cell above this ratio is white."""


def correct_ratios(axes: Axes, tasks: Sequence[TaskResult]) -> None:
    """Draw the correct answer ratios of each material and task: their distribution, mean, SD and stars."""
    materials = tasks[0].confusion.materials
    width = 0.8 / len(tasks)
    for index, task in enumerate(tasks):
        _bars(axes, task, index, width, (index - (len(tasks) - 1) / 2) * width)
    drawing.name_below(
        axes,
        range(len(materials)),
        materials,
        (drawing.width_inches(axes) - 0.5) / len(materials) - drawing.LETTER_INCHES,
    )
    _ratios(axes, {task.task.id: task.chance for task in tasks}, 1.18)
    axes.set_xlim(-0.6, len(materials) - 0.4)


def confusion(axes: Axes, task: TaskResult, *, unanswered: bool) -> None:
    """Draw the mean answer ratios of one task as a heat map, with mean and SD in each cell that has room for them."""
    matrix = task.confusion
    answers = (*matrix.materials, NO_ANSWER)[: len(matrix.materials) + unanswered]
    shown_means = matrix.means()[list(matrix.presented), : len(answers)]
    axes.pcolormesh(shown_means, cmap=drawing.SHADES, vmin=0, vmax=1, edgecolors="white", linewidth=1)
    axes.invert_yaxis()
    room = (drawing.width_inches(axes) - 0.9) / len(answers)
    for row in range(len(matrix.presented)):
        for j in range(len(answers)):
            _cell(axes, task, row, j, room)
    drawing.name_below(axes, [one + 0.5 for one in range(len(answers))], answers, room)
    names = [textwrap.fill(drawing.short(matrix.materials[i], 26), 14) for i in matrix.presented]
    axes.set_yticks(np.arange(len(names)) + 0.5, names)
    axes.tick_params(length=0)
    axes.set_xlabel("answered")
    axes.set_ylabel("presented")
    axes.set_title(f"{drawing.short(task.task.title, 40)} (n = {len(matrix.participants)})")
    axes.spines[:].set_visible(False)


def participants(axes: Axes, task: TaskResult, first: int, last: int) -> None:
    """Draw the matrices of participants `first` to before `last`, presented x answered; never presented is white."""
    matrix = task.confusion
    rows, answers = list(matrix.presented), len(matrix.materials) + bool(matrix.unanswered)
    size = len(rows)
    step = (answers + 1, size + 2.2 * size / 4)
    shown = drawing.told_apart(matrix.participants, PANEL_LETTERS)
    between = ": " if max(map(len, shown)) <= PANEL_LETTERS - 5 else "\n"
    for place, index in enumerate(range(first, last)):
        x, y = place % ACROSS * step[0], place // ACROSS * step[1]
        counts, trials = matrix.counts[index, rows, :answers], matrix.trials[index, rows]
        ratios = np.where(trials[:, None] > 0, counts / np.maximum(trials, 1)[:, None], np.nan)
        edges = x + np.arange(answers + 1), y + np.arange(size + 1)
        axes.pcolormesh(*edges, ratios, cmap=drawing.SHADES, vmin=0, vmax=1, edgecolors="#c9ced6", linewidth=0.25)
        right = float(counts[range(size), rows].sum() / trials.sum())
        axes.text(x, y - 0.08 * size, f"{shown[index]}{between}{right:.2f}", ha="left", va="bottom")
    axes.set_xlim(-0.1, ACROSS * step[0] - 0.9)
    axes.set_ylim(ceil((last - first) / ACROSS) * step[1] - step[1] + size + 0.1, -0.55 * size)
    axes.set_axis_off()


def material_map(axes: Axes, one: Identification, materials: Sequence[str]) -> None:
    """Draw the materials as points, the closer the more they were taken for one another."""
    points = one.scaling.points if one.scaling else np.zeros((0, 2))
    for index, (material, point) in enumerate(zip(materials, points, strict=True)):
        # Hollow, so that of two materials in one place both are seen.
        axes.plot(
            *point, drawing.marker(index), color=drawing.colour(index), fillstyle="none", markeredgewidth=1.2,
            label=drawing.short(material, 24),
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.15)
    axes.set_xlabel("first axis")
    axes.set_ylabel(f"{one.task}: second axis")


def against_dissimilarity(axes: Axes, found: Mapping[str, Sequence[tuple[float, float]]], source: str) -> None:
    """Draw confusing ratios against dissimilarity; `found` holds the (dissimilarity, ratio) points of each series."""
    for index, (name, points) in enumerate(found.items()):
        x, y = zip(*points, strict=True)
        axes.plot(
            x, y, drawing.marker(index), color=drawing.colour(index), markersize=4, alpha=0.8, label=name, clip_on=False
        )
    said = f"dissimilarity of the spectra ({source})"
    axes.set_xlabel(textwrap.fill(said, int((drawing.width_inches(axes) - 0.6) / drawing.LETTER_INCHES)))
    axes.set_ylabel("confusing answer ratio")
    axes.set_xlim(0)
    axes.set_ylim(0)
    drawing.key(axes, columns=1)


def _bars(axes: Axes, task: TaskResult, index: int, width: float, shift: float) -> None:
    matrix = task.confusion
    hue = drawing.colour(index)
    named = False
    for test in task.tests:
        place, result = matrix.materials.index(test.material), test.result
        if result.mean is None:
            continue
        x = place + shift
        label = "" if named else f"{task.task.id} (n = {len(matrix.participants)})"
        hatch = drawing.HATCHES[index % len(drawing.HATCHES)]
        axes.bar(x, result.mean, width * 0.92, facecolor="none", edgecolor=drawing.pale(hue), hatch=hatch)
        values, often = np.unique([float(one) for one in matrix.ratios(place, place).values()], return_counts=True)
        reach = 0.42 * width * often / often.max()
        axes.hlines(values, x - reach, x + reach, color=hue, linewidth=2.5, label=label, clip_on=False, zorder=3)
        named = True
        if result.sd is not None:
            axes.errorbar(x, result.mean, yerr=result.sd, color="black", capsize=2.5, linewidth=1.0)
        top = max(1.0, *values, min(result.mean + (result.sd or 0.0), 1.1))
        axes.text(x, top + 0.01, task.stars(test), ha="center", va="bottom")


def _cell(axes: Axes, task: TaskResult, row: int, j: int, room: float) -> None:
    i = task.confusion.presented[row]
    mean, sd = task.confusion.mean(i, j), task.confusion.sd(i, j)
    whole = room >= 8 * drawing.LETTER_INCHES
    if mean is None:
        text = "not\nshown" if whole else "-"
    elif room < 4.5 * drawing.LETTER_INCHES:
        return
    else:
        stars = task.stars(task.tests[row]) if i == j and whole else ""
        text = f"{mean:.2f}{stars}" + ("" if sd is None or not whole else f"\n± {sd:.2f}")
    ink = "white" if mean is not None and mean > DARK else "black"
    axes.text(j + 0.5, row + 0.5, text, ha="center", va="center", color=ink)


NAMED = 20
"""More participants than this stand in order of their level, without labels."""

TICK_LETTERS = 12
"""Letters of a participant's label below an axis."""

BINS = 40
"""The most bins of the histogram of onset errors."""


def learning(axes: Axes, curves: Mapping[str, Sequence[Window]], chances: Mapping[str, float]) -> None:
    """Draw the share of right answers in a running window of trials, each point at the window's middle."""
    for index, (task, windows) in enumerate(curves.items()):
        hue, line = drawing.colour(index), drawing.LINES[index % len(drawing.LINES)]
        x = [(one.first + one.last) / 2 for one in windows]
        dot = "o" if len(x) == 1 else ""  # because a line through a single point is invisible
        axes.plot(x, [one.right / one.trials for one in windows], line, color=hue, label=task, marker=dot)
        known = [(place, one.interval) for place, one in zip(x, windows, strict=True) if one.interval]
        if known:
            places = [place for place, _ in known]
            lows = [0.0 if limits.low is None else limits.low for _, limits in known]
            highs = [1.0 if limits.high is None else limits.high for _, limits in known]
            axes.fill_between(places, lows, highs, color=hue, alpha=0.2, linewidth=0)
    _ratios(axes, chances)
    axes.set_xlabel("trial number (middle of window)")


def speed(axes: Axes, curves: Mapping[str, Sequence[SpeedBin]], chances: Mapping[str, float]) -> None:
    """Draw the share of right answers in bins of the foot's speed, each point at the mean speed of its steps."""
    for index, (task, bins) in enumerate(curves.items()):
        shares = np.array([one.right / one.trials for one in bins])
        lows, highs = (np.array([getattr(one.interval, end) for one in bins]) for end in ("low", "high"))
        off = np.abs([shares - lows, highs - shares])
        axes.errorbar(
            [one.mean_mm_s for one in bins],
            shares,
            yerr=off,
            color=drawing.colour(index),
            linestyle=drawing.LINES[index % len(drawing.LINES)],
            marker=drawing.marker(index),
            markersize=3.5,
            capsize=2,
            label=task,
        )
    _ratios(axes, chances)
    axes.set_xlabel("foot speed (mm/s)")


def onset_errors(axes: Axes, found: Mapping[str, OnsetErrors]) -> None:
    """Draw a histogram of measured onset minus contact, with the same bins for every task."""
    everything = np.concatenate([one.errors_ms for one in found.values()])
    edges = np.histogram_bin_edges(everything, bins=_bins(everything))
    for index, (task, one) in enumerate(found.items()):
        hue = drawing.colour(index)
        spread = "" if one.sd_ms is None else f" ± {one.sd_ms:.2f}"
        axes.hist(
            one.errors_ms,
            bins=edges.tolist(),
            histtype="stepfilled",
            facecolor="none" if index else drawing.pale(hue),
            edgecolor=hue,
            hatch=drawing.HATCHES[index % len(drawing.HATCHES)],
            linestyle=drawing.LINES[index % len(drawing.LINES)],
            label=f"{task}: {one.mean_ms:.2f}{spread} ms, {plural(len(one.errors_ms), 'trial')}",
        )
    axes.axvline(0, color="black", linestyle="--", linewidth=0.8)
    axes.set_xlabel("measured onset minus contact (ms)")
    axes.set_ylabel("trials")
    drawing.key(axes, columns=1)


def masker_levels(axes: Axes, found: Mapping[str, Sequence[MaskerLevels]]) -> None:
    """Draw the median level of every participant, with the lowest and highest of the trials."""
    order = list(dict.fromkeys(one.participant for levels in found.values() for one in levels))
    named = len(order) <= NAMED
    for index, (task, levels) in enumerate(found.items()):
        shown = levels if named else sorted(levels, key=lambda one: one.median_db_a)
        x = [order.index(one.participant) if named else rank for rank, one in enumerate(shown)]
        middle = np.array([one.median_db_a for one in shown])
        reach = np.array([[m - one.low_db_a, one.high_db_a - m] for m, one in zip(middle, shown, strict=True)]).T
        axes.errorbar(
            np.array(x) + 0.12 * (index - (len(found) - 1) / 2),
            middle,
            yerr=reach,
            fmt=drawing.marker(index),
            color=drawing.colour(index),
            markersize=3,
            linewidth=0.7,
            label=task,
        )
    if named:
        shown_as = drawing.told_apart(order, TICK_LETTERS)
        longest = max(map(len, shown_as))
        turned: Any = {"rotation": 90} if longest * len(order) > 40 else {}
        axes.set_xticks(range(len(order)), shown_as, **turned)
    axes.set_xlabel("participant" if named else "participants, in order of level")
    axes.set_ylabel("masker (dB(A))")
    drawing.key(axes)


def _bins(values: NDArray[np.float64]) -> int:
    """Return the number of bins of Freedman and Diaconis (1981), at most `BINS`: one far value asks for millions."""
    low, high = np.quantile(values, (0.25, 0.75))
    width, reach = float(2 * (high - low) / values.size ** (1 / 3)), float(np.ptp(values))
    if width:
        return ceil(min(reach / width, BINS))
    return BINS if reach else 1


def _ratios(axes: Axes, chances: Mapping[str, float], top: float = 1.02) -> None:
    for chance in sorted(set(chances.values())):
        axes.axhline(chance, color="black", linestyle="--", linewidth=0.8, label=f"chance, {chance:.3g}")
    axes.set_ylim(0, top)
    axes.set_yticks(np.linspace(0, 1, 6))
    axes.set_ylabel("correct answer ratio")
    drawing.key(axes)


PAGE = 25
"""The number of participants on a page of panels."""

PAGES = 4
"""The most pages of panels of one task."""


def sheets(results: Results, label: str, *, titles: bool = False) -> tuple[drawing.Sheet, ...]:
    """Return every figure of at least one task, below the dataset's `label`, and with `titles` below what it shows."""
    with mpl.rc_context(drawing.COLUMN_STYLE):
        return tuple(_sheets(results, label, titles=titles))


def _sheets(results: Results, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    yield from _answers(results, label, titles=titles)
    if found := results.marginal[0]:
        chances = {task.task.id: task.chance for task in results.tasks}
        yield contrast_sheet(found, list(chances), label, list(chances.values()), titles)
    yield from _course(results, label, titles=titles)


def _answers(results: Results, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    tasks = results.tasks
    count = len(tasks[0].confusion.materials)
    width = drawing.COLUMN_MM if count <= FEW else drawing.PAGE_MM
    figure, (axes,) = drawing.sheet([2.4], "Correct answers: mean ± SD" if titles else "", label, width)
    correct_ratios(axes, tasks)
    adjusted = [task.task.id for task in tasks if task.correction]
    by = f"Holm-adjusted in {' and '.join(adjusted)}" if adjusted else "not adjusted"
    said = (
        f"Correct answer ratios of each material in {_people(tasks)}. Wider lines mean more participants with that "
        "ratio. Pale bars are means; whiskers are standard deviations across participants. Dashed line: chance. *, "
        f"** and *** mark means above chance with P < 0.05, 0.01 and 0.001 (t, {by}).{bracketed(tasks)}"
    )
    yield drawing.Sheet("correct-ratios", "answers", said, figure)

    unanswered = any(task.confusion.unanswered for task in tasks)
    height = max(1.6, 0.42 * count) + 0.85 if count <= FEW else min(0.32 * count + 1.4, drawing.PAGE_INCHES)
    for page, of in drawing.pages(tasks, height):
        figure, panels = drawing.sheet(
            [height] * len(of), "Answer ratios: means across participants" if titles else "", label, width
        )
        for axes, task in zip(panels, of, strict=True):
            confusion(axes, task, unanswered=unanswered)
            if len(tasks) == 1 and not titles:
                axes.set_title("")
        said = (
            f"Mean answer ratios in {_people(of)}, from 0 (white) to 1 (dark), ± the standard deviation across "
            "participants where it fits."
        )
        yield drawing.Sheet(f"confusion{page}", "confusion", said, figure)

    for task, one in zip(tasks, results.identifications, strict=True):
        if "joined" not in one.statements:
            yield from _participants(task, label, titles=titles)
    yield from _similarity(results, label, titles=titles)


def _similarity(results: Results, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    tasks = results.tasks
    found = [one for one in zip(tasks, results.identifications, strict=True) if one[1].scaling]
    for page, mapped in drawing.pages(found, MAP_INCHES):
        title = "Map of the materials, from their confusions" if titles else ""
        figure, panels = drawing.sheet([MAP_INCHES] * len(mapped), title, label)
        for axes, (_, one) in zip(panels, mapped, strict=True):
            material_map(axes, one, tasks[0].confusion.materials)
        names = [drawing.short(material, 24) for material in tasks[0].confusion.materials]
        named = [drawing.name_beside(figure, axes, names) for axes in panels]
        if not all(named):
            drawing.key(panels[0])
        said = (
            f"Map of the materials in {_people([task for task, _ in mapped])}: the closer two are, the more often they "
            "were confused (classical scaling). The map has no error bars."
        )
        yield drawing.Sheet(f"map{page}", "confusions", said, figure)

    if confusing := _confusing(results):
        figure, (axes,) = drawing.sheet([2.5], "Confusions and dissimilarity of spectra" if titles else "", label)
        against_dissimilarity(axes, confusing, results.dissimilarities.source)
        said = (
            f"Mean confusion ratios in {_people(tasks)} against the dissimilarity of the spectra, with one point for "
            "each ordered pair of materials, and Mantel's r and P. There are no error bars."
        )
        yield drawing.Sheet("dissimilarity", "confusions", said, figure)


MAP_INCHES = 2.6
"""The height of a map of the materials."""


def _people(tasks: Sequence[TaskResult]) -> str:
    """Return the titles of tasks, each with its number of participants."""
    return " and ".join(f"{task.task.title} (n = {len(task.confusion.participants)})" for task in tasks)


def _participants(task: TaskResult, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    people, count = len(task.confusion.participants), len(task.confusion.presented)
    shown = min(people, PAGES * PAGE)
    for page, first in enumerate(range(0, shown, PAGE), start=1):
        last = min(first + PAGE, shown)
        title = f"{task.task.id}: participants {first + 1} to {last} of {people}, and their proportion correct"
        figure, (axes,) = drawing.sheet([0.3 + 0.75 * ceil((last - first) / ACROSS)], title * titles, label)
        participants(axes, task, first, last)
        said = (
            f"Answer ratios of participants {first + 1} to {last} (n = {people}) in {task.task.title}: darker means "
            f"more often. Rows are the {count} materials presented and columns are the answers, both in the order of "
            "the tables; the proportion correct is above."
        )
        if shown < people:
            said += f" The first {shown} of {people} participants are drawn; counts.csv has all of them."
        name = f"participants-{task.task.id}" + (f"-{page}" if page > 1 else "")
        yield drawing.Sheet(name, "confusion", said, figure)


def _confusing(results: Results) -> dict[str, list[tuple[float, float]]]:
    """Return every confusing ratio with the dissimilarity of its materials, for tasks with a Mantel test."""
    found = {}
    for task, one in zip(results.tasks, results.identifications, strict=True):
        if one.mantel is None:
            continue
        means, names = task.confusion.means(), task.confusion.materials
        alike = results.dissimilarities.pairs
        found[f"{one.task}: Mantel r = {one.mantel.r:.2f}, P = {one.mantel.p_two:.3f}"] = [
            (alike[frozenset((a, b))], float(means[i, j]))
            for i, a in enumerate(names)
            for j, b in enumerate(names)
            if i != j
        ]
    return found


def contrast_sheet(
    found: Marginal, tasks: Sequence[str], label: str, chances: Sequence[float], titles: bool
) -> drawing.Sheet:
    """Return the figure of marginal means; `label` stands above it, and its own title if there are to be `titles`."""
    materials = list(dict.fromkeys(one.material for one in found.means))
    width = drawing.COLUMN_MM if len(materials) <= FEW else drawing.PAGE_MM
    figure, (axes,) = drawing.sheet([2.4], "Marginal means of proportion correct" if titles else "", label, width)
    for index, task in enumerate(tasks):
        of = [one for one in found.means if one.task == task]
        places = [materials.index(one.material) + 0.16 * (index - (len(tasks) - 1) / 2) for one in of]
        odds = np.array([one.log_odds for one in of])
        reach = np.array([[one.log_odds - one.low, one.high - one.log_odds] for one in of]).reshape(-1, 2).T
        axes.errorbar(
            places,
            odds,
            yerr=reach,
            fmt=drawing.marker(index),
            color=drawing.colour(index),
            capsize=2.5,
            markersize=4,
            label=task,
        )
    for chance in sorted(set(chances)):
        axes.axhline(float(logit(chance)), color="black", linestyle="--", linewidth=0.8)
    low, high = axes.get_ylim()
    axes.set_yticks([value for share in SHARES if low <= (value := float(logit(share))) <= high])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{expit(value):.3g}"))
    axes.set_ylim(low, high)
    axes.set_ylabel("proportion correct (logit scale)")
    drawing.name_below(axes, range(len(materials)), materials, (drawing.width_inches(axes) - 0.6) / len(materials))
    axes.set_xlim(-0.5, len(materials) - 0.5)
    drawing.key(axes)
    said = (
        f"Marginal means of proportion correct for a typical participant (n = {found.participants}), on the logit "
        "scale, with 95 % intervals. Dashed: chance. Two materials or tasks can differ even if their intervals "
        "overlap; the tables in this section test the differences."
    )
    return drawing.Sheet("marginal-means", "contrasts", said, figure)


def _course(results: Results, label: str, *, titles: bool) -> Iterator[drawing.Sheet]:
    found = results.course
    chances = {task.task.id: task.chance for task in results.tasks}
    if found.learning:
        window = max(one.last - one.first + 1 for windows in found.learning.values() for one in windows)
        figure, (axes,) = drawing.sheet(
            [2.3], f"Proportion correct, {plural(window, 'trial')} at a time" if titles else "", label
        )
        learning(axes, found.learning, chances)
        of = plural(window, "successive trial")
        said = (
            f"Proportion correct in {of}, all participants together ({_people(results.tasks)}). Bands are 95 % "
            "intervals across participants, and the dashed line is chance."
        )
        yield drawing.Sheet("learning", "course", said, figure)
    if found.speed:
        figure, (axes,) = drawing.sheet([2.3], "Proportion correct by foot speed" if titles else "", label)
        speed(axes, found.speed, chances)
        said = (
            f"Proportion correct by foot speed, all participants together ({_people(results.tasks)}"
            "). Whiskers are Wilson's 95 % intervals, which treat trials as independent, and the dashed line is chance."
        )
        yield drawing.Sheet("speed", "course", said, figure)
    if found.onsets:
        figure, (axes,) = drawing.sheet([2.3], "Stimulus onset, measured at the panel" if titles else "", label)
        onset_errors(axes, found.onsets)
        trials = " and ".join(f"{task} ({plural(len(one.errors_ms), 'trial')})" for task, one in found.onsets.items())
        said = f"Measured stimulus onset minus foot contact in {trials}; the key shows means ± SD across trials."
        yield drawing.Sheet("onset-errors", "course", said, figure)
    if found.masker:
        figure, (axes,) = drawing.sheet([2.3], "Masker level of each participant" if titles else "", label)
        masker_levels(axes, found.masker)
        people = " and ".join(f"{task} (n = {len(levels)})" for task, levels in found.masker.items())
        said = (
            f"Masker level in {people}: the median of each participant's trials; whiskers show the lowest and highest."
        )
        yield drawing.Sheet("masker", "course", said, figure)
