"""Results -> every figure of an analysis, with its name, the section in which it stands, and what it shows."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

import matplotlib as mpl

from analysis import answer_figures as answers
from analysis import trial_figures as trials
from analysis.figures import COLUMN_MM, COLUMN_STYLE, PAGE_MM, Sheet, key, sheet
from analysis.results import Results, TaskResult
from analysis.words import number_of

FEW = 5
"""Materials that stand beside one another within a column of a journal; more take the width of two."""

PAGE = 25
"""Participants on a page of panels."""

PAGES = 4
"""Most pages of panels of one task."""

ELSEWHERE = "The numbers stand in the tables here."


def sheets(results: Results, label: str) -> tuple[Sheet, ...]:
    """Every figure there are numbers for.

    Args:
        results: at least one task.
        label: of the dataset; empty for a study's own data.
    """
    with mpl.rc_context(COLUMN_STYLE):
        return (*_answers(results, label), *_course(results, label))


def _answers(results: Results, label: str) -> Iterator[Sheet]:
    tasks = results.tasks
    count = len(tasks[0].confusion.materials)
    width = COLUMN_MM if count <= FEW else PAGE_MM
    figure, (axes,) = sheet([2.4], "Correct answers: mean ± SD", label, width)
    answers.correct_ratios(axes, tasks)
    said = "Correct answer ratios per material and task (as Fig. 11 of Okamoto et al.). Bars: mean; whiskers: standard "
    said += f"deviation among participants; dots: participants, where there are at most {answers.DOTS}; stars: above "
    said += "chance."
    yield Sheet("correct-ratios", "tests", f"{said} {ELSEWHERE}", figure)

    unanswered = any(task.confusion.unanswered for task in tasks)
    height = max(1.6, 0.42 * count) + 0.85 if count <= FEW else 0.32 * count + 1.4
    figure, panels = sheet([height] * len(tasks), "Answer ratios: means among participants", label, width)
    for axes, task in zip(panels, tasks, strict=True):
        answers.confusion(axes, task, unanswered=unanswered)
    said = (
        "Mean answer ratios as heat maps, from 0 (white) to 1 (dark), with the standard deviation where there is room."
    )
    yield Sheet("confusion", "confusion", f"{said} {ELSEWHERE}", figure)

    for task in tasks:
        yield from _participants(task, label)

    found = [one for one in results.identifications if one.scaling]
    if found:
        figure, panels = sheet([2.6] * len(found), "Map of the materials, from their confusions", label)
        for axes, one in zip(panels, found, strict=True):
            answers.material_map(axes, one, tasks[0].confusion.materials)
        key(panels[0])
        said = "Materials as points: the closer two are, the more they were taken for one another."
        yield Sheet("map", "confusions", f"{said} Classical scaling of their confusions.", figure)

    if confusing := _confusing(results):
        figure, (axes,) = sheet([2.5], "Confusing answers and dissimilarity of spectra", label)
        answers.against_dissimilarity(axes, confusing, results.dissimilarities.source)
        said = "Confusing answer ratios against the dissimilarity of spectra (as Fig. 13 of Okamoto et al.)."
        yield Sheet("dissimilarity", "confusions", said, figure)


def _participants(task: TaskResult, label: str) -> Iterator[Sheet]:
    people, count = len(task.confusion.participants), len(task.confusion.materials)
    shown = min(people, PAGES * PAGE)
    for page, first in enumerate(range(0, shown, PAGE), start=1):
        last = min(first + PAGE, shown)
        title = f"{task.task.id}: participants {first + 1} to {last} of {people}, and their share of right answers"
        figure, (axes,) = sheet([0.3 + 0.75 * ceil((last - first) / answers.ACROSS)], title, label)
        answers.participants(axes, task, first, last)
        said = f"{task.task.title}: answer ratios of each participant, the darker the more often. Rows: the {count} "
        said += "materials presented, columns: the answers, both in the order of the tables; above, the share right."
        if shown < people:
            said += f" The first {shown} of {people} participants are drawn; all stand in counts.csv."
        name = f"participants-{task.task.id}" + (f"-{page}" if page > 1 else "")
        yield Sheet(name, "confusion", said, figure)


def _confusing(results: Results) -> dict[str, list[tuple[float, float]]]:
    """Every confusing ratio with the dissimilarity of its materials, of the tasks that have a Mantel test."""
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


def _course(results: Results, label: str) -> Iterator[Sheet]:
    found = results.course
    chances = {task.task.id: task.chance for task in results.tasks}
    if found.learning:
        window = max(one.last - one.first + 1 for windows in found.learning.values() for one in windows)
        figure, (axes,) = sheet([2.3], f"Right answers, {number_of(window, 'trial')} at a time", label)
        trials.learning(axes, found.learning, chances)
        said = f"Share of right answers in {number_of(window, 'successive trial')}; bands: 95 % BCa intervals over "
        said += "participants."
        yield Sheet("learning", "course", said, figure)
    if found.speed:
        figure, (axes,) = sheet([2.3], "Right answers by the speed of the foot", label)
        trials.speed(axes, found.speed, chances)
        said = "Share of right answers by the speed of the foot; whiskers: Wilson's 95 % intervals over trials."
        yield Sheet("speed", "course", said, figure)
    if found.onsets:
        figure, (axes,) = sheet([2.3], "Onset of the stimulus, measured at the panel", label)
        trials.onset_errors(axes, found.onsets)
        yield Sheet("onset-errors", "course", "Measured onset of the stimulus minus contact of the foot.", figure)
    if found.masker:
        figure, (axes,) = sheet([2.3], "Masker of each participant", label)
        trials.masker_levels(axes, found.masker)
        said = "Level of the masker: median of a participant's trials; whiskers: lowest and highest."
        yield Sheet("masker", "course", said, figure)
