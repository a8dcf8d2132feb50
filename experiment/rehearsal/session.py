"""REHEARSAL of one participant: opens the ports of each task, with the simulated world at their far ends."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from experiment import storage
from experiment.apparatus import host, opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.panel.conditioning import open_drive
from experiment.apparatus.ports import Actuator
from experiment.apparatus.tracker.clock_map import ClockMap
from experiment.clock import ManualClock, MonotonicClock
from experiment.dataset import build
from experiment.desk.port import Console
from experiment.errors import Interrupted
from experiment.protocol.models import Protocol
from experiment.records import journal
from experiment.rehearsal.footstep.foot import Foot
from experiment.rehearsal.footstep.materials import SimulatedMaterials
from experiment.rehearsal.footstep.panel import CardPanel, Panel
from experiment.rehearsal.footstep.participant import SimulatedParticipant, Tick
from experiment.rehearsal.wires.serial_line import SerialLine
from experiment.rehearsal.wires.sound_card import SimulatedSound
from experiment.session import attempt, masker, run, runner, scene
from experiment.settings import load
from experiment.synthesis import waveforms
from experiment.synthesis.waveforms import Basis

SIMULATED_START_NS = int(datetime(2000, 1, 1, 9, tzinfo=UTC).timestamp()) * 10**9
"""When simulated time begins, so that the same seed writes the same files."""

RECONNECT_S = 2.0
"""How long a rehearsal waits for its tracker, s."""

TASK_NS = 2 * 3600 * 10**9
"""In simulated time each task of a participant starts this long after the one before, break included."""


@dataclass(frozen=True)
class Job:
    """One participant of a rehearsal.

    Attributes:
        dataset: folder of the rehearsal, prepared.
        participant: label.
        tasks: ids of the participant's tasks, in their order.
        seed: the rehearsal's seed.
        control: `none` or `silence`.
        real_time: paced by the wall clock.
    """

    dataset: Path
    participant: str
    tasks: tuple[str, ...]
    seed: int
    control: str
    real_time: bool


def rehearse_participant(job: Job, tick: Tick, screen: Console | None) -> None:
    """Run every task of one participant, or what remains of them.

    Args:
        job: who and what.
        tick: called after each confirmed answer.
        screen: shows what an experimenter would see, if anybody looks.

    Raises:
        PalpateError: a part failed.
    """
    protocol = load.load(job.dataset / "sourcedata" / "protocol.toml")
    rig = rigs.load(job.dataset / "sourcedata" / "rig.toml")
    materials = SimulatedMaterials(protocol.synthesis.rate_hz, protocol.synthesis.samples)
    for position, task_id in enumerate(job.tasks, start=1):
        _rehearse_task(job, protocol, rig, materials, task_id, position, tick, screen)


def _rehearse_task(
    job: Job,
    protocol: Protocol,
    rig: rigs.Rig,
    materials: SimulatedMaterials,
    task_id: str,
    position: int,
    tick: Tick,
    screen: Console | None,
) -> None:
    planned = scene.plan(protocol=protocol, task_id=task_id)
    clock = MonotonicClock() if job.real_time else ManualClock(_simulated_now_ns(job, task_id, position))
    header = run.header(
        protocol=protocol,
        rig=rig,
        participant=job.participant,
        task_id=task_id,
        position=position,
        seed=job.seed,
        recordings=job.dataset / build.RECORDINGS if planned.synthesis else None,
        rehearsal=True,
        clock=clock,
    )
    with ExitStack() as opened:
        got = opened.enter_context(host.raised()) if job.real_time else ""
        line = opened.enter_context(SerialLine())
        powered_ns = clock.now_ns()
        foot = Foot(line, rig.tracker, real_time=job.real_time)
        opened.callback(foot.close)
        # Simulated time stands still during a step, so that arrivals tell nothing of the device's clock.
        known = None if job.real_time else ClockMap(anchor_us=0, anchor_ns=powered_ns)
        contact_mm = protocol.step.contact_mm
        tracker = opening.open_tracker(rig, clock=clock, port=line.url, clock_map=known, contact_mm=contact_mm)
        opened.callback(tracker.close)
        sound: SimulatedSound | None = None
        if rig.audio is not None:
            dose = masker.dose_before(job.dataset, protocol, job.participant, clock)
            sound = opened.enter_context(SimulatedSound(rig, protocol, clock, dose_before=dose))
        panel: Panel | CardPanel | None = None
        actuator: Actuator | None = None
        stimuli: dict[str, Basis] | None = None
        if planned.synthesis:
            recordings, rate_hz = job.dataset / build.RECORDINGS, rig.actuator.rate_hz
            stimuli = scene.open_stimuli(
                scene=planned, protocol=protocol, recordings=recordings, output_rate_hz=rate_hz
            )
            if job.control == "silence":
                stimuli = {material: _silenced(basis) for material, basis in stimuli.items()}
        if planned.actuator:
            limit_m_s2 = protocol.exposure.vibration_peak_m_s2
            drive = open_drive(job.dataset / "sourcedata", rig.actuator, limit_m_s2=limit_m_s2, materials=stimuli)
            if sound is not None and rig.actuator.driver == "audio":
                panel = sound.panel()
                actuator = opening.open_actuator(rig, limit_m_s2=limit_m_s2, drive=drive, stream=sound.stream)
            else:
                panel = Panel(rig.actuator)
                opened.callback(panel.close)
                actuator = opening.open_actuator(rig, limit_m_s2=limit_m_s2, drive=drive, address=panel.address)
            opened.callback(actuator.close)
        participant = SimulatedParticipant(
            protocol=protocol,
            materials=materials,
            who=(job.participant, task_id),
            entropy=(job.seed, int(job.participant), [task.id for task in protocol.tasks].index(task_id)),
            foot=foot,
            powered_ns=powered_ns,
            panel=panel,
            actuator_rate_hz=rig.actuator.rate_hz,
            clock=clock,
            real_time=job.real_time,
            tick=tick,
            screen=screen,
        )
        devices = attempt.Devices(
            tracker=tracker,
            tracker_port=line.url,
            noise_mm=rig.tracker.noise_mm,
            actuator=actuator,
            materials=stimuli,
            console=participant,
            clock=clock,
            masker=sound.masker if sound is not None else None,
            reconnect_s=RECONNECT_S,
            priority=got,
        )
        rig_file = job.dataset / "sourcedata" / "rig.toml"
        footer = runner.run(protocol=protocol, header=header, devices=devices, rig_file=rig_file, dataset=job.dataset)
    if footer.reason == "paused":
        raise Interrupted(f"the rehearsal was paused ({footer.detail}); the same command goes on with it")


def _silenced(basis: Basis) -> Basis:
    """The control condition: the same material, with no vibration in any of its bins."""
    silent = replace(basis.spectra, amplitudes=np.zeros_like(basis.spectra.amplitudes))
    return waveforms.prepare(silent, material=basis.material, output_rate_hz=basis.output_rate_hz)


def _simulated_now_ns(job: Job, task_id: str, position: int) -> int:
    """Where simulated time stands: after the journal's last entry, or at the task's start."""
    path = storage.journal_path(job.dataset, job.participant, task_id)
    lines = journal.read(path).lines if path.exists() else ()
    return lines[-1].t_ns if lines else SIMULATED_START_NS + (position - 1) * TASK_NS
