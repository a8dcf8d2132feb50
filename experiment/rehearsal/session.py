"""REHEARSAL of one participant: opens the ports of each task, with the simulated world at their far ends."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from experiment import storage
from experiment.apparatus import rig as rigs
from experiment.apparatus.ports import Tracker
from experiment.apparatus.tracker.clock_map import ClockMap
from experiment.clock import Clock, ManualClock, MonotonicClock
from experiment.desk.port import Console
from experiment.errors import Interrupted
from experiment.protocol import files
from experiment.protocol.models import Protocol
from experiment.records import journal
from experiment.rehearsal.footstep.foot import Foot
from experiment.rehearsal.footstep.materials import SimulatedMaterials
from experiment.rehearsal.footstep.panel import CardPanel, Panel
from experiment.rehearsal.footstep.participant import SimulatedParticipant, Tick
from experiment.rehearsal.wires.serial_line import SerialLine
from experiment.rehearsal.wires.sound_card import DEVICE, WiredCard
from experiment.session import runner, scene
from experiment.session.laboratory import header, open_laboratory
from experiment.synthesis import waveforms
from experiment.synthesis.waveforms import Basis

SIMULATED_START_NS = int(datetime(2000, 1, 1, 9, tzinfo=UTC).timestamp()) * 10**9
"""When simulated time begins, so that the same seed writes the same files."""

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
    protocol = files.load(job.dataset / "sourcedata" / "protocol.toml")
    rig = rigs.load(job.dataset / "sourcedata" / "rig.toml")
    materials = SimulatedMaterials(protocol.footstep.synthesis.rate_hz, protocol.footstep.synthesis.samples)
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
    clock = MonotonicClock() if job.real_time else ManualClock(_simulated_now_ns(job, task_id, position))
    recordings = job.dataset / storage.RECORDINGS if scene.plan(protocol=protocol, task_id=task_id).synthesis else None
    rig_file = job.dataset / "sourcedata" / "rig.toml"
    ends = SimulatedEnds(job, protocol, rig, materials, task_id, clock, tick, screen)
    with open_laboratory(
        protocol=protocol,
        rig=rig,
        rig_folder=rig_file.parent,
        participant=job.participant,
        task_id=task_id,
        dataset=job.dataset,
        recordings=recordings,
        clock=clock,
        ends=ends,
    ) as devices:
        asked = header(
            protocol=protocol,
            rig=rig,
            participant=job.participant,
            task_id=task_id,
            position=position,
            seed=job.seed,
            recordings=recordings,
            rehearsal=True,
            clock=clock,
        )
        footer = runner.run(protocol=protocol, header=asked, devices=devices, rig_file=rig_file, dataset=job.dataset)
    if footer.reason == "paused":
        raise Interrupted(f"the rehearsal was paused ({footer.detail}); the same command goes on with it")


class SimulatedEnds:
    """Implements `FarEnds`: a simulated foot, panel and participant."""

    reconnect_s = 2.0

    def __init__(
        self,
        job: Job,
        protocol: Protocol,
        rig: rigs.Rig,
        materials: SimulatedMaterials,
        task_id: str,
        clock: Clock,
        tick: Tick,
        screen: Console | None,
    ) -> None:
        """Nothing is set up yet; each far end is when the session opens its port."""
        self.real_time = job.real_time
        self._job, self._protocol, self._rig, self._materials = job, protocol, rig, materials
        self._task_id, self._clock, self._tick, self._screen = task_id, clock, tick, screen
        self._card: WiredCard | None = None
        self._panel: Panel | CardPanel | None = None

    def sound_device(self, opened: ExitStack) -> str:
        self._card = opened.enter_context(WiredCard(self._rig))
        return DEVICE

    def wire_sound(self) -> None:
        if self._card is not None:
            self._card.wire()

    def panel(self, opened: ExitStack) -> str | None:
        if self._card is not None and self._rig.actuator.driver == "audio":
            self._panel = self._card.panel()
            return None
        panel = Panel(self._rig.actuator)
        opened.callback(panel.close)
        self._panel = panel
        return panel.address

    def presented(self, materials: dict[str, Basis]) -> dict[str, Basis]:
        if self._job.control != "silence":
            return materials
        return {material: _silenced(basis) for material, basis in materials.items()}

    def tracker(self, opened: ExitStack) -> tuple[str, ClockMap | None]:
        line = opened.enter_context(SerialLine())
        self._powered_ns = self._clock.now_ns()
        self._foot = Foot(line, self._rig.tracker, real_time=self.real_time)
        opened.callback(self._foot.close)
        # Simulated time stands still during a step, so that arrivals tell nothing of the device's clock.
        return line.url, None if self.real_time else ClockMap(anchor_us=0, anchor_ns=self._powered_ns)

    def check(self, tracker: Tracker, rig: rigs.Rig) -> None:
        """Check nothing: the simulated foot sends no frame before its first step in simulated time."""

    def console(self) -> Console:
        job, tasks = self._job, [task.id for task in self._protocol.tasks]
        return SimulatedParticipant(
            protocol=self._protocol,
            materials=self._materials,
            who=(job.participant, self._task_id),
            entropy=(job.seed, int(job.participant), tasks.index(self._task_id)),
            foot=self._foot,
            powered_ns=self._powered_ns,
            panel=self._panel,
            actuator_rate_hz=self._rig.actuator.rate_hz,
            clock=self._clock,
            real_time=self.real_time,
            tick=self._tick,
            screen=self._screen,
        )


def _silenced(basis: Basis) -> Basis:
    """Return the control condition: the same material, with no vibration in any of its bins."""
    silent = replace(basis.spectra, amplitudes=np.zeros_like(basis.spectra.amplitudes))
    return waveforms.prepare(silent, material=basis.material, output_rate_hz=basis.output_rate_hz)


def _simulated_now_ns(job: Job, task_id: str, position: int) -> int:
    """Where simulated time stands: after the journal's last entry, or at the task's start."""
    path = storage.journal_path(job.dataset, job.participant, task_id)
    lines = journal.read(path).lines if path.exists() else ()
    return lines[-1].t_ns if lines else SIMULATED_START_NS + (position - 1) * TASK_NS
