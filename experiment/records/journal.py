"""The journal of one session: append-only JSON lines, each on disk before the session moves on.

A line is `{"n": 3, "t_ns": ..., "prev": "<SHA-256 of line 2>", "entry": {...}}`. The hash chain makes any later
change to a line visible. What stands after the last newline is torn: a write that never finished, so nothing
that was confirmed. It is reported and dropped; anything else that does not fit is refused.

A chain alone cannot show that its end was cut off. So the number and the hash of the last line on disk stand in a
file of their own beside the journal (`.head`), written after the line. A journal that is shorter than its head says is
refused, and so is one that is longer by more than the one line that a kill can leave between the two.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Annotated

from filelock import FileLock, Timeout
from pydantic import Field, TypeAdapter, ValidationError

from experiment import storage
from experiment.clock import Clock
from experiment.errors import JournalError, SessionLocked
from experiment.records import chain
from experiment.records.entries import (
    FORMAT,
    Answer,
    Armed,
    Exposure,
    Footer,
    Header,
    MaskerSet,
    Phase,
    Redo,
    Resumed,
    TrackerOpened,
    Withdrawal,
)
from experiment.records.footstep import BrokenOff, FootStep, Zeroed
from experiment.storage import sync_folder

AnyEntry = Annotated[
    Header
    | TrackerOpened
    | Zeroed
    | MaskerSet
    | Exposure
    | Phase
    | Armed
    | FootStep
    | BrokenOff
    | Answer
    | Redo
    | Resumed
    | Footer
    | Withdrawal,
    Field(discriminator="kind"),
]
ENTRY: TypeAdapter[AnyEntry] = TypeAdapter(AnyEntry)


@dataclass(frozen=True)
class Line:
    """One entry with the session time at which it was written, ns."""

    t_ns: int
    entry: AnyEntry


@dataclass(frozen=True)
class Contents:
    """A journal as read from disk.

    `lines` are the whole lines, oldest first; there are none when not even the header was finished. `torn` are the
    bytes after the last newline, and `size` those up to and including it. `last_hash` is the SHA-256 of the last whole
    line, the `prev` of the next.
    """

    lines: tuple[Line, ...]
    torn: bytes
    size: int
    last_hash: str

    @property
    def entries(self) -> tuple[AnyEntry, ...]:
        """The entries alone."""
        return tuple(line.entry for line in self.lines)

    @property
    def header(self) -> Header:
        """The header. Raises `JournalError` if there is none."""
        if not self.lines or not isinstance(self.lines[0].entry, Header):
            raise JournalError("the journal has no header: its session never started; run the session again")
        return self.lines[0].entry


def read(path: Path) -> Contents:
    """Read and verify a journal.

    Raises `JournalError` if the file cannot be read, or if a whole line is broken, missing or changed.
    """
    # The head first: read the other way round, a journal that is being written would seem cut off.
    head = _head(path)
    try:
        data = storage.read_bytes(path)
    except OSError as error:
        raise JournalError(f"{path}: cannot read the journal ({error.strerror}); give the path of a journal") from error
    size = data.rfind(b"\n") + 1
    lines: list[Line] = []
    last_hash = chain.GENESIS
    for n, line in enumerate(data[:size].splitlines()):
        lines.append(_verified(path, n, line, last_hash))
        last_hash = hashlib.sha256(line).hexdigest()
    known, whole = head[0], data[:size].splitlines()
    if len(whole) > known + 1 and _head(path) != head:
        # It is being written: both have grown since the head was read.
        return read(path)
    _check_head(path, head, whole)
    return Contents(tuple(lines), data[size:], size, last_hash)


def read_if_begun(path: Path) -> Contents:
    """Return what `read` returns, or `EMPTY` if the session has not begun.

    Raises `JournalError` as `read`, and if the journal is gone although its head is there.
    """
    if path.exists():
        return read(path)
    known, _ = _head(path)
    if known:
        raise JournalError(f"{path}: the journal is missing: it had {known} lines; restore it from a backup")
    return EMPTY


def _head(path: Path) -> tuple[int, str]:
    """Return how many lines the head says the journal has, and the hash of the last; 0 before the first line."""
    try:
        return chain.read_head(path)
    except (OSError, ValueError) as error:
        raise JournalError(
            f"{chain.head_path(path)}: cannot be read; restore it and the journal from a backup"
        ) from error


def _check_head(path: Path, known_head: tuple[int, str], lines: list[bytes]) -> None:
    (known, last_hash), head = known_head, chain.head_path(path).name
    remedy = "keep the file as it is and restore the journal from a backup"
    if len(lines) < known:
        raise JournalError(f"{path}: the journal is truncated: it had {known} lines and has {len(lines)}; {remedy}")
    if known and hashlib.sha256(lines[known - 1]).hexdigest() != last_hash:
        raise JournalError(f"{path}: line {known} is not the one that {head} names; {remedy}")
    if len(lines) > known + 1:
        raise JournalError(
            f"{path}: got {len(lines)} lines and {f'a {head} of {known}' if known else f'no {head}'}; allowed: one "
            f"that names {len(lines)}, or one less after a kill; restore both files from a backup"
        )


def _verified(path: Path, n: int, line: bytes, last_hash: str) -> Line:
    where = f"{path}: line {n + 1}"
    remedy = "keep the file as it is and restore the journal from a backup"
    try:
        document = storage.json_of(line)
        number, t_ns, prev = document["n"], document["t_ns"], document["prev"]
        _check_format(where, document["entry"])
        entry = ENTRY.validate_json(json.dumps(document["entry"]))
    except (ValueError, KeyError, TypeError, ValidationError) as error:
        raise JournalError(f"{where} is no journal entry ({type(error).__name__}); {remedy}") from error
    if number != n or prev != last_hash:
        raise JournalError(f"{where} does not follow the line before it: a line was changed or is missing; {remedy}")
    if not isinstance(t_ns, int):
        raise JournalError(f"{where} has no time; {remedy}")
    if isinstance(entry, Header) != (n == 0):
        raise JournalError(f"{where}: a journal holds one header, in its first line; {remedy}")
    return Line(t_ns, entry)


def _check_format(where: str, entry: dict[str, object]) -> None:
    """Refuse a journal of another format in plain words, before its models refuse it in theirs."""
    if entry["kind"] == "header" and entry.get("format", 1) != FORMAT:
        raise JournalError(
            f"{where}: got a journal of format {entry.get('format', 1)}; allowed: {FORMAT}; read it with the palpate "
            f"that wrote it ({entry.get('software', 'not named')})"
        )


class Journal:
    """A journal open for appending; `append` returns when the entry is on disk."""

    def __init__(self, path: Path, clock: Clock, contents: Contents) -> None:
        """Continue `path` after what `read` returned, dropping its torn end, or begin it after `EMPTY`.

        Raises `SessionLocked` if another runner has it open, whatever became of the participant's lock.
        """
        self._path = path
        self._clock = clock
        self._count = len(contents.lines)
        self._last_hash = contents.last_hash
        self._size = contents.size
        self._whole = True
        path.parent.mkdir(parents=True, exist_ok=True)
        # Without a buffer, which would be written after all once a full disk has room again.
        self._file = FileIO(path, "ab")
        try:
            _hold(self._file.fileno(), f"{path}: the journal is being written")
            self._cut()
            self._head = os.open(chain.head_path(path), os.O_RDWR | os.O_CREAT, 0o666)
        except BaseException:
            self._file.close()
            raise
        if self._count:
            self._write_head()
        sync_folder(path.parent)

    @property
    def accepts(self) -> bool:
        """Whether an entry may follow: the journal has a header, and no write was interrupted halfway."""
        return self._whole and self._count > 0

    def append(self, entry: AnyEntry) -> int:
        """Write one entry, wait until it is on disk, and return the session time written with it, ns.

        Raises `JournalError` if the disk does not take it, or if the journal no longer stands where it was begun.
        """
        if not self._whole:
            raise JournalError(f"{self._path}: an earlier entry was interrupted; run the same command again")
        t_ns = self._clock.now_ns()
        document = {
            "n": self._count,
            "t_ns": t_ns,
            "prev": self._last_hash,
            "entry": entry.model_dump(mode="json"),
        }
        line = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        # An interrupt from here on leaves it open whether the line is on disk; only reading the file again tells.
        self._whole = False
        try:
            write_through(self._file, line + b"\n")
        except OSError as error:
            self._whole = self._taken_back()
            raise unwritable(self._path, error) from error
        self._count += 1
        self._size += len(line) + 1
        self._last_hash = hashlib.sha256(line).hexdigest()
        try:
            self._write_head()
        except OSError as error:
            raise unwritable(chain.head_path(self._path), error) from error
        self._whole = True
        check_place(self._file.fileno(), self._path)
        check_place(self._head, chain.head_path(self._path))
        return t_ns

    def close(self) -> None:
        """Close the files; nothing is pending."""
        self._file.close()
        os.close(self._head)

    def _taken_back(self) -> bool:
        """Return whether what was written of a line could be cut off again."""
        try:
            self._cut()
        except OSError:
            return False
        return True

    def _cut(self) -> None:
        self._file.truncate(self._size)
        os.fsync(self._file.fileno())

    def _write_head(self) -> None:
        """Write in place and always equally long, so that a kill leaves the old head or the new one."""
        os.lseek(self._head, 0, os.SEEK_SET)
        os.write(self._head, f"{self._count:012d} {self._last_hash}\n".encode("ascii"))
        os.fsync(self._head)


EMPTY = Contents((), b"", 0, chain.GENESIS)
"""A journal in which nothing is written yet."""


def write_through(file: FileIO, content: bytes) -> None:
    """Append to a file without a buffer, and wait until it is on disk. Raises `OSError`."""
    left = memoryview(content)
    while left:
        left = left[file.write(left) :]
    os.fsync(file.fileno())


def unwritable(path: Path, error: OSError) -> JournalError:
    """Return what to tell of a file of a session that the disk does not take."""
    return JournalError(
        f"{path}: cannot be written ({error.strerror}); see to the disk and its free space, then run the same command "
        "again; every answer that was confirmed is on disk"
    )


def check_place(file: int, path: Path) -> None:
    """Refuse to go on with an open file that is no longer the one at its path. Raises `JournalError`."""
    try:
        stands = os.path.samestat(os.fstat(file), path.stat())
    except OSError:
        stands = False
    if not stands:
        raise JournalError(
            f"{path}: the file is gone: it, or the folder that it stands in, was deleted, moved or replaced while the "
            "session wrote it; put it back from where it is now or from a backup, then run the same command again"
        )


def _hold(file: int, got: str) -> None:
    """Lock an open file or folder until it is closed. Raises `SessionLocked`; `OSError` where there are no locks."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise SessionLocked(f"{got} by another runner; end it there, or wait until it ends") from error


@contextmanager
def _held_folder(folder: Path, got: str) -> Iterator[None]:
    """Hold a folder itself, so that nobody is let in by removing the file that is locked in it."""
    if not hasattr(os, "O_DIRECTORY"):
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            _hold(descriptor, got)
        except OSError as error:
            # A network's file system may lock files alone; there the lock file and the journal's own lock remain.
            if error.errno not in (errno.EBADF, errno.ENOLCK, errno.ENOTSUP, errno.EINVAL):
                raise
        yield
    finally:
        os.close(descriptor)


@contextmanager
def locked(folder: Path, participant: str) -> Iterator[None]:
    """Hold a participant for this runner; the operating system lets go when the process ends, however it ends.

    Raises `SessionLocked` if another runner holds the participant.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / f".sub-{participant}.lock")
    got = f"participant {participant} is being run"
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise SessionLocked(f"{got} by another runner; end it there, or wait until it ends") from error
    try:
        with _held_folder(folder, got):
            yield
    finally:
        lock.release()
