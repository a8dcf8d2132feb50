"""A study's progress: who is done, under way and due, and what prevents it. Concealed orders stay concealed."""

import shutil
from calendar import monthrange
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, timedelta
from itertools import groupby
from pathlib import Path
from textwrap import fill, shorten, wrap
from typing import Literal

from palpate.experiment import storage
from palpate.experiment.dataset import checks, tables
from palpate.experiment.dataset.build import LABELS
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.errors import DatasetError, Finding, ProtocolError, Remedy
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Purpose
from palpate.experiment.records.progress import Progress, progress
from palpate.experiment.study import amendment, enrolment, privacy
from palpate.experiment.study.lines import Incident
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster

COLUMNS = 80
"""Width of the screen, characters."""

SHOWN = 5
"""The most lines of one kind on the screen; the document for programs has them all."""

SOON = timedelta(days=30)
"""A seal that ends within this time is told."""

LEAST_FREE = 10**9
"""Less room than this on the dataset's disk is told, bytes: some seven of the longest sessions."""

GOES_ON: Mapping[Purpose, str] = {
    "REHEARSAL": "the same palpate rehearse",
    "PRACTICE": "the same palpate run --practice",
}
"""What goes on with a session of a simulation; with any other `palpate run` does."""

State = Literal["to begin", "under way", "done", "withdrawn", "doubted"]


@dataclass(frozen=True)
class Person:
    """One participant's tasks in order, concealed until one has begun, and progress; `doubted` for a bad journal.

    `group` is empty in a study without groups.
    """

    participant: str
    order: tuple[str, ...]
    state: State
    begun: tuple[Progress, ...]
    group: str = ""

    @property
    def task(self) -> Progress | None:
        """The session that has begun and is not complete, if there is one."""
        return next((one for one in self.begun if not one.complete), None)

    @property
    def position(self) -> int:
        """The place of the task that comes next, from 1."""
        return len(self.begun) + (self.task is None)

    @property
    def place(self) -> str:
        """That place in words."""
        return f"task {self.position} of {len(self.order)}"

    @property
    def standing(self) -> str:
        """Where somebody under way stands, in a sentence."""
        if self.task is None:
            return f"{self.participant} is between tasks; {self.place} is next."
        footer, left, of = self.task.footer, len(self.task.remaining), self.task.trials
        how = {"paused": "is paused", "error": "ended with an error"}.get(footer.reason if footer else "", "is open")
        where, trained = f"{self.participant}, {self.task.header.task} ({self.place})", self.task.training_words
        return f"{where}, {how}: {left} of {of} trials remain." + (f" {trained}." if trained else "")

    def as_dict(self) -> dict[str, object]:
        """Return a session under way for programs."""
        task = self.task
        return {
            "participant": self.participant,
            "position": self.position,
            "of": len(self.order),
            "task": task and task.header.task,
            "ended": task and task.footer and task.footer.reason,
            "remaining": task and len(task.remaining),
            "trials": task and task.trials,
            "trained": task and len(task.trained),
            "training": task and task.training and task.training.model_dump(exclude={"kind"}),
        }


