"""Ours, beside the published tests: materials and tasks, tested with participants as the unit.

Repeated measures within a task, tasks over those who did both, and a logit in which participants differ by both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import combinations

import numpy as np
from scipy.special import fdtrc

from palpate.analysis.identification.confusion import Confusion, in_every, shared
from palpate.analysis.reading.study import Study
from palpate.analysis.statistics import mixed_logit
from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Statements
from palpate.analysis.statistics.inference import EffectSize, TTest, cohens_d, t_against_chance
from palpate.analysis.statistics.participants import Repeated, SignFlip, repeated, sign_flip

LEAST = 6
"""The fewest participants of a logit in which they differ by material and task."""

LINKED = (
    "which row of one task goes with which of another, and of one material with which of another, is arbitrary in a "
    "reconstruction"
)


@dataclass(frozen=True)
class Paired:
    """Two tasks over the participants who did both with every material: paired t, d, sign flips; first - second."""

    first: str
    second: str
    test: TTest
    d: EffectSize | None
    flip: SignFlip


@dataclass(frozen=True)
class Term:
    """Wald's F that all coefficients of a term are zero."""

    name: str
    f: float
    df1: int
    df2: int
    p: float


@dataclass(frozen=True)
class SlopesLogit:
    """The logit with random deviations: log odds ratios with standard errors by name, tests, and SDs by name."""

    participants: int
    coefficients: Mapping[str, tuple[float, float]]
    terms: tuple[Term, ...]
    sds: Mapping[str, float]


@dataclass(frozen=True)
class Beside:
    """All of it; `materials` holds the lines of each task, `statements` say why something is missing."""

    materials: Mapping[str, tuple[Repeated, ...]]
    both: tuple[Repeated, ...]
    paired: tuple[Paired, ...]
    logit: SlopesLogit | None
    statements: Mapping[str, str]


def beside(study: Study, tasks: Mapping[str, Confusion]) -> Beside:
    """Return the tests of a study from the confusion matrices of its tasks."""
    said = Statements()
    materials: dict[str, tuple[Repeated, ...]] = {}
    for task, matrix in tasks.items():
        ratios = _ratios(matrix, matrix.complete, matrix.presented)
        found = said.told(f"repeated-measures ANOVA of {task}", partial(repeated, ratios, ["material"]))
        if found is not None:
            materials[task] = found
    linked = study.origin != "RECONSTRUCTION"
    both: tuple[Repeated, ...] | None = ()
    paired: list[Paired] = []
    if len(tasks) > 1:
        if linked:
            both = said.told("repeated-measures ANOVA of tasks and materials", lambda: _both(list(tasks.values())))
            for first, second in combinations(tasks, 2):
                one = said.told(f"comparison of {first} with {second}", partial(_paired, first, second, tasks))
                paired += [one] if one else []
        else:
            said["paired comparison of tasks"] = LINKED
    if linked:
        logit = said.told("logit in which participants differ by material and task", lambda: _logit(tasks))
    else:
        logit, said["logit in which participants differ by material and task"] = None, LINKED
    return Beside(materials, both or (), tuple(paired), logit, said)


def _ratios(matrix: Confusion, people: Sequence[str], places: Sequence[int]) -> Floats:
    """Return the correct ratios of these participants to the materials at these places, shape (people, places)."""
    rows = [matrix.participants.index(label) for label in people]
    right = np.diagonal(matrix.counts[rows, :, :-1], axis1=1, axis2=2)
    return np.asarray(right[:, places] / matrix.trials[rows][:, places])


def _both(tasks: Sequence[Confusion]) -> tuple[Repeated, ...]:
    people, places = in_every(tasks), shared(tasks)
    values = np.stack([_ratios(task, people, places) for task in tasks], axis=1)
    return repeated(values, ["task", "material"])


def _paired(first: str, second: str, tasks: Mapping[str, Confusion]) -> Paired:
    pair = [tasks[first], tasks[second]]
    people, places = in_every(pair), shared(pair)
    if len(people) < 2:
        raise NotDefined(f"it needs two participants who did both with every material, got {len(people)}")
    if not places:
        raise NotDefined("they present no material both")
    right = [[matrix.ratios(i, i) for i in places] for matrix in pair]
    gaps = [sum((a[who] - b[who] for a, b in zip(*right, strict=True)), Fraction(0)) / len(places) for who in people]
    test = t_against_chance(gaps, 0)
    return Paired(first, second, test, None if test.t is None else cohens_d(test.t, test.df), sign_flip(gaps, 0))


def right_answers(tasks: Mapping[str, Confusion]) -> tuple[tuple[str, ...], Integers, Integers]:
    """Return everybody, right answers and trials, shape (participants, tasks, materials); 0 of what is lacking."""
    people = tuple(dict.fromkeys(label for matrix in tasks.values() for label in matrix.participants))
    place = {label: row for row, label in enumerate(people)}
    names = next(iter(tasks.values())).materials
    right, trials = (np.zeros((len(people), len(tasks), len(names)), dtype=np.int64) for _ in range(2))
    for k, matrix in enumerate(tasks.values()):
        rows = [place[label] for label in matrix.participants]
        right[rows, k] = np.diagonal(matrix.counts[:, :, :-1], axis1=1, axis2=2)
        trials[rows, k] = matrix.trials
    return people, right, trials


def _logit(tasks: Mapping[str, Confusion]) -> SlopesLogit:
    """Return the logit of every participant's counts; who lacks a task or a material has no trials there."""
    people, right, trials = right_answers(tasks)
    if len(people) < LEAST:
        raise NotDefined(f"it needs {LEAST} participants, got {len(people)}")
    known = sorted({place for matrix in tasks.values() for place in matrix.presented})
    names = [next(iter(tasks.values())).materials[place] for place in known]
    right, trials = right[:, :, known], trials[:, :, known]
    for what, of, axes in (("task", list(tasks), (0, 2)), ("material", list(names), (0, 1))):
        for level, hits, total in zip(of, right.sum(axis=axes), trials.sum(axis=axes), strict=True):
            if hits in (0, total):
                kind = "right" if hits else "wrong"
                raise NotDefined(f"every answer to {what} {level} is {kind}: its odds have no limit")
    held = trials.any(axis=0)
    cells = mixed_logit.layout([of.tolist() for of in np.nonzero(held)])
    if np.linalg.matrix_rank(cells.fixed) < cells.fixed.shape[1]:
        raise NotDefined("tasks and materials cannot be told apart: too few materials are presented in several tasks")
    found = mixed_logit.fit(right[:, held], trials[:, held], cells)
    factors = [(what, of) for what, of in (("task", list(tasks)), ("material", list(names))) if len(of) > 1]
    labels = ["intercept", *(f"{level} (against {of[0]})" for _, of in factors for level in of[1:])]
    errors = np.sqrt(np.diag(found.covariance))
    terms, first = [], 1
    for what, of in factors:
        part = slice(first, first + len(of) - 1)
        own = found.coefficients[part]
        df1 = len(of) - 1
        f = float(own @ np.linalg.solve(found.covariance[part, part], own)) / df1
        df2 = df1 * (len(people) - 1)
        terms.append(Term(what, f, df1, df2, float(fdtrc(df1, df2, f))))
        first += df1
    values = zip(found.coefficients.tolist(), errors.tolist(), strict=True)
    return SlopesLogit(
        len(people),
        dict(zip(labels, values, strict=True)),
        tuple(terms),
        dict(zip(["participant", *(f"participant by {what}" for what, _ in factors)], found.sds.tolist(), strict=True)),
    )
