"""Whether the limit of vibration holds for what a panel does: run `python -m tests.benchmarks.limit [stimuli a panel]`.

Causal panels are measured in memory, with the noise of a simulated sensor, and driven through the conditioner by
stimuli that look for the worst; the drawn panels have drifted since, and were compared. The truth is a
simulation in time with states, eight times as fine as the samples, which shares no code with what limits. Everything is
SIMULATED.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.apparatus.panel import drift
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.movement import DRIFT_DB, Movement
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.modes import FINER, Mode, Modes, Resonance, poles_and_residues, read, respond
from palpate.experiment.synthesis.waveforms import Ring
from tests.benchmarks.drift import FULL_SCALE_V, RATE_HZ, devices, drifted, reference

ONE_MODE = read(shipped("rigs/rehearsal-panel.toml"))
MODE = ONE_MODE.modes[0]
LOADED = MODE.loaded(0.2, 0.05), ONE_MODE.suspension.loaded(0.2, 0.05)


def panel_of(*modes: tuple[float, float, float]) -> Modes:
    """The panel of one mode with others in its place: frequency, damping and part of each."""
    made = tuple(Mode(frequency_hz=hz, damping=damping, part=part) for hz, damping, part in modes)
    return ONE_MODE.model_copy(update={"modes": made})


def resting(suspension: tuple[float, float], *modes: tuple[float, float, float]) -> Modes:
    """A panel on a suspension of its own: frequency and damping."""
    frequency_hz, damping = suspension
    return panel_of(*modes).model_copy(update={"suspension": Resonance(frequency_hz=frequency_hz, damping=damping)})


def drawn(number: int) -> Modes:
    """A panel that nobody chose: one to four modes that move alike, damped by 2 to 12 %, on 20 to 60 Hz."""
    rng = np.random.default_rng(1000 + number)
    hz = 70.0 * 7.0 ** ((np.arange(1 + number % 4) + rng.uniform(0.1, 0.9, 1 + number % 4)) / (1 + number % 4))
    parts = rng.uniform(0.2, 1.0, hz.size)
    modes = zip(hz.tolist(), rng.uniform(0.02, 0.12, hz.size).tolist(), (parts / parts.sum()).tolist(), strict=True)
    return resting((float(rng.uniform(20.0, 60.0)), float(rng.uniform(0.1, 0.4))), *modes)


PANELS: Mapping[str, Modes] = {
    "one mode": ONE_MODE,
    "two modes": panel_of((180.0, 0.05, 0.6), (420.0, 0.12, 0.4)),
    "four modes": panel_of((90.0, 0.03, 0.4), (160.0, 0.05, -0.2), (300.0, 0.04, 0.5), (470.0, 0.06, 0.3)),
    "loaded": ONE_MODE.model_copy(update={"modes": (LOADED[0],), "suspension": LOADED[1]}),
    "soft coil": ONE_MODE.model_copy(update={"soft_v": 5.0}),
}
"""The soft coil takes 6.4 % off 3.4 V, the loudest (5 asinh(3.4 / 5) / 3.4)."""

LIMIT_M_S2 = 5.0
LOUDEST = 3.4 / FULL_SCALE_V
"""The highest sample."""

SECONDS = 0.5
COUNT = round(SECONDS * RATE_HZ)
HIGHEST_HZ = 2000.0
"""So far panels are measured by a sensor of 5000 Hz."""


def response(modes: Modes, frequencies_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Acceleration of a sample of 1.0, shape (K,), from poles and residues."""
    s = 2j * np.pi * frequencies_hz
    found = np.zeros(s.size, np.complex128)
    for pole, residue in poles_and_residues(modes):
        found += residue / (s - pole) + np.conj(residue) / (s - np.conj(pole))
    return FULL_SCALE_V * found


