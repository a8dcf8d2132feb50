"""How often 95 % intervals cover: run `python -m tests.benchmarks.intervals FILE [STUDIES [SECONDS]]`.

SIMULATED studies of 4 to 40 participants who differ. Their true value is that of the population. FILE gets a line for
each cell, a kind of study with a number of participants; a cell that is in it is not run again, so that a run of so
many SECONDS of processor time goes on where the last one stopped. Cells come in a shuffled order, so that those run so
far are a sample of all. At the end the table of all cells in FILE is printed. An open end is 0 or 1. Not a test.

- share: 10, 40 or unequal numbers of trials; means of 0.5 to 0.99; a beta distribution or one on the logit;
- guessers: 2 to 30 % of people are right in a quarter of trials, the others equally often, in 0.9 to 0.99;
- difference: the same participants in two tasks, who differ in level and by task on the logit;
- information: four materials, 3 or 10 trials each, from guessing to 0.99 right, answers by Dirichlet distributions.

The interval of d' is that of the share, transformed, and covers as often.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.special import expit

from palpate.analysis.identification.confusion import information, information_limits
from palpate.analysis.statistics.exact import Floats, Integers
from palpate.analysis.statistics.shares import (
    Limits,
    difference_limits,
    first_limits,
    modelled,
    population_limits,
    share_limits,
)
from tests.benchmarks.inference import at_share

SIZES = (4, 7, 10, 15, 25, 40)
CHANCE = 0.25
HELD, CONFIDENT = 0.935, 0.99
"""A cell falls short if its own interval of this confidence lies below so much coverage."""

Ends = tuple[float, float]
Drawn = Callable[[tuple[int, int], np.random.Generator], Floats]
"""Shares of participants, shape (studies, people)."""

Outcome = tuple[tuple[int, int], ...]
"""Right answers and trials of each participant, in order."""


@dataclass(frozen=True)
class Cell:
    """One kind of study with so many participants; `run` returns the ends of each interval, and the truth."""

    quantity: str
    kind: str
    people: int
    run: Callable[[int, np.random.Generator], tuple[dict[str, list[Ends]], float]]

    @property
    def name(self) -> str:
        return f"{self.quantity}, {self.kind}, n = {self.people}"


def _closed(limits: Limits) -> Ends:
    return limits.low or 0.0, 1.0 if limits.high is None else limits.high


@cache
def _share(outcome: Outcome, guessers: bool) -> dict[str, Ends]:
    right, trials = np.array(outcome).T
    shares = right / trials
    reach = stats.t.ppf(0.975, shares.size - 1) * stats.sem(shares)
    found = {
        "over participants": _closed(share_limits(right, trials)),
        "any population": _closed(population_limits(right, trials)),
        "Student's t": (float(shares.mean() - reach), float(shares.mean() + reach)),
    }
    return {**found, "shown first": _closed(first_limits(right, trials, CHANCE))} if guessers else found


def _shares(
    drawn: Drawn,
    pattern: Sequence[int],
    mean: float,
    people: int,
    studies: int,
    random: np.random.Generator,
) -> tuple[dict[str, list[Ends]], float]:
    trials: Integers = np.resize(np.array(pattern, dtype=np.int64), people)
    right = random.binomial(trials, drawn((studies, people), random))
    guessers = isinstance(drawn, partial) and drawn.func is _guessing
    found = [_share(tuple(sorted(zip(row, trials.tolist(), strict=True))), guessers) for row in right.tolist()]
    _share.cache_clear()
    return {name: [one[name] for one in found] for name in found[0]}, mean


def _beta(mean: float, rho: float, size: tuple[int, int], random: np.random.Generator) -> Floats:
    c = 1 / rho - 1 if rho else 0.0
    return random.beta(mean * c, (1 - mean) * c, size) if rho else np.full(size, mean)


def _normal(mean: float, sd: float, size: tuple[int, int], random: np.random.Generator) -> Floats:
    return np.asarray(expit(random.normal(at_share(mean, sd), sd, size)))


def _guessing(good: float, part: float, size: tuple[int, int], random: np.random.Generator) -> Floats:
    return np.where(random.random(size) < part, CHANCE, good)


def _differences(
    means: tuple[float, float],
    level: float,
    by_task: float,
    patterns: Sequence[Sequence[int]],
    people: int,
    studies: int,
    random: np.random.Generator,
) -> tuple[dict[str, list[Ends]], float]:
    sd = math.hypot(level, by_task)
    trials: Integers = np.array([np.resize(np.array(one, dtype=np.int64), people) for one in patterns])
    odds = np.array([at_share(mean, sd) for mean in means])[:, None]
    found: dict[str, list[Ends]] = {"over participants": [], "Student's t": []}
    for _ in range(studies):
        own = odds + random.normal(0, level, people) + random.normal(0, by_task, (2, people))
        right = random.binomial(trials, expit(own))
        gaps = right[0] / trials[0] - right[1] / trials[1]
        limits = difference_limits(right, trials, gaps)
        found["over participants"].append((limits.low or 0.0, limits.high or 0.0))
        reach = stats.t.ppf(0.975, people - 1) * stats.sem(gaps)
        found["Student's t"].append((float(gaps.mean() - reach), float(gaps.mean() + reach)))
    return found, means[0] - means[1]


def _information(
    right: float, rho: float, each: int, people: int, studies: int, random: np.random.Generator
) -> tuple[dict[str, list[Ends]], float]:
    shares = np.full((4, 4), (1 - right) / 3)
    np.fill_diagonal(shares, right)
    bits = 2 + float((shares[0] * np.log2(shares[0])).sum())
    ends = []
    for _ in range(studies):
        own = np.tile(shares, (people, 1, 1))
        if rho:
            own = np.stack([random.dirichlet(row * (1 / rho - 1), people) for row in shares], axis=1)
        counts = random.multinomial(each, own)
        hits, trials = np.trace(counts, axis1=1, axis2=2), np.full(people, 4 * each)
        found = information_limits(counts, information(counts.sum(axis=0)), modelled(hits, trials))
        ends.append((found.low, found.high))
    return {"over participants": ends}, bits


def cells() -> Iterator[Cell]:
    """Yield every cell of the grid."""
    patterns = ((10,), (40,), (5, 10, 20, 40))
    for n in SIZES:
        for trials in patterns:
            of = f"{' '.join(map(str, trials))} trials"
            for mean in (0.5, 0.75, 0.9, 0.95, 0.99):
                spreads: list[tuple[str, Drawn]] = [
                    *((f"beta {rho}", partial(_beta, mean, rho)) for rho in (0.0, 0.05, 0.15, 0.4)),
                    *((f"logit {sd}", partial(_normal, mean, sd)) for sd in (0.5, 1.0, 2.0)),
                ]
                for name, drawn in spreads:
                    yield Cell("share", f"{mean}, {name}, {of}", n, partial(_shares, drawn, trials, mean, n))
            for good in (0.9, 0.95, 0.99):
                for part in (0.02, 0.05, 0.1, 0.3):
                    drawn, mean = partial(_guessing, good, part), (1 - part) * good + part * CHANCE
                    yield Cell("guessers", f"{part} of {good}, {of}", n, partial(_shares, drawn, trials, mean, n))
        for means in ((0.5, 0.5), (0.5, 0.75), (0.75, 0.75), (0.75, 0.95), (0.95, 0.95), (0.95, 0.99), (0.99, 0.99)):
            for level, by_task in ((0.0, 0.0), (1.0, 0.0), (0.5, 0.8), (1.0, 1.5)):
                for both in (((10,), (10,)), ((10,), (40,)), ((5, 10, 20, 40), (5, 10, 20, 40))):
                    kind = f"{means}, SD {level} and {by_task}, {both} trials"
                    yield Cell("difference", kind, n, partial(_differences, means, level, by_task, both, n))
        for share in (0.25, 0.5, 0.75, 0.9, 0.99):
            for rho in (0.0, 0.05, 0.15, 0.3):
                for each in (3, 10):
                    kind = f"{share}, Dirichlet {rho}, {each} trials"
                    yield Cell("information", kind, n, partial(_information, share, rho, each, n))


def run(file: Path, studies: int, seconds: float) -> None:
    """Run the cells that the file lacks, until so many seconds of processor time are over."""
    known = {line["cell"] for line in _lines(file)}
    every = list(enumerate(cells()))
    for place in np.random.default_rng(1).permutation(len(every)).tolist():
        if time.process_time() > seconds:
            return
        seed, cell = every[place]
        if cell.name in known:
            continue
        found, truth = cell.run(studies, np.random.default_rng([seed, 39]))
        with file.open("a", encoding="utf-8") as out:
            line = {"cell": cell.name, "quantity": cell.quantity, "people": cell.people, "studies": studies}
            out.write(
                json.dumps({**line, "found": {name: _covered(ends, truth) for name, ends in found.items()}}) + "\n"
            )


def _covered(ends: Sequence[Ends], truth: float) -> tuple[int, float]:
    """Return how often the intervals hold the truth, and their mean width."""
    low, high = np.array(ends).T
    return int(((low <= truth + 1e-12) & (truth - 1e-12 <= high)).sum()), float((high - low).mean())


def _lines(file: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def table(lines: Sequence[dict[str, object]]) -> str:
    """Return coverage by quantity, interval and participants: cells, studies, least, mean, width, and what falls short.

    A cell falls short where even its Clopper-Pearson interval of 99 % lies below 93.5 %.
    """
    whole: dict[tuple[str, int], int] = {}
    for cell in cells():
        whole[cell.quantity, cell.people] = whole.get((cell.quantity, cell.people), 0) + 1
    rows = ["| quantity | interval | n | cells | studies a cell | least | mean | width | short of 93.5 % |",
            "|:--|:--|--:|--:|--:|--:|--:|--:|--:|"]  # fmt: skip
    groups: dict[tuple[str, str, int], list[tuple[int, int, float]]] = {}
    for line in lines:
        for name, (hits, width) in line["found"].items():  # type: ignore[attr-defined]
            key = str(line["quantity"]), name, int(str(line["people"]))
            groups.setdefault(key, []).append((hits, int(str(line["studies"])), width))
    for (quantity, name, people), found in sorted(groups.items()):
        hits, of, widths = np.array(found).T
        short = sum(
            stats.binomtest(int(one), int(each)).proportion_ci(CONFIDENT).high < HELD
            for one, each in zip(hits, of, strict=True)
        )
        shares = 100 * hits / of
        rows.append(
            f"| {quantity} | {name} | {people} | {len(found)} of {whole[quantity, people]} | {of.min():.0f} | "
            f"{shares.min():.1f} | {shares.mean():.1f} | {widths.mean():.2f} | {short} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    place, *numbers = sys.argv[1:]
    asked, most = (*numbers, *("2000", "inf")[len(numbers) :])
    run(Path(place), int(asked), float(most))
    print(table(_lines(Path(place))))
