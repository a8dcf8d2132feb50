"""REHEARSAL of a whole study, and PRACTICE of one session of it, through the ports, the journal and the dataset."""

import errno
import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from palpate.experiment import storage
from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import open_drive
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.dataset import build
from palpate.experiment.dataset.checks import Plan
from palpate.experiment.desk.questions import At, Attended, Console, Notice
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.findings import shown
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.kind import rehearsal_kind
from palpate.experiment.rehearsal.practice import Guided
from palpate.experiment.rehearsal.session import (
    HEARD_FILE,
    PANEL_FILE,
    Job,
    rehearse_at_once,
    rehearse_participant,
    run_task,
)
from palpate.experiment.rehearsal.shorter import shortened
from palpate.experiment.session import answering
from palpate.experiment.session.remarks import paused
from palpate.experiment.session.visit import tell_group, visit_steps, walk
from palpate.experiment.study.schedule import allocate, find_allocation

OPTIONS = {"REHEARSAL": "--out", "PRACTICE": "--dataset"}
"""What names the folder of each on the command line."""

PRACTICE_SEED = 1
"""So that whoever practices again meets the same trials."""

WELCOME = """{label}. These are not data of the study.
All files are saved in {out} and marked PRACTICE."""

TO_DO = """Participant {participant}, task {task}, {left} trials (fewer: --repetitions). You are the experimenter.
Press Enter instead of laying out materials. You may end familiarization immediately, and breaks are skipped. {answers}
Ctrl-C pauses."""

SAYS = "In each trial the simulated participant says an answer: press its key, then confirm it."
PRESSES = "The simulated participant answers every trial without you, so there is nothing to confirm."


def rehearse(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path | None,
    participants: int | None,
    seed: int,
    control: Literal["none", "silence", "heard"] = "none",
    real_time: bool = False,
    panel_file: Path | None = None,
    jobs: int = 1,
    total: Callable[[int, int], None] = lambda _, __: None,
    tick: Callable[[], None] = lambda: None,
    screen: Console | None = None,
) -> Path:
    """Rehearse a study, or what remains of an interrupted rehearsal, and return the complete dataset's folder.

    `out` is made or continued; None is a folder under `participants/` named after study and seed. The first
    `participants` are rehearsed, None for all, in `jobs` processes at a time, 0 for one a core. `seed` names every
    draw, and `real_time` paces by the wall clock. `panel_file` has the modes of a panel that moves in time; None is
    one that answers each frequency on its own, as equation (7) assumes. `total` gets the numbers of answers and of
    those on disk, `tick` follows each confirmed answer; `screen` shows what an experimenter would see.

    Raises `DatasetError` if `out` holds anything else, and `PalpateError` if a part failed; the same call continues.
    Before any session nothing is left in `out`.
    """
    protocol = files.load(protocol_file)
    count = protocol.study.participants if participants is None else participants
    if not 1 <= count <= protocol.study.participants:
        raise DatasetError(
            "--participants",
            f"got {count}",
            "give a number",
            allowed=f"1 to {protocol.study.participants}, as in the protocol",
        )
    _check_control(protocol, control)
    rig = _simulated_rig(rig_file, protocol)
    panel = _panel(panel_file, rig_file, rig)
    beside = {PANEL_FILE: panel, HEARD_FILE: HEARD if control == "heard" else None}
    if not real_time:
        _check_paced(rig_file, rig, protocol)
    out = (out or Path("participants") / f"rehearsal-{protocol.study.id}-seed{seed}").resolve()
    plan = Plan(
        protocol_sha256=approval.sha256(protocol),
        rig_sha256=rigs.sha256(rig),
        participants=count,
        seed=seed,
        control="silence" if control == "silence" else "none",
        real_time=real_time,
    )
    allocations = allocate(protocol, seed)[:count]
    todo = [Job(out, one.participant, one.tasks, seed, plan.control, real_time) for one in allocations]
    with ExitStack() as refused:
        if not _is_begun_on(beside, out, plan):
            refused.enter_context(_prepared(out, plan, protocol_file, rig_file, beside))
        left = {job: sum(_remaining(out, protocol, job, task) for task in job.tasks) for job in todo}
        answers = sum(protocol.trials(protocol.task(task)) for job in todo for task in job.tasks)
        begin = partial(total, answers, answers - sum(left.values()))
        jobs = min(jobs or os.cpu_count() or 1, sum(len(job.tasks) for job in todo))
        if jobs == 1 or screen is not None:
            begin()
            for job in todo:
                rehearse_participant(job, tick, screen)
            build.build(out)
        else:
            # The shortest come last, so that nobody waits long for the last of them.
            todo.sort(key=left.__getitem__, reverse=True)
            rehearse_at_once(todo, jobs, tick, partial(build.build, out), begin)
    return out


