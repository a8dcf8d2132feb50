"""Type I error and power of planned tests: `python -m tests.benchmarks.planned_tests FILE [STUDIES [SECONDS]]`.

SIMULATED studies of four materials in two tasks that the same 4 to 40 participants do, who differ as in `inference.py`
or by a beta distribution. FILE gets a line for each cell, a question of one kind of study; a cell that is in it is not
run again, so that a run of so many SECONDS goes on where the last one stopped. Cells come in a shuffled order. Once all
are run, the `WORST` are run again with ten times as many. At the end the table of all cells in FILE is printed.

Of STUDIES a test errs in as many as reject a true null; a family errs where any of its tests does, by Holm. Its power
is that for a difference of `FAR` standard errors, or none for equivalence, beside the best test of the same question
that errs in no more than `MOST`. Shares of 0.05 are the mirror image of 0.95. Where everybody who differs has a mean at
chance, or one of two groups varies more, no test is of a true null; these rows are their own. Not a test.
"""

import csv
import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.linalg import helmert
from scipy.special import betaincinv, expit, stdtr

from palpate.analysis.identification.companion_tests import LEAST, MARGIN, slopes_logit
from palpate.analysis.identification.confusion import Confusion
from palpate.analysis.statistics.anova import tasks_by_materials, two_way_tests
from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, of_counts
from palpate.analysis.statistics.groups import difference_tests
from palpate.analysis.statistics.inference import holm
from palpate.analysis.statistics.participants import equivalence_tests, order_tests, repeated_tests
from palpate.analysis.statistics.shares import EDGE
from palpate.analysis.statistics.sign_flips import sign_flip_tests
from tests.benchmarks.inference import ALPHA, MATERIALS, SPREADS, Spread, at_share

SIZES = (4, 6, 10, 15, 25, 40)
PATTERNS = ((10,), (5, 10, 20, 40))
"""Trials of each material, of participants in turn."""

SHARES = (0.6, 0.95)
BETA, RHO = Spread("beta", 0.0, 0.0, 0.0, math.inf), 0.15
"""People who differ in level by a beta distribution with this intraclass correlation."""

FAR = 3.0
MOST, CONFIDENT = 0.06, 0.99
"""A cell errs too often if its own interval of this confidence lies above so much."""

WORST, AGAIN = 25, 10
FITTED = 20
"""The logit, which takes longest, is fitted in one of so many studies."""

CHUNK = 1000
COMPARED = "t, ", "Welch's t", "pooled t", "two-way ANOVA"
"""How tests begin that stand beside the planned ones, to compare power, or because papers print them."""

UNLIKE = ((1.0, 0.0, 0.0), (0.5, 0.0, 0.8), (0.5, 0.0, 1.5), (0.5, 0.8, 0.0), (0.5, 1.5, 0.0))
"""SDs of the log odds by level, material and task, for the two-way ANOVA, which errs as these say."""

OWN_ROW = {
    "third who differ": "The null is one population; here only the means are equal. The report bounds P and warns.",
    "people differ": "The null is that everybody guesses; here some know, so rejecting is right. The report says so.",
    "two-way ANOVA": "Printed only where it is published or planned; the report warns.",
    "t, against": "Printed beside the sign flips, which answer.",
}
"""What the names of rows hold whose null no population that is drawn meets, and why they may err more often."""

Tests = Iterator[tuple[str, Floats]]
Found = dict[str, tuple[int, int]]
"""How many studies each test rejects without, and with, an effect."""


