"""How well studies of footsteps give back what SIMULATED people tell: run `python -m tests.benchmarks.footsteps [200]`.

Of `profile.toml`, `ahead.toml` and `weight.toml`, from waveforms that a session would hand over. Each of `PEOPLE` is
the observer of `palpate rehearse`, and feels each material of each task at `STEPS` speeds, evenly spaced by how often
feet have them: how often each answer comes is known, and so what is true of these people. Participants of a study are
drawn from them, one for both tasks, as in a rehearsal; the second task is felt alike, or, planted, `SHARPER` times as
sharply. Counts are drawn, and the analysis' own intervals and P computed.

Of the share of right answers in either task, and of their difference: the true one, the mean over studies, and how
often the 95 % interval holds the true one. `in power %`: how often a study's difference lies within the central 95 % of
what `palpate power` draws by a choice model of these people; `P %` and `power %`: how often the planned test of the two
tasks has a P below alpha, and in how many of its studies power has one.

It is no rehearsal: nothing passes a port, a step's speed is known without error, none breaks off or comes again, and
answers within a task are independent given the observer. Not a test: it asserts nothing.
"""

from __future__ import annotations

import sys
import time
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri, softmax

from palpate.analysis.power.choice_models import Answers, ChoiceModel
from palpate.analysis.power.planned_tests import answer, design
from palpate.analysis.statistics.exact import mean_gaps
from palpate.analysis.statistics.shares import difference_limits, share_limits
from palpate.analysis.statistics.sign_flips import sign_flip
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import open_conditioner, open_drive
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.kinds.footstep.participant import SPEED_MEDIAN_MM_S, SPEED_SIGMA, Observer
from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import SimulatedMaterials, make_recordings
from palpate.experiment.rehearsal.wires.panel import moved
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep.preparation import open_stimuli

STUDIES = ("profile.toml", "ahead.toml", "weight.toml")
PEOPLE, STEPS, SHARPER, SEED = 200, 24, 1.5, 42
SLOWEST_MM_S, FASTEST_MM_S = 55.0, 390.0
"""No foot of a rehearsal is slower or faster."""

POWER_STUDIES = 4000
TEST = "sign flips between tasks"

Array = NDArray[np.float64]


def speeds_mm_s(protocol: Protocol) -> Array:
    """Return speeds that a rehearsal's feet have equally often, of those that count."""
    limits = {rule.when: rule.limit for rule in protocol.exclusion if rule.limit}
    ends = np.log([limits.get("speed-below", 1.0), limits.get("speed-above", inf)]) - np.log(SPEED_MEDIAN_MM_S)
    low, high = ndtr(ends / SPEED_SIGMA)
    drawn = SPEED_MEDIAN_MM_S * np.exp(SPEED_SIGMA * ndtri(low + (np.arange(STEPS) + 0.5) / STEPS * (high - low)))
    return np.asarray(np.clip(drawn, SLOWEST_MM_S, FASTEST_MM_S))


def delivered(protocol: Protocol, rig: rigs.Rig, rig_folder: Path, speeds: Array) -> list[list[list[Array]]]:
    """Return how the panel of a rehearsal moves, m/s^2, by task, material and speed."""
    limit_m_s2, actuator = protocol.exposure.vibration_peak_m_s2, rig.actuator

    def panel(samples: NDArray[np.float32]) -> Array:
        return moved(samples.astype(np.float64) * actuator.full_scale, rate_hz=actuator.rate_hz)

    found: list[list[list[Array]]] = []
    with TemporaryDirectory() as folder:
        recordings = Path(folder) / "recordings"
        make_recordings(recordings, protocol=protocol, seed=SEED)
        for task in protocol.tasks:
            prepared = open_stimuli(
                scene=scene.plan(protocol=protocol, task_id=task.id),
                protocol=protocol,
                recordings=recordings,
                output_rate_hz=actuator.rate_hz,
            )
            drive = open_drive(rig_folder, actuator, limit_m_s2=limit_m_s2, materials=prepared)
            condition = open_conditioner(rig, limit_m_s2=limit_m_s2, drive=drive)
            bases = [prepared[material.id] for material in protocol.materials]
            found.append([[panel(condition(basis.at(v)).samples) for v in speeds.tolist()] for basis in bases])
    return found


def percepts(protocol: Protocol) -> Array:
    """Return how like each material every step feels, shape (people, tasks, materials, steps, materials)."""
    rig_file, synthesis = files.shipped("rigs/rehearsal.toml"), protocol.table(Footstep).synthesis
    rig, speeds = rigs.load(rig_file), speeds_mm_s(protocol)
    every = delivered(protocol, rig, rig_file.parent, speeds)
    materials, names = SimulatedMaterials(synthesis.rate_hz, synthesis.samples), [m.id for m in protocol.materials]
    found = np.zeros((PEOPLE, len(every), len(names), STEPS, len(names)))
    for person, own in enumerate(found):
        rng = np.random.default_rng([SEED, person])
        observer = Observer(materials, names, rng=rng)
        observer.familiarise(rng=rng)
        for task, material, step in np.ndindex(own.shape[:-1]):
            v = float(speeds[step])
            take = materials.take(None, speed_mm_s=v, rng=rng)
            felt = observer.feel_virtual(
                take, every[task][material][step], rate_hz=rig.actuator.rate_hz, speed_mm_s=v
            ).alike
            # Where nothing is noticed, all are alike.
            if felt is not None and felt.size:
                own[task, material, step] = felt
    return found


