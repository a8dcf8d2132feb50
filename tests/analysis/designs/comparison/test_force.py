"""The error of a recorded force: against a simulation in which the force moves the hand, and by another program."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from math import inf, nan, sqrt
from pathlib import Path

import numpy as np
import pytest

from palpate.analysis.designs.comparison import force
from palpate.analysis.designs.comparison.force import CAUSES, NOTHING, Law, Sums, run_sums, trace_sums
from palpate.experiment.apparatus.servo import rendering
from palpate.experiment.apparatus.servo.observer import QUANTUM_SD, TOLD_KG
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, Rendered, bounded
from palpate.experiment.synthesis.contact.block import Block
from palpate.experiment.synthesis.contact.observer import Observer
from tests.benchmarks.force import COUNT_M, IN_S, LIMIT_N, NOISE_M, PARTS, STARTS_M, Hand, law_n

PERIOD_S, SPEED_M_S = 4e-4, 0.1
LAW = Law(2500.0, 100.0, LIMIT_N, 1 / PERIOD_S)


def tap(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Tap with a device of 0.1 kg and 5 N s/m; return height, force asked and sent of each cycle, and the truth.

    The truth are mean squares: of the held law's error, of the sent force's, and of that beside the whole law, and of
    the laws. They are of the path itself, which nothing that is judged here sees.
    """
    rng = np.random.default_rng(seed)
    observer = Observer(PERIOD_S, sqrt(NOISE_M**2 + (QUANTUM_SD * COUNT_M) ** 2), TOLD_KG)
    block = Block((2500.0,) * 2, (100.0,) * 2, (inf,) * 2, into=(-1.0, 0.0), nominal_s=PERIOD_S)
    begun_s, turned_s = rng.uniform(0.0, PERIOD_S), STARTS_M / SPEED_M_S + IN_S
    hand, at, sent_n = Hand(0.1, 5.0, PERIOD_S / PARTS, (-STARTS_M, 0.0)), Rendered(), NO_FORCE
    rows, truth = [], np.zeros(5)
    for n in range(round(2 * turned_s / PERIOD_S)):
        mm = -1e3 * COUNT_M * round((hand.at[0] + rng.normal(0.0, NOISE_M)) / COUNT_M)
        at, _ = rendering.step(block, at, n * 400, (mm, 0.0), observer, sent_n)
        sent_n, held_n = bounded(at.force_n, LIMIT_N), law_n(*hand.at)
        rows.append((mm, at.force_n[0], sent_n[0]))
        for part in range(PARTS):
            t_s = (n + (part + 0.5) / PARTS) * PERIOD_S - begun_s
            goes_m_s = -SPEED_M_S if t_s > turned_s else SPEED_M_S
            hand.go_on((SPEED_M_S * min(t_s, 2 * turned_s - t_s) - STARTS_M, goes_m_s), sent_n[0])
            m, m_s = hand.at
            within, whole = law_n(m, m_s), max(2500 * m + 100 * m_s, 0.0) if m > 0 else 0.0
            off = (held_n - within, sent_n[0] - within, sent_n[0] - whole, within, whole)
            truth += np.square(off)
    return np.array(rows), truth


@pytest.fixture(scope="module")
def taps() -> list[tuple[np.ndarray, np.ndarray]]:
    return [tap(seed) for seed in range(4)]


def test_the_error_of_what_was_sent_is_that_of_a_simulation_that_knows_the_path(
    taps: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    hold, sent, whole, within2, whole2 = np.sqrt(sum(truth for _, truth in taps))
    total: Sums = NOTHING
    for rows, _ in taps:
        total = total.plus(run_sums(LAW, *rows.T))
    parts = total.parts()
    assert parts["sent"] == pytest.approx(sent / within2, rel=0.1)
    assert parts["limit"] == pytest.approx(whole / whole2, rel=0.1)
    assert parts["hold"] == pytest.approx(hold / within2, abs=0.05)
    # What the servo asked for within the limit is what was sent.
    assert parts["observer and noise"] == pytest.approx(parts["sent"], rel=0.01)
    assert total.noise_part() < 0.05


def written(folder: Path, runs: list[np.ndarray], **more: float | list[float]) -> Path:
    """Write runs with a gap between them, as a dataset has them."""
    columns = ["hand_height", "force_asked", "force_sent"]
    stated = {"StiffnessNewtonPerMetre": 2500.0, "DampingNewtonSecondPerMetre": 100.0, "LimitNewton": 3.0}
    sidecar = {"SamplingFrequency": 2500, "Columns": columns, "Force": {**stated, "LostCycles": 3, **more}}
    lines = [line for run in runs for line in ["n/a\tn/a\tn/a", *("\t".join(map(str, row)) for row in run)]]
    table = folder / "recording-force_physio.tsv.gz"
    table.write_bytes(gzip.compress(("\n".join(lines) + "\n").encode().replace(b"nan", b"n/a")))
    table.with_name("recording-force_physio.json").write_text(json.dumps(sidecar))
    return table


def test_another_program_finds_the_same(tmp_path: Path, taps: list[tuple[np.ndarray, np.ndarray]]) -> None:
    runs = [rows.copy() for rows, _ in taps[:2]]
    # A cycle in which no sample came.
    runs[0][40, 0] = nan
    table = written(tmp_path, runs)
    sums, lost = trace_sums(table)
    assert (lost, sums.cycles) == (3, sum(map(len, runs)))
    file = Path(__file__).with_name("force_by_hand.py")
    told = subprocess.run([sys.executable, file, table], capture_output=True, check=True, text=True).stdout
    assert list(sums.parts().values()) == pytest.approx([float(one) for one in told.split()], abs=0.005)


def test_nothing_is_stated_of_a_block_that_gives_way_or_has_crossovers_or_of_too_short_a_run(tmp_path: Path) -> None:
    run = np.tile([-0.1, 1.0, 1.0], (force.WINDOW - 1, 1))
    long = [np.tile(run, (9, 1))]
    crossed: dict[str, float | list[float]] = {"CrossoversHertz": [10.0, 20.0]}
    for runs, facts in (([run], {}), (long, {"BlockKilogram": 0.5}), (long, crossed)):
        sums, _ = trace_sums(written(tmp_path, runs, **facts))
        assert all(np.isnan(part) for part in sums.parts().values())
    assert len(CAUSES) == len(sums.parts())
