"""What simulated studies cost: run `python -m tests.benchmarks.power`; ratios of one run, in turns, on one core.

`palpate power` beside a loop that draws one study after the other with numpy and puts it through scipy, statsmodels and
pingouin: the footstep study with 15 participants and its planned tests, and with ICC(2,k) planned as well. Each test
of the loop is the fastest call of these libraries that gives the same number; that they do give it is checked first.
Not a test: it asserts nothing about time, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import os
import resource
import statistics
import time
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
import pingouin
import scipy.stats
import statsmodels.formula.api as smf
from statsmodels.stats.anova import anova_lm

from analysis import choice_models, planned_tests, power, published
from analysis.choice_models import ChoiceModel
from analysis.planned_tests import Design
from analysis.power import Chunk
from experiment.protocol import load
from experiment.protocol.models import PlannedTest
from experiment.protocol.shipped import shipped

TURNS = 7
LOOPED = 10
"""Studies of the loop in a turn."""

VECTORISED = 10_000
TERMS = ("C(task, Sum)", "C(material, Sum)", "C(task, Sum):C(material, Sum)")


def one_study(design: Design, model: ChoiceModel, random: np.random.Generator) -> dict[str, np.ndarray]:
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


def looped(design: Design, drawn: dict[str, np.ndarray], *, icc: bool) -> list[float]:
    """P of every planned test, by libraries."""
    found: list[float] = []
    frames = []
    for task, counts in drawn.items():
        ratios = counts / 10
        correct = ratios[range(4), range(4)]
        p = np.array([scipy.stats.ttest_1samp(row, 0.25).pvalue for row in correct])
        found += [*p, *pingouin.multicomp(p, method="holm")[1]]
        frames.append(
            pd.DataFrame(
                {
                    "ratio": correct.ravel(),
                    "task": task,
                    "material": np.repeat(design.materials, correct.shape[1]),
                    "participant": np.tile(np.arange(correct.shape[1]), 4),
                }
            )
        )
    answers = drawn["virtual"][:, :4] / 10
    both = np.triu(answers.mean(axis=2) + answers.mean(axis=2).T, k=1)
    for i, j in ((1, 3), np.unravel_index(int(np.argmax(both)), both.shape)):
        groups = (answers[i, i], answers[j, j], answers[i, j], answers[j, i])
        found.append(scipy.stats.f_oneway(*groups).pvalue)
    fit = smf.ols("ratio ~ C(task, Sum) * C(material, Sum)", pd.concat(frames)).fit()
    tables = [anova_lm(fit, typ=kind) for kind in (1, 2, 3)]
    found += [tables[0].loc[TERMS[0], "PR(>F)"], tables[0].loc[TERMS[1], "PR(>F)"], tables[2].loc[TERMS[1], "PR(>F)"]]
    found.append(tables[0].loc[TERMS[2], "PR(>F)"])
    if icc:
        for frame in frames:
            table = pingouin.intraclass_corr(frame, targets="material", raters="participant", ratings="ratio")
            found.append(table["pval"].iloc[4])
    return found


def ours(design: Design, drawn: dict[str, np.ndarray]) -> list[float]:
    """The same numbers of the same study."""
    answers = planned_tests.answer(design, {task: counts[:, :, None] for task, counts in drawn.items()})
    return [
        float(answer.p[0])
        for question, answer in answers.items()
        if answer.p is not None and "cells" not in question.subject
    ]


def vectorised(chunks: list[Chunk]) -> None:
    """Simulate and test every chunk."""
    for chunk in chunks:
        power.simulate(chunk)


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
    protocol = load.load(shipped("okamoto2012.toml"))
    printed = published.load("okamoto2012")
    pairs = printed.pairs() if printed else {}
    model = choice_models.find("published", protocol)
    reliability = PlannedTest(test="ICC", tasks=("virtual", "real"), question="?", form="ICC(2,k)")
    random = np.random.default_rng(1)
    print(f"15 and 10 participants, 40 trials; medians of {TURNS} turns; load {os.getloadavg()[0]:.1f}")
    for name, tests in (("as planned", ()), ("with ICC(2,k)", (reliability,))):
        planned = planned_tests.design(protocol.model_copy(update={"analysis": (*protocol.analysis, *tests)}), pairs)
        worst = 0.0
        for _ in range(50):
            drawn = one_study(planned, model, random)
            theirs, mine = looped(planned, drawn, icc=bool(tests)), ours(planned, drawn)
            # Without variance scipy divides by zero and finds P = 0; palpate finds none, and counts that.
            if not np.isnan(mine).any():
                worst = max(worst, float(np.abs(np.subtract(theirs, mine)).max()))
        chunks = [
            Chunk(planned, model, "model", 15, number, power.CHUNK_STUDIES, 1)
            for number in range(VECTORISED // power.CHUNK_STUDIES)
        ]

        def loop(planned: Design = planned, icc: bool = bool(tests)) -> None:
            for _ in range(LOOPED):
                looped(planned, one_study(planned, model, random), icc=icc)

        taken = in_turns({"loop": loop, "palpate": partial(vectorised, chunks)})
        ratios = [
            (slow / LOOPED) / (fast / VECTORISED) for slow, fast in zip(taken["loop"], taken["palpate"], strict=True)
        ]
        print(f"{name}: largest difference of any P from the libraries' {worst:.1e}")
        print(f"  loop of scipy, statsmodels, pingouin {LOOPED / statistics.median(taken['loop']):10.1f} studies/s")
        print(
            f"  palpate power                        {VECTORISED / statistics.median(taken['palpate']):10.1f} studies/s"
        )
        spread = f"{min(ratios):.0f} to {max(ratios):.0f}"
        print(f"  ratio {statistics.median(ratios):.0f} ({spread})   (at least 300, aim 1000)")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"peak resident memory, libraries included {peak_mb:.0f} MB")


if __name__ == "__main__":
    main()
