"""One session of a real study: from the approved protocol and the roster to the dataset."""

from __future__ import annotations

import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from experiment import __version__, storage
from experiment.apparatus import host, opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.ports import Actuator
from experiment.apparatus.tracker import calibration
from experiment.clock import Clock, MonotonicClock, day, utc
from experiment.dataset import build
from experiment.desk.port import Console
from experiment.errors import PalpateError, RecordingError, RigError, RosterError, SessionError
from experiment.protocol import approval
from experiment.protocol.models import Protocol
from experiment.records import journal
from experiment.records.entries import Footer, Header
from experiment.records.progress import progress
from experiment.session import attempt, runner, scene
from experiment.settings import load
from experiment.study import enrolment, roster, schedule

if TYPE_CHECKING:
    from experiment.session.masker import Sound
    from experiment.synthesis.waveforms import Basis


def header(
    *,
    protocol: Protocol,
    rig: rigs.Rig,
    participant: str,
    task_id: str,
    position: int,
    seed: int,
    recordings: Path | None,
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
        recordings: folder of the recordings that stimuli are made from; None where there are none.
        rehearsal: whether the participant is simulated.
        clock: says when it begins.
    """
    return Header(
        study=protocol.study.id,
        protocol_sha256=approval.sha256(protocol),
        software=f"palpate {__version__}",
        rig=rig.rig.name,
        rig_sha256=rigs.sha256(rig),
        recordings_sha256=_recordings_sha256(recordings) if recordings is not None else None,
        seed=seed,
        participant=participant,
        task=task_id,
        task_position=position,
        rehearsal=rehearsal,
        started_utc=utc(clock.now_ns()),
        block_trials=schedule.block_trials(protocol, task_id),
        order=schedule.schedule(protocol=protocol, participant=participant, task_id=task_id, seed=seed),
    )


def _recordings_sha256(folder: Path) -> str:
    from experiment.recordings import manifest

    return manifest.sha256(folder)


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
    if protocol.consent.voice_recordings:
        raise SessionError(f"{protocol_file}: asks for voice recordings, which palpate cannot make yet; leave them out")
    today = day(clock.now_ns())
    approval.verify(protocol_file, protocol, today)
    root = root or enrolment.default_root(protocol)
    roster.Roster.load(build.roster_path(root)).may_run(participant, protocol)
    rig = rigs.load(rig_file)
    if rig.rig.simulated:
        raise RigError(f"{rig_file}: the rig is simulated; give a rig file of real devices, or use palpate rehearse")
    rigs.check(rig, protocol.step)
    calibration.check_age(rig, today)
    seed = enrolment.settle(root, protocol_file, protocol, None)
    allocation = roster.find(roster.allocate(protocol, seed), participant)
    _check_turn(root, allocation, task_id)
    _wait_for_break(root, protocol, allocation, task_id, clock, console)
    with ExitStack() as opened:
        got = opened.enter_context(host.raised())
        console.show(f"Priority: {got}.")
        planned = scene.plan(protocol=protocol, task_id=task_id)
        sound: Sound | None = None
        if rig.audio is not None:
            from experiment.session.masker import dose_before, open_sound

            dose = dose_before(root, protocol, participant, clock)
            sound = open_sound(rig, protocol, clock=clock, dose_before=dose, opened=opened)
        else:
            console.show(
                f"Masker: the rig has no audio device. Play {protocol.masker.noise} noise by other means. "
                f"{protocol.masker.criterion} At most {protocol.exposure.masker_level_db_a:g} dB(A)."
            )
        materials: dict[str, Basis] | None = None
        actuator: Actuator | None = None
        used: Path | None = None
        if planned.synthesis:
            used = _keep_recordings(root, recordings, protocol, planned)
            rate_hz = rig.actuator.rate_hz
            materials = scene.open_stimuli(scene=planned, protocol=protocol, recordings=used, output_rate_hz=rate_hz)
        if planned.actuator:
            from experiment.apparatus.panel.conditioning import open_drive

            limit_m_s2 = protocol.exposure.vibration_peak_m_s2
            drive = open_drive(rig_file.parent, rig.actuator, limit_m_s2=limit_m_s2, materials=materials)
            stream = sound.stream if sound is not None else None
            actuator = opening.open_actuator(rig, limit_m_s2=limit_m_s2, drive=drive, stream=stream)
            opened.callback(actuator.close)
        tracker = opening.open_tracker(rig, clock=clock, contact_mm=protocol.step.contact_mm)
        opened.callback(tracker.close)
        calibration.check_reading(tracker, rig.tracker)
        asked = header(
            protocol=protocol,
            rig=rig,
            participant=participant,
            task_id=task_id,
            position=allocation.tasks.index(task_id) + 1,
            seed=seed,
            recordings=used,
            rehearsal=False,
            clock=clock,
        )
        devices = attempt.Devices(
            tracker=tracker,
            tracker_port=rig.tracker.port,
            noise_mm=rig.tracker.noise_mm,
            actuator=actuator,
            materials=materials,
            console=console,
            clock=clock,
            masker=sound.masker if sound is not None else None,
            reconnect_s=attempt.RECONNECT_S,
            priority=got,
        )
        try:
            footer = runner.run(protocol=protocol, header=asked, devices=devices, rig_file=rig_file, dataset=root)
        except (PalpateError, KeyboardInterrupt) as ended:
            # No device is kept, and no priority, while files are written.
            opened.close()
            try:
                build.build(root)
            except PalpateError as unbuilt:
                ended.add_note(f"the dataset could not be brought up to date either: {unbuilt}")
            raise
    build.build(root)
    return footer


def _check_turn(root: Path, allocation: roster.Allocation, task_id: str) -> None:
    """Refuse a task that is not the participant's, or whose turn has not come."""
    who, tasks = allocation.participant, allocation.tasks
    if task_id not in tasks:
        raise RosterError(f"participant {who} does not do task '{task_id}'; theirs are: {', '.join(tasks)}")
    for earlier in tasks[: tasks.index(task_id)]:
        path = storage.journal_path(root, who, earlier)
        entries = journal.read(path).entries if path.exists() else ()
        footer = progress(entries).footer if entries else None
        if footer is None or footer.reason != "complete":
            raise RosterError(f"participant {who} does task '{earlier}' before '{task_id}'; run that one first")


def _keep_recordings(root: Path, given: Path | None, protocol: Protocol, planned: scene.Scene) -> Path:
    """The recordings in the dataset; put there at the first session that names them."""
    from experiment.recordings import manifest

    kept = root / build.RECORDINGS
    folder = given or kept
    if manifest.is_simulated(folder):
        raise RecordingError(
            f"{folder}: the recordings are simulated; participants feel real ones: record them, or use palpate rehearse"
        )
    if kept.exists():
        if manifest.sha256(folder) != manifest.sha256(kept):
            raise RecordingError(f"{folder}: the study was begun with other recordings; leave out --recordings")
    else:
        manifest.load(folder, synthesis=protocol.synthesis, material_ids=planned.materials)
        partial = kept.with_name(f".{kept.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(folder, partial)
        partial.replace(kept)
    return kept


def _wait_for_break(
    root: Path,
    protocol: Protocol,
    allocation: roster.Allocation,
    task_id: str,
    clock: Clock,
    console: Console,
) -> None:
    """Let the protocol's break pass since the participant's other tasks."""
    for other in allocation.tasks:
        path = storage.journal_path(root, allocation.participant, other)
        if other == task_id or not path.exists():
            continue
        lines = journal.read(path).lines
        left_ns = lines[-1].t_ns + int(protocol.task_order.break_min_s * 1e9) - clock.now_ns() if lines else 0
        if left_ns > 0:
            console.show(f"Break after task {other}: {left_ns / 60e9:.1f} min are left; the session starts then.")
            clock.sleep_ns(left_ns)
