"""Type I error and coverage of what `analyse` prints: run `python -m tests.benchmarks.inference [STUDIES [FITTED]]`.

SIMULATED studies of four materials, ten trials each, in two tasks that the same 6, 10, 15 or 25 participants do. A test
errs where its null hypothesis holds and P is below 0.05; an interval covers where it holds the value that the studies
were drawn from. Participants differ not at all, in level alone (as much for every material), or in level and,
independently, by material, by task and in their wrong answers ("all"). Of all STUDIES those numbers are taken that
`statistics` finds for many studies at once, and the GEE, which is fast; of FITTED ones those of other models. The
number stands behind each name. `planned_tests.py` has those that a protocol can plan. Not a test.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import expit

from palpate.analysis.identification import maps, trial_models
from palpate.analysis.identification.companion_tests import marginal
from palpate.analysis.identification.confusion import Confusion, most_confused
from palpate.analysis.identification.trial_models import Design
from palpate.analysis.reading.study import Study, Task
from palpate.analysis.statistics import lapses
from palpate.analysis.statistics.anova import one_way_tests, tasks_by_materials, two_way_tests
from palpate.analysis.statistics.exact import Floats, NotDefined, of_counts
from palpate.analysis.statistics.inference import clopper_pearson, t_tests, wilson
from palpate.analysis.statistics.participants import jackknife, repeated_tests
from palpate.analysis.statistics.psychophysics.information import information, information_limits

SIZES = (6, 10, 15, 25)
MATERIALS, TRIALS, ALPHA = ("a", "b", "c", "d"), 10, 0.05
CHANCE = Fraction(1, 4)
SHOWN = 0.5
"""The log odds of right answers where materials and tasks are alike and well above chance."""

"""Fewer than `analyse` draws, because each study draws anew."""


@dataclass(frozen=True)
class Spread:
    """SDs of the log odds of a right answer among participants: of the level, by material and by task.

    `answers` is the concentration of the Dirichlet shares by which a participant divides wrong answers to a material;
    infinite where all participants divide them evenly.
    """

    name: str
    level: float
    material: float
    task: float
    answers: float

    @property
    def whole(self) -> float:
        return math.sqrt(self.level**2 + self.material**2 + self.task**2)


SPREADS = (
    Spread("none", 0.0, 0.0, 0.0, math.inf),
    Spread("level", 0.8, 0.0, 0.0, math.inf),
    Spread("all", 0.8, 0.8, 0.6, 1.0),
)
"""At even odds 0.8 is an intraclass correlation of about 0.13, and all together of 0.25."""

Counts = NDArray[np.int64]
Key = tuple[str, int]
Found = dict[str, dict[Key, tuple[int, int]]]


def draw(
    spread: Spread, people: int, studies: int, log_odds: float | tuple[float, float], random: np.random.Generator
) -> Counts:
    """Counts of answers, shape (2, studies, people, 4, 4): the mean shares of all wrong answers are the same.

    `log_odds` are those of both tasks, or of each.
    """
    own = random.normal(0, spread.level, (1, studies, people, 1))
    by_material = random.normal(0, spread.material, (1, studies, people, 4))
    by_task = random.normal(0, spread.task, (2, studies, people, 1))
    right = random.binomial(TRIALS, expit(np.reshape(log_odds, (-1, 1, 1, 1)) + own + by_material + by_task))
    shares = np.full((studies, people, 4, 3), 1 / 3)
    if spread.answers < math.inf:
        shares = random.dirichlet([spread.answers] * 3, size=shares.shape[:-1])
    counts = np.zeros((*right.shape, 4), dtype=np.int64)
    for i in range(4):
        others = [j for j in range(4) if j != i]
        counts[..., i, others] = random.multinomial(TRIALS - right[..., i], shares[:, :, i])
        counts[..., i, i] = right[..., i]
    return counts


def mean_share(log_odds: float, sd: float) -> float:
    """The mean share of right answers over the normal spread."""
    nodes, weights = _normal_nodes()
    return float(weights @ expit(log_odds + sd * nodes) / weights.sum())


@cache
def _normal_nodes() -> tuple[Floats, Floats]:
    """Return Gauss and Hermite's nodes and weights."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    return nodes, weights


