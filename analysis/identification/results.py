"""Study -> every number of the analysis: matrices, tests against chance, analyses of variance and reliabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np

from palpate.analysis.documents.tables import plural
from palpate.analysis.forked import forked
from palpate.analysis.identification.companion_tests import (
    LINKED,
    Beside,
    Equivalences,
    Marginal,
    equivalences,
    marginal,
    run_companions,
)
from palpate.analysis.identification.confusion import Confusion, confusion_of, in_every, shared
from palpate.analysis.identification.identify import Identification, identify, without_joining
from palpate.analysis.identification.planned import Planned, planned_tests
from palpate.analysis.identification.time_course import TimeCourse, course_of
from palpate.analysis.identification.trial_models import TrialLevel, trial_level
from palpate.analysis.reading.dataset import COMPUTING, Say, silent
from palpate.analysis.reading.dissimilarities import NO_DISSIMILARITIES, Dissimilarities
from palpate.analysis.reading.study import Study, Task, chance, correction
from palpate.analysis.statistics import anova as anovas
from palpate.analysis.statistics import inference
from palpate.analysis.statistics.exact import defined
from palpate.analysis.statistics.icc import Icc, icc
from palpate.analysis.statistics.shares import Limits, first_limits
from palpate.analysis.statistics.sign_flips import SignFlip, sign_flip
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    import pandas as pd

TASK, MATERIAL = "task", "material"

EVERY = "materials and tasks"
"""The family, as a protocol names it, of the tests of all materials in all tasks."""

SEED = 1
"""The seed of every draw; the draws of one task do not depend on the other tasks."""

STEPS = 5
"""Of a computation: tests of materials, what confusions say, what stands beside, contrasts, and models of trials."""

FLIPS, PLANNED = 1, 2
"""What sets the draws of sign flips, and of planned tests, apart from the other draws of a task."""


@dataclass(frozen=True)
class MaterialTest:
    """Correct answers to one material against chance; stars follow the protocol's P, Holm's in the `family`.

    `interval` is that of the mean to be shown first, None where nobody has a trial.
    `flip_least` is P of sign flips, adjusted where the stars' P is, if everybody who differs from chance did so alike.
    """

    material: str
    result: inference.TTest
    p_holm: float | None
    d: inference.EffectSize | None
    log_bf10: float | None
    flip: SignFlip | None
    flip_holm: float | None
    flip_least: float | None
    interval: Limits | None
    stars: str


@dataclass(frozen=True)
class PairTest:
    """One-way ANOVA of the ratios of two materials: right, right, first as second, second as first; or why not."""

    task: str
    pair: tuple[str, str]
    chosen: str
    anova: anovas.Anova | None
    statement: str


@dataclass(frozen=True)
class Reliability:
    """Every ICC form for one matrix, or why there is none, and participants `dropped` for lack of a cell."""

    matrix: str
    task: str | None
    icc: Icc | None
    statement: str
    dropped: tuple[str, ...]


@dataclass(frozen=True)
class ComponentReliability:
    """Variance-component ICC of the mean of k participants, and its limits, None without F, for each sensible k."""

    components: anovas.VarianceComponents
    by_k: tuple[tuple[int, str, float | None], ...]
    intervals: tuple[inference.EffectSize | None, ...]


@dataclass(frozen=True)
class TaskResult:
    """What one task gives; `correction` is the family over which the protocol adjusts the P that the stars follow."""

    task: Task
    chance: float
    confusion: Confusion
    tests: tuple[MaterialTest, ...]
    correction: str | None

    def test(self, material: str) -> MaterialTest:
        """Return the test of one material; `KeyError` if there is none."""
        return {test.material: test for test in self.tests}[material]

    def flip(self, test: MaterialTest) -> float | None:
        """Return P of sign flips, adjusted where the P that the stars follow is."""
        return test.flip_holm if self.correction else test.flip.p if test.flip else None

    def shows_above(self, test: MaterialTest, p: float | None, level: float) -> bool:
        """Return whether `p`, one of those of a test, shows that its mean lies above chance."""
        return p is not None and p < level and test.result.mean is not None and test.result.mean > self.chance

    def stars(self, test: MaterialTest) -> str:
        """Return the stars of a test, in brackets where sign flips, which hold, do not show what they mark."""
        p = self.flip(test)
        return f"({test.stars})" if test.stars and p is not None and p >= inference.STARS[-1][0] else test.stars


def bracketed(tasks: Sequence[TaskResult]) -> str:
    """Return what brackets around stars say, where any of the tasks has them."""
    found = any(task.stars(test) != test.stars for task in tasks for test in task.tests)
    return " Exact sign-flip tests do not confirm the stars in brackets." if found else ""


@dataclass(frozen=True)
class Results:
    """The results of a study; a statement says why something is not defined, beside `marginal` why it is None."""

    tasks: tuple[TaskResult, ...]
    identifications: tuple[Identification, ...]
    dissimilarities: Dissimilarities
    pairs: tuple[PairTest, ...]
    two_way: tuple[anovas.Anova, ...]
    two_way_statement: str
    components: ComponentReliability | None
    reliabilities: tuple[Reliability, ...]
    beside: Beside
    marginal: tuple[Marginal | None, str]
    equivalences: Equivalences
    planned: tuple[Planned, ...]
    trials: TrialLevel
    course: TimeCourse

    def __repr__(self) -> str:
        return f"<Results: {'; '.join(map(_right, self.tasks))}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each task, presented and answered material, categories in the order of the tables.

        `mean` and `sd` (n - 1) are those of the `participants`' ratios; of right answers `t` (df = participants - 1), P
        of the two-tailed test against `chance`, and Holm's within the task; NaN where not defined."""
        import pandas as pd

        frame = pd.DataFrame([
            {"task": task.task.id, "presented": test.material, "answered": answered,
             "participants": task.confusion.n(i), "mean": task.confusion.mean(i, j), "sd": task.confusion.sd(i, j),
             "chance": task.chance, **(_t(test) if i == j else {})}
            for task in self.tasks
            for i, test in zip(task.confusion.presented, task.tests, strict=True)
            for j, answered in enumerate((*task.confusion.materials, NO_ANSWER))
        ])  # fmt: skip
        named = pd.CategoricalDtype(list(frame["answered"].unique()))
        frame = frame.astype({"presented": named, "answered": named})
        return frame.astype(dict.fromkeys(("mean", "sd", "chance", "t", "p", "p_holm"), "float64"))

    def task(self, task: str) -> TaskResult | None:
        """Return the result of one task, or None if the dataset has no such task."""
        return next((result for result in self.tasks if result.task.id == task), None)


