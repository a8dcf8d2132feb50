"""REHEARSAL of participants one after another or several at a time, and PRACTICE with one, in real sessions."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor.doctor import SimulatedPorts
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.ports import Actuator, Tracker
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.desk.questions import Console
from palpate.experiment.errors import Interrupted
from palpate.experiment.protocol import files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Purpose
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.kind import Parts, rehearsal_kind, stepping
from palpate.experiment.rehearsal.participant import SimulatedPerson, Tick
from palpate.experiment.rehearsal.practice import Guided, Practiced
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.panel import CardPanel, Panel
from palpate.experiment.rehearsal.wires.serial_line import SerialLine, SimulatedButtons, SimulatedPedal
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, WiredCard
from palpate.experiment.session import runner, scene
from palpate.experiment.session.kind import Sitting, Stimuli
from palpate.experiment.session.laboratory import header, open_laboratory
from palpate.experiment.synthesis.waveforms import Ring, Waveform

if TYPE_CHECKING:
    from palpate.experiment.apparatus.panel.conditioning import Played
    from palpate.experiment.rehearsal.voice import Speaker
    from palpate.experiment.rehearsal.wires.modes import MovingPanel

SIMULATED_START_NS = int(datetime(2000, 1, 1, 9, tzinfo=UTC).timestamp()) * 10**9
"""When simulated time begins, so that the same seed writes the same files."""

PANEL_FILE = "panel.toml"
"""Beside the rig in a rehearsal's dataset: the modes of its panel, where it was given any."""

HEARD_FILE = "heard.toml"
"""Beside the rig in the dataset of a rehearsal in which a control's stimuli are heard."""

TASK_NS = 2 * 3600 * 10**9
"""In simulated time each task of a participant starts this long after the one before, break included."""


@dataclass(frozen=True)
class Job:
    """One participant of a rehearsal or practice: the prepared folder, their label, and their tasks' ids in order.

    `seed` names every draw, `control` is `none` or `silence`, and `real_time` is paced by the wall clock.
    """

    dataset: Path
    participant: str
    tasks: tuple[str, ...]
    seed: int
    control: str
    real_time: bool


def rehearse_participant(job: Job, tick: Tick, screen: Console | None) -> None:
    """Run what remains of a participant's tasks; `tick` follows each confirmed answer. Raises `PalpateError`.

    `screen` shows what an experimenter would see; None for no screen.
    """
    for task_id in job.tasks:
        footer = run_task(job, task_id, tick, screen)
        if footer.reason == "paused":
            raise Interrupted(
                f"the rehearsal was paused ({footer.detail})", remedy="run the same command to continue it"
            )


def run_task(job: Job, task_id: str, tick: Tick, screen: Console | None, desk: Guided | None = None) -> Footer:
    """Run what remains of a task, as `rehearse_participant`, with an experimenter who practices at `desk`, if any."""
    kept = storage.protocol_path(job.dataset)
    rig_file = kept.with_name("rig.toml")
    protocol, rig = _study(kept, rig_file, storage.read_bytes(kept), storage.read_bytes(rig_file))
    position = job.tasks.index(task_id) + 1
    clock = MonotonicClock() if job.real_time else ManualClock(_simulated_now_ns(job, task_id, position))
    recordings = job.dataset / storage.RECORDINGS if scene.plan(protocol=protocol, task_id=task_id).synthesis else None
    sitting = Sitting(protocol, rig, rig_file, job.participant, task_id, job.dataset, recordings, clock)
    purpose: Purpose = "REHEARSAL" if desk is None else "PRACTICE"
    with open_laboratory(sitting, SimulatedEnds(job, sitting, tick, screen, desk)) as devices:
        asked = header(sitting, position=position, seed=job.seed, purpose=purpose)
        if desk is None:
            asked = asked.model_copy(update={"session_id": asked.rehearsed_id(job.control)})
        else:
            protocol = _without_waiting(protocol)
        footer = runner.run(
            protocol=protocol,
            header=asked,
            devices=devices,
            rig_file=rig_file,
            dataset=job.dataset,
            last=desk is not None and task_id == job.tasks[-1],
            keeps_voices=protocol.consent.voice_recordings,
        )
    if footer.reason == "complete" and task_id == job.tasks[-1] and protocol.answers.microphone:
        from palpate.experiment.desk.voice import enrolling

        enrolling.forget(enrolling.place(job.dataset, job.participant))
    return footer


