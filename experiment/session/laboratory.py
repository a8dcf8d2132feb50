"""The laboratory of one session: opens what its task needs, in order, and closes it in reverse.

A rehearsal opens the same parts, with other far ends of the ports (`FarEnds`).
"""

import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module

from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.clock import utc
from palpate.experiment.desk.questions import Console, Notice
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.records import journal, software
from palpate.experiment.records.entries import Header, Purpose
from palpate.experiment.session import exposure, masker, scene
from palpate.experiment.session.attempt import Devices
from palpate.experiment.session.kind import FarEnds, Signals, Sitting, session_kind
from palpate.experiment.study import schedule
from palpate.experiment.study.admission import Admission, own_journals


@contextmanager
def open_laboratory(sitting: Sitting, ends: FarEnds) -> Iterator[Devices]:
    """Open what a task needs, and yield the opened parts, which are closed at the end.

    Earlier sessions in the dataset count towards the masker's dose of 24 hours. Raises `PalpateError` if a part cannot
    be opened.
    """
    protocol, rig, clock = sitting.protocol, sitting.rig, sitting.clock
    with ExitStack() as opened:
        priority = opened.enter_context(host.raised()) if ends.real_time else ""
        signals: Signals | None = None
        if rig.triggers and ends.attended:
            triggers = import_module("palpate.experiment.apparatus.wires.triggers")
            signals = triggers.open_triggers(rig, clock, lambda text: console.tell(Notice(text)), opened)
            sitting = replace(sitting, signals=signals)
        planned = scene.plan(protocol=protocol, task_id=sitting.task_id)
        sound: masker.Sound | None = None
        if rig.audio is not None and planned.sounds(rig):
            own = own_journals(sitting.dataset, sitting.participant, (task.id for task in protocol.tasks))
            dose = exposure.dose_before([journal.read_if_begun(path) for path in own.values()], clock)
            device = ends.sound_device(opened)
            sound = masker.open_sound(
                rig, protocol, planned=planned, clock=clock, dose_before=dose, opened=opened, device=device
            )
            ends.wire_sound()
        stream = sound.stream if sound is not None else None
        kind = session_kind(protocol.task(sitting.task_id)).opens(sitting, stream, ends, opened)
        pedal = opening.open_pedal(rig, port=ends.pedal(opened)) if ends.real_time else None
        if pedal is not None:
            opened.callback(pedal.close)
        port, known = ends.buttons(opened)
        buttons = opening.open_buttons(rig, protocol.answers.mode, clock=clock, port=port, known=known)
        if buttons is not None:
            opened.callback(buttons.close)
        console: Console = ends.console()
        if priority and not rig.rig.simulated:
            console.tell(Notice(f"Priority: {priority}."))
        listening = None
        if protocol.answers.microphone:
            from palpate.experiment.desk.voice.listening import open_listening

            listening = open_listening(rig, stream, console, opened)
        yield Devices(
            kind=kind,
            console=console,
            clock=clock,
            masker=sound.masker if sound is not None else None,
            stream=stream,
            reconnect_s=ends.reconnect_s,
            priority=priority,
            pedal=pedal,
            buttons=buttons,
            signals=signals,
            listening=listening,
        )


def header(
    sitting: Sitting, *, position: int, seed: int, purpose: Purpose, admission: Admission | None = None
) -> Header:
    """Return the header of a new session, with its trials in order and a unique `session_id`.

    `position` is the task's among the participant's, from 1. `admission` is None in a rehearsal.
    """
    protocol, rig = sitting.protocol, sitting.rig
    participant, task_id = sitting.participant, sitting.task_id
    recordings_sha256 = floor_m_s2 = None
    if sitting.recordings is not None:
        from palpate.experiment.recordings import manifest

        recordings_sha256 = manifest.sha256(sitting.recordings)
        floor_m_s2 = kind_of(protocol.task(task_id).kind).floor_m_s2(protocol, participant)
    ours = software.this()
    return Header(
        session_id=secrets.token_hex(16),
        study=protocol.study.id,
        protocol_sha256=approval.sha256(protocol),
        software=f"palpate {ours.version}",
        source_sha256=ours.source_sha256,
        rig=rig.rig.name,
        rig_sha256=rigs.sha256(rig),
        recordings_sha256=recordings_sha256,
        floor_m_s2=floor_m_s2,
        roster_sha256=None if admission is None else admission.roster.lines.end.last,
        seal_sha256=None if admission is None else admission.approved.seal_sha256,
        consent_sha256=None if admission is None else admission.consent_sha256,
        seed=seed,
        participant=participant,
        task=task_id,
        task_kind=protocol.task(task_id).kind,
        design=protocol.task(task_id).design,
        task_position=position,
        purpose=purpose,
        started_utc=utc(sitting.clock.now_ns()),
        block_trials=schedule.block_trials(protocol, task_id),
        order=schedule.schedule(protocol=protocol, participant=participant, task_id=task_id, seed=seed),
    )