HEARD = b"# The sound of a control's stimuli gets through the masker.\n"


def _check_control(protocol: Protocol, control: str) -> None:
    """Raise `DatasetError` for a condition that a study cannot have."""
    if control == "silence" and not protocol.renders:
        raise DatasetError(
            "--control",
            f"study {protocol.study.id} does not play anything",
            "leave it out",
            allowed="none, because this study does not play anything",
        )
    if control == "heard" and not any(task.control for task in protocol.tasks):
        raise DatasetError(
            "--control", f"study {protocol.study.id} has no control", "leave it out", allowed="a study with a control"
        )


def _check_paced(rig_file: Path, rig: rigs.Rig, protocol: Protocol) -> None:
    """Raise `DatasetError` for a rig that takes real time."""
    if rig.audio is not None:
        raise DatasetError(
            rig_file,
            "its audio device runs in real time, but simulated time runs faster",
            "add --real-time, or give a rig without [audio]",
        )
    if rig.tracker is not None and rig.tracker.zeroing_mm is not None and protocol.gate is not None:
        raise DatasetError(
            rig_file,
            "its tracker is zeroed with a resting foot, but no foot rests in simulated time",
            "add --real-time, or give a rig without tracker.zeroing_mm",
        )


def generic(protocol: Protocol) -> str:
    """Return a sentence on the materials that are simulated generically; nothing without any."""
    materials = [material.id for material in protocol.materials]
    said = {rehearsal_kind(task).generic(materials): None for task in protocol.tasks}
    return " ".join(filter(None, said))


def simulated_rig(protocol: Protocol) -> Path:
    """Return the shipped rig to rehearse a study on."""
    return files.shipped(rehearsal_kind(protocol.tasks[0]).rig(protocol))


def practice_folder(protocol_file: Path, repetitions: int | None) -> Path:
    """Return where this version of a protocol is practiced, with so many repetitions, unless another folder is named.

    It is the first folder without practice of another version. Raises `ProtocolError` as `files.load`.
    """
    with shortened(protocol_file, repetitions) as file:
        protocol = files.load(file)
    few = f"-{repetitions}-of-each" if repetitions else ""
    plain = Path("participants") / f"practice-{protocol.study.id}{few}"
    folders = (plain if one == 1 else plain.with_name(f"{plain.name}-{one}") for one in itertools.count(1))
    return next(one for one in folders if _version_practiced(one) in ("", approval.sha256(protocol)))


