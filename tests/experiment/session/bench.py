"""A session's devices, scripted, and what it wrote."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment import storage
from palpate.experiment.apparatus.audio.microphone import Microphone
from palpate.experiment.apparatus.ports import Masker
from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.apparatus.tracker.gate import Scrutiny
from palpate.experiment.apparatus.tracker.guarded import GuardedTracker
from palpate.experiment.apparatus.tracker.zeroing import ZeroedTracker
from palpate.experiment.desk.voice.listening import Listening
from palpate.experiment.errors import PalpateError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Header, PlannedTrial
from palpate.experiment.records.kinds.footstep import BrokenOff
from palpate.experiment.records.stimulus import Computed, Delivered
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.kinds.footstep.trials import FootstepDevices
from palpate.experiment.synthesis.waveforms import Basis
from tests.experiment.session.scripted import (
    START_NS,
    ScriptedActuator,
    ScriptedConsole,
    ScriptedTracker,
    rest_samples,
    step_samples,
)
from tests.experiment.synthesis.stimuli import Given, given

HEADER = Header(
    session_id="0" * 32,
    study="s",
    protocol_sha256="0" * 64,
    software="palpate 0",
    source_sha256="5" * 64,
    rig="r",
    rig_sha256="1" * 64,
    recordings_sha256=None,
    roster_sha256=None,
    seed=1,
    participant="01",
    task_kind="footstep",
    design="identification",
    task="virtual",
    task_position=1,
    purpose="REHEARSAL",
    started_utc="2000-01-01T00:00:00+00:00",
    block_trials=2,
    order=(PlannedTrial(trial=1, presented=("Papier à lettres",)), PlannedTrial(trial=2, presented=("foil",))),
)
ORDER = ("copy paper", "polypropylene", "copy paper")
COMPUTED = Computed(method="scripted", relative_error=0.0, left_out=0.0, dissimilarity_m_s2=0.0)
DELIVERED = Delivered(
    requested_ns=0, onset_ns=0, onset_error_ms=0.0, gain=1.0, residual_db=-60.0, xruns=0, delivered=True
)


def header(task: str) -> Header:
    order = tuple(PlannedTrial(trial=n, presented=(material,)) for n, material in enumerate(ORDER, start=1))
    return HEADER.model_copy(update={"order": order, "task": task, "block_trials": len(order)})


@dataclass(frozen=True, eq=False)
class Constant(Basis):
    """A material whose waveform is 1.5 m/s^2 throughout, at any speed; `rendered` is what was asked for."""

    rendered: list[tuple[str, float]]

    def at(self, speed_mm_s: float) -> Given:
        self.rendered.append((self.material, speed_mm_s))
        return given(np.full(2500, 1.5), material=self.material, floored=3)


@dataclass
class Bench:
    """One set of scripted devices; `rendered` is what synthesis was asked for."""

    tracker: ScriptedTracker
    console: ScriptedConsole
    actuator: ScriptedActuator
    clock: ManualClock
    rendered: list[tuple[str, float]]
    masker: Masker | None = None
    priority: str = ""
    zeroed: ZeroedTracker | None = None
    foreign: GuardedTracker | None = None
    microphone: Microphone | None = None
    computing: Executor | None = None
    keeps_voices: bool = False
    last: bool = False
    noise: str = ""
    rig_file: Path = field(default_factory=lambda: shipped("rigs/rehearsal.toml"))

    def materials(self, protocol: Protocol) -> dict[str, Basis]:
        silent = {m.id: given([0.0], material=m.id).basis for m in protocol.materials}
        return {material: Constant(**vars(basis), rendered=self.rendered) for material, basis in silent.items()}

    def run(self, protocol: Protocol, asked: Header, dataset: Path) -> Footer:
        virtual = asked.task == "virtual"
        devices = attempt.Devices(
            kind=FootstepDevices(
                tracker=self.zeroed or self.foreign or self.tracker,
                tracker_port="scripted",
                noise_mm=0.1,
                scrutiny=Scrutiny(rate_hz=1000, noise_mm=0.1),
                actuator=self.actuator if virtual else None,
                materials=self.materials(protocol) if virtual else None,
            ),
            console=self.console,
            clock=self.clock,
            masker=self.masker,
            reconnect_s=300.0,
            priority=self.priority,
            listening=Listening(self.microphone, self.computing) if self.microphone and self.computing else None,
        )
        return runner.run(
            protocol=protocol,
            header=asked,
            devices=devices,
            rig_file=self.rig_file,
            dataset=dataset,
            keeps_voices=self.keeps_voices,
            last=self.last,
            noise=self.noise,
        )


def in_pieces(step: Samples) -> list[Samples]:
    """As a port gives it: 4 ms a read."""
    pieces = []
    while step.device_us.size:
        piece, step = step.cut(min(4, step.device_us.size))
        pieces.append(piece)
    return pieces


def as_read(steps: int, speed_mm_s: float) -> list[Samples]:
    """Steps as a port gives them in real time, 4 ms a read; after each the foot stays where it is for a second."""
    pieces = []
    for n in range(1, steps + 1):
        step = step_samples(2_000_000 * n, speed_mm_s)
        for part in (step, *(rest_samples(int(step.device_us[-1]) + 1000 + 200_000 * i, 0.0) for i in range(5))):
            pieces += in_pieces(part)
    return [replace(piece, arrived_ns=START_NS + 1000 * int(piece.device_us[-1])) for piece in pieces]


def bench(keys: str, steps: list[Samples | PalpateError] | None = None, lost: tuple[int, ...] = ()) -> Bench:
    clock = ManualClock(START_NS)
    if steps is None:
        steps = [step_samples(2_000_000 * n, 100.0 * n) for n in range(1, len(keys) + 1)]
    return Bench(ScriptedTracker(steps, lost, clock=clock), ScriptedConsole(clock, keys), ScriptedActuator(), clock, [])


def entries(dataset: Path, task: str) -> tuple[object, ...]:
    return journal.read(storage.journal_path(dataset, "01", task)).entries


def felt_and_on_file(broken: object, reason: str, dataset: Path) -> None:
    """The first trial's step of 100 mm/s, with every frame up to the end of its tail."""
    assert isinstance(broken, BrokenOff)
    assert (broken.trial, broken.attempt, broken.felt, broken.reason) == (1, 1, True, reason)
    assert broken.speed_mm_s == pytest.approx(100.0, rel=1e-9)
    # The foot lands on a sample; rounding decides on which side of it.
    length = broken.trace.length
    assert length == broken.link.received in (401, 402)
    assert storage.foot_path(storage.journal_path(dataset, "01", "virtual")).stat().st_size == length