def at_share(wanted: float, sd: float) -> float:
    """The log odds at which the mean share of right answers is the one wanted."""
    low, high = -20.0, 20.0
    while high - low > 1e-10:
        middle = (low + high) / 2
        low, high = (middle, high) if mean_share(middle, sd) < wanted else (low, middle)
    return low


def at_once(null: Counts, shown: Counts) -> Iterator[tuple[str, Iterable[float]]]:
    """Yield P of every study: `null` has all answers equally likely, in `shown` materials and tasks are alike."""
    guessed = np.diagonal(null[0], axis1=2, axis2=3)[..., 0]
    yield "t against chance", t_tests(of_counts(guessed, TRIALS), CHANCE).p
    answers = of_counts(np.moveaxis(null[0], (2, 3), (0, 1)), TRIALS)
    one, other = most_confused(answers.means)
    places = np.stack([one, other, one, other]), np.stack([one, other, other, one]), np.arange(len(one))
    yield "one-way ANOVA of the pair most confused", one_way_tests(answers[places]).p
    right = np.diagonal(shown, axis1=3, axis2=4)
    layout, cells = tasks_by_materials([of_counts(np.moveaxis(task, 2, 0), TRIALS) for task in right])
    for name, effect in (("task", "A"), ("material", "B")):
        yield f"two-way ANOVA, {name}", two_way_tests(layout, cells, effect, "II").p
    gaps = right[0] - right[1]
    yield "paired t, task", repeated_tests(gaps.sum(axis=-1)[..., None].astype(float))[2]
    tables = shown[0].sum(axis=1)
    _, _, fitted, _ = maps.fit(tables, 1e-6)
    g2 = 2 * (tables * np.log(np.where(tables > 0, tables / fitted, 1.0))).sum(axis=(1, 2))
    yield "similarity-choice, G² as chi-squared (not printed)", stats.chi2.sf(g2, 3)


def intervals(shown: Counts, share: float) -> Iterator[tuple[str, Iterable[bool]]]:
    """Yield whether each study's intervals hold the share of right answers, and the bits that it transmits."""
    wrong = (1 - share) / 3
    bits = 2 + share * math.log2(share) + 3 * wrong * math.log2(wrong)
    people = shown.shape[2]
    totals = shown[0, :, :, 0, 0].sum(axis=1).tolist()
    for name, limits in (("Wilson, ratio", wilson), ("Clopper-Pearson, ratio", clopper_pearson)):
        held = {total: limits(total, people * TRIALS) for total in set(totals)}
        yield name, [held[total].low <= share <= held[total].high for total in totals]
    found = []
    for study in shown[0]:
        # Fano's bound counts where more than 0.9 are right, which none of these studies comes near.
        own = information_limits(study, information(study.sum(axis=0)), (0.0, 1.0))
        found.append(own.low <= bits <= own.high)
    yield "jackknife, information (companion)", found
    # Wrong answers are as frequent, so that a share of right answers is 1 - 3/4 of the lapses.
    lapse, held_lapses = (1 - share) * 4 / 3, []
    for study in shown[0]:
        pooled = study.sum(axis=0)
        guessed = lapses.fits(np.concatenate([pooled[None], pooled - study]))[0].sum(axis=1)
        left = (people - 1) * 4 * TRIALS
        own = jackknife(float(guessed[0]) / (people * 4 * TRIALS), guessed[1:] / left)
        held_lapses.append(own.low <= lapse <= own.high)
    yield "jackknife, lapses (companion)", held_lapses


def one_by_one(shown: Counts) -> Iterator[tuple[str, bool]]:
    """Yield whether tests of models err in one study, shape (2, people, 4, 4)."""
    yield from _contrasts(shown)
    try:
        terms = {term.name: term.p for term in trial_models.mixed(_design(shown)).terms}
    except NotDefined:
        terms = {}
    for of in ("task", "material"):
        yield f"mixed logit with intercepts, {of}", terms.get(of, 1.0) < ALPHA


def gee(shown: Counts) -> Iterator[tuple[str, bool]]:
    """Yield whether the GEE errs in one study, by F as it is printed and as chi-squared."""
    people = shown.shape[1]
    try:
        terms = {term.name: term for term in trial_models.gee(_design(shown)).terms}
    except NotDefined:
        terms = {}
    for of in ("task", "material"):
        term = terms.get(of)
        yield f"GEE logit, {of} (companion)", term is not None and term.p < ALPHA
        wald = term.statistic * term.df * (people - 1) / (people - term.df) if term else 0.0
        p = float(stats.chi2.sf(wald, term.df)) if term else 1.0
        yield f"GEE logit, {of}, as chi-squared (not printed)", p < ALPHA


