"""Single trials from the CSV files that other software writes: PsychoPy, jsPsych, OpenSesame, Gorilla, a lab's own.

Rows whose column of materials is empty (instructions, breaks) are passed over and counted. The user says which column
holds what; a bad cell is refused with its line and column.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.settings.characters import quoted, skeleton
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated, Table, Understood, read_table

ABSENT = ("", "None", "null", "NA")
"""Cells in which nothing stands: empty, and as PsychoPy and OpenSesame, jsPsych, and R write it."""

MOST_MATERIALS = 64
"""More different cells than this are no materials: the column is another one."""

TOLD = 12
"""The most columns or values that an error lists."""


@dataclass(frozen=True)
class Layout:
    """Which column holds what.

    `answers`, `materials` and `people` translate cells of `answered`, `presented` and `participant`; `where` gives the
    cells that make a row a trial. At most one of `time_s` and `time_ms` names the column of response times.
    """

    presented: str
    answered: str
    participant: str
    task: str | None = None
    trial: str | None = None
    time_s: str | None = None
    time_ms: str | None = None
    answers: Mapping[str, str] = field(default_factory=dict)
    materials: Mapping[str, str] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)
    people: Mapping[str, str] = field(default_factory=dict)

    def columns(self) -> tuple[str, ...]:
        """Return every column that must be there, once."""
        named = (self.presented, self.answered, self.participant, self.task, self.trial, self.time_s, self.time_ms)
        return tuple(dict.fromkeys([*(one for one in named if one is not None), *self.where]))


@dataclass(frozen=True)
class Row:
    """One trial as its file has it: `file` is the place of the file among those given, and `line` where it begins."""

    file: int
    line: int
    participant: str
    task: str
    trial: int | None
    presented: str
    answered: str
    response_time_s: float | None


@dataclass(frozen=True)
class Trials:
    """Trials, the materials in the order of the tables, what stands for the material in each row `passed_over`, and how
    each file was read.
    """

    rows: tuple[Row, ...]
    materials: tuple[str, ...]
    passed_over: tuple[str, ...]
    read_as: tuple[Understood, ...]


def pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Return left -> right of the texts of an option, such as `f=felt`. Raises `DatasetError` for any other text."""
    found: dict[str, str] = {}
    for text in texts:
        left, equals, right = (part.strip() for part in text.rpartition("="))
        if not (equals and right) or left in found:
            again = " a second time" if left in found else ""
            raise DatasetError(option, f"got {quoted(text)}{again}", "correct it", allowed="LEFT=RIGHT, each LEFT once")
        found[left] = right
    return found


def read_trials(
    paths: Sequence[Path], layout: Layout, materials: Sequence[str] = (), stated: Stated = NOTHING_STATED
) -> Trials:
    """Return the trials in these files, in the order of files and lines.

    `materials` may be presented and answered, by default those presented, in alphabetical order. Raises `DatasetError`
    with file, line and column for an unreadable file, a missing or repeated column, a bad cell, a trial number twice in
    a participant's task, and without trials or two materials.
    """
    rows: list[Row] = []
    passed_over: list[str] = []
    if layout.presented == layout.answered:
        raise DatasetError(
            "--answered",
            f"got the column {layout.answered}, as --presented",
            "name that of the answers",
            allowed="another one",
        )
    tables = [_table(path, layout, stated) for path in paths]
    for number, (path, table) in enumerate(zip(paths, tables, strict=True), start=1):
        for row in _rows(path, number, layout, materials, table):
            if isinstance(row, Row):
                rows.append(row)
            else:
                passed_over.append(row)
    if not rows:
        raise DatasetError(
            ", ".join(map(str, paths)),
            f"got no trial: {layout.presented} is empty in every row that is taken",
            "name another column with --presented, or take other rows with --where",
        )
    known = tuple(materials) or tuple(sorted({row.presented for row in rows}))
    _check_materials(paths[0], layout, known)
    for row in rows:
        if row.answered not in (*known, NO_ANSWER):
            raise _refused(
                paths[row.file - 1], row.line, layout.answered, row.answered, _listed((*known, NO_ANSWER)),
                f"give --map {row.answered}=MATERIAL, or --material for what was never presented",
            )  # fmt: skip
    _refuse_twice(paths, layout, rows)
    return Trials(tuple(rows), known, tuple(passed_over), tuple(table.understood for table in tables))


def _table(path: Path, layout: Layout, stated: Stated) -> Table:
    times = [name for name in (layout.time_s, layout.time_ms) if name is not None]
    try:
        table = read_table(path, layout.columns(), times, stated)
    except PalpateError as error:
        raise DatasetError.saying(error) from error
    if not table.header:
        raise DatasetError(path, "got an empty file", "name another file", allowed="a header, and a row for each trial")
    _check_header(path, layout, table)
    return table


def _rows(path: Path, number: int, layout: Layout, materials: Sequence[str], table: Table) -> Iterator[Row | str]:
    """Yield each row below the header as a trial, or its material where it is none."""
    places = {name: table.header.index(name) for name in layout.columns()}
    for row in table.rows:
        yield _row(path, number, row.line, layout, materials, _Cells(places, row.cells, table))


