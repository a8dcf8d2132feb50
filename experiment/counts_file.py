"""Counts files: how often each participant gave each answer to each material, CSV."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from experiment.errors import DatasetError
from experiment.event_columns import NO_ANSWER

COLUMNS = ("participant", "presented", "answered", "count")
"""Header of a counts file."""

MAX_COUNT = 10_000
"""A count above this is taken for a slip of the pen."""

Counts = Mapping[int, Mapping[tuple[str, str], int]]
"""participant number -> (presented, answered) -> count"""


def parse_task(text: str) -> tuple[str, Path]:
    """`TASK=FILE` as task id and counts file.

    Raises:
        DatasetError: for any other text.
    """
    task, equals, file = text.partition("=")
    if not (equals and file and re.fullmatch(r"[a-z][a-z0-9]*", task)):
        raise DatasetError(f"got {text!r}; allowed: TASK=FILE, the task in lower-case letters and digits; mend it")
    return task, Path(file)


def read_counts(path: Path, materials: Sequence[str]) -> Counts:
    """Read a counts file: CSV with the header of `COLUMNS`, answers from `materials` or `event_columns.NO_ANSWER`.

    Participants are whole numbers, with or without zeros before them, but each in one way throughout the file.

    Raises:
        DatasetError: naming file and line, for anything that is not such a file.
    """
    lines = csv.reader(_text(path).splitlines(), strict=True)
    counts: dict[int, dict[tuple[str, str], int]] = {}
    spelt: dict[int, str] = {}
    try:
        header = next(lines, [])
        if tuple(header) != COLUMNS:
            raise DatasetError(f"{path}: line 1: got header {','.join(header)!r}; allowed: {','.join(COLUMNS)}")
        for row in lines:
            where = f"{path}: line {lines.line_num}"
            participant, cell, count = _row(row, where, materials)
            if (spelling := spelt.setdefault(participant, row[0])) != row[0]:
                raise DatasetError(f"{where}: participant: got {row[0]!r}, {spelling!r} above; write one of them")
            if cell in counts.setdefault(participant, {}):
                raise DatasetError(f"{where}: participant {participant}, {cell} stands twice; keep one of the lines")
            counts[participant][cell] = count
    except csv.Error as error:
        raise DatasetError(f"{path}: line {lines.line_num}: {error}; write plain CSV") from error
    if not counts:
        raise DatasetError(f"{path}: no counts below the header; give one line a cell")
    return counts


def materials_of(path: Path) -> tuple[str, ...]:
    """Every material that a counts file presents, in its order.

    Raises:
        DatasetError: it cannot be read.
    """
    rows = csv.DictReader(_text(path).splitlines())
    return tuple(dict.fromkeys(row["presented"] for row in rows if row.get("presented")))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read ({error}); give a CSV file of counts in UTF-8") from error


def _row(row: list[str], where: str, materials: Sequence[str]) -> tuple[int, tuple[str, str], int]:
    if len(row) != len(COLUMNS):
        raise DatasetError(f"{where}: got {len(row)} fields; allowed: {len(COLUMNS)}, {','.join(COLUMNS)}")
    participant, presented, answered, count = row
    if not re.fullmatch(r"0{0,5}[1-9][0-9]{0,5}", participant):
        raise DatasetError(f"{where}: participant: got {participant!r}; allowed: a whole number from 1 to 999999")
    if presented not in materials:
        raise DatasetError(f"{where}: presented: got {presented!r}; allowed: {', '.join(materials)}")
    if answered not in (*materials, NO_ANSWER):
        raise DatasetError(f"{where}: answered: got {answered!r}; allowed: {', '.join((*materials, NO_ANSWER))}")
    if not re.fullmatch(r"[0-9]{1,5}", count) or int(count) > MAX_COUNT:
        raise DatasetError(f"{where}: count: got {count!r}; allowed: a whole number from 0 to {MAX_COUNT}")
    return int(participant), (presented, answered), int(count)
