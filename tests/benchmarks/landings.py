"""Onset at contact through real parts: `python -m tests.benchmarks.landings [STEPS [SESSIONS [SEED [BUSY]]]]`, and
`--desk` and `--drift PPM`.

Feet step in real time behind a serial line; stimuli sound on a JACK server of the rehearsal's, and the loopback hears
them. Of each step: how far the predicted contact, and the onset that was heard, are from where the simulated foot
truly met the panel, both on the session's clock. So clock mapping, prediction and sound all stand in the figure. And
how long after the arrival of the gate's frame the stimulus was scheduled, as trial records have it. BUSY processes do
nothing but compute meanwhile. With --desk, and one session, a console, the participant's screen and the microphone are
open and at work beside it (`attended.py`). With --drift the tracker's clock gains so many parts in a million on the
session's, or loses them where PPM is below zero; the sensor keeps to its clock, so its rate is off by as much.

Once of all steps, and once of those that the session counts as delivered: a machine that stands still for a moment
spoils a step, which is then known and done again. 2,000 steps take somewhat over half an hour; SESSIONS side by side,
each with parts of its own, take less, but hold each other up. The machine should do nothing else. Not a test: it
asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import open_drive
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.gate import GateDetector, Scrutiny
from palpate.experiment.apparatus.tracker.landing import LandingPredictor
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.desk.questions import Arm
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.wires.foot import Foot, trajectory
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, WiredCard
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.session.kinds.footstep.stimulus import Sounder
from palpate.experiment.session.kinds.footstep.watch import Feed, Watch, WatchedStep, watch
from palpate.experiment.session.masker import open_sound
from tests.benchmarks import attended
from tests.benchmarks.scheduling import loaded, spread
from tests.experiment.session.scripted import Endless

STEPS, SESSIONS = 2000, 1
REST_MM = 30.0
"""Where the foot waits between steps: low, so that steps follow soon."""

NOISE_MM = 0.1
APART_S = 10.0
"""From one session's opening to the next one's, s."""

SETTLED_S = 5.0
"""The device's clock is learned meanwhile, s."""


class Gaining(MonotonicClock):
    """A device's clock, which gains on the machine's."""

    def __init__(self, ppm: float) -> None:
        super().__init__()
        self._begun_ns = super().now_ns()
        self._ppm = ppm

    def now_ns(self) -> int:
        passed_ns = super().now_ns() - self._begun_ns
        return self._begun_ns + passed_ns + round(passed_ns * self._ppm * 1e-6)


@dataclass
class Landed:
    """What one session saw; errors in ms, one entry a step.

    Attributes:
        speeds_mm_s: of each step that landed, through the gate.
        predicted_ms: predicted less true contact.
        heard_ms: onset heard by the loopback less true contact; NaN where it was not delivered.
        requested_ms: onset heard less onset asked for; NaN likewise.
        gate_to_scheduled_ms: of each stimulus that was scheduled at the gate.
        delivered: whether the session counts it so.
        reasons: why stimuli were not delivered or steps broke, and how often.
        priority: of the session.
        desk: what was open beside it.
    """

    speeds_mm_s: list[float] = field(default_factory=list)
    predicted_ms: list[float] = field(default_factory=list)
    heard_ms: list[float] = field(default_factory=list)
    requested_ms: list[float] = field(default_factory=list)
    gate_to_scheduled_ms: list[float] = field(default_factory=list)
    delivered: list[bool] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    priority: str = ""
    desk: str = "none"


