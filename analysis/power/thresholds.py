"""How far thresholds are off: whole tracks of SIMULATED observers by a protocol's own rule of levels, each analysed.

An observer's threshold lies amid the levels, off any of them, and is known. `palpate power` shows bias and SD of the
threshold by the rule and by the fit, at four slopes and three shares of lapses, and how often the interval of the fit
holds the threshold, and how many participants their mean needs; `palpate plan` warns of a bias by the rule. The rule is
lent by the caller: it is the session's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import count
from math import hypot, sqrt
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.special import ndtri, stdtrit

from palpate.analysis.designs.detection import results
from palpate.analysis.documents import page
from palpate.analysis.documents.output import publish
from palpate.analysis.documents.tables import Column, Record, Section, tabulate
from palpate.analysis.documents.tables import text as in_terminal
from palpate.analysis.power.simulate import LABEL, on_cores
from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.inference import ConfidenceInterval, wilson
from palpate.analysis.statistics.psychophysics.psychometric import fit, psychometric
from palpate.experiment.errors import Finding, PowerError
from palpate.experiment.protocol.designs.detection import Detection
from palpate.experiment.protocol.models import Levels, Task
from palpate.experiment.protocol.models import Protocol as StudyProtocol

SPREADS_DB, LAPSES = (1.5, 3.0, 6.0, 12.0), (0.0, 0.02, 0.05)
"""Slopes, as dB from the threshold to 84 %, and shares of lapses of the simulated observers; ours."""

FALSE_ALARMS = 0.05
"""A simulated observer says yes without a signal so often; ours."""

BETWEEN_DB, WITHIN_DB = 5.0, 3.0
"""The SD of thresholds among people, and how near to their mean its 95 % interval is to keep; ours."""

SESSIONS, QUICK = 100, 40
"""Sessions of each observer that are simulated unless told, and those for a warning; ours."""

WARNED_DB = 1.0
"""A bias above it is warned of."""


class Rule(Protocol):
    """How the levels of one track follow from its answers, as a session has it."""

    def init(self) -> Any: ...
    def step(self, state: Any, *, level: float, right: bool) -> Any: ...
    def level(self, state: Any) -> float | None: ...


@dataclass(frozen=True)
class Observer:
    """One observer in one task: bias and SD, dB, of the thresholds by the rule and by the fit, over its sessions.

    The bias by the rule is of the `ruled` sessions that it gives a threshold, from the level at which the share of
    right answers is that of the rule. `held` of the `fitted` sessions have the threshold in the fit's interval;
    `beyond` have none, for the track stayed at an end.
    """

    task: str
    spread_db: float
    lapse: float
    sessions: int
    trials: float
    ruled: int
    rule_bias_db: float | None
    rule_sd_db: float | None
    fit_bias_db: float | None
    fit_sd_db: float | None
    fitted: int
    held: int
    beyond: int

    @property
    def coverage(self) -> float | None:
        """Return the share of intervals that hold the threshold."""
        return self.held / self.fitted if self.fitted else None

    @property
    def coverage_interval(self) -> ConfidenceInterval | None:
        """Return Wilson's interval of it: its Monte Carlo error."""
        return wilson(self.held, self.fitted) if self.fitted else None

    @property
    def needed(self) -> int | None:
        """Return how many participants have a mean threshold by the fit within `WITHIN_DB`."""
        return None if self.fit_sd_db is None else people_for(hypot(BETWEEN_DB, self.fit_sd_db), WITHIN_DB)


def people_for(sd: float, within: float) -> int:
    """Return the fewest people whose mean has a 95 % interval of Student's t that reaches at most so far."""
    return next(n for n in count(2) if float(stdtrit(n - 1, 0.975)) * sd / sqrt(n) <= within)


@dataclass(frozen=True)
class Thresholds:
    """Every observer of every task with levels."""

    study: str
    seed: int
    observers: tuple[Observer, ...]


def _share(coverage: float | None, low: float | None, high: float | None) -> str:
    return "-" if coverage is None or low is None or high is None else f"{coverage:.3f} ({low:.3f}-{high:.3f})"


COLUMNS = (
    Column("task", left=True), Column("spread_db", "spread dB", 1), Column("lapse", decimals=2), Column("sessions"),
    Column("trials", decimals=0), Column("rule_bias_db", "rule: bias dB", 2), Column("rule_sd_db", "SD", 2),
    Column("fit_bias_db", "fit: bias dB", 2), Column("fit_sd_db", "SD", 2),
    Column(("coverage", "coverage_low", "coverage_high"), "in interval", show=_share),
    Column("beyond", "no threshold"), Column("needed", "n"),
)  # fmt: skip


