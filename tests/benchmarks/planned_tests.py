"""Type I error of tests that can be planned: run `python -m tests.benchmarks.planned_tests [STUDIES [FITTED]]`.

SIMULATED studies of four materials, ten trials each, in two tasks that the same 4 to 40 participants do, who differ as
in `inference.py`. Of STUDIES a test errs in as many per cent as it rejects a true null in; a family errs where any of
its tests does, by Holm. FITTED studies have the logit, which takes longest, and a quarter of all the order of tasks,
whose ways to give either order are drawn from 15 participants on. Not a test.
"""

import sys
import time
import warnings
from collections.abc import Iterable, Iterator
from itertools import combinations
from unittest import mock

import numpy as np
from scipy.linalg import helmert

from palpate.analysis.identification.companion_tests import MARGIN, slopes_logit
from palpate.analysis.statistics import participants
from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.groups import difference_tests
from palpate.analysis.statistics.inference import holm
from palpate.analysis.statistics.participants import equivalence_tests, order_effect, repeated_tests
from palpate.analysis.statistics.sign_flips import sign_flip_tests
from tests.benchmarks.inference import (
    ALPHA,
    CHANCE,
    SHOWN,
    SPREADS,
    TRIALS,
    Counts,
    Spread,
    at_share,
    draw,
    matrices,
    mean_share,
)

SIZES = (4, 6, 10, 15, 25, 40)
ORDERS = 1999
"""So many orders are drawn, fewer than `analyse` draws, because each study draws anew."""

GROUPED = 0.6
"""Right answers of groups of which no one is better."""

Found = dict[str, dict[tuple[str, int], list[float]]]
"""Every P of each test, by spread and number of participants."""


def at_once(null: Counts, shown: Counts) -> Iterator[tuple[str, Floats]]:
    """Yield P of every study: `null` has all answers equally likely, in `shown` materials and tasks are alike."""
    guessed = np.diagonal(null[0], axis1=2, axis2=3)
    family = np.stack([sign_flip_tests(guessed[..., material], TRIALS, CHANCE) for material in range(4)])
    yield "sign flips against chance, one material", family[0]
    yield "sign flips against chance, any of 4 by Holm", holm(family).min(axis=0)
    right = np.diagonal(shown, axis1=3, axis2=4)
    one_task, gaps = right[0], right[0] - right[1]
    yield "sign flips between tasks", _signs(gaps.sum(axis=-1), 4 * TRIALS)
    pairs = np.stack([_signs(one_task[..., a] - one_task[..., b], TRIALS) for a, b in combinations(range(4), 2)])
    yield "sign flips between materials, any of 6 by Holm", holm(pairs).min(axis=0)
    yield "repeated measures, material in one task", repeated_tests(one_task / TRIALS @ helmert(4).T)[2]
    yield "repeated measures, material", repeated_tests((right[0] + right[1]) @ helmert(4).T)[2]
    yield "repeated measures, task x material", repeated_tests(gaps @ helmert(4).T)[2]


def _signs(gaps: Counts, most: int) -> Floats:
    """Return P of sign flips of differences: k of `most` is k + most of 2 most against a half."""
    return sign_flip_tests(gaps + most, 2 * most, CHANCE * 2)


def at_the_margin(
    spread: Spread, people: int, studies: int, random: np.random.Generator
) -> Iterator[tuple[str, Floats]]:
    """Yield P of equivalence in studies whose tasks, or pairs of materials, differ by exactly the margin.

    Where all wrong answers are as frequent, a share of right answers of p tells a pair apart by (4 p - 1) / 3.
    """
    share = mean_share(SHOWN, spread.whole)
    low, high = (at_share(share + step * MARGIN / 2, spread.whole) for step in (-1, 1))
    ratios = np.diagonal(draw(spread, people, studies, (low, high), random), axis1=3, axis2=4) / TRIALS
    gaps = ratios[0] - ratios[1]
    yield "equivalence of tasks, true difference the margin", equivalence_tests(gaps.mean(axis=-1), MARGIN)
    odds = at_share((1 + 3 * MARGIN) / 4, spread.whole)
    pair = draw(spread, people, studies, odds, random)[0, :, :, :2, :2] / TRIALS
    apart = (pair[..., 0, 0] - pair[..., 1, 0] + pair[..., 1, 1] - pair[..., 0, 1]) / 2
    yield "equivalence of a pair, told apart by the margin", equivalence_tests(apart, MARGIN)