def compute(
    study: Study,
    pairs: Mapping[str, tuple[str, str]],
    dissimilarities: Dissimilarities = NO_DISSIMILARITIES,
    *,
    say: Say = silent,
) -> Results:
    """Return every result of a study; `pairs` are those published for a task, beside which the most confused is tested.

    Confusions are compared with `dissimilarities` where no pair is missing; `say` gets progress.
    """
    table = dissimilarities.table(study.materials)
    tasks = _tasks(study)
    say(COMPUTING, 1, STEPS)
    data, statement = _crossed(tasks)
    matrices = {task.task.id: task.confusion for task in tasks}

    # These take half of the time.
    with forked(partial(trial_level, study)) as modelled:
        identifications = tuple(
            identify(task.task.id, task.confusion, table, np.random.default_rng([SEED, place]))
            for place, task in enumerate(tasks)
        )
        if study.origin == "RECONSTRUCTION":
            identifications = tuple(map(without_joining, identifications))
        say(COMPUTING, 2, STEPS)
        beside_these = run_companions(study, matrices, np.random.default_rng([SEED, len(tasks), FLIPS]))
        say(COMPUTING, 3, STEPS)
        contrasts, course = defined(partial(marginal, study, matrices)), course_of(study)
        say(COMPUTING, 4, STEPS)
        trials = modelled()
    return Results(
        tasks=tasks, identifications=identifications, dissimilarities=dissimilarities,
        pairs=tuple(test for task in tasks for test in _pairs(task, pairs.get(task.task.id), study)),
        two_way=tuple(anovas.two_way(data, kind) for kind in anovas.TYPES) if data else (),
        two_way_statement=statement, components=_components(data, tasks) if data else None,
        reliabilities=tuple(_reliabilities(study, tasks)), beside=beside_these, marginal=contrasts,
        equivalences=equivalences(study, matrices),
        planned=planned_tests(study, matrices, np.random.default_rng([SEED, len(tasks), PLANNED])),
        trials=trials, course=course,
    )  # fmt: skip


