"""Files that are whole and on disk, or not there; where a study's files stand in its dataset; how Python is started.

Unfinished files have names that `TEMPORARY` knows, in the folder of their target. Whoever writes there next removes
what a killed process left. Modes follow the umask.
"""

import errno
import io
import json
import os
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args

from palpate.experiment.errors import DatasetError, other_format

if sys.platform != "win32":
    import fcntl

RECORDINGS = Path("stimuli") / "recordings"
"""Where the recordings stand that a study's stimuli are made from, inside its dataset."""

DatasetFormat = Literal[2]
"""Formats of a dataset: its files, their columns and keys, and what stands in `sourcedata` beside journals."""

DATASET_FORMAT: DatasetFormat = 2
"""The one that is written."""

TEMPORARY = re.compile(r"\.palpate-[0-9a-f]{16}")

MOST = 256 * 2**20
"""No file of a user is read that is larger, bytes; files of one kind may have less."""

DEEPEST = 32
"""Tables and arrays stand in one another at most as often as this."""

Place = tuple[str | int, ...]


def python_command(*arguments: str) -> list[str]:
    """Return the command that starts Python with `-m` or `-c`, without modules of the working folder."""
    return [sys.executable, "-P", *arguments]


@contextmanager
def safe_path() -> Iterator[None]:
    """Have workers that a library starts in this block do as well, whatever program it was that called palpate."""
    before = os.environ.get("PYTHONSAFEPATH", "")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        os.environ["PYTHONSAFEPATH"] = before


def read_bytes(path: Path, most: int = MOST, at: int = 0, length: int = sys.maxsize) -> bytes:
    """Return a file of at most `most` bytes, or the `length` from `at` on, as far as they are there.

    Raises `OSError`, also for devices and pipes, which may have no end.
    """
    try:
        found = path.stat()
    except ValueError as error:
        raise OSError(errno.EINVAL, f"{error} in its name", str(path)) from error
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a device, a pipe or a socket, not a file", str(path))
    if found.st_size > most:
        raise OSError(errno.EFBIG, f"{found.st_size:,} bytes, more than {most:,}", str(path))
    with path.open("rb") as file:
        file.seek(at)
        return file.read(max(min(found.st_size - at, length), 0))


def read_text(path: Path, most: int = MOST) -> str:
    """Return a text in UTF-8, its lines ended by line feeds. Raises `OSError` as `read_bytes`, and `ValueError`."""
    return io.TextIOWrapper(io.BytesIO(read_bytes(path, most)), encoding="utf-8").read()


def why(error: Exception) -> str:
    """Return in words why a file cannot be read as text."""
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start + 1} is not valid UTF-8"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def json_of(text: str | bytes) -> Any:
    """Return a JSON document of UTF-8. Raises `ValueError` if it is none, `extreme`, or has half a character."""
    # Left to itself, `json` takes half a character for one where it stands in bytes.
    text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    try:
        document = json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    if found := extreme(document):
        raise ValueError(found[1])
    # Half of a pair of escapes is a text that nothing can print.
    if "\\u" in text:
        json.dumps(document, ensure_ascii=False).encode()
    return document


def _finite(number: str) -> float:
    if not isfinite(value := float(number)):
        raise ValueError(f"the number {number[:20]}")
    return value


def _whole(number: str) -> int:
    try:
        return int(number)
    except ValueError:
        raise ValueError(f"a number of {len(number)} digits") from None


TOO_DEEP = f"tables or arrays nested more than {DEEPEST} levels deep"


def extreme(document: object) -> tuple[Place, str] | None:
    """Return where a document of TOML or JSON holds what no file needs, and what: the nesting, or a whole number."""
    if _is_plain(document):
        return None
    level: list[tuple[Place, object]] = [((), document)]
    for _ in range(DEEPEST + 1):
        inner: list[tuple[Place, object]] = []
        for place, held in level:
            if isinstance(held, int) and not -(2**63) <= held < 2**63:
                return place, "a whole number longer than 64 bits"
            items: Iterable[tuple[Any, object]] = ()
            if isinstance(held, dict):
                items = held.items()
            elif isinstance(held, list):
                items = enumerate(held)
            inner += [((*place, key), one) for key, one in items]
        level = inner
    return (level[0][0], TOO_DEEP) if level else None


def _is_plain(document: object) -> bool:
    """Return whether `extreme` finds nothing, sooner than by keeping the place of everything."""
    level: list[Any] = [document]
    for _ in range(DEEPEST + 1):
        inner: list[Any] = []
        for held in level:
            what = type(held)
            if what is dict:
                inner += held.values()
            elif what is list:
                inner += held
            elif what is int and not -(2**63) <= held < 2**63:
                return False
        level = inner
    return not level


def write(path: Path, content: bytes) -> None:
    """Put `content` at `path`, whole and on disk when this returns. Raises `OSError`, and leaves nothing behind."""
    with named(path), temporary(path.parent, lambda partial: create(partial, content)) as partial:
        partial.replace(path)
    sync_folder(path.parent)


