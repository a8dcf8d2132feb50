"""What a panel drifted, from lines that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from palpate.experiment.apparatus.panel import calibration, multisine
from palpate.experiment.apparatus.panel.accelerometer import Gap, Window
from palpate.experiment.apparatus.panel.calibration import Devices
from palpate.experiment.apparatus.panel.drift import drifts
from palpate.experiment.apparatus.panel.movement import Reference
from palpate.experiment.errors import RecordingError
from tests.benchmarks.drift import RATE_HZ, Memory
from tests.benchmarks.limit import ONE_MODE


@pytest.mark.parametrize("lines_hz", [np.arange(8, 620), np.array([50, 51, 400])], ids=["every band", "three lines"])
def test_third_octaves_in_which_the_reference_has_a_line_have_their_drift(lines_hz: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    response = np.full(lines_hz.size, 20.0 + 5.0j)
    reference = Reference(lines_hz, response, np.full(lines_hz.size, 1e-3))
    played = np.full(lines_hz.size, 0.1 + 0.0j)
    louder = 10 ** (1.5 / 20)
    noise = rng.normal(scale=1e-4, size=(8, lines_hz.size, 2)) @ np.array([1, 1j])
    found = list(drifts(played, louder * played * response + noise, reference, gain=1.0))
    assert len(found) == (17 if lines_hz.size > 3 else 2)
    assert [one.db for one in found] == pytest.approx([1.5] * len(found), abs=0.05)


@dataclass
class Losing:
    """Implements `Listener`: a memory that loses some samples of its first windows, where they count or before."""

    memory: Memory
    times: int
    at_s: float
    armed: int = 0

    def arm(self, samples: int) -> None:
        self.armed += 1
        self.memory.arm(samples)

    def heard_since_armed(self) -> Window:
        window = self.memory.heard_since_armed()
        return replace(window, gaps=(Gap(self.at_s, 0.008),) if self.armed <= self.times else ())


@pytest.mark.parametrize(("times", "at_s", "armed"), [(0, 2.0, 1), (2, 2.0, 3), (9, 0.5, 1), (9, 3.9, 1)])
def test_a_multisine_is_played_again_where_samples_that_count_were_lost(times: int, at_s: float, armed: int) -> None:
    heard, listener = _heard(times, at_s)
    assert (heard().shape[0], listener.armed) == (2, armed)


def test_a_multisine_of_which_samples_are_lost_each_time_is_refused() -> None:
    heard, listener = _heard(9, 2.0)
    with pytest.raises(RecordingError):
        heard()
    assert listener.armed == calibration.TRIES


def _heard(times: int, at_s: float) -> tuple[Callable[[], np.ndarray], Losing]:
    memory = Memory(ONE_MODE, np.random.default_rng(1))
    losing = Losing(memory, times, at_s)
    lines_hz = multisine.lines(RATE_HZ)
    amplitudes = 0.1 * multisine.drawn(lines_hz, rate_hz=RATE_HZ, rng=np.random.default_rng(2))
    on = Devices(memory, losing, RATE_HZ, RATE_HZ)
    return lambda: calibration.heard(on, amplitudes, lines_hz, 2), losing
