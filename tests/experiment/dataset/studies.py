"""A study's dataset made in a moment: approved, enrolled and run with scripted devices. All of it is SIMULATED."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.tracker.frames import Samples, encode
from palpate.experiment.dataset import build
from palpate.experiment.desk.messages import Repeat
from palpate.experiment.desk.questions import Remark
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Header
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.kind import Sitting
from palpate.experiment.session.laboratory import header
from palpate.experiment.study import approvals, enrolment, roster
from palpate.experiment.study.admission import Admission
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.schedule import Allocation, allocated, find_allocation
from tests.experiment.session.bench import Bench
from tests.experiment.session.scripted import (
    START_NS,
    ScriptedActuator,
    ScriptedConsole,
    ScriptedTracker,
    step_samples,
)

DAY = date(2001, 9, 9)
"""On which every session begins."""


@dataclass(frozen=True)
class MadeStudy:
    """A study with a protocol of four trials a task, and where its dataset stands."""

    file: Path
    root: Path

    @property
    def protocol(self) -> Protocol:
        return files.load(self.file)

    @property
    def tasks(self) -> tuple[Allocation, ...]:
        known = roster.Roster.load(storage.roster_path(self.root))
        return allocated(self.protocol, enrolment.seed_of(self.root), known.takes)

    def journal(self, place: int = 0, position: int = 0) -> Path:
        one = self.tasks[place]
        return storage.journal_path(self.root, one.participant, one.tasks[position])

    def header(self, participant: str, task: str) -> Header:
        known = roster.Roster.load(storage.roster_path(self.root))
        return header(
            Sitting(
                protocol=self.protocol,
                rig=rigs.load(shipped("rigs/rehearsal.toml")),
                rig_file=shipped("rigs/rehearsal.toml"),
                participant=participant,
                task_id=task,
                dataset=self.root,
                recordings=None,
                clock=ManualClock(START_NS),
            ),
            position=find_allocation(self.tasks, participant).tasks.index(task) + 1,
            seed=enrolment.seed_of(self.root),
            purpose=enrolment.purpose_of(self.root),
            admission=Admission(known, approvals.read_first(self.root), None),
        )

    def run(self, asked: Header, keys: Sequence[str | Repeat] = "capt", remarks: Iterable[Remark] = ()) -> None:
        """One session under this header, whatever it says, with remarks at its end."""
        clock = ManualClock(START_NS)
        steps = [framed(step_samples(600_000 * n, 100.0 * n)) for n in range(1, len(keys) + 1)]
        devices = ScriptedTracker(steps, clock=clock), ScriptedConsole(clock, keys), ScriptedActuator()
        devices[1].remarks.extend(remarks)
        Bench(*devices, clock, []).run(self.protocol, asked, self.root)


def make_study(
    folder: Path,
    *,
    study: str = "okamoto2012",
    min_s: int = 180,
    seed: int = 1,
    pilot: bool = False,
    enrolled: int = 2,
    sessions: int = 2,
    kept_months: int | None = None,
    voices: bool = False,
    further: dict[str, str] | None = None,
    keys: str = "capt",
) -> MadeStudy:
    """Make a study in a folder; the first `sessions` participants do their first task.

    In its protocol the `further` texts stand in place of others, and `keys` are pressed in a session.
    """
    folder.mkdir(parents=True)
    file = folder / "study.toml"
    text = shipped("okamoto2012.toml").read_text("utf-8")
    changed = {"repetitions = 10": "repetitions = 1", "limit = 36": "limit = 4", "min_s = 180": f"min_s = {min_s}"}
    if kept_months is not None:
        changed["voice_recordings = false"] = f"kept_months = {kept_months}"
    if voices:
        changed |= {
            "voice_recordings = false": "voice_recordings = true",
            'mode = "oral"': 'mode = "oral"\nmicrophone = true',
        }
    for old, new in ({'id = "okamoto2012"': f'id = "{study}"'} | changed | (further or {})).items():
        assert old in text
        text = text.replace(old, new)
    file.write_text(text, "utf-8")
    made = MadeStudy(file, folder / "dataset")
    sealing.write(
        file,
        made.protocol,
        approval_number="17",
        board=made.protocol.ethics.board,
        approved_on=date(2001, 1, 1),
        expires_on=date(2099, 1, 1),
    )
    for place in range(enrolled):
        enrolling.enrol(file, f"{place + 1:02d}", DAY, root=made.root, seed=seed, pilot=pilot)
    kept = approval.seal_path(storage.protocol_path(made.root))
    storage.write_bytes(kept, approval.seal_path(file).read_bytes())
    for one in made.tasks[:sessions]:
        made.run(made.header(one.participant, one.tasks[0]), keys)
    if sessions:
        build.build(made.root)
    return made


def framed(step: Samples) -> Samples:
    """The step as a tracker sends it."""
    raw = [encode(number, int(us), 30_000) for number, us in enumerate(step.device_us)]
    ends = np.cumsum([len(frame) for frame in raw])
    return Samples(step.device_us, step.height_mm, b"".join(raw), ends, step.arrived_ns)