@dataclass(frozen=True)
class Status:
    """A study's progress on the `day` of which its seal was checked.

    `people` are those enrolled, in a rehearsal all. `seal` is the approval. `excluded` gives a reason for each finished
    participant whom the rules exclude; None if unknown. `doubts` question the evidence, `reminders` need action.
    `to_enrol` is the next label. `revealed` gives the days of `palpate schedule --reveal`, `keep_until` the last day on
    which the data of each may be kept, where the protocol limits it. `incidents` are adverse events and deviations.
    `retired` has labels that people gave up, which are not in `people`, and for which of theirs each one's sessions
    count.
    """

    root: Path
    day: date
    study: str
    title: str
    purpose: Purpose
    seal: str
    planned: int
    people: tuple[Person, ...]
    erased: frozenset[str]
    revealed: Mapping[str, date]
    to_enrol: str | None
    doubts: tuple[Finding, ...]
    reminders: tuple[Finding, ...]
    excluded: Mapping[str, str] | None = field(default_factory=dict)
    keep_until: Mapping[str, date] = field(default_factory=dict)
    incidents: tuple[Incident, ...] = ()
    retired: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def heading(self) -> str:
        """What the dataset is, where it is no study, and which study it is of."""
        label = LABELS[self.purpose]
        return f"{label}: {self.study}" if label else self.study

    @property
    def enrolment(self) -> Finding | None:
        """That somebody is to be enrolled next, and the command for it."""
        if self.to_enrol is None:
            return None
        given = ("--participant", self.to_enrol, "--dataset", str(self.root))
        command = ("palpate", "enrol", str(storage.protocol_path(self.root)), *given)
        return Finding(f"{self.to_enrol} is next to enroll", remedy=Remedy("run {}", command), verdict="warns")

    def those(self, state: State) -> list[Person]:
        """Return the participants in a state, in the order of enrolment."""
        return [one for one in self.people if one.state == state]

    def orders(self) -> dict[tuple[str, ...], Counter[str]]:
        """Return how many participants began each order of tasks, and how many of them are in each state."""
        found: dict[tuple[str, ...], Counter[str]] = {}
        for one in self.people:
            if one.begun:
                left_out = one.participant in (self.excluded or {})
                found.setdefault(one.order, Counter()).update(["begun", one.state, *["excluded"] * left_out])
        return dict(sorted(found.items()))

    def groups(self) -> dict[str, Counter[State]]:
        """Return how many participants of each group are in each state; nothing in a study without groups."""
        found: dict[str, Counter[State]] = {}
        for one in self.people if any(one.group for one in self.people) else ():
            found.setdefault(one.group, Counter()).update([one.state])
        return dict(sorted(found.items()))

    def as_dict(self) -> dict[str, object]:
        """Return the document for programs, as `participants/README.md` tells it."""
        due = next(iter(self.those("to begin")), None)
        return {
            "day": self.day.isoformat(),
            "study": self.study,
            "title": self.title,
            "purpose": self.purpose,
            "seal": self.seal,
            "planned": self.planned,
            "enrolled": len(self.people),
            **{state.replace(" ", "_"): [one.participant for one in self.those(state)] for state in STATES},
            "erased": sorted(self.erased),
            "retired": dict(self.retired),
            "revealed": {who: day.isoformat() for who, day in self.revealed.items()},
            "excluded": self.excluded,
            "keep_until": {who: day.isoformat() for who, day in self.keep_until.items()},
            "sessions": [one.as_dict() for one in self.those("under way")],
            "due": due and due.participant,
            "to_enrol": self.to_enrol,
            "orders": [
                {"tasks": order, **{column.replace(" ", "_"): counts[column] for column in TABLE}}
                for order, counts in self.orders().items()
            ],
            **({"groups": groups} if (groups := self.groups()) else {}),
            "incidents": [one.model_dump(mode="json") for one in self.incidents],
            "doubts": [one.sentence(self.root) for one in self.doubts],
            "reminders": [one.sentence(self.root) for one in self.reminders],
        }

    def text(self) -> str:
        """Return the screen."""
        counts = Counter(one.state for one in self.people)
        gone = len(self.erased.difference(self.retired))
        erased = f" ({gone} erased)" if gone else ""
        left_out = "not known" if self.excluded is None else f"{len(self.excluded)}"
        told = ", ".join(
            f"{counts[state]} {state}" + erased * (state == "withdrawn")
            for state in STATES
            if counts[state] or state != "doubted"
        )
        due, under_way = self.those("to begin"), self.those("under way")
        come = [f"{due[0].participant}, {due[0].place}; the order of their tasks is concealed."] if due else []
        come += [f"{self.enrolment.what}."] if self.enrolment else []
        return "\n".join(
            [
                shorten(f"{self.heading}: {self.title}", COLUMNS, placeholder=" ..."),
                *wrap(self.seal, COLUMNS),
                *wrap(f"{self.planned} participants planned, {len(self.people)} enrolled: {told}.", COLUMNS),
                *wrap(f"Complete but excluded by the protocol's rules: {left_out}.", COLUMNS),
                "",
                *self._table(),
                *_listed("Groups:", [f"{name}: {_states(counts)}" for name, counts in self.groups().items()]),
                *_listed("Labels given up:", [f"{old}, now {' and '.join(new)}." for old, new in self.retired.items()]),
                *_listed("Revealed before a session:", [f"{who}, on {day}." for who, day in self.revealed.items()]),
                *_listed("Under way:", [one.standing for one in under_way]),
                *_listed("Next:", come),
                *_listed("Adverse events and deviations:", [one.sentence for one in reversed(self.incidents)]),
                *_listed("PROBLEMS IN THE DATA (run palpate verify for details):", self.doubts, self.root),
                *_listed("To do:", self.reminders, self.root),
            ]
        )

    def _table(self) -> Iterator[str]:
        found = self.orders()
        yield f"{'order of tasks':34}" + "".join(f"{column:>{len(column) + 2}}" for column in TABLE)
        rows = [(shorten(", ".join(order), 34, placeholder=" ..."), counts) for order, counts in found.items()]
        if len(rows) > SHOWN:
            rest = sum((counts for _, counts in rows[SHOWN:]), Counter[str]())
            rows[SHOWN:] = [(f"{len(rows) - SHOWN} other orders", rest)]
        if gone := sum(not one.begun for one in self.those("withdrawn")):
            rows.append(("no session (erased or never begun)", Counter(withdrawn=gone)))
        for order, counts in [*rows, ("all", sum((counts for _, counts in rows), Counter[str]()))]:
            yield f"{order:34}" + "".join(f"{counts[column]:>{len(column) + 2}}" for column in TABLE)

    def flow(self) -> tuple[str, tuple[tuple[str, tuple[str, ...]], ...]]:
        """Return the texts of a flow figure: what stands beside it, and its stages with their boxes from the top."""
        found = self.orders()
        if len(found) > MOST_ARMS:
            found = {(f"{len(found)} orders of tasks",): sum(found.values(), Counter[str]())}
        aside = Counter(one.state for one in self.people if not one.begun)
        beside = [f"Not in any order below: n = {aside.total()}", f"to begin: {aside['to begin']}"]
        gone = [one.participant for one in self.those("withdrawn") if not one.begun]
        erased = len(self.erased.intersection(gone))
        beside += [f"withdrew before beginning: {len(gone) - erased}", f"withdrew, data erased: {erased}"]
        beside += [f"doubted: {aside['doubted']}"] if aside["doubted"] else []
        known = self.excluded is not None
        arms = [(fill(", then ".join(order), 26), counts) for order, counts in found.items()]
        ends = [
            [f"completed: {n['done']}", f"under way: {n['under way']}", f"withdrew: {n['withdrawn']}"]
            + ([f"doubted: {n['doubted']}"] if n["doubted"] else [])
            + [f"excluded by a rule: {n['excluded'] if known else 'not known'}"]
            for _, n in arms
        ]
        left = sum(n["done"] - n["excluded"] for _, n in arms)
        analysed = f"Available for analysis: {'' if known else 'at most '}n = {left}"
        enrolled = f"Enrolled: n = {len(self.people)}\n(planned: {self.planned})"
        stages = (
            ("Enrolment", (enrolled,)),
            ("Allocation", tuple(f"{order}\nbegan: n = {n['begun']}" for order, n in arms)),
            ("Sessions", tuple("\n".join(lines) for lines in ends)),
            ("Analysis", (analysed,)),
        )
        return "\n".join(beside), tuple((name, boxes) for name, boxes in stages if boxes)