def create(path: Path, content: bytes) -> None:
    """Put `content` into a new file, on disk when this returns. Raises `OSError`, also if there is such a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with named(path), path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


REMEDIES = {
    errno.ENOSPC: "free some space on that disk",
    errno.EDQUOT: "free some space within your quota",
    errno.EFBIG: "allow larger files (ulimit -f), or use another file system",
    **dict.fromkeys((errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP), "use a local disk, whose file system can lock files"),
}
"""What to do about what a system refuses, by its number."""


def remedy(error: OSError) -> str:
    """Return what to do about it."""
    return REMEDIES.get(error.errno or 0, "correct that")


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Have what the system refuses in this block name a file, as it will be called, unless it names one."""
    try:
        yield
    except OSError as error:
        if error.filename is None and not TEMPORARY.fullmatch(path.name):
            error.filename = str(Path(*(part for part in path.parts if not TEMPORARY.fullmatch(part))))
        raise


@contextmanager
def locked(path: Path, timeout_s: float = -1) -> Iterator[None]:
    """Hold a lock file; its folder is made. Raises `filelock.Timeout`, and `OSError` where nothing can be held."""
    from filelock import FileLock

    # A file beside it would not be let go where the process is killed.
    lock = FileLock(path, timeout_s, fallback_to_soft=False)
    with named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a folder that becomes `out`, which is new or empty, when the block ends well, and vanishes otherwise."""
    with temporary(out.parent) as partial:
        yield partial
        partial.replace(out)
    sync_folder(out.parent)


def remove_folder(folder: Path) -> None:
    """Remove a folder, as far as that is possible, in one step: after a kill, what is left of it is temporary."""
    with suppress(OSError), temporary(folder.parent) as gone:
        folder.replace(gone)


def remove(path: Path) -> None:
    """Remove a file, a folder with all that it holds, or a link and not what it leads to. Raises `OSError`."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


@contextmanager
def temporary(folder: Path, make: Callable[[Path], object] = Path.mkdir) -> Iterator[Path]:
    """Yield what `make` makes in `folder`, removed unless moved, as is what killed processes left there."""
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.iterdir():
        if TEMPORARY.fullmatch(left.name):
            # What is held by a process is on its way; what cannot be removed is left to the next.
            with suppress(OSError), ExitStack() as holding:
                if _lock(left, holding, surely=True):
                    _remove(left)
    with ExitStack() as holding:
        while True:
            path = folder / f".palpate-{secrets.token_hex(8)}"
            holding.callback(_remove, path)
            make(path)
            # Otherwise another process came between, which removes what is left.
            if _lock(path, holding):
                break
        yield path


def _lock(path: Path, holding: ExitStack, *, surely: bool = False) -> bool:
    """Lock a file or folder, not a link, until `holding` ends; return False if another process has it.

    A network's file system may have no such lock; nothing is held `surely` there.
    """
    if sys.platform == "win32":
        return not surely
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    holding.callback(os.close, descriptor)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return not surely
    return os.fstat(descriptor).st_nlink > 0


def _remove(path: Path) -> None:
    """Remove a file or folder, no link's target, as far as that is possible."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


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
    """Put `content` at `path`, whole and on disk, unless it is there. Raises `DatasetError` if the disk refuses."""
    try:
        if path.is_symlink() or not path.is_file() or path.read_bytes() != content:
            write(path, content)
    except OSError as error:
        raise DatasetError(
            f"cannot write {path}: {error.strerror}", remedy="check its folder and the free space"
        ) from error


def json_bytes(content: Mapping[str, object]) -> bytes:
    """Return a JSON object as UTF-8 text, two spaces deep, keys in the order given."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a JSON object as `json_bytes` gives it. Raises `DatasetError` if the file system refuses."""
    write_bytes(path, json_bytes(content))


def protocol_path(dataset: Path, number: int = 1) -> Path:
    """Return where the protocol of a study's approval with this `number` is kept inside its dataset."""
    return dataset / "sourcedata" / ("protocol.toml" if number == 1 else f"protocol-{number}.toml")


def protocol_paths(dataset: Path) -> Iterator[Path]:
    """Yield the file of the protocol of each approval that is there, the first one's first."""
    number = 1
    while (path := protocol_path(dataset, number)).exists():
        yield path
        number += 1


def plan_path(dataset: Path) -> Path:
    """Return where the plan of a rehearsal or of practice stands; a dataset without it is of neither."""
    return dataset / "sourcedata" / "rehearsal.json"


def seed_path(dataset: Path) -> Path:
    """Return where the one seed that names every draw of a study, and what the study is for, stand in its dataset."""
    return dataset / "sourcedata" / "seed.json"


def shared_path(dataset: Path) -> Path:
    """Return where a copy that was shared has the list of its files; another dataset has none."""
    return dataset / "sourcedata" / "shared.json"


def shared_label_path(dataset: Path, participant: str) -> Path:
    """Return where the labels of a participant in shared copies stand, by the copy's anchor, if they are kept."""
    return participant_folder(dataset, participant) / f"sub-{participant}_shared.json"


