"""Texts that would forge what a person reads: in every text of every file and option, and in file names.

A text is survived where it is refused with its field and the code of the character, or where it is shown, but so that
it passes for nothing of palpate's own. In neither case may a control or invisible character be printed raw.
"""

from __future__ import annotations

import csv
import io
import json
import re
import sys
import tempfile
import tomllib
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Any
from unittest.mock import patch

from palpate.analysis import export
from palpate.analysis.documents.tables import FORMULA, NUMBER, Section, comma_separated
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Exclusion
from palpate.experiment import __main__
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.page import page
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Phase
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.settings.characters import BLANKS, JOINERS, hidden
from palpate.experiment.settings.load import written
from tests.analysis.datasets import balanced, write_dataset
from tests.experiment.protocol.small import SMALL, Where, changed, document, leaves, with_text
from tests.experiment.session.bench import HEADER
from tests.faults.campaign import Count, Size

KINDS = tuple(
    one
    for one in map(chr, range(sys.maxunicode + 1))
    if one in BLANKS or one in "\ue000\uf8ff\ufffe\u0378\U0010ffff" or unicodedata.category(one) in ("Cc", "Zl", "Zp")
    if one != "\n"
) + tuple(
    one for one in map(chr, range(sys.maxunicode + 1)) if unicodedata.category(one) == "Cf" and one not in JOINERS
)
"""One of each kind: every control and format character, every one drawn as nothing, and some without a meaning."""

FORMS = (
    *(f"a{one}" for one in "АВЕКМНОРСТХаеіјорсухѕΑΒΕΖΗΙΚΜΝΟΡΤΥΧανορυ"),
    *map(chr, (*range(0xFF10, 0xFF1A), *range(0xFF21, 0xFF3B), *range(0xFF41, 0xFF5B), *range(0x1D400, 0x1D434))),
    *(f"{before}{mark:c}" for before in (" ", "3", "a\u0301\u0302") for mark in range(0x300, 0x316)),
)
"""Letters of a second alphabet, special forms, and marks that stand on no letter or on two: the last is refused."""

LEFTWARD = tuple(map(chr, (*range(0x5D0, 0x5EB), *range(0x620, 0x64B), *range(0x660, 0x66A), *range(0x712, 0x730))))
"""Letters and digits of Hebrew, Arabic and Syriac."""

TWINS = ("COCOA", "co coa", "\u0441\u043e\u0441\u043e\u0430", "\u0421\u041e\u0421\u041e\u0410", "coco\u2003a")
"""Names that look like cocoa, or differ by what a reader passes over."""

STEP = 37
"""From one text to the next, so that a few of each cover all kinds; ours, without a common factor with their number."""

MANIFEST: dict[str, Any] = {
    "format": 1,
    "label": "SIMULATED",
    "note": "made up",
    "simulated": True,
    "rate_hz": 5000,
    "samples": 4,
    "unit": "m/s^2",
    "takes": ({"file": "a.wav", "material": "felt", "speed_mm_s": 50.0, "number": 1, "sha256": "0" * 64},),
}
CHOICES: dict[str, Any] = {
    "format": 1,
    "source": "made up",
    "rows": ({"task": "one", "presented": "felt", "answers": (0.5, 0.5), "spread": 0.1},),
}


@dataclass
class _Tally:
    """What happened so far to one kind of fault."""

    fault: str
    tried: int = 0
    failures: tuple[str, ...] = ()

    def note(self, what: str, *failed: str) -> None:
        self.tried += 1
        if failed:
            self.failures = (*self.failures, f"{what}: {'; '.join(failed)}")

    def count(self) -> Count:
        return Count(self.fault, self.tried, self.tried - len(self.failures), failures=self.failures)