def run(
    protocol: StudyProtocol,
    rules: Mapping[str, Rule],
    *,
    sessions: int = SESSIONS,
    seed: int = 1,
    jobs: int = 0,
    total: Callable[[int], None] = lambda _: None,
    tick: Callable[[], None] = lambda: None,
) -> Thresholds:
    """Return bias, SD and coverage for every task of which there is a rule, by its id; `jobs` as of `on_cores`.

    Raises `PowerError` for less than one session, or a worker that was ended.
    """
    if sessions < 1:
        raise PowerError("--studies", f"got {sessions}", "give more", allowed="1 or more")
    work = [
        partial(_observer, protocol, task, rules[task.id], spread_db, lapse, sessions, seed)
        for task in protocol.tasks
        if task.id in rules
        for spread_db in SPREADS_DB
        for lapse in LAPSES
    ]
    total(len(work))
    found: dict[int, Observer] = {}
    for place, one in on_cores(_done, work, jobs):
        found[place] = one
        tick()
    return Thresholds(protocol.study.id, seed, tuple(found[place] for place in range(len(work))))


def _done(work: Callable[[], Observer]) -> Observer:
    return work()


def doubts(protocol: StudyProtocol, rules: Mapping[str, Rule]) -> Iterator[Finding]:
    """Yield each task whose rule of levels is off by more than `WARNED_DB` for an observer without many lapses.

    Or which gives a threshold in less than half of the sessions. Constant stimuli have no such rule.
    """
    for task in (one for one in protocol.tasks if one.id in rules and _levels(one).method != "constant"):
        off = [
            _observer(protocol, task, rules[task.id], spread_db, LAPSES[1], QUICK, 1, fits=False)
            for spread_db in SPREADS_DB
        ]
        if 2 * (least := min(one.ruled for one in off)) < QUICK:
            yield Finding(
                f"task {task.id}: the rule of the levels gives a threshold in {least} of {QUICK} SIMULATED sessions",
                remedy="use more trials, or levels farther apart; `palpate power` shows every observer",
                verdict="warns",
            )
            continue
        worst = max(off, key=lambda one: abs(one.rule_bias_db or 0.0))
        if abs(bias_db := worst.rule_bias_db or 0.0) > WARNED_DB:
            yield Finding(
                f"task {task.id}: the threshold by the rule of the levels is {bias_db:+.1f} dB off in {QUICK} "
                f"SIMULATED sessions of an observer with a spread of {worst.spread_db:g} dB",
                remedy="use more reversals or trials, or smaller final steps; `palpate power` shows every observer",
                verdict="warns",
            )


def _observer(
    protocol: StudyProtocol,
    task: Task,
    rule: Rule,
    spread_db: float,
    lapse: float,
    sessions: int,
    seed: int,
    *,
    fits: bool = True,
) -> Observer:
    own, levels = protocol.table(Detection), _levels(task)
    grid_db = 20 * np.log10(np.asarray(levels.grid))
    guess = 0.5 if own.intervals == 2 else FALSE_ALARMS
    by_rule, by_fit, trials, held, beyond = list[float](), list[float](), list[int](), 0, 0
    for session in range(sessions):
        rng = np.random.default_rng((seed, session, int(10 * spread_db), int(100 * lapse)))
        # Off every level, by up to half a step of the grid.
        middle = len(grid_db) // 2
        true_db = float(rng.uniform(grid_db[middle - 1 : middle + 1].mean(), grid_db[middle : middle + 2].mean()))
        x, right = _track(rule, levels, task.repetitions * own.signal_trials, rng, true_db, spread_db, guess, lapse)
        trials.append(len(x))
        turned = results.reversals(right.tolist(), levels)
        estimate = results.threshold_by_rule(x, right, turned, levels, np.ones(len(x), dtype=bool))
        if results.beyond_grid(x, right, levels, estimate.share):
            beyond += 1
            continue
        if estimate.db is not None and estimate.share is not None:
            felt = (estimate.share - guess) / (1 - guess - lapse)
            by_rule += [estimate.db - true_db - spread_db * float(ndtri(felt))] if 0 < felt < 1 else []
        if fits and (one := _fitted(x, right, _said_guess(own, task, guess, rng))) is not None:
            by_fit.append(one.value - true_db)
            held += one.low <= true_db <= one.high
    rule_off, fit_off = _summary(by_rule), _summary(by_fit)
    mean = float(np.mean(trials))
    ruled, fitted = len(by_rule), len(by_fit)
    return Observer(task.id, spread_db, lapse, sessions, mean, ruled, *rule_off, *fit_off, fitted, held, beyond)


