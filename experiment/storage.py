"""Files that are whole and on disk, or not there, and where every file of a study stands in its dataset."""

from __future__ import annotations

import errno
import io
import json
import os
import stat
import tempfile
from collections.abc import Iterable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from experiment.errors import DatasetError

RECORDINGS = Path("stimuli") / "recordings"
"""Where the recordings stand that a study's stimuli are made from, inside its dataset."""

MOST = 256 * 2**20
"""No file of a user is read that is larger, bytes; files of one kind may have less."""

DEEPEST = 32
"""Tables and arrays stand in one another at most as often as this."""

Place = tuple[str | int, ...]


def read_bytes(path: Path, most: int = MOST) -> bytes:
    """Return the content of a file of at most `most` bytes.

    Raises `OSError` if it cannot be read, and for what is no file: devices and pipes have no end, or none that comes.
    """
    try:
        found = path.stat()
    except ValueError as error:
        raise OSError(errno.EINVAL, f"{error} in its name", str(path)) from error
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "a device, a pipe or a socket, not a file", str(path))
    if found.st_size > most:
        raise OSError(errno.EFBIG, f"{found.st_size:,} bytes, more than {most:,}", str(path))
    with path.open("rb") as file:
        return file.read(found.st_size)


def read_text(path: Path, most: int = MOST) -> str:
    """Return a text in UTF-8, its lines ended by line feeds. Raises `OSError` as `read_bytes`, and `ValueError`."""
    return io.TextIOWrapper(io.BytesIO(read_bytes(path, most)), encoding="utf-8").read()


def json_of(text: str | bytes) -> Any:
    """Return a JSON document. Raises `ValueError` if it is none, or holds what `extreme` tells, or half a character."""
    try:
        document = json.loads(text, parse_float=_finite, parse_constant=_finite)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    if found := extreme(document):
        raise ValueError(found[1])
    # Half of a pair of escapes is a text that nothing can print.
    if (b"\\u" if isinstance(text, bytes) else "\\u") in text:  # type: ignore[operator]
        json.dumps(document, ensure_ascii=False).encode()
    return document


def _finite(number: str) -> float:
    if not isfinite(value := float(number)):
        raise ValueError(f"the number {number[:20]}")
    return value


TOO_DEEP = f"tables or arrays in one another more than {DEEPEST} times"


def extreme(document: object) -> tuple[Place, str] | None:
    """Return where a document of TOML or JSON holds what no file needs, and what: the nesting, or a whole number."""
    level: list[tuple[Place, object]] = [((), document)]
    for _ in range(DEEPEST + 1):
        inner: list[tuple[Place, object]] = []
        for place, held in level:
            if isinstance(held, int) and not -(2**63) <= held < 2**63:
                return place, "a whole number of more than 64 bits"
            items: Iterable[tuple[Any, object]] = ()
            if isinstance(held, dict):
                items = held.items()
            elif isinstance(held, list):
                items = enumerate(held)
            inner += [((*place, key), one) for key, one in items]
        level = inner
    return (level[0][0], TOO_DEEP) if level else None


def write(path: Path, content: bytes) -> None:
    """Put `content` at `path`, on disk when this returns: a reader finds the old file or the new one, never a part.

    Raises `OSError` if the file system refuses; nothing is left behind.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial = Path(name)
        partial.chmod(0o644)
        partial.replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Have the entries of a folder and of the folders above it on disk, where the system can say so."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    for one in (folder, *list(folder.resolve().parents)[:3]):
        descriptor = os.open(one, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_bytes(path: Path, content: bytes) -> None:
    """Put `content` at `path`, whole and on disk. Raises `DatasetError` if the file system refuses."""
    try:
        write(path, content)
    except OSError as error:
        raise DatasetError(f"cannot write {path}: {error.strerror}; check its folder and the free space") from error


def json_bytes(content: Mapping[str, object]) -> bytes:
    """Return a JSON object as UTF-8 text, two spaces deep, keys in the order given."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a JSON object as `json_bytes` gives it. Raises `DatasetError` if the file system refuses."""
    write_bytes(path, json_bytes(content))


def protocol_path(dataset: Path) -> Path:
    """Return where the protocol of a study is kept inside its dataset."""
    return dataset / "sourcedata" / "protocol.toml"


def plan_path(dataset: Path) -> Path:
    """Return where the plan of a rehearsal stands; a dataset without it is of no rehearsal."""
    return dataset / "sourcedata" / "rehearsal.json"


def roster_path(dataset: Path) -> Path:
    """Return where the roster of a study stands inside its dataset."""
    return dataset / "sourcedata" / "roster.jsonl"


def journals(dataset: Path) -> list[Path]:
    """Return the journals of a dataset, by participant and task."""
    return sorted((dataset / "sourcedata").glob("sub-*/sub-*_journal.jsonl"))


def participant_folder(dataset: Path, participant: str) -> Path:
    """Return where everything of a participant's sessions stands inside a dataset."""
    return dataset / "sourcedata" / f"sub-{participant}"


def journal_path(dataset: Path, participant: str, task: str) -> Path:
    """Return where the journal of a session stands inside a dataset."""
    return participant_folder(dataset, participant) / f"sub-{participant}_task-{task}_journal.jsonl"


def withdrawal_path(dataset: Path, participant: str) -> Path:
    """Return where the withdrawal of a participant without a journal is kept inside a dataset."""
    return participant_folder(dataset, participant) / f"sub-{participant}_withdrawn.json"


def rig_path(journal_file: Path) -> Path:
    """Return where the rig file of a session stands, beside its journal."""
    return journal_file.with_name(journal_file.name.replace("_journal.jsonl", "_rig.toml"))


def foot_path(journal_file: Path) -> Path:
    """Return where the raw tracker frames of a session stand, beside its journal."""
    return journal_file.with_name(journal_file.name.replace("_journal.jsonl", "_foot.cobs"))
