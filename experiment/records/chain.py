"""Lines that nobody changes unseen: each has its number, its time and the hash of the line before it.

A line is `{"n": 3, "t_ns": ..., "prev": "<SHA-256 of line 2>", "entry": {...}}`. Bytes after the last newline are torn:
a write that never finished and was not confirmed. They are reported and dropped; anything else that does not fit is
refused.

A head beside the file shows a cut end: the number of lines and the hash of the last, written after each line. A file
that is shorter than its head says, or longer by more than one line, is refused.
"""

import hashlib
import json
import os
import re
import sys
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import PalpateError, SessionLocked

GENESIS = "0" * 64
"""`prev` of the first line."""

ENCODER = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)

ENVELOPE = re.compile(
    rb'\{"n":([0-9]{1,12}),"t_ns":(-?[0-9]{1,19}),"prev":"([0-9a-f]{64})","entry":\{.*\}\}', re.DOTALL
)
"""A line, whatever its entry is: its number, its time and the hash of the line before it."""

COPY_FIRST = "copy the file as it is, then restore it from a backup"
"""What to do with a file of which a line was changed or is missing."""


@dataclass(frozen=True)
class Link:
    """One line: its time, ns since 1970-01-01T00:00Z, entry (or the `problem` with it), bytes, and SHA-256."""

    t_ns: int
    entry: dict[str, object]
    line: bytes
    sha256: str
    problem: str = ""

    @property
    def json(self) -> bytes:
        """The entry as JSON."""
        return self.line.partition(b',"entry":')[2][:-1]


@dataclass(frozen=True)
class End:
    """Where a file of chained lines ends, with the SHA-256 of the last line; what follows is `torn`."""

    count: int = 0
    last: str = GENESIS
    size: int = 0
    torn: bytes = b""


START = End()
"""Where a file ends in which nothing is written yet."""


@dataclass(frozen=True)
class Chain:
    """A file of chained lines, and where it ends."""

    links: tuple[Link, ...] = ()
    end: End = START


EMPTY = Chain()
"""A file in which nothing is written yet."""


def head_path(path: Path) -> Path:
    """Return where the number and the hash of a file's last line stand."""
    return path.with_suffix(".head")


def read(path: Path, error: type[PalpateError], *, strict: bool = True) -> Chain:
    """Read and verify a file of chained lines; one that was never begun is empty.

    Raises `error` if the file or its head is unreadable, missing, or does not fit; unless `strict`, an entry that is
    not JSON between fitting lines is allowed.
    """
    # The head first: read the other way round, a file that is being written would seem cut off.
    head, data = _head(path, error), _bytes(path, error)
    while (now := _head(path, error)) != head:
        # Somebody appended meanwhile.
        head, data = now, _bytes(path, error)
    if data is None and head[0]:
        raise error(path, f"the file is missing: it had {head[0]} lines", "restore it from a backup")
    lines, torn = split(data or b"")
    links, last = list[Link](), GENESIS
    for number, line in enumerate(lines):
        try:
            links.append(_verified(path, number, line, last, error, strict=strict))
        except error:
            # A line that does not follow an unreadable one shows that that one was changed.
            if links and links[-1].problem:
                _verified(path, number - 1, links[-1].line, GENESIS, error, strict=True)
            raise
        last = links[-1].sha256
    (known, named), file = head, head_path(path).name
    if len(links) < known:
        raise error(path, f"the file is truncated: it had {known} lines and now has {len(links)}", COPY_FIRST)
    if (links[known - 1].sha256 if known else GENESIS) != named:
        raise error(path, f"line {known} does not match {file}", COPY_FIRST)
    if len(links) > known + 1:
        raise error(
            path,
            f"got {len(links)} lines, but {f'{file} states {known}' if known else f'no {file}'}",
            "restore both files from a backup",
            allowed=f"a {file} that states {len(links)}, or one less after a forced stop",
        )
    return Chain(tuple(links), End(len(links), last, len(data or b"") - len(torn), torn))


def is_behind(path: Path, end: End, error: type[PalpateError]) -> bool:
    """Return whether the head of a file that was read says less than the file. Raises `error` as `read` does."""
    return _head(path, error)[0] < end.count