def _version_practiced(folder: Path) -> str:
    """Return the hash of the protocol that is practiced in a folder, empty where none is."""
    try:
        return str(storage.json_of(storage.read_bytes(storage.plan_path(folder)))["protocol_sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return "" if not folder.exists() or not any(folder.iterdir()) else "unknown"


def practice(
    *,
    protocol_file: Path,
    repetitions: int | None,
    rig_file: Path,
    participant: str,
    task_id: str | None,
    out: Path,
    console: Console,
) -> Footer:
    """Have an experimenter at `console` practice a session with a simulated participant, and return its footer.

    `out` is made or continued; tasks have so many `repetitions` as `shortened` gives them. `task_id` None is for all
    incomplete tasks. Raises as `rehearse`, and `RosterError` for an unknown participant or task.
    """
    with ExitStack() as refused:
        file = refused.enter_context(shortened(protocol_file, repetitions))
        protocol = files.load(file)
        rig = _simulated_rig(rig_file, protocol)
        allocation = find_allocation(allocate(protocol, PRACTICE_SEED), participant)
        job = Job(out.resolve(), participant, allocation.tasks, PRACTICE_SEED, "none", real_time=True)
        plan = Plan(
            label="PRACTICE",
            protocol_sha256=approval.sha256(protocol),
            rig_sha256=rigs.sha256(rig),
            participants=protocol.study.participants,
            seed=PRACTICE_SEED,
            control="none",
            real_time=True,
        )
        first = not is_begun(job.dataset, plan)
        if first:
            refused.enter_context(_prepared(job.dataset, plan, file, rig_file, {}))
        left = {task: _remaining(job.dataset, protocol, job, task) for task in job.tasks}
        tasks = (task_id,) if task_id else tuple(task for task in job.tasks if left[task]) or job.tasks[-1:]
        if tasks[0] not in left:
            raise RosterError(
                f"participant {participant} does not do task '{task_id}'",
                remedy="choose one of these",
                allowed=", ".join(left),
            )
        facts = {"label": build.LABELS["PRACTICE"], "participant": participant, "task": tasks[0], "out": out}
        facts["left"] = left[tasks[0]]
        facts["answers"] = SAYS if protocol.answers.mode == "oral" else PRESSES
        for said in filter(None, (WELCOME.format(**facts), generic(protocol), TO_DO.format(**facts))):
            console.tell(Notice(said))
        tell_group(console, protocol, allocation)
        desk = Guided(console, first=first)
        practice = _Practice(job, desk)
        footer = walk(console=desk, tasks=tasks, run=practice.session, noting=practice.noting)
    others = [task for task in job.tasks if left[task] and task not in tasks]
    if footer.reason == "paused":
        onward = ""
    elif not left[tasks[-1]]:
        onward = "This session is already complete. To practice again, give another --participant or --dataset."
    else:
        of = ("--rig", str(rig_file)) if rig_file != simulated_rig(protocol) else ()
        few = ("--repetitions", str(repetitions)) if repetitions else ()
        again = ("palpate", "run", str(protocol_file), "--practice", "-p", participant, "--dataset", str(out))
        study = "You have practiced every task. The desk shows the next step of the study"
        onward = f"{study}: {shown(('palpate', 'desk', str(protocol_file)))}"
        if others:
            onward = f"To practice the other task: {shown((*again, *of, *few, '--task', others[0]))}"
    # What ended the session may stand on an unfinished line.
    console.tell(Notice(f"\n{onward}"))
    if footer.answered:
        console.tell(Notice(f"To see tables of your practice sessions: {shown(('palpate', 'analyse', str(out)))}"))
    return footer


@dataclass(frozen=True)
class _Practice:
    job: Job
    desk: Guided

    def session(self, task_id: str) -> Footer:
        self.desk.tell(At(task_id, visit_steps(self.job.tasks)))
        footer = run_task(self.job, task_id, lambda: None, None, self.desk)
        build.build(self.job.dataset)
        return footer

    def noting(self, task_id: str) -> Attended | None:
        return paused(self.job.dataset, self.job.participant, self.job.tasks, task_id, MonotonicClock())


def _simulated_rig(rig_file: Path, protocol: Protocol) -> rigs.Rig:
    """Return a rig whose files can all be used, before any folder is made. Raises `PalpateError`."""
    rig = rigs.load(rig_file)
    if not rig.rig.simulated:
        raise DatasetError(
            rig_file, "is a real rig", "use a simulated rig file", allowed="a rig file with simulated = true"
        )
    answering.check(protocol, rig)
    for task in protocol.tasks:
        rehearsal_kind(task).lacks_nothing(rig, protocol)
    for site, limit_m_s2 in protocol.limits_m_s2.items():
        open_drive(rig_file.parent, rig.at(site).actuator, limit_m_s2=limit_m_s2)
    return rig


def _panel(panel_file: Path | None, rig_file: Path, rig: rigs.Rig) -> bytes | None:
    """Return the file of a panel's modes, if any, which can be used with a rig. Raises `PalpateError`."""
    if panel_file is None:
        return None
    from palpate.experiment.rehearsal.wires import modes

    modes.read(panel_file)
    if rig.actuator.shaping is None:
        raise DatasetError(
            rig_file,
            "its actuator takes accelerations, but a simulated panel with modes needs volts",
            "leave out --panel, or use a rig with [actuator.shaping]",
            allowed="a rig with [actuator.shaping]",
        )
    return storage.read_bytes(panel_file)


def _is_begun_on(beside: Mapping[str, bytes | None], out: Path, plan: Plan) -> bool:
    """Return what `is_begun` does. Raises `DatasetError` also where another file stands beside the rig, or none."""
    if not is_begun(out, plan):
        return False
    for name, content in beside.items():
        kept = storage.protocol_path(out).with_name(name)
        if content != (storage.read_bytes(kept) if kept.exists() else None):
            another = f"choose another folder with {OPTIONS[plan.label]}"
            what, option = (
                ("on another panel", "--panel") if name == PANEL_FILE else ("with a different control", "--control")
            )
            raise DatasetError(out, f"contains a rehearsal {what}", another, allowed=f"the same {option} as before")
    return True


def _remaining(out: Path, protocol: Protocol, job: Job, task: str) -> int:
    """Return how many answers of one participant in a task are not on disk yet."""
    entries = journal.read_if_begun(storage.journal_path(out, job.participant, task)).entries
    return len(progress(entries).remaining) if entries else protocol.trials(protocol.task(task))


def is_begun(out: Path, plan: Plan) -> bool:
    """Return whether `out` already holds what is planned. Raises `DatasetError` where it holds anything else."""
    another = f"choose another folder with {OPTIONS[plan.label]}"
    for above in out.parents:
        if (above / "dataset_description.json").exists():
            raise DatasetError(out, f"is inside the dataset {above}", another, allowed="none")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return False
    try:
        found = storage.json_of(storage.read_bytes(storage.plan_path(out)))
    except (OSError, ValueError):
        raise DatasetError(
            out, f"is not the dataset of {plan.what}, and {plan.what} writes only to its own datasets", another
        ) from None
    if not isinstance(found, dict):
        found = {}
    wanted = plan.model_dump()
    differing = [
        f"{name} {found.get(name)} there, {wanted[name]} requested"
        for name in wanted
        if found.get(name) != wanted[name]
    ]
    if differing:
        raise DatasetError(out, f"contains {plan.what} with other settings ({'; '.join(differing)})", another)
    return True


@contextmanager
def _prepared(
    out: Path, plan: Plan, protocol_file: Path, rig_file: Path, beside: Mapping[str, bytes | None]
) -> Iterator[None]:
    """Make `out` with all that precedes the first participant, whole or not at all, and undo it without a session."""
    was_there, parents = out.exists(), [above for above in out.parents if not above.exists()]
    made = False
    try:
        with storage.new_folder(out) as partial:
            kept = storage.protocol_path(partial)
            files.keep(protocol_file, kept)
            opening.copy_rig(rig_file, kept.with_name("rig.toml"))
            for name, content in beside.items():
                if content is not None:
                    storage.create(kept.with_name(name), content)
            protocol = files.load(kept)
            rehearsal_kind(protocol.tasks[0]).prepare(partial, protocol, plan.seed)
            storage.write_json(storage.plan_path(partial), plan.model_dump())
        made = True
        yield
    except BaseException as ended:
        if made and not any(path.stat().st_size for path in storage.journals(out)):
            storage.remove_folder(out)
        if was_there:
            out.mkdir(exist_ok=True)
        for folder in parents:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(ended, OSError) and ended.errno in (errno.ENOTEMPTY, errno.EEXIST):
            raise DatasetError(
                out,
                "another palpate program is creating it now",
                f"run the same command later, or choose another folder with {OPTIONS[plan.label]}",
                allowed="one",
            ) from None
        raise