def _without_waiting(protocol: Protocol) -> Protocol:
    """Return the protocol with no least time of familiarisation."""
    tasks = (
        task.model_copy(update={"familiarisation": task.familiarisation.model_copy(update={"min_s": 0})})
        for task in protocol.tasks
    )
    return protocol.model_copy(update={"tasks": tuple(tasks)})


@dataclass(frozen=True, eq=False)
class Silence(Ring):
    """As many samples of nothing as a stimulus has."""

    occasion: ClassVar[str] = "control"
    method: ClassVar[str] = "silence"


@dataclass(frozen=True)
class SilentActuator:
    """The control condition: an actuator that plays silence in place of every stimulus, of whatever kind of trial."""

    actuator: Actuator

    def prepare(self, stimulus: Waveform) -> Played:
        return self.actuator.prepare(Silence(np.zeros_like(stimulus.waveform_m_s2), stimulus.rate_hz))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.actuator, name)


@dataclass
class SimulatedEnds:
    """Implements `FarEnds`: a simulated participant, foot and panel, each set up when its port is opened."""

    reconnect_s = 30.0
    """Nobody has to plug anything in: a foot that is silent waits for its turn on a busy machine."""

    job: Job
    sitting: Sitting
    tick: Tick
    screen: Console | None
    desk: Guided | None

    def __post_init__(self) -> None:
        self.real_time, self.attended = self.job.real_time, self.desk is not None
        self.protocol, self.rig = self.sitting.protocol, self.sitting.rig
        self.task_id, self.clock = self.sitting.task_id, self.sitting.clock
        self._card: WiredCard | None = None
        self._panels: dict[str | None, Panel | CardPanel] = {}
        self._speaker: Speaker | None = None
        self._foot: Foot | None = None
        self._box: SimulatedButtons | None = None
        self._powered_ns = 0

    def sound_device(self, opened: ExitStack) -> str:
        self._card = opened.enter_context(WiredCard(self.rig))
        return DEVICE

    def wire_sound(self) -> None:
        if self._card is None:
            return
        self._card.wire()
        if self.protocol.answers.microphone and self.rig.audio and self.rig.audio.channels.microphone is not None:
            from palpate.experiment.rehearsal.voice import Speaker

            self._speaker = Speaker(
                self._card.mouth(), rate_hz=self.rig.audio.rate_hz, entropy=(self.job.seed, int(self.job.participant))
            )

    def panel(self, site: str | None, opened: ExitStack) -> str | None:
        moving = moving_panel(self.job.dataset)
        if self._card is not None and self.rig.actuator.driver == "audio":
            self._panels[site] = self._card.panel(site, moving)
            return None
        panel = Panel(self.rig.at(site).actuator, real_time=self.real_time, moving=moving)
        opened.callback(panel.close)
        self._panels[site] = panel
        return panel.address

    def playing(self, actuator: Actuator, sitting: Sitting, opened: ExitStack) -> Actuator:  # noqa: ARG002
        return actuator if self.job.control != "silence" else cast("Actuator", SilentActuator(actuator))

    def stimuli(self, prepare: Callable[[], Stimuli]) -> Stimuli:
        from palpate.experiment.recordings.manifest import MANIFEST

        kept, folder = storage.protocol_path(self.job.dataset), self.job.dataset / storage.RECORDINGS
        contents = tuple(map(storage.read_bytes, (kept, kept.with_name("rig.toml"), folder / MANIFEST)))
        key = folder, contents, self.task_id
        if key not in _stimuli:
            _stimuli.clear()
            _stimuli[key] = prepare()
        return _stimuli[key]

    def force(self, opened: ExitStack) -> str:
        from palpate.experiment.rehearsal.wires.force_device import ForceDeviceProcess

        return opened.enter_context(ForceDeviceProcess()).address

    def tracker(self, opened: ExitStack) -> tuple[str, ClockMap | None]:
        line = opened.enter_context(SerialLine())
        self._powered_ns = self.clock.now_ns()
        moves = rehearsal_kind(self.protocol.task(self.task_id)).moves
        self._foot = moves(line, self.rig, real_time=self.real_time)
        opened.callback(self._foot.close)
        # Simulated time stands still during a step, so that arrivals tell nothing of the device's clock.
        return line.url, None if self.real_time else ClockMap(anchor_us=0, anchor_ns=self._powered_ns)

    def pedal(self, opened: ExitStack) -> str | None:
        return opened.enter_context(SimulatedPedal()).url if self.rig.pedal is not None else None

    def buttons(self, opened: ExitStack) -> tuple[str | None, ClockMap | None]:
        if self.protocol.answers.mode != "keys":
            return None, None
        self._box = opened.enter_context(SimulatedButtons(self.clock, beats=self.real_time))
        known = None if self.real_time else ClockMap(anchor_us=0, anchor_ns=self._box.powered_ns)
        return self._box.url, known

    def check(self, tracker: Tracker, rig: rigs.Rig) -> None:
        """Check nothing: in simulated time the foot sends no frame before its first step."""

    def console(self) -> Console:
        person = self._person()
        person.box = self._box
        return person if self.desk is None else Practiced(desk=self.desk, participant=person)

    def _person(self) -> SimulatedPerson:
        tasks = [task.id for task in self.protocol.tasks]
        who = self.job.participant, self.task_id
        # Whoever hears a control's stimuli knows them as if they were felt.
        reached = (
            self.protocol.task(self.task_id).control is None
            or storage.protocol_path(self.job.dataset).with_name(HEARD_FILE).exists()
        )
        entropy = (self.job.seed, int(self.job.participant), tasks.index(self.task_id))
        parts = Parts(
            foot=self._foot,
            powered_ns=self._powered_ns,
            panels=self._panels if reached else {},
            rig=self.rig,
            real_time=self.real_time,
            speaker=self._speaker,
        )
        return rehearsal_kind(self.protocol.task(self.task_id)).person(
            parts,
            protocol=self.protocol,
            who=who,
            entropy=entropy,
            clock=self.clock,
            tick=self.tick,
            screen=self.screen,
        )


