"""Participants: which tasks each does in which order, who has consented, who has withdrawn.

Participants are labels and nothing else: '01', '02', ... in the order of their enrolment. A task with fewer
participants than the study is done by those who enrol first, so whoever comes later does less, and a study that ends
early is as far as it can be in each task. Who does several tasks is allocated to their orders by permuted blocks: a
block holds every order once, shuffled, so the orders balance after every block.

The first enrolment begins the study's dataset, with one protocol and one seed.
"""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import date
from itertools import permutations
from pathlib import Path
from typing import Annotated, Literal

from filelock import FileLock
from pydantic import Field, TypeAdapter, ValidationError

from experiment import storage
from experiment.errors import DatasetError, RosterError
from experiment.protocol import approval, files
from experiment.protocol.models import Protocol
from experiment.records import journal
from experiment.records.entries import Entry
from experiment.settings.characters import quoted
from experiment.settings.load import Line
from experiment.study.schedule import Draws

LOCK = ".study.lock"

SEED = "seed.json"
"""The file beside the journals with the one seed that names every draw of a study."""


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


class Consented(Entry):
    """A participant who had enrolled without it gave consent."""

    kind: Literal["consented"] = "consented"
    participant: str
    consent_on: date


class Withdrawn(Entry):
    """A participant withdrew, or was withdrawn. `reason` names no person and no state of health."""

    kind: Literal["withdrawn"] = "withdrawn"
    participant: str
    reason: Annotated[Line, Field(max_length=200)]


AnyEntry = Annotated[Enrolled | Consented | Withdrawn, Field(discriminator="kind")]
_ENTRY: TypeAdapter[AnyEntry] = TypeAdapter(AnyEntry)


@dataclass
class Roster:
    """The roster file of a study: one JSON line for each event, only ever appended to.

    `consent_on` holds each participant's day of consent, or None without consent, in the order of enrolment;
    `withdrawn` holds the reasons of those who withdrew.
    """

    path: Path
    consent_on: dict[str, date | None] = field(default_factory=dict)
    withdrawn: dict[str, str] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Roster:
        """Read a roster; one without a file has nobody enrolled.

        Raises `RosterError` if the file cannot be read, or if a line of it cannot be trusted.
        """
        roster = cls(path)
        roster._read()
        return roster

    def enrol(self, participant: str, consent_on: date | None) -> None:
        """Give the next place to a participant, on disk when this returns; `consent_on` is None without consent.

        Participants enrol in the order of their labels, which keeps tasks balanced. Raises `RosterError` if the label
        is taken, or is not the next one.
        """
        self._append(Enrolled(participant=participant, consent_on=consent_on))

    def consent(self, participant: str, consent_on: date) -> None:
        """Record the consent of a participant who enrolled without it.

        Raises `RosterError` if the participant is not enrolled, has consented already, or has withdrawn.
        """
        self._append(Consented(participant=participant, consent_on=consent_on))

    def withdraw(self, participant: str, reason: str) -> None:
        """Record that a participant withdrew; the reason is one line that names no person and no state of health.

        Raises `RosterError` if the participant is not enrolled or has withdrawn already, or if the reason is no such
        line.
        """
        try:
            entry = Withdrawn(participant=participant, reason=reason)
        except ValidationError as error:
            raise RosterError(
                f"got the reason {quoted(reason)}; allowed: one line of 1 to 200 characters, none of them a control "
                "or invisible one; mend it"
            ) from error
        self._append(entry)

    def may_run(self, participant: str, protocol: Protocol) -> None:
        """Return when `participant` may be run in the study of `protocol`.

        Raises `RosterError` that says why not: not of this study, not enrolled, without consent, or withdrawn.
        """
        if participant not in labels(protocol):
            raise _stranger(participant, labels(protocol))
        if participant not in self.consent_on:
            raise RosterError(f"participant {participant} is not enrolled in {self.path}; enrol them first")
        if participant in self.withdrawn:
            raise RosterError(
                f"participant {participant} withdrew ({self.withdrawn[participant]}) and is not run again; "
                "enrol another participant"
            )
        if protocol.consent.required and self.consent_on[participant] is None:
            raise RosterError(f"participant {participant} has not consented; record their consent before the session")

    def _read(self) -> int:
        """Replay the file; return the size of its whole lines."""
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return 0
        except OSError as error:
            raise RosterError(f"{self.path}: cannot read the roster ({error.strerror}); make it readable") from error
        # What stands after the last newline is a write that never finished, so nothing that was confirmed.
        size = data.rfind(b"\n") + 1
        for number, line in enumerate(data[:size].splitlines(), start=1):
            try:
                self._apply(_ENTRY.validate_json(line))
            except (ValidationError, RosterError) as error:
                why = "this is no roster entry" if isinstance(error, ValidationError) else str(error)
                raise RosterError(
                    f"{self.path}: line {number}: {why}; restore the roster from a backup (nothing was changed)"
                ) from error
        return size

    def _append(self, entry: AnyEntry) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with FileLock(self.path.with_name(f".{self.path.name}.lock")):
                latest = Roster(self.path)
                size = latest._read()
                latest._apply(entry)
                with self.path.open("ab") as file:
                    file.truncate(size)
                    file.write(json.dumps(entry.model_dump(mode="json"), ensure_ascii=False).encode() + b"\n")
                    file.flush()
                    os.fsync(file.fileno())
        except OSError as error:
            raise RosterError(f"{self.path}: cannot write the roster ({error.strerror}); mend that first") from error
        self.consent_on, self.withdrawn = latest.consent_on, latest.withdrawn

    def _apply(self, entry: AnyEntry) -> None:
        participant = entry.participant
        if isinstance(entry, Enrolled):
            self.check_next(participant)
            self.consent_on[participant] = entry.consent_on
            return
        self.check_enrolled(participant)
        if participant in self.withdrawn:
            raise RosterError(f"participant {participant} has withdrawn already; enrol another participant")
        if isinstance(entry, Consented):
            if self.consent_on[participant] is not None:
                raise RosterError(f"participant {participant} consented on {self.consent_on[participant]} already")
            self.consent_on[participant] = entry.consent_on
        else:
            self.withdrawn[participant] = entry.reason

    def check_enrolled(self, participant: str) -> None:
        """Return when `participant` is enrolled. Raises `RosterError` otherwise."""
        if participant not in self.consent_on:
            raise RosterError(f"participant '{participant}' is not enrolled; enrol them first")

    def check_next(self, participant: str) -> None:
        """Return when `participant` is the next label. Raises `RosterError` otherwise."""
        if participant in self.consent_on:
            raise RosterError(f"participant {participant} is enrolled already; the next label is {self._next(2)}")
        if not re.fullmatch(r"[0-9]{2,}", participant) or participant != self._next(len(participant)):
            raise RosterError(f"got the label '{participant}'; allowed: {self._next(2)}, the next one in order")

    def _next(self, width: int) -> str:
        """Return the next label; as wide as those enrolled, or as `width` while nobody is."""
        width = len(next(iter(self.consent_on), "0" * width))
        return f"{len(self.consent_on) + 1:0{width}d}"