def shares_of(felt: Array, sharper: float) -> Array:
    """Return how often each answer comes, shape (people, tasks, materials, answers), the second task felt `sharper`."""
    of_task = np.array([1.0, sharper])[None, :, None, None, None]
    return np.asarray(softmax(felt * of_task, axis=-1).mean(axis=3))


def powered(protocol: Protocol, shares: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Return the differences of the tasks that power draws for people of these shares, and how often P is below alpha.

    Its choice model has the mean shares, and the spread of the people by moments.
    """
    means, planned = shares.mean(axis=0), design(protocol, {})
    spreads = shares.var(axis=0).sum(axis=-1) / (means * (1 - means)).sum(axis=-1)
    rows = np.concatenate([means, np.zeros((*means.shape[:2], 1))], axis=-1)
    tasks = [Answers(task.id, *each) for task, *each in zip(protocol.tasks, rows, spreads, strict=True)]
    drawn = ChoiceModel("SIMULATED people", tuple(tasks)).drawn(planned, planned.participants, POWER_STUDIES, rng)
    one, other = (np.trace(drawn[task.id]).mean(axis=-1) / task.repetitions / len(rows[0]) for task in protocol.tasks)
    (asked,) = (one for one in answer(planned, drawn).items() if one[0].test == TEST)
    assert asked[0].alpha is not None
    assert asked[1].p is not None
    return one - other, float(np.mean(asked[1].p < asked[0].alpha))


def studied(protocol: Protocol, shares: Array, rng: np.random.Generator) -> dict[str, Any]:
    """Return what the analysis says of one study: shares with limits, their difference with limits, and P."""
    tasks, people = protocol.tasks, protocol.study.participants
    own = shares[rng.integers(len(shares), size=people)]
    counts = np.array([rng.multinomial(task.repetitions, own[:, t]) for t, task in enumerate(tasks)])
    right = np.moveaxis(np.diagonal(counts, axis1=2, axis2=3), 2, 1)
    trials = np.moveaxis(counts.sum(axis=-1), 2, 1)
    gaps = mean_gaps(right, trials)
    gap, of_each = np.array(gaps, dtype=np.float64), (right.sum(axis=1), trials.sum(axis=1))
    return {
        "shares": [float((n / total).mean()) for n, total in zip(*of_each, strict=True)],
        "limits": [share_limits(n, total) for n, total in zip(*of_each, strict=True)],
        "gap": float(gap.mean()),
        "gap_limits": difference_limits(*of_each, gap),
        "p": sign_flip(gaps, 0, rng).p,
    }


HEAD = (
    "study,second task,studies,participants,first: true %,mean %,holds %,second: true %,mean %,holds %,"
    "difference: true %,mean %,SD %,holds %,in power %,P %,power %"
)


def row(name: str, felt: Array, studies: int, *, sharper: float) -> str:
    """Return the row of many studies."""
    protocol, rng = files.load(files.shipped(name)), np.random.default_rng(SEED)
    (alpha,) = (test.alpha for test in protocol.analysis if test.test == TEST)
    shares = shares_of(felt, sharper)
    true = np.trace(shares, axis1=2, axis2=3).mean(axis=0) / len(protocol.materials)
    true_gap = float(true[0] - true[1])
    differences, power = powered(protocol, shares, rng)
    low, high = np.quantile(differences, (0.025, 0.975))
    found = [studied(protocol, shares, rng) for _ in range(studies)]
    cells: list[Any] = []
    for task, its in enumerate(true.tolist()):
        holds = [(one["limits"][task].low or 0.0) <= its <= (one["limits"][task].high or 1.0) for one in found]
        cells += [its, np.mean([one["shares"][task] for one in found]), np.mean(holds)]
    gaps = np.array([one["gap"] for one in found])
    holds = [one["gap_limits"].low <= true_gap <= one["gap_limits"].high for one in found]
    cells += [true_gap, gaps.mean(), gaps.std(ddof=1), np.mean(holds), np.mean((low <= gaps) & (gaps <= high))]
    cells += [np.mean([one["p"] < alpha for one in found]), power]
    second = "alike" if sharper == 1 else f"{sharper:g} times as sharp"
    shown = (f"{100 * float(cell):.1f}" for cell in cells)
    return ",".join((name, second, str(studies), str(protocol.study.participants), *shown))


if __name__ == "__main__":
    start = time.process_time()
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print(HEAD)
    for study in STUDIES:
        felt = percepts(files.load(files.shipped(study)))
        for sharper in (1.0, SHARPER):
            print(row(study, felt, asked, sharper=sharper), flush=True)
    print(f"{time.process_time() - start:.0f} s of the processor", file=sys.stderr)
