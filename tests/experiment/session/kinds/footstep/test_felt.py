"""Third octaves and envelope of a movement beside what was asked for, by closed forms and on a causal panel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from palpate.experiment.apparatus.panel.movement import Movement
from palpate.experiment.rehearsal.wires.modes import FINER, respond
from palpate.experiment.session.kinds.footstep.error_budget import Detailed, ErrorBudget
from palpate.experiment.session.kinds.footstep.felt import Felt, felt
from palpate.experiment.synthesis.budget import Budget
from tests.benchmarks import limit
from tests.benchmarks.drift import FULL_SCALE_V, RATE_HZ, reference

T = np.arange(2500) / RATE_HZ
TONE = np.sin(2 * np.pi * 100 * T)


@pytest.mark.parametrize("gain", [0.5, 1.0, 2.0])
def test_a_gain_is_that_many_decibels_in_both(gain: float) -> None:
    found = felt(TONE, np.pad(gain * TONE, (0, 1000)), rate_hz=RATE_HZ)
    decibels = abs(20 * np.log10(gain))
    assert (found.third_octave_db, found.envelope_db) == pytest.approx((decibels, decibels), abs=1e-9)


def test_a_third_octave_alone_and_a_stretch_in_time_alone() -> None:
    other = 0.5 * np.sin(2 * np.pi * 300 * T)
    spectral = felt(TONE + other, TONE + 2 * other, rate_hz=RATE_HZ)
    assert spectral.third_octave_db == pytest.approx(20 * np.log10(2), abs=0.05)
    # 1 + 1 / 4 parts of energy become 1 + 1.
    assert spectral.envelope_db == pytest.approx(10 * np.log10(2 / 1.25), abs=0.01)
    softer = TONE.copy()
    softer[1000:1100] *= 0.5
    assert felt(TONE, softer, rate_hz=RATE_HZ).envelope_db == pytest.approx(20 * np.log10(2), abs=1e-9)
    assert felt(np.zeros(2500), np.zeros(2600), rate_hz=RATE_HZ).third_octave_db == 0.0


def test_a_plan_shows_them_of_a_measured_panel_alone() -> None:
    each = (Felt(1.0, 0.25, 0.1, 0.9), Felt(3.5, 0.5, 0.2, 1.0))
    made = Detailed((20.0, 600.0), (Budget(1.0, 0.0),) * 2, (), (), None, None, each)
    plain = replace(made, felt=())
    shown, hidden = (ErrorBudget({"cork": of}, (None, None), None, False, "") for of in (made, plain))
    rows = [line.split()[-3:] for line in shown.lines() if ", dB" in line]
    assert rows == [["1.0", "to", "3.5"], ["0.2", "to", "0.5"]]
    assert [line.split()[-3:] for line in shown.lines() if ", %" in line and "noticed" in line] == [
        ["10", "to", "20"],
        ["90", "to", "100"],
    ]
    assert not any(", dB" in line for line in hidden.lines())
    assert max(map(len, shown.lines())) <= 100


def test_a_measured_panel_moves_as_a_simulation_in_time_says() -> None:
    """The simulation has states, and no code of what predicts."""
    modes = limit.PANELS["four modes"]
    stated, found = reference(modes, np.random.default_rng(3))
    window = np.hanning(2500)
    asked = sum(np.sin(2 * np.pi * hz * T + hz) for hz in (40.0, 95.0, 210.0, 330.0)) * window
    samples = (asked * 1e-2).astype(np.float32)
    predicted = Movement(found, stated, RATE_HZ).moved_m_s2(samples)
    drive_v = np.pad(samples.astype(float) * FULL_SCALE_V, (0, predicted.size - samples.size))
    true = respond(modes, signal.resample_poly(drive_v, FINER, 1), rate_hz=FINER * RATE_HZ)
    true = true[::FINER]
    one, other = (felt(asked, moved, rate_hz=RATE_HZ) for moved in (predicted, true))
    assert one.third_octave_db == pytest.approx(other.third_octave_db, abs=0.3)
    assert one.envelope_db == pytest.approx(other.envelope_db, abs=0.3)
    assert np.linalg.norm(predicted - true) < 0.02 * np.linalg.norm(true)