def of_groups(spread: Spread, people: int, studies: int, random: np.random.Generator) -> Iterator[tuple[str, Floats]]:
    """Yield P of groups of one population, and of a third who differ as `spread` says beside others who are alike.

    Both groups are right in the same share on average.
    """
    third = max(2, people // 3)
    one, other = (
        np.diagonal(draw(own, people, studies, at_share(GROUPED, own.whole), random)[0], axis1=2, axis2=3).mean(axis=-1)
        for own in (spread, SPREADS[0])
    )
    yield "difference of groups, half in each", difference_tests(one[:, ::2], one[:, 1::2])
    yield "difference of groups, a third in one", difference_tests(one[:, :third], one[:, third:])
    yield "difference of groups, a third who differ", difference_tests(one[:, :third], other[:, third:])


def orders(shown: Counts, random: np.random.Generator) -> Iterator[float]:
    """Yield P of the order of tasks of each study, which adds nothing, where every other participant has either."""
    right = np.diagonal(shown, axis1=3, axis2=4).sum(axis=-1)
    for gaps in (right[0] - right[1]).tolist():
        try:
            yield order_effect(gaps[::2], gaps[1::2], random).p
        except NotDefined:
            yield 1.0


def logits(shown: Counts) -> Iterator[tuple[str, float]]:
    """Yield P of each term of the logit of each study; where it is not defined nothing is shown."""
    for study in np.moveaxis(shown, 1, 0):
        try:
            found = {one.name: one.p for one in slopes_logit(matrices(study)).terms}
        except NotDefined:
            found = {}
        yield from ((f"logit with participants, {name}", found.get(name, 1.0)) for name in ("task", "material"))


def measure(studies: int, fitted: int) -> Found:
    """Return P of each test in each study."""
    found: Found = {}

    def add(name: str, p: Iterable[float]) -> None:
        found.setdefault(name, {}).setdefault(key, []).extend(p)

    for s, spread in enumerate(SPREADS):
        for people in SIZES:
            key, random = (spread.name, people), np.random.default_rng([s, people, 39])
            null = draw(spread, people, studies, at_share(float(CHANCE), spread.whole), random)
            shown = draw(spread, people, studies, SHOWN, random)
            for name, p in (*at_once(null, shown), *at_the_margin(spread, people, studies, random)):
                add(name, p.tolist())
            # Draws of their own leave those of the other tests as they were.
            for name, p in of_groups(spread, people, studies, np.random.default_rng([s, people, 7])):
                add(name, p.tolist())
            with mock.patch.object(participants, "DRAWS", ORDERS):
                add("order of tasks", orders(shown[:, : studies // 4], random))
            for name, one in logits(shown[:, :fitted]):
                add(name, [one])
            print(*key, f"{time.process_time():.0f} s", file=sys.stderr, flush=True)
    return found


def table(found: Found) -> str:
    """Return how often P lies below alpha, in per cent, as Markdown."""
    keys = [(spread.name, people) for spread in SPREADS for people in SIZES]
    lines = [f"| nominal 5 % | studies | {' | '.join(f'{name} {n}' for name, n in keys)} |"]
    lines.append("|:--|--:" + "|--:" * len(keys) + "|")
    for name, own in found.items():
        shares = " | ".join(f"{100 * np.mean(np.array(own[key]) < ALPHA):.1f}" for key in keys)
        lines.append(f"| {name} | {len(own[keys[0]])} | {shares} |")
    return "\n".join(lines)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 4000
    models = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    print(table(measure(asked, models)))
