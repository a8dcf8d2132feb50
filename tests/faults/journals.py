"""Every truncation, bit and line of a journal and of a roster, and every journal that is not of its dataset."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, tables, verify
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.records import chain, journal
from palpate.experiment.study import roster, withdrawal
from tests.experiment.dataset.studies import MadeStudy
from tests.faults.campaign import Count, Size
from tests.faults.wrong import ALONE, WRONG, base, copied

Read = Callable[[Path], object]
Mutant = tuple[str, bytes]
"""What was done to a file, and what is in it then."""


def attacks(size: Size) -> Iterator[Count]:
    """Of a study with two sessions, three enrolments and a withdrawal."""
    with tempfile.TemporaryDirectory() as name:
        made = base(Path(name) / "study")
        yield from _wrong(made, Path(name), size)
        yield _alone(made, Path(name))
        withdrawal.withdraw(made.file, "02", "asked to stop", root=made.root, rebuild=build.build)
        for what, path, read in (
            ("journal", made.journal(), journal.read),
            ("roster", storage.roster_path(made.root), roster.Roster.load),
        ):
            yield from _changed(what, path, read, made.root, size)


def _wrong(made: MadeStudy, folder: Path, size: Size) -> Iterator[Count]:
    chosen = WRONG[:: size.of(4, 1)]
    check = "the check with which analyse, export, audit and power begin"
    answers: dict[str, list[tuple[str, str | None]]] = {check: [], "build": []}
    for number, wrong in enumerate(chosen):
        there = folder / f"wrong-{number}"
        study = copied(made, there / "study")
        wrong.act(study, there)
        answers[check].append((wrong.said, _refusal(tables.check_tables, study.root)))
        if wrong.mended:
            build.build(study.root)
            answers["build"].append(("^mended$", _refusal(tables.check_tables, study.root) or "mended"))
        else:
            answers["build"].append((wrong.said, _refusal(build.build, study.root)))
        shutil.rmtree(there)
    for by, said in answers.items():
        failures = tuple(
            f"{wrong.name}: {got or 'let in'}"
            for wrong, (pattern, got) in zip(chosen, said, strict=True)
            if got is None or not re.search(pattern, got)
        )
        let_in = sum(got is None for _, got in said)
        name = f"dataset: something wrong in it, by {by}"
        yield Count(name, len(chosen), len(chosen) - len(failures), let_in, failures)


def _alone(made: MadeStudy, folder: Path) -> Count:
    let_in = []
    for number, (name, act) in enumerate(ALONE.items()):
        study = copied(made, folder / f"alone-{number}")
        act(study, folder)
        verified = not _refused(_proven, study.root)
        if verified or not _refused(build.build, study.root):
            let_in.append(f"{name}: {'verify' if verified else 'build'}")
    fault = "dataset: a study's tables without what is behind them, by verify and build"
    return Count(fault, len(ALONE), len(ALONE) - len(let_in), len(let_in), tuple(let_in))


def _proven(root: Path) -> None:
    if verify.verify(root).refused:
        raise DatasetError("refused")


def _changed(what: str, path: Path, read: Read, root: Path, size: Size) -> Iterator[Count]:
    data, head = path.read_bytes(), chain.head_path(path).read_bytes()
    lines = data.split(b"\n")[:-1]
    older = [_head_of(lines[:count]) for count in range(1, len(lines))]
    sets: dict[str, Iterable[tuple[str, bytes, bytes | None]]] = {
        "truncated at any byte": ((*one, head) for one in _cut(data, size.of(97, 1))),
        "truncated at any byte, head deleted": ((*one, None) for one in _cut(data, size.of(97, 1))),
        "a bit of any byte flipped": ((*one, head) for one in _flipped(data, size.of(397, 1))),
        "a bit of any byte flipped, head deleted": ((*one, None) for one in _flipped(data, size.of(397, 1))),
        "a line deleted, doubled, swapped or edited": ((*one, head) for one in _lines(lines)),
        "a line deleted, doubled, swapped or edited, head deleted": ((*one, None) for one in _lines(lines)),
        "a line deleted or edited, chained anew": ((*one, head) for one in _chained_anew(lines)),
        "a line deleted or edited, chained anew, head deleted": ((*one, None) for one in _chained_anew(lines)),
        "the head deleted, emptied or two lines older": (
            (f"head {n}", data, one) for n, one in enumerate([None, b"", *older[:-1]])
        ),
        "a bit of the head flipped": ((name, data, one) for name, one in _flipped(head, size.of(29, 1))),
    }
    for name, mutants in sets.items():
        yield _count(f"{what}: {name}", mutants, path, read, root)
    yield _torn(f"{what}: the last line torn by a kill, reported", data, older[-1], path, read, size)
    _put(path, data, head)


def _count(fault: str, mutants: Iterable[tuple[str, bytes, bytes | None]], path: Path, read: Read, root: Path) -> Count:
    """Refused as the file is read, or when its dataset is."""
    tried = 0
    let_in: list[str] = []
    for name, data, head in mutants:
        tried += 1
        _put(path, data, head)
        if not _refused(read, path) and not _refused(checks.load_sound, root):
            let_in.append(f"{fault}: {name}")
    return Count(fault, tried, tried - len(let_in), len(let_in), tuple(let_in))


def _torn(fault: str, data: bytes, head: bytes, path: Path, read: Read, size: Size) -> Count:
    begin = data[:-1].rfind(b"\n") + 1
    failures = []
    places = range(begin + 1, len(data), size.of(7, 1))
    for place in places:
        _put(path, data[:place], head)
        found = read(path)
        torn = found.lines.end.torn if isinstance(found, roster.Roster) else getattr(found, "torn", b"")
        if torn != data[begin:place]:
            failures.append(f"{fault}: cut at {place}: {torn!r}")
    return Count(fault, len(places), len(places) - len(failures), len(failures), tuple(failures))


def _put(path: Path, data: bytes, head: bytes | None) -> None:
    path.write_bytes(data)
    if head is None:
        chain.head_path(path).unlink(missing_ok=True)
    else:
        chain.head_path(path).write_bytes(head)


def _refused(act: Callable[[Path], object], path: Path) -> bool:
    return _refusal(act, path) is not None


def _refusal(act: Callable[[Path], object], path: Path) -> str | None:
    """Return the words in which it is refused; None if it is let in."""
    try:
        act(path)
    except PalpateError as error:
        return str(error)
    return None


def _head_of(lines: list[bytes]) -> bytes:
    return f"{len(lines):012d} {hashlib.sha256(lines[-1]).hexdigest()}\n".encode()


def _cut(data: bytes, step: int) -> Iterator[Mutant]:
    for place in range(0, len(data), step):
        yield f"cut at {place}", data[:place]


def _flipped(data: bytes, step: int) -> Iterator[Mutant]:
    """Each bit of every so many bytes."""
    for place in range(0, len(data), step):
        for bit in range(8):
            changed = bytes([data[place] ^ 1 << bit])
            yield f"bit {bit} of byte {place}", data[:place] + changed + data[place + 1 :]


def _lines(lines: list[bytes]) -> Iterator[Mutant]:
    def joined(changed: list[bytes]) -> bytes:
        return b"".join(line + b"\n" for line in changed)

    for place, line in enumerate(lines):
        yield f"line {place} deleted", joined([*lines[:place], *lines[place + 1 :]])
        yield f"line {place} doubled", joined([*lines[: place + 1], *lines[place:]])
        yield f"line {place} edited", joined([*lines[:place], _edited(line), *lines[place + 1 :]])
        if place:
            swapped = [*lines[: place - 1], line, lines[place - 1], *lines[place + 1 :]]
            yield f"line {place} swapped", joined(swapped)


def _chained_anew(lines: list[bytes]) -> Iterator[Mutant]:
    """Without the head, which would need an anchor outside of the dataset to tell."""
    for place, line in enumerate(lines):
        for name, changed in (
            ("deleted", [*lines[:place], *lines[place + 1 :]]),
            ("edited", [*lines[:place], _edited(line), *lines[place + 1 :]]),
        ):
            last, out = chain.GENESIS, b""
            for number, one in enumerate(changed):
                document = {**json.loads(one), "n": number, "prev": last}
                written = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
                last = hashlib.sha256(written).hexdigest()
                out += written + b"\n"
            yield f"line {place} {name}", out


def _edited(line: bytes) -> bytes:
    """The time of the line is one more."""
    document = json.loads(line)
    return json.dumps({**document, "t_ns": document["t_ns"] + 1}, separators=(",", ":"), ensure_ascii=False).encode()
