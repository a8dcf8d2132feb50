"""Participants: which tasks each does in which order, who has consented, who has withdrawn.

Participants are labels and nothing else: '01', '02', ... in the order of their enrolment. A task with fewer
participants than the study is done by those who enrol first, so whoever comes later does less, and a study that ends
early is as far as it can be in each task. Who does several tasks is allocated to their orders by permuted blocks: a
block holds every order once, shuffled, so the orders balance after every block. Once all planned labels are enrolled,
each further one takes the place of somebody who withdrew before completing, and does the same tasks in the same order.

The first enrolment begins the study's dataset, with one protocol and one seed.
"""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from datetime import date
from itertools import permutations
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from filelock import FileLock
from pydantic import Field, TypeAdapter, ValidationError

from experiment import storage
from experiment.clock import MonotonicClock, day, wall_ns
from experiment.errors import DatasetError, RosterError
from experiment.protocol import approval, files
from experiment.protocol.models import Protocol
from experiment.records import chain, journal
from experiment.records.chain import Chain
from experiment.records.entries import Entry, Purpose, Record, Withdrawal
from experiment.records.progress import progress
from experiment.settings.characters import quoted
from experiment.settings.load import VISIBLE, Line
from experiment.study.schedule import Draws

LOCK = ".study.lock"


@dataclass(frozen=True)
class Allocation:
    """What one participant does: their label, and the ids of their tasks in the order in which they do them."""

    participant: str
    tasks: tuple[str, ...]


def labels(protocol: Protocol) -> tuple[str, ...]:
    """Return the labels of a study's participants, all equally wide, with at least two digits."""
    count = protocol.study.participants
    width = max(2, len(str(count)))
    return tuple(f"{number:0{width}d}" for number in range(1, count + 1))


def allocate(protocol: Protocol, seed: int) -> tuple[Allocation, ...]:
    """Return what every participant of a study does, in the order of enrolment.

    It depends on the arguments alone, on any machine: on the protocol by `approval.names_draws`, and on the seed.
    """
    blocks: dict[tuple[str, ...], Iterator[tuple[str, ...]]] = {}
    allocations = []
    for place, participant in enumerate(labels(protocol)):
        tasks = tuple(task.id for task in protocol.tasks if place < task.participants)
        if protocol.task_order.kind == "counterbalanced":
            if tasks not in blocks:
                blocks[tasks] = _permuted_blocks(tasks, approval.names_draws(protocol), seed)
            tasks = next(blocks[tasks])
        allocations.append(Allocation(participant, tasks))
    return tuple(allocations)


def allocated(protocol: Protocol, seed: int, roster: Roster) -> tuple[Allocation, ...]:
    """Return what `allocate` returns, and what those do who took the places of others, as the roster says."""
    tasks = {one.participant: one.tasks for one in allocate(protocol, seed)}
    for participant, place in roster.takes.items():
        if place in tasks:
            tasks.setdefault(participant, tasks[place])
    return tuple(Allocation(participant, its) for participant, its in tasks.items())


def free_place(root: Path, protocol: Protocol, roster: Roster) -> str | None:
    """Return who withdrew first, by label, before completing, with a place that nobody took; None if nobody did."""
    for one in allocated(protocol, 0, roster):
        if one.participant in roster.withdrawn and one.participant not in roster.takes.values():
            paths = (storage.journal_path(root, one.participant, task) for task in one.tasks)
            begun = [entries for path in paths if (entries := journal.read_if_begun(path).entries)]
            if sum(progress(entries).complete for entries in begun) < len(one.tasks):
                return one.participant
    return None


def _permuted_blocks(tasks: tuple[str, ...], study: str, seed: int) -> Iterator[tuple[str, ...]]:
    draws = Draws("task orders", study, *tasks, seed)
    while True:
        yield from draws.shuffled(tuple(permutations(tasks)))


def find(allocations: Sequence[Allocation], participant: str) -> Allocation:
    """Return the allocation of one participant. Raises `RosterError` if the study has no such participant."""
    for allocation in allocations:
        if allocation.participant == participant:
            return allocation
    raise _stranger(participant, [allocation.participant for allocation in allocations])


def _stranger(participant: str, known: Sequence[str]) -> RosterError:
    return RosterError(
        f"no participant '{participant}': this study has '{known[0]}' to '{known[-1]}'; give one of these"
    )