def moving_panel(dataset: Path) -> MovingPanel | None:
    """Return a new panel of the modes that a rehearsal keeps, None without any. Raises `ProtocolError`."""
    file = storage.protocol_path(dataset).with_name(PANEL_FILE)
    if not file.exists():
        return None
    from palpate.experiment.rehearsal.wires import modes

    return modes.MovingPanel(modes.read(file))


_stimuli: dict[tuple[Path, tuple[bytes, ...], str], Stimuli] = {}
"""What this process prepared last: the same for every participant, by protocol, rig, recordings and task."""


@lru_cache(maxsize=1)
def _study(kept: Path, rig_file: Path, *_contents: bytes) -> tuple[Protocol, rigs.Rig]:
    """Return the study that a rehearsal's folder keeps, read once for the same contents."""
    return files.load(kept), rigs.load(rig_file)


def simulated_far_ends(rig: rigs.Rig, opened: ExitStack) -> SimulatedPorts:
    """Start what stands at the far ends of a simulated rig, closed with `opened`: foot, panel, forces, sound card."""

    port = address = None
    if rig.tracker is not None:
        line = opened.enter_context(SerialLine())
        moves = (
            stepping if rig.servo is None else import_module("palpate.experiment.rehearsal.kinds.tapping.hand").moves
        )
        opened.callback(moves(line, rig, real_time=True).close)
        port = line.url
    if rig.actuator.driver != "audio":
        panel = Panel(rig.actuator)
        opened.callback(panel.close)
        address = panel.address
    force = None
    if rig.servo is not None:
        from palpate.experiment.rehearsal.wires.force_device import ForceDeviceProcess

        force = opened.enter_context(ForceDeviceProcess()).address
    pedal = opened.enter_context(SimulatedPedal()).url if rig.pedal is not None else None
    is_simulated = rig.buttons is not None and rig.buttons.port == rigs.REHEARSAL
    box = SimulatedButtons(MonotonicClock(), beats=True) if is_simulated else None
    buttons = opened.enter_context(box).url if box is not None else None
    ends = SimulatedPorts(port=port, address=address, force=force, pedal=pedal, buttons=buttons)
    if rig.audio is None:
        return ends
    card, heard = opened.enter_context(WiredCard(rig)), rig.audio.channels.microphone is not None

    def wire() -> None:
        card.wire()
        if heard:
            card.mouth()

    return replace(ends, device=DEVICE, wire=wire)


