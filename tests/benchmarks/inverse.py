"""How near an inverse brings a measured panel, and what it costs: run `python -m tests.benchmarks.inverse [seed]`.

The simulated materials at ten speeds, as the inverse of a panel's measured response has a causal panel move, which was
measured in memory; what equation (7) makes of them `python -m tests.benchmarks.panel` has. The truth is the simulation
in time with states, which shares no code with either. Levels are of third octaves from 10 to 500 Hz that hold a
thousandth of the energy or more; profiles are compared in time, both within 10 to 500 Hz, rms of the difference by rms.
Times are from a speed to samples, by those of equation (7) with the limit of a measured panel, turn by turn.
Everything is SIMULATED.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

from palpate.experiment.apparatus.panel import inverse
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.movement import Movement
from palpate.experiment.rehearsal.wires.modes import Modes, MovingPanel
from palpate.experiment.synthesis.felt import felt
from palpate.experiment.synthesis.shaping import Response
from palpate.experiment.synthesis.voltages import Drive
from palpate.experiment.synthesis.waveforms import Basis
from tests.benchmarks.drift import FULL_SCALE_V, RATE_HZ, reference
from tests.benchmarks.limit import PANELS, drawn, panel_of, response, resting
from tests.benchmarks.panel import SPEEDS_MM_S, bases

LINEAR: Mapping[str, Modes] = {
    **{name: PANELS[name] for name in ("one mode", "two modes", "loaded")},
    "three modes": panel_of((90.0, 0.04, 0.4), (210.0, 0.05, 0.3), (450.0, 0.08, 0.3)),
    "stiff, one mode": resting((60.0, 0.3), (230.0, 0.02, 1.0)),
    "soft, two modes": resting((28.0, 0.35), (140.0, 0.06, 0.55), (330.0, 0.07, 0.45)),
    "stiff, four modes": resting(
        (45.0, 0.2), (70.0, 0.05, 0.3), (150.0, 0.04, 0.3), (260.0, 0.06, 0.2), (410.0, 0.05, 0.2)
    ),
    "four modes, a null": PANELS["four modes"],
}
"""The inverse's constants were chosen on these. The last one has a zero to the right of the axis, at 122.8 Hz: what
inverts it would begin some 0.14 s before."""


DRAWN = 20
AHEAD_S = (0.0, 0.005, 0.01, 0.02)
BAND_HZ = (10.0, 500.0)


@dataclass(frozen=True)
class Row:
    """The worst of all stimuli: third octave, dB, profile in time, what the budget states of it less than there is, and
    the highest sample for each m/s^2.
    """

    third_octave_db: float
    profile: float
    understated: float
    highest: float


def within(waveform: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """What of a waveform is in the band, shape (size,)."""
    bins, f = np.fft.rfft(waveform, size), np.fft.rfftfreq(size, 1 / RATE_HZ)
    return np.asarray(np.fft.irfft(np.where((f >= BAND_HZ[0]) & (f <= BAND_HZ[1]), bins, 0.0), size))


def row(modes: Modes, condition: Conditioner, stimuli: list[Basis]) -> Row:
    """Play every material at every speed."""
    worst = np.array([0.0, 0.0, -inf, 0.0])
    ahead, (low_hz, high_hz) = round(condition.ahead_s * RATE_HZ), inverse.BAND_HZ
    for basis in stimuli:
        for speed in SPEEDS_MM_S:
            played = condition(basis.at(float(speed)))
            asked = played.stimulus.waveform_m_s2
            volts = played.samples.astype(float) * played.full_scale / played.scale
            moved = MovingPanel(modes).moved(volts, rate_hz=RATE_HZ)
            size = 2 * moved.size
            wanted, found = within(np.pad(asked, (ahead, 0)), size), within(moved, size)
            thirds = felt(asked, moved, rate_hz=RATE_HZ).third_octave_db
            profile = float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))
            highest = float(np.abs(played.samples).max()) / played.scale / float(np.abs(asked).max())
            missed = fft.dct(moved[ahead : ahead + asked.size] - asked, norm="ortho")
            f = np.arange(asked.size) * RATE_HZ / 2 / asked.size
            share = float(np.linalg.norm(missed[(f >= low_hz) & (f <= high_hz)]) / np.linalg.norm(asked))
            worst = np.maximum(worst, [thirds, profile, share - played.budget()[0].inverse, highest])
    return Row(*worst.tolist())


def least(modes: Modes, asked: NDArray[np.float64], ahead: int, most: float) -> float:
    """The least rms in the band by which any samples of rms `most` at most miss a waveform, as a part of its own.

    They begin `ahead` samples before it and end 0.3 s after it. By least squares with the poles and residues
    of the panel and a cost of their power, which falls until it buys `most`: of all with that power they are nearest.
    """
    count = ahead + asked.size + round(0.3 * RATE_HZ)
    size = fft.next_fast_len(2 * count, real=True)
    f = np.fft.rfftfreq(size, 1 / RATE_HZ).astype(np.float64)
    counts = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    true = np.where(counts, response(modes, f), 0.0)
    wanted = np.where(counts, fft.rfft(np.pad(asked, (ahead, 0)), size), 0.0)
    for cost in np.square(np.abs(true)).max() * 10.0 ** -np.arange(3.0, 11.0):
        column = fft.irfft(np.square(np.abs(true)) + cost, size)[:count]
        samples = linalg.solve_toeplitz(column, fft.irfft(np.conj(true) * wanted, size)[:count])
        if np.sqrt(np.mean(samples**2)) >= most:
            break
    return float(np.linalg.norm(true * fft.rfft(samples, size) - wanted) / np.linalg.norm(wanted))


def conditioners(modes: Modes, seed: int, stimuli: Mapping[str, Basis]) -> Iterator[tuple[str, Conditioner, float]]:
    """Each way of one panel, which is measured once, and its highest gain beside that of the usable band."""
    stated, found = reference(modes, np.random.default_rng(seed))
    movement = Movement(found, stated, RATE_HZ)
    f = np.concatenate([np.arange(10.0, 30.0, 2.0), np.arange(30.0, 605.0, 5.0)])
    table = Response(f, np.array([0.1, 1e3]), np.abs(response(modes, f))[:, None] / FULL_SCALE_V * [[0.1, 1e3]])
    drive = Drive(stimuli, rate_hz=RATE_HZ, response=table, gain_limit_v_per_m_s2=10.0, limit_v=inf)
    loud = 1e6
    yield "equation (7)", Conditioner(full_scale=loud, limit_m_s2=loud, drive=drive, movement=movement), 0.0
    for ahead_s in AHEAD_S:
        way = inverse.Inverse(movement, ahead_s=ahead_s)
        made = Conditioner(full_scale=FULL_SCALE_V, limit_m_s2=1e9, drive=drive, movement=movement, inverse=way)
        yield f"inverse, {ahead_s * 1e3:g} ms", made, way.highest_gain


def ratio(first: Conditioner, second: Conditioner, basis: Basis) -> float:
    """The median time of the second way by that of the first, from a speed to samples, turn by turn."""
    times: tuple[list[float], list[float]] = ([], [])
    for speed in np.random.default_rng(1).uniform(50.0, 300.0, 200):
        for way, took in zip((first, second), times, strict=True):
            began = time.perf_counter()
            way(basis.at(float(speed)))
            took.append(time.perf_counter() - began)
    return float(np.median(times[1]) / np.median(times[0]))


def main(first_seed: int = 0) -> None:
    prepared = bases()
    print(
        "| panel | way | third octaves, dB | profile, rms | understated | highest sample for 1 m/s^2 | highest gain "
        "| time by (7) |"
    )
    print("|:--|:--|--:|--:|--:|--:|--:|--:|")
    panels = {**LINEAR, **{f"drawn {number}": drawn(number) for number in range(DRAWN)}}
    for seed, (name, modes) in enumerate(panels.items(), start=first_seed):
        first: Conditioner | None = None
        for way, condition, gain in conditioners(modes, seed, prepared):
            first = first or condition
            if condition is first:
                continue
            found = row(modes, condition, list(prepared.values()))
            took = ratio(first, condition, next(iter(prepared.values())))
            cells = [
                f"{found.third_octave_db:.2f}",
                f"{found.profile:.1%}",
                f"{found.understated:.1%}",
                f"{found.highest:.3g}",
                f"{gain:.0f}",
            ]
            print(f"| {name} | {way} | {' | '.join([*cells, f'{took:.2f}'])} |", flush=True)


def nearest() -> None:
    """Print how near any samples could bring the panel with a null, with no more power than the inverse takes."""
    modes, stimuli = LINEAR["four modes, a null"], bases().values()
    for way, condition, _ in conditioners(modes, 0, bases()):
        if ahead := round(condition.ahead_s * RATE_HZ):
            missed = []
            for basis in stimuli:
                for speed in SPEEDS_MM_S[::3]:
                    played = condition(basis.at(float(speed)))
                    rms = float(np.sqrt(np.mean(np.square(played.samples / played.scale))))
                    missed.append(least(modes, played.stimulus.waveform_m_s2, ahead, rms))
            print(f"{way}: at least {max(missed):.1%}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
    nearest()
