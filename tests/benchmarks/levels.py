"""Levels that follow from answers: run `python -m tests.benchmarks.levels [SESSIONS]`.

How long the next level takes by QUEST+ and psi on a grid with slope and lapse free, from the answer on, by the clock
and of the processor. Then SIMULATED observers of a known threshold, with four spreads and lapses of 0 to 5 %: bias and
SD of the threshold by the rule, and by a second simulation of it that knows neither states nor information, with the
same random numbers; and how often the interval of the psychometric fit of a session holds the true threshold. Not a
test: it asserts nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from itertools import pairwise, product
from math import log10, sqrt
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from palpate.analysis.statistics.psychophysics.psychometric import fit
from palpate.experiment.protocol.models import Levels
from palpate.experiment.study.levels import psi
from palpate.experiment.study.levels.quest_plus import QuestPlus
from palpate.experiment.study.levels.up_down import UpDown

Array = NDArray[np.float64]

GRID = tuple(round(10 ** (db / 20), 6) for db in range(-40, 1, 2))
THRESHOLD_DB, GUESS, TRIALS = -19.0, 0.5, 60
SPREADS_DB, LAPSES = (1.5, 3.0, 6.0, 12.0), (0.0, 0.02, 0.05)

EXPECTED = Levels(
    method="quest-plus",
    grid=GRID,
    thresholds=tuple(round(10 ** (db / 20), 6) for db in range(-39, 0)),
    spreads_db=(1.0, 1.5, 2.0, 3.0, 4.5, 6.0, 9.0, 12.0),
    lapses=(0.0, 0.02, 0.04, 0.06),
    guess=GUESS,
)
STAIRCASE = Levels(method="up-down", grid=GRID, first=1.0, down=2, reversals=100, steps=(4, 2, 1))
WEIGHTED = Levels(method="up-down", grid=GRID, first=1.0, down=1, up=3, reversals=100, steps=(2, 1))


def chance_right(level: float, spread_db: float, lapse: float) -> float:
    return GUESS + (1 - GUESS - lapse) * NormalDist().cdf((20 * log10(level) - THRESHOLD_DB) / spread_db)


Session = tuple[list[float], list[bool]]
"""Levels and answers."""


def by_method(method: Any, draws: Array, spread_db: float, lapse: float) -> Session:
    state = method.init()
    levels, right = [], []
    for draw in draws:
        level = method.level(state)
        assert level is not None
        levels.append(level)
        right.append(bool(draw < chance_right(level, spread_db, lapse)))
        state = method.step(state, level=level, right=right[-1])
    return levels, right


def up_down_again(rule: Levels, draws: Array, spread_db: float, lapse: float) -> Session:
    """The same rule as a loop over the whole record, with no state."""
    levels: list[float] = []
    right: list[bool] = []
    places = [rule.grid.index(rule.first or 0.0)]
    moves: list[int] = []
    run = 0
    for draw in draws:
        levels.append(rule.grid[places[-1]])
        right.append(bool(draw < chance_right(levels[-1], spread_db, lapse)))
        run = run + 1 if right[-1] else 0
        move = 1 if not right[-1] else -1 if run == rule.down else 0
        if move:
            moves, run = [*moves, move], 0
            turns = sum(one != other for one, other in pairwise(moves))
            size = (rule.steps or (1,))[min(turns, len(rule.steps or (1,)) - 1)]
            move *= size * ((rule.up or 1) if move > 0 else 1)
        places.append(min(max(places[-1] + move, 0), len(rule.grid) - 1))
    return levels, right


def quest_again(rule: Levels, draws: Array, spread_db: float, lapse: float) -> Session:
    """The same rule by entropies of posteriors written out, multiplied answer by answer."""
    cells = np.array(list(product(rule.thresholds or (), rule.spreads_db or (), rule.lapses or ())))
    x = 20 * np.log10(np.array(rule.grid))[:, None]
    share = GUESS + (1 - GUESS - cells[:, 2]) * ndtr((x - 20 * np.log10(cells[:, 0])) / cells[:, 1])
    known = np.full(len(cells), 1 / len(cells))
    levels: list[float] = []
    right: list[bool] = []
    for draw in draws:
        expected = np.zeros(len(rule.grid))
        for of in (share, 1 - share):
            joint = known * of
            total = joint.sum(axis=1)
            after = joint / total[:, None]
            expected -= total * (after * np.log(np.maximum(after, 1e-300))).sum(axis=1)
        place = int(np.argmax(expected <= expected.min() + 1e-9))
        levels.append(rule.grid[place])
        right.append(bool(draw < chance_right(levels[-1], spread_db, lapse)))
        known = known * (share if right[-1] else 1 - share)[place]
        known /= known.sum()
    return levels, right


def fitted(session: Session) -> tuple[float, bool]:
    """The threshold of a session by its fit, dB, and whether the interval holds the true one."""
    levels, right = (np.array(one) for one in session)
    of = [levels == level for level in GRID]
    found = fit(
        20 * np.log10(np.array(GRID)),
        np.array([float(right[one].sum()) for one in of]),
        np.array([float(one.sum()) for one in of]),
        guess=GUESS,
    ).threshold
    return found.value, found.low <= THRESHOLD_DB <= found.high


def next_levels(method: QuestPlus, trials: int) -> Array:
    """From an answer to the next level, ms, by the clock and of the processor, shape (2, trials)."""
    rng, took = np.random.default_rng(1), []
    state = method.init()
    method.level(state)
    for trial in range(trials):
        if trial % 100 == 0:
            state = method.init()
        level = method.level(state) or GRID[-1]
        begun, used = time.perf_counter(), time.thread_time()
        state = method.step(state, level=level, right=bool(rng.random() < chance_right(level, 3.0, 0.02)))
        method.level(state)
        took.append((1e3 * (time.perf_counter() - begun), 1e3 * (time.thread_time() - used)))
    return np.array(took).T


RULES: dict[str, tuple[Any, Callable[[Levels, Array, float, float], Session]]] = {
    "2 down 1 up": (UpDown(STAIRCASE), up_down_again),
    "weighted 1:3": (UpDown(WEIGHTED), up_down_again),
    "QUEST+": (QuestPlus(EXPECTED), quest_again),
}


def main(sessions: int) -> None:
    for name, method in (("QUEST+", QuestPlus(EXPECTED)), ("psi", psi.method(EXPECTED))):
        for by, took in zip(("the clock", "the processor"), next_levels(method, 2000), strict=True):
            p99 = np.quantile(took, 0.99)
            print(f"next level by {name}, ms of {by}: median {np.median(took):.2f}, 99 % within {p99:.2f}")
    print(f"SIMULATED: {sessions} sessions of {TRIALS} trials, threshold {THRESHOLD_DB:g} dB, guess {GUESS:g}")
    print("rule          spread  lapse    bias     SD   again: bias     SD   in interval")
    for (name, (rule, again)), spread_db, lapse in product(RULES.items(), SPREADS_DB, LAPSES):
        found, repeated, held = [], [], 0
        for seed in range(sessions):
            draws = np.random.default_rng((seed, int(10 * spread_db), int(100 * lapse))).random(TRIALS)
            one, other = by_method(rule, draws, spread_db, lapse), again(rule.levels, draws, spread_db, lapse)
            value, inside = fitted(one)
            found.append(value)
            held += inside
            repeated.append(value if one == other else fitted(other)[0])
        own, second = (np.array(of) - THRESHOLD_DB for of in (found, repeated))
        share, error = held / sessions, sqrt(held * (sessions - held) / sessions**3)
        print(
            f"{name:13} {spread_db:5.1f}  {lapse:5.2f}  {own.mean():+6.2f} {own.std(ddof=1):6.2f}"
            f"   {second.mean():+11.2f} {second.std(ddof=1):6.2f}   {100 * share:.0f} % (± {100 * error:.0f})"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