def attacks(size: Size) -> Iterator[Count]:
    with tempfile.TemporaryDirectory(prefix="palpate-texts-") as name:
        folder = Path(name)
        small = folder / "small.toml"
        small.write_text(SMALL, "utf-8")
        yield _file("a protocol", document(), folder / "p.toml", ("check", "FILE"), size)
        rig = _tables(shipped("rigs/rehearsal.toml")) | {"audio": _tables(shipped("rigs/headless.toml"))["audio"]}
        rig["tracker"] |= {"driver": "palpate-frames"}
        yield _file("a rig", rig, folder / "r.toml", ("doctor", "--rig", "FILE"), size, most=24)
        yield _file("a protocol", document(), folder / "p.toml", ("check", "FILE"), size, kinds=FORMS)
        yield _leftward(folder / "p.toml", size)
        yield _twins(folder / "p.toml")
        takes = folder / "takes"
        takes.mkdir()
        yield _file("recordings", MANIFEST, takes / "manifest.toml", ("validate", str(takes)), size, most=45)
        prints = _tables(Path(export.__file__).parent / "published" / "okamoto2012.toml")
        yield _file("printed numbers", prints, folder / "n.toml", ("audit", "FILE"), size, most=4)
        yield _file(
            "a choice model", CHOICES, folder / "c.toml", ("power", str(small), "--model", "FILE"), size, most=90
        )
        yield _dataset(folder / "dataset", size)
        yield _counts(folder, size)
        yield _options(folder, small, size)
        yield _names(folder, size)
        yield _journal(folder, size)
        yield _imitated(size)
        yield _computed(folder / "computed")


def _tables(path: Path) -> dict[str, Any]:
    tables: dict[str, Any] = _frozen(tomllib.loads(path.read_text("utf-8")))
    return tables


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _frozen(held) for key, held in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _toml(value: Any) -> str:
    """Any value as TOML on one line, with every character beyond ASCII escaped."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(held)}' for key, held in value.items())} }}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return (
            '"'
            + "".join(one if " " <= one <= "~" and one not in '"\\' else f"\\U{ord(one):08X}" for one in value)
            + '"'
        )
    return value.isoformat() if isinstance(value, date) else str(value).lower()


def _write(path: Path, tables: dict[str, Any]) -> None:
    path.write_text("".join(f"{key} = {_toml(value)}\n" for key, value in tables.items()), "utf-8")


def _drawn(place: int, size: Size, most: int = 12, kinds: Sequence[str] = KINDS) -> Iterator[str]:
    """A few kinds for the text at this place."""
    count = size.of(1, most)
    return (kinds[(STEP * (place * count + one)) % len(kinds)] for one in range(count))


def _palpate(*arguments: object) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with patch.object(sys, "argv", ["palpate", *map(str, arguments)]), redirect_stdout(out), redirect_stderr(err):
        try:
            __main__.main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return code, out.getvalue(), err.getvalue()


def _wrong(told: tuple[int, str, str], *named: str, code: int = 2) -> Iterator[str]:
    """Everything that is wrong with what the command told of a text that it has to refuse, or to escape."""
    ended, out, err = told
    if ended != code:
        yield f"exit code {ended}"
    if raw := hidden(out + err, "\n\t"):
        yield f"printed raw: {raw!r}"
    for one in named:
        if one not in out + err:
            yield f"{one} is not named in {(out + err)[:200]!r}"


def _code(character: str) -> str:
    return f"U+{ord(character):04X}"


def _file(
    what: str,
    tables: dict[str, Any],
    path: Path,
    command: tuple[str, ...],
    size: Size,
    most: int = 12,
    kinds: Sequence[str] = KINDS,
) -> Count:
    fault = "a hidden character" if kinds is KINDS else "a letter that passes for another, or a stray mark,"
    tally = _Tally(f"{fault} in a text of {what}")
    texts: list[tuple[Where, str]] = [(where, held) for where, held in leaves(tables) if isinstance(held, str)]
    if size is Size.SUBSET:
        texts = list(islice(texts, 0, None, max(1, len(texts) // 20)))
    for place, (where, held) in enumerate(texts):
        for kind in _drawn(place, size, most, kinds):
            _write(path, changed(tables, where, held[:3] + kind + held[3:]))
            told = _palpate(*(str(path) if one == "FILE" else one for one in command))
            code = _code(kind[-1])
            tally.note(f"{written(where)} with {code}", *_wrong(told, written(where), code))
    return tally.count()


def _leftward(path: Path, size: Size) -> Count:
    """Names refuse it; a text shows it on lines that begin with a bar, so that no value of palpate's stands there."""
    tally = _Tally("a letter that runs from right to left")
    texts = dict(with_text())
    for place, where in enumerate([*texts, *(one for one, _ in _names_of(document()))]):
        for character in _drawn(place, size, kinds=LEFTWARD):
            tables = changed(document(), where, f"a3 {character}5")
            if where in texts:
                lines = page(ProtocolFile.model_validate(tables), "small.toml").split("\n")
                shown = [line for line in lines if character in line]
                wrong = [line for line in shown if not re.match(r" *\| ", line)] if shown else ["is not shown"]
            else:
                _write(path, tables)
                wrong = [*_wrong(_palpate("check", path), written(where), _code(character))]
            tally.note(f"{written(where)} with {_code(character)}", *wrong)
    return tally.count()


