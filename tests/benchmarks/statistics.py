"""What the exact statistics cost: run `python -m tests.benchmarks.statistics`; medians of one run, and their ratios.

The tables have the sizes of the paper's study: 16 cells x 15 participants for the intraclass correlations, the correct
ratios of two tasks with 15 and 10 participants for the two-way ANOVA. The other software takes turns with ours, on the
same values, and both must agree to 1e-10. Not a test of speed: the figures belong to the machine that printed them.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pandas as pd
import statsmodels.formula.api as smf
from statsmodels.stats.anova import anova_lm

from palpate.analysis.statistics.anova import TYPES, Anova, cells, two_way
from palpate.analysis.statistics.icc import Icc, icc

ROUNDS, BATCH = 20, 10
TERMS = {"task": "C(task, Sum)", "material": "C(material, Sum)", "task x material": "C(task, Sum):C(material, Sum)"}
AGREEMENT = 1e-10

Values = list[list[Fraction]]


def ratings() -> Values:
    rng = np.random.default_rng(1)
    return [[Fraction(int(k), 10) for k in rng.binomial(10, p, size=15)] for p in rng.uniform(0.05, 0.95, size=16)]


def answers() -> tuple[list[Fraction], list[str], list[str]]:
    rng = np.random.default_rng(2)
    rows = [
        (Fraction(int(k), 10), task, material)
        for task, people in (("virtual", 15), ("real", 10))
        for material, p in zip("abcd", (0.8, 0.5, 0.6, 0.3), strict=True)
        for k in rng.binomial(10, p, size=people)
    ]
    values, tasks, materials = zip(*rows, strict=True)
    return list(values), list(tasks), list(materials)


def our_anova(values: list[Fraction], tasks: list[str], materials: list[str]) -> list[Anova]:
    data = cells(values, tasks, materials, names=("task", "material"))
    return [two_way(data, kind) for kind in TYPES]


def their_anova(frame: pd.DataFrame) -> list[Any]:
    model = smf.ols("ratio ~ C(task, Sum) * C(material, Sum)", frame).fit()
    return [anova_lm(model, typ=number) for number in (1, 2, 3)]


def their_icc(frame: pd.DataFrame) -> pd.DataFrame:
    import pingouin

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found: pd.DataFrame = pingouin.intraclass_corr(frame, targets="target", raters="rater", ratings="ratio")
    return found


def turns(*calls: Callable[[], object]) -> list[list[float]]:
    """Times in ms of one of BATCH calls in a row; the batches take turns."""
    times: list[list[float]] = [[] for _ in calls]
    for call in calls:
        call()
    for _ in range(ROUNDS):
        for call, own in zip(calls, times, strict=True):
            start = time.perf_counter()
            for _ in range(BATCH):
                call()
            own.append(1e3 * (time.perf_counter() - start) / BATCH)
    return times


def icc_difference(ours: Icc, theirs: pd.DataFrame) -> float:
    """Largest difference of value, F and P, relative where above 1."""
    pairs = [
        (form_value, float(line[column]))
        for form, (_, line) in zip(ours.forms, theirs.iterrows(), strict=True)
        for form_value, column in ((form.value, "ICC"), (form.f, "F"), (form.p, "pval"))
        if form_value is not None
    ]
    return _largest(pairs)


def anova_difference(ours: list[Anova], theirs: list[Any]) -> float:
    """Largest difference of sums of squares, F and P, relative where above 1."""
    pairs = []
    for table, other in zip(ours, theirs, strict=True):
        for effect in table.effects:
            line = other.loc[TERMS[effect.name]]
            pairs += [(effect.ss, line["sum_sq"]), (effect.f or 0.0, line["F"]), (effect.p or 0.0, line["PR(>F)"])]
    return _largest(pairs)


def _largest(pairs: list[tuple[float, float]]) -> float:
    return max(abs(a - b) / max(1.0, abs(b)) for a, b in pairs)


def _report(name: str, other: str, ours: list[float], theirs: list[float], wanted: int, difference: float) -> str:
    own, their = statistics.median(ours), statistics.median(theirs)
    low, _, high = statistics.quantiles([b / a for a, b in zip(ours, theirs, strict=True)], n=4)
    agree = "agree" if difference <= AGREEMENT else "DO NOT agree"
    return (
        f"{name}: {own:.3f} ms, {other} {their:.2f} ms: {their / own:.0f} times faster "
        f"(quartiles of the turns {low:.0f} to {high:.0f}; wanted {wanted}); values {agree} to {AGREEMENT:g} "
        f"(largest difference {difference:.1e})"
    )


def main() -> None:
    table = ratings()
    long = pd.DataFrame(
        [(t, r, float(value)) for t, row in enumerate(table) for r, value in enumerate(row)],
        columns=["target", "rater", "ratio"],
    )
    values, tasks, materials = answers()
    frame = pd.DataFrame({"ratio": [float(value) for value in values], "task": tasks, "material": materials})
    own_icc, other_icc, own_anova, other_anova = turns(
        lambda: icc(table),
        lambda: their_icc(long),
        lambda: our_anova(values, tasks, materials),
        lambda: their_anova(frame),
    )
    difference = icc_difference(icc(table), their_icc(long))
    print(_report("All ICC forms, 16 x 15", "pingouin", own_icc, other_icc, 50, difference))
    model = smf.ols("ratio ~ C(task, Sum) * C(material, Sum)", frame).fit()
    (tables_alone,) = turns(lambda: [anova_lm(model, typ=number) for number in (1, 2, 3)])
    difference = anova_difference(our_anova(values, tasks, materials), their_anova(frame))
    print(_report("Two-way ANOVA, types I to III", "statsmodels", own_anova, other_anova, 20, difference))
    alone = statistics.median(tables_alone)
    print(f"  against anova_lm alone, its model fitted before: {alone / statistics.median(own_anova):.0f} times faster")


if __name__ == "__main__":
    main()
