"""One session of a real study: from the approved protocol and the roster to the dataset."""

from __future__ import annotations

import json
import secrets
import shutil
from contextlib import ExitStack
from datetime import UTC, date, datetime
from pathlib import Path

from experiment import __version__, dataset, roster, scene, schedule
from experiment.apparatus import rig as rigs
from experiment.apparatus.ports import Actuator, Console
from experiment.clock import Clock, MonotonicClock, utc
from experiment.errors import DatasetError, RigError, RosterError
from experiment.protocol import canonical, load, seal
from experiment.protocol.models import Protocol
from experiment.records import Footer, Header
from experiment.session import journal, runner

SEED = "seed.json"
"""Beside the journals: the one seed that names every draw of a study."""


def header(
    *,
    protocol: Protocol,
    rig: rigs.Rig,
    participant: str,
    task_id: str,
    position: int,
    seed: int,
    rehearsal: bool,
    clock: Clock,
) -> Header:
    """What a session is, with its trials in order.

    Args:
        protocol: the study.
        rig: the rig it runs on.
        participant: label.
        task_id: id of the task.
        position: which of the participant's tasks this is, from 1.
        seed: of the study's draws.
        rehearsal: whether the participant is simulated.
        clock: says when it begins.
    """
    return Header(
        study=protocol.study.id,
        protocol_sha256=canonical.sha256(protocol),
        software=f"palpate {__version__}",
        rig=rig.rig.name,
        rig_sha256=rigs.sha256(rig),
        seed=seed,
        participant=participant,
        task=task_id,
        task_position=position,
        rehearsal=rehearsal,
        started_utc=utc(clock.now_ns()),
        order=schedule.schedule(protocol=protocol, participant=participant, task_id=task_id, seed=seed),
    )


def default_root(protocol: Protocol) -> Path:
    """Where the dataset of a study stands unless another folder is named."""
    return Path("participants") / protocol.study.id


def enrol(
    protocol_file: Path, participant: str, consent_on: date | None, *, root: Path | None, seed: int | None
) -> Path:
    """Enrol the next participant; the first one begins the study's dataset and settles its seed.

    Args:
        protocol_file: the study's protocol.
        participant: the next label.
        consent_on: day of consent; None while there is none.
        root: folder of the dataset; None for `participants/STUDY`.
        seed: of the study's draws; None for the settled one, or a new one.

    Returns:
        The roster's file.

    Raises:
        RosterError: not the next label, or one that the study does not have.
        DatasetError: the folder is that of something else.
    """
    protocol = load.load(protocol_file)
    root = root or default_root(protocol)
    roster.find(roster.allocate(protocol, 0), participant)
    _settle(root, protocol_file, protocol, seed)
    path = dataset.roster_path(root)
    roster.Roster.load(path).enrol(participant, consent_on)
    return path


def withdraw(protocol_file: Path, participant: str, reason: str, *, root: Path | None) -> Path:
    """Record that a participant withdrew; the dataset says so, and analysis leaves them out.

    Raises:
        RosterError: the participant is not enrolled, or the reason is no line of text.
    """
    root = root or default_root(load.load(protocol_file))
    path = dataset.roster_path(root)
    roster.Roster.load(path).withdraw(participant, reason)
    if dataset.journals(root):
        dataset.build(root)
    return path