class Enrolled(Entry):
    """A participant took up the next place of the study."""

    kind: Literal["enrolled"] = "enrolled"
    participant: str
    consent_on: date | None


class Replacing(Entry):
    """A participant, beyond the planned ones, took up the place of one who withdrew."""

    kind: Literal["replacing"] = "replacing"
    participant: str
    consent_on: date | None
    takes: str


class Consented(Entry):
    """A participant who had enrolled without it gave consent."""

    kind: Literal["consented"] = "consented"
    participant: str
    consent_on: date


Reason = Annotated[Line, Field(max_length=200)]
"""One line that names no person and no state of health."""


class Corrected(Entry):
    """The day of a consent on record was wrong; from now on this one holds."""

    kind: Literal["corrected"] = "corrected"
    participant: str
    consent_on: date
    reason: Reason


class Withdrawn(Entry):
    """A participant withdrew, or was withdrawn."""

    kind: Literal["withdrawn"] = "withdrawn"
    participant: str
    reason: Reason


class Erased(Entry):
    """Journals, raw frames and tables of a participant who had withdrawn are deleted from here on."""

    kind: Literal["erased"] = "erased"
    participant: str


class Revealed(Entry):
    """The concealed order of what a participant does was shown; the label need not be enrolled."""

    kind: Literal["revealed"] = "revealed"
    participant: str
    revealed_on: date


AnyEntry = Annotated[
    Enrolled | Replacing | Consented | Corrected | Withdrawn | Erased | Revealed, Field(discriminator="kind")
]
_ENTRY: TypeAdapter[AnyEntry] = TypeAdapter(AnyEntry)


