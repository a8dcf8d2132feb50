"""REHEARSAL of a whole study: every participant, every task, through the ports, the journal and the dataset."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from experiment import storage
from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.panel.conditioning import open_drive
from experiment.dataset import build
from experiment.desk.port import Console
from experiment.errors import DatasetError
from experiment.protocol import approval, files
from experiment.protocol.models import Protocol
from experiment.records import journal
from experiment.records.progress import progress
from experiment.rehearsal.footstep import recorded_takes
from experiment.rehearsal.footstep.participant import Tick
from experiment.rehearsal.session import Job, rehearse_at_once, rehearse_participant
from experiment.study import roster

Control = Literal["none", "silence"]


@dataclass(frozen=True)
class Plan:
    """What is rehearsed, as for `rehearse`; kept on disk, so that an interrupted rehearsal continues as it was begun.

    A folder without it is no rehearsal and is never written to.

    `label` is REHEARSAL, for whoever opens the file.
    """

    label: str
    protocol_sha256: str
    rig_sha256: str
    participants: int
    seed: int
    control: Control
    real_time: bool


def rehearse(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path | None,
    participants: int | None,
    seed: int,
    control: Control = "none",
    real_time: bool = False,
    jobs: int = 1,
    total: Callable[[int], None] = lambda _: None,
    tick: Tick = lambda: None,
    screen: Console | None = None,
) -> Path:
    """Rehearse a study, or what remains of an interrupted rehearsal, and return the complete dataset's folder.

    `rig_file` is of a simulated rig. `out` is made, or continued where it holds the same rehearsal; None stands for a
    folder under `participants/` that is named after the study and the seed. `participants` are rehearsed from the
    first, None for all of the study's, `jobs` at a time, each in a process of its own; 0 is one a core. `seed` names
    every random draw, and `real_time` paces by the wall clock. `total` is called with the number of answers that
    remain, and `tick` after each confirmed answer; `screen` shows what an experimenter would see, one participant after
    another.

    Raises `DatasetError` if `out` holds anything but this rehearsal, and `PalpateError` if a part failed; the same call
    continues where it stopped. If no session has begun by then, nothing is left in `out`.
    """
    protocol = files.load(protocol_file)
    rig = rigs.load(rig_file)
    count = protocol.study.participants if participants is None else participants
    if not 1 <= count <= protocol.study.participants:
        raise DatasetError(
            f"--participants: got {count}; allowed: 1 to {protocol.study.participants}, as in the protocol; give number"
        )
    if not rig.rig.simulated:
        raise DatasetError(f"{rig_file}: is a real rig; allowed: one that says simulated = true; give such a rig file")
    if rig.audio is not None and not real_time:
        raise DatasetError(
            f"{rig_file}: its audio device runs in real time, and simulated time is faster; add --real-time, or give a "
            "rig without [audio]"
        )
    if rig.tracker.zeroing_mm is not None and not real_time:
        raise DatasetError(
            f"{rig_file}: its tracker is zeroed by a resting foot, and no foot rests in simulated time; add "
            "--real-time, or give a rig without tracker.zeroing_mm"
        )
    # Errors in the rig's files are reported before a folder is made.
    open_drive(rig_file.parent, rig.actuator, limit_m_s2=protocol.exposure.vibration_peak_m_s2)
    out = (out or Path("participants") / f"rehearsal-{protocol.study.id}-seed{seed}").resolve()
    plan = Plan("REHEARSAL", approval.sha256(protocol), rigs.sha256(rig), count, seed, control, real_time)
    allocations = roster.allocate(protocol, seed)[:count]
    todo = [Job(out, one.participant, one.tasks, seed, control, real_time) for one in allocations]
    with ExitStack() as refused:
        if not is_begun(out, plan):
            refused.enter_context(_prepared(out, plan, protocol_file, rig_file))
        total(sum(_remaining(out, protocol, job) for job in todo))
        jobs = jobs or os.cpu_count() or 1
        if jobs == 1 or screen is not None:
            for job in todo:
                rehearse_participant(job, tick, screen)
        else:
            rehearse_at_once(todo, jobs, tick)
    build.build(out)
    return out


def _remaining(out: Path, protocol: Protocol, job: Job) -> int:
    """Return how many answers of one participant are not on disk yet."""
    left = 0
    for task in job.tasks:
        path = storage.journal_path(out, job.participant, task)
        entries = journal.read_if_begun(path).entries
        trials = len(protocol.materials) * protocol.task(task).repetitions
        left += len(progress(entries).remaining) if entries else trials
    return left


def is_begun(out: Path, plan: Plan) -> bool:
    """Return whether `out` already holds this rehearsal. Raises `DatasetError` where it holds anything else."""
    for above in out.parents:
        if (above / "dataset_description.json").exists():
            raise DatasetError(f"{out}: is inside the dataset {above}; choose a folder outside it with --out")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return False
    try:
        found = storage.json_of(storage.read_bytes(storage.plan_path(out)))
    except (OSError, ValueError):
        raise DatasetError(
            f"{out}: is no rehearsal, and a rehearsal never writes into anything else; choose another folder with --out"
        ) from None
    if not isinstance(found, dict):
        found = {}
    wanted = asdict(plan)
    differing = [
        f"{name} {found.get(name)} there, {wanted[name]} asked for"
        for name in wanted
        if found.get(name) != wanted[name]
    ]
    if differing:
        raise DatasetError(f"{out}: holds another rehearsal ({'; '.join(differing)}); choose another folder with --out")
    return True


@contextmanager
def _prepared(out: Path, plan: Plan, protocol_file: Path, rig_file: Path) -> Iterator[None]:
    """Make `out` with all that stands before the first participant, whole or not at all.

    If this ends before the first session has begun, `out` is as it was before; what another call made stays.
    """
    was_there, parents = out.exists(), [above for above in out.parents if not above.exists()]
    made = False
    try:
        with storage.new_folder(out) as partial:
            source = partial / "sourcedata"
            storage.create(source / "protocol.toml", protocol_file.read_bytes())
            opening.copy_rig(rig_file, source / "rig.toml")
            protocol = files.load(source / "protocol.toml")
            recorded_takes.make_recordings(partial / storage.RECORDINGS, protocol=protocol, seed=plan.seed)
            storage.write_json(storage.plan_path(partial), asdict(plan))
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
                f"{out}: another palpate rehearse is making it at this moment; allowed: one; give the same command "
                "later, or choose another folder with --out"
            ) from None
        raise