STATES: tuple[State, ...] = ("done", "under way", "to begin", "withdrawn", "doubted")
TABLE = ("begun", "under way", "withdrawn", "done", "excluded")
"""The columns of the table."""

MOST_ARMS = 4
"""As many orders stand beside one another on a page."""


def status(given: Path, today: date) -> Status:
    """Return the progress in this dataset folder, or in a protocol file's.

    Raises as `checks.load`, and `DatasetError` where the folder holds no study.
    """
    protocol_file = given if given.is_file() else None
    root = enrolment.default_root(files.load(given)) if protocol_file else given
    storage.refuse_other_format(root)
    if not checks.has_journals(root):
        described = (root / "dataset_description.json").exists()
        alone = tables.ALONE.get(tables.origin_of(root)) if described else None
        remedy = Remedy("enroll a participant first", ("palpate", "enrol", "PROTOCOL"))
        if alone:
            words = f"it contains {alone}; to make tables and a report: {{}}"
            remedy = Remedy(words, ("palpate", "analyse", str(root)))
        raise DatasetError(root, "does not contain a study", remedy, allowed="the dataset of a study")
    dataset = checks.load(root)
    found = tuple(checks.findings(dataset))
    doubts = tuple(one for one in found if one.refuses)
    warned = [one for one in found if not one.refuses]
    known, protocol = dataset.roster, dataset.protocol
    sound = {path for path, _ in dataset.sessions}
    people: list[Person] = []
    retired = _retired(known) if known is not None else {}
    for participant in dataset.tasks if known is None else [one for one in known.consent_on if one not in retired]:
        order = dataset.tasks.get(participant, ())
        own = [*dataset.people.journals_of(root, participant, order).values()]
        begun = tuple(progress(journal.read(path).entries) for path in own if path in sound)
        state: State = "to begin"
        if known is not None and participant in known.withdrawn:
            state = "withdrawn"
        elif any(storage.size(one) for path in own if path not in sound for one in (path, chain.head_path(path))):
            state = "doubted"
        elif begun:
            state = "done" if len([one for one in begun if one.complete]) == len(order) else "under way"
        people.append(Person(participant, order, state, begun, dataset.groups.get(participant, "")))
    sealed, wanted = "A simulation needs no approval.", list[Finding]()
    if known is not None:
        sealed, wanted = _seal(root, protocol_file, dataset, people, today)
    keep_until = _keep_until(dataset, people)
    left = [label for label in dataset.tasks if known is not None and label not in known.consent_on]
    if known is not None and not left and not doubts and enrolling.free_place(root, protocol, known):
        left = [known.next_label()]
    return Status(
        root=root,
        day=today,
        study=protocol.study.id,
        title=protocol.study.title,
        purpose=dataset.purpose,
        seal=sealed,
        planned=len(dataset.tasks) - len(known.takes if known else ()),
        people=tuple(people),
        erased=frozenset(known.erased if known else ()),
        revealed=dict(known.revealed if known else {}),
        to_enrol=left[0] if left else None,
        doubts=doubts,
        reminders=(
            *wanted,
            *warned,
            *_reminders(root, dataset, people, today),
            *_due(root, keep_until, today),
        ),
        keep_until=keep_until,
        incidents=tuple(known.incidents if known else ()),
        retired=retired,
    )