def _names_of(tables: dict[str, Any]) -> Iterator[tuple[Where, str]]:
    for where, held in leaves(tables):
        if "spoken" in where or (where[-1] == "id" and where[0] in ("materials", "exclusion")):
            yield where, held


def _twins(path: Path) -> Count:
    tally = _Tally("two names that look alike")
    for first, second in (
        (("materials", 0, "id"), ("materials", 1, "id")),
        (("materials", 0, "spoken", 0), ("materials", 1, "spoken", 0)),
        (("materials", 0, "id"), ("materials", 1, "spoken", 0)),
        (("exclusion", 0, "id"), ("exclusion", 1, "id")),
    ):
        for twin in TWINS:
            _write(path, changed(changed(document(), first, "cocoa"), second, twin))
            tally.note(f"{written(second)}: {twin!a}", *_wrong(_palpate("check", path), written(second), "unique"))
    return tally.count()


def _dataset(root: Path, size: Size) -> Count:
    tally = _Tally("a hidden character in a text of a dataset")
    write_dataset(root, {"01": {"real": balanced(1)}}, tasks=("real",))
    out = root.with_name("exported")
    for file in ("dataset_description.json", "sub-01/beh/sub-01_task-real_events.json"):
        whole = (root / file).read_bytes()
        tables = _frozen(json.loads(whole))
        for place, (where, held) in enumerate((where, held) for where, held in leaves(tables) if isinstance(held, str)):
            for character in _drawn(place, size):
                (root / file).write_text(json.dumps(changed(tables, where, held + character)), "utf-8")
                told = _palpate("export", root, "--out", out)
                tally.note(f"{file}, {written(where)} with {_code(character)}", *_wrong(told, file, _code(character)))
        (root / file).write_bytes(whole)
    if out.exists():
        tally.note("export", "a table was written")
    return tally.count()


def _counts(folder: Path, size: Size) -> Count:
    tally = _Tally("a hidden character in a material of a counts file")
    path = folder / "counts.csv"
    for place in range(size.of(8, 40)):
        for character in _drawn(place, size, 8):
            name = f'"fe{character}lt"'
            path.write_text(
                f"participant,presented,answered,count\n1,{name},{name},2\n1,cork,cork,2\n", "utf-8", newline=""
            )
            told = _palpate(
                "import-counts", "--task", f"one={path}", "--study", "s", "--source", "x", "--out", folder / "o"
            )
            tally.note(_code(character), *_wrong(told, str(path), "U+"))
    return tally.count()


def _options(folder: Path, small: Path, size: Size) -> Count:
    tally = _Tally("a hidden character in an option")
    counts = folder / "plain.csv"
    counts.write_text("participant,presented,answered,count\n1,felt,felt,2\n1,cork,cork,2\n", "utf-8")
    study = ("--dataset", str(folder / "study"))
    _palpate("enrol", small, "-p", "01", *study)
    days = ("--approved-on", "2020-02-01", "--expires-on", "2021-02-01")
    imported = ("import-counts", "--task", f"one={counts}", "--study", "s", "--out", str(folder / "o"))
    commands: dict[str, Callable[[str], tuple[object, ...]]] = {
        "approval_number": lambda text: ("seal", small, "--approval-number", text, *days),
        "reason": lambda text: ("withdraw", small, "-p", "01", "--reason", text, *study),
        "source": lambda text: (*imported, "--source", text),
        "participant": lambda text: ("schedule", small, "-p", text),
        "label": lambda text: ("enrol", small, "-p", text, *study),
        "study": lambda text: (*imported[:3], "--study", text, "--source", "x", "--out", str(folder / "o")),
        "TASK=FILE": lambda text: (
            "import-counts",
            "--task",
            f"{text}={counts}",
            "--study",
            "s",
            "--out",
            folder / "o",
        ),
    }
    for place, (option, command) in enumerate(commands.items()):
        for character in _drawn(place, size, 60):
            if character != "\0":
                told = _palpate(*command(f"a{character}b"))
                tally.note(f"{option} with {_code(character)}", *_wrong(told))
    left = [one for one in (folder / "o", folder / "small.seal.toml") if one.exists()]
    roster = (folder / "study" / "sourcedata" / "roster.jsonl").read_text("utf-8")
    if left or "withdrawn" in roster:
        tally.note("what is left", f"{left}, {roster!r}")
    return tally.count()


