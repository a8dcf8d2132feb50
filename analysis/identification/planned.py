"""Every planned test in which participants are the unit, as its protocol plans it: with its materials, and its family.

The published analyses of variance, t against chance and the ICC stand in `results`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from palpate.analysis.documents.tables import plural
from palpate.analysis.identification.companion_tests import LINKED, MARGIN, equivalent_gaps, slopes_logit, told_apart
from palpate.analysis.identification.confusion import Confusion, shared
from palpate.analysis.reading.study import Study
from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Statements, mean_gaps
from palpate.analysis.statistics.groups import Apart, compared
from palpate.analysis.statistics.inference import holm
from palpate.analysis.statistics.participants import Order, equivalence, order_effect, repeated
from palpate.analysis.statistics.shares import Limits, difference_limits, first_limits
from palpate.analysis.statistics.sign_flips import SignFlip, sign_flip

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import PlannedTest

CHANCE, EQUIVALENCE = "sign flips against chance", "equivalence"


@dataclass(frozen=True)
class Line:
    """One P of a planned test, of a `subject` in its `tasks`: a value with its interval, or F with its df.

    `p_holm` is None without a family. No P that is planned lies below `least`; `error` is the Monte Carlo standard
    error of one that is drawn. `loose`: the smaller of two groups varies far more than the other. `shown`: the P
    that is planned lies below alpha, and against chance the value above it.
    """

    tasks: tuple[str, ...]
    subject: str
    n: int
    p: float
    value: float | None = None
    interval: Limits | None = None
    f: float | None = None
    df: tuple[int, int] | None = None
    least: float | None = None
    error: float | None = None
    loose: bool = False
    p_holm: float | None = None
    shown: bool = False


@dataclass(frozen=True)
class Planned:
    """A planned test with its lines; `statements` say why some are missing."""

    plan: PlannedTest
    lines: tuple[Line, ...]
    statements: Mapping[str, str]


Tasks = Mapping[str, Confusion]
Found = Iterator[tuple[str, Callable[[], Sequence[Line]]]]


def planned_tests(study: Study, tasks: Tasks, rng: np.random.Generator) -> tuple[Planned, ...]:
    """Return the planned tests of `TESTS`, each once, from the confusion matrices of a study's tasks."""
    return tuple(_planned(plan, study, tasks, rng) for plan in dict.fromkeys(study.plans()) if plan.test in TESTS)


def _planned(plan: PlannedTest, study: Study, tasks: Tasks, rng: np.random.Generator) -> Planned:
    said = Statements({task: "no trial" for task in plan.tasks if task not in tasks})
    lines: list[Line] = []
    if study.origin == "RECONSTRUCTION" and plan.test != CHANCE:
        said[" and ".join(plan.tasks)] = LINKED
    else:
        own = {task: tasks[task] for task in plan.tasks if task in tasks}
        parts = TESTS[plan.test](plan, study, own, rng) if own else ()
        lines = [line for name, compute in parts for line in said.compute(name, compute) or ()]
    return Planned(plan, tuple(_judged(plan, lines, len(said))), said)


def _judged(plan: PlannedTest, lines: Sequence[Line], missing: int) -> Iterator[Line]:
    """Yield the lines with P adjusted over the family of each, and with what they show; `missing` tests have P of 1."""
    adjusted = plan.correction is not None or (plan.test == EQUIVALENCE and len(plan.tasks) == 1)
    apart = plan.correction in (None, "materials")
    for place, line in enumerate(lines):
        own = [other for other, of in enumerate(lines) if of.tasks == line.tasks or not apart]
        family = [(lines[other].p, lines[other].least or 0.0) for other in own] + [(np.nan, np.nan)] * missing
        p, least = (float(one) for one in (holm(np.array(family)) if adjusted else np.array(family))[own.index(place)])
        above = plan.chance is None or (line.value or 0.0) > plan.chance
        yield replace(line, p_holm=p if adjusted else None, least=least or None, shown=above and p < plan.alpha)