def _retired(known: Roster) -> dict[str, tuple[str, ...]]:
    """Return the labels that people gave up, and those enrolled afterwards for which their sessions count."""
    gone, later = set[str](), set[tuple[str, str]]()
    for link in known.lines.links:
        kind, who = link.entry["kind"], str(link.entry.get("participant"))
        if kind == "withdrawn":
            gone.add(who)
        elif kind in ("enrolled", "replacing"):
            later.update((label, who) for label in gone)
    moved = sorted({(label, who) for (label, _), who in known.took_part.items()} & later)
    return {label: tuple(who for _, who in own) for label, own in groupby(moved, lambda one: one[0])}


def _seal(
    root: Path, protocol_file: Path | None, dataset: Dataset, people: Sequence[Person], today: date
) -> tuple[str, list[Finding]]:
    """Return the approval in a sentence, and what to do about it, by the seal that `palpate run` would check."""
    known = dataset.approvals
    if known is not None and (stop := known.stop(today)) is not None:
        return f"{stop.kind.upper()} since {stop.from_on}. No sessions are allowed. Reason: {stop.reason}.", []
    latest = known.covering(today, visit=None) if known else None
    file = protocol_file or storage.protocol_path(root, latest.number if latest else 1)
    if protocol_file is None and not approval.seal_path(file).exists():
        return "No session has begun, so this folder has no seal yet; the seal next to the protocol file applies.", []
    version = files.load(file)
    told, _ = sealing.state(file, version, today)
    wanted = []
    if protocol_file and approval.sha256(version) not in _in_force(dataset, people, today):
        what = f"{file} differs from the dataset's version of the protocol, so it cannot be used for sessions"
        words = "if the board approved it for this study, seal it, then run {}"
        amend = ("palpate", "amend", str(file), "--dataset", str(root))
        wanted.append(Finding(what, remedy=Remedy(words, amend, suffices=False)))
    try:
        seal = approval.verify(file, version, today)
    except ProtocolError:
        words, replaces = "Have the protocol approved and sealed: {}", approval.seal_path(file).exists()
        if known is not None:
            words = "Renew the approval, seal the protocol again ({}), then run palpate amend"
        seal_it = approval.seal_again(protocol_file or Path("PROTOCOL"), words, *(["--replace"] if replaces else []))
        return told, [*wanted, Finding("", remedy=seal_it)]
    if seal.expires_on - today <= SOON:
        what = f"The approval ends on {seal.expires_on}; renew it, seal the protocol again, then run palpate amend."
        wanted.append(Finding(what))
    return f"Sealed until {seal.expires_on}, approval number {seal.approval_number}.", wanted