def _simulated_now_ns(job: Job, task_id: str, position: int) -> int:
    """Return where simulated time stands: after the journal's last entry, or at the task's start."""
    path = storage.journal_path(job.dataset, job.participant, task_id)
    lines = journal.read_if_begun(path).lines
    return lines[-1].t_ns if lines else SIMULATED_START_NS + (position - 1) * TASK_NS


_queue: multiprocessing.SimpleQueue[None] | None = None


def rehearse_at_once(
    todo: Sequence[Job], jobs: int, tick: Tick, finish: Callable[[Any], object], begun: Callable[[], object]
) -> None:
    """Rehearse every participant of `todo`, `jobs` at a time; `tick` is called here after each confirmed answer.

    `begun` is called once all processes (forks on Linux) have begun, so it may begin threads; `finish` at the end with
    what calls a function in them. Raises `Interrupted` at the keyboard, with what is confirmed on disk, and
    `PalpateError`.
    """
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    others = set(multiprocessing.active_children())
    with storage.safe_path(), _noted() as interrupts:
        queue: multiprocessing.SimpleQueue[None] = context.SimpleQueue()
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=_share, initargs=(queue,)) as pool:
            try:
                with beside.held_back():
                    futures: set[Future[None]] = {pool.submit(_rehearse_shared, job) for job in todo}
                begun()
                while futures:
                    done, futures = wait(futures, timeout=0.1, return_when=FIRST_EXCEPTION)
                    while not queue.empty():
                        queue.get()
                        tick()
                    _end_at(interrupts)
                    for future in done:
                        future.result()
                finish(pool.map)
            except BaseException:
                for worker in set(multiprocessing.active_children()) - others:
                    worker.terminate()
                raise
        _end_at(interrupts)


def _end_at(interrupts: Sequence[int]) -> None:
    if interrupts:
        raise Interrupted("the rehearsal was interrupted", remedy="run the same command to continue it")


@contextmanager
def _noted() -> Iterator[Sequence[int]]:
    """Yield a list that grows with each press of Ctrl-C, which as an exception might leave the pool's locks taken."""
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    # A process that ignores it, as a background job does, goes on ignoring it; only the main thread may change that.
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield pressed
        return
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)


def _share(queue: multiprocessing.SimpleQueue[None]) -> None:
    global _queue
    _queue = queue
    # The keyboard interrupts the parent alone; a worker ends with it, however that ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    beside.end_with_parent()


def _rehearse_shared(job: Job) -> None:
    queue = _queue
    rehearse_participant(job, (lambda: queue.put(None)) if queue is not None else (lambda: None), None)
