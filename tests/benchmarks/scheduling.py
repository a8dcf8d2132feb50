"""From the gate to a scheduled stimulus: run `python -m tests.benchmarks.scheduling [STEPS] [--desk]`.

How long after the arrival of the frame that gave the gate its stimulus has been synthesised, limited, shaped, handed to
its driver and aimed. A thread hands frames over as the tracker's does, and the terminal's screen is open; with --desk
a console, the participant's screen and, where there is sound, the microphone are instead (`attended.py`). On an idle
machine and with every core loaded by a busy process; at ordinary priority and at that of a session. Beside it what the
machine itself takes to hand an empty message from one thread to another, in the same minutes: no figure can be below
that. Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import Played, open_drive
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector, GateState, Scrutiny
from palpate.experiment.apparatus.tracker.landing import LandingPredictor
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.desk.questions import Arm, Console
from palpate.experiment.desk.terminal import TerminalConsole
from palpate.experiment.desk.voice.ear import Ear
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Step
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.wires import foot
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, WiredCard
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.session.kinds.footstep.stimulus import Sounder
from palpate.experiment.session.kinds.footstep.watch import Feed, Watch, watch
from palpate.experiment.session.masker import open_sound
from palpate.experiment.synthesis.waveforms import Waveform
from tests.benchmarks import attended
from tests.experiment.session.scripted import Endless

STEPS = 2000
STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)

CALIBRATING_TURNS = 1_000_000

READ_S = 0.002
PACED_MM = (4.0, 12.0)
"""Heights between which frames come as slowly as a foot falls; outside, as fast as they are taken."""


def spin() -> None:
    while True:
        pass


@contextmanager
def loaded(processes: int) -> Iterator[None]:
    """As many processes that do nothing but compute."""
    hogs = [multiprocessing.get_context("spawn").Process(target=spin, daemon=True) for _ in range(processes)]
    for hog in hogs:
        hog.start()
    try:
        yield
    finally:
        for hog in hogs:
            hog.terminate()
            hog.join()


class Replayed:
    """Implements `Tracker`: one step in reads of 2 ms from a thread of its own, handed over as by `SerialTracker`."""

    def __init__(self) -> None:
        self.counts = LinkCounts()
        self.clock_map: ClockMap | None = None
        self.read_ns = 0
        """When the newest read arrived."""
        self._arrived: SimpleQueue[tuple[Samples, int]] = SimpleQueue()
        self._steps: SimpleQueue[Samples] = SimpleQueue()
        self._join = host.joining()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def load(self, us: NDArray[np.int64], mm: NDArray[np.float64]) -> None:
        self.clock_map = ClockMap(int(us[0]), time.monotonic_ns())
        ends = np.arange(1, us.size + 1) * 12
        self._arrived = SimpleQueue()
        self._steps.put(Samples(us, mm, bytes(int(ends[-1])), ends, 0))

    def drain(self) -> None:
        pass

    def read(self) -> Samples:
        samples, self.read_ns = self._arrived.get()
        return samples

    def reconnect(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass

    def _run(self) -> None:
        self._join()
        while True:
            whole, arrived = self._steps.get(), self._arrived
            while whole.device_us.size and self._steps.empty():
                piece, whole = whole.cut(min(2, whole.device_us.size))
                if PACED_MM[0] <= piece.height_mm[0] <= PACED_MM[1]:
                    time.sleep(READ_S)
                arrived.put((piece, time.perf_counter_ns()))


class Timed:
    """Implements `Actuator`: plays nothing, and notes how long after the gate's frame a stimulus was first aimed."""

    def __init__(self, actuator: Actuator) -> None:
        self._actuator = actuator
        self.gate_ns: int | None = None
        """When the frame arrived that gave the gate; None once a stimulus was aimed after it."""
        self.waited_ms: list[float] = []

    @property
    def rate_hz(self) -> int:
        return self._actuator.rate_hz

    @property
    def lead_ns(self) -> int:
        return self._actuator.lead_ns

    def prepare(self, stimulus: Waveform) -> Played:
        return self._actuator.prepare(stimulus)

    def aim(self, onset_ns: int) -> bool:
        self._actuator.aim(onset_ns)
        if self.gate_ns is not None:
            self.waited_ms.append((time.perf_counter_ns() - self.gate_ns) / 1e6)
            self.gate_ns = None
            # Steps come faster than stimuli end.
            self._actuator.withdraw()
        return True

    def landed(self, contact_ns: int) -> None:
        pass

    def withdraw(self) -> bool:
        return self._actuator.withdraw()

    def is_silent(self) -> bool:
        return self._actuator.is_silent()

    def delivered(self, contact_ns: int) -> Delivered | None:
        return None

    def close(self) -> None:
        self._actuator.close()


