"""A made-up study, printed from random counts by scipy, statsmodels and decimal: what an audit must not accuse."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pandas as pd
import statsmodels.formula.api as smf
from numpy.typing import NDArray
from scipy import stats
from statsmodels.stats.anova import anova_lm

from palpate.analysis.published.numbers import Published

MATERIALS = ("glass", "sand", "snow")
LEVELS = ((0.001, "***"), (0.01, "**"), (0.05, "*"))
WAYS = (ROUND_HALF_UP, ROUND_HALF_EVEN, ROUND_DOWN)
MIXED = "mixed"
"""Stands for any of the ways, now this, now that."""

Counts = Mapping[str, NDArray[np.int64]]
"""Task -> counts by participant, material presented and answer."""


def draw(seed: int, sizes: Mapping[str, int], trials: int) -> dict[str, NDArray[np.int64]]:
    """Answers that tend to be right."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(3), size=3) + np.eye(3)
    shares = weights / weights.sum(axis=1, keepdims=True)
    return {task: np.stack([rng.multinomial(trials, shares) for _ in range(n)]) for task, n in sizes.items()}


def scores(seed: int, n: int, items: int) -> list[Fraction]:
    """Means of `items` whole numbers from 1 to 7, not all the same: evenly spread to nearly all alike."""
    rng = np.random.default_rng(seed)
    low, high = rng.choice([[0, 6 * items], sorted(rng.choice(6 * items + 1, size=2, replace=False))]).tolist()
    among = range(low, high + 1)
    weights = rng.dirichlet(np.full(len(among), rng.choice([0.1, 1, 10])))
    counts = [low, high, *rng.choice(among, size=n - 2, p=weights).tolist()]
    return [Fraction(items + count, items) for count in counts]


def root(variance: Fraction) -> Fraction:
    """To 40 digits, so that cutting it off cuts the true root."""
    scale = 10**40
    return Fraction(math.isqrt(variance.numerator * scale**2 // variance.denominator), scale)


def text(value: float | Fraction, digits: int, way: str) -> str:
    """A number as printed, with so many decimals."""
    exact = Fraction(value)
    long = Decimal(exact.numerator) / Decimal(exact.denominator)
    if way == MIXED:
        way = WAYS[int(long * 10**9) % 3]
    return f"{long.quantize(Decimal(1).scaleb(-digits), rounding=way):f}"


def scientific(value: float, way: str) -> str:
    """P as printed, with three digits."""
    power = math.floor(math.log10(value))
    if power >= -1:
        return text(value, 3, way)
    mantissa = text(Fraction(value) / Fraction(10) ** power, 2, way)
    return f"{mantissa}e{power}" if float(mantissa) < 10 else f"1.00e{power + 1}"


def printed(
    counts: Counts, trials: int, digits: int, way: str, *, steps: bool = True, above: bool = True, kind: int = 2
) -> dict[str, Any]:
    """The study as the content of its file, arrays as tuples.

    `steps`: whether it says how many trials there were; `above`: whether it gives stars above chance alone; `kind`: the
    type of its two-way ANOVA.
    """
    chance = Fraction(1, 3)
    tables, tests = [], []
    for task, answers in counts.items():
        n = len(answers)
        cells = []
        for i, shown in enumerate(MATERIALS):
            for j, said in enumerate(MATERIALS):
                ratios = [Fraction(int(count), trials) for count in answers[:, i, j]]
                mean, variance = statistics.mean(ratios), statistics.variance(ratios)
                cell = {"presented": shown, "answered": said, "mean": text(mean, digits, way)}
                cell["sd"] = text(root(variance), digits, way)
                if i == j and variance:
                    t = float(mean - chance) / math.sqrt(variance / n)
                    p = float(2 * stats.t.sf(abs(t), n - 1))
                    cell["stars"] = next((mark for level, mark in LEVELS if p < level), "")
                    if above and mean <= chance:
                        cell["stars"] = ""
                    test = {"task": task, "of": shown, "df": n - 1, "t": text(t, 2, way), "p": scientific(p, way)}
                    tests.append(test)
                cells.append(cell)
        tables.append({"where": f"Table of {task}", "task": task, "cells": tuple(cells)})
    known = {"trials": trials} if steps else {}
    tasks = tuple({"id": task, "participants": len(answers), **known} for task, answers in counts.items())
    document: dict[str, Any] = {"study": "made", "source": "Nobody", "chance": "1/3", "task": tasks, "table": tables}
    document["levels"] = tuple({"stars": mark, "p": str(level), "above": above} for level, mark in LEVELS)
    if tests:
        document["t"] = ({"where": "Text", "tests": tuple(tests)},)
    return {**document, **_anovas(counts, trials, way, kind), "table": tuple(tables)}


def choices(counts: Sequence[int], trials: int, way: str) -> dict[str, Any]:
    """A study of percentages, each of so many trials, by seven who did ten for each pair."""
    percentages = [f"{text(Fraction(100 * count, trials), 0, way)}%" for count in counts]
    cells = tuple({"pair": (str(k), "other"), "correct": percent} for k, percent in enumerate(percentages))
    block = {"where": "Text", "task": "taps", "participants": 7, "trials": 10 * len(counts), "cells": cells}
    return {"study": "made", "source": "Nobody", "choices": (block,)}


def published(document: Mapping[str, Any]) -> Published:
    """What `palpate.analysis.published.read` makes of such a file."""
    return Published.model_validate(document)


def changed(document: dict[str, Any], change: Callable[[dict[str, Any]], None], index: int = 0) -> dict[str, Any]:
    """The study with one t-test changed."""
    tests = [dict(test) for test in document["t"][0]["tests"]]
    change(tests[index])
    return {**document, "t": ({"where": "Text", "tests": tuple(tests)},)}


def _anovas(counts: Counts, trials: int, way: str, kind: int) -> dict[str, Any]:
    found: dict[str, Any] = {}
    first = next(iter(counts))
    answers = counts[first] / trials
    groups = [answers[:, 0, 0], answers[:, 1, 1], answers[:, 0, 1], answers[:, 1, 0]]
    if sum(np.ptp(group) for group in groups):
        f = stats.f_oneway(*groups)
        df = (3, 4 * len(answers) - 4)
        one = {"where": "Text", "task": first, "pair": MATERIALS[:2], "df": df}
        if f.pvalue > 0 and f.statistic > 1e-9:
            found["one_way"] = ({**one, "f": text(float(f.statistic), 2, way), "p": scientific(float(f.pvalue), way)},)
    found["two_way"] = tuple(_two_way(counts, trials, way, kind))
    return found


def _two_way(counts: Counts, trials: int, way: str, kind: int) -> Iterator[dict[str, Any]]:
    """Both effects by statsmodels, those that differ from nothing."""
    cells = [(task, MATERIALS[k], held[:, k, k] / trials) for task, held in counts.items() for k in range(3)]
    if len(counts) != 2 or sum(float(np.var(values)) for _, _, values in cells) < 1e-9:
        return
    rows = [(task, material, ratio) for task, material, values in cells for ratio in values]
    frame = pd.DataFrame(rows, columns=["task", "material", "ratio"])
    table = anova_lm(smf.ols("ratio ~ C(task, Sum) * C(material, Sum)", frame).fit(), typ=kind)
    for effect in ("task", "material"):
        line = table.loc[f"C({effect}, Sum)"]
        f, p = float(line["F"]), float(line["PR(>F)"])
        if f > 1e-9 and p > 0:
            df = (int(line["df"]), int(table.loc["Residual", "df"]))
            yield {"where": "Text", "effect": effect, "df": df, "f": text(f, 2, way), "p": scientific(p, way)}
