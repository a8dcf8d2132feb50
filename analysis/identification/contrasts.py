"""Ours: differences of right answers between materials and between tasks, and equivalence within a margin.

Each cell has its own log odds in a logit in which participants differ in level, by material, task and cell: with a
random intercept alone a quarter of studies err, and GEE lacks degrees of freedom. Means and contrasts: Searle, Speed
and Milliken (1980, Am. Stat. 34, 216-221). Equivalence has tests of its own, of tasks, and of pairs of materials.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import stdtr, stdtrit

from palpate.analysis.identification.beside import LEAST, LINKED, right_answers
from palpate.analysis.identification.confusion import Confusion, shared
from palpate.analysis.reading.study import Study
from palpate.analysis.statistics import mixed_logit
from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.inference import CONFIDENCE, holm
from palpate.analysis.statistics.participants import Equivalence, equivalence


@dataclass(frozen=True)
class Mean:
    """The log odds of a right answer to a material in a task, of a participant in the middle, with their limits."""

    task: str
    material: str
    log_odds: float
    error: float
    low: float
    high: float


@dataclass(frozen=True)
class Contrast:
    """Log odds of `first` less those of `second`, two materials or two tasks, `within` the task or material named.

    t has n - 1 df for each step, as Wald's F in `beside`; `p_holm` is over the pairs of one task, or all pairs of
    tasks.
    """

    within: str
    first: str
    second: str
    log_odds: float
    error: float
    t: float
    df: int
    p: float
    p_holm: float
    low: float
    high: float


@dataclass(frozen=True)
class Marginal:
    """Means and contrasts of so many participants, SDs of log odds, and cells `left_out`, all right or all wrong."""

    participants: int
    means: tuple[Mean, ...]
    materials: tuple[Contrast, ...]
    tasks: tuple[Contrast, ...]
    sds: Mapping[str, float]
    left_out: tuple[tuple[str, str], ...]


_Pair = tuple[str, str, str, int, int, int]
"""What a pair is within, its two names, the places of their cells, and its df."""


def marginal(study: Study, tasks: Mapping[str, Confusion]) -> Marginal:
    """Return means and contrasts of a study from the confusion matrices of its tasks.

    Raises `NotDefined` for a reconstruction, too few participants or cells with odds, and without a fit.
    """
    if study.origin == "RECONSTRUCTION":
        raise NotDefined(LINKED)
    people, right, trials = right_answers(tasks)
    if len(people) < LEAST:
        raise NotDefined(f"it needs {LEAST} participants, got {len(people)}")
    materials = next(iter(tasks.values())).materials
    hits, total = right.sum(axis=0), trials.sum(axis=0)
    cells = [(i, k) for i, matrix in enumerate(tasks.values()) for k in matrix.presented]
    kept = [cell for cell in cells if 0 < hits[cell] < total[cell]]
    if len(kept) < 2:
        raise NotDefined(f"it needs two cells with right and wrong answers, got {len(kept)}")
    named = [(list(tasks)[i], materials[k]) for i, k in cells]
    layout, deviations = _layout(kept)
    counts = [np.stack([of[:, i, k] for i, k in kept], axis=1) for of in (right, trials)]
    found = mixed_logit.fit(counts[0], counts[1], layout)
    df = len(people) - 1
    reach = _reach(df)
    places = {named[cells.index(cell)]: place for place, cell in enumerate(kept)}
    errors = np.sqrt(np.diag(found.covariance)).tolist()
    means = tuple(
        Mean(task, material, odds, error, odds - reach * error, odds + reach * error)
        for (task, material), odds, error in zip(places, found.coefficients.tolist(), errors, strict=True)
    )
    by_task, by_material = _pairs(tasks, places, df)
    return Marginal(
        len(people),
        means,
        tuple(one for family in by_task for one in _family(family, found)),
        tuple(_family(by_material, found)),
        dict(zip(deviations, found.sds.tolist(), strict=True)),
        tuple(name for name, cell in zip(named, cells, strict=True) if cell not in kept),
    )


def _pairs(
    tasks: Mapping[str, Confusion], places: Mapping[tuple[str, str], int], df: int
) -> tuple[list[list[_Pair]], list[_Pair]]:
    """Return the pairs of materials in each task, and those of tasks over all materials; `df` are of one step."""
    materials = next(iter(tasks.values())).materials
    by_task = [
        [(task, a, b, places[task, a], places[task, b], (len(matrix.presented) - 1) * df)
         for a, b in combinations(materials, 2) if {(task, a), (task, b)} <= places.keys()]
        for task, matrix in tasks.items()
    ]  # fmt: skip
    by_material = [
        (material, a, b, places[a, material], places[b, material],
         (sum(k in matrix.presented for matrix in tasks.values()) - 1) * df)
        for k, material in enumerate(materials)
        for a, b in combinations(tasks, 2)
        if {(a, material), (b, material)} <= places.keys()
    ]  # fmt: skip
    return by_task, by_material


def _layout(cells: Sequence[tuple[int, int]]) -> tuple[mixed_logit.Layout, list[str]]:
    """Return a fixed effect of each cell, task and material, and random ones, by name, of which no two are the same."""
    own: Floats = np.eye(len(cells))
    random, names = [np.ones((len(cells), 1))], ["participant"]
    for place, what in ((0, "participant by task"), (1, "participant by material")):
        levels = [cell[place] for cell in cells]
        if 1 < len(set(levels)) < len(cells):
            random.append(np.equal.outer(levels, np.unique(levels)).astype(np.float64))
            names.append(what)
    several = len({task for task, _ in cells}) > 1
    return mixed_logit.Layout(own, (*random, own)), [*names, f"participant by {'cell' if several else 'material'}"]


def _reach(df: int) -> float:
    return float(stdtrit(df, (1 + CONFIDENCE) / 2))


def _family(pairs: Sequence[_Pair], found: mixed_logit.MixedLogit) -> list[Contrast]:
    """Return the contrasts of cells, by their places and with their df, with P adjusted over all of them."""
    lines = []
    for within, first, second, a, b, df in pairs:
        gap = float(found.coefficients[a] - found.coefficients[b])
        spread = found.covariance
        error = float(np.sqrt(spread[a, a] + spread[b, b] - 2 * spread[a, b]))
        lines.append((within, first, second, gap, error, df, _reach(df), 2 * float(stdtr(df, -abs(gap / error)))))
    adjusted = holm(np.array([p for *_, p in lines])).tolist()
    return [
        Contrast(within, first, second, gap, error, gap / error, df, p, q, gap - reach * error, gap + reach * error)
        for (within, first, second, gap, error, df, reach, p), q in zip(lines, adjusted, strict=True)
    ]


@dataclass(frozen=True)
class Equivalent:
    """An equivalence test of `subject` in one task or between two; `planned` if a protocol names its margin."""

    tasks: tuple[str, ...]
    subject: str
    planned: bool
    result: Equivalence
    p_holm: float


@dataclass(frozen=True)
class Equivalences:
    """The tests of tasks, first less second, and of pairs of materials; `statements` say why some are missing."""

    tasks: tuple[Equivalent, ...]
    pairs: tuple[Equivalent, ...]
    statements: tuple[str, ...]


MARGIN = 0.1
"""Ours: one answer in ten, the margin of what no protocol plans."""

ALL, SHARED = "all materials", "materials of both tasks"


def equivalences(study: Study, tasks: Mapping[str, Confusion]) -> Equivalences:
    """Return the equivalence tests of a study from the confusion matrices of its tasks."""
    if study.origin == "RECONSTRUCTION":
        return Equivalences((), (), (f"there are no equivalence tests: {LINKED}",))
    names = next(iter(tasks.values())).materials
    said: list[str] = []

    def tested(of: tuple[str, ...], values: Sequence[tuple[str, Floats]]) -> list[Equivalent]:
        planned = margin(study, of)
        found = []
        for subject, each in values:
            try:
                found.append((subject, equivalence(each, planned or MARGIN)))
            except NotDefined as reason:
                said.append(f"equivalence of {subject} in {' and '.join(of)} is not defined: {reason}")
        adjusted = holm(np.array([one.p for _, one in found])).tolist()
        return [
            Equivalent(of, subject, planned is not None, one, p)
            for (subject, one), p in zip(found, adjusted, strict=True)
        ]

    between: list[Equivalent] = []
    for of in combinations(tasks, 2):
        _, right, trials = right_answers({task: tasks[task] for task in of})
        places = shared(tasks[task] for task in of)
        if not places:
            said.append(f"equivalence of {' and '.join(of)} is not defined: they present no material both")
            continue
        right, trials = right[:, :, places], trials[:, :, places]
        both = (trials > 0).all(axis=(1, 2))
        gaps = np.subtract(*np.moveaxis(right[both] / trials[both], 1, 0))
        between += tested(of, [(ALL if len(places) == len(names) else SHARED, gaps.mean(axis=1))])
        between += tested(of, list(zip((names[place] for place in places), gaps.T, strict=True)))
    pairs: list[Equivalent] = []
    for task, matrix in tasks.items():
        every = matrix.trials[:, matrix.presented].all(axis=1)
        ratios = matrix.counts[every, :, :-1] / np.maximum(matrix.trials[every], 1)[:, :, None]
        apart = [
            (f"{names[a]} and {names[b]}",
             (ratios[:, a, a] - ratios[:, b, a] + ratios[:, b, b] - ratios[:, a, b]) / 2)
            for a, b in combinations(matrix.presented, 2)
        ]  # fmt: skip
        pairs += tested((task,), apart)
    return Equivalences(tuple(between), tuple(pairs), tuple(said))


def margin(study: Study, tasks: tuple[str, ...]) -> float | None:
    """Return the margin within which a protocol plans to take these as equivalent: one task's pairs, or two tasks."""
    for plan in study.plans():
        if plan.test == "equivalence" and (plan.tasks == tasks or (len(tasks) > 1 and {*tasks} <= {*plan.tasks})):
            return plan.margin
    return None
