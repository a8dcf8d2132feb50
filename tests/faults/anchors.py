"""Datasets that somebody made anew, whole and consistent, or lost parts of: what `palpate verify` says of each."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, register, verify
from palpate.experiment.dataset.verify import Report
from palpate.experiment.errors import PalpateError
from palpate.experiment.records import chain, journal
from tests.experiment.dataset.studies import make_study
from tests.faults.campaign import Count, Size

Change = Callable[[dict[str, Any]], object]


def later(line: dict[str, Any]) -> None:
    """A change that every line can bear: it was written a nanosecond later."""
    line["t_ns"] += 1


def forge(root: Path, path: Path, number: int, change: Change = later) -> None:
    """Change a line, counted from 1, of a journal or the roster, and make anew all that knows its hash but anchors."""
    old = register.line_hashes(path)
    _rechain(path, lambda n, line: change(line) if n == number else None)
    if path == storage.roster_path(root):
        new = dict(zip(old, register.line_hashes(path), strict=True))
        for one in storage.journals(root):
            _rechain(one, lambda n, line: _renamed(line["entry"], new) if n == 1 else None)


def _renamed(header: dict[str, Any], new: dict[str, str]) -> None:
    header["roster_sha256"] = new[header["roster_sha256"]]


def _rechain(path: Path, change: Callable[[int, dict[str, Any]], object]) -> None:
    last, lines = "0" * 64, []
    for number, text in enumerate(path.read_bytes().splitlines(), start=1):
        line = json.loads(text)
        change(number, line)
        line["prev"] = last
        lines.append(json.dumps(line, separators=(",", ":"), ensure_ascii=False).encode())
        last = hashlib.sha256(lines[-1]).hexdigest()
    path.write_bytes(b"".join(line + b"\n" for line in lines))
    chain.head_path(path).write_text(f"{len(lines):012d} {last}\n")


HIDES: dict[str, Callable[[bytes, bytes, int], bytes]] = {
    "between carriage returns": lambda line, old, number: b'{"entry":' + b"\r" * (number - 2) + old + b"\r," + line[1:],
    "under a key of its own": lambda line, old, number: line[:-1] + b',"was":' + old + b"}",
    "under a key that comes twice": lambda line, old, number: b'{"entry":' + old + b"," + line[1:],
    "behind blanks": lambda line, old, number: line + b" " * number,
}
"""How a file may hold its old last line, as JSON allows: the new second line, the old last one and its number -> what
takes the second line's place."""


def smuggle(path: Path, hide: Callable[[bytes, bytes, int], bytes]) -> None:
    """Change every answer of a journal, and hide its old last line in the second, so that an anchor may find it."""
    *old, _ = path.read_bytes().split(b"\n")
    last, lines = "0" * 64, []
    for number, text in enumerate(old, start=1):
        document = json.loads(text)
        if document["entry"]["kind"] == "answer":
            document["entry"] |= {"answered": None, "key": "n"}
        document["prev"] = last
        line = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
        lines.append(hide(line, old[-1], len(old)) if number == 2 else line)
        last = hashlib.sha256(lines[-1]).hexdigest()
    path.write_bytes(b"".join(line + b"\n" for line in lines))
    chain.head_path(path).write_text(f"{len(lines):012d} {last}\n")


@dataclass
class _Tally:
    fault: str
    tried: int = 0
    failures: list[str] = field(default_factory=list)

    def add(self, case: str, survived: bool, report: Report) -> None:
        self.tried += 1
        if not survived:
            told = "; ".join(
                f"{one.verdict} {one.place()}: {one.clause()}" for one in report.findings if one.verdict != "passes"
            )
            self.failures.append(f"{self.fault}: {case}: {told} {' '.join(report.verdict)}")

    def count(self) -> Count:
        lost = len(self.failures)
        return Count(self.fault, self.tried, self.tried - lost, lost, tuple(self.failures))


@dataclass
class _Bench:
    """A sound dataset, copied for each attack, and a register outside of it."""

    folder: Path
    participants: int

    def __post_init__(self) -> None:
        made = make_study(self.folder / "study", enrolled=self.participants, sessions=self.participants)
        self.sound, self.register = made.root, self.folder / "register"
        self.files = [*storage.journals(self.sound), storage.roster_path(self.sound)]
        self.number = self.anchor(self.sound)

    def anchor(self, root: Path) -> str:
        """Anchor a dataset in the register, not in its own log, and return the number."""
        anchor = checks.anchor(root)
        register.enter(anchor, root, self.register, None)
        return anchor.number

    def copy(self) -> Path:
        root = self.folder / "attacked"
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(self.sound, root)
        return root

    def lines(self) -> Iterator[tuple[Path, str, int]]:
        """Every line of every journal and of the roster, each in a fresh copy."""
        for file in self.files:
            for number in range(1, len(register.line_hashes(file)) + 1):
                root = self.copy()
                yield root, file.relative_to(self.sound).as_posix(), number


def attacks(size: Size) -> Iterator[Count]:
    with tempfile.TemporaryDirectory() as folder:
        bench = _Bench(Path(folder), size.of(2, 5))
        yield from _made_anew(bench)
        yield from _answers(bench, size)
        yield _smuggled(bench)
        yield _cut(bench, size)
        yield _lost(bench)
        yield _register(bench, size)


