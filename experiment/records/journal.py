"""The journal of one session: append-only chained JSON lines, each on disk before the session moves on."""

import errno
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Union, get_args

from filelock import Timeout
from pydantic import Field, TypeAdapter, ValidationError, create_model

from palpate.experiment import storage
from palpate.experiment.clock import Clock
from palpate.experiment.errors import JournalError, Remedy, SessionLocked, other_format
from palpate.experiment.records import chain, entries
from palpate.experiment.records.chain import End
from palpate.experiment.records.entries import Entry, Header
from palpate.experiment.records.kinds import entries_of

SHARED: tuple[type[Entry], ...] = (
    Header,
    entries.TrackerOpened,
    entries.MaskerSet,
    entries.Exposure,
    entries.Phase,
    entries.LevelChosen,
    entries.TrackEnded,
    entries.Armed,
    entries.Answer,
    entries.TrainingEnded,
    entries.Spoken,
    entries.Correction,
    entries.Note,
    entries.Commanded,
    entries.Shown,
    entries.Visited,
    entries.Questioned,
    entries.Ignored,
    entries.Redo,
    entries.Triggers,
    entries.Resumed,
    entries.Footer,
    entries.Withdrawal,
)
"""The entries of every journal; the others are those of its kind of trial."""


@cache
def reader(*task_kinds: str) -> TypeAdapter[Entry]:
    """Return what reads the entries of a journal of these kinds of trial. Raises `ValueError` for an unknown kind."""
    own = [entry for name in task_kinds for entry in entries_of(name)]
    entry: Any = Annotated[Union[*SHARED, *own], Field(discriminator="kind")]
    trained: Any = create_model("Trained", __base__=entries.Trained, entry=(entry, ...))
    every: Any = Annotated[Union[*SHARED, trained, *own], Field(discriminator="kind")]
    return TypeAdapter(every)


@dataclass(frozen=True)
class Line:
    """One entry with the session time at which it was written, ns."""

    t_ns: int
    entry: Entry


@dataclass(frozen=True)
class Unreadable:
    """A line whose entry cannot be read, though no line is missing or changed: its number from 1, its time, and why."""

    number: int
    t_ns: int
    why: str


