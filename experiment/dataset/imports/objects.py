"""Trials as objects of named values, a row each, and a name a column: the JSON of jsPsych, and the log of E-Prime.

A file of JSON is one list of objects, one object with such a list, or JSON lines of either. An object in a cell has a
column of its own for each of its keys, as `response.Q0`. A log of E-Prime is frames, one for each time that a procedure
ran; what its header says is in all rows.
"""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.experiment.errors import DatasetError
from palpate.experiment.settings import delimited
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.delimited import Record, Stated, Table, Understood

HEADER, FRAME = "*** Header Start ***", "*** LogFrame Start ***"
"""How parts of a log of E-Prime begin."""


@dataclass(frozen=True)
class UnderstoodJson(Understood):
    """How a JSON file was read; rows are numbered from 1."""

    def sentence(self) -> str:
        """Return it for a reader, in one line."""
        return f"read as JSON, {self.encoding}; {self.rows} rows of {len(self.names)} columns"


@dataclass(frozen=True)
class UnderstoodFrames(Understood):
    """How a log was read."""

    def sentence(self) -> str:
        """Return it for a reader, in one line."""
        return f"read as an E-Prime log, {self.encoding}; {self.rows} frames of {len(self.names)} attributes"


def is_json(path: Path) -> bool:
    """Return whether a file begins as JSON does, or has its suffix."""
    try:
        with path.open("rb") as file:
            head = file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()
    except OSError:
        return False
    return head[:1] in (b"[", b"{") or path.suffix.lower() in (".json", ".jsonl")


def json_table(path: Path, stated: Stated) -> Table:
    """Return the objects of a JSON file as a table. Raises `PalpateError` for a file that has none."""
    text, encoding = delimited.decoded(delimited.content(path), path, stated)
    rows = [dict(_cells("", one)) for one in _objects(path, text)]
    header = tuple(dict.fromkeys(name for row in rows for name in row))
    records = tuple(
        Record(number, 0, [row.get(name, "") for name in header]) for number, row in enumerate(rows, start=1)
    )
    return Table(header, records, UnderstoodJson(encoding, "", ".", (), header, (), 1, len(rows)))


def _objects(path: Path, text: str) -> list[dict[str, Any]]:
    try:
        try:
            found = [json.loads(text, object_pairs_hook=_once)]
        except json.JSONDecodeError:
            found = [json.loads(line, object_pairs_hook=_once) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise DatasetError(
            path, f"cannot be read as JSON: {error}", "export it again", allowed="a list of objects, one per trial"
        ) from error
    rows = [one for held in found for one in _listed(held)]
    if not rows:
        raise DatasetError(path, "got JSON without trials", "give another file", allowed="a list of objects")
    return rows


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object. Raises `ValueError` where a key stands in it twice, of which one value would be lost."""
    held = dict(pairs)
    if len(held) < len(pairs):
        twice = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        raise ValueError(f"an object has the key {quoted(twice)} twice")
    return held


def _listed(held: Any) -> Iterator[dict[str, Any]]:
    """Yield the objects of a list, or of the only list in an object, or the object itself."""
    if isinstance(held, dict):
        lists = [one for one in held.values() if isinstance(one, list) and one and isinstance(one[0], dict)]
        if len(lists) == 1:
            yield from _listed(lists[0])
        else:
            yield held
    elif isinstance(held, list):
        for one in held:
            yield from _listed(one) if isinstance(one, list) else [one] if isinstance(one, dict) else []


def _cells(name: str, held: Any) -> Iterator[tuple[str, str]]:
    """Yield the names and texts of the cells of an object."""
    if isinstance(held, dict):
        if name:
            yield name, json.dumps(held, ensure_ascii=False)
        for key, value in held.items():
            yield from _cells(f"{name}.{key}" if name else str(key), value)
    elif held is None or isinstance(held, str):
        yield name, held or ""
    else:
        yield name, json.dumps(held, ensure_ascii=False)


def is_log(data: bytes) -> bool:
    """Return whether a file begins as a log of E-Prime does, in UTF-8 or UTF-16."""
    return HEADER.encode() in data[:200].replace(b"\0", b"")


def frames_table(path: Path, data: bytes, stated: Stated) -> Table:
    """Return the frames of a log, each at its line. Raises `PalpateError` for bytes that are no text."""
    text, encoding = delimited.decoded(data, path, stated)
    rows: list[tuple[int, dict[str, str]]] = []
    for line, one in enumerate(text.splitlines(), start=1):
        name, _, value = (part.strip() for part in one.partition(":"))
        if name in (HEADER, FRAME):
            rows.append((line, {}))
        elif rows and not name.startswith("***"):
            rows[-1][1][name] = value
    (_, header), *frames = rows
    names = tuple(dict.fromkeys(name for _, row in (*frames, rows[0]) for name in row if name))
    records = tuple(Record(line, 0, [row.get(name, header.get(name, "")) for name in names]) for line, row in frames)
    return Table(names, records, UnderstoodFrames(encoding, "", ".", (), names, (), 1, len(records)))
