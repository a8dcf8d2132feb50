"""One step watched with scripted devices: what is known of its contact afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.apparatus.tracker.gate import GateDetector, Scrutiny
from palpate.experiment.apparatus.tracker.landing import Landing, LandingPredictor
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires import foot
from palpate.experiment.session.kinds.footstep.watch import Feed, Watch, WatchedStep, watch
from tests.benchmarks.ruler import STEP
from tests.experiment.session.scripted import START_NS, Endless, ScriptedTracker


def reads(speed_mm_s: float, seed: int, size: int) -> tuple[list[Samples], float]:
    """A simulated step with 0.1 mm of noise at 1 kHz, so many frames a read, and its true contact, microseconds."""
    step = foot.trajectory(np.random.default_rng(seed), speed_mm_s, hesitation="none")
    us = np.arange(0, int(step.contact_us) + 200_000, 1000)
    mm = step.at(us.astype(np.float64)) + np.random.default_rng(step.noise_seed).normal(0, 0.1, us.size)
    whole = Samples(us, mm, bytes(us.size), np.arange(us.size) + 1, START_NS)
    pieces = []
    while whole.device_us.size:
        piece, whole = whole.cut(min(size, whole.device_us.size))
        pieces.append(piece)
    return pieces, step.contact_us


def watched(pieces: list[Samples]) -> WatchedStep:
    clock = ManualClock(START_NS)
    found = watch(
        Watch(
            feed=Feed(ScriptedTracker(pieces, clock=clock), simulated_time=True),
            scrutiny=Scrutiny(rate_hz=1000, noise_mm=0.1),
            detector=GateDetector(STEP),
            predictor=LandingPredictor(STEP, noise_mm=0.1),
            clock=clock,
            limits=Endless(),
            sounder=None,
        ),
        "paper",
    )
    assert isinstance(found, WatchedStep)
    return found


@pytest.mark.parametrize("speed_mm_s", [55.0, 120.0, 390.0])
def test_the_contact_of_a_step_is_the_same_however_reads_were_cut(speed_mm_s: float) -> None:
    found: set[tuple[Landing, int, int]] = set()
    for size in (1, 3, 8, 50, 10_000):
        pieces, contact_us = reads(speed_mm_s, 4, size)
        step = watched(pieces)
        assert abs(step.contact.us - contact_us) < 4 * step.contact.standard_error_us < 3000
        assert step.contact_ns == step.clock.session_ns(step.contact.us)
        found.add((step.contact, step.link.received, len(step.raw)))
    ((contact, received, _),) = found
    assert received == int(contact.us / 1000) + 1
