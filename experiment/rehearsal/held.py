"""What the tasks of a study need on a rig, and what a process of each holds of the machine, for `palpate plan`.

`python -m palpate.experiment.rehearsal.held` opens what a session opens up to its first trial, and ends with its input.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from datetime import date
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment import storage
from palpate.experiment.errors import Finding, PalpateError, ScheduleError, SessionError

if TYPE_CHECKING:
    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.session.kinds.footstep.scene_cost import TaskPlan

Bar = tuple[Callable[[int], None], Callable[[], None]]
"""What is given how many tasks there are, and what is called after each."""


@dataclass(frozen=True)
class Asked:
    """One task of a protocol on a rig: paths, and the ports of simulated far ends, None for those of the rig file."""

    protocol: str
    rig: str
    task: str
    recordings: str
    port: str | None = None
    address: str | None = None
    device: str | None = None


@dataclass(frozen=True)
class Held:
    """What a process holds: resident memory, MB, threads and modules; and its processor time until all was open, s."""

    mb: float
    threads: int
    modules: tuple[str, ...]
    cpu_s: float

    @property
    def words(self) -> str:
        """The same in words."""
        held = f"{self.mb:.0f} MB, {self.threads} threads, {len(self.modules)} modules"
        return f"{held}, ready after {self.cpu_s:.1f} s of processor time"


def started(asked: Asked, opened: ExitStack) -> Held:
    """Return what a process of its own holds once all is open, until the stack is closed. Raises `SessionError`."""
    command = storage.python_command("-m", "palpate.experiment.rehearsal.held", json.dumps(asdict(asked)))
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)  # noqa: S603
    opened.enter_context(process)
    line = process.stdout.readline() if process.stdout is not None else ""
    if not line:
        why = process.communicate()[1].strip().splitlines()
        raise SessionError(f"task {asked.task}", f"its process ended: {why[-1] if why else 'it gave no reason'}")
    return Held(**json.loads(line))


def with_refusal(planned: "TaskPlan", unmeasured: Finding | None) -> "TaskPlan":
    """Return a plan that a panel nobody measured refuses too, if it has vibrations and nothing else refuses it."""
    if unmeasured is None or planned.budget is None or planned.refused:
        return planned
    return replace(planned, budget=replace(planned.budget, refused=unmeasured.sentence()))


def plans(
    protocol_file: Path, rig_file: Path, task: str | None, recordings: Path | None, bar: Bar, today: date
) -> tuple[str, str, list["TaskPlan"]]:
    """Return which recordings and rig were planned with, and plans of a task or, for None, of every task.

    Recordings are simulated where there are none. A plan of vibrations refuses a real rig whose panel does not count as
    measured `today`. Raises as `scene_cost.plan`, and `ScheduleError` for an unknown task.
    """
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.protocol import files
    from palpate.experiment.session.kind import session_kind

    protocol, rig = files.load(protocol_file), rigs.load(rig_file)
    asked = [one for one in protocol.tasks if task in (None, one.id)]
    if not asked:
        known = ", ".join(one.id for one in protocol.tasks)
        raise ScheduleError(f"no task '{task}' in study {protocol.study.id}", remedy=f"its tasks: {known}")
    name = f"{rig.rig.name} ({'SIMULATED' if rig.rig.simulated else 'real'})"
    tasks = [one.id for one in asked if session_kind(one).recordings]
    if not tasks:
        kind = import_module(f"palpate.experiment.session.kinds.{asked[0].kind}.plan")
        return "no recordings", name, [kind.plan(protocol=protocol, rig=rig, task=one) for one in asked]
    from palpate.experiment.apparatus.panel.conditioning import open_drive
    from palpate.experiment.apparatus.panel.validity import unmeasured_panel
    from palpate.experiment.recordings import manifest
    from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
    from palpate.experiment.session.kinds.footstep import scene_cost

    open_drive(rig_file.parent, rig.actuator, limit_m_s2=protocol.exposure.vibration_peak_m_s2)
    total, tick = bar
    total(len(tasks))
    with tempfile.TemporaryDirectory() as folder:
        source = "SIMULATED recordings, generated for this plan"
        if recordings is None:
            recordings = recorded_takes.make_recordings(Path(folder) / "simulated", protocol=protocol, seed=1).parent
        else:
            source = f"SIMULATED recordings, {recordings}" if manifest.is_simulated(recordings) else str(recordings)
        made, unmeasured = [], unmeasured_panel(rig_file, rig, today)
        plan = partial(scene_cost.plan, protocol=protocol, rig=rig, rig_folder=rig_file.parent, recordings=recordings)
        for one in tasks:
            process = _process(protocol_file, rig_file, rig, one, recordings)
            made.append(with_refusal(plan(task_id=one, process=process), unmeasured))
            tick()
    return source, name, made


def _process(protocol_file: Path, rig_file: Path, rig: "Rig", task: str, recordings: Path) -> str:
    """Return in words what a process of one task holds, with all of a simulated rig open."""
    from palpate.experiment.rehearsal.session import simulated_far_ends

    if not rig.rig.simulated:
        return "not measured, because planning does not open this rig's devices"
    try:
        with ExitStack() as opened:
            ends = simulated_far_ends(rig, opened)
            files = str(protocol_file), str(rig_file), task, str(recordings)
            return started(Asked(*files, ends.port, ends.address, ends.device), opened).words
    except PalpateError as error:
        return f"not measured: {error.finding.sentence()}"


def _open(asked: Asked) -> None:
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.apparatus.ports import Tracker
    from palpate.experiment.clock import MonotonicClock
    from palpate.experiment.desk.terminal import TerminalConsole
    from palpate.experiment.protocol import files
    from palpate.experiment.session import scene
    from palpate.experiment.session.kind import Sitting
    from palpate.experiment.session.laboratory import open_laboratory
    from palpate.experiment.session.run import RealEnds

    class Ends(RealEnds):
        # The process waits for nobody, so its priority is no matter.
        real_time = attended = False

        def sound_device(self, opened: ExitStack) -> str | None:  # noqa: ARG002
            return asked.device

        def panel(self, site: str | None, opened: ExitStack) -> str | None:  # noqa: ARG002
            return asked.address

        def tracker(self, opened: ExitStack) -> tuple[str | None, None]:  # noqa: ARG002
            return asked.port, None

        def check(self, tracker: Tracker, rig: rigs.Rig) -> None:
            pass

    protocol, rig_file, recordings = files.load(Path(asked.protocol)), Path(asked.rig), Path(asked.recordings)
    used = recordings if scene.plan(protocol=protocol, task_id=asked.task).synthesis else None
    rig, dataset, clock = rigs.load(rig_file), recordings / "none", MonotonicClock()
    sitting = Sitting(protocol, rig, rig_file, "01", asked.task, dataset, used, clock)
    console = TerminalConsole(write=sys.stderr, ask=lambda _: "y", heading="")
    with open_laboratory(sitting, Ends(console)):
        cpu_s = time.process_time()
        status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text("ascii").splitlines())
        mb, threads = int(status["VmRSS"].split()[0]) * 1.024e-3, int(status["Threads"])
        sys.stdout.write(json.dumps(asdict(Held(mb, threads, tuple(sorted(sys.modules)), cpu_s))) + "\n")
        sys.stdout.flush()
        sys.stdin.readline()


if __name__ == "__main__":
    _open(Asked(**json.loads(sys.argv[1])))