def _said(report: Report, file: str, number: int) -> bool:
    """Whether the report refuses a file for a line, or for a stretch of lines that holds it.

    Whoever makes a line of the roster anew has to make every journal anew too, which names its last line. Then a
    register of a single anchor agrees with no line, and says so.
    """
    foreign = any(one.verdict == "refuses" and one.clause() == verify.FOREIGN for one in report.findings)
    if foreign and file.endswith("roster.jsonl"):
        return True
    for one in report.findings:
        if one.verdict == "refuses" and one.place() == file:
            named = [int(digits) for digits in re.findall(r"(?:lines?|from|to) (\d+)", one.clause())]
            if named and min(named) <= number <= max(named):
                return True
    return False


def _not_proven(report: Report) -> bool:
    return not report.refused and any(sentence.startswith("NOT PROVEN") for sentence in report.verdict)


def _made_anew(bench: _Bench) -> Iterator[Count]:
    with_anchor = _Tally("a line made anew, chain and heads too, with an anchor outside: refused, and named")
    without = _Tally("the same without an anchor: told as not proven")
    for root, file, number in bench.lines():
        forge(root, root / file, number)
        case = f"{file} line {number}"
        without.add(case, _not_proven(report := verify.verify(root)), report)
        with_anchor.add(case, _said(report := verify.verify(root, [bench.register]), file, number), report)
    yield from (with_anchor.count(), without.count())


def _answers(bench: _Bench, size: Size) -> Iterator[Count]:
    with_anchor = _Tally("an answer changed, chain, heads and tables made anew, with an anchor: refused")
    without = _Tally("the same without an anchor: told as not proven")

    def other(line: dict[str, Any]) -> None:
        line["entry"]["answered"] = "typing paper" if line["entry"]["answered"] != "typing paper" else "copy paper"

    cases = [
        (path, number)
        for path in storage.journals(bench.sound)
        for number, entry in enumerate(journal.read(path).entries, start=1)
        if entry.kind == "answer"
    ]
    for path, number in cases[: size.of(2, len(cases))]:
        root = bench.copy()
        file = path.relative_to(bench.sound).as_posix()
        forge(root, root / file, number, other)
        build.build(root)
        without.add(f"{file} line {number}", _not_proven(report := verify.verify(root)), report)
        report = verify.verify(root, [bench.register])
        with_anchor.add(f"{file} line {number}", _said(report, file, number), report)
    yield from (with_anchor.count(), without.count())


def _smuggled(bench: _Bench) -> Count:
    tally = _Tally("answers changed and the anchored line hidden in another, with an anchor: refused, and named")
    for path in storage.journals(bench.sound):
        for how, hide in HIDES.items():
            root = bench.copy()
            file = path.relative_to(bench.sound).as_posix()
            smuggle(root / file, hide)
            with suppress(PalpateError):
                build.build(root)
            report = verify.verify(root, [bench.register])
            tally.add(f"{file} {how}", _said(report, file, 2), report)
    return tally.count()


def _cut(bench: _Bench, size: Size) -> Count:
    """Lines cut from the end, the head written for what is left, and the same from the roster."""
    tally = _Tally("lines cut off, the head made anew, with an anchor: refused, and named")
    for root, file, number in bench.lines():
        if size is Size.SUBSET and number % 4:
            continue
        path = root / file
        path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[: number - 1]))
        _rechain(path, lambda n, line: None)
        report = verify.verify(root, [bench.register])
        tally.add(
            f"{file} from line {number}",
            any(file == one.place() for one in report.findings if one.verdict == "refuses"),
            report,
        )
    return tally.count()


def _lost(bench: _Bench) -> Count:
    """Every file deleted, one at a time, the dataset's own log of anchors too."""
    checks.keep_anchor(bench.sound)
    tally = _Tally("a file of a dataset deleted: refused, and named")
    for path in sorted(bench.sound.rglob("*")):
        file = path.relative_to(bench.sound).as_posix()
        # Without its `.gitattributes` a dataset is as it was: the file only speaks to Git.
        if path.is_dir() or path.suffix == ".lock" or path.name == ".gitattributes":
            continue
        root = bench.copy()
        (root / file).unlink()
        report = verify.verify(root)
        # That a log of anchors is not there is told: one has none before its first session ends.
        word = "unknown" if file == register.LOG.as_posix() else "refuses"
        named = any(path.name in f"{one.place()} {one.clause()}" for one in report.findings if one.verdict == word)
        tally.add(file, named, report)
    return tally.count()


def _register(bench: _Bench, size: Size) -> Count:
    """A bit changed in bytes all over the register: what its number in the lab book does not confirm proves nothing."""
    tally = _Tally("a bit of the register changed, its number in the lab book: refused")
    whole = bench.register.read_bytes()
    changed = bench.folder / "changed"
    for place in range(0, len(whole) - 1, size.of(97, 5)):
        data = bytearray(whole)
        data[place] ^= 1 << place % 7
        changed.write_bytes(data)
        try:
            report = verify.verify(bench.sound, [changed], [bench.number])
        except PalpateError as error:
            report = Report(str(error), (), ())
        tally.add(f"byte {place}", report.refused > 0, report)
    return tally.count()