def _in_force(dataset: Dataset, people: Sequence[Person], today: date) -> set[str]:
    """Return the hashes of the versions that somebody is run under now, or may be later."""
    known = dataset.approvals
    if known is None or dataset.roster is None:
        return {approval.sha256(dataset.protocol)}
    on = dataset.roster.known_day(today)
    found = [known.approved[known.version_on(on) - 1], *(one for one in known.approved if one.from_on > on)]
    for one in people:
        if one.state not in ("done", "withdrawn"):
            visit = max((known.number_of(session.header.seal_sha256) for session in one.begun), default=None)
            session = known.number_of(one.task.header.seal_sha256) if one.task else None
            found += [covering] if (covering := known.covering(on, visit=visit, session=session)) else []
    return {one.protocol_sha256 for one in found}


def _reconsent(root: Path, dataset: Dataset, today: date) -> Iterator[Finding]:
    """Tell who has to consent to an amendment before their next session."""
    if dataset.roster is None or dataset.approvals is None:
        return
    on = dataset.roster.known_day(today)
    if left := amendment.to_reconsent(root, dataset.approvals, dataset.roster, on):
        file = storage.protocol_path(root, dataset.approvals.version_on(on))
        given = ("--participant", left[0], "--consent-on", "DAY", "--dataset", str(root))
        remedy = Remedy("{}", ("palpate", "consent", str(file), *given), suffices=len(left) == 1)
        yield Finding(f"Before the next session, record consent to the amendment by {_people(left)}", remedy=remedy)


def _reminders(root: Path, dataset: Dataset, people: list[Person], today: date) -> Iterator[Finding]:
    asked = dataset.roster.consent_on if dataset.roster and dataset.protocol.consent.required else {}
    on = today if dataset.roster is None else dataset.roster.known_day(today)
    if on > today:
        what = f"This computer's clock shows {today}, but the last line of the roster is dated {on}"
        yield Finding(what, remedy="correct the clock before the next session")
    for one in people:
        if one.state == "to begin" and asked.get(one.participant, date.min) is None:
            words = f"Record consent for participant {one.participant} before the session: {{}}"
            given = ("--participant", one.participant, "--consent-on", "DAY", "--dataset", str(root))
            version = 1 if dataset.approvals is None else dataset.approvals.version_on(on)
            command = ("palpate", "consent", str(storage.protocol_path(root, version)), *given)
            yield Finding("", remedy=Remedy(words, command))
        if one.task is not None and one.task.footer is None and one.state == "under way":
            again = GOES_ON.get(dataset.purpose, "palpate run")
            yield Finding(
                f"Participant {one.participant}: the session of task {one.task.header.task} has no recorded end. "
                f"Unless it is running now, it was interrupted; {again} continues it."
            )
    for stop in () if dataset.approvals is None else dataset.approvals.stops:
        if stop.from_on > on:
            yield Finding(f"As of {stop.from_on}, the study is {stop.kind}: {stop.reason}.")
    yield from _reconsent(root, dataset, today)
    yield from _unasked(root, dataset, people)
    if warning := privacy.readers_warning(root):
        yield Finding(warning)
    if (free := shutil.disk_usage(root).free) < LEAST_FREE:
        full = f"The dataset's disk is nearly full ({free / 1e6:,.0f} MB free); free space before the next session."
        yield Finding(full)