@dataclass(frozen=True)
class Contents:
    """A journal as read from disk: its whole lines, oldest first, without the `unreadable`, and where they end."""

    lines: tuple[Line, ...]
    end: End = chain.START
    unreadable: tuple[Unreadable, ...] = ()

    @property
    def torn(self) -> bytes:
        """The bytes after the last newline."""
        return self.end.torn

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The entries alone."""
        return tuple(line.entry for line in self.lines)

    @property
    def header(self) -> Header:
        """The header. Raises `JournalError` if there is none."""
        if not self.lines or not isinstance(self.lines[0].entry, Header):
            raise JournalError("the journal has no header: its session never started", remedy="run the session again")
        return self.lines[0].entry

    def in_order(self) -> list[Line | Unreadable]:
        """Return every line, also those that cannot be read, in the order of the file."""
        lines: list[Line | Unreadable] = list(self.lines)
        for one in self.unreadable:
            lines.insert(one.number - 1, one)
        return lines


def read(path: Path, *, strict: bool = True) -> Contents:
    """Read and verify a journal.

    Raises `JournalError` if it is unreadable, or a whole line is broken, missing or changed; unless `strict`, entries
    behind the header may be unreadable.
    """
    if not path.is_file():
        raise JournalError(path, "cannot read the journal: it is not a file", "give the path of a journal")
    return read_if_begun(path, strict=strict)


def read_if_begun(path: Path, *, strict: bool = True) -> Contents:
    """Return `read`, without lines if the session has not begun. Raises `JournalError`, also for a head alone."""
    found = chain.read(path, JournalError, strict=False)
    lines, unreadable = list[Line](), list[Unreadable]()
    task_kinds: tuple[str, ...] = ()
    for number, link in enumerate(found.links, start=1):
        first = number == 1
        try:
            entry = _entry(path, number, link, *task_kinds)
            task_kinds = (entry.task_kind,) if isinstance(entry, Header) else task_kinds
            lines.append(Line(link.t_ns, entry))
        except ValueError as error:
            why = _why(error)
            if first:
                raise _refused(path, number, why, chain.COPY_FIRST) from error
            unreadable.append(Unreadable(number, link.t_ns, why))
    contents = Contents(tuple(lines), found.end, tuple(unreadable))
    if strict:
        refuse_unreadable(path, contents)
    return contents


def refuse_unreadable(path: Path, contents: Contents) -> None:
    """Raise `JournalError` for the first entry that cannot be read; it names the answers that can."""
    for one in contents.unreadable:
        by_trial: dict[int, str | None] = {}
        for entry in contents.entries:
            if isinstance(entry, entries.Answer | entries.Correction):
                by_trial[entry.trial] = entry.answered
            elif isinstance(entry, entries.Redo):
                by_trial.pop(entry.trial, None)
        answers = ", ".join(f"trial {trial} {answered or 'no answer'}" for trial, answered in by_trial.items())
        rest = f"Confirmed answers: {answers}" if answers else "No answers were confirmed"
        ask = f"{rest}. To show all other entries, run {{}}. Ask the maintainers for a version that reads this line"
        show = ("palpate", "journal", str(path))
        remedy = Remedy(f"no line is missing or changed. {ask}", show, suffices=False)
        raise _refused(path, one.number, one.why, remedy)


def _entry(path: Path, number: int, link: chain.Link, *task_kinds: str) -> Entry:
    """Return the entry of a line, `task_kinds` behind a header. Raises `ValueError`, and `OtherFormat`."""
    if link.problem:
        raise ValueError(link.problem)
    # A journal of another format is refused in plain words, before its models refuse it in theirs.
    if link.entry.get("kind") == "header":
        got, by = link.entry.get("format"), str(link.entry.get("software", ""))
        known = get_args(Header.model_fields["format"].annotation)
        if (other := other_format(path, "journal", got, known, line=number, software=by)) is not None:
            raise other
    entry = reader(*task_kinds).validate_json(link.json)
    if isinstance(entry, Header) != (number == 1):
        raise ValueError("a journal has one header, in its first line")
    if isinstance(entry, Header):
        entries_of(entry.task_kind)
    return entry


def _why(error: ValueError) -> str:
    """Return why an entry cannot be read: of several reasons the first."""
    if not isinstance(error, ValidationError):
        return str(error)
    problem = error.errors(include_url=False)[0]
    return f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}" if problem["loc"] else "its kind is unknown"


def _refused(path: Path, number: int, why: str, remedy: Remedy | str) -> JournalError:
    return JournalError(
        path, f"line {number} is not a journal entry that this version of palpate can read ({why})", remedy
    )


class Journal:
    """A journal open for appending. Entries are on disk when `append` returns, in a rehearsal when it is closed."""

    def __init__(self, path: Path, clock: Clock, contents: Contents) -> None:
        """Begin `path`, or continue it after its torn end. Raises `SessionLocked` if another runner has it open."""
        self._path = path
        self._paths = path, chain.head_path(path)
        self._clock = clock
        self._begun = bool(contents.lines)
        self._task_kinds: tuple[str, ...] = ()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._writer = chain.Writer(path, contents.end)
        for entry in contents.entries[:1]:
            self._is_of(entry)

    def _is_of(self, entry: Entry) -> None:
        if isinstance(entry, Header):
            self._task_kinds = (entry.task_kind,)
            self._writer.waits = entry.purpose != "REHEARSAL"

    @property
    def waits(self) -> bool:
        """Whether an entry is on disk when `append` returns."""
        return self._writer.waits

    @property
    def accepts(self) -> bool:
        """Whether an entry may follow: the journal has a header, and no write was interrupted halfway."""
        return self._writer.whole and self._begun

    def append(self, entry: Entry) -> int:
        """Write one entry, and return its session time, ns.

        Raises `JournalError`, before writing if `read` would refuse it, if the disk fails or the journal was moved.
        """
        if not self._writer.whole:
            raise JournalError(self._path, "an earlier entry was not completely written", "run the same command again")
        t_ns = self._clock.now_ns()
        link = self._readable(t_ns, entry)
        self._is_of(entry)
        try:
            self._writer.append(link)
        except OSError as error:
            raise unwritable(self._path, error) from error
        self._begun = True
        for file, path in zip(self._writer.descriptors, self._paths, strict=True):
            check_place(file, path)
        return t_ns

    def _readable(self, t_ns: int, entry: Entry) -> chain.Link:
        """Return the line of an entry. Raises `JournalError` if `read` would refuse it."""
        try:
            link = self._writer.next_link(t_ns, entry.model_dump(mode="json", warnings=False))
            _entry(self._path, 2 if self._begun else 1, link, *self._task_kinds)
        except ValueError as error:
            raise JournalError(
                self._path,
                f"an entry of kind {entry.kind} was not written, because it could not be read back ({_why(error)})",
                "run the same command again",
            ) from error
        return link

    def close(self) -> None:
        """Close the files; nothing is pending. Raises `JournalError` if the disk does not take what is."""
        try:
            self._writer.close()
        except OSError as error:
            raise unwritable(self._path, error) from error


def settle(path: Path, contents: Contents) -> None:
    """Write the head of a complete journal, which a kill leaves one line behind: else a cut would not show.

    Raises `SessionLocked`, and `JournalError` if the disk does not take it.
    """
    if chain.is_behind(path, contents.end, JournalError):
        try:
            chain.Writer(path, contents.end).close()
        except OSError as error:
            raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> JournalError:
    """Return what to tell of a file of a session that the disk does not take."""
    return JournalError(
        path,
        f"cannot be written ({error.strerror}); check the disk and its free space, then run the same command again",
        "every confirmed answer is saved",
    )


def check_place(file: int, path: Path) -> None:
    """Refuse to go on with an open file that is no longer the one at its path. Raises `JournalError`."""
    try:
        stands = os.path.samestat(os.fstat(file), path.stat())
    except OSError:
        stands = False
    if not stands:
        raise JournalError(
            path,
            "the file is missing: it or its folder was deleted, moved or replaced during the session",
            "move it back or restore it from a backup, then run the same command again",
        )


@contextmanager
def _held_folder(folder: Path, refused: SessionLocked) -> Iterator[None]:
    """Hold a folder itself, so that nobody is let in by removing the file that is locked in it."""
    if not hasattr(os, "O_DIRECTORY"):
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            chain.hold(descriptor, refused)
        except OSError as error:
            # A network's file system may lock files alone; there the lock file and the journal's own lock remain.
            if error.errno not in (errno.EBADF, errno.ENOLCK, errno.ENOTSUP, errno.EINVAL):
                raise
        yield
    finally:
        os.close(descriptor)


def check_free(folder: Path, participant: str) -> None:
    """Raise `SessionLocked` if a runner holds the participant, whose folder need not be there."""
    if folder.exists():
        with locked(folder, participant):
            pass


@contextmanager
def locked(folder: Path, participant: str) -> Iterator[None]:
    """Lock a participant until this process ends. Raises `SessionLocked` if another runner has the lock."""
    refused = SessionLocked(
        f"a session with participant {participant} is running", remedy="end it at its console, or wait until it ends"
    )
    with ExitStack() as held:
        try:
            held.enter_context(storage.locked(folder / f".sub-{participant}.lock", 0))
        except Timeout as error:
            raise refused from error
        held.enter_context(_held_folder(folder, refused))
        yield
