"""How often 95 % intervals cover: run `python -m tests.benchmarks.intervals FILE [STUDIES [SECONDS]]`.

SIMULATED studies of 4 to 40 participants who differ. Their true value is that of the population. FILE gets a line for
each cell, a kind of study with a number of participants; a cell that is in it is not run again, so that a run of so
many SECONDS of processor time goes on where the last one stopped. Cells come in a shuffled order, so that those run so
far are a sample of all; once all are run, the `WORST` are run again with ten times as many. At the end the table of all
cells in FILE is printed. An open end is 0 or 1. Not a test.

- share: 10, 40 or unequal numbers of trials; means of 0.5 to 0.99; a beta distribution or one on the logit;
- guessers: 2 to 30 % of people are right in a quarter of trials, the others equally often, in 0.9 to 0.99;
- difference: the same participants in two tasks, who differ in level and by task on the logit;
- information: four materials, 3 or 10 trials each, from guessing to 0.99 right, answers by Dirichlet distributions.

The interval of d' is that of the share, transformed, and covers as often. The intervals are those of
`statistics.shares`, of many studies at once, which `tests/analysis/statistics/test_many_intervals.py` compares.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import expit

from palpate.analysis.statistics.exact import Floats, Integers
from palpate.analysis.statistics.psychophysics.information import Information, information_limits, transmitted
from palpate.analysis.statistics.shares import Limits, may_guess, population_limits
from tests.benchmarks.inference import at_share
from tests.benchmarks.many_intervals import Ends, difference_ends, holds_any, modelled_ends, share_ends, student_ends

SIZES = (4, 7, 10, 15, 25, 40)
CHANCE = 0.25
HELD, CONFIDENT = 0.935, 0.99
"""A cell falls short if its own interval of this confidence lies below so much coverage."""

WORST, AGAIN = 25, 10
"""So many cells in which what is to cover covers least are run again, with so many times the studies."""

MEASURED = 20
"""The width of the interval for any population is that of so many studies a cell; it is slow to find."""

Drawn = Callable[[tuple[int, int], np.random.Generator], Floats]
"""Shares of participants, shape (studies, people)."""

Found = dict[str, tuple[int, float]]
"""How many studies each interval covers, and its mean width."""


@dataclass(frozen=True)
class Cell:
    """One kind of study with so many participants; `run` returns what each interval does."""

    quantity: str
    kind: str
    people: int
    run: Callable[[int, np.random.Generator], Found]

    @property
    def name(self) -> str:
        return f"{self.quantity}, {self.kind}, n = {self.people}"


def _closed(limits: Limits) -> tuple[float, float]:
    return limits.low or 0.0, 1.0 if limits.high is None else limits.high


def _covered(ends: Ends, truth: float) -> NDArray[np.bool_]:
    return np.asarray((ends[0] <= truth + 1e-12) & (truth - 1e-12 <= ends[1]))


def _counted(ends: Ends, truth: float) -> tuple[int, float]:
    return int(_covered(ends, truth).sum()), float((ends[1] - ends[0]).mean())


def _shares(
    drawn: Drawn, pattern: Sequence[int], mean: float, people: int, studies: int, random: np.random.Generator
) -> Found:
    trials: Integers = np.resize(np.array(pattern, dtype=np.int64), people)
    right = random.binomial(trials, drawn((studies, people), random))
    shares = right / trials
    over, anyone = share_ends(right, trials), holds_any(right, trials, mean)
    measured = [_closed(population_limits(row, trials)) for row in right[:MEASURED]]
    width = float(np.mean([high - low for low, high in measured]))
    found = {
        "over participants": _counted(over, mean),
        "any population": (int(anyone.sum()), width),
        "Student's t": _counted(student_ends(shares), mean),
    }
    if isinstance(drawn, partial) and drawn.func is _guessing:
        strange = may_guess(right, trials, CHANCE)
        first = np.where(strange, anyone, _covered(over, mean))
        own = [high - low for (low, high), odd in zip(measured, strange, strict=False) if odd]
        mixed = np.where(strange, np.mean(own) if own else width, over[1] - over[0])
        found["shown first"] = int(first.sum()), float(mixed.mean())
    return found


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
) -> Found:
    sd = math.hypot(level, by_task)
    trials: Integers = np.array([np.resize(np.array(one, dtype=np.int64), people) for one in patterns])
    odds = np.array([at_share(mean, sd) for mean in means])[:, None]
    own = odds + random.normal(0, level, (studies, 1, people)) + random.normal(0, by_task, (studies, 2, people))
    right = random.binomial(trials, expit(own))
    shares = right / trials
    truth = means[0] - means[1]
    return {
        "over participants": _counted(difference_ends(right, trials), truth),
        "Student's t": _counted(student_ends(shares[:, 0] - shares[:, 1]), truth),
    }


def _information(right: float, rho: float, each: int, people: int, studies: int, random: np.random.Generator) -> Found:
    shares = np.full((4, 4), (1 - right) / 3)
    np.fill_diagonal(shares, right)
    own = np.broadcast_to(shares, (studies, people, 4, 4))
    if rho:
        own = np.stack([random.dirichlet(row * (1 / rho - 1), (studies, people)) for row in shares], axis=2)
    counts = random.multinomial(each, own)
    hits = np.trace(counts, axis1=2, axis2=3)
    limits = np.transpose(modelled_ends(hits, np.full(people, 4 * each)))
    bits = transmitted(counts.sum(axis=1))
    ends = []
    for study, sent, (low, high) in zip(counts, bits.tolist(), limits.tolist(), strict=True):
        known = Information(4 * each * people, 2.0, sent, math.nan, math.nan)
        found = information_limits(study, known, (low, high))
        ends.append((found.low, found.high))
    truth = 2 + float((shares[0] * np.log2(shares[0])).sum())
    return {"over participants": _counted((np.array(ends)[:, 0], np.array(ends)[:, 1]), truth)}


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
    """Run the cells that the file lacks, then the worst again, until so many seconds of processor time are over."""
    every = list(enumerate(cells()))
    order = np.random.default_rng(1).permutation(len(every)).tolist()
    for count, wanted in ((studies, None), (AGAIN * studies, WORST)):
        known = {line["cell"] for line in lines(file) if int(str(line["studies"])) >= count}
        names = {str(line["cell"]) for line in _worst(lines(file), studies)} if wanted else None
        for seed, cell in (every[place] for place in order):
            if time.process_time() > seconds:
                return
            if cell.name in known or (names is not None and cell.name not in names):
                continue
            found = cell.run(count, np.random.default_rng([seed, count, 39]))
            line = {"cell": cell.name, "quantity": cell.quantity, "people": cell.people, "studies": count}
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps({**line, "found": found}) + "\n")


def promised(line: dict[str, object]) -> str:
    """Return the name of the interval that is to cover in a cell; where some only guess none over participants can."""
    return "any population" if line["quantity"] == "guessers" else "over participants"


def _worst(of: Sequence[dict[str, object]], studies: int) -> list[dict[str, object]]:
    """Return the lines of so many studies in which what is to cover covers least."""
    own = [line for line in of if studies <= int(str(line["studies"])) < AGAIN * studies]
    return sorted(own, key=lambda line: line["found"][promised(line)][0] / line["studies"])[:WORST]  # type: ignore[index]


def lines(file: Path) -> list[dict[str, object]]:
    """Return the lines of a file, none of one that does not exist."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def table(of: Sequence[dict[str, object]]) -> str:
    """Return coverage by quantity, interval and participants: cells, studies, least, mean, width, and what falls short.

    A cell falls short where even its Clopper-Pearson interval of 99 % lies below 93.5 %. Of a cell that was run again
    the larger number of studies counts.
    """
    best: dict[str, dict[str, object]] = {}
    for line in sorted(of, key=lambda line: int(str(line["studies"]))):
        best[str(line["cell"])] = line
    whole: dict[tuple[str, int], int] = {}
    for cell in cells():
        whole[cell.quantity, cell.people] = whole.get((cell.quantity, cell.people), 0) + 1
    rows = ["| quantity | interval | n | cells | studies a cell | least | mean | width | short of 93.5 % |",
            "|:--|:--|--:|--:|--:|--:|--:|--:|--:|"]  # fmt: skip
    groups: dict[tuple[str, str, int], list[tuple[int, int, float]]] = {}
    for line in best.values():
        for name, (hits, width) in line["found"].items():  # type: ignore[attr-defined]
            key = str(line["quantity"]), name, int(str(line["people"]))
            groups.setdefault(key, []).append((hits, int(str(line["studies"])), width))
    for (quantity, name, people), found in sorted(groups.items()):
        hits, of_cell, widths = np.array(found).T
        short = sum(
            stats.binomtest(int(one), int(each)).proportion_ci(CONFIDENT).high < HELD
            for one, each in zip(hits, of_cell, strict=True)
        )
        shares = 100 * hits / of_cell
        rows.append(
            f"| {quantity} | {name} | {people} | {len(found)} of {whole[quantity, people]} | {of_cell.min():.0f} | "
            f"{shares.min():.1f} | {shares.mean():.1f} | {widths.mean():.2f} | {short} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    place, *numbers = sys.argv[1:]
    asked, most = (*numbers, *("2000", "inf")[len(numbers) :])
    run(Path(place), int(asked), float(most))
    print(table(lines(Path(place))))