def _unasked(root: Path, dataset: Dataset, people: list[Person]) -> Iterator[Finding]:
    """Tell of whom nothing is on record that the protocol asks of people."""
    if dataset.roster is None or not getattr(getattr(dataset.protocol, "asked", None), "people", ()):
        return
    answered, latest = dataset.roster.facts, dataset.roster.approved
    if left := [one.participant for one in people if one.state != "withdrawn" and one.participant not in answered]:
        path = storage.protocol_path(root, latest[-1].number if latest else 1)
        ask = ("palpate", "facts", str(path), "--participant", left[0], "--dataset", str(root))
        what = f"The protocol's questions about participants have not been answered for {_people(left)}"
        yield Finding(what, remedy=Remedy("ask one participant at a time: {}", ask, suffices=False))


def _keep_until(dataset: Dataset, people: list[Person]) -> dict[str, date]:
    """Return the last day on which the data of each participant may be kept; of a simulation none has to go."""
    months = dataset.protocol.consent.kept_months
    if dataset.roster is None or months is None:
        return {}
    last = {
        one.participant: max(date.fromisoformat(session.header.started_utc[:10]) for session in one.begun)
        for one in people
        if one.begun
    }
    return {who: months_after(day, months) for who, day in last.items()}


def months_after(day: date, months: int) -> date:
    """Return the same day of a later month, or that month's last day; at most the last day that there is."""
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    if year > date.max.year:
        return date.max
    return date(year, month + 1, min(day.day, monthrange(year, month + 1)[1]))


def _due(root: Path, keep_until: Mapping[str, date], today: date) -> Iterator[Finding]:
    """Tell whose data may be kept no longer, or not for long."""
    over = {who: day for who, day in keep_until.items() if day < today}
    soon = {who: day for who, day in keep_until.items() if today <= day <= today + SOON}
    given = ("--participant", "LABEL", "--reason", "REASON", "--erase", "--dataset", str(root))
    erase = ("palpate", "withdraw", str(storage.protocol_path(root)), *given)
    if over:
        what = f"OVERDUE: the protocol allowed data of {_people(over)} to be kept only until {min(over.values())}"
        by_hand = (
            "or delete the whole dataset by hand once none of it may be kept, including backups, copies and exports"
        )
        yield Finding(what, remedy=Remedy(f"erase them ({{}} for each), {by_hand}", erase, suffices=False))
    if soon:
        what = f"The protocol allows data of {_people(soon)} to be kept until {min(soon.values())}"
        words = "erase them after that day ({} for each), or delete the dataset by hand"
        yield Finding(what, remedy=Remedy(words, erase, suffices=False))


def _states(counts: Counter[State]) -> str:
    """Return a group in words: how many enrolled, and how many of them are in each state that somebody is in."""
    told = ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])
    return f"{counts.total()} enrolled, {told}."


def _people(labels: Collection[str]) -> str:
    """Return whom a sentence is about: a few by their labels, more by their number."""
    if len(labels) > SHOWN:
        return f"{len(labels)} participants"
    return f"{'participant' if len(labels) == 1 else 'participants'} {', '.join(labels)}"


def _listed(heading: str, sentences: Sequence[str | Finding], root: Path = Path()) -> Iterator[str]:
    """Give a list of sentences under a heading; nothing without any."""
    if not sentences:
        return
    yield from ("", heading)
    for one in sentences[:SHOWN]:
        yield from (one if isinstance(one, Finding) else Finding(one)).lines(COLUMNS, ("  ", "    "), root)
    if len(sentences) > SHOWN:
        yield f"  ... and {len(sentences) - SHOWN} more (--json lists all)."