def _levels(task: Task) -> Levels:
    if task.levels is None:
        raise ValueError(f"got task {task.id} without levels")
    return task.levels


def _track(
    rule: Rule,
    levels: Levels,
    most: int,
    rng: np.random.Generator,
    true_db: float,
    spread_db: float,
    guess: float,
    lapse: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the levels, dB, and answers of one track of at most so many trials, each of shape (trials,)."""
    state, at, right = rule.init(), list[float](), list[bool]()
    fixed = rng.permuted(np.resize(np.asarray(levels.grid), most)) if levels.method == "constant" else None
    for place in range(most):
        level = rule.level(state) if fixed is None else float(fixed[place])
        if level is None:
            break
        x = 20 * np.log10(level)
        is_right = bool(rng.random() < psychometric(np.asarray(x), true_db, spread_db, guess, lapse))
        state = rule.step(state, level=level, right=is_right)
        at.append(x)
        right.append(is_right)
    return np.asarray(at), np.asarray(right)


def _said_guess(own: Detection, task: Task, guess: float, rng: np.random.Generator) -> float:
    """Return the share of yes that an analysis takes: of two intervals a half, else that of the catch trials."""
    catches = own.catch_trials * task.repetitions
    return guess if own.intervals == 2 else float(rng.binomial(catches, guess)) / max(catches, 1)


def _fitted(x: np.ndarray, right: np.ndarray, guess: float) -> Any:
    levels = np.unique(x)
    counts = [(one, right[x == one].sum(), (x == one).sum()) for one in levels]
    try:
        return fit(*np.asarray(counts, dtype=np.float64).T, guess=guess).threshold
    except NotDefined:
        return None


def _summary(off: list[float]) -> tuple[float | None, float | None]:
    """Return mean and standard deviation of at least two."""
    return (float(np.mean(off)), float(np.std(off, ddof=1))) if len(off) > 1 else (None, None)


def _section(found: Thresholds) -> Section:
    records: list[Record] = [
        {**{name: getattr(one, name) for name in Observer.__dataclass_fields__}, "coverage": one.coverage,
         "coverage_low": getattr(one.coverage_interval, "low", None),
         "coverage_high": getattr(one.coverage_interval, "high", None), "needed": one.needed}
        for one in found.observers
    ]  # fmt: skip
    off = [one for one in found.observers if abs(one.rule_bias_db or 0.0) > WARNED_DB]
    said = (
        f"SIMULATED observers for {found.study}, seed {found.seed}: a known threshold within the levels, four "
        "spreads, three lapse rates. Fit bias is relative to the true threshold; rule bias is relative to the level "
        "at the rule's proportion correct.",
        f"The rule's bias is above {WARNED_DB:g} dB for {len(off)} of {len(found.observers)} observers.",
    )
    notes = (
        "in interval: among sessions with a fit, how often its 95 % interval contains the threshold; brackets show "
        "Wilson's 95 % interval, the Monte Carlo error. no threshold: sessions whose track stayed at one end of the "
        f"levels. n: participants needed for a 95 % interval within {WITHIN_DB:g} dB around the mean fitted threshold, "
        f"if thresholds have an SD of {BETWEEN_DB:g} dB across people; palpate sets both values.",
    )
    return Section("observers", "Simulated observers", said, (tabulate("Thresholds", COLUMNS, records, notes),))


def text(found: Thresholds) -> str:
    """Return everything for a terminal."""
    return "\n\n\n".join([LABEL, in_terminal(_section(found)), LABEL])


def as_dict(found: Thresholds) -> dict[str, Any]:
    """Return every number, for JSON."""
    return {"label": LABEL, "study": found.study, "observers": [dict(one) for one in _section(found).records]}


def write(found: Thresholds, out: Path) -> tuple[Path, ...]:
    """Write the table into a folder; return the files. Raises `DatasetError` as `publish`."""
    return publish(out, page.tables([_section(found)], LABEL), LABEL, "power")