def _t(test: MaterialTest) -> dict[str, float | None]:
    return {"t": test.result.t, "p": test.result.p, "p_holm": test.p_holm}


def _right(task: TaskResult) -> str:
    means = [f"{test.material} {test.result.mean:.2f}" for test in task.tests if test.result.mean is not None]
    return f"{task.task.id}, right by {len(task.confusion.participants)}: {', '.join(means)}, chance {task.chance:.2f}"


def _tasks(study: Study) -> tuple[TaskResult, ...]:
    tasks = [task for task in study.tasks if len(study.trials(task.id))]
    found = [(confusion_of(study, task.id), chance(study, task.id)) for task in tasks]
    tests = [[inference.t_against_chance(each, guessed) for each in _correct(matrix)] for matrix, guessed in found]
    flips = [_flips(*one, np.random.default_rng([SEED, place, FLIPS])) for place, one in enumerate(found)]
    limits = [[_first(matrix, place, float(guessed)) for place in matrix.presented] for matrix, guessed in found]
    corrections = [correction(study, task.id) for task in tasks]
    columns = (
        _adjusted([[test.p for test in of] for of in tests], corrections),
        _adjusted([[flip.p if flip else None for flip in of] for of in flips], corrections),
        _adjusted([[flip.least if flip else None for flip in of] for of in flips], corrections),
    )
    return tuple(
        TaskResult(task, float(guessed), matrix, tuple(map(_test, task.presented, *rows, repeat(family))), family)
        for task, (matrix, guessed), family, *rows in zip(
            tasks, found, corrections, tests, flips, *columns, limits, strict=True
        )
    )


def _first(matrix: Confusion, place: int, chance: float) -> Limits | None:
    return defined(partial(first_limits, matrix.counts[:, place, place], matrix.trials[:, place], chance))[0]


def _flips(matrix: Confusion, guessed: Fraction, rng: np.random.Generator) -> list[SignFlip | None]:
    return [sign_flip(each, guessed, rng) if each else None for each in _correct(matrix)]


def _test(
    material: str,
    test: inference.TTest,
    flip: SignFlip | None,
    p_holm: float | None,
    flip_holm: float | None,
    least_holm: float | None,
    interval: Limits | None,
    family: str | None,
) -> MaterialTest:
    return MaterialTest(
        material,
        test,
        p_holm,
        None if test.t is None else inference.cohens_d(test.t, test.df),
        None if test.t is None else inference.log_bayes_factor(test.t, test.n),
        flip,
        flip_holm,
        least_holm if family or not flip else flip.least,
        interval,
        test.stars if family is None else replace(test, p=p_holm).stars,
    )


def _correct(matrix: Confusion, people: Sequence[str] | None = None) -> list[list[Fraction]]:
    """Return the ratios of correct answers to each material presented: of these people, or of all to whom it was."""
    each = [matrix.ratios(i, i) for i in matrix.presented]
    return [[ratios[label] for label in (ratios if people is None else people)] for ratios in each]


def _adjusted(p: Sequence[Sequence[float | None]], families: Sequence[str | None]) -> list[list[float | None]]:
    """Return P adjusted by Holm's method: within each task, or over all tasks whose family are `EVERY` materials."""
    apart = [[k] for k, family in enumerate(families) if family != EVERY]
    together = [k for k, family in enumerate(families) if family == EVERY]
    found: list[list[float | None]] = [[] for _ in p]
    for family in (*apart, together):
        rows = [(k, value) for k in family for value in p[k]]
        adjusted = inference.holm(np.array([np.nan if value is None else value for _, value in rows])).tolist()
        for (k, value), one in zip(rows, adjusted, strict=True):
            found[k].append(None if value is None else one)
    return found


