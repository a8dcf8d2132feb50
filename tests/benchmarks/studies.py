"""How well studies give back what SIMULATED participants feel: run `python -m tests.benchmarks.studies [STUDIES]`.

Each study of `sole.toml` has its own participants, tracks and levels: the method of the session chooses each level, and
the analysis' own rule makes the threshold of it. Participants differ by an SD of 4 dB at each frequency, with spreads
of 1.5 to 4 dB and 2 % of lapses. Of a mean over participants: its bias and SD over studies, and how often its 95 %
interval holds the mean of all people; of one participant: the same of the threshold, and how often the lower limit,
which is the floor, is below it; and how often the floor of everybody is below all participants' thresholds. In each
study of `harder.toml` participants choose by Bradley and Terry, with slopes of their own: mean and SD of what a
doubling adds, and how often its 95 % interval holds the mean slope of all people. A common scale comes out lower, for
it has no spread between people. `timing.toml` and `late.toml` likewise, of 10 ms earlier and later than the touch;
`crossover.toml`, of the top of a parabola, which lies elsewhere for each participant. Of a hand that taps as in
rehearsals: how many taps are predicted so far ahead with a standard error that aims a vibration, and by how much they
are off. Not a test: it asserts nothing.
"""

from __future__ import annotations

import sys
import time
from math import log2, log10

import numpy as np
from scipy.special import expit, ndtr, ndtri

from palpate.analysis.designs.comparison.crossover import crossed
from palpate.analysis.designs.comparison.delays import JUST, STEP_MS, delayed
from palpate.analysis.designs.comparison.factors import factored
from palpate.analysis.designs.detection.results import threshold_by_rule
from palpate.analysis.statistics.exact import Integers
from palpate.analysis.statistics.participants import mean
from palpate.analysis.statistics.scaling import FIRST, SECOND, Comparisons
from palpate.experiment.apparatus.servo.rendering import AGAIN_MM
from palpate.experiment.apparatus.tracker.landing import LandingPredictor
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Levels, Protocol, Step
from palpate.experiment.rehearsal.kinds.tapping import hand
from palpate.experiment.session.kinds.tapping.taps import FROM_MM, SURE_US, WANDER_MM
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
    first, second, person = pairs_of(protocol)
    found = []
    for _ in range(studies):
        slopes = np.array(list(SLOPES.values())) + BETWEEN * rng.normal(size=(task.participants, len(SLOPES)))
        logit = ((octaves[first] - octaves[second]) * slopes[person]).sum(axis=1) + ORDER
        chosen = np.where(rng.random(len(first)) < expit(logit), FIRST, SECOND)
        got = factored(Comparisons(first, second, chosen, person, len(names)), names, numbers)
        assert got is not None
        assert got.apart is not None
        found.append([*(one.doubling for one in got.factors if one.doubling is not None), got.apart])
    print("harder.toml,studies,participants,true,mean,SD,holds %")
    for place, name in enumerate((*SLOPES, "the first beyond the second")):
        own = [one[place] for one in found]
        values = [one.value for one in own]
        holds = [(one.low or 0) <= true[place] <= (one.high or 0) for one in own]
        cells = f"{true[place]:.2f}", f"{np.mean(values):.3f}", f"{np.std(values, ddof=1):.3f}"
        print(",".join((name, str(studies), str(task.participants), *cells, f"{100 * np.mean(holds):.1f}")))


SIDES = {"timing.toml": (0.1, -0.3), "late.toml": (-0.6, 0.4)}
"""What 10 ms earlier and 10 ms later add, logits: hardness, which an early vibration hardly changes, and lateness."""

BETWEEN_SIDES = 0.2
"""SD of each over participants, logits."""