@dataclass
class Roster:
    """The roster file of a study: one chained line for each event, only ever appended to.

    `consent_on` holds each participant's day of consent, or None without consent, in the order of enrolment;
    `withdrawn` holds the reasons of those who withdrew, `erased` those whose data were deleted, and `revealed` the days
    on which a concealed order was first shown. `takes` names, for each who came after the planned ones, the participant
    whose place they took. `now_ns` tells the time of a new line.
    """

    path: Path
    consent_on: dict[str, date | None] = field(default_factory=dict)
    withdrawn: dict[str, str] = field(default_factory=dict)
    erased: set[str] = field(default_factory=set)
    revealed: dict[str, date] = field(default_factory=dict)
    takes: dict[str, str] = field(default_factory=dict)
    lines: Chain = chain.EMPTY
    now_ns: Callable[[], int] = field(default=wall_ns, repr=False, compare=False)

    @classmethod
    def load(cls, path: Path) -> Roster:
        """Read a roster; one without a file has nobody enrolled.

        Raises `RosterError` if the file cannot be read, or if a line of it cannot be trusted.
        """
        return cls._of(path, chain.read(path, RosterError))

    def as_of(self, sha256: str | None) -> Roster:
        """Return the roster as it was when its last line had this hash. Raises `RosterError` if it has no such line."""
        for number, link in enumerate(self.lines.links, start=1):
            if link.sha256 == sha256:
                return self._of(self.path, Chain(self.lines.links[:number]))
        raise RosterError(
            f"{self.path}: lacks a line that a session began under: it was cut or changed; restore it from a backup"
        )

    @classmethod
    def continued(cls, path: Path) -> Roster:
        """Read a roster as `load` does, and bring its head up to the last line: a kill leaves it one line behind.

        Until then nobody would notice if that line were cut off, and a refused command writes none.
        """
        roster = cls.load(path)
        if roster.lines.links:
            with roster._writing():
                roster = cls.load(path)
                chain.Writer(path, roster.lines.end).close()
        return roster

    def enrol(self, participant: str, consent_on: date | None, takes: str | None = None) -> None:
        """Give the next place to a participant, on disk when this returns; `consent_on` is None without consent.

        Participants enrol in the order of their labels, which keeps tasks balanced. Raises `RosterError` if the label
        is taken, or is not the next one, or if the place that it `takes` is not free.
        """
        if takes is None:
            self._append(Enrolled, participant=participant, consent_on=consent_on)
        else:
            self._append(Replacing, participant=participant, consent_on=consent_on, takes=takes)

    def consent(self, participant: str, consent_on: date) -> None:
        """Record the consent of a participant who enrolled without it.

        Raises `RosterError` if the participant is not enrolled, has consented already, or has withdrawn.
        """
        self._append(Consented, participant=participant, consent_on=consent_on)

    def correct(self, participant: str, consent_on: date, reason: str) -> None:
        """Record another day of consent than the one on record, which stays in the file.

        Raises `RosterError` if there is no consent to correct, or if the reason is no line of text.
        """
        self._append(Corrected, participant=participant, consent_on=consent_on, reason=reason)

    def withdraw(self, participant: str, reason: str) -> None:
        """Record that a participant withdrew; the reason is one line that names no person and no state of health.

        Raises `RosterError` if the participant is not enrolled or has withdrawn already, or if the reason is no such
        line.
        """
        self._append(Withdrawn, participant=participant, reason=reason)

    def erase(self, participant: str) -> None:
        """Record that the data of a participant are deleted. Raises `RosterError` unless the participant withdrew."""
        self._append(Erased, participant=participant)

    def reveal(self, participant: str, today: date) -> None:
        """Record that the concealed order of what a participant does is shown. Raises `RosterError`."""
        self._append(Revealed, participant=participant, revealed_on=today)

    def has_erased(self, file: str) -> bool:
        """Return whether a file of the dataset, by its path inside, was of a participant whose data were deleted."""
        return PurePosixPath(file).parent.name.removeprefix("sub-") in self.erased

    def may_run(self, participant: str, protocol: Protocol, *, approved_on: date, today: date) -> None:
        """Return when `participant` may be run in the study of `protocol`.

        Raises `RosterError` that says why not: not of this study, not enrolled, without a consent between approval and
        today, or withdrawn.
        """
        if participant not in (*labels(protocol), *self.takes):
            raise _stranger(participant, labels(protocol))
        if participant not in self.consent_on:
            raise RosterError(f"participant {participant} is not enrolled in {self.path}; enrol them first")
        if participant in self.withdrawn:
            raise RosterError(
                f"participant {participant} withdrew ({self.withdrawn[participant]}) and is not run again; "
                "enrol another participant"
            )
        consent_on = self.consent_on[participant]
        if protocol.consent.required and consent_on is None:
            raise RosterError(f"participant {participant} has not consented; record their consent before the session")
        check_consent(participant, consent_on, approved_on=approved_on, today=today)

    @classmethod
    def _of(cls, path: Path, lines: Chain) -> Roster:
        """Replay the lines of a roster's file."""
        roster = cls(path, lines=lines)
        for number, link in enumerate(lines.links, start=1):
            try:
                roster._apply(_ENTRY.validate_json(json.dumps(link.entry)))
            except (ValidationError, RosterError) as error:
                why = "this is no roster entry" if isinstance(error, ValidationError) else str(error)
                raise RosterError(
                    f"{path}: line {number}: {why}; restore the roster from a backup (nothing was changed)"
                ) from error
        return roster

    def _append(self, kind: type[AnyEntry], **facts: object) -> None:
        try:
            entry = kind.model_validate(facts)
        except ValidationError as error:
            raise RosterError(
                f"got the reason {quoted(str(facts.get('reason')))}; allowed: one line of 1 to 200 characters, "
                f"{VISIBLE}; mend it"
            ) from error
        with self._writing():
            latest = Roster.load(self.path)
            latest._apply(entry)
            with closing(chain.Writer(self.path, latest.lines.end)) as opened:
                opened.append(self.now_ns(), entry.model_dump(mode="json"))
            self.lines = chain.read(self.path, RosterError)
        self.consent_on, self.withdrawn = latest.consent_on, latest.withdrawn
        self.erased, self.revealed, self.takes = latest.erased, latest.revealed, latest.takes

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Keep other writers out. Raises `RosterError` if the roster cannot be written."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with FileLock(self.path.with_name(f".{self.path.name}.lock")):
                yield
        except OSError as error:
            raise RosterError(f"{self.path}: cannot write the roster ({error.strerror}); mend that first") from error

    def _apply(self, entry: AnyEntry) -> None:
        participant = entry.participant
        if isinstance(entry, Enrolled | Replacing):
            self.check_next(participant)
            if isinstance(entry, Replacing):
                if entry.takes not in self.withdrawn or entry.takes in self.takes.values():
                    raise RosterError(f"the place of participant {entry.takes} is not free; enrol {participant} again")
                self.takes[participant] = entry.takes
            self.consent_on[participant] = entry.consent_on
            return
        if isinstance(entry, Revealed):
            self.revealed.setdefault(participant, entry.revealed_on)
            return
        self.check_enrolled(participant)
        if isinstance(entry, Erased):
            if participant not in self.withdrawn:
                raise RosterError(f"participant {participant} has not withdrawn; withdraw them first")
            if participant in self.erased:
                raise RosterError(f"the data of participant {participant} are erased already; nothing is left to do")
            self.erased.add(participant)
            return
        if participant in self.withdrawn:
            on_record = f"the reason on record is '{self.withdrawn[participant]}'; give that one"
            mend = on_record if isinstance(entry, Withdrawn) else "enrol another participant"
            raise RosterError(f"participant {participant} has withdrawn already; {mend}")
        known = self.consent_on[participant]
        if isinstance(entry, Withdrawn):
            self.withdrawn[participant] = entry.reason
            return
        if isinstance(entry, Consented) and known is not None:
            raise RosterError(
                f"participant {participant} consented on {known} already; if that day is wrong, give --correct and "
                "--reason"
            )
        if isinstance(entry, Corrected) and known is None:
            raise RosterError(f"participant {participant} has no consent to correct; record it without --correct")
        self.consent_on[participant] = entry.consent_on

    def check_enrolled(self, participant: str) -> None:
        """Return when `participant` is enrolled. Raises `RosterError` otherwise."""
        if participant not in self.consent_on:
            raise RosterError(f"participant '{participant}' is not enrolled; enrol them first")

    def check_next(self, participant: str) -> None:
        """Return when `participant` is the next label. Raises `RosterError` otherwise."""
        if participant in self.consent_on:
            raise RosterError(f"participant {participant} is enrolled already; the next label is {self.next_label()}")
        if not re.fullmatch(r"[0-9]{2,}", participant) or participant != self.next_label(len(participant)):
            raise RosterError(f"got the label '{participant}'; allowed: {self.next_label()}, the next one in order")

    def next_label(self, width: int = 2) -> str:
        """Return the next label; as wide as those enrolled, or as `width` while nobody is."""
        width = len(next(iter(self.consent_on), "0" * width))
        return f"{len(self.consent_on) + 1:0{width}d}"


