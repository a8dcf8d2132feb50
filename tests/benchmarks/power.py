"""What simulated studies cost: run `python -m tests.benchmarks.power`; ratios of one run, in turns, on one core.

`palpate power` beside two loops that draw one study after the other with numpy and put it through scipy, statsmodels
and pingouin: the footstep study with 15 participants and its planned tests, and with ICC(2,k) planned as well.

- By name: each test by the function that bears its name, called once for as much as it takes at once (`ttest_1samp`
  on all materials, `f_oneway`, one fit by formula with `anova_lm` of types I and III; II is one of the two here).
- Least: each P by the call of these libraries that was found to give it in the least time: `ttest_mean` of
  `DescrStatsW`, `anova_oneway`, and `OLS` with `f_test`, its design and contrasts made once for all studies.

Holm and ICC are pingouin's in both. That the loops give the numbers of palpate is checked first, value by value. Not a
test: it asserts nothing about time, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import os
import resource
import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pandas as pd
import pingouin
import scipy.stats
import statsmodels.api as sm
import statsmodels.formula.api as smf
from numpy.typing import NDArray
from statsmodels.stats.anova import anova_lm
from statsmodels.stats.oneway import anova_oneway
from statsmodels.stats.weightstats import DescrStatsW

from palpate.analysis import published
from palpate.analysis.power import planned_tests, simulate
from palpate.analysis.power.planned_tests import Design, Model
from palpate.analysis.power.simulate import Chunk
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import PlannedTest

Floats = NDArray[np.float64]

TURNS = 7
LOOPED = 10
"""Studies of each loop in a turn."""

COMPARED = 200
"""Studies whose numbers are compared."""

VECTORISED = 10_000
TERMS = ("C(task, Sum)", "C(material, Sum)", "C(task, Sum):C(material, Sum)")


def one_study(design: Design, model: Model, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Task -> counts, shape (presented, answered, participants)."""
    drawn = {}
    for task, answers, size in zip(design.tasks, model.tasks, design.sizes(design.participants), strict=True):
        alphas = answers.shares * (1 / answers.spread[:, None] - 1)
        p = [random.dirichlet(alpha[alpha > 0], size=size) for alpha in alphas]
        counts = np.zeros((len(alphas), alphas.shape[1], size), dtype=np.int64)
        for i, alpha in enumerate(alphas):
            counts[i, alpha > 0] = random.multinomial(task.repetitions, p[i]).T
        drawn[task.id] = counts
    return drawn


class ByName:
    """Each test by the function that bears its name."""

    def __init__(self, design: Design) -> None:
        self._materials = design.materials

    def t(self, correct: Floats) -> Floats:
        return np.asarray(scipy.stats.ttest_1samp(correct, 0.25, axis=1).pvalue)

    def one_way(self, groups: Sequence[Floats]) -> float:
        return float(scipy.stats.f_oneway(*groups).pvalue)

    def two_way(self, correct: Sequence[Floats]) -> list[float]:
        """Of the task, of the material by types I and III, and of their interaction."""
        frame = pd.DataFrame(
            {
                "ratio": np.concatenate([ratios.ravel() for ratios in correct]),
                "task": np.repeat(np.arange(len(correct)), [ratios.size for ratios in correct]),
                "material": np.concatenate([np.repeat(self._materials, ratios.shape[1]) for ratios in correct]),
            }
        )
        fit = smf.ols("ratio ~ C(task, Sum) * C(material, Sum)", frame).fit()
        first, third = (anova_lm(fit, typ=kind)["PR(>F)"] for kind in (1, 3))
        return [first[TERMS[0]], first[TERMS[1]], third[TERMS[1]], first[TERMS[2]]]


class Least(ByName):
    """Each P by the call that was found to take the least time."""

    def __init__(self, design: Design) -> None:
        super().__init__(design)
        sizes = np.repeat(design.sizes(design.participants), len(design.materials))
        root = np.sqrt(sizes)
        task, material = np.array([[1.0], [-1.0]]), np.vstack([np.eye(3), -np.ones(3)])
        parts = {"": np.ones((8, 1)), "A": np.kron(task, np.ones((4, 1))), "B": np.kron(np.ones((2, 1)), material)}
        parts["X"] = np.kron(task, material)
        self._cells = np.repeat(np.eye(8), sizes, axis=0)
        # In root-weighted cell means the last directions of each order are what its last effect adds to the others.
        self._contrasts = [
            np.linalg.qr(root[:, None] * np.hstack([parts[name] for name in ("", *order)]))[0].T[-df:] * root
            for order, df in (("A", 1), ("AB", 3), ("AXB", 3), ("ABX", 3))
        ]

    def t(self, correct: Floats) -> Floats:
        return np.asarray(DescrStatsW(correct.T).ttest_mean(0.25)[1])

    def one_way(self, groups: Sequence[Floats]) -> float:
        return float(anova_oneway(groups, use_var="equal").pvalue)

    def two_way(self, correct: Sequence[Floats]) -> list[float]:
        """Of the task, of the material by types I and III, and of their interaction."""
        fit = sm.OLS(np.concatenate([ratios.ravel() for ratios in correct]), self._cells).fit()
        return [float(fit.f_test(contrast).pvalue) for contrast in self._contrasts]


