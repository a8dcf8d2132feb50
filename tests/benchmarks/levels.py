"""Levels that follow from answers: run `python -m tests.benchmarks.levels [FILE] [SESSIONS]`.

How long the next level takes by QUEST+ and psi on a grid with slope and lapse free, from the answer on, by the clock
and of the processor. Then SIMULATED observers of a known threshold, with four spreads and lapses of 0 to 5 %: bias and
SD of the fitted threshold; how many of the first 20 sessions have the same levels in a second simulation of the rule
that knows neither states nor information, with the same random numbers; and how often the interval of the fit holds the
true threshold. A row is appended to the file for each cell that it has not yet: stop and start as you like. Not a test:
it asserts nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from itertools import pairwise, product
from math import log10
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from palpate.analysis.statistics.inference import CONFIDENCE, wilson
from palpate.analysis.statistics.psychophysics.psychometric import COARSE, FINE, MOST_LAPSES, OF_LAPSES, fit
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


def counted(session: Session) -> tuple[Array, Array]:
    """Return right answers and trials at each level of the grid."""
    levels, right = (np.array(one) for one in session)
    of = [levels == level for level in GRID]
    return np.array([float(right[one].sum()) for one in of]), np.array([float(one.sum()) for one in of])


X_DB = 20 * np.log10(np.array(GRID))
STEP_DB, BATCH = 0.5, 50
THRESHOLDS_DB, LOG_SPREADS = np.arange(-60.0, 20.01, STEP_DB), np.linspace(np.log(0.4), np.log(100.0), 51)
HALF = (LOG_SPREADS[1] - LOG_SPREADS[0]) / 2
MISSED = np.linspace(0, MOST_LAPSES, COARSE[2])


def intervals(sessions: Sequence[Session]) -> Array:
    """Return median, low and high limit of the threshold of each session, dB, shape (3, sessions).

    As `psychometric.fit` has them, on one grid for all sessions instead of two for each.
    """
    z = (X_DB[:, None, None] - THRESHOLDS_DB[:, None]) / np.exp(LOG_SPREADS)
    share = (GUESS + (1 - GUESS - MISSED) * ndtr(z)[..., None]).reshape(len(GRID), -1)
    right, wrong = np.log(share), np.log(np.maximum(1 - share, 1e-300))
    prior = (OF_LAPSES - 1) * np.log1p(-MISSED)
    edges = np.append(THRESHOLDS_DB, THRESHOLDS_DB[-1] + STEP_DB) - STEP_DB / 2
    cells = np.append(LOG_SPREADS - HALF, LOG_SPREADS[-1] + HALF)
    found = []
    for first in range(0, len(sessions), BATCH):
        counts = [counted(one) for one in sessions[first : first + BATCH]]
        hits, every = (np.array(of) for of in zip(*counts, strict=True))
        logs = (hits @ right + (every - hits) @ wrong).reshape(len(hits), len(THRESHOLDS_DB), len(LOG_SPREADS), -1)
        for log, trials in zip(logs + prior, every, strict=True):
            used = X_DB[trials > 0]
            span, ends = float(np.ptp(used)), (np.log(np.diff(used).min() / 4), np.log(2 * np.ptp(used)))
            # What of each cell is between the bounds, and half a step of `fit` beyond them.
            beyond = (ends[1] - ends[0]) / (FINE[1] - 1) / 2
            inside = np.diff(np.clip(cells, ends[0] - beyond, ends[1] + beyond))
            weight = np.exp(log - log.max()).sum(axis=2) @ inside
            weight[(used.min() - span / 2 > THRESHOLDS_DB) | (used.max() + span / 2 < THRESHOLDS_DB)] = 0
            below = np.append(0.0, np.cumsum(weight)) / weight.sum()
            found.append(np.interp([0.5, (1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], below, edges))
    return np.array(found).T


def off_fit(sessions: Sequence[Session]) -> float:
    """Return by how much a limit or a median of some sessions is off that of their own fits, dB, at most."""
    own = [fit(X_DB, *counted(one), guess=GUESS).threshold for one in sessions]
    return float(np.abs(intervals(sessions) - np.array([(one.value, one.low, one.high) for one in own]).T).max())


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


COLUMNS = (
    "rule,spread_db,lapse,sessions,bias_db,sd_db,same_tracks_of_20,off_fit_db,held,coverage,coverage_low,coverage_high"
)
AGAIN = 20
"""So many sessions of a cell are simulated by the second simulation, and fitted one by one, too."""


def cell(name: str, spread_db: float, lapse: float, sessions: int) -> str:
    """Return a row of the table: sessions of one rule and observer, each fitted."""
    rule, again = RULES[name]
    every, same = list[Session](), 0
    for seed in range(sessions):
        draws = np.random.default_rng((seed, int(10 * spread_db), int(100 * lapse))).random(TRIALS)
        every.append(by_method(rule, draws, spread_db, lapse))
        if seed < AGAIN:
            same += every[-1] == again(rule.levels, draws, spread_db, lapse)
    value, low, high = intervals(every)
    off, held = value - THRESHOLD_DB, int(((low <= THRESHOLD_DB) & (high >= THRESHOLD_DB)).sum())
    share = wilson(held, sessions)
    of_fit = f"{off.mean():.3f},{off.std(ddof=1):.3f},{same},{off_fit(every[:AGAIN]):.3f},{held}"
    covers = f"{held / sessions:.4f},{share.low:.4f},{share.high:.4f}"
    return f"{name},{spread_db:g},{lapse:g},{sessions},{of_fit},{covers}"


def main(file: Path | None, sessions: int) -> None:
    for name, method in (("QUEST+", QuestPlus(EXPECTED)), ("psi", psi.method(EXPECTED))):
        for by, took in zip(("the clock", "the processor"), next_levels(method, 2000), strict=True):
            p99 = np.quantile(took, 0.99)
            print(f"next level by {name}, ms of {by}: median {np.median(took):.2f}, 99 % within {p99:.2f}")
    print(f"SIMULATED: sessions of {TRIALS} trials, threshold {THRESHOLD_DB:g} dB, guess {GUESS:g}")
    rows = file.read_text("utf-8").splitlines() if file is not None and file.exists() else [COLUMNS]
    done = {tuple(row.split(",")[:4]) for row in rows}
    for name, spread_db, lapse in product(RULES, SPREADS_DB, LAPSES):
        if (name, f"{spread_db:g}", f"{lapse:g}", str(sessions)) in done:
            continue
        rows.append(cell(name, spread_db, lapse, sessions))
        print(rows[-1], flush=True)
        if file is not None:
            file.write_text("\n".join(rows) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None, int(sys.argv[2]) if len(sys.argv) > 2 else 100)