def run(
    *,
    protocol_file: Path,
    rig_file: Path,
    participant: str,
    task_id: str,
    root: Path | None,
    recordings: Path | None,
    console: Console,
) -> Footer:
    """Run one session of a participant in the room, or what remains of it, and bring the dataset up to date.

    Args:
        protocol_file: the study's protocol, sealed.
        rig_file: the rig.
        participant: label of an enrolled participant.
        task_id: one of the participant's tasks.
        root: folder of the study's dataset; None for `participants/STUDY`.
        recordings: folder of the recordings that stimuli are made from; None for those in the dataset.
        console: the experimenter's screen.

    Raises:
        PalpateError: anything that forbids or ends the session, before a participant is on the panel where possible.
    """
    clock = MonotonicClock()
    protocol = load.load(protocol_file)
    seal.verify(protocol_file, protocol, datetime.now(UTC).astimezone().date())
    root = root or default_root(protocol)
    roster.Roster.load(dataset.roster_path(root)).may_run(participant, protocol)
    rig = rigs.load(rig_file)
    if rig.rig.simulated:
        raise RigError(f"{rig_file}: the rig is simulated; give a rig file of real devices, or use palpate rehearse")
    rigs.check(rig, protocol.step)
    seed = _settle(root, protocol_file, protocol, None)
    allocation = roster.find(roster.allocate(protocol, seed), participant)
    if task_id not in allocation.tasks:
        raise RosterError(
            f"participant {participant} does not do task '{task_id}'; theirs are: {', '.join(allocation.tasks)}"
        )
    _wait_for_break(root, protocol, participant, task_id, allocation.tasks, clock, console)
    with ExitStack() as opened:
        planned = scene.plan(protocol=protocol, task_id=task_id)
        render: scene.Render | None = None
        actuator: Actuator | None = None
        if planned.synthesis:
            folder = recordings or root / dataset.RECORDINGS
            render = scene.open_stimuli(scene=planned, protocol=protocol, recordings=folder)
        if planned.actuator:
            actuator = rigs.open_actuator(rig, limit_m_s2=protocol.exposure.vibration_peak_m_s2)
            opened.callback(actuator.close)
        tracker = rigs.open_tracker(rig)
        opened.callback(tracker.close)
        asked = header(
            protocol=protocol,
            rig=rig,
            participant=participant,
            task_id=task_id,
            position=allocation.tasks.index(task_id) + 1,
            seed=seed,
            rehearsal=False,
            clock=clock,
        )
        dataset.keep_rig(root, rig_file, participant, task_id)
        devices = runner.Devices(tracker, rig.tracker.port, actuator, render, console, clock)
        footer = runner.run(protocol=protocol, header=asked, devices=devices, dataset=root)
    dataset.build(root)
    return footer


def _settle(root: Path, protocol_file: Path, protocol: Protocol, seed: int | None) -> int:
    """Keep protocol and seed beside the journals at the first session, and hold every later one to them."""
    source = root / "sourcedata"
    kept = source / "protocol.toml"
    if not kept.exists():
        if root.exists() and (not root.is_dir() or any(root.iterdir())):
            raise DatasetError(f"{root}: is no dataset that palpate run began; choose another folder with --dataset")
        source.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(protocol_file, kept)
    elif canonical.sha256(load.load(kept)) != canonical.sha256(protocol):
        raise DatasetError(
            f"{root}: was begun with another form of the protocol; run {kept}, or give another folder with --dataset"
        )
    if (source / "rehearsal.json").exists():
        raise DatasetError(f"{root}: is a rehearsal's; choose another folder with --dataset")
    file = source / SEED
    if not file.exists():
        settled = secrets.randbelow(2**31) if seed is None else seed
        file.write_text(json.dumps({"seed": settled}) + "\n", "utf-8")
        return settled
    try:
        settled = int(json.loads(file.read_text("utf-8"))["seed"])
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{file}: holds no seed; restore it from a backup or from a journal's header") from error
    if seed not in (None, settled):
        raise DatasetError(f"{root}: its draws are named by seed {settled}, not {seed}; leave out --seed")
    return settled


def _wait_for_break(
    root: Path,
    protocol: Protocol,
    participant: str,
    task_id: str,
    tasks: tuple[str, ...],
    clock: Clock,
    console: Console,
) -> None:
    """Let the protocol's break pass since the participant's other tasks."""
    for other in tasks:
        path = runner.journal_path(root, participant, other)
        if other == task_id or not path.exists():
            continue
        lines = journal.read(path).lines
        left_ns = lines[-1].t_ns + int(protocol.task_order.break_min_s * 1e9) - clock.now_ns() if lines else 0
        if left_ns > 0:
            console.show(f"Break after task {other}: {left_ns / 60e9:.1f} min are left; the session starts then.")
            clock.sleep_ns(left_ns)