def _pairs(task: TaskResult, published: tuple[str, str] | None, study: Study) -> list[PairTest]:
    matrix = task.confusion
    planned = [tuple(plan.materials) for plan in study.plans() if plan.materials and task.task.id in plan.tasks]
    reasons = [("published", published), *(("planned", pair) for pair in planned)]
    wanted: dict[frozenset[str], tuple[tuple[str, ...], list[str]]] = {}
    most = matrix.most_confused()
    for reason, pair in (*reasons, ("most confused", most[0] if len(most) == 1 else None)):
        if pair and set(pair) <= set(task.task.presented):
            wanted.setdefault(frozenset(pair), (pair, []))[1].append(reason)
    tests = []
    for (one, other), chosen in wanted.values():
        first, second = matrix.materials.index(one), matrix.materials.index(other)
        places = ((first, first), (second, second), (first, second), (second, first))
        groups = [list(matrix.ratios(i, j).values()) for i, j in places]
        why = "; ".join(dict.fromkeys(chosen))
        tests.append(PairTest(task.task.id, (one, other), why, *defined(partial(anovas.one_way, groups, "ratio"))))
    return tests


def _crossed(tasks: Sequence[TaskResult]) -> tuple[anovas.Cells | None, str]:
    places = shared(task.confusion for task in tasks) if tasks else ()
    if tasks and not places:
        return None, "the tasks have no material in common"
    values: list[Fraction] = []
    levels: tuple[list[str], list[str]] = ([], [])
    for task in tasks:
        for index in places:
            material = task.confusion.materials[index]
            ratios = list(task.confusion.ratios(index, index).values())
            values += ratios
            levels[0].extend([task.task.id] * len(ratios))
            levels[1].extend([material] * len(ratios))
    return defined(partial(anovas.cells, values, *levels, names=(TASK, MATERIAL)))


def _components(data: anovas.Cells, tasks: Sequence[TaskResult]) -> ComponentReliability:
    components = anovas.variance_components(data)
    sizes = [len(task.confusion.participants) for task in tasks]
    everyone = " + ".join(map(str, sizes))
    wanted = {sum(sizes): f"all participants of all tasks, {everyone}; no cell has that many"}
    wanted |= {size: f"participants in a task, {size}" for size in sizes}
    wanted[1] = "a single participant"
    values = tuple((k, meaning, anovas.icc_of_mean(components, k)) for k, meaning in wanted.items())
    limits = tuple(defined(partial(anovas.icc_limits, data, k))[0] for k in wanted)
    return ComponentReliability(components, values, limits)


def _reliabilities(study: Study, tasks: Sequence[TaskResult]) -> list[Reliability]:
    found = []
    for task in tasks:
        matrix, people = task.confusion, task.confusion.complete
        complete = set(people)
        dropped = tuple(label for label in matrix.participants if label not in complete)
        who = plural(len(people), "participant")
        each = [matrix.ratios(i, j) for i in matrix.presented for j in range(len(study.materials))]
        correct = _correct(matrix, people)
        for name, rows in (
            (f"{len(each)} cells (presented x answered)", [[ratios[label] for label in people] for ratios in each]),
            (plural(len(correct), "correct ratio"), correct),
        ):
            title = f"{task.task.id}: {name} x {who}"
            found.append(Reliability(title, task.task.id, *defined(partial(icc, rows)), dropped))
    if study.origin == "RECONSTRUCTION":
        return [
            replace(one, icc=replace(one.icc, forms=one.icc.forms[::3]), statement=LINKED) if one.icc else one
            for one in found
        ]
    if len(tasks) > 1:
        both = in_every([task.confusion for task in tasks])
        rows = [row for task in tasks for row in _correct(task.confusion, both)]
        anyone = dict.fromkeys(label for task in tasks for label in task.confusion.participants)
        in_both = set(both)
        dropped = tuple(label for label in anyone if label not in in_both)
        name = f"{len(rows)} correct ratios (material by task) x {plural(len(both), 'participant')} who did every task"
        found.append(Reliability(name, None, *defined(partial(icc, rows)), dropped))
    return found
