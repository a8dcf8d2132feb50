"""REHEARSAL of one participant: opens the ports of each task, with the simulated world at their far ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from multiprocessing import connection
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
from experiment.rehearsal.footstep.panel import CardPanel, Panel
from experiment.rehearsal.footstep.participant import SimulatedParticipant, Tick
from experiment.rehearsal.footstep.recorded_takes import SimulatedMaterials
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


_queue: multiprocessing.SimpleQueue[None] | None = None


def rehearse_at_once(todo: Sequence[Job], jobs: int, tick: Tick) -> None:
    """Rehearse every participant of `todo`, `jobs` at a time; `tick` is called here after each confirmed answer.

    Raises:
        Interrupted: at the keyboard; what is confirmed is on disk.
        PalpateError: a part failed.
    """
    context = multiprocessing.get_context("spawn")
    queue: multiprocessing.SimpleQueue[None] = context.SimpleQueue()
    with _noted() as interrupts:
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=_share, initargs=(queue,)) as pool:
            try:
                with _held_back():
                    futures: set[Future[None]] = {pool.submit(_rehearse_shared, job) for job in todo}
                while futures:
                    done, futures = wait(futures, timeout=0.1, return_when=FIRST_EXCEPTION)
                    for _ in _drained(queue):
                        tick()
                    _end_at(interrupts)
                    for future in done:
                        future.result()
            except BaseException:
                for worker in multiprocessing.active_children():
                    worker.terminate()
                raise
        _end_at(interrupts)


def _end_at(interrupts: Sequence[int]) -> None:
    if interrupts:
        raise Interrupted("the rehearsal was interrupted; the same command goes on with it")


@contextmanager
def _held_back() -> Iterator[None]:
    """Ctrl-C reaches every process of a terminal: those that begin here do not hear it before they can ignore it."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _noted() -> Iterator[Sequence[int]]:
    """Every Ctrl-C that was pressed since; they do nothing else.

    As an exception it might come while the pool's locks are being taken, which then nobody gives back, and the process
    would never end.
    """
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    # Who ignores it, as a job in the background does, goes on ignoring it; only the main thread may say.
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield pressed
        return
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)


def _drained(queue: multiprocessing.SimpleQueue[None]) -> Iterator[None]:
    while not queue.empty():
        yield queue.get()


def _share(queue: multiprocessing.SimpleQueue[None]) -> None:
    global _queue
    _queue = queue
    # The keyboard interrupts the parent alone, and a worker never outlives it, however it ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def _rehearse_shared(job: Job) -> None:
    queue = _queue
    rehearse_participant(job, (lambda: queue.put(None)) if queue is not None else (lambda: None), None)
