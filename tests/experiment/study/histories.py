"""Random histories of a study: enrolment, approvals, consent, sessions, events, withdrawal, kills, all SIMULATED.

Each attempt at a session is compared with a naive model of the rules, which keeps nothing but a list of what happened.
`python -m tests.experiment.study.histories 200` runs so many, and prints what they held.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any, Literal

import pytest

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset import build, checks, verify
from palpate.experiment.errors import PalpateError, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session.kind import Sitting
from palpate.experiment.session.laboratory import header
from palpate.experiment.settings import load
from palpate.experiment.settings.load import read
from palpate.experiment.study import amendment, approvals, enrolment, withdrawal
from palpate.experiment.study.admission import Admission, admit
from palpate.experiment.study.people import enrolling, incidents
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import Allocation, allocated, find_allocation

BEGIN = date(2090, 1, 1)
RIG = shipped("rigs/rehearsal.toml")
TASKS = 2


def _document_of(parse: Callable[[Path, str], dict[str, Any]]) -> Callable[[Path, str], dict[str, Any]]:
    """Return what parses the text of a TOML file once."""
    parsed = cache(lambda text: parse(Path("text.toml"), text))
    return lambda _, text: dict(parsed(text))


@cache
def _read_version(content: bytes) -> Protocol:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_bytes(content)
        return read(path, files.ProtocolFile)


@dataclass
class Model:
    """What happened, as lists of plain facts; `covers` reads them from the first to the last.

    `approvals` are (version, seal, first day, last day, in progress, reconsent), `stops` (day, whether stopped for a
    while, for good, or no longer). `sessions` are (participant, task) -> (index of approval, complete).
    """

    approvals: list[tuple[int, str, date, date, str, bool]] = field(default_factory=list)
    stops: list[tuple[date, str]] = field(default_factory=list)
    consents: dict[str, int | None] = field(default_factory=dict)
    gone: set[str] = field(default_factory=set)
    sessions: dict[tuple[str, str], tuple[int, bool]] = field(default_factory=dict)

    def state(self, day: date) -> str:
        state = "runs"
        for since, what in sorted(self.stops, key=lambda one: one[0]):
            if since <= day and state != "ended":
                state = what
        return state

    def at(self, day: date) -> int:
        """The index of the last approval that has begun."""
        return [index for index, one in enumerate(self.approvals) if index == 0 or one[2] <= day][-1]

    def first(self, version: int) -> int:
        """The index of the approval that began a version."""
        return next(index for index, one in enumerate(self.approvals) if one[0] == version)

    def begins(self, day: date) -> int:
        """The version that somebody is under who begins on a day."""
        return max(one[0] for one in self.approvals[: self.at(day) + 1])

    def covers(self, who: str, task: str, day: date) -> int | None:
        """The index of the approval for a session, None where there may be none."""
        if self.state(day) != "runs" or who in self.gone or self.consents.get(who) is None:
            return None
        index = self.moved(who, task, day)
        day = max(
            [day, *(self.approvals[index][2] for (label, _), (index, _) in self.sessions.items() if label == who)]
        )
        if index is None or not self.approvals[index][2] <= day <= self.approvals[index][3]:
            return None
        for later in range(1, self.first(self.approvals[index][0]) + 1):
            if self.approvals[later][5] and (self.consents[who] or 0) < later:
                return None
        return index

    def moved(self, who: str, task: str, day: date) -> int | None:
        own = [index for (label, _), (index, _) in self.sessions.items() if label == who]
        now = max([self.at(day), *own])
        begun = (who, task) in self.sessions
        start = self.sessions[who, task][0] if begun else max(own, default=now)
        version = self.approvals[start][0] if own else self.begins(day)
        for index in range(start + 1, now + 1):
            amended = self.first(self.approvals[index][0]) == index
            in_progress = self.approvals[index][4]
            if amended and begun and in_progress == "new":
                return None
            if amended and not begun and in_progress in ("session", "new"):
                version = self.approvals[index][0]
        return max(index for index in range(now + 1) if self.approvals[index][0] == version)


@dataclass
class World:
    """A study on disk, its model, and the day."""

    folder: Path
    patch: pytest.MonkeyPatch
    draw: random.Random
    model: Model = field(default_factory=Model)
    day: date = BEGIN
    version: int = 0
    seen: Counter[str] = field(default_factory=Counter)
    line_on: date = BEGIN
    session_on: date = BEGIN

    def __post_init__(self) -> None:
        # The same few versions are read and hashed thousands of times.
        self.patch.setattr(files, "load", lambda path: _read_version(path.read_bytes()))
        self.patch.setattr(approval, "sha256", cache(approval.sha256))
        self.patch.setattr(load, "_document", _document_of(load._document))
        for module in (enrolment, enrolling, amendment, incidents):
            self.patch.setattr(module, "wall_ns", self.now_ns)
        append = Roster.append

        def stamped(roster: Roster, kind: Any, /, **facts: object) -> None:
            roster.now_ns = self.now_ns
            append(roster, kind, **facts)
            self.line_on = self.day

        self.patch.setattr(Roster, "append", stamped)
        self.write_version(0)
        self.seal(BEGIN, BEGIN + timedelta(days=150))
        self.model.approvals.append((0, self.beside(), BEGIN, BEGIN + timedelta(days=150), "old", False))

    @property
    def file(self) -> Path:
        return self.folder / "study.toml"

    @property
    def root(self) -> Path:
        return self.folder / "dataset"

    @property
    def roster(self) -> Roster:
        return Roster.load(storage.roster_path(self.root))

    def now_ns(self) -> int:
        noon = datetime(self.day.year, self.day.month, self.day.day, 12, tzinfo=UTC)
        return int(noon.timestamp()) * 10**9

    def write_version(self, version: int) -> None:
        text = shipped("okamoto2012.toml").read_text("utf-8")
        limit = f"vibration_peak_m_s2 = {30 - version / 10}"
        for old, new in (
            ("repetitions = 10", "repetitions = 1"),
            ("participants = 15", "participants = 4"),
            ("participants = 10", "participants = 4"),
            ("limit = 36", "limit = 4"),
            ("vibration_peak_m_s2 = 30.0", limit),
        ):
            assert old in text
            text = text.replace(old, new)
        self.file.write_text(text, "utf-8")

    def seal(self, first: date, last: date) -> None:
        protocol = files.load(self.file)
        number = f"{len(self.model.approvals) + 1}"
        board = protocol.ethics.board
        days: dict[str, Any] = {"approved_on": first, "expires_on": last}
        sealing.write(self.file, protocol, approval_number=number, board=board, replace=True, **days)

    def beside(self) -> str:
        return approvals.seal_sha256(self.file)

    def step(self) -> None:
        self.day += timedelta(days=self.draw.choice((0, 0, 1, 3, 11)))
        weights = {"enrol": 4, "consent": 3, "session": 12, "amend": 2, "renew": 2, "stop": 2, "withdraw": 1, "tell": 1}
        event = self.draw.choices(list(weights), list(weights.values()))[0]
        if event != "enrol" and not storage.roster_path(self.root).exists():
            return
        getattr(self, event)()

    def enrol(self) -> None:
        who = f"{len(self.model.consents) + 1:02d}"
        if len(self.model.consents) >= 4:
            return
        signed = self.draw.random() < 0.8 and self.day >= self.model.approvals[0][2]
        kept = len(self.model.approvals) > 1 or self.model.sessions
        first = self.model.first(self.model.begins(self.day))
        file = (
            storage.protocol_path(self.root, first + 1)
            if kept and storage.protocol_path(self.root).exists()
            else self.file
        )
        runs = self.model.state(self.day) == "runs"
        try:
            enrolling.enrol(file, who, self.day if signed else None, root=self.root, seed=7)
        except RosterError:
            assert not runs
            return
        assert runs
        self.model.consents[who] = first if signed else None
        self.seen["enrolment"] += 1

    def consent(self) -> None:
        who = self.draw.choice(list(self.model.consents))
        version, had = self.draw.choice(self.model.approvals)[0], self.model.consents[who]
        at = self.model.first(version)
        allowed = who not in self.model.gone and (had is None or had < at)
        beside = self.model.approvals[-1][0] == version
        file = self.file if beside else storage.protocol_path(self.root, at + 1)
        try:
            enrolment.consent(file, who, self.day, root=self.root)
        except PalpateError:
            assert not allowed
            return
        assert allowed
        self.model.consents[who] = at
        self.seen["consent"] += 1

    def amend(self, kind: Literal["amendment", "renewal"] = "amendment") -> None:
        begins = max(self.day, self.model.approvals[-1][2]) + timedelta(days=self.draw.choice((0, 0, 5)))
        if self.model.state(begins) == "ended" or (not self.model.sessions and kind == "renewal"):
            return
        if kind == "amendment":
            self.version += 1
        version = self.version if kind == "amendment" else self.draw.choice(self.model.approvals)[0]
        self.write_version(version)
        lasts = begins + timedelta(days=self.draw.choice((20, 150)))
        self.seal(self.day, lasts)
        in_progress: Any = self.draw.choice(("old", "session", "new")) if kind == "amendment" else None
        anew = self.draw.random() < 0.5 if kind == "amendment" else None
        planned = amendment.plan_approval(
            self.file, root=self.root, from_on=begins, in_progress=in_progress, reconsent=anew
        )
        if self.draw.random() < 0.3:
            # A kill after the copies and before the roster's line: the same command is run again.
            kept = storage.protocol_path(self.root, planned.number)
            storage.write_bytes(kept, b"half of")
            self.seen["kill of an amendment"] += 1
        amendment.record(self.file, planned, root=self.root)
        self.model.approvals.append((version, self.beside(), begins, lasts, in_progress or "old", bool(anew)))
        self.seen[kind] += 1

    def renew(self) -> None:
        self.amend("renewal")

    def stop(self) -> None:
        on = self.day + timedelta(days=self.draw.choice((0, 0, -4, 6)))
        # A stop before a session that took place is no history that verifies.
        on = on if on > self.session_on else self.day
        state = self.model.state(on)
        likely = "lifted" if state == "suspended" else "suspended"
        kind: Any = self.draw.choices((likely, "ended", "suspended", "lifted"), (80, 5, 5, 5))[0]
        allowed = state != "ended" and (kind == "ended" or kind == likely)
        try:
            amendment.stop(self.file, kind, on, "the board's letter", root=self.root)
        except RosterError:
            assert not allowed
            return
        assert allowed
        self.model.stops.append((on, {"lifted": "runs"}.get(kind, kind)))
        self.seen[{"lifted": "suspension lifted", "ended": "end"}.get(kind, "suspension")] += 1

    def withdraw(self) -> None:
        who = self.draw.choice(list(self.model.consents))
        if who in self.model.gone or self.draw.random() < 0.5:
            return
        withdrawal.withdraw(self.file, who, "asked to stop", root=self.root, rebuild=build.build)
        self.model.gone.add(who)
        self.seen["withdrawal"] += 1

    def tell(self) -> None:
        """An adverse event; it is there to the end, whoever withdraws."""
        protocol = files.load(storage.protocol_path(self.root))
        incidents.report(protocol, self.root, "adverse event", what="A fall.", done="A pause.")
        self.seen["adverse event"] += 1

    def allocation(self, who: str) -> Allocation:
        protocol = files.load(storage.protocol_path(self.root))
        return find_allocation(allocated(protocol, 7, {}), who)

    def session(self) -> None:
        """Try every version and seal that there is: the one that the model gives may run, and no other."""
        who = self.draw.choice(list(self.model.consents))
        own = self.allocation(who)
        over = [task for task in own.tasks if self.model.sessions.get((who, task), (0, False))[1]]
        left = [task for task in own.tasks if task not in over]
        closed = [task for task in left if (who, task) in self.model.sessions and self._closed(who, task)]
        tasks = [task for task in left if task not in closed]
        if not tasks:
            return
        task = tasks[0]
        wanted = self.model.covers(who, task, self.day)
        candidates = [storage.protocol_path(self.root, number) for number in range(1, len(self.model.approvals) + 1)]
        candidates = [one for one in (self.file, *candidates) if one.exists() and approval.seal_path(one).exists()]
        # With a clock that was set back the day of the roster's last line counts.
        back = self.day - timedelta(days=5)
        on = self.model.covers(who, task, max(back, self.line_on))
        early = self._admitted(candidates, own, task, back)
        assert {one.approved.seal_sha256 for one in early.values()} <= {self.model.approvals[on or 0][1]}
        assert not early or on is not None
        ran = self._admitted(candidates, own, task, self.day)
        found = {(one.approved.protocol_sha256, one.approved.seal_sha256) for one in ran.values()}
        self.seen["refused attempt at a session"] += wanted is None
        if wanted is None:
            assert found == set(), (self.day, who, task)
            return
        assert len(found) == 1, (self.day, who, task, wanted, found)
        ((_, seal_sha256),) = found
        assert seal_sha256 == self.model.approvals[wanted][1]
        file, admission = next(iter(ran.items()))
        assert admission.consent_sha256 is not None
        self.session_on = self.day
        self._write(who, task, own, file, admission)
        complete = self.draw.random() < 0.7
        if (who, task) not in self.model.sessions:
            self.model.sessions[who, task] = wanted, complete
        else:
            self.model.sessions[who, task] = self.model.sessions[who, task][0], complete
        self._end(who, task, complete=complete)
        self.seen["session" if complete else "session cut off by a kill"] += 1

    def _admitted(self, candidates: list[Path], own: Allocation, task: str, day: date) -> dict[Path, Admission]:
        ran = {}
        for file in candidates:
            try:
                approval.verify(file, protocol := files.load(file), day)
                ran[file] = admit(self.root, file, protocol, own, task, (), day)
            except PalpateError:
                continue
        return ran

    def _closed(self, who: str, task: str) -> bool:
        return self.model.moved(who, task, self.day) is None

    def _write(self, who: str, task: str, own: Allocation, file: Path, admission: Admission) -> None:
        path = storage.journal_path(self.root, who, task)
        approvals.keep_first(self.root, file)
        if path.exists():
            return
        clock = ManualClock(self.now_ns())
        sitting = Sitting(files.load(file), rigs.load(RIG), RIG, who, task, self.root, None, clock)
        position = own.tasks.index(task) + 1
        asked = header(sitting, position=position, seed=7, purpose="STUDY", admission=admission)
        with closing(journal.Journal(path, clock, journal.read_if_begun(path))) as opened:
            opened.append(asked)

    def _end(self, who: str, task: str, *, complete: bool) -> None:
        if complete:
            path = storage.journal_path(self.root, who, task)
            with closing(journal.Journal(path, ManualClock(self.now_ns()), journal.read(path))) as opened:
                opened.append(Footer(reason="complete", answered=0, silent=True))

    def check(self) -> None:
        """Every journal is under the model's approval, the orders are as drawn at first, and nothing speaks against
        the dataset."""
        if not storage.protocol_path(self.root).exists():
            return
        for (who, task), (index, _) in self.model.sessions.items():
            head = journal.read(storage.journal_path(self.root, who, task)).header
            version, seal = self.model.approvals[index][:2]
            kept = files.load(storage.protocol_path(self.root, self.model.first(version) + 1))
            assert (head.seal_sha256, head.protocol_sha256) == (seal, approval.sha256(kept))
            assert head.task == self.allocation(who).tasks[head.task_position - 1]
        orders = [self.allocation(who).tasks for who in self.model.consents]
        for place in range(0, len(orders) - 1, TASKS):
            assert orders[place] != orders[place + 1]
        dataset = checks.load(self.root)
        assert len(dataset.people.incidents) == self.seen["adverse event"]
        found = [one.sentence() for one in checks.findings(dataset)]
        assert found == [], found
        told = list(verify._without_approval(dataset, dataset.approvals)) if dataset.approvals else []
        assert told == []


def run_history(folder: Path, seed: int, steps: int) -> Counter[str]:
    """Run one history; return how often each event took place."""
    folder.mkdir(parents=True, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        world = World(folder, patch, random.Random(seed))
        for _ in range(steps):
            world.step()
        world.check()
        return world.seen


if __name__ == "__main__":
    # No history ends in a power cut.
    os.fsync = lambda *_: None
    total: Counter[str] = Counter()
    count = int(sys.argv[1])
    for seed in range(count):
        with tempfile.TemporaryDirectory() as name:
            total += run_history(Path(name), seed, 40)
    print(f"{count} histories of 40 steps each; every session is under the version and seal of the model.\n")
    print("| event | times |\n|:--|--:|")
    for event, times in sorted(total.items()):
        print(f"| {event} | {times:,} |")