def roster_path(dataset: Path) -> Path:
    """Return where the roster of a study stands inside its dataset."""
    return dataset / "sourcedata" / "roster.jsonl"


def size(path: Path) -> int:
    """Return how many bytes a file has; none if it is not there, or is a link that leads nowhere."""
    return path.stat().st_size if path.exists() else 0


def journals(dataset: Path) -> list[Path]:
    """Return the journals of a dataset, by participant and task."""
    return sorted((dataset / "sourcedata").glob("sub-*/sub-*_journal.jsonl"))


def people_folder(dataset: Path) -> Path:
    """Make the folder of what participants gave, and return it: its owner alone may enter."""
    folder = dataset / "sourcedata"
    folder.mkdir(parents=True, exist_ok=True)
    owners_alone(folder)
    return folder


def owners_alone(path: Path) -> None:
    """Restrict a new file or folder to its owner, and to its group where the umask shares with groups."""
    mode = path.stat().st_mode
    path.chmod(mode & ~(0o007 if mode & 0o020 else 0o077))


def participant_folder(dataset: Path, participant: str) -> Path:
    """Return where everything of a participant's sessions stands inside a dataset."""
    return dataset / "sourcedata" / f"sub-{participant}"


def journal_path(dataset: Path, participant: str, task: str) -> Path:
    """Return where the journal of a session stands inside a dataset."""
    return participant_folder(dataset, participant) / f"sub-{participant}_task-{task}_journal.jsonl"


def voices_folder(dataset: Path, participant: str) -> Path:
    """Return where the sound of a participant's answers is kept, where it is: among what nobody else is given."""
    return participant_folder(dataset, participant) / "voices"


def withdrawal_path(dataset: Path, participant: str) -> Path:
    """Return where the withdrawal of a participant without a journal is kept inside a dataset."""
    return participant_folder(dataset, participant) / f"sub-{participant}_withdrawn.json"


def left_of(dataset: Path, participant: str) -> list[Path]:
    """Return all that a dataset holds of a participant, but for the roster, their withdrawal, and a lock."""
    folder = participant_folder(dataset, participant)
    source = (*folder.glob("[!.]*"), *_on_their_way(folder))
    tables = dataset.glob(f"sub-{participant}")
    return [path for path in (*source, *tables) if path != withdrawal_path(dataset, participant)]


def left_of_session(dataset: Path, label: str, task: str) -> list[Path]:
    """Return every file that a dataset holds of one session, with what a second rater said of the label's sound."""
    places = (participant_folder(dataset, label), *dataset.glob(f"sub-{label}/*"))
    own = [path for place in places for path in place.glob(f"sub-{label}_task-{task}_*")]
    sound = list(voices_folder(dataset, label).glob(f"task-{task}_*"))
    return [*own, *sound, *(voices_folder(dataset, label).glob("*.log") if sound else ())]


def facts_path(dataset: Path, participant: str) -> Path:
    """Return where what a participant was asked about themselves stands inside a dataset."""
    return participant_folder(dataset, participant) / f"sub-{participant}_facts.json"


def answers_of(dataset: Path, participant: str) -> list[Path]:
    """Return every file that may hold what a participant was asked about themselves, with what a kill left."""
    folder = participant_folder(dataset, participant)
    return sorted([*folder.glob(f"sub-{participant}_facts*.json"), *_on_their_way(folder)])


def _on_their_way(folder: Path) -> Iterator[Path]:
    return (path for path in folder.glob(".palpate-*") if TEMPORARY.fullmatch(path.name))


def rig_path(journal_file: Path) -> Path:
    """Return where the rig file of a session stands, beside its journal."""
    return journal_file.with_name(journal_file.name.replace("_journal.jsonl", "_rig.toml"))


RAW = ("foot.cobs", "force.bin")
"""How the file of what a session recorded beside its journal ends: the tracker's frames, or a servo's force."""


def raw_path(journal_file: Path, end: str) -> Path:
    """Return where a file of raw data of a session stands, beside its journal; `end` is one of `RAW`."""
    return journal_file.with_name(journal_file.name.replace("_journal.jsonl", f"_{end}"))


def foot_path(journal_file: Path) -> Path:
    """Return where the raw tracker frames of a session stand, beside its journal."""
    return raw_path(journal_file, RAW[0])


def refuse_other_format(root: Path) -> None:
    """Raise `OtherFormat` for a dataset of another format; unreadable files are left to later checks."""
    settled = ((seed_path(root), "seed"), (plan_path(root), "participants"))
    stated = [(path, found.get("format")) for path, key in settled if key in (found := _object(path))]
    tables = root / "dataset_description.json"
    if isinstance(facts := _object(tables).get("Palpate"), dict):
        stated.append((tables, facts.get("Format")))
    for path, got in stated:
        if (other := other_format(path, "dataset", got, get_args(DatasetFormat))) is not None:
            raise other


def _object(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file, an empty one where there is none."""
    try:
        content = json_of(read_bytes(path))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