def pairs_of(protocol: Protocol) -> tuple[Integers, Integers, Integers]:
    """Return first, second and person of each trial of a study: half of the trials with a pair are in either order."""
    (task,), items = protocol.tasks, len(protocol.materials)
    pairs = np.array([(i, j) for i in range(items) for j in range(items)])
    each = np.where(pairs[:, 0] == pairs[:, 1], task.repetitions, task.repetitions // 2)
    first, second = np.tile(np.repeat(pairs, each, axis=0), (task.participants, 1)).T
    return first, second, np.repeat(np.arange(task.participants), each.sum())


def delays(name: str, studies: int) -> None:
    """Print a row for each side of the touch, and for the delay after it that is just noticed."""
    protocol, rng = files.load(files.shipped(name)), np.random.default_rng(42)
    (task,), names, numbers = protocol.tasks, [one.id for one in protocol.materials], protocol.table(Tapping).numbers
    first, second, person = pairs_of(protocol)
    delay_ms = np.array([numbers[one]["delay_ms"] for one in names])
    terms = np.column_stack([np.maximum(-delay_ms, 0), np.maximum(delay_ms, 0)]) / STEP_MS
    found = []
    for _ in range(studies):
        own = np.array(SIDES[name]) + BETWEEN_SIDES * rng.normal(size=(task.participants, 2))
        logit = ((terms[first] - terms[second]) * own[person]).sum(axis=1) + ORDER
        chosen = np.where(rng.random(len(first)) < expit(logit), FIRST, SECOND)
        got = delayed(Comparisons(first, second, chosen, person, len(names)), names, numbers)
        assert got is not None
        found.append(got.sides)
    print(f"{name},studies,participants,true,mean,SD,holds %,noticed ms,median ms,holds %")
    for place, true in enumerate(SIDES[name]):
        slopes = [one[place].slope for one in found]
        values = [one.value for one in slopes]
        holds = 100 * np.mean([(one.low or 0) <= true <= (one.high or 0) for one in slopes])
        noticed_ms, sides = STEP_MS * JUST / abs(true), [one[place] for one in found]
        within = [(one.noticed_low_ms or 0) <= noticed_ms <= (one.noticed_high_ms or float("inf")) for one in sides]
        middle_ms = np.median([one.noticed_ms or float("inf") for one in sides])
        cells = f"{true:.2f}", f"{np.mean(values):.3f}", f"{np.std(values, ddof=1):.3f}", f"{holds:.1f}"
        more = f"{noticed_ms:.1f}", f"{middle_ms:.1f}", f"{100 * np.mean(within):.1f}"
        print(
            ",".join(("10 ms later" if place else "10 ms earlier", str(studies), str(task.participants), *cells, *more))
        )


BESTS_HZ, BEND, OCTAVES = (40.0, 25.0), 0.25, 0.5
"""Best crossovers, what one octave beside takes away, logits, and the SD of the best over participants, octaves."""


def crossover(studies: int) -> None:
    """Print a row for each best crossover of people: how well a study gives it and the bend back."""
    protocol, rng = files.load(files.shipped("crossover.toml")), np.random.default_rng(42)
    (task,), names, numbers = protocol.tasks, [one.id for one in protocol.materials], protocol.table(Tapping).numbers
    first, second, person = pairs_of(protocol)
    octaves = np.log2([numbers[one]["crossover_hz"] for one in names])
    print(
        "crossover.toml,studies,participants,true Hz,median Hz,SD octaves,holds %,no top %,no interval %,bend,mean,SD"
    )
    for best_hz in BESTS_HZ:
        found = []
        for _ in range(studies):
            own = log2(best_hz) + OCTAVES * rng.normal(size=task.participants)
            scale = -BEND * (octaves[:, None] - own) ** 2
            logit = scale[first, person] - scale[second, person] + ORDER
            chosen = np.where(rng.random(len(first)) < expit(logit), FIRST, SECOND)
            got = crossed(Comparisons(first, second, chosen, person, len(names)), names, numbers)
            assert got is not None
            found.append(got)
        bests = np.array([one.best_hz for one in found if one.best_hz is not None])
        ends_hz = [(one.best_low_hz, one.best_high_hz) for one in found if one.best_hz is not None]
        known = [(low, high) for low, high in ends_hz if low is not None and high is not None]
        holds = 100 * np.mean([low <= best_hz <= high for low, high in known])
        without = 100 * (1 - len(bests) / studies), 100 * (1 - len(known) / studies)
        bends = [one.bend.value for one in found if one.bend is not None]
        cells = (
            *(f"{best_hz:g}", f"{np.median(bests):.1f}", f"{np.std(np.log2(bests), ddof=1):.2f}", f"{holds:.1f}"),
            *(f"{without[0]:.1f}", f"{without[1]:.1f}"),
            *(f"{BEND:g}", f"{np.mean(bends):.3f}", f"{np.std(bends, ddof=1):.3f}"),
        )
        print(",".join(("the top", str(studies), str(task.participants), *cells)))


def ahead(taps: int) -> None:
    """Print how well taps are predicted, by the tracker's rate, its noise, and how long before the touch."""
    step = Step(gate_top_mm=FROM_MM, gate_bottom_mm=AGAIN_MM, contact_mm=0.0)
    print("touch predicted,taps,tracker Hz,noise mm,ms ahead,aimed %,bias ms,SD ms")
    for rate_hz in (1000, 2500):
        for noise_mm in (0.005, 0.05):
            predictor = LandingPredictor(step, noise_mm=noise_mm, wander_mm=WANDER_MM)
            for ahead_ms in (10.0, 20.0, 30.0):
                rng, errors_ms = np.random.default_rng(42), []
                for _ in range(taps):
                    path, state, last = hand.tap(rng), predictor.init(), None
                    us = np.arange(0.0, path.contact_us - ahead_ms * 1e3, 1e6 / rate_hz)
                    heights = path.at(us) + noise_mm * rng.normal(size=us.size)
                    for at_us, mm in zip(us, heights, strict=True):
                        state = predictor.step(state, int(at_us), float(mm))
                        landing = None if state is None else predictor.landing(state)
                        in_time = landing is not None and landing.us - at_us >= ahead_ms * 1e3
                        if landing is not None and in_time and landing.standard_error_us <= SURE_US:
                            last = (landing.us - path.contact_us) / 1e3
                    errors_ms += [] if last is None else [last]
                cells = f"{100 * len(errors_ms) / taps:.1f}", f"{np.mean(errors_ms):.2f}", f"{np.std(errors_ms):.2f}"
                print(",".join(("a tap", str(taps), str(rate_hz), f"{noise_mm:g}", f"{ahead_ms:g}", *cells)))


if __name__ == "__main__":
    start = time.process_time()
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    sole(asked)
    harder(asked)
    for study in SIDES:
        delays(study, asked)
    crossover(asked)
    ahead(asked)
    print(f"{time.process_time() - start:.0f} s of the processor", file=sys.stderr)