def _contrasts(shown: Counts) -> Iterator[tuple[str, bool]]:
    """Yield every contrast of a study, each counted as one, and whether Holm's P shows any of a family."""
    try:
        found = marginal(_study(), matrices(shown))
    except NotDefined:
        return
    for name, of in (("materials within a task", found.materials), ("tasks within a material", found.tasks)):
        yield from ((f"contrast of {name} (companion)", one.p < ALPHA) for one in of)
        family = [one for one in of if name[0] == "t" or one.within == "one"]
        yield f"any contrast of {name}, Holm (companion)", any(one.p_holm < ALPHA for one in family)


def matrices(counts: Counts) -> dict[str, Confusion]:
    labels = tuple(map(str, range(counts.shape[1])))
    none = np.zeros((*counts.shape[1:-1], 1), dtype=np.int64)
    return {
        name: Confusion(MATERIALS, labels, np.concatenate([of, none], axis=2))
        for name, of in zip(("one", "two"), counts, strict=True)
    }


def _study() -> Study:
    tasks = tuple(Task(name, name, "", MATERIALS) for name in ("one", "two"))
    return Study("s", "s", "REHEARSAL", "SIMULATED", MATERIALS, tasks, (), {}, {}, None, (), (), (), {})  # type: ignore[arg-type]


def _design(counts: Counts) -> Design:
    hit = np.arange(TRIALS) < np.diagonal(counts, axis1=2, axis2=3)[..., None]
    task, who, material, _ = (index.ravel() for index in np.indices(hit.shape))
    columns = [np.ones(hit.size), task == 1, *(material == k for k in (1, 2, 3))]
    names, terms = ("intercept", "two", "b", "c", "d"), {"task": (1,), "material": (2, 3, 4)}
    order = np.argsort(who, kind="stable")
    matrix = np.column_stack(columns).astype(np.float64)[order]
    return Design(hit.ravel().astype(np.float64)[order], who[order].astype(np.int64), names, matrix, terms, {}, {}, ())


def measure(studies: int, fitted: int) -> Found:
    """Return name -> (spread, participants) -> how often it erred, or covered, and of how many."""
    found: Found = {}

    def count(name: str, key: Key, hits: int, of: int) -> None:
        before, whole = found.setdefault(name, {}).get(key, (0, 0))
        found[name][key] = before + hits, whole + of

    for s, spread in enumerate(SPREADS):
        share = mean_share(SHOWN, spread.whole)
        for people in SIZES:
            key, random = (spread.name, people), np.random.default_rng([s, people])
            null = draw(spread, people, studies, at_share(float(CHANCE), spread.whole), random)
            shown = draw(spread, people, studies, SHOWN, random)
            for name, p in at_once(null, shown):
                count(name, key, int(np.count_nonzero(np.asarray(p) < ALPHA)), studies)
            for name, held in intervals(shown, share):
                count(f"coverage: {name}", key, sum(held), studies)
            for k in range(studies):
                for name, hit in gee(shown[:, k]):
                    count(name, key, hit, 1)
            for k in range(min(fitted, studies)):
                for name, hit in one_by_one(shown[:, k]):
                    count(name, key, hit, 1)
            print(*key, f"{time.process_time():.0f} s", file=sys.stderr, flush=True)
    return found


def table(found: Mapping[str, Mapping[Key, tuple[int, int]]]) -> str:
    """Return the shares in per cent as Markdown, of so many studies each."""
    keys = [(spread.name, people) for spread in SPREADS for people in SIZES]
    head = " | ".join(f"{name} {n}" for name, n in keys)
    lines = [f"| nominal 5 %, or coverage of 95 % | studies | {head} |", "|:--|--:" + "|--:" * len(keys) + "|"]
    for name in sorted(found, key=lambda name: name.startswith("coverage")):
        shares = " | ".join(f"{100 * hits / of:.1f}" for hits, of in (found[name][key] for key in keys))
        lines.append(f"| {name} | {found[name][keys[0]][1]} | {shares} |")
    return "\n".join(lines)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    models = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    print(table(measure(asked, models)))