def check_consent(participant: str, consent_on: date | None, *, approved_on: date | None, today: date) -> None:
    """Refuse a day of consent in the future or before the study was approved; `approved_on` None for no approval yet.

    Raises `RosterError`.
    """
    mend = "give the right day; one on record is corrected with palpate consent --correct"
    if consent_on is not None and consent_on > today:
        raise RosterError(f"participant {participant}: got consent on {consent_on}; allowed: up to {today}; {mend}")
    if consent_on is not None and approved_on is not None and consent_on < approved_on:
        raise RosterError(
            f"participant {participant}: got consent on {consent_on}; allowed: from {approved_on}, when the study was "
            f"approved; {mend}"
        )


def default_root(protocol: Protocol, *, pilot: bool = False) -> Path:
    """Return where the dataset of a study, or of its pilot, stands unless another folder is named."""
    return Path("participants") / f"{protocol.study.id}{'-pilot' if pilot else ''}"


def enrol(
    protocol_file: Path,
    participant: str,
    consent_on: date | None,
    *,
    root: Path | None,
    seed: int | None,
    pilot: bool = False,
) -> Path:
    """Enrol the next participant, and return the roster's file; the first one begins the dataset and settles its seed.

    Beyond the planned number a participant takes the place of one who withdrew before completing.

    `root` None stands for `participants/STUDY`, and `seed` None for the settled seed or a new one. With `pilot` the
    dataset is begun as one of a pilot, and stands in `participants/STUDY-pilot`. Raises `RosterError` if the label is
    not the next one, the study does not have it, or nobody can have consented on that day; and `DatasetError` if the
    folder belongs to something else.
    """
    protocol = files.load(protocol_file)
    purpose: Purpose | None = "PILOT" if pilot else "STUDY" if root is None else None
    root = root or default_root(protocol, pilot=pilot)
    _refuse_rehearsal(root)
    check_consent(participant, consent_on, approved_on=approved_on(root, protocol_file), today=day(wall_ns()))
    path = storage.roster_path(root)
    known = Roster.continued(path)
    takes = None if participant in labels(protocol) else free_place(root, protocol, known)
    if participant not in labels(protocol) and takes is None:
        raise _stranger(participant, labels(protocol))
    if not path.exists() and any((root / "sourcedata").glob("sub-*")):
        raise DatasetError(f"{root}: has participants and no roster; restore {path} and its head from a backup")
    known.check_next(participant)
    settle(root, protocol_file, protocol, seed, purpose)
    known.enrol(participant, consent_on, takes)
    return path