def split(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the whole lines of a file of chained lines, and what stands after the last newline."""
    *lines, torn = data.split(b"\n")
    return lines, torn


def _bytes(path: Path, error: type[PalpateError]) -> bytes | None:
    try:
        return storage.read_bytes(path)
    except FileNotFoundError:
        return None
    except OSError as problem:
        raise error(path, f"cannot be read ({problem.strerror})", "restore it from a backup") from problem


def _head(path: Path, error: type[PalpateError]) -> tuple[int, str]:
    """Return how many lines the head says a file has, and the hash of the last; 0 before the first line."""
    file = head_path(path)
    try:
        head = storage.read_bytes(file, 4096).decode("ascii")
    except FileNotFoundError:
        return 0, GENESIS
    except (OSError, ValueError) as problem:
        raise error(file, "cannot be read", f"restore it and {path.name} from a backup") from problem
    if not head:
        return 0, GENESIS
    if (found := re.fullmatch(r"([0-9]{12}) ([0-9a-f]{64})\n", head)) is None:
        raise error(file, "is not a valid chain head", f"restore it and {path.name} from a backup")
    return int(found[1]), found[2]


def _verified(path: Path, number: int, line: bytes, last: str, error: type[PalpateError], *, strict: bool) -> Link:
    where = f"line {number + 1}"
    try:
        document = storage.json_of(line)
        n, t_ns, prev, entry = (document[key] for key in ("n", "t_ns", "prev", "entry"))
        if set(document) != {"n", "t_ns", "prev", "entry"} or not isinstance(t_ns, int) or not isinstance(entry, dict):
            raise ValueError("not the keys of a chained line")
        problem = ""
    except (ValueError, KeyError, TypeError) as refused:
        envelope = None if strict else ENVELOPE.fullmatch(line)
        if envelope is None:
            older = "it was changed, or an older version of palpate wrote it"
            raise error(path, f"{where} is not a chained line: {older}", COPY_FIRST) from refused
        n, t_ns, prev, entry = int(envelope[1]), int(envelope[2]), envelope[3].decode(), {}
        problem = str(refused)
    if (n, prev) != (number, last):
        raise error(path, f"{where} does not follow the line before it: a line was changed or is missing", COPY_FIRST)
    # JSON lets a line hold more than what it says, another line among it: blanks, or one key twice.
    if not problem and line != _line(number, t_ns, last, entry):
        raise error(path, f"{where} was changed: palpate does not write lines like this", COPY_FIRST)
    return Link(t_ns, entry, line, hashlib.sha256(line).hexdigest(), problem)


def _line(number: int, t_ns: int, last: str, entry: dict[str, object]) -> bytes:
    return ENCODER.encode({"n": number, "t_ns": t_ns, "prev": last, "entry": entry}).encode()


class Writer:
    """A file of chained lines that is open for appending, and locked against other writers.

    `whole`: no write was interrupted halfway. `waits`: each line is on disk when `append` returns, otherwise when the
    file is closed. `descriptors` are those of the file and of its head.
    """

    def __init__(self, path: Path, end: End) -> None:
        """Continue `path` after `end`, without its torn end. Raises `SessionLocked` if it is open, and `OSError`."""
        self._count, self._last, self._size = end.count, end.last, end.size
        self.whole = self.waits = True
        # Without a buffer, which would be written after all once a full disk has room again.
        self._file = FileIO(path, "ab")
        try:
            running = "another session is writing to the file"
            hold(self._file.fileno(), SessionLocked(path, running, "end that session, or wait until it ends"))
            if os.fstat(self._file.fileno()).st_size != end.size + len(end.torn):
                raise SessionLocked(path, "changed after it was read", "try again")
            self._cut()
            self._head = os.open(head_path(path), os.O_RDWR | os.O_CREAT, 0o666)
        except BaseException:
            self._file.close()
            raise
        if self._count:
            self._write_head()
        storage.sync_folder(path.parent)

    @property
    def descriptors(self) -> tuple[int, int]:
        """The open file and the open head."""
        return self._file.fileno(), self._head

    def next_link(self, t_ns: int, entry: dict[str, object]) -> Link:
        """Return the next line as `read` would; nothing is written. Raises `ValueError` if that would refuse it."""
        line = _line(self._count, t_ns, self._last, entry)
        if self._size + len(line) >= storage.MOST:
            raise ValueError(f"the file would be larger than {storage.MOST:,} bytes")
        if extreme := storage.extreme([t_ns, entry]):
            raise ValueError(extreme[1])
        return Link(t_ns, entry, line, hashlib.sha256(line).hexdigest())

    def append(self, link: Link) -> None:
        """Write what `next_link` returned, on disk when this returns if the writer `waits`. Raises `OSError`."""
        # An interrupt from here on leaves it open whether the line is on disk; only reading the file again tells.
        self.whole = False
        try:
            write_through(self._file, link.line + b"\n", wait=self.waits)
        except OSError:
            # This raises too if it cannot be cut off again.
            self._cut()
            self.whole = True
            raise
        self._count += 1
        self._size += len(link.line) + 1
        self._last = link.sha256
        self._write_head()
        self.whole = True

    def close(self) -> None:
        """Close both files; nothing is pending. Raises `OSError`."""
        try:
            for file in () if self.waits else self.descriptors:
                os.fsync(file)
        finally:
            self._file.close()
            os.close(self._head)

    def _cut(self) -> None:
        self._file.truncate(self._size)
        os.fsync(self._file.fileno())

    def _write_head(self) -> None:
        """Write in place and always equally long, so that a kill leaves the old head or the new one."""
        os.lseek(self._head, 0, os.SEEK_SET)
        os.write(self._head, f"{self._count:012d} {self._last}\n".encode("ascii"))
        if self.waits:
            os.fsync(self._head)


def write_through(file: FileIO, content: bytes, *, wait: bool = True) -> None:
    """Append to a file without a buffer, and `wait` until it is on disk. Raises `OSError`."""
    left = memoryview(content)
    while left:
        left = left[file.write(left) :]
    if wait:
        os.fsync(file.fileno())


def hold(file: int, refused: SessionLocked) -> None:
    """Lock an open file or folder until it is closed. Raises `refused` if another has it, `OSError` without locks."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise refused from error
