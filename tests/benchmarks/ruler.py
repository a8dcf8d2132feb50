"""Contact as recorded, beside true contact: run `python -m tests.benchmarks.ruler [STEPS]`.

The truth is a simulated foot's: a minimum-jerk reach whose pace wavers, drawn as straight lines between 2,001 knots and
cut where it meets the panel, so that true contact is known to rounding (`trajectory` in
`experiment/rehearsal/wires/foot.py`). What follows contact is a sole and a panel that give way. Sensors have noise,
or none, and frames come at 1 or 5 kHz at a random phase.

Three rulers judge the same feet: contact as recorded, the root of a straight line through the last 3 mm, which was on
record before and still tells a session that a foot has landed, and the last prediction 12 ms ahead, which is what is
judged. Mean and standard deviation of each, ms, by speed; and by how many of its standard errors the recorded one was
off. Not a test: it asserts nothing, though its figures are those of any machine.
"""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.apparatus.tracker.gate import Contact, GateDetector
from palpate.experiment.apparatus.tracker.landing import Landing, LandingPredictor
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.wires import foot

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
STEPS = 2000
LEAD_US = 12_000
BEFORE_US = 50_000
AFTER_US = 60_000
SPEEDS_MM_S = ((50, 400), (50, 100), (300, 400))
Sensed = tuple[NDArray[np.int64], NDArray[np.float64]]


class Ruled(NamedTuple):
    """A foot's contact as recorded, as the detector had it at once, and as predicted; device time, microseconds."""

    recorded: Landing
    at_once_us: float
    predicted_us: float


def sensed(rng: np.random.Generator, step: foot.Trajectory, *, noise_mm: float, rate_hz: int) -> Sensed:
    """Return device times, microseconds, and heights, mm, from above the gate until the foot is at rest."""
    period_us = 1_000_000 // rate_hz
    from_us = int(step.gate_top_us) - BEFORE_US - int(rng.integers(period_us))
    us = np.arange(from_us, int(step.contact_us) + AFTER_US, period_us)
    return us, step.at(us.astype(np.float64)) + rng.normal(0, noise_mm, us.size)


def ruled(predictor: LandingPredictor, us: NDArray[np.int64], mm: NDArray[np.float64]) -> Ruled | None:
    """Return what is said of one foot; None where it was not seen to land."""
    detector = GateDetector(STEP)
    _, events = detector.step(detector.init(), Samples(us, mm, b"", np.zeros(us.size, np.int64), 0))
    contact = next((event for event in events if isinstance(event, Contact)), None)
    if contact is None:
        return None
    state, touch, predicted_us = predictor.init(), None, np.nan
    for at_us, height_mm in zip(us.tolist(), mm.tolist(), strict=True):
        if at_us >= contact.given_us:
            touch = predictor.touch(touch or predictor.touching(state, contact), at_us, height_mm, contact)
            continue
        state = predictor.step(state, at_us, height_mm)
        landing = None if state is None else predictor.landing(state)
        if landing is not None and landing.us - at_us >= LEAD_US:
            predicted_us = landing.us
    return None if touch is None else Ruled(touch.landing, contact.us, predicted_us)


def line(name: str, errors_ms: NDArray[np.float64], speeds_mm_s: NDArray[np.float64]) -> None:
    cells = []
    for low, high in SPEEDS_MM_S:
        some = errors_ms[(speeds_mm_s >= low) & (speeds_mm_s <= high)]
        cells.append(f"{low}-{high} mm/s: {np.nanmean(some):+7.3f} {np.nanstd(some):6.3f}")
    print(f"    {name:28s} " + "   ".join(cells) + f"   worst {np.nanmax(np.abs(errors_ms)):.2f}")


def main() -> None:
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else STEPS
    print(f"Less true contact, ms: mean and standard deviation over {steps} SIMULATED steps of 50-400 mm/s")
    for noise_mm, rate_hz in ((0.1, 1000), (0.0, 1000), (0.1, 5000)):
        rng = np.random.default_rng(1)
        predictor = LandingPredictor(STEP, noise_mm=noise_mm)
        found: list[tuple[float, Ruled, float]] = []
        begun = time.perf_counter()
        for speed_mm_s in rng.uniform(50, 400, steps).tolist():
            step = foot.trajectory(rng, speed_mm_s, hesitation="none")
            of_this = ruled(predictor, *sensed(rng, step, noise_mm=noise_mm, rate_hz=rate_hz))
            if of_this is not None:
                found.append((speed_mm_s, of_this, step.contact_us))
        print(
            f"  noise {noise_mm:g} mm, {rate_hz} Hz: {len(found)} landed; {time.perf_counter() - begun:.0f} s for all"
        )
        speeds, true_us = (np.array([row[column] for row in found]) for column in (0, 2))
        recorded_us, errors_us, at_once_us, predicted_us = np.array(
            [(one.recorded.us, one.recorded.standard_error_us, one.at_once_us, one.predicted_us) for _, one, _ in found]
        ).T
        line("recorded", (recorded_us - true_us) / 1e3, speeds)
        line("straight line, last 3 mm", (at_once_us - true_us) / 1e3, speeds)
        line(f"predicted {LEAD_US / 1e3:g} ms ahead", (predicted_us - true_us) / 1e3, speeds)
        off = (recorded_us - true_us) / errors_us
        print(f"    recorded, in its standard errors: {off.mean():+.2f} {off.std():.2f}; worst {abs(off).max():.1f}")


if __name__ == "__main__":
    main()