def seed_of(root: Path) -> int:
    """Return the seed that names every draw of the study with this dataset.

    Raises `DatasetError` if the study has none, or if its file is broken.
    """
    return _settled(root).seed


def purpose_of(root: Path) -> Purpose:
    """Return what the sessions of this dataset are for: STUDY or PILOT. Raises `DatasetError` as `seed_of`."""
    return _settled(root).purpose


class _Settled(Record):
    seed: int
    purpose: Literal["STUDY", "PILOT"]


def _settled(root: Path) -> _Settled:
    file = storage.seed_path(root)
    try:
        return _Settled.model_validate_json(storage.read_bytes(file))
    except (OSError, ValidationError) as error:
        raise DatasetError(
            f"{file}: seed and purpose of the study cannot be read; restore the file from a backup, or write it anew "
            "from a journal's header"
        ) from error


def approved_on(root: Path, protocol_file: Path) -> date | None:
    """Return the day from which participants may consent: that of the seal in the dataset, or else of the protocol's.

    None while the protocol has no seal. Raises `ProtocolError` if a seal is broken.
    """
    for one in (storage.protocol_path(root), protocol_file):
        if approval.seal_path(one).exists():
            return approval.read(one).approved_on
    return None


def consent(
    protocol_file: Path, participant: str, consent_on: date, *, root: Path | None, correction: str | None = None
) -> Path:
    """Record the consent of a participant who enrolled without it, and return the roster's file.

    With `correction`, which says why, the day takes the place of the one on record. Raises `RosterError` if the
    participant is not enrolled or has withdrawn, has consented already, or cannot have consented on that day.
    """
    root = _begun(protocol_file, root)
    check_consent(participant, consent_on, approved_on=approved_on(root, protocol_file), today=day(wall_ns()))
    path = storage.roster_path(root)
    known = Roster.continued(path)
    if correction is None:
        known.consent(participant, consent_on)
    else:
        known.correct(participant, consent_on, correction)
    return path


def withdraw(
    protocol_file: Path,
    participant: str,
    reason: str,
    *,
    root: Path | None,
    rebuild: Callable[[Path], None],
    erase: bool = False,
) -> Path:
    """Record that a participant withdrew, and return the roster's file; analysis leaves them out.

    The roster is told first, then the participant's journals, then the tables; the same call goes on with what a kill
    cut short. With `erase` the roster is told that too, and then all else of the participant is deleted, but for a file
    that says that they withdrew; a reason that is on record stays. `rebuild` makes the tables of the dataset in a
    folder anew. Raises `RosterError` if the participant is not enrolled or has withdrawn for another reason, or the
    reason is no line of text, and `SessionLocked` if a session of theirs is running.
    """
    root = _begun(protocol_file, root)
    path = storage.roster_path(root)
    Roster.load(path).check_enrolled(participant)
    with journal.locked(storage.participant_folder(root, participant), participant):
        known = Roster.continued(path)
        if known.withdrawn.get(participant) != reason and not (erase and participant in known.withdrawn):
            known.withdraw(participant, reason)
        if erase:
            _erase(root, known, participant)
        else:
            _mark(root, participant, reason)
        if erase or storage.journals(root):
            rebuild(root)
    return path


def held(protocol_file: Path, participant: str, *, root: Path | None) -> tuple[int, int]:
    """Return how many sessions of a participant a dataset has, and how many answers, also where journals are damaged.

    Raises `RosterError` if the participant is not enrolled.
    """
    root = _begun(protocol_file, root)
    Roster.load(storage.roster_path(root)).check_enrolled(participant)
    paths = [path for path in storage.left_of(root, participant) if path.suffix == ".jsonl" and storage.size(path)]
    return len(paths), sum(storage.read_bytes(path).count(b'"kind":"answer"') for path in paths)


