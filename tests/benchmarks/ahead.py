"""Vibrations before contact: run `python -m tests.benchmarks.ahead [STEPS]`; results/ahead.csv has 100 of each.

SIMULATED feet of 75 to 300 mm/s above a tracker, whose samples come at a random phase, with noise. A foot is straight
(one speed), a reach (minimum jerk, as in a rehearsal), slowed (to half of its speed on the last 15 to 25 mm, evenly) or
broken off (it brakes on 3 mm, and stands 2 to 12 mm above the panel). The gate is 50 to 40 mm above it. Stimuli are
aimed as a session does, and can be moved or taken back until `LEAD_MS` before they sound.

Of a foot that lands: bias and SD of the onset beside its time before contact, and the standard error that the predictor
stated (root mean square); and the SD of the gate's speed, % of the true one. `felt` is how many feel a vibration, %: of
a foot that breaks off, those for which it had begun. A switch or a force sensor predicts nothing and knows no speed:
the switch closes at contact, the sensor of a foot that presses by `STIFFNESS_N_MM` passes `THRESHOLD_N`; the vibration
sounds the lead after the sample that shows it. Not a test: it asserts nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.apparatus.tracker.gate import Gate, GateDetector
from palpate.experiment.apparatus.tracker.landing import Landing, LandingPredictor
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.wires import foot

STEP = Step(gate_top_mm=50.0, gate_bottom_mm=40.0, contact_mm=0.0)
RATES_HZ, NOISES_MM, AHEAD_MS = (100, 250, 500, 1000, 5000), (0.1, 0.5), (0, 20, 50, 100)
FEET = ("straight", "reach", "slowed", "broken off")
SPEEDS_MM_S, REST_MM, LEAD_MS, STEPS = (75.0, 300.0), 70.0, 8.0, 100
STIFFNESS_N_MM, THRESHOLD_N, FORCE_NOISE_N = 10.0, 1.0, 0.1
SEED = 42

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Path:
    """A foot's height at times from 0, its contact (infinite where it breaks off), s, and its speed in the gate."""

    s: Array
    mm: Array
    contact_s: float
    speed_mm_s: float


def path(kind: str, speed_mm_s: float, rng: np.random.Generator) -> Path:
    """Return how a foot comes down, with 0.3 s after it has stopped or landed."""
    if kind == "reach":
        drawn = foot.trajectory(rng, speed_mm_s, rest_mm=REST_MM, hesitation="none")
        gate_s = np.interp([-STEP.gate_top_mm, -STEP.gate_bottom_mm], *_falling(drawn)) / 1e6
        speed = (STEP.gate_top_mm - STEP.gate_bottom_mm) / float(gate_s[1] - gate_s[0])
        return Path(drawn.us / 1e6, drawn.height_mm, drawn.contact_us / 1e6, speed)
    ends_mm, brakes_mm, part = {
        "straight": (0.0, 0.0, 1.0),
        "slowed": (0.0, rng.uniform(15, 25), 0.5),
        "broken off": (rng.uniform(2, 12), foot.BRAKES_MM, 0.0),
    }[kind]
    even_s, braked_s = (REST_MM - ends_mm - brakes_mm) / speed_mm_s, 2 * brakes_mm / (speed_mm_s * (1 + part))
    s = np.arange(0.0, even_s + braked_s + 0.3, 1e-5)
    braking_s = np.clip(s - even_s, 0.0, braked_s)
    slower = speed_mm_s * (1 - part) * braking_s**2 / (2 * braked_s) if braked_s else 0.0
    mm = REST_MM - speed_mm_s * (np.minimum(s, even_s) + braking_s) + slower
    return Path(s, mm, inf if ends_mm else even_s + braked_s, speed_mm_s)


def _falling(drawn: foot.Trajectory) -> tuple[Array, Array]:
    falls = drawn.us <= drawn.contact_us
    return -np.minimum.accumulate(drawn.height_mm[falls]), drawn.us[falls]


@dataclass
class Aim:
    """Where one vibration is aimed, until it begins."""

    ahead_us: float
    landing: Landing | None = None
    begun: bool = False

    def follow(self, landing: Landing | None, us: int) -> None:
        """Move the onset as a session does after a sample."""
        sounds_us = self.ahead_us + LEAD_MS * 1e3
        self.begun = self.begun or (self.landing is not None and us >= self.landing.us - sounds_us)
        if not self.begun and landing is not None and landing.us - us >= sounds_us:
            self.landing = landing


@dataclass(frozen=True)
class Seen:
    """What one step gave: the gate's speed and the aims, by how long they are before contact, ms."""

    speed_mm_s: float
    aims: dict[int, Aim]


