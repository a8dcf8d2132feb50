"""How often intervals of a mean share cover: run `python -m tests.benchmarks.intervals [STUDIES [PARTICIPANTS ...]]`.

SIMULATED studies of 2 to 40 participants with 10, 40 or unequal numbers of trials, whose shares have a mean of 0.5 to
0.99 and differ by a beta distribution or on the logit: 105 kinds for each number of participants. The true value is the
mean share of the population. The table has the least and the mean coverage of an interval, in per cent, over the kinds,
and its mean width. An end that is open is 0 or 1. Not a test.
"""

import sys
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
from scipy import stats

from palpate.analysis.statistics.exact import Floats, Integers
from palpate.analysis.statistics.shares import share_limits
from tests.benchmarks.inference import at_share

SIZES = (2, 3, 4, 5, 7, 10, 15, 25, 40)
MEANS = (0.5, 0.75, 0.9, 0.95, 0.99)
CORRELATIONS = (0.0, 0.05, 0.15, 0.4)
SDS = (0.5, 1.0, 2.0)
TRIALS = ((10,), (40,), (5, 10, 20, 40))
"""Each participant's trials, in turn."""

Ends = tuple[float, float]


@cache
def recommended(outcome: tuple[tuple[int, int], ...]) -> Ends:
    """The interval of these counts of these trials, in order."""
    right, trials = np.array(outcome).T
    found = share_limits(right, trials)
    return found.low or 0.0, 1.0 if found.high is None else found.high


@cache
def student(outcome: tuple[tuple[int, int], ...]) -> Ends:
    """Student's interval of the participants' shares."""
    right, trials = np.array(outcome).T
    shares = right / trials
    reach = stats.t.ppf(0.975, shares.size - 1) * stats.sem(shares)
    return float(shares.mean() - reach), float(shares.mean() + reach)


INTERVALS: dict[str, Callable[[tuple[tuple[int, int], ...]], Ends]] = {
    "over participants": recommended,
    "Student's t of shares": student,
}


def kinds(mean: float, people: int, studies: int, random: np.random.Generator) -> Iterator[Floats]:
    """Yield the shares of participants who differ in each way, shape (studies, people)."""
    for rho in CORRELATIONS:
        c = 1 / rho - 1 if rho else 0.0
        size = (studies, people)
        yield random.beta(mean * c, (1 - mean) * c, size) if rho else np.full(size, mean)
    for sd in SDS:
        odds = at_share(mean, sd)
        yield 1 / (1 + np.exp(-random.normal(odds, sd, (studies, people))))


def measure(people: int, studies: int) -> dict[str, list[tuple[float, float]]]:
    """Return the coverage and the mean width of each interval in each kind of study."""
    random = np.random.default_rng([people])
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in INTERVALS}
    for pattern in TRIALS:
        trials: Integers = np.resize(np.array(pattern, dtype=np.int64), people)
        for mean in MEANS:
            for shares in kinds(mean, people, studies, random):
                right = random.binomial(trials, shares)
                outcomes = [tuple(sorted(zip(row, trials.tolist(), strict=True))) for row in right.tolist()]
                for name, interval in INTERVALS.items():
                    ends = np.array([interval(outcome) for outcome in outcomes])
                    covered = (ends[:, 0] <= mean) & (mean <= ends[:, 1])
                    found[name].append((float(covered.mean()), float(np.diff(ends, axis=1).mean())))
    return found


if __name__ == "__main__":
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    print("| interval | participants | least | mean | width |\n|:--|--:|--:|--:|--:|")
    for size in [int(one) for one in sys.argv[2:]] or SIZES:
        for name, cells in measure(size, asked).items():
            covered, widths = np.array(cells).T
            print(f"| {name} | {size} | {100 * covered.min():.1f} | {100 * covered.mean():.1f} | {widths.mean():.2f} |")
        recommended.cache_clear()
        student.cache_clear()
        sys.stdout.flush()