def true_peak_m_s2(modes: Modes, samples: NDArray[np.float32]) -> float:
    """The largest magnitude that samples move a panel by until it rests; a converter's filter begins before them."""
    drive_v = signal.resample_poly(np.pad(samples.astype(float), (100, RATE_HZ // 5)), FINER, 1) * FULL_SCALE_V
    if modes.soft_v is not None:
        drive_v = modes.soft_v * np.arcsinh(drive_v / modes.soft_v)
    return float(np.abs(respond(modes, drive_v, rate_hz=FINER * RATE_HZ)).max())


@dataclass(frozen=True)
class Adversary:
    """What makes stimuli: the panel's impulse response, and what its measurement is off by, at the bins of a grid."""

    impulse: NDArray[np.float64]
    error: NDArray[np.complex128]
    f: NDArray[np.float64]

    def aimed(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """The impulse response backward: of all stimuli of its energy it peaks highest."""
        last = int(rng.integers(self.impulse.size // 4, COUNT))
        return np.pad(self.impulse[: last + 1][::-1], (0, COUNT - last - 1))

    def banged(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Its sign: of all stimuli with that highest sample it peaks highest."""
        return np.sign(self.aimed(rng))

    def misled(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """What meets all that the measurement is off by at once, in a band."""
        low, high = np.sort(rng.uniform(5.0, HIGHEST_HZ, 2))
        bins = np.where((self.f >= low) & (self.f <= high), np.conj(self.error), 0.0)
        bins = bins * np.exp(-2j * np.pi * self.f * rng.uniform(0.1, 0.4))
        return np.asarray(np.fft.irfft(bins / np.maximum(np.abs(bins), 1e-12))[:COUNT])

    def noise(self, rng: np.random.Generator) -> NDArray[np.float64]:
        return rng.normal(size=COUNT)

    def tone(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """A burst, which may peak between its samples."""
        t, hz = np.arange(COUNT) / RATE_HZ, float(np.exp(rng.uniform(np.log(5.0), np.log(HIGHEST_HZ))))
        return np.asarray(np.sin(2 * np.pi * hz * t + rng.uniform(0, 2 * np.pi)) * (t < rng.uniform(0.02, SECONDS)))

    def sweep(self, rng: np.random.Generator) -> NDArray[np.float64]:
        t = np.arange(COUNT) / RATE_HZ
        first, last = rng.uniform(5.0, HIGHEST_HZ, 2)
        return np.asarray(signal.chirp(t, first, SECONDS, last, phi=float(rng.uniform(0, 360))))

    def knock(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Few samples."""
        made = np.zeros(COUNT)
        made[rng.integers(0, COUNT, int(rng.integers(1, 6)))] = rng.choice([-1.0, 1.0])
        return made

    def step(self, rng: np.random.Generator) -> NDArray[np.float64]:
        return np.repeat([1.0, *rng.choice([-1.0, 0.0, 1.0], 9)], COUNT // 10)


WAYS: tuple[Callable[[Adversary, np.random.Generator], NDArray[np.float64]], ...] = (
    Adversary.aimed,
    Adversary.banged,
    Adversary.misled,
    Adversary.noise,
    Adversary.tone,
    Adversary.sweep,
    Adversary.knock,
    Adversary.step,
)


@dataclass(frozen=True)
class Row:
    """What was found of one panel.

    `over`: how often the truth was above the limit; `highest`: the truth by the limit, at most; `below`: stimuli whose
    own true peak is below 0.8 of the limit, and `attenuated` those of them that were taken down. `stated` is the rms
    standard error of the response from 10 to 500 Hz by the rms of what it is off by.
    """

    stimuli: int
    over: int
    highest: float
    below: int
    attenuated: int
    stated: float


def row(modes: Modes, stimuli: int, *, seed: int, drift_db: float = 0.0) -> Row:
    """Measure a panel that then drifts, compare it, and drive it by 0.3 to 3 times what reaches the limit."""
    rng = np.random.default_rng(seed)
    stated, found = reference(modes, rng)
    now = drifted(modes, drift_db)
    compared = drift.compare(devices(now, rng), stated, found, peak=stated.check_peak, rng=rng)
    movement = Movement(found, stated, RATE_HZ, drift.at_most(compared))
    condition = Conditioner(full_scale=FULL_SCALE_V, limit_m_s2=LIMIT_M_S2, movement=movement)
    lines = found.lines_hz.astype(float)
    off = found.response_m_s2 * np.exp(2j * np.pi * lines * _delay_s(modes, found.response_m_s2, lines))
    off -= response(modes, lines)
    within = (lines >= 10) & (lines <= 500)
    f = np.fft.rfftfreq(2 * COUNT, 1 / RATE_HZ).astype(np.float64)
    impulse = np.fft.irfft(response(modes, f))[:COUNT]
    error = np.interp(f, lines, off.real) + 1j * np.interp(f, lines, off.imag)
    adversary = Adversary(impulse / np.abs(impulse).max(), error, f)
    over = below = attenuated = 0
    highest = 0.0
    for i in range(stimuli):
        made = WAYS[i % len(WAYS)](adversary, rng)
        if not made.any():
            continue
        own = movement.peak(made * 1e-3 / np.abs(made).max()).peak_m_s2
        most = min(1e-3 * LIMIT_M_S2 / own * float(rng.uniform(0.3, 3.0)), LOUDEST)
        wanted = made / np.abs(made).max() * most
        played = condition(Ring(wanted * FULL_SCALE_V, RATE_HZ))
        true = true_peak_m_s2(now, played.samples)
        over += true > LIMIT_M_S2
        highest = max(highest, true / LIMIT_M_S2)
        changed = played.panel_scale < 1 or played.limited > 0
        before = true_peak_m_s2(now, wanted.astype(np.float32)) if changed else true
        below += before < 0.8 * LIMIT_M_S2
        attenuated += changed and before < 0.8 * LIMIT_M_S2
    ratio = np.sqrt(2 * np.mean(found.standard_error_m_s2[within] ** 2) / np.mean(np.abs(off[within]) ** 2))
    return Row(stimuli, over, highest, below, attenuated, float(ratio))


def _delay_s(modes: Modes, found: NDArray[np.complex128], lines: NDArray[np.float64]) -> float:
    """The delay that a measured response has beside the true one: a table of a response has none of its own."""
    crossed = found * np.conj(response(modes, lines))
    delays = np.arange(-2e-3, 2e-3, 1e-7)
    coarse = delays[:: len(delays) // 400]
    at = coarse[np.argmax([(crossed * np.exp(2j * np.pi * lines * d)).sum().real for d in coarse])]
    near = delays[np.abs(delays - at) < 2e-5]
    return float(near[np.argmax([(crossed * np.exp(2j * np.pi * lines * d)).sum().real for d in near])])


def main() -> None:
    stimuli = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    print(
        "| panel | drift, dB | stimuli | over the limit | highest, of it | below 0.8 | of them attenuated "
        "| stated by true error |"
    )
    print("|:--|--:|--:|--:|--:|--:|--:|--:|")
    every = [(name, modes, 0.0) for name, modes in PANELS.items()]
    every += [(f"drawn {n}", drawn(n), db) for n in (101, 102, 103) for db in (-DRIFT_DB, 0.0, DRIFT_DB)]
    for seed, (name, modes, db) in enumerate(every):
        found = row(modes, stimuli, seed=seed, drift_db=db)
        cells = [f"{db:+g}", f"{found.stimuli:,}", f"{found.over}", f"{found.highest:.4f}", f"{found.below:,}"]
        print(f"| {name} | {' | '.join([*cells, str(found.attenuated), f'{found.stated:.2f}'])} |", flush=True)


if __name__ == "__main__":
    main()