def _mark(root: Path, participant: str, reason: str) -> None:
    """Leave the withdrawal in the participant's journals, or in a file of its own while they have none."""
    begun = [
        (path, contents)
        for path in storage.journals(root)
        if path.parent == storage.participant_folder(root, participant) and (contents := journal.read(path)).lines
    ]
    for path, contents in begun:
        # Opening it brings up a head that a kill left one line behind.
        with closing(journal.Journal(path, MonotonicClock(), contents)) as opened:
            if not isinstance(contents.entries[-1], Withdrawal):
                torn = contents.torn.decode("utf-8", "backslashreplace")
                opened.append(Withdrawal(reason=reason, torn=torn))
    if not begun:
        _mark_apart(root, participant, reason)


def _mark_apart(root: Path, participant: str, reason: str) -> None:
    storage.write_json(storage.withdrawal_path(root, participant), {"participant": participant, "reason": reason})


def _erase(root: Path, roster: Roster, participant: str) -> None:
    """Delete what the dataset has of a participant; the roster says so before the first file is gone."""
    folder = storage.participant_folder(root, participant)
    if folder.is_symlink():
        raise DatasetError(f"{folder}: is a link; put the folder itself in its place, then do it again")
    _mark_apart(root, participant, roster.withdrawn[participant])
    if participant not in roster.erased:
        roster.erase(participant)
    for path in storage.left_of(root, participant):
        storage.remove(path)
    storage.sync_folder(folder)


def _begun(protocol_file: Path, root: Path | None) -> Path:
    """Return where the dataset of a study stands; `root` as for `enrol`. Raises `RosterError` if it was not begun."""
    root = root or default_root(files.load(protocol_file))
    _refuse_rehearsal(root)
    roster = storage.roster_path(root)
    begun = (storage.protocol_path(root), storage.seed_path(root), roster, chain.head_path(roster))
    if not any(path.exists() for path in begun):
        raise RosterError(f"no dataset of this study stands at {root}; give --dataset")
    return root


def _refuse_rehearsal(root: Path) -> None:
    if storage.plan_path(root).exists():
        raise DatasetError(
            f"{root}: this is the dataset of practice or of a rehearsal, and its participants are simulated: nobody "
            "enrols, consents or withdraws; name the folder of a study with --dataset, or delete this one if it is not "
            "needed"
        )


def settle(
    root: Path, protocol_file: Path, protocol: Protocol, seed: int | None, purpose: Purpose | None = None
) -> int:
    """Keep protocol, seed and purpose beside the journals at the first call, and hold every later one to them.

    The protocol's copy is written last: without it the study has not begun.
    """
    kept, lock = storage.protocol_path(root), root / "sourcedata" / LOCK
    if not kept.exists() and any(_of_something_else(path.relative_to(root)) for path in root.rglob("*")):
        raise DatasetError(f"{root}: this folder holds something else; choose another folder with --dataset")
    lock.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(lock):
        if not kept.exists():
            storage.people_folder(root)
            drawn = secrets.randbelow(2**31) if seed is None else seed
            storage.write_json(storage.seed_path(root), {"seed": drawn, "purpose": purpose or "STUDY"})
            storage.owners_alone(storage.seed_path(root))
            storage.write_bytes(kept, storage.read_bytes(protocol_file))
        elif approval.sha256(files.load(kept)) != approval.sha256(protocol):
            raise DatasetError(
                f"{root}: the study was begun with another version of the protocol; run {kept}, or give the new "
                "version an id of its own, or another folder with --dataset"
            )
    settled = seed_of(root)
    if purpose not in (None, begun_as := purpose_of(root)):
        raise DatasetError(
            f"{root}: this dataset was begun as a {begun_as}, not as a {purpose}; name another folder with "
            "--dataset, and a pilot with --pilot"
        )
    if seed not in (None, settled):
        raise DatasetError(f"{root}: the study has another seed than {seed}; leave out --seed")
    return settled


def _of_something_else(path: Path) -> bool:
    """Return whether a path is none that a refused or killed command leaves before the study begins."""
    begun = {"sourcedata", "sourcedata/seed.json", f"sourcedata/{LOCK}", "sourcedata/.roster.jsonl.lock"}
    temporary = path.parent.as_posix() in (".", "sourcedata") and storage.TEMPORARY.fullmatch(path.name)
    return not temporary and path.as_posix() not in begun
