"""Whether what a plan states of a measured panel is so: run `python -m tests.benchmarks.felt [seed]`.

Five causal panels, one of which got a load after it was measured and one a coil that takes 10 % off the loudest sample,
and others beside them, are measured in memory and play the simulated materials at ten speeds, by equation (7) and by
their inverse. What is stated of third octaves and envelope (`Movement.felt`) stands beside the truth: a simulation that
was written from the words of `protocols/rigs/rehearsal-panel.toml`, but for what a load does to a mode, which its
writer took from the source. What limits take off a whole stimulus is in neither. Everything is SIMULATED.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.apparatus.panel import drift
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.inverse import Inverse
from palpate.experiment.apparatus.panel.movement import Movement
from palpate.experiment.rehearsal.wires.modes import Load, Modes
from palpate.experiment.synthesis.felt import Felt, felt
from palpate.experiment.synthesis.shaping import Response
from palpate.experiment.synthesis.voltages import Drive
from palpate.experiment.synthesis.waveforms import Basis
from tests.benchmarks.drift import FULL_SCALE_V, RATE_HZ, devices, reference
from tests.benchmarks.inverse import LINEAR
from tests.benchmarks.limit import LOUDEST, ONE_MODE, PANELS, response
from tests.benchmarks.panel import SPEEDS_MM_S, bases

FINE = 16
"""Times as fine as the samples."""

RESTS = 64
"""Samples of rest before the first one, for what a band-limited line does before it."""

AHEAD_S = 0.01
LIMIT_M_S2 = 1e3


def moved_m_s2(panel: Modes, volts: NDArray[np.float64], *, rate_hz: int, size: int) -> NDArray[np.float64]:
    """How a panel at rest moves by volts, shape (n,), and after them, shape (size,), at the same rate.

    Band-limited lines through the samples, the coil, the suspension, and the modes side by side, each an ordinary
    differential equation of second order by first-order hold.
    """
    drive = signal.resample(np.pad(volts, (RESTS, size - volts.size)), FINE * (RESTS + size))
    if panel.soft_v is not None:
        drive = panel.soft_v * np.arcsinh(drive / panel.soft_v)
    mass, damping = (panel.load.mass, panel.load.damping) if panel.load is not None else (0.0, 0.0)

    def passed(by: NDArray[np.float64], hz: float, ratio: float, *, low: bool) -> NDArray[np.float64]:
        w = 2 * np.pi * hz / np.sqrt(1 + mass)
        above = [w * w] if low else [1.0, 0.0, 0.0]
        b, a, _ = signal.cont2discrete((above, [1.0, 2 * (ratio + damping) * w, w * w]), 1 / rate_hz / FINE, "foh")
        return np.asarray(signal.lfilter(np.ravel(b), a, by))

    base = passed(drive, panel.suspension.frequency_hz, panel.suspension.damping, low=False)
    modes = sum(mode.part * passed(base, mode.frequency_hz, mode.damping, low=True) for mode in panel.modes)
    return np.asarray(panel.gain_m_s2_per_v / (1 + mass) * modes)[RESTS * FINE :: FINE]


def loaded(mass: float) -> Modes:
    """The panel of one mode with something on it."""
    return ONE_MODE.model_copy(update={"load": Load(name="a bag", mass=mass, damping=0.0)})


FIVE: Mapping[str, tuple[Modes, Modes]] = {
    **{name: (LINEAR[name], LINEAR[name]) for name in ("one mode", "two modes", "three modes")},
    "one mode, 3 % heavier": (ONE_MODE, loaded(0.03)),
    "soft coil": (ONE_MODE.model_copy(update={"soft_v": 3.82}),) * 2,
}
"""Each panel as it was measured, and as it plays. A load of 3 % is what a comparison lets pass without a warning; the
coil takes 10 % off 3.4 V."""

OTHERS: Mapping[str, tuple[Modes, Modes]] = {
    "four modes, a null": (PANELS["four modes"], PANELS["four modes"]),
    "one mode, 4 % heavier": (ONE_MODE, loaded(0.04)),
}


@dataclass(frozen=True)
class Row:
    """Of one quantity of all stimuli: the truth, dB, and what was stated, with its interval, each of shape (40,)."""

    truth_db: NDArray[np.float64]
    stated_db: NDArray[np.float64]
    low_db: NDArray[np.float64]
    high_db: NDArray[np.float64]

    @property
    def near(self) -> int:
        """How many are stated within 10 % or 0.3 dB."""
        return int(np.sum(np.abs(self.stated_db - self.truth_db) <= np.maximum(0.3, 0.1 * self.truth_db)))

    @property
    def holds(self) -> int:
        """How many intervals have the truth in them."""
        return int(np.sum((self.low_db <= self.truth_db) & (self.truth_db <= self.high_db)))

    @property
    def narrow(self) -> int:
        """How many intervals are no wider than twice the truth."""
        return int(np.sum(self.high_db - self.low_db <= 2 * self.truth_db))


def felts(
    now: Modes, condition: Conditioner, movement: Movement, compared: Movement, stimuli: list[Basis]
) -> Iterator[tuple[Felt, Felt, Felt]]:
    """What is true of every material at every speed, and what is stated by a plan, and once a panel was compared."""
    ahead = round(condition.ahead_s * RATE_HZ)
    for basis in stimuli:
        for speed in SPEEDS_MM_S:
            played = condition(basis.at(float(speed)))
            down = min(1.0, LOUDEST / float(np.abs(played.samples).max()))
            samples = (played.samples * down).astype(np.float32)
            asked = played.stimulus.waveform_m_s2 * (down * played.scale * played.panel_scale)
            volts = samples.astype(np.float64) * FULL_SCALE_V
            # Of one length, for the level of a low third octave hangs on where the few frequencies in it lie.
            size = movement.moved_m_s2(samples).size
            true = moved_m_s2(now, volts, rate_hz=RATE_HZ, size=size)[ahead:]
            planned, known = (of.felt(asked, samples, ahead=ahead) for of in (movement, compared))
            yield felt(asked, true, rate_hz=RATE_HZ), planned, known


def rows(before: Modes, now: Modes, seed: int, prepared: Mapping[str, Basis]) -> Iterator[tuple[str, float, Row, Row]]:
    """Each way and quantity of a panel that was measured once and then compared: their names, the drift on record, dB,
    what a plan states, and what a session records.
    """
    rng = np.random.default_rng(seed)
    stated, found = reference(before, rng)
    movement = Movement(found, stated, RATE_HZ)
    drifts = drift.compare(devices(now, rng), stated, found, peak=stated.check_peak, rng=rng)
    drifted = drift.at_most(drifts)
    f = np.concatenate([np.arange(8.0, 30.0, 1.0), np.arange(30.0, 605.0, 5.0)])
    table = Response(f, np.array([0.1, 1e3]), np.abs(response(before, f))[:, None] / FULL_SCALE_V * [[0.1, 1e3]])
    drive = Drive(prepared, rate_hz=RATE_HZ, response=table, gain_limit_v_per_m_s2=10.0, limit_v=FULL_SCALE_V)
    for way, inverse in (("equation (7)", None), ("inverse 10 ms ahead", Inverse(movement, ahead_s=AHEAD_S))):
        condition = Conditioner(
            full_scale=FULL_SCALE_V, limit_m_s2=LIMIT_M_S2, drive=drive, movement=movement, inverse=inverse
        )
        compared = replace(movement, drifted=drifted)
        every = list(felts(now, condition, movement, compared, list(prepared.values())))
        for quantity, of in (("third octaves", "third_octave"), ("envelope", "envelope")):
            truth, stated_db = (np.array([getattr(one[i], f"{of}_db") for one in every]) for i in (0, 1))
            between = [np.array([getattr(one[i], f"{of}_between_db") for one in every]).T for i in (1, 2)]
            planned, known = (Row(truth, stated_db, *one) for one in between)
            yield f"{way},{quantity}", drifted.off_db, planned, known


def main(seed: int = 0) -> None:
    prepared = bases()
    print("panel,drift on record,way,of,truth,off,10 % or 0.3 dB,interval holds,narrow,compared: holds,narrow")
    for name, (before, now) in {**FIVE, **OTHERS}.items():
        for what, off_db, row, known in rows(before, now, seed, prepared):
            truth = f"{row.truth_db.min():.2f} to {row.truth_db.max():.2f} dB"
            off = f"{np.abs(row.stated_db - row.truth_db).max():.2f} dB"
            counts = ",".join(map(str, (row.near, row.holds, row.narrow, known.holds, known.narrow)))
            print(f'"{name}",{off_db:.2f} dB,{what},{truth},{off},{counts}', flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
