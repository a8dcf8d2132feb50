"""Onset at contact: run `python -m tests.benchmarks.onset`.

How far predicted contact is from true contact, by speed, noise and lead; beside a straight line through the last 40 ms.
What prediction costs. How long a foot that left the gate waits for its stimulus to be scheduled, and an answered trial
for the next to be armed, on an idle machine and with every core loaded. Not a test: it asserts nothing, because these
figures belong to the machine that printed them.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker.landing import LandingPredictor
from palpate.experiment.desk.questions import Arm, Question, Reply, TrialAnswer
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.kinds.footstep.participant import SimulatedParticipant
from palpate.experiment.rehearsal.wires import foot
from tests.benchmarks.scheduling import STEP, STEPS, loaded, report, spread

LEADS_MS = (5.0, 10.0, 12.0, 15.0, 20.0)
LINE_US = 40_000

Sensed = list[tuple[NDArray[np.int64], NDArray[np.float64], float, float]]
"""Device times, heights, true contact and speed of each step."""


def feet(noise_mm: float, rate_hz: int) -> Sensed:
    rng = np.random.default_rng(1)
    made = []
    for speed_mm_s in rng.uniform(50, 400, STEPS):
        step = foot.trajectory(rng, float(speed_mm_s), hesitation="none")
        us = np.arange(int(step.gate_top_us) - int(rng.integers(1000)), int(step.contact_us), 1_000_000 // rate_hz)
        made.append(
            (us, step.at(us.astype(np.float64)) + rng.normal(0, noise_mm, us.size), step.contact_us, float(speed_mm_s))
        )
    return made


def filtered_ms(steps: Sensed, noise_mm: float) -> tuple[NDArray[np.float64], float]:
    """Errors of the last prediction in time for each lead, shape (steps, leads), ms; and the cost of a sample, us."""
    predictor = LandingPredictor(STEP, noise_mm=noise_mm)
    errors = np.full((len(steps), len(LEADS_MS)), np.nan)
    samples, begun = 0, time.perf_counter()
    for row, (us, mm, contact_us, _) in enumerate(steps):
        state = predictor.init()
        for at_us, height_mm in zip(us.tolist(), mm.tolist(), strict=True):
            state = predictor.step(state, at_us, height_mm)
            landing = predictor.landing(state) if state is not None and height_mm < 9 else None
            if landing is not None:
                in_time = landing.us - at_us >= np.array(LEADS_MS) * 1e3
                errors[row, in_time] = (landing.us - contact_us) / 1e3
        samples += us.size
    return errors, (time.perf_counter() - begun) / samples * 1e6


def straight_ms(steps: Sensed) -> NDArray[np.float64]:
    """The same for a straight line through the last 40 ms."""
    errors = np.full((len(steps), len(LEADS_MS)), np.nan)
    for row, (us, mm, contact_us, _) in enumerate(steps):
        for end in range(int(np.argmax(mm < 9)), us.size):
            near = slice(int(np.searchsorted(us, us[end] - LINE_US)), end + 1)
            slope, height_mm = np.polyfit(us[near] - us[end], mm[near], 1)
            left_us = -height_mm / slope
            errors[row, left_us >= np.array(LEADS_MS) * 1e3] = (us[end] + left_us - contact_us) / 1e3
    return errors


def shown(name: str, errors: NDArray[np.float64], speeds: NDArray[np.float64]) -> None:
    print(f"  {name}")
    for column, lead_ms in enumerate(LEADS_MS):
        cells = []
        for low, high in ((50, 400), (50, 100), (300, 400)):
            some = errors[(speeds >= low) & (speeds <= high), column]
            cells.append(f"{low}-{high} mm/s: {np.nanmean(some):+7.3f} {np.nanstd(some):6.3f}")
        print(f"    lead {lead_ms:4.0f} ms   " + "   ".join(cells) + f"   none: {np.isnan(errors[:, column]).sum()}")


def dead_ms(folder: Path, name: str) -> list[float]:
    """From each keyed answer to the next trial's arming, in a rehearsal with every write on disk."""
    waited: list[float] = []
    answered_ns = 0
    ask = SimulatedParticipant.ask

    def asked(self: SimulatedParticipant, question: Question | Arm) -> Reply:
        nonlocal answered_ns
        armed = isinstance(question, Arm) and question.attempt == 1 and question.trial > 1
        if answered_ns and armed:
            waited.append((time.perf_counter_ns() - answered_ns) / 1e6)
        reply = ask(self, question)
        if isinstance(question, TrialAnswer):
            answered_ns = time.perf_counter_ns()
        return reply

    SimulatedParticipant.ask = asked  # type: ignore[method-assign]
    try:
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"),
            rig_file=shipped("rigs/rehearsal.toml"),
            out=folder / name,
            participants=3,
            seed=3,
        )
    finally:
        SimulatedParticipant.ask = ask  # type: ignore[method-assign]
    return waited


def main() -> None:
    print(f"Predicted minus true contact, ms: mean and standard deviation over {STEPS} steps of 50-400 mm/s")
    for noise_mm, rate_hz in ((0.1, 1000), (0.0, 1000), (0.1, 5000)):
        steps = feet(noise_mm, rate_hz)
        speeds = np.array([speed for *_, speed in steps])
        errors, cost_us = filtered_ms(steps, noise_mm)
        shown(
            f"filter, noise {noise_mm:g} mm, {rate_hz} Hz ({cost_us:.1f} us a sample, prediction included)",
            errors,
            speeds,
        )
        if noise_mm and rate_hz == 1000:
            shown("straight line through 40 ms, same feet", straight_ms(steps), speeds)
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("Waiting, ms")
        spread("answer to armed", dead_ms(folder, "rehearsal"))
        with loaded(cores):
            spread(f"answer to armed, {cores} cores loaded", dead_ms(folder, "loaded"))
        print("Gate to scheduled")
        report(folder, STEPS)


if __name__ == "__main__":
    main()
