"""Ours, beside the published tests: tests in which participants are the unit, contrasts, and equivalence.

Repeated measures within a task, tasks over those who did both, and a logit in which participants differ by both. For
contrasts each cell has its own log odds in a logit in which participants differ in level, by material, task and cell:
with a random intercept alone a quarter of studies err, and GEE lacks degrees of freedom. Means and contrasts: Searle,
Speed and Milliken (1980, Am. Stat. 34, 216-221). Equivalence has tests of its own, of tasks, and of pairs of materials.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import combinations

import numpy as np
from scipy.special import fdtrc, stdtr, stdtrit

from palpate.analysis.identification.confusion import Confusion, in_every, shared
from palpate.analysis.reading.study import Study
from palpate.analysis.statistics import mixed_logit
from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Statements
from palpate.analysis.statistics.inference import CONFIDENCE, EffectSize, TTest, cohens_d, holm, t_against_chance
from palpate.analysis.statistics.participants import Equivalence, Repeated, equivalence, repeated
from palpate.analysis.statistics.shares import EDGE, Limits, difference_limits, near_edges
from palpate.analysis.statistics.sign_flips import SignFlip, sign_flip

LEAST = 6
"""The fewest participants of a logit in which they differ by material and task."""

LINKED = "a reconstruction pairs rows across tasks and materials arbitrarily"
COMPARISON = "comparison of {} with {}"


@dataclass(frozen=True)
class Paired:
    """Two tasks over the participants who did both with every material: paired t, d, sign flips; first - second.

    `interval` is that of the mean difference; it allows for participants unlike these where shares are near 0 or 1.
    """

    first: str
    second: str
    test: TTest
    d: EffectSize | None
    flip: SignFlip
    interval: Limits


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


def run_companions(study: Study, tasks: Mapping[str, Confusion], rng: np.random.Generator) -> Beside:
    """Return the tests of a study from the confusion matrices of its tasks; sign flips may draw."""
    if study.origin == "RECONSTRUCTION":
        return Beside({}, (), (), None, {"test with participants as units": LINKED})
    said = Statements()
    materials: dict[str, tuple[Repeated, ...]] = {}
    for task, matrix in tasks.items():
        ratios = _ratios(matrix, matrix.complete, matrix.presented)
        if found := said.compute(f"repeated-measures ANOVA of {task}", partial(repeated, ratios, ["material"])):
            materials[task] = found
    both: tuple[Repeated, ...] | None = ()
    paired: list[Paired] = []
    if len(tasks) > 1:
        both = said.compute("repeated-measures ANOVA of tasks and materials", lambda: _both(list(tasks.values())))
        for first, second in combinations(tasks, 2):
            one = said.compute(COMPARISON.format(first, second), partial(_paired, first, second, tasks, rng))
            paired += [one] if one else []
    logit = said.compute("logit with participants who vary by material and task", partial(slopes_logit, tasks))
    return Beside(materials, both or (), tuple(paired), logit, said)


def _ratios(matrix: Confusion, people: Sequence[str], places: Sequence[int]) -> Floats:
    """Return the correct ratios of these participants to the materials at these places, shape (people, places)."""
    rows = matrix.rows(people)
    right = np.diagonal(matrix.counts[rows, :, :-1], axis1=1, axis2=2)
    return np.asarray(right[:, places] / matrix.trials[rows][:, places])


def _both(tasks: Sequence[Confusion]) -> tuple[Repeated, ...]:
    values = np.stack([_ratios(task, in_every(tasks), shared(tasks)) for task in tasks], axis=1)
    return repeated(values, ["task", "material"])


def _paired(first: str, second: str, tasks: Mapping[str, Confusion], rng: np.random.Generator) -> Paired:
    pair = [tasks[first], tasks[second]]
    people, places = in_every(pair), shared(pair)
    if len(people) < 2:
        raise NotDefined(f"it needs two participants who did both tasks with every material, got {len(people)}")
    if not places:
        raise NotDefined("they have no material in common")
    right = [[matrix.ratios(i, i) for i in places] for matrix in pair]
    gaps = [sum((a[who] - b[who] for a, b in zip(*right, strict=True)), Fraction(0)) / len(places) for who in people]
    test = t_against_chance(gaps, 0)
    limits = difference_limits(*_pooled(pair, people, places), np.array(gaps, dtype=np.float64))
    d = None if test.t is None else cohens_d(test.t, test.df)
    return Paired(first, second, test, d, sign_flip(gaps, 0, rng), limits)


def _pooled(tasks: Sequence[Confusion], people: Sequence[str], places: Sequence[int]) -> tuple[Integers, Integers]:
    """Return right answers and trials of these participants with these materials, each of shape (tasks, people)."""
    right, trials = [], []
    for matrix in tasks:
        rows = matrix.rows(people)
        right.append(np.diagonal(matrix.counts[rows, :, :-1], axis1=1, axis2=2)[:, places].sum(axis=1))
        trials.append(matrix.trials[rows][:, places].sum(axis=1))
    return np.array(right), np.array(trials)


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


def slopes_logit(tasks: Mapping[str, Confusion]) -> SlopesLogit:
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
                raise NotDefined(f"every answer to {what} {level} is {kind}, so its odds are infinite or zero")
    held = trials.any(axis=0)
    cells = mixed_logit.layout([of.tolist() for of in np.nonzero(held)])
    if np.linalg.matrix_rank(cells.fixed) < cells.fixed.shape[1]:
        raise NotDefined("tasks and materials cannot be separated: too few materials are presented in several tasks")
    found = mixed_logit.fit(right[:, held], trials[:, held], cells)
    # Likelihood takes the spread of n participants about their own mean, which has n - 1 df.
    covariance = found.covariance * (len(people) / (len(people) - 1))
    factors = [(what, of) for what, of in (("task", list(tasks)), ("material", list(names))) if len(of) > 1]
    labels = ["intercept", *(f"{level} (against {of[0]})" for _, of in factors for level in of[1:])]
    errors = np.sqrt(np.diag(covariance))
    terms, first = [], 1
    for what, of in factors:
        part = slice(first, first + len(of) - 1)
        own = found.coefficients[part]
        df1 = len(of) - 1
        f = float(own @ np.linalg.solve(covariance[part, part], own)) / df1
        df2 = df1 * (len(people) - 1)
        terms.append(Term(what, f, df1, df2, float(fdtrc(df1, df2, f))))
        first += df1
    values = zip(found.coefficients.tolist(), errors.tolist(), strict=True)
    by = ["participant", *(f"participant by {what}" for what, _ in factors)]
    sds = dict(zip(by, found.sds.tolist(), strict=True))
    return SlopesLogit(len(people), dict(zip(labels, values, strict=True)), tuple(terms), sds)


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

    t has n - 1 df for each step, as Wald's F; `p_holm` is over the pairs of one task, or all pairs of
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
        raise NotDefined(f"it needs two cells with both right and wrong answers, got {len(kept)}")
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
    """An equivalence test of `subject` in one task or between two, within `MARGIN`."""

    tasks: tuple[str, ...]
    subject: str
    result: Equivalence
    p_holm: float


@dataclass(frozen=True)
class Equivalences:
    """The tests of tasks, first less second, and of pairs of materials; `statements` say why some are missing."""

    tasks: tuple[Equivalent, ...]
    pairs: tuple[Equivalent, ...]
    statements: tuple[str, ...]


MARGIN = 0.1
"""Ours: one answer in ten, the margin of what no protocol plans; `planned` has those of plans."""

ALL, SHARED = "all materials", "materials of both tasks"


def equivalences(study: Study, tasks: Mapping[str, Confusion]) -> Equivalences:
    """Return the equivalence tests of a study from the confusion matrices of its tasks."""
    if study.origin == "RECONSTRUCTION":
        return Equivalences((), (), (f"there are no equivalence tests: {LINKED}",))
    names = next(iter(tasks.values())).materials
    said: list[str] = []

    def tested(of: tuple[str, ...], values: Sequence[tuple[str, Callable[[], Floats]]]) -> list[Equivalent]:
        found = []
        for subject, each in values:
            try:
                found.append((subject, equivalence(each(), MARGIN)))
            except NotDefined as reason:
                said.append(f"equivalence of {subject} in {' and '.join(of)} is not defined: {reason}")
        adjusted = holm(np.array([one.p for _, one in found])).tolist()
        return [Equivalent(of, subject, one, p) for (subject, one), p in zip(found, adjusted, strict=True)]

    between: list[Equivalent] = []
    for of in combinations(tasks, 2):
        _, right, trials = right_answers({task: tasks[task] for task in of})
        places = shared(tasks[task] for task in of)
        if not places:
            said.append(f"equivalence of {' and '.join(of)} is not defined: they have no material in common")
            continue
        right, trials = right[:, :, places], trials[:, :, places]
        both = (trials > 0).all(axis=(1, 2))
        counts = [each[both].transpose(1, 2, 0) for each in (right, trials)]
        between += tested(of, [(ALL if len(places) == len(names) else SHARED, partial(equivalent_gaps, *counts))])
        single = [partial(equivalent_gaps, *(each[:, [k]] for each in counts)) for k in range(len(places))]
        between += tested(of, list(zip((names[place] for place in places), single, strict=True)))
    pairs: list[Equivalent] = []
    for task, matrix in tasks.items():
        apart = told_apart(matrix).items()
        pairs += tested((task,), [(f"{names[a]} and {names[b]}", partial(np.asarray, one)) for (a, b), one in apart])
    return Equivalences(tuple(between), tuple(pairs), tuple(said))


def equivalent_gaps(right: Integers, trials: Integers) -> Floats:
    """Return how much each is better in the first task, of counts (tasks, materials, people). Raises `NotDefined`."""
    shares = (right / trials).mean(axis=1)
    if shares.size and near_edges(shares):
        raise NotDefined(f"a proportion is below {EDGE:g} or above {1 - EDGE:g}, where this test errs too often")
    return np.asarray(shares[0] - shares[1])


def told_apart(matrix: Confusion) -> dict[tuple[int, int], Floats]:
    """Return how much more often each pair of materials is named when presented, of participants who had them all."""
    every = matrix.trials[:, matrix.presented].all(axis=1)
    ratios = matrix.counts[every, :, :-1] / np.maximum(matrix.trials[every], 1)[:, :, None]
    return {
        (a, b): (ratios[:, a, a] - ratios[:, b, a] + ratios[:, b, b] - ratios[:, a, b]) / 2
        for a, b in combinations(matrix.presented, 2)
    }