def looped(design: Design, drawn: dict[str, np.ndarray], by: ByName, *, icc: bool) -> list[float]:
    """P of every planned test, by libraries."""
    found: list[float] = []
    correct = [counts[range(4), range(4)] / 10 for counts in drawn.values()]
    for ratios in correct:
        p = by.t(ratios)
        found += [*p, *pingouin.multicomp(p, method="holm")[1]]
    answers = drawn["virtual"][:, :4] / 10
    means = answers.mean(axis=2)
    both = np.triu(means + means.T, k=1)
    for i, j in ((1, 3), np.unravel_index(int(np.argmax(both)), both.shape)):
        found.append(by.one_way((answers[i, i], answers[j, j], answers[i, j], answers[j, i])))
    found += by.two_way(correct)
    if icc:
        for ratios in correct:
            frame = pd.DataFrame(
                {
                    "ratio": ratios.ravel(),
                    "material": np.repeat(design.materials, ratios.shape[1]),
                    "participant": np.tile(np.arange(ratios.shape[1]), 4),
                }
            )
            table = pingouin.intraclass_corr(frame, targets="material", raters="participant", ratings="ratio")
            found.append(table["pval"].iloc[4])
    return found


def ours(design: Design, drawn: dict[str, np.ndarray]) -> list[float]:
    """The same numbers of the same study."""
    answers = planned_tests.answer(design, {task: counts[:, :, None] for task, counts in drawn.items()})
    return [
        float(answer.p[0])
        for question, answer in answers.items()
        if answer.p is not None
        and "cells" not in question.subject
        and "(companion)" not in question.subject + question.test
    ]


def differences(theirs: Sequence[float], mine: Sequence[float]) -> Floats:
    """Of every P that can be compared; NaN where palpate finds none.

    Without variance scipy divides by zero and finds P = 0, and palpate finds none and takes it as 1 in Holm: neither
    that P nor what Holm makes of its family can be compared.
    """
    apart = np.abs(np.subtract(theirs, mine))
    for family in (0, 8):
        if np.isnan(apart[family : family + 4]).any():
            apart[family + 4 : family + 8] = np.nan
    return np.asarray(apart)


def vectorised(chunks: list[Chunk]) -> None:
    """Simulate and test every chunk."""
    for chunk in chunks:
        simulate.simulate(chunk)


def in_turns(calls: dict[str, Callable[[], object]]) -> dict[str, list[float]]:
    """Seconds of every call in each turn."""
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(TURNS):
        for name, call in calls.items():
            begun = time.perf_counter()
            call()
            taken[name].append(time.perf_counter() - begun)
    return taken


def main() -> None:
    warnings.simplefilter("ignore")
    protocol = files.load(shipped("okamoto2012.toml"))
    printed = published.load("okamoto2012")
    pairs = printed.pairs() if printed else {}
    model = simulate.find("published", protocol)
    reliability = PlannedTest(test="ICC", tasks=("virtual", "real"), question="?", form="ICC(2,k)")
    random = np.random.default_rng(1)
    print(f"15 and 10 participants, 40 trials; medians of {TURNS} turns; load {os.getloadavg()[0]:.1f}")
    for name, tests in (("as planned", ()), ("with ICC(2,k)", (reliability,))):
        planned = planned_tests.design(protocol.model_copy(update={"analysis": (*protocol.analysis, *tests)}), pairs)
        loops = {"by name": ByName(planned), "least": Least(planned)}
        print(f"{name}:")
        for loop, by in loops.items():
            apart = []
            for _ in range(COMPARED):
                drawn = one_study(planned, model, random)
                apart.append(differences(looped(planned, drawn, by, icc=bool(tests)), ours(planned, drawn)))
            every = np.array(apart)
            print(
                f"  {loop}: {np.isfinite(every).sum()} of {every.size} P in {COMPARED} studies compared, the others "
                f"not defined; largest difference {np.nanmax(every):.1e}"
            )
        chunks = [
            Chunk(planned, model, "model", 15, number, simulate.CHUNK_STUDIES, 1)
            for number in range(VECTORISED // simulate.CHUNK_STUDIES)
        ]

        def loop_of(by: ByName, planned: Design = planned, icc: bool = bool(tests)) -> None:
            for _ in range(LOOPED):
                looped(planned, one_study(planned, model, random), by, icc=icc)

        calls: dict[str, Callable[[], object]] = {loop: partial(loop_of, by) for loop, by in loops.items()}
        taken = in_turns({**calls, "palpate": partial(vectorised, chunks)})
        rates = {loop: [LOOPED / s for s in taken[loop]] for loop in loops}
        rates["palpate"] = [VECTORISED / s for s in taken["palpate"]]
        for loop, rate in rates.items():
            print(f"  {loop:8} {statistics.median(rate):10.1f} studies/s ({min(rate):.1f} to {max(rate):.1f})")
        for loop in loops:
            ratios = [fast / slow for slow, fast in zip(rates[loop], rates["palpate"], strict=True)]
            spread = f"{min(ratios):.0f} to {max(ratios):.0f}"
            print(f"  palpate beside the loop {loop}: ratio {statistics.median(ratios):.0f} ({spread})")
    print("at least 300, aim 1000")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"peak resident memory, libraries included {peak_mb:.0f} MB")


if __name__ == "__main__":
    main()
