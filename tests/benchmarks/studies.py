"""How well studies give back what SIMULATED participants feel: run `python -m tests.benchmarks.studies [STUDIES]`.

Each study of `sole.toml` has its own participants, tracks and levels: the method of the session chooses each level,
and the analysis' own rule makes the threshold of it. Participants differ by an SD of 4 dB at each frequency, with
spreads of 1.5 to 4 dB and 2 % of lapses. Of a mean over participants: its bias and SD over studies, and how often its
95 % interval holds the mean of all people; of one participant: the same of the threshold, and how often the lower
limit, which is the floor, is below it; and how often the floor of everybody is below all participants' thresholds. In
each study of `harder.toml` participants choose by Bradley and Terry, with slopes of their own: mean and SD of what a
doubling adds, and how often its 95 % interval holds the mean slope of all people. A common scale comes out lower, for
it has no spread between people. Not a test: it asserts nothing.
"""

from __future__ import annotations

import sys
import time
from math import log10

import numpy as np
from scipy.special import expit, ndtr, ndtri

from palpate.analysis.designs.comparison.factors import factored
from palpate.analysis.designs.detection.results import threshold_by_rule
from palpate.analysis.statistics.participants import mean
from palpate.analysis.statistics.scaling import FIRST, SECOND, Comparisons
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.models import Levels
from palpate.experiment.study.levels.quest_plus import QuestPlus

SLOPES = {"amplitude_m_s2": 0.8, "frequency_hz": 0.4}
"""What a doubling adds, logits: the names in the order of the analysis."""

TRUE_DB, BETWEEN_DB, SPREADS_DB, LAPSE = -27.0, 4.0, (1.5, 4.0), 0.02


def track(levels: Levels, trials: int, threshold_db: float, rng: np.random.Generator) -> tuple[float, float]:
    """Return threshold and SD, dB, by the rule of the levels, of one track of a simulated participant."""
    method, spread = QuestPlus(levels), rng.uniform(*SPREADS_DB)
    state, x, right = method.init(), list[float](), list[bool]()
    while len(x) < trials and (level := method.level(state)) is not None:
        x.append(20 * log10(level))
        share = 0.5 + (0.5 - LAPSE) * ndtr((x[-1] - threshold_db) / spread)
        right.append(bool(rng.random() < share))
        state = method.step(state, level=level, right=right[-1])
    found = threshold_by_rule(np.array(x), np.array(right), (), levels, np.ones(len(x), dtype=bool))
    assert found.db is not None
    assert found.sd is not None
    return found.db, found.sd


def sole(studies: int) -> None:
    """Print a row for each frequency's place: all frequencies have the same observers, so there is one."""
    protocol = files.load(files.shipped("sole.toml"))
    (task,), rng = protocol.tasks, np.random.default_rng(42)
    assert task.levels is not None
    errors, holds, each, below, all_below = [], [], [], [], []
    half = float(ndtri(0.975))
    for _ in range(studies):
        true = TRUE_DB + BETWEEN_DB * rng.normal(size=task.participants)
        found = np.array([track(task.levels, task.repetitions, one, rng) for one in true])
        over = mean(found[:, 0])
        assert over.low is not None
        assert over.high is not None
        errors.append(over.value - TRUE_DB)
        holds.append(over.low <= TRUE_DB <= over.high)
        lower = found[:, 0] - half * found[:, 1]
        each += (found[:, 0] - true).tolist()
        below += (lower <= true).tolist()
        all_below.append(lower.min() <= true.min())
    print("sole.toml,studies,participants,bias dB,SD dB,holds %,one: bias dB,one: SD dB,floor below %,below all %")
    cells = (
        *(f"{np.mean(errors):.2f}", f"{np.std(errors, ddof=1):.2f}", f"{100 * np.mean(holds):.1f}"),
        *(f"{np.mean(each):.2f}", f"{np.std(each, ddof=1):.2f}", f"{100 * np.mean(below):.1f}"),
        f"{100 * np.mean(all_below):.1f}",
    )
    print(",".join(("a frequency", str(studies), str(task.participants), *cells)))


BETWEEN, ORDER = 0.3, 0.2
"""SD of a slope over participants, and what being first adds, in logits."""


def harder(studies: int) -> None:
    """Print a row for each factor of `harder.toml`, and for what one adds beyond the other."""
    protocol = files.load(files.shipped("harder.toml"))
    (task,), rng = protocol.tasks, np.random.default_rng(42)
    numbers, names = protocol.table(Presented).numbers, protocol.materials_of(task)
    octaves = np.log2([[numbers[one][key] for key in SLOPES] for one in names])
    true = [*SLOPES.values(), SLOPES["amplitude_m_s2"] - SLOPES["frequency_hz"]]
    # Half of the trials with a pair are in either order.
    pairs = np.array([(i, j) for i in range(len(names)) for j in range(len(names))])
    each = np.where(pairs[:, 0] == pairs[:, 1], task.repetitions, task.repetitions // 2)
    first, second = np.tile(np.repeat(pairs, each, axis=0), (task.participants, 1)).T
    person = np.repeat(np.arange(task.participants), each.sum())
    found = []
    for _ in range(studies):
        slopes = np.array(list(SLOPES.values())) + BETWEEN * rng.normal(size=(task.participants, len(SLOPES)))
        logit = ((octaves[first] - octaves[second]) * slopes[person]).sum(axis=1) + ORDER
        chosen = np.where(rng.random(len(first)) < expit(logit), FIRST, SECOND)
        got = factored(Comparisons(first, second, chosen, person, len(names)), names, numbers)
        assert got is not None
        assert got.apart is not None
        found.append([*(one.doubling for one in got.factors), got.apart])
    print("harder.toml,studies,participants,true,mean,SD,holds %")
    for place, name in enumerate((*SLOPES, "the first beyond the second")):
        own = [one[place] for one in found]
        values = [one.value for one in own]
        holds = [(one.low or 0) <= true[place] <= (one.high or 0) for one in own]
        cells = f"{true[place]:.2f}", f"{np.mean(values):.3f}", f"{np.std(values, ddof=1):.3f}"
        print(",".join((name, str(studies), str(task.participants), *cells, f"{100 * np.mean(holds):.1f}")))


if __name__ == "__main__":
    start = time.process_time()
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    sole(asked)
    harder(asked)
    print(f"{time.process_time() - start:.0f} s of the processor", file=sys.stderr)