def seen(one: Path, rate_hz: int, noise_mm: float, rng: np.random.Generator) -> Seen:
    us = np.arange(rng.uniform(0, 1e6 / rate_hz), one.s[-1] * 1e6, 1e6 / rate_hz).round().astype(np.int64)
    mm = np.interp(us / 1e6, one.s, one.mm) + rng.normal(0, noise_mm, us.size)
    detector, predictor = GateDetector(STEP), LandingPredictor(STEP, noise_mm=noise_mm)
    whole = Samples(us, mm, bytes(us.size), np.arange(us.size) + 1, 0)
    gate = next((event for event in detector.step(detector.init(), whole)[1] if isinstance(event, Gate)), None)
    aims = {ahead: Aim(ahead * 1e3) for ahead in AHEAD_MS}
    if gate is None:
        return Seen(nan, aims)
    state = predictor.init()
    for at_us, at_mm in zip(us.tolist(), mm.tolist(), strict=True):
        if at_us >= one.contact_s * 1e6:
            break
        state = predictor.step(state, at_us, at_mm)
        if at_us < gate.given_us:
            continue
        hesitates = bool(predictor.hesitates(state, gate))
        landing = None if hesitates or state is None else predictor.landing(state)
        for aim in aims.values():
            aim.follow(landing, at_us)
            if hesitates and not aim.begun:
                aim.landing = None
        if hesitates:
            break
    return Seen(gate.speed_mm_s, aims)


def tracked(rate_hz: int, noise_mm: float, kind: str, steps: int) -> Iterator[str]:
    """Yield a row for each time before contact."""
    rng = np.random.default_rng([SEED, rate_hz, round(noise_mm * 10), FEET.index(kind)])
    paths = [path(kind, float(rng.uniform(*SPEEDS_MM_S)), rng) for _ in range(steps)]
    found = [seen(one, rate_hz, noise_mm, rng) for one in paths]
    speeds = np.array([each.speed_mm_s / one.speed_mm_s - 1 for each, one in zip(found, paths, strict=True)])
    for ahead in AHEAD_MS:
        felt = [(each.aims[ahead].landing, one.contact_s) for each, one in zip(found, paths, strict=True)]
        aimed = [(landing, contact_s) for landing, contact_s in felt if landing is not None]
        cells = ["", "", ""]
        if kind != "broken off" and aimed:
            off_ms = np.array([landing.us / 1e3 - contact_s * 1e3 for landing, contact_s in aimed])
            stated_ms = np.sqrt(np.mean([(landing.standard_error_us / 1e3) ** 2 for landing, _ in aimed]))
            cells = [f"{off_ms.mean():+.2f}", f"{off_ms.std(ddof=1):.2f}", f"{stated_ms:.2f}"]
        share = f"{100 * len(aimed) / steps:.0f}"
        yield ",".join(
            ["tracker", str(rate_hz), str(noise_mm), kind, str(ahead), *cells, f"{100 * np.nanstd(speeds):.1f}", share]
        )


def touched(rate_hz: int, steps: int) -> Iterator[str]:
    """Yield a row of a switch and one of a force sensor."""
    rng = np.random.default_rng([SEED, rate_hz])
    period_ms, speeds = 1e3 / rate_hz, rng.uniform(*SPEEDS_MM_S, steps)
    late_ms = rng.uniform(0, period_ms, steps)
    yield f"switch,{rate_hz},,straight,0,{(late_ms + LEAD_MS).mean():+.2f},{late_ms.std(ddof=1):.2f},,,100"
    ms = late_ms[:, None] + np.arange(round(50 / period_ms) + 2) * period_ms
    force = STIFFNESS_N_MM * speeds[:, None] * ms / 1e3 + rng.normal(0, FORCE_NOISE_N, ms.shape)
    passed_ms = ms[np.arange(steps), np.argmax(force > THRESHOLD_N, axis=1)]
    bias_ms, sd_ms = (passed_ms + LEAD_MS).mean(), passed_ms.std(ddof=1)
    yield f"force sensor,{rate_hz},{FORCE_NOISE_N} N,straight,0,{bias_ms:+.2f},{sd_ms:.2f},,,100"


def main(steps: int = STEPS) -> None:
    print("contact by,Hz,noise mm,foot,ahead ms,bias ms,SD ms,stated ms,speed SD %,felt %")
    for rate_hz in RATES_HZ:
        for row in touched(rate_hz, steps):
            print(row)
        for noise_mm in NOISES_MM:
            for kind in FEET:
                for row in tracked(rate_hz, noise_mm, kind, steps):
                    print(row, flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
