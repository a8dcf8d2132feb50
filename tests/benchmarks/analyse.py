"""What an analysis costs: run `python -m tests.benchmarks.analyse`; time and peak memory of the whole command.

The published study from a cold start, with and without figures; then 1,000 simulated participants, once as counts
without any order and once as trials with times and speeds. With numbers, such as `1000 2000 10000`, it takes so many
participants with 104 trials each instead, to show how the cost grows: 10,000 of them have a million. Each run is a
process of its own. Not a test of speed: the figures belong to the machine that printed them.
"""

from __future__ import annotations

import csv
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from palpate.experiment.dataset.bids import DatasetText, TaskText, description, events, participants, write_files
from palpate.experiment.dataset.imports import reconstruction
from palpate.experiment.dataset.imports import reconstruction as counts_file
from palpate.experiment.records.software import this

ROOT = Path(__file__).parents[2]
PARTICIPANTS, REPETITIONS, RUNS = 1000, 10, 5
MANY = 13
"""Repetitions where it is asked how the cost grows."""

MATERIALS = ("copy paper", "aluminum foil", "polypropylene", "typing paper")
RATIOS = {
    "virtual": ((0.79, 0.02, 0.04, 0.15), (0.08, 0.44, 0.14, 0.34), (0.06, 0.17, 0.64, 0.13), (0.2, 0.29, 0.2, 0.31)),
    "real": ((0.97, 0.01, 0.01, 0.01), (0.02, 0.59, 0.16, 0.23), (0.04, 0.14, 0.68, 0.14), (0.05, 0.28, 0.13, 0.54)),
}
"""Near the ratios of Okamoto's Tables 1 and 2, so that the analysis has as much to do as with the paper's data."""


def answers(task: str, shape: tuple[int, int]) -> np.ndarray:
    """Index of the answer of every participant, material and repetition; of so many participants and repetitions."""
    rng = np.random.default_rng([1, list(RATIOS).index(task)])
    return np.stack([rng.choice(len(MATERIALS), size=shape, p=row) for row in RATIOS[task]], axis=1)


def counts_dataset(folder: Path, shape: tuple[int, int]) -> Path:
    """As `palpate import-counts` makes it."""
    pairs = {}
    for task in RATIOS:
        pairs[task] = folder / f"{task}.csv"
        with pairs[task].open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(counts_file.COLUMNS)
            for who, rows in enumerate(answers(task, shape), start=1):
                for shown, said in zip(MATERIALS, rows, strict=True):
                    found = np.bincount(said, minlength=len(MATERIALS)).tolist()
                    writer.writerows(
                        [who, shown, answer, count] for answer, count in zip(MATERIALS, found, strict=True) if count
                    )
    return reconstruction.import_counts(
        pairs, folder / "counts", study=reconstruction.study_text("simulated", pairs, "simulated for a benchmark")
    )


def trials_dataset(folder: Path, shape: tuple[int, int]) -> Path:
    """As a rehearsal makes it, without sessions behind it."""
    root = folder / "trials"
    readme = "Simulated answers for a benchmark. " * 6
    text = DatasetText("simulated", "Simulated", "REHEARSAL", "CC0-1.0", ("Nobody",), tuple(RATIOS), readme, this())
    write_files(description(root, text))
    people_count, repetitions = shape
    labels = [f"{number:0{len(str(people_count))}}" for number in range(1, people_count + 1)]
    first = ("virtual", "real")
    people = ({"participant_id": f"sub-{who}", "first_task": first[int(who) % 2], "withdrawn": False} for who in labels)
    write_files(participants(root, people, origin="REHEARSAL"))
    rng = np.random.default_rng(2)
    for task in RATIOS:
        said = answers(task, shape)
        described = {material: material for material in MATERIALS}
        software = {"SoftwareName": "palpate"}
        words = TaskText(task, f"{task.title()} materials", "A task.", "Say it.", described, software, "REHEARSAL")
        for place, who in enumerate(labels):
            order = rng.permutation(len(MATERIALS) * repetitions)
            rows = (
                {
                    "onset": 5.0 * number,
                    "duration": 0.5,
                    "trial": number,
                    "attempt": 1,
                    "counted": True,
                    "presented": MATERIALS[cell // repetitions],
                    "answered": MATERIALS[said[place, cell // repetitions, cell % repetitions]],
                    "response_time": round(float(rng.gamma(4, 0.4)), 6),
                    "foot_speed": round(float(rng.uniform(60, 350)), 3),
                    "frames_lost": 0,
                    "delivered": True,
                    "onset_error": round(float(rng.normal(0, 5e-4)), 6),
                    "masker_level": 60.0 + place % 9,
                    "origin": "REHEARSAL",
                }
                for number, cell in enumerate(order.tolist(), start=1)
            )
            write_files(events(root, who, words, rows))
    return root


def run(*arguments: str) -> tuple[float, float, float]:
    """Wall-clock time, s, time on the processor, s, and peak memory, MB, of `palpate` with these arguments."""
    command = [sys.executable, "-m", "palpate.experiment", *arguments]
    begun = time.perf_counter()
    silence = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    child = os.posix_spawn(command[0], command, os.environ, file_actions=silence)
    _, status, usage = os.wait4(child, 0)
    if status:
        raise SystemExit(f"{' '.join(command)} failed")
    return time.perf_counter() - begun, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def lines(folder: Path) -> Iterator[str]:
    out = str(folder / "out")
    for flag in ("--no-figures", "--figures"):
        found = [run("analyse", str(ROOT / "participants" / "okamoto2012"), flag, "--out", out) for _ in range(RUNS)]
        taken, busy, memory = zip(*found, strict=True)
        spread = f"{min(taken):.2f} to {max(taken):.2f} s of {RUNS}"
        cost = f"busy {statistics.median(busy):.2f} s, {max(memory):.0f} MB"
        yield f"okamoto2012 {flag}: {statistics.median(taken):.2f} s ({spread}), {cost}"
    for make in (counts_dataset, trials_dataset):
        dataset = make(folder, (PARTICIPANTS, REPETITIONS))
        for flag in ("--no-figures", "--figures"):
            taken_s, busy_s, memory_mb = run("analyse", str(dataset), flag, "--out", f"{out}-{dataset.name}")
            cost = f"{taken_s:.1f} s, busy {busy_s:.1f} s, {memory_mb:.0f} MB"
            yield f"{PARTICIPANTS} participants, {dataset.name}, {flag}: {cost}"


def growth(folder: Path, people: int) -> str:
    """What so many participants cost, without figures."""
    dataset = trials_dataset(folder, (people, MANY))
    taken_s, busy_s, memory_mb = run("analyse", str(dataset), "--no-figures", "--out", str(folder / "out"))
    trials = people * MANY * len(MATERIALS) * len(RATIOS)
    return f"{people} participants, {trials} trials: {taken_s:.1f} s, busy {busy_s:.1f} s, {memory_mb:.0f} MB"


def main() -> None:
    """Print the figures."""
    for people in map(int, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as folder:
            print(growth(Path(folder), people), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for line in () if sys.argv[1:] else lines(Path(folder)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