@dataclass(frozen=True)
class _Cells:
    """The cells of a row of a table; a row that is too short ends in empty cells."""

    places: Mapping[str, int]
    cells: Sequence[str]
    table: Table

    @property
    def width(self) -> int:
        """Return how many columns the header has."""
        return len(self.table.header)

    def cell(self, column: str) -> str:
        place = self.places[column]
        return self.cells[place].strip() if place < len(self.cells) else ""

    @property
    def fits(self) -> bool:
        return len(self.cells) == self.width or (
            len(self.cells) > self.width and not any(cell.strip() for cell in self.cells[self.width :])
        )


def _row(path: Path, file: int, line: int, layout: Layout, materials: Sequence[str], cells: _Cells) -> Row | str:
    if any(cells.cell(column) != value for column, value in layout.where.items()):
        return ""
    shown = cells.cell(layout.presented)
    if shown in ABSENT and shown not in layout.materials and shown not in materials:
        return shown
    if not cells.fits:
        raise DatasetError(
            path,
            f"got {len(cells.cells)} cells under {cells.width} columns",
            "mend the line, or export the file again",
            allowed="as many",
            line=line,
        )
    presented = layout.materials.get(shown, shown)
    allowed = tuple(materials) or tuple(layout.materials.values())
    if allowed and presented not in allowed:
        raise _refused(
            path, line, layout.presented, shown, _listed(dict.fromkeys((*layout.materials, *allowed))),
            f"give --map-presented {shown}=MATERIAL",
        )  # fmt: skip
    participant = layout.people.get(cell := cells.cell(layout.participant), cell)
    if participant in ABSENT:
        raise _refused(path, line, layout.participant, participant, "who took part", "fill it in")
    task = "" if layout.task is None else cells.cell(layout.task)
    if layout.task is not None and task in ABSENT:
        raise _refused(path, line, layout.task, task, "which task this was", "fill it in")
    said = cells.cell(layout.answered)
    answered = layout.answers.get(said, NO_ANSWER if said in ABSENT and said not in materials else said)
    trial = None if layout.trial is None else _whole(path, line, layout.trial, cells.cell(layout.trial))
    return Row(file, line, participant, task, trial, presented, answered, _time_s(path, line, layout, cells))


def _whole(path: Path, line: int, column: str, cell: str) -> int:
    # Tables that were merged in pandas or a spreadsheet have whole numbers with a point.
    if not (match := re.fullmatch(r"([0-9]{1,7})(\.0+)?", cell)):
        raise _refused(path, line, column, cell, "a whole number from 0", "mend it, or leave --trial away")
    return int(match[1])


def _time_s(path: Path, line: int, layout: Layout, cells: _Cells) -> float | None:
    column = layout.time_s or layout.time_ms
    if column is None or (cell := cells.cell(column)) in ABSENT:
        return None
    value = cells.table.number(cell)
    if not (math.isfinite(value) and value >= 0):
        raise _refused(path, line, column, cell, "a number from 0, or nothing", "mend it")
    return value if layout.time_s else value / 1000


def _refused(path: Path, line: int, column: str, cell: str, allowed: str, remedy: str) -> DatasetError:
    return DatasetError(path, f"line {line}, column {column}: got {quoted(cell)}", remedy, allowed=allowed)


def _listed(values: Sequence[str] | Mapping[str, None]) -> str:
    named = [value if value.isprintable() and value else quoted(value) for value in values]
    more = f" and {len(named) - TOLD} more" if len(named) > TOLD else ""
    return ", ".join(named[:TOLD]) + more


def _check_header(path: Path, layout: Layout, table: Table) -> None:
    header = table.header
    for column in layout.columns():
        if (times := header.count(column)) != 1:
            got = "no such column" if not times else f"{times} such columns"
            there = _listed(dict.fromkeys(name for name in header if name))
            raise DatasetError(
                path,
                f"line {table.understood.heading_lines[0]}, column {column}: got {got}",
                "name it as the header does",
                allowed=f"one of {there or 'a header'}",
            )


def _check_materials(path: Path, layout: Layout, materials: Sequence[str]) -> None:
    if not 2 <= len(materials) <= MOST_MATERIALS:
        raise DatasetError(
            path,
            f"column {layout.presented}: got {len(materials)} different materials ({_listed(materials)})",
            "name another column with --presented",
            allowed=f"2 to {MOST_MATERIALS}",
        )
    alike: dict[str, str] = {}
    for material in materials:
        if (other := alike.setdefault(skeleton(material), material)) != material:
            raise DatasetError(
                path,
                f"column {layout.presented}: got {quoted(other)} and {quoted(material)}, which look the same",
                f"give --map-presented '{material}={other}'",
                allowed="one spelling",
            )


def _refuse_twice(paths: Sequence[Path], layout: Layout, rows: Sequence[Row]) -> None:
    first: dict[tuple[str, str, int], Row] = {}
    for row in rows:
        if (
            row.trial is not None
            and (known := first.setdefault((row.participant, row.task, row.trial), row)) is not row
        ):
            raise DatasetError(
                paths[row.file - 1],
                f"line {row.line}, column {layout.trial}: got trial {row.trial} of participant "
                f"{quoted(row.participant)} again, after {paths[known.file - 1]}, line {known.line}",
                "take one row a trial with --where, name the task with --task, or leave --trial away",
                allowed="each once in a task",
            )