@dataclass(frozen=True)
class Kind:
    """People who differ as `spread` says, so many, with so many trials, right in a mean `share`."""

    spread: Spread
    people: int
    pattern: tuple[int, ...]
    share: float

    @property
    def trials(self) -> Integers:
        return np.resize(np.array(self.pattern, dtype=np.int64), self.people)

    @property
    def most(self) -> int:
        return max(self.pattern)

    def counts(self, means: Floats, studies: int, random: np.random.Generator, people: slice = slice(None)) -> Integers:
        """Right answers out of `most`, shape (2, studies, people, 4), at these mean shares of tasks and materials."""
        trials, one = self.trials[people], self.spread
        shape = studies, trials.size
        if one is BETA:
            level, c = random.random(shape), 1 / RHO - 1
            at = {mean: betaincinv(mean * c, (1 - mean) * c, level) for mean in np.unique(means).tolist()}
            shares = np.stack([np.stack([at[mean] for mean in row], axis=-1) for row in means.tolist()])
        else:
            odds = np.vectorize(at_share)(means, one.whole)[:, None, None, :]
            own = random.normal(0, one.level, (1, *shape, 1)) + random.normal(0, one.material, (1, *shape, 4))
            shares = expit(odds + own + random.normal(0, one.task, (2, *shape, 1)))
        drawn = random.binomial(trials[:, None], shares)
        return np.asarray(drawn * (self.most // trials)[:, None])


def _alike(share: float) -> Floats:
    return np.full((2, 4), share)


def _less(share: float, by: float, tasks: slice, materials: slice) -> Floats:
    means = _alike(share)
    means[tasks, materials] = max(share - by, 0.02)
    return means


def _t(values: Floats, null: float = 0.0) -> Floats:
    """Return P of Student's t, 1 where nothing varies."""
    sd = values.std(axis=-1, ddof=1)
    t = (values.mean(axis=-1) - null) / np.where(sd > 1e-12, sd, np.inf) * math.sqrt(values.shape[-1])
    return np.asarray(2 * stdtr(values.shape[-1] - 1, -abs(t)))


def _two_groups(one: Floats, other: Floats) -> Tests:
    for name, equal in (("Welch's t", False), ("pooled t", True)):
        yield name, np.asarray(stats.ttest_ind(one, other, axis=1, equal_var=equal).pvalue)


def _signs(gaps: Integers, most: int) -> Floats:
    """Return P of sign flips of differences: k of `most` is k + most of 2 most against a half."""
    return sign_flip_tests(gaps + most, 2 * most, Fraction(1, 2))


def of_chance(chance: Fraction, kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield tests that everybody guesses among so many materials, of which four are presented."""
    share = float(chance)
    alike = kind.counts(_alike(share), 500, np.random.default_rng(1))[0, ..., 0] / kind.most
    error = float(alike.std()) / math.sqrt(kind.people)
    right = kind.counts(_alike(min(share + far * error, 0.9)), studies, random)[0]
    flips = np.stack([sign_flip_tests(right[..., k], kind.most, chance) for k in range(4)])
    t = np.stack([_t(right[..., k] / kind.most, share) for k in range(4)])
    who = "everybody guesses" if kind.spread.name == "none" else "people differ about chance"
    for name, p in (("sign flips against chance", flips), ("t, against chance", t)):
        yield f"{name}, one material, {who}", p[0]
        yield f"{name}, any of 4 by Holm, {who}", holm(p).min(axis=0)


def of_tasks(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield tests that two tasks are alike."""
    right = kind.counts(_less(kind.share, far * _error(kind), slice(1, 2), slice(None)), studies, random)
    gaps = (right[0] - right[1]).sum(axis=-1)
    yield "sign flips between tasks", _signs(gaps, 4 * kind.most)
    yield "repeated measures, task (paired t)", _t(gaps / (4 * kind.most))


def of_materials(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield tests that the materials of one task are alike."""
    right = kind.counts(
        _less(kind.share, far * _error(kind, one_material=True), slice(None), slice(1)), studies, random
    )[0]
    pairs = list(combinations(range(4), 2))
    flips = np.stack([_signs(right[..., a] - right[..., b], kind.most) for a, b in pairs])
    yield "sign flips between materials, any of 6 by Holm", holm(flips).min(axis=0)
    t = np.stack([_t((right[..., a] - right[..., b]) / kind.most) for a, b in pairs])
    yield "t, between materials, any of 6 by Holm", holm(t).min(axis=0)
    yield "repeated measures, material in one task", repeated_tests(right / kind.most @ helmert(4).T)[2]


def of_both(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield the test that a difference of tasks is the same for all materials."""
    right = kind.counts(
        _less(kind.share, 2 * far * _error(kind, one_material=True), slice(1, 2), slice(1)), studies, random
    )
    yield "repeated measures, task x material", repeated_tests((right[0] - right[1]) / kind.most @ helmert(4).T)[2]


def of_equivalence(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield tests of tasks and of a pair of materials that differ by exactly the margin, or with an effect not at all.

    Where all wrong answers are as frequent, a share of right answers of p tells a pair apart by (4 p - 1) / 3.
    """
    margin, centre = (0.0 if far else MARGIN), min(kind.share, 0.94)
    means = np.array([[centre + margin / 2] * 4, [centre - margin / 2] * 4])
    right = kind.counts(means, studies, random) / kind.most
    # Near 0 and 1 the report has no such test.
    alike = (abs(right.mean(axis=(2, 3)) - 0.5) <= 0.5 - EDGE).all(axis=0)
    p = np.where(alike, equivalence_tests((right[0] - right[1]).mean(-1), MARGIN), 1.0)
    yield "equivalence of tasks, true difference the margin", p
    hits = kind.counts(_alike((1 + 3 * margin) / 4), studies, random)[0, ..., :2]
    part = random.dirichlet([kind.spread.answers] * 3, hits.shape)[..., 0] if kind.spread.answers < math.inf else 1 / 3
    other = random.binomial((kind.most - hits) // (kind.most // kind.trials)[:, None], part) / kind.trials[:, None]
    apart = (hits / kind.most - other).mean(axis=-1)
    yield "equivalence of a pair, told apart by the margin", equivalence_tests(apart, MARGIN)


def of_groups(
    third: bool, other: Spread | None, kind: Kind, studies: int, random: np.random.Generator, far: float
) -> Tests:
    """Yield tests of two groups, halves or a third and the rest, of one population or of people `other` than these."""
    first = max(2, kind.people // 3) if third else kind.people // 2
    by = far * _error(kind, groups=True) * math.sqrt(kind.people / 4 * (1 / first + 1 / (kind.people - first)))
    rest = Kind(other or kind.spread, kind.people, kind.pattern, kind.share)
    members = slice(0, None, 2) if not third else slice(first)
    others = slice(1, None, 2) if not third else slice(first, None)
    means = _less(kind.share, by, slice(None), slice(None))
    one = kind.counts(means, studies, random, members)[0].mean(axis=-1) / kind.most
    two = rest.counts(_alike(kind.share), studies, random, others)[0].mean(axis=-1) / kind.most
    name = "a third who differ" if other else "a third in one" if third else "half in each"
    yield f"difference of groups, {name}", difference_tests(one, two)
    yield from ((f"{test}, of groups, {name}", p) for test, p in _two_groups(one, two))


def of_order(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield tests that what is done first adds nothing, where every other participant has either order."""
    means = _less(kind.share, far * _error(kind), slice(1, 2), slice(None))
    own = [kind.counts(of, studies, random, slice(k, None, 2)) for k, of in enumerate((means, means[::-1]))]
    one, other = ((right[0] - right[1]).mean(axis=-1) / kind.most for right in own)
    yield "order of tasks", order_tests(one, other)
    yield from ((f"{test}, of orders", p) for test, p in _two_groups(one, other))


def of_anova(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield the published analysis of variance of tasks that are alike."""
    right = kind.counts(_less(kind.share, far * _error(kind), slice(1, 2), slice(None)), studies, random)
    layout, of = tasks_by_materials([of_counts(np.moveaxis(task, 2, 0), kind.most) for task in right])
    for name, effect in (("task", "A"), ("material", "B")):
        yield f"two-way ANOVA, {name}", two_way_tests(layout, of, effect, "II").p


def of_logit(kind: Kind, studies: int, random: np.random.Generator, far: float) -> Tests:
    """Yield the terms of the logit, beside repeated measures of the same studies; undefined, it shows nothing."""
    by_task, by_material = far * _error(kind), far * _error(kind, one_material=True)
    means = _less(kind.share, by_task, slice(1, 2), slice(None))
    means[:, 0] = np.maximum(means[:, 0] - by_material, 0.02)
    right = kind.counts(means, math.ceil(studies / FITTED), random)
    p: dict[str, list[float]] = {"task": [], "material": []}
    for study in np.moveaxis(right, 1, 0):
        try:
            found = {one.name: one.p for one in slopes_logit(_matrices(kind, study)).terms}
        except NotDefined:
            found = {}
        for name, own in p.items():
            own.append(found.get(name, 1.0))
    yield from ((f"logit with participants, {name}", np.array(own)) for name, own in p.items())


def _matrices(kind: Kind, study: Integers) -> Mapping[str, Confusion]:
    """Return confusion matrices of a study, whose wrong answers, which the logit leaves alone, are all of one kind."""
    counts = np.zeros((2, kind.people, 4, 5), dtype=np.int64)
    hits = study // (kind.most // kind.trials)[:, None]
    for k in range(4):
        counts[:, :, k, k], counts[:, :, k, (k + 1) % 4] = hits[..., k], kind.trials - hits[..., k]
    people = tuple(map(str, range(kind.people)))
    return {name: Confusion(MATERIALS, people, of) for name, of in zip(("one", "two"), counts, strict=True)}


def _error(kind: Kind, *, one_material: bool = False, groups: bool = False) -> float:
    """Return the standard error of a difference of two tasks, of two materials, or of two groups of half the people."""
    right = kind.counts(_alike(kind.share), 500, np.random.default_rng(1)) / kind.most
    if groups:
        return float(right[0].mean(axis=-1).std()) * 2 / math.sqrt(kind.people)
    of = right[0, ..., 0] - right[0, ..., 1] if one_material else (right[0] - right[1]).mean(axis=-1)
    return float(of.std()) / math.sqrt(kind.people)


Question = Callable[[Kind, int, np.random.Generator, float], Tests]


@dataclass(frozen=True)
class Cell:
    """A question of one kind of study; `run` returns how often each of its tests rejects."""

    question: str
    kind: Kind
    ask: Question

    @property
    def name(self) -> str:
        pattern = " ".join(map(str, self.kind.pattern))
        return f"{self.question}, {self.kind.spread.name}, {self.kind.share}, {pattern} trials, n = {self.kind.people}"

    def run(self, studies: int, seed: int) -> Found:
        found: dict[str, list[int]] = {}
        for first in range(0, studies, CHUNK):
            for place, far in enumerate((0.0, FAR)):
                random = np.random.default_rng([seed, studies, first, place, 39])
                for name, p in self.ask(self.kind, min(CHUNK, studies - first), random, far):
                    found.setdefault(name, [0, 0])[place] += int(np.count_nonzero(p < ALPHA))
        return {name: (one, other) for name, (one, other) in found.items()}


def cells() -> Iterator[Cell]:
    """Yield every cell, the logits last."""
    late: list[Cell] = []
    for people in SIZES:
        for pattern in PATTERNS:
            for spread in (*SPREADS, BETA):
                for chance in (Fraction(1, 4), Fraction(1, 20)):
                    yield Cell("chance", Kind(spread, people, pattern, float(chance)), partial(of_chance, chance))
                for share in SHARES:
                    kind = Kind(spread, people, pattern, share)
                    yield Cell("tasks", kind, of_tasks)
                    yield Cell("materials", kind, of_materials)
                    yield Cell("tasks and materials", kind, of_both)
                    yield Cell("equivalence", kind, of_equivalence)
                    yield Cell("half", kind, partial(of_groups, False, None))
                    yield Cell("third", kind, partial(of_groups, True, None))
                    if spread.name != "none":
                        yield Cell("third who differ", kind, partial(of_groups, True, SPREADS[0]))
                    yield Cell("order", kind, of_order)
                    if people >= LEAST:
                        late.append(Cell("logit", kind, of_logit))
    yield from late
    for sds in UNLIKE:
        for people in SIZES:
            for trials in (10, 40):
                spread = Spread(f"SD {sds}", *sds, math.inf)
                yield Cell("two-way ANOVA", Kind(spread, people, (trials,), 0.5), of_anova)


def run(file: Path, studies: int, seconds: float) -> None:
    """Run the cells that the file lacks, the worst again, then logits, until so many seconds of processor time."""
    every = list(enumerate(cells()))
    order = np.random.default_rng(1).permutation(len(every)).tolist()
    for count, wanted, slow in ((studies, None, False), (AGAIN * studies, WORST, False), (studies, None, True)):
        known = {line["cell"] for line in lines(file) if line["studies"] >= count}
        names = {line["cell"] for line in _worst(lines(file), studies)} if wanted else None
        for seed, cell in (every[place] for place in order):
            if time.process_time() > seconds:
                return
            own = names is None or cell.name in names
            if cell.name in known or not own or (cell.question == "logit") != slow:
                continue
            started = time.process_time()
            found = cell.run(count, seed)
            line = {"cell": cell.name, "question": cell.question, "people": cell.kind.people, "studies": count}
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps({**line, "found": found}) + "\n")
            print(cell.name, f"{time.process_time() - started:.1f} s", file=sys.stderr, flush=True)


def lines(file: Path) -> list[dict[str, Any]]:
    """Return the lines of a file, none of one that does not exist."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def _planned(line: Mapping[str, Any]) -> dict[str, float]:
    """Return how often each planned test of a cell errs, of those whose null is true."""
    return {
        name: one / _count(line)
        for name, (one, _) in line["found"].items()
        if not name.startswith(COMPARED) and not any(own in name for own in OWN_ROW)
    }


def _count(line: Mapping[str, Any]) -> int:
    """Return of how many studies a line is."""
    return math.ceil(line["studies"] / FITTED) if line["question"] == "logit" else int(line["studies"])


def _worst(of: Sequence[Mapping[str, Any]], studies: int) -> list[Mapping[str, Any]]:
    """Return the lines of so many studies in which a planned test errs most."""
    own = [one for one in of if one["studies"] == studies and one["question"] != "logit" and _planned(one)]
    return sorted(own, key=lambda one: -max(_planned(one).values()))[:WORST]


def _too_often(hits: int, of: int) -> bool:
    return hits > MOST * of and bool(stats.binomtest(hits, of).proportion_ci(CONFIDENT).low > MOST)


SEEN = 0.2
"""The power of the best test below which a ratio says nothing."""


def _ratios(line: Mapping[str, Any]) -> dict[str, float]:
    """Return the power of each test beside that of the best one of the same effect that does not err too often."""
    found: dict[str, tuple[int, int]] = line["found"]
    ratios = {}
    for name, (_, power) in found.items():
        group = name.rpartition(", ")[2] if line["question"] in ("logit", "equivalence") else ""
        family = "by Holm" in name
        rivals = [
            other
            for of, (one, other) in found.items()
            if not _too_often(one, _count(line))
            and (not group or of.rpartition(", ")[2] == group)
            and (line["question"] not in ("chance", "materials") or ("by Holm" in of) == family)
        ]
        if (best := max([power, *rivals])) > SEEN * _count(line):
            ratios[name] = power / best
    return ratios


def table(of: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return a row for each test: cells, how often it errs, and its least power beside the best by participants."""
    best = {line["cell"]: line for line in sorted(of, key=lambda line: line["studies"])}
    found: dict[str, list[tuple[Mapping[str, Any], float, bool]]] = {}
    ratios: dict[tuple[str, int], list[float]] = {}
    for line in best.values():
        for name, (one, _) in line["found"].items():
            found.setdefault(name, []).append((line, 100 * one / _count(line), _too_often(one, _count(line))))
        for name, ratio in _ratios(line).items():
            ratios.setdefault((name, line["people"]), []).append(ratio)
    rows = [["test", "cells", "studies", "errs: mean %", "most %", "where", "above 6 %", "below 3 %",
             *(f"least power beside the best: n = {n}" for n in SIZES), "cells below 0.9", "remark"]]  # fmt: skip
    for name, own in sorted(found.items(), key=lambda item: (item[0].startswith(COMPARED), item[0])):
        shares = [share for _, share, _ in own]
        most = max(own, key=lambda one: one[1])
        counts = sorted({_count(line) for line, _, _ in own})
        rows.append(
            [name, str(len(own)), "-".join(map(str, dict.fromkeys((counts[0], counts[-1])))),
             f"{np.mean(shares):.1f}", f"{most[1]:.1f}", str(most[0]["cell"]), str(sum(over for *_, over in own)),
             str(sum(share < 3 for share in shares)),
             *(f"{min(ratios[name, n]):.2f}" if (name, n) in ratios else "-" for n in SIZES),
             str(sum(one < 0.9 for n in SIZES for one in ratios.get((name, n), ()))),
             next((why for own, why in OWN_ROW.items() if own in name), "")]
        )  # fmt: skip
    return rows


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    place, *numbers = sys.argv[1:]
    asked, most = (*numbers, *("2000", "inf")[len(numbers) :])
    run(Path(place), int(asked), float(most))
    csv.writer(sys.stdout, lineterminator="\n").writerows(table(lines(Path(place))))
