"""What the spine costs: run `python -m tests.benchmarks.spine`; every figure is a median, every ratio of one run.

Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation

STARTS = 21
REHEARSALS = 3
RENDERS = 300


def seconds(call: Callable[[], object]) -> float:
    """Wall-clock time of one call."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def start_up() -> tuple[float, float]:
    """Medians of `palpate --help` and of a bare interpreter, in turns, s."""
    palpate = shutil.which("palpate", path=str(Path(sys.executable).parent)) or "palpate"
    commands = ([palpate, "--help"], [sys.executable, "-c", "pass"])
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(STARTS):
        for command, taken in zip(commands, times, strict=True):
            taken.append(seconds(partial(subprocess.run, command, stdout=subprocess.DEVNULL, check=True)))
    return statistics.median(times[0]), statistics.median(times[1])


def rehearse(folder: Path, seed: int, jobs: int, participants: int) -> None:
    study.rehearse(
        protocol_file=shipped("okamoto2012.toml"),
        rig_file=shipped("rigs/rehearsal.toml"),
        out=folder / f"{seed}-{jobs}",
        participants=participants,
        seed=seed,
        jobs=jobs,
    )


def main() -> None:
    protocol = files.load(shipped("okamoto2012.toml"))
    palpate_s, bare_s = start_up()
    print(
        f"palpate --help              {palpate_s * 1e3:8.1f} ms   {palpate_s / bare_s:.1f} x bare python3 -c pass "
        f"({bare_s * 1e3:.1f} ms), {STARTS} runs"
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        times = [seconds(partial(rehearse, folder, seed, 1, 2)) for seed in range(REHEARSALS)]
        trials = 160
        print(
            f"one process                 {trials / statistics.median(times):8.1f} trials/s   "
            f"({trials} trials, preparation and dataset included, {REHEARSALS} runs)"
        )
        jobs = os.cpu_count() or 1
        whole_s = seconds(lambda: rehearse(folder, 99, jobs, 15))
        print(f"whole study, {jobs} processes    {1000 / whole_s:8.1f} trials/s   (25 sessions: {whole_s:.1f} s)")
        planned = scene.plan(protocol=protocol, task_id="virtual")
        materials = preparation.open_stimuli(
            scene=planned,
            protocol=protocol,
            recordings=folder / "0-1" / storage.RECORDINGS,
            output_rate_hz=48_000,
        )
        copy_paper = materials["copy paper"]
        speeds = [60.0 + i for i in range(RENDERS)]

        def sounded(speed_mm_s: float) -> object:
            return copy_paper.at(speed_mm_s).waveform_m_s2

        rendered = [seconds(partial(sounded, v)) for v in speeds]
        print(
            f"gate to waveform            {statistics.median(rendered) * 1e3:8.3f} ms   "
            f"(0.5 s at 48 kHz, median of {RENDERS}; worst {max(rendered) * 1e3:.3f} ms)"
        )


if __name__ == "__main__":
    main()