class Noted(GateDetector):
    """Notes when the frame arrived that gave a gate."""

    def __init__(self, tracker: Replayed, actuator: Timed) -> None:
        super().__init__(STEP)
        self._tracker = tracker
        self._actuator = actuator

    def step(self, state: GateState, samples: Samples) -> tuple[GateState, tuple[Gate | Contact, ...]]:
        state, events = super().step(state, samples)
        if any(isinstance(event, Gate) for event in events):
            self._actuator.gate_ns = self._tracker.read_ns
        return state, events


def gate_to_scheduled_ms(
    folder: Path, rig_name: str, rate_hz: int, steps: int, desk: attended.Desk | None = None
) -> list[float]:
    """From the arrival of the frame that showed the foot below the gate to its stimulus aimed, for many steps."""
    protocol = files.load(shipped("okamoto2012.toml"))
    planned = scene.plan(protocol=protocol, task_id="virtual")
    recordings = folder / "rehearsal" / storage.RECORDINGS
    materials = preparation.open_stimuli(
        scene=planned, protocol=protocol, recordings=recordings, output_rate_hz=rate_hz
    )
    rig_file, clock, tracker = shipped(f"rigs/{rig_name}.toml"), MonotonicClock(), Replayed()
    rig = rigs.load(rig_file)
    rig = rig.model_copy(update={"actuator": rig.actuator.model_copy(update={"rate_hz": rate_hz})})
    limit_m_s2 = protocol.exposure.vibration_peak_m_s2
    drive = open_drive(rig_file.parent, rig.actuator, limit_m_s2=limit_m_s2, materials=materials)
    with ExitStack() as opened:
        ear: Ear | None = None
        if rig.audio is None:
            panel = Panel(rig.actuator)
            opened.callback(panel.close)
            played = opening.open_actuator(rig, limit_m_s2=limit_m_s2, drive=drive, address=panel.address)
        else:
            card = opened.enter_context(WiredCard(rig))
            sound = open_sound(
                rig, protocol, planned=planned, clock=clock, dose_before=0.0, opened=opened, device=DEVICE
            )
            card.wire()
            if desk is not None:
                ear = opened.enter_context(attended.listening(rig, sound.stream, clock, desk))
            played = opening.open_actuator(rig, limit_m_s2=limit_m_s2, drive=drive, stream=sound.stream)
        opened.callback(played.close)
        nowhere = opened.enter_context(Path(os.devnull).open("w"))
        lines: Console = TerminalConsole(write=nowhere, ask=input, heading="REHEARSAL")
        screen = desk.console if desk is not None else lines
        actuator = Timed(played)
        parts = Watch(
            feed=Feed(tracker, simulated_time=True),
            scrutiny=Scrutiny(rate_hz=1000, noise_mm=0.1),
            detector=Noted(tracker, actuator),
            predictor=LandingPredictor(STEP, noise_mm=0.1),
            clock=clock,
            limits=Endless(),
            sounder=Sounder(materials, actuator),
        )
        rng = np.random.default_rng(2)
        for n in range(steps):
            step = foot.trajectory(rng, float(rng.uniform(50, 400)), hesitation="none")
            us = np.arange(int(step.gate_top_us) - 50_000, int(step.lift_us), 1000)
            screen.ask(Arm(n + 1, 1, steps))
            tracker.load(us, step.at(us.astype(np.float64)) + rng.normal(0, 0.1, us.size))
            watch(parts, protocol.materials[n % 4].id)
            if ear is not None:
                ear.stop()
                ear.listen(n + 1, 1, clock.now_ns())
    return actuator.waited_ms