def session(
    folder: Path, steps: int, number: int, seed: int, with_desk: bool = False, drift_ppm: float = 0.0
) -> Landed:
    """Step, in real time; `folder` holds a rehearsal. Sessions open one after the other: opening takes a core."""
    time.sleep(number * APART_S)
    protocol = files.load(shipped("okamoto2012.toml"))
    rig_file = shipped("rigs/headless.toml")
    rig, clock, landed = rigs.load(rig_file), MonotonicClock(), Landed()
    limit_m_s2 = protocol.exposure.vibration_peak_m_s2
    rng = np.random.default_rng([seed, number])
    with ExitStack() as opened:
        there = opened.enter_context(attended.desk(folder)) if with_desk else None
        landed.priority = opened.enter_context(host.raised())
        planned, rate_hz = scene.plan(protocol=protocol, task_id="virtual"), rig.actuator.rate_hz
        recordings = folder / storage.RECORDINGS
        materials = preparation.open_stimuli(
            scene=planned, protocol=protocol, recordings=recordings, output_rate_hz=rate_hz
        )
        line = opened.enter_context(SerialLine())
        powered_ns = clock.now_ns()
        foot = Foot(line, tracker_of(rig), real_time=True, clock=Gaining(drift_ppm), rest_mm=REST_MM, noise_mm=NOISE_MM)
        opened.callback(foot.close)
        tracker = opening.open_tracker(rig, clock=clock, port=line.url)
        opened.callback(tracker.close)
        card = opened.enter_context(WiredCard(rig))
        sound = open_sound(rig, protocol, planned=planned, clock=clock, dose_before=0.0, opened=opened, device=DEVICE)
        card.wire()
        ear = opened.enter_context(attended.listening(rig, sound.stream, clock, there)) if there is not None else None
        landed.desk = there.says if there is not None else "none"
        drive = open_drive(rig_file.parent, rig.actuator, limit_m_s2=limit_m_s2, materials=materials)
        actuator = opening.open_actuator(rig, limit_m_s2=limit_m_s2, drive=drive, stream=sound.stream)
        opened.callback(actuator.close)
        parts = Watch(
            feed=Feed(tracker, simulated_time=False),
            scrutiny=Scrutiny(rate_hz=tracker_of(rig).rate_hz, noise_mm=NOISE_MM),
            detector=GateDetector(protocol.table(Footstep).step),
            predictor=LandingPredictor(protocol.table(Footstep).step, noise_mm=NOISE_MM),
            clock=clock,
            limits=Endless(),
            sounder=Sounder(materials, actuator),
        )
        begun_ns = clock.now_ns()
        while clock.now_ns() - begun_ns < SETTLED_S * 1e9:
            tracker.read()
        for done in range(steps):
            parts.feed.drain()
            speed_mm_s = float(rng.uniform(50, 400))
            step = trajectory(rng, speed_mm_s, rest_mm=REST_MM, hesitation="none")
            if there is not None:
                there.console.ask(Arm(done + 1, 1, steps))
            foot.step(step, foot.free_us)
            found = watch(parts, protocol.materials[done % 4].id)
            if not isinstance(found, WatchedStep):
                landed.reasons[found.reason] += 1
                continue
            if ear is not None:
                ear.stop()
                ear.listen(done + 1, 1, clock.now_ns())
            onset = found.onset
            delivered = onset.delivered if onset is not None else None
            if onset is None or onset.scheduled_ns is None or delivered is None:
                landed.reasons["not scheduled"] += 1
                continue
            if not delivered.delivered:
                landed.reasons[delivered.reason] += 1
            true_ns = powered_ns + foot.true_contact_us * 1e3 / (1 + drift_ppm * 1e-6)
            heard_ns = delivered.onset_ns if delivered.onset_ns is not None else np.nan
            landed.speeds_mm_s.append(speed_mm_s)
            landed.predicted_ms.append((onset.scheduled_ns - true_ns) / 1e6)
            landed.heard_ms.append((heard_ns - true_ns) / 1e6)
            landed.requested_ms.append((heard_ns - delivered.requested_ns) / 1e6)
            landed.delivered.append(delivered.delivered)
            if onset.gate_to_scheduled_ms is not None:
                landed.gate_to_scheduled_ms.append(onset.gate_to_scheduled_ms)
    return landed


def shown(name: str, errors_ms: list[float], speeds_mm_s: list[float], some: NDArray[np.bool_]) -> None:
    """A row; `some` of the steps."""
    errors, speeds = np.array(errors_ms)[some], np.array(speeds_mm_s)[some]
    cells = []
    for low, high in ((50, 400), (50, 100), (300, 400)):
        within = errors[(speeds >= low) & (speeds <= high) & np.isfinite(errors)]
        cells.append(f"{low}-{high} mm/s: {within.mean():+7.3f} {within.std(ddof=1):6.3f} ({within.size})")
    print(f"  {name:34s} " + "   ".join(cells) + f"   worst {np.nanmax(np.abs(errors)):.2f}")


def main() -> None:
    words, drift_ppm = [word for word in sys.argv[1:] if word != "--desk"], 0.0
    if "--drift" in words:
        at = words.index("--drift")
        drift_ppm = float(words[at + 1])
        del words[at : at + 2]
    numbers = [int(word) for word in words]
    steps, sessions, seed, busy = (*numbers, *(STEPS, SESSIONS, 0, 0)[len(numbers) :])
    with_desk = "--desk" in sys.argv
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "rehearsal"
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"),
            rig_file=shipped("rigs/rehearsal.toml"),
            out=folder,
            participants=1,
            seed=3,
        )
        with loaded(busy), ProcessPoolExecutor(sessions, mp_context=multiprocessing.get_context("spawn")) as pool:
            shares = [steps // sessions + (number < steps % sessions) for number in range(sessions)]
            desks = [with_desk and number == 0 for number in range(sessions)]
            seeds, drifts = [seed] * sessions, [drift_ppm] * sessions
            found = list(pool.map(session, [folder] * sessions, shares, range(sessions), seeds, desks, drifts))
    speeds = [speed for landed in found for speed in landed.speeds_mm_s]
    print(
        f"{len(speeds)} of {steps} steps landed with a stimulus scheduled, in {sessions} sessions side by side; "
        f"priority: {found[0].priority}; desk: {found[0].desk}; "
        f"the tracker's clock gains {drift_ppm:g} ppm; "
        f"load average {os.getloadavg()[0]:.1f}. Mean and standard deviation, ms (steps)"
    )
    delivered = np.array([one for landed in found for one in landed.delivered], dtype=np.bool_)
    for which, some in (("all", np.ones_like(delivered)), ("delivered", delivered)):
        print(f" {which} steps:")
        for name, errors_ms in (
            ("onset asked for, less true contact", [one for landed in found for one in landed.predicted_ms]),
            ("onset heard, less true contact", [one for landed in found for one in landed.heard_ms]),
            ("onset heard, less asked for", [one for landed in found for one in landed.requested_ms]),
        ):
            shown(name, errors_ms, speeds, some)
    gate_to_scheduled_ms = [one for landed in found for one in landed.gate_to_scheduled_ms]
    if gate_to_scheduled_ms:
        spread("gate to scheduled", gate_to_scheduled_ms)
    for reason, count in sum((landed.reasons for landed in found), Counter()).most_common():
        print(f"  {count} x {reason}")


if __name__ == "__main__":
    main()
