"""Lines that nobody changes unseen: each has its number, its time and the hash of the line before it.

Beside the file stands its head: the number of its lines and the hash of the last, written after each line. So a file
that was cut is told from one that is whole, as long as nobody writes the head anew as well.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from experiment import storage
from experiment.errors import PalpateError

GENESIS = "0" * 64
"""`prev` of the first line."""


@dataclass(frozen=True)
class Link:
    """One line: when it was written, ns since 1970-01-01T00:00Z, what it says, and its SHA-256."""

    t_ns: int
    entry: dict[str, object]
    sha256: str


@dataclass(frozen=True)
class Chain:
    """A file of chained lines; `torn` are the bytes after the last newline, and `size` those up to and including it."""

    links: tuple[Link, ...] = ()
    torn: bytes = b""
    size: int = 0

    @property
    def last(self) -> str:
        """The SHA-256 of the last whole line, the `prev` of the next."""
        return self.links[-1].sha256 if self.links else GENESIS


EMPTY = Chain()
"""A file in which nothing is written yet."""


def head_path(path: Path) -> Path:
    """Return where the number and the hash of a file's last line stand."""
    return path.with_suffix(".head")


def read(path: Path, error: type[PalpateError]) -> Chain:
    """Read and verify a file of chained lines; one that was never begun is empty.

    Raises `error` if the file cannot be read, or if a line or the head does not fit.
    """
    try:
        head, data = read_head(path), _bytes(path)
        while (now := read_head(path)) != head:
            # Somebody appended meanwhile.
            head, data = now, _bytes(path)
    except (OSError, ValueError) as problem:
        raise error(f"{path}: cannot read the file or its head ({problem}); restore both from a backup") from problem
    lines = data[: data.rfind(b"\n") + 1].split(b"\n")[:-1]
    links: list[Link] = []
    for number, line in enumerate(lines):
        links.append(
            _verified(f"{path}: line {number + 1}", number, line, links[-1].sha256 if links else GENESIS, error)
        )
    _check_head(path, head, links, error)
    size = data.rfind(b"\n") + 1
    return Chain(tuple(links), data[size:], size)


def read_head(path: Path) -> tuple[int, str]:
    """Return how many lines the head says a file has, and the hash of the last; 0 before the first line.

    Raises `OSError` or `ValueError` if the head cannot be read.
    """
    try:
        head = storage.read_bytes(head_path(path), 4096).decode("ascii")
    except FileNotFoundError:
        return 0, GENESIS
    if not head:
        return 0, GENESIS
    if (found := re.fullmatch(r"([0-9]{12}) ([0-9a-f]{64})\n", head)) is None:
        raise ValueError(f"its head is {head[:100]!r}")
    return int(found[1]), found[2]


def append(path: Path, chain: Chain, t_ns: int, entry: dict[str, object]) -> None:
    """Write one more line after what `read` returned, in place of its torn end; it is on disk when this returns."""
    document = {"n": len(chain.links), "t_ns": t_ns, "prev": chain.last, "entry": entry}
    line = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    if len(chain.links) > 1:
        _write_head(path, len(chain.links), chain.last)
    with path.open("ab") as file:
        file.truncate(chain.size)
        file.write(line + b"\n")
        file.flush()
        os.fsync(file.fileno())
    _write_head(path, len(chain.links) + 1, hashlib.sha256(line).hexdigest())


def _bytes(path: Path) -> bytes:
    try:
        return storage.read_bytes(path)
    except FileNotFoundError:
        return b""


def _write_head(path: Path, count: int, last: str) -> None:
    """Write in place and always equally long, so that a kill leaves the old head or the new one."""
    descriptor = os.open(head_path(path), os.O_RDWR | os.O_CREAT, 0o666)
    try:
        os.write(descriptor, f"{count:012d} {last}\n".encode("ascii"))
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _verified(where: str, number: int, line: bytes, last: str, error: type[PalpateError]) -> Link:
    remedy = "keep the file as it is and restore it from a backup"
    older = "it was changed, or an older palpate wrote it"
    try:
        document = storage.json_of(line)
        n, t_ns, prev, entry = (document[key] for key in ("n", "t_ns", "prev", "entry"))
        fits = set(document) == {"n", "t_ns", "prev", "entry"} and isinstance(t_ns, int) and isinstance(entry, dict)
    except (ValueError, KeyError, TypeError) as problem:
        raise error(f"{where} is no chained line ({type(problem).__name__}): {older}; {remedy}") from problem
    if not fits or (n, prev) != (number, last):
        raise error(f"{where} does not follow the line before it: a line was changed or is missing; {remedy}")
    return Link(t_ns, entry, hashlib.sha256(line).hexdigest())


def _check_head(path: Path, head: tuple[int, str], links: list[Link], error: type[PalpateError]) -> None:
    known, last = head
    remedy = f"restore {path.name} and {head_path(path).name} from a backup"
    if len(links) < known:
        raise error(f"{path}: the file is truncated: it had {known} lines and has {len(links)}; {remedy}")
    if len(links) > known + 1:
        # A kill leaves one line at most without its head.
        raise error(f"{path}: has {len(links)} lines, and {head_path(path).name} knows of {known}; {remedy}")
    if (links[known - 1].sha256 if known else GENESIS) != last:
        raise error(f"{path}: line {known} is not the one that {head_path(path).name} names; {remedy}")