def handed_over_ms(messages: int, work_ms: float = 0.0) -> list[float]:
    """From one thread's message, one every `READ_S`, to the end of another's work on it: a loop that does nothing.

    Args:
        messages: how many.
        work_ms: how long the loop takes, as a rule. With the median of gate to scheduled it shows what the machine
            makes of as much work that is not ours.
    """
    turns = 0
    if work_ms:
        begun_ns = time.perf_counter_ns()
        for _ in range(CALIBRATING_TURNS):
            pass
        turns = round(work_ms * 1e6 * CALIBRATING_TURNS / (time.perf_counter_ns() - begun_ns))
    sent: SimpleQueue[int] = SimpleQueue()

    join = host.joining()

    def send() -> None:
        join()
        for _ in range(messages):
            time.sleep(READ_S)
            sent.put(time.perf_counter_ns())

    sender = threading.Thread(target=send)
    sender.start()
    waited_ms = []
    for _ in range(messages):
        sent_ns = sent.get()
        for _ in range(turns):
            pass
        waited_ms.append((time.perf_counter_ns() - sent_ns) / 1e6)
    sender.join()
    return waited_ms


def spread(name: str, values_ms: list[float]) -> None:
    quantiles = np.quantile(values_ms, (0.5, 0.99, 0.999))
    cells = "  ".join(
        f"{label} {value:8.3f}" for label, value in zip(("median", "99 %", "99.9 %"), quantiles, strict=True)
    )
    print(f"  {name:56s} {cells}  worst {max(values_ms):8.3f} ms  ({len(values_ms)})", flush=True)


def report(folder: Path, steps: int, desk: attended.Desk | None = None) -> None:
    """Print the table; `folder` holds a rehearsal."""
    cores = os.cpu_count() or 1
    for rig_name, rate_hz in (("rehearsal", 5000), ("rehearsal", 48_000), ("headless", 48_000)):
        how = f"{'JACK' if rig_name == 'headless' else 'PCM'}, {rate_hz} Hz"
        for load_name, hogs in (("idle", 0), (f"{cores} cores loaded", cores)):
            with loaded(hogs):
                spread(f"{how}, {load_name}, ordinary", gate_to_scheduled_ms(folder, rig_name, rate_hz, steps, desk))
                with host.raised() as got:
                    in_session = gate_to_scheduled_ms(folder, rig_name, rate_hz, steps, desk)
                    empty = handed_over_ms(steps)
                    as_much = handed_over_ms(steps, work_ms=float(np.median(in_session)) - float(np.median(empty)))
                spread(f"{how}, {load_name}, {got.partition(':')[0]}", in_session)
                spread(f"  an empty message, {load_name}, {got.partition(':')[0]}", empty)
                spread(f"  a message and an empty loop, {load_name}, {got.partition(':')[0]}", as_much)


def main() -> None:
    numbers = [int(word) for word in sys.argv[1:] if word != "--desk"]
    steps = numbers[0] if numbers else STEPS
    with tempfile.TemporaryDirectory() as name:
        rehearsed = Path(name) / "rehearsal"
        study.rehearse(
            protocol_file=shipped("okamoto2012.toml"),
            rig_file=shipped("rigs/rehearsal.toml"),
            out=rehearsed,
            participants=1,
            seed=3,
        )
        with attended.desk(Path(name)) if "--desk" in sys.argv else nullcontext() as desk:
            print(f"Gate to scheduled; desk: {desk.says if desk is not None else 'none'}")
            report(Path(name), steps, desk)


if __name__ == "__main__":
    main()
