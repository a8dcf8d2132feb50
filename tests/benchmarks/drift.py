"""How surely a drifting panel is found before a session: run `python -m tests.benchmarks.drift`.

A causal panel is measured once and compared again and again, each time by another draw of phases, noise, delay and
clock, in memory: no port carries the samples. It drifts by its gain, up or down.
"""

from __future__ import annotations

import sys
from collections import Counter
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import calibration, drift, measured
from palpate.experiment.apparatus.panel.accelerometer import Window
from palpate.experiment.apparatus.panel.calibration import Calibration, Devices
from palpate.experiment.apparatus.panel.movement import Reference, read_reference
from palpate.experiment.apparatus.rig import MeasuredRig
from palpate.experiment.findings import Verdict
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.modes import Modes, MovingPanel, read
from palpate.experiment.rehearsal.wires.sensor import REST_NOISE_M_S2

RATE_HZ = 5000
PEAK = 0.2
FULL_SCALE_V = rigs.load(shipped("rigs/rehearsal.toml")).actuator.full_scale
CLOCK_PPM = 100.0
"""The sensor's clock is off by up to so much."""


FINER = 16


class Memory:
    """Implements `Player` and `Listener` by arithmetic."""

    def __init__(self, modes: Modes, rng: np.random.Generator, noise_m_s2: float = REST_NOISE_M_S2) -> None:
        self._modes, self._rng, self._noise_m_s2 = modes, rng, noise_m_s2
        self._faster = 1 + 1e-6 * rng.uniform(-CLOCK_PPM, CLOCK_PPM)
        self._samples, self._moved = 0, np.zeros(0)

    def arm(self, samples: int) -> None:
        self._samples = samples

    def play(self, samples: NDArray[np.float32]) -> None:
        self._moved = MovingPanel(self._modes).moved(samples.astype(np.float64) * FULL_SCALE_V, rate_hz=RATE_HZ)

    def heard_since_armed(self) -> Window:
        late = self._rng.uniform(100, 1500)
        # Straight lines between samples that are 16 times as dense take 0.002 dB off at 500 Hz.
        moved = signal.resample_poly(self._moved, FINER, 1)
        at = (np.arange(self._samples) - late) * self._faster * FINER
        heard = np.interp(at, np.arange(moved.size), moved, left=0.0, right=0.0)
        return Window(heard + self._rng.normal(0.0, self._noise_m_s2, heard.size), 0)


def devices(modes: Modes, rng: np.random.Generator, noise_m_s2: float = REST_NOISE_M_S2) -> Devices:
    """What plays and hears."""
    memory = Memory(modes, rng, noise_m_s2)
    return Devices(memory, memory, RATE_HZ, RATE_HZ)


def reference(modes: Modes, rng: np.random.Generator) -> tuple[MeasuredRig, Reference]:
    """A panel as it was measured, and its response."""
    made: Calibration = calibration.measure(devices(modes, rng), loudest=PEAK, seed=1)
    stated = MeasuredRig(
        response="panel.csv",
        response_sha256="0" * 64,
        load="nobody",
        full_scale_m_s2=made.figures.full_scale_m_s2,
        low_hz=made.figures.low_hz,
        high_hz=made.figures.high_hz,
        resonances_hz=(),
        loudest=PEAK,
        check_peak=calibration.LEVELS[0] * PEAK,
        compression_db=made.compression_db,
        accelerometer_m_s2=100.0,
        calibrated_on=date(2026, 1, 1),
        calibration_days=30,
    )
    return stated, read_reference(Path("panel.csv"), measured.table(made.found, ()))


def drifted(modes: Modes, db: float) -> Modes:
    """The panel with another gain."""
    return modes.model_copy(update={"gain_m_s2_per_v": modes.gain_m_s2_per_v * 10 ** (db / 20)})


def verdicts(modes: Modes, drifts_db: list[float], *, seed: int) -> Counter[Verdict]:
    """How often a panel that was measured once is passed, warned of and refused, once for each drift."""
    rng = np.random.default_rng(seed)
    stated, response = reference(modes, rng)
    counted: Counter[Verdict] = Counter()
    for db in drifts_db:
        on = devices(drifted(modes, db), rng)
        found = drift.compare(on, stated, response, peak=stated.check_peak, rng=rng)
        counted[drift.judged(found, Path("rig.toml")).verdict] += 1
    return counted


def main() -> None:
    """Print how often drift is found, and how often none is reported."""
    modes = read(shipped("rigs/rehearsal-panel.toml"))
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print(f"no drift, {times} times: {dict(verdicts(modes, [0.0] * times, seed=1))}")
    for db in (1.5, -1.5, 3.5, -3.5):
        print(f"{db:+g} dB, 100 times: {dict(verdicts(modes, [db] * 100, seed=2))}")


if __name__ == "__main__":
    main()