def default_root(protocol: Protocol) -> Path:
    """Return where the dataset of a study stands unless another folder is named."""
    return Path("participants") / protocol.study.id


def enrol(
    protocol_file: Path, participant: str, consent_on: date | None, *, root: Path | None, seed: int | None
) -> Path:
    """Enrol the next participant, and return the roster's file; the first one begins the dataset and settles its seed.

    `root` None stands for `participants/STUDY`, and `seed` None for the settled seed or a new one. Raises `RosterError`
    if the label is not the next one or the study does not have it, and `DatasetError` if the folder belongs to
    something else.
    """
    protocol = files.load(protocol_file)
    root = root or default_root(protocol)
    find(allocate(protocol, 0), participant)
    path = storage.roster_path(root)
    Roster.load(path).check_next(participant)
    settle(root, protocol_file, protocol, seed)
    Roster.load(path).enrol(participant, consent_on)
    return path


def seed_of(root: Path) -> int:
    """Return the seed that names every draw of the study with this dataset.

    Raises `DatasetError` if the study has none, or if its file is broken.
    """
    file = root / "sourcedata" / SEED
    try:
        return int(json.loads(file.read_text("utf-8"))["seed"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(
            f"{file}: the seed cannot be read; restore it from a backup, or from a journal's header"
        ) from error


def consent(protocol_file: Path, participant: str, consent_on: date, *, root: Path | None) -> Path:
    """Record the consent of a participant who enrolled without it, and return the roster's file.

    Raises `RosterError` if the participant is not enrolled, has consented already, or has withdrawn.
    """
    path = storage.roster_path(root or default_root(files.load(protocol_file)))
    Roster.load(path).consent(participant, consent_on)
    return path


def withdraw(
    protocol_file: Path, participant: str, reason: str, *, root: Path | None, rebuild: Callable[[Path], None]
) -> Path:
    """Record that a participant withdrew, and return the roster's file; analysis leaves them out.

    `rebuild` makes the tables of the dataset in a folder anew. Raises `RosterError` if the participant is not enrolled
    or the reason is no line of text, and `SessionLocked` if a session of theirs is running.
    """
    root = root or default_root(files.load(protocol_file))
    path = storage.roster_path(root)
    known = Roster.load(path)
    known.check_enrolled(participant)
    with journal.locked(storage.participant_folder(root, participant), participant):
        known.withdraw(participant, reason)
        if storage.journals(root):
            rebuild(root)
    return path


def settle(root: Path, protocol_file: Path, protocol: Protocol, seed: int | None) -> int:
    """Keep protocol and seed beside the journals at the first call, and hold every later one to them.

    The protocol's copy is written last: without it the study has not begun.
    """
    source = root / "sourcedata"
    kept, file = source / "protocol.toml", source / SEED
    begun = {"sourcedata", f"sourcedata/{SEED}", f"sourcedata/{LOCK}"}
    if not kept.exists() and root.exists() and {p.relative_to(root).as_posix() for p in root.rglob("*")} - begun:
        raise DatasetError(f"{root}: this folder holds something else; choose another folder with --dataset")
    if (source / "rehearsal.json").exists():
        raise DatasetError(f"{root}: this is the dataset of a rehearsal; choose another folder with --dataset")
    source.mkdir(parents=True, exist_ok=True)
    with FileLock(source / LOCK):
        if not kept.exists():
            drawn = secrets.randbelow(2**31) if seed is None else seed
            storage.write_json(file, {"seed": drawn})
            storage.write_bytes(kept, protocol_file.read_bytes())
        elif approval.sha256(files.load(kept)) != approval.sha256(protocol):
            raise DatasetError(
                f"{root}: the study was begun with another version of the protocol; run {kept}, or choose another "
                "folder with --dataset"
            )
    settled = seed_of(root)
    if seed not in (None, settled):
        raise DatasetError(f"{root}: the study has the seed {settled}, not {seed}; leave out --seed")
    return settled
