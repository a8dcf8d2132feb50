"""Single trials from the files that other software writes: PsychoPy, jsPsych, OpenSesame, Gorilla, a lab's own.

Rows whose column of materials is empty (instructions, breaks) are passed over and counted. The user says which column
holds what; everything that cannot be read is reported at once, counted by kind.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median

from palpate.experiment.dataset.imports.json_rows import is_json, json_table
from palpate.experiment.dataset.imports.layout import ABSENT, RIGHT, WRONG, Layout
from palpate.experiment.errors import DatasetError, Finding, PalpateError, Remedy
from palpate.experiment.protocol.designs.comparison import FIRST, SECOND, TIE
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.settings.characters import quoted, skeleton
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated, Table, Understood, read_table
from palpate.experiment.settings.units import heading, time_unit

MOST_MATERIALS = 64
"""More different cells than this are no materials: the column is another one."""

TOLD = 12
"""The most columns or values that an error lists."""

TIES = ("tie", "ties", "draw", "equal", "same", "neither", "both")
"""Words for a comparison in which neither was chosen, in small letters."""

FASTEST_S, SLOWEST_S = 0.05, 60.0
"""Nobody answers in a median time outside of these: another unit is more likely."""


@dataclass(frozen=True)
class Row:
    """One trial as its file has it: `file` is the place of the file among those given, and `line` where it begins.

    Of a comparison `second` is the material that was presented second, and `answered` names a place of the pair.
    """

    file: int
    line: int
    participant: str
    task: str
    trial: int | None
    presented: str
    answered: str
    response_time_s: float | None
    second: str | None = None


@dataclass(frozen=True)
class Trials:
    """Trials, the materials in the order of the tables, and how each file was read.

    `passed_over` is what stands for the material in each row that is no trial. `left_out` counts rows by the cell that
    left them out, `missing_times` response times that a rule took for missing; `doubts` are implausible values.
    """

    rows: tuple[Row, ...]
    materials: tuple[str, ...]
    passed_over: tuple[str, ...]
    read_as: tuple[Understood, ...]
    left_out: Mapping[tuple[str, str], int] = field(default_factory=dict)
    missing_times: int = 0
    doubts: tuple[Finding, ...] = ()


class _PassedOver(Exception):
    """A row is no trial; the text is what stands for the material."""


def read_trials(
    paths: Sequence[Path],
    layout: Layout,
    materials: Sequence[str] = (),
    stated: Stated = NOTHING_STATED,
    tick: Callable[[], None] = lambda: None,
) -> Trials:
    """Return the trials in these files, in the order of files and lines; `tick` is called after each file.

    `materials` may be presented and answered, by default those presented, in alphabetical order. Raises `DatasetError`
    for all that cannot be read, counted by kind: an unreadable file, a missing or repeated column, a bad cell, a trial
    number twice in a participant's task; and without trials or two materials.
    """
    reader = _Reader(paths, layout, tuple(materials), stated)
    for number, path in enumerate(paths, start=1):
        reader.read(number, path)
        tick()
    return reader.trials()


class _Reader:
    """What was read of all files so far, and what could not be."""

    def __init__(self, paths: Sequence[Path], layout: Layout, materials: tuple[str, ...], stated: Stated) -> None:
        self._paths, self._layout, self._materials, self._stated = paths, layout, materials, stated
        self._rows: list[Row] = []
        self._answers: dict[int, str] = {}
        self._passed_over: list[str] = []
        self._read_as: list[Understood] = []
        self._left_out: Counter[tuple[str, str]] = Counter()
        self._missing_times = 0
        self._errors: list[DatasetError] = []

    def read(self, number: int, path: Path) -> None:
        """Read a file; keep what is wrong with it."""
        try:
            table = _table(path, self._layout, self._stated)
            label = self._layout.label_in(path) if self._layout.participant is None else ""
        except DatasetError as error:
            self._errors.append(error)
            return
        self._read_as.append(table.understood)
        places = {name: table.header.index(name) for name in self._layout.columns()}
        for record in table.rows:
            cells = _Cells(path, record.line, places, record.cells, table)
            try:
                row = self._row(number, label, cells)
            except _PassedOver as row_is:
                self._passed_over.append(str(row_is))
            except DatasetError as error:
                self._errors.append(error)
            else:
                self._rows += [row] if row else []

    def trials(self) -> Trials:
        """Return the trials. Raises `DatasetError` for all that is wrong."""
        known = self._materials or tuple(sorted({one for row in self._rows for one in _shown(row)}))
        if self._rows and self._layout.second is None:
            self._errors += self._strange_answers(known)
        self._errors += self._twice()
        if self._errors:
            raise _all_of(self._errors)
        if not self._rows:
            raise DatasetError(
                ", ".join(map(str, self._paths[:TOLD])),
                f"got no trial: {self._layout.presented} is empty in every row that is taken",
                "name another column with --presented, or take other rows with --where",
            )
        self._check_materials(known)
        rows = self._rows if self._layout.correct is None else [self._resolved(row, known) for row in self._rows]
        return Trials(
            tuple(rows), known, tuple(self._passed_over), tuple(self._read_as), dict(self._left_out),
            self._missing_times, self._doubts(),
        )  # fmt: skip

    def _row(self, file: int, label: str, cells: "_Cells") -> Row | None:
        """Return a row as a trial, or None where it is left out. Raises `_PassedOver` for a row that is none."""
        layout = self._layout
        if any(cells.cell(column) != value for column, value in layout.where.items()):
            raise _PassedOver("")
        for column, value in layout.leave_out:
            if cells.cell(column) == value:
                self._left_out[column, value] += 1
                return None
        presented = self._material(cells, layout.presented)
        if not cells.fits:
            raise DatasetError(
                cells.path,
                f"got {len(cells.cells)} cells under {cells.width} columns",
                "export the file again",
                allowed="as many",
                line=cells.line,
            )
        second = None if layout.second is None else self._material(cells, layout.second)
        participant = label or self._filled(cells, layout.participant or "", "who took part")
        task = "" if layout.task is None else self._filled(cells, layout.task, "which task this was")
        trial = None if layout.trial is None else self._whole(cells, layout.trial)
        answered = self._answered(cells, presented, second)
        who = layout.people.get(participant, participant)
        return Row(file, cells.line, who, task, trial, presented, answered, self._time_s(cells), second)

    def _material(self, cells: "_Cells", column: str) -> str:
        layout, shown = self._layout, cells.cell(column)
        if shown in ABSENT and shown not in layout.materials and shown not in self._materials:
            raise _PassedOver(shown)
        presented = layout.materials.get(shown, shown)
        allowed = self._materials or tuple(layout.materials.values())
        if allowed and presented not in allowed:
            options = "--map-presented", f"{shown}=MATERIAL"
            raise cells.refused(
                column, _listed(dict.fromkeys((*layout.materials, *allowed))), self._remedy("say what it is", *options)
            )
        return presented

    def _filled(self, cells: "_Cells", column: str, what: str) -> str:
        cell = cells.cell(column)
        if cell in ABSENT and cell not in self._layout.people:
            raise cells.refused(column, what, self._remedy("leave such rows out", "--leave-out", f"{column}={cell}"))
        return cell

    def _whole(self, cells: "_Cells", column: str) -> int:
        # Tables that were merged in pandas or a spreadsheet have whole numbers with a point.
        if not (match := re.fullmatch(r"([0-9]{1,7})(\.0+)?", cell := cells.cell(column))):
            remedy = self._remedy("leave such rows out, or leave --trial away", "--leave-out", f"{column}={cell}")
            raise cells.refused(column, "a whole number from 0", remedy)
        return int(match[1])

    def _answered(self, cells: "_Cells", presented: str, second: str | None) -> str:
        """Return the answer; of `correct`, a mark that is resolved once all materials are known."""
        layout = self._layout
        if layout.correct is not None:
            said = cells.cell(layout.correct)
            right = {**RIGHT, **WRONG}.get(layout.answers.get(said, said).lower())
            if right is None and said not in ABSENT:
                remedy = self._remedy("say what it is", "--map", f"{said}=correct")
                raise cells.refused(layout.correct, "1 and 0, true and false, or correct and incorrect", remedy)
            return NO_ANSWER if right is None else presented if right else _WRONG
        said = cells.cell(layout.answered or "")
        answer = layout.answers.get(said, NO_ANSWER if said in ABSENT and said not in self._materials else said)
        if second is None or answer == NO_ANSWER:
            return answer
        answer = layout.materials.get(answer, answer)
        places = {presented: FIRST, second: SECOND} if presented != second else {}
        places |= {FIRST: FIRST, SECOND: SECOND, **dict.fromkeys(TIES, TIE)}
        chosen = places.get(answer, places.get(answer.lower()))
        if chosen is None:
            allowed = f"{presented}, {second}, or what --map makes first, second or tie"
            raise cells.refused(
                layout.answered or "", allowed, self._remedy("say what it is", "--map", f"{said}=first")
            )
        return chosen

    def _time_s(self, cells: "_Cells") -> float | None:
        column = self._layout.time
        if column is None or (cell := cells.cell(column)) in ABSENT:
            return None
        value = cells.table.number(cell)
        if self._layout.is_missing(value):
            self._missing_times += 1
            return None
        if not (math.isfinite(value) and value >= 0):
            rule = "negative" if value < 0 else "NUMBER"
            remedy = self._remedy("say that such times are missing", "--missing-time", rule)
            if math.isnan(value):
                remedy = self._remedy("leave such rows out", "--leave-out", f"{column}={cell}")
            raise cells.refused(column, "a number from 0, or nothing", remedy)
        return value if self._layout.time_s else value / 1000

    def _strange_answers(self, known: tuple[str, ...]) -> list[DatasetError]:
        return [
            _refused(
                self._paths[row.file - 1], row.line, self._layout.answered or "", row.answered,
                _listed((*known, NO_ANSWER)),
                self._as_presented(row.answered),
            )
            for row in self._rows
            if row.answered not in (*known, NO_ANSWER, _WRONG)
        ]  # fmt: skip

    def _as_presented(self, answered: str) -> Remedy | str:
        """Return what to do about an answer that was never presented; one that --map made may be a code there."""
        if code := next((code for code, meant in self._layout.answers.items() if meant == answered), ""):
            words = "if it was presented as that code, say so, or name it with --material"
            return self._remedy(words, "--map-presented", f"{code}={answered}")
        words = "say what it is, or name it with --material if it was never presented"
        return self._remedy(words, "--map", f"{answered}=MATERIAL")

    def _resolved(self, row: Row, known: tuple[str, ...]) -> Row:
        """Return a trial whose answer was right or wrong with what was answered."""
        if row.answered != _WRONG:
            return row
        if len(known) > 2:
            raise DatasetError(
                self._paths[row.file - 1],
                f"got a wrong answer to one of {len(known)} materials, which does not say what was answered",
                "name the column of the answers with --answered",
                allowed="--correct for two materials, where the other one was answered",
                field=f"column {self._layout.correct}",
                line=row.line,
            )
        return replace(row, answered=next(one for one in known if one != row.presented))

    def _check_materials(self, known: tuple[str, ...]) -> None:
        path, column = self._paths[0], self._layout.presented
        if not 2 <= len(known) <= MOST_MATERIALS:
            raise DatasetError(
                path,
                f"column {column}: got {len(known)} different materials ({_listed(known)})",
                "name another column with --presented",
                allowed=f"2 to {MOST_MATERIALS}",
            )
        alike: dict[str, str] = {}
        for material in known:
            if (other := alike.setdefault(skeleton(material), material)) != material:
                raise DatasetError(
                    path,
                    f"column {column}: got {quoted(other)} and {quoted(material)}, which look the same",
                    self._remedy("if they are one, say so", "--map-presented", f"{material}={other}"),
                    allowed="one spelling",
                )

    def _twice(self) -> list[DatasetError]:
        first: dict[tuple[str, str, int], Row] = {}
        found = []
        for row in self._rows:
            if row.trial is None or (known := first.setdefault((row.participant, row.task, row.trial), row)) is row:
                continue
            error = DatasetError(
                self._paths[row.file - 1],
                f"got trial {row.trial} of participant {quoted(row.participant)} again, after "
                f"{self._paths[known.file - 1]}, line {known.line}",
                "take one row a trial with --where, name the task with --task, or leave --trial away",
                allowed="each once in a task",
                field=f"column {self._layout.trial}",
                line=row.line,
            )
            found.append(error)
        return found[:1]

    def _doubts(self) -> tuple[Finding, ...]:
        """Return what is implausible of the response times, with the unit that is more likely."""
        times = [row.response_time_s for row in self._rows if row.response_time_s is not None]
        if not times or FASTEST_S <= (usual := median(times)) <= SLOWEST_S:
            return ()
        in_s = self._layout.time_s is not None
        other = "--milliseconds" if in_s else "--seconds"
        likely = FASTEST_S <= usual * (1e-3 if in_s else 1e3) <= SLOWEST_S
        command = tuple(
            other if word in ("--seconds", "--milliseconds") else word for word in self._stated.command
        ) or ("palpate", "import-trials", other, str(self._layout.time))  # fmt: skip
        remedy: Remedy | str = f"check the unit of {self._layout.time}"
        if likely:
            remedy = Remedy(f"if they are in {other[2:]}, delete the dataset and say so: {{}}", command)
        return (
            Finding(
                f"got a median response time of {usual:.3g} s, which is implausible",
                field=f"column {self._layout.time}",
                allowed=f"{FASTEST_S:g} to {SLOWEST_S:g} s",
                remedy=remedy,
                verdict="warns",
                check="response times",
            ),
        )

    def _remedy(self, words: str, *options: str) -> Remedy | str:
        return self._stated.remedy(words, *options)


_WRONG = "\0wrong"
"""Stands for an answer of which no more is known than that it was wrong."""


def _shown(row: Row) -> tuple[str, ...]:
    return (row.presented,) if row.second is None else (row.presented, row.second)


def _table(path: Path, layout: Layout, stated: Stated) -> Table:
    times = [layout.time] if layout.time is not None else []
    try:
        table = json_table(path, stated) if is_json(path) else read_table(path, layout.columns(), times, stated)
    except PalpateError as error:
        raise DatasetError.saying(error) from error
    if not table.header:
        raise DatasetError(path, "got an empty file", "name another file", allowed="a header, and a row for each trial")
    _check_header(path, layout, table)
    _check_unit(path, layout)
    return table


@dataclass(frozen=True)
class _Cells:
    """The cells of a row of a table; a row that is too short ends in empty cells."""

    path: Path
    line: int
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

    def refused(self, column: str, allowed: str, remedy: Remedy | str) -> DatasetError:
        return _refused(self.path, self.line, column, self.cell(column), allowed, remedy)


def _refused(path: Path, line: int, column: str, cell: str, allowed: str, remedy: Remedy | str) -> DatasetError:
    return DatasetError(path, f"got {quoted(cell)}", remedy, allowed=allowed, field=f"column {column}", line=line)


def _all_of(errors: Sequence[DatasetError]) -> DatasetError:
    """Return one error of all: the only one as it is, or each kind with how often it occurs and where first."""
    if len(errors) == 1:
        return errors[0]
    kinds: dict[tuple[str, str, str, str], list[Finding]] = {}
    for error in errors:
        one = error.finding
        kinds.setdefault((one.field, one.what, one.allowed, str(one.remedy)), []).append(one)
    told = [replace(same[0], line=None, what=f"{same[0].what} in {_places(same)}") for same in [*kinds.values()][:TOLD]]
    if len(kinds) == 1:
        return DatasetError.at(told[0])
    if len(kinds) > TOLD:
        told.append(Finding(f"and {len(kinds) - TOLD} kinds of errors more"))
    files = list(dict.fromkeys(str(error.finding.where) for error in errors))
    named = files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} other files"
    return DatasetError.in_file(f"{named}, in {len(errors)} places", told)


def _places(same: Sequence[Finding]) -> str:
    """Return where findings of one kind are."""
    one = same[0]
    first = str(one.where) if one.line is None else f"line {one.line} of {one.where}"
    return first if len(same) == 1 else f"{len(same)} {'files' if one.line is None else 'rows'}, the first in {first}"


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
                f"got {got}",
                "name it as the header does",
                allowed=f"one of {there or 'a header'}",
                field=f"column {column}",
                line=next(iter(table.understood.heading_lines), None),
            )


def _check_unit(path: Path, layout: Layout) -> None:
    """Refuse a column of times whose heading says another unit than the option that names it."""
    named, unit = heading(layout.time or ""), "s" if layout.time_s else "ms"
    says = time_unit(named)
    # In a name a letter may stand for something else.
    if says in ("", unit) or (says in ("min", "h") and not named.unit):
        return
    option = {"s": "--seconds", "ms": "--milliseconds"}.get(says)
    raise DatasetError(
        path,
        f"got times in {says}, as their heading says",
        f"name the column with {option}" if option else "export them in seconds",
        allowed=unit,
        field=f"column {layout.time}",
    )