def _counts(
    plan: PlannedTest, *tasks: Confusion, only: Sequence[int] = (), least: int = 2
) -> tuple[list[str], Integers, Integers]:
    """Return who did all of it, with right answers and trials, each of shape (tasks, materials, participants).

    It is of a test's materials, or `only` of those at some places. Raises `NotDefined` for too few.
    """
    if not (places := list(only) or _places(plan, *tasks)):
        raise NotDefined("they have no material in common")
    rows = [{who: row for row, who in enumerate(one.participants) if one.trials[row, places].all()} for one in tasks]
    people = [who for who in rows[0] if all(who in of for of in rows)]
    if len(people) < least:
        raise NotDefined(f"it needs {plural(least, 'participant')} with every trial it uses, got {len(people)}")
    own = [one.counts[[of[who] for who in people]][:, places] for one, of in zip(tasks, rows, strict=True)]
    right = [one[:, range(len(places)), places].T for one in own]
    return people, np.array(right), np.array([one.sum(axis=2).T for one in own])


def _places(plan: PlannedTest, *tasks: Confusion) -> list[int]:
    """Return the places of the materials that a test is of: those named, or all that its tasks present."""
    return [place for place in shared(tasks) if plan.materials is None or tasks[0].materials[place] in plan.materials]


def _against_chance(plan: PlannedTest, study: Study, tasks: Tasks, rng: np.random.Generator) -> Found:
    chance = plan.exact_chance(len(study.materials))

    def line(task: str, place: int) -> list[Line]:
        _, right, trials = _counts(plan, tasks[task], only=[place], least=1)
        right, trials = right[0, 0], trials[0, 0]
        limits = first_limits(right, trials, float(chance))
        flip = sign_flip(list(map(Fraction, right.tolist(), trials.tolist())), chance, rng)
        return [_flipped((task,), tasks[task].materials[place], flip, float((right / trials).mean()), limits)]

    for task, matrix in tasks.items():
        for place in _places(plan, matrix):
            yield f"{task}, {matrix.materials[place]}", partial(line, task, place)


def _between_tasks(plan: PlannedTest, _: Study, tasks: Tasks, rng: np.random.Generator) -> Found:
    def line(of: tuple[str, str]) -> list[Line]:
        return [_paired(of, "", *_counts(plan, tasks[of[0]], tasks[of[1]])[1:], rng)]

    yield from ((" and ".join(of), partial(line, of)) for of in combinations(tasks, 2))


def _between_materials(plan: PlannedTest, _: Study, tasks: Tasks, rng: np.random.Generator) -> Found:
    def line(task: str, pair: tuple[int, int]) -> list[Line]:
        # The materials of a pair take the place of tasks.
        right, trials = (of.swapaxes(0, 1) for of in _counts(plan, tasks[task], only=pair)[1:])
        return [_paired((task,), " less ".join(tasks[task].materials[place] for place in pair), right, trials, rng)]

    for task, matrix in tasks.items():
        for pair in combinations(_places(plan, matrix), 2):
            yield f"{task}, {' and '.join(matrix.materials[place] for place in pair)}", partial(line, task, pair)


def _paired(tasks: tuple[str, ...], subject: str, right: Integers, trials: Integers, rng: np.random.Generator) -> Line:
    gaps = mean_gaps(right, trials)
    limits = difference_limits(right.sum(axis=1), trials.sum(axis=1), np.array(gaps, dtype=np.float64))
    return _flipped(tasks, subject, sign_flip(gaps, 0, rng), float(sum(gaps, Fraction(0)) / len(gaps)), limits)


def _flipped(
    tasks: tuple[str, ...], subject: str, flip: SignFlip | Apart | Order, value: float, interval: Limits | None
) -> Line:
    return Line(tasks, subject, flip.n, flip.p, value, interval, least=flip.least, error=flip.error)