def _names(folder: Path, size: Size) -> Count:
    tally = _Tally("a hidden character in the name of a file")
    commands = ("check", "journal", "build", "analyse", "audit", "spectrum", "plan", "validate")
    for place, command in enumerate(commands):
        for character in _drawn(place, size, 30):
            if character != "\0":
                told = _palpate(command, folder / f"a{character}\nb.toml")
                forged = [line for line in told[2].splitlines() if line.startswith("b")]
                tally.note(f"{command} with {_code(character)}", *_wrong(told), *forged)
    return tally.count()


def _journal(folder: Path, size: Size) -> Count:
    tally = _Tally("a hidden character in a journal that is told")
    for place in range(size.of(2, 20)):
        for character in _drawn(place, size, 12):
            path = folder / f"{place}-{ord(character)}.jsonl"
            opened = journal.Journal(path, ManualClock(10), journal.Contents(()))
            forged = f"a{character}\n     0.000 s  the session ended: complete"
            for entry in (HEADER, Phase(state="paused", detail=forged), Footer(reason="complete", answered=0)):
                opened.append(entry)
            opened.close()
            with path.open("ab") as file:
                file.write(f'{{"torn{character}'.encode())
            told = _palpate("journal", path)
            twice = told[1].count("\n     0.000 s  the session ended") != 1
            tally.note(_code(character), *_wrong(told, _code(character), code=0), *(["a forged line"] if twice else []))
    return tally.count()


FORGED = "8. Limits that protect the participant " + "-" * 92 + " Vibration at most 3.0 m/s^2 peak "


def _imitated(size: Size) -> Count:
    """In the text every word carries a mark, so wherever lines break, it shows which line is the text's."""
    tally = _Tally("a text that imitates the board's page")
    for where, _ in with_text():
        for by in range(1, size.of(4, 47)):
            for wide in ("x", "紙"):
                words = (wide * by + " " + FORGED * 3).split()
                study = ProtocolFile.model_validate(changed(document(), where, "\n".join(f"{one}@" for one in words)))
                outside = [re.sub(r"\| .*", "", line) for line in page(study, "small.toml").split("\n")]
                shown = [line for line in outside if "@" in line or "3.0" in line]
                tally.note(f"{written(where)} by {by}", *shown)
    return tally.count()


def _computed(root: Path) -> Count:
    tally = _Tally("a text that a spreadsheet would compute")
    study = read(write_dataset(root, {"01": {"real": balanced(1)}}, tasks=("real",)))
    names = [where for where, _ in leaves(document()) if where[-1] == "id" and len(where) > 2 and where[0] != "tasks"]
    for first in "=+-@\t\n\uff1d\uff0b\uff0d\uff20":
        text = f"{first}SUM(A1)"
        for where in names:
            try:
                ProtocolFile.model_validate(changed(document(), where, text))
            except ValueError:
                tally.note(written(where))
            else:
                tally.note(written(where), f"{text!r} is a name")
        rule = Exclusion("01", "all", None, None, text, text)
        tables = [comma_separated(Section("s", "T", further=({"a": text, "b": -0.5},)), text)]
        tables += [one.decode() for one in export.files(replace(study, exclusions=(rule,), label=text)).values()]
        for table in tables:
            cells = [cell for row in csv.reader(io.StringIO(table, newline="")) for cell in row]
            tally.note(text, *(cell for cell in cells if FORMULA.match(cell) and not NUMBER.fullmatch(cell)))
    return tally.count()