def _repeated(plan: PlannedTest, _: Study, tasks: Tasks, __: np.random.Generator) -> Found:
    def lines() -> list[Line]:
        _, right, trials = _counts(plan, *tasks.values())
        values, names = np.moveaxis(right / trials, -1, 0), ["task", "material"]
        one = len(tasks) == 1
        return [
            Line(tuple(tasks), line.effect, line.n, line.p, f=line.f, df=(line.df1, line.df2))
            for line in repeated(values[:, 0] if one else values, names[one:])
            if line.p is not None
        ]

    yield " and ".join(tasks), lines


def _logit(_: PlannedTest, __: Study, tasks: Tasks, ___: np.random.Generator) -> Found:
    def lines() -> list[Line]:
        found = slopes_logit(tasks)
        who, of = found.participants, tuple(tasks)
        return [Line(of, one.name, who, one.p, f=one.f, df=(one.df1, one.df2)) for one in found.terms]

    yield " and ".join(tasks), lines


def _equivalent(plan: PlannedTest, _: Study, tasks: Tasks, __: np.random.Generator) -> Found:
    def line(of: tuple[str, ...], subject: str, values: Floats) -> list[Line]:
        one = equivalence(values, plan.margin or MARGIN, plan.alpha)
        return [Line(of, subject, one.n, one.p, one.mean, Limits(one.low, one.high, 1 - 2 * plan.alpha))]

    def gap_lines(of: tuple[str, ...]) -> list[Line]:
        return line(of, "", equivalent_gaps(*_counts(plan, *(tasks[task] for task in of))[1:]))

    if len(plan.tasks) > 1:
        yield from ((" and ".join(of), partial(gap_lines, of)) for of in combinations(tasks, 2))
        return
    for task, matrix in tasks.items():
        places = _places(plan, matrix)
        for (a, b), values in told_apart(matrix).items():
            if {a, b} <= {*places}:
                name = f"{matrix.materials[a]} and {matrix.materials[b]}"
                yield f"{task}, {name}", partial(line, (task,), name, values)


def _order(plan: PlannedTest, study: Study, tasks: Tasks, rng: np.random.Generator) -> Found:
    def line(of: tuple[str, str]) -> list[Line]:
        people, *counts = _counts(plan, *(tasks[task] for task in of))
        gaps = list(zip(people, mean_gaps(*counts), strict=True))
        one, other = ([gap for who, gap in gaps if study.first_tasks.get(who) == name] for name in of)
        effect = order_effect(one, other, rng)
        return [_flipped(of, "", effect, effect.value, Limits(effect.low, effect.high))]

    yield from ((" and ".join(of), partial(line, of)) for of in combinations(tasks, 2))


def _groups(plan: PlannedTest, study: Study, tasks: Tasks, rng: np.random.Generator) -> Found:
    def line(task: str, pair: tuple[str, str]) -> list[Line]:
        people, right, trials = _counts(plan, tasks[task])
        told = [study.facts.get((who, plan.groups or "")) for who in people]
        one = compared(right[0], trials[0], [[group == own for own in told] for group in pair], rng)
        return [replace(_flipped((task,), " less ".join(pair), one, one.value, one.interval), loose=one.loose)]

    for task, pair in product(tasks, combinations(study.groups(plan), 2)):
        yield f"{task}, {' and '.join(pair)}", partial(line, task, pair)


TESTS: Mapping[str, Callable[[PlannedTest, Study, Tasks, np.random.Generator], Found]] = {
    CHANCE: _against_chance,
    "sign flips between tasks": _between_tasks,
    "sign flips between materials": _between_materials,
    "repeated measures": _repeated,
    "logit with participants": _logit,
    EQUIVALENCE: _equivalent,
    "order of tasks": _order,
    "difference of groups": _groups,
}
"""What computes each test, by its name in a protocol."""
