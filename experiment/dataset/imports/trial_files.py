"""Single trials from the files that other software writes: PsychoPy, jsPsych, OpenSesame, Gorilla, a lab's own.

Rows whose column of materials is empty (instructions, breaks) are passed over and counted. The user says which column
holds what; everything that cannot be read is reported at once, counted by kind.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from palpate.experiment.dataset.imports.doubts import Practice, Unanswered, summary_doubts, time_doubts, wide_doubts
from palpate.experiment.dataset.imports.layout import ABSENT, AGAIN, ANY, RIGHT, SEVERAL, WRONG, Layout
from palpate.experiment.dataset.imports.objects import UnderstoodJson
from palpate.experiment.dataset.imports.refusals import MOST_LISTED, Place, all_of, listed, refused
from palpate.experiment.dataset.imports.runs import TRIAL, Runs, numbered_again, rows_again
from palpate.experiment.dataset.imports.times import Times, bare, is_several
from palpate.experiment.dataset.imports.trial_table import trial_table
from palpate.experiment.errors import DatasetError, Finding, Remedy
from palpate.experiment.protocol.designs.comparison import FIRST, SECOND, TIE
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.settings.characters import quoted, skeleton
from palpate.experiment.settings.delimited import NOTHING_STATED, Record, Stated, Table, Understood

MOST_MATERIALS = 64
"""More different cells than this are no materials: the column is another one."""

PARTED, AT_A_TIME = 0.2, 1000
"""The share of a file's time in which its cells are parted, and the rows after which progress is told. Ours."""

TIES = ("tie", "ties", "draw", "equal", "same", "neither", "both")
"""Words for a comparison in which neither was chosen, in small letters."""


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
    session: str = ""


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

    def place(self, row: Row) -> Place:
        """Return where a trial is in its file."""
        return _place(row, self.read_as[row.file - 1])


class _PassedOver(Exception):
    """A row is no trial; the text is what stands for the material."""


def read_trials(
    paths: Sequence[Path],
    layout: Layout,
    materials: Sequence[str] = (),
    stated: Stated = NOTHING_STATED,
    done: Callable[[float], None] = lambda _: None,
) -> Trials:
    """Return the trials in these files, in the order of files and lines; `done` is called with the share
    that is read.

    `materials` may be presented and answered, by default those presented, in alphabetical order. Raises `DatasetError`
    for all that cannot be read, counted by kind: an unreadable file, a missing or repeated column, a bad cell, a trial
    number twice in a participant's task; and without trials or two materials.
    """
    reader = _Reader(paths, layout, tuple(materials), stated)
    for number, path in enumerate(paths, start=1):
        for share in reader.read(number, path):
            done((number - 1 + share) / len(paths))
    return reader.trials()


class _Reader:
    """What was read of all files so far, and what could not be."""

    def __init__(self, paths: Sequence[Path], layout: Layout, materials: tuple[str, ...], stated: Stated) -> None:
        self._paths, self._layout, self._materials, self._stated = paths, layout, materials, stated
        self._rows: list[Row] = []
        self._said: Counter[str] = Counter()
        self._practice, self._runs, self._unanswered = Practice(layout), Runs(), Unanswered(layout)
        self._columns: set[str] = set()
        self._passed_over: list[str] = []
        self._understood: dict[int, Understood] = {}
        self._left_out: Counter[tuple[str, str]] = Counter()
        self._missing_times = 0
        self._mixed: list[Path] = []
        self._tenths: list[Path] = []
        self._no_times: list[DatasetError] = []
        self._copied: list[DatasetError] = []
        self._renumbered: list[tuple[Path, str]] = []
        self._errors: list[DatasetError] = []

    def read(self, number: int, path: Path) -> Iterator[float]:
        """Read a file; keep what is wrong with it. Yield the share that is read."""
        try:
            table, times = trial_table(path, self._layout, self._stated)
            label = self._layout.label_in(path) if self._layout.participant is None else ""
        except DatasetError as error:
            self._errors.append(error)
            return
        yield PARTED
        self._understood[number] = table.understood
        self._mixed += [path] * times.mixed
        self._tenths += [path] * (times.scale != 1.0)
        self._columns.update(table.header)
        places = {name: table.header.index(name) for name in self._layout.columns() if name in table.header}
        again = self._exported_twice(table)
        copies = {one.line for one in again} if AGAIN in self._layout.leave_out else set[int]()
        begun, trials = len(self._rows), list[Record]()
        for row_number, record in enumerate(table.rows):
            if not row_number % AT_A_TIME:
                yield PARTED + (1 - PARTED) * row_number / len(table.rows)
            if record.line in copies:
                self._left_out[AGAIN] += 1
                continue
            cells = _Cells(path, record.line, places, record.cells, table, times)
            try:
                row = self._row(number, label, cells)
            except _PassedOver as row_is:
                self._passed_over.append(str(row_is))
            except DatasetError as error:
                self._errors.append(error)
            else:
                if row is not None:
                    self._rows.append(row)
                    trials.append(record)
                    self._practice.add(row.participant, table.header, record.cells)
                    self._runs.add(table.header, record.cells)
                    self._unanswered.add(table.header, record.cells, answered=row.answered != NO_ANSWER)
        self._keep_repeated(path, table.header, again, self._rows[begun:], trials)

    def _exported_twice(self, table: Table) -> list[Record]:
        """Return the rows that stand in a table twice, where times or numbers of trials tell them from each other."""
        told = self._layout.time is not None or any(TRIAL.fullmatch(name.lower()) for name in table.header)
        return rows_again(table.rows) if told else []

    def _keep_repeated(
        self, path: Path, header: Sequence[str], again: Sequence[Record], rows: Sequence[Row], trials: Sequence[Record]
    ) -> None:
        """Keep what is wrong or doubtful of trials that stand in a file twice, or whose number does."""
        taken = {one.line for one in trials}
        if copied := [one.line for one in again if one.line in taken]:
            what = f"starting at this line, {len(copied)} of {len(trials)} trials occur twice with identical cells"
            remedy = self._remedy("if they were exported twice, use only one copy", "--leave-out", "=".join(AGAIN))
            self._copied.append(DatasetError(path, what, remedy, allowed="each trial once", line=copied[0]))
        elif self._layout.trial is None:
            who = [(row.participant, row.task, row.session) for row in rows]
            self._renumbered += [(path, column)] if (column := numbered_again(header, who, trials)) else []

    def trials(self) -> Trials:
        """Return the trials. Raises `DatasetError` for all that is wrong."""
        shown = Counter(one for row in self._rows for one in _shown(row))
        strange = self._strange_materials(shown)
        known = self._materials or tuple(sorted(one for one in shown if one not in strange))
        self._errors += [error for errors in strange.values() for error in errors]
        if known and self._rows and self._layout.second is None:
            self._errors += self._strange_answers(known, shown, guessed=bool(strange))
        self._errors += [*self._spellings(known, shown), *(self._copied or self._twice()), *self._never_there()]
        if self._errors:
            raise all_of(self._without_times() or self._errors, self._stated)
        if not self._rows:
            raise DatasetError(
                ", ".join(map(str, self._paths[:MOST_LISTED])),
                f"has no trials: {self._layout.presented} is empty in every selected row",
                "give another column with --presented, or select other rows with --where",
            )
        self._check_materials(known)
        rows = self._rows if self._layout.correct is None else [self._resolved(row, known) for row in self._rows]
        return Trials(
            tuple(rows), known, tuple(self._passed_over), tuple(self._understood.values()), dict(self._left_out),
            self._missing_times, self._doubts(),
        )  # fmt: skip

    def _without_times(self) -> list[DatasetError]:
        """Return the errors with one in place of all cells that are no times, where leaving them out leaves too few."""
        many = len(self._no_times)
        if many <= len(self._rows):
            return []
        first, column, words = self._no_times[0].finding, self._layout.time or "", self._stated.command
        options = ("--seconds", "--milliseconds")
        at = next((place for place, word in enumerate(words[:-1]) if word in options and words[place + 1] == column), 0)
        without = (*words[:at], *words[at + 2 :])
        advice = "give the column of response times, or import without them"
        one = replace(
            first,
            what=f"{first.what}, and the time is missing in {many} of {many + len(self._rows)} rows",
            remedy=Remedy(f"{advice}: {{}}", without) if at else advice,
        )
        others = [error for error in self._errors if all(error is not each for each in self._no_times)]
        return [DatasetError.at(one), *others]

    def _row(self, file: int, label: str, cells: "_Cells") -> Row | None:
        """Return a row as a trial, or None where it is left out. Raises `_PassedOver` for a row that is none."""
        layout = self._layout
        if any(cells.cell(column) != value for column, value in layout.where.items()):
            raise _PassedOver("")
        for column, value in layout.leave_out:
            if column in cells.places and layout.is_left_out(cells.cell(column), value):
                self._left_out[column, value] += 1
                return None
        presented = self._material(cells, layout.presented)
        if not cells.fits:
            raise DatasetError(
                cells.path,
                f"got {len(cells.cells)} cells for {cells.width} columns",
                "export the file again",
                allowed="one cell per column",
                line=cells.line,
            )
        second = None if layout.second is None else self._material(cells, layout.second)
        participant = label or self._filled(cells, layout.participant or "", "who took part")
        task = "" if layout.task is None else self._filled(cells, layout.task, "which task this was")
        trial = None if layout.trial is None else self._whole(cells, layout.trial)
        answered = self._answered(cells, presented, second)
        who = layout.people.get(participant, participant)
        session = "" if layout.session is None else self._filled(cells, layout.session, "which session this was")
        return Row(file, cells.line, who, task, trial, presented, answered, self._time_s(cells), second, session)

    def _material(self, cells: "_Cells", column: str) -> str:
        layout, shown = self._layout, cells.cell(column)
        if shown in ABSENT and shown not in layout.materials and shown not in self._materials:
            raise _PassedOver(shown)
        presented = layout.materials.get(shown, shown)
        allowed = self._materials
        if allowed and presented not in allowed:
            options = "--map-presented", f"{shown}={_akin(shown, allowed) or 'MATERIAL'}"
            raise cells.refused(
                column, listed(dict.fromkeys((*layout.materials, *allowed))), self._remedy("map it", *options)
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
            remedy = self._remedy("leave such rows out, or omit --trial", "--leave-out", f"{column}={cell}")
            raise cells.refused(column, "a whole number of at least 0", remedy)
        return int(match[1])

    def _answered(self, cells: "_Cells", presented: str, second: str | None) -> str:
        """Return the answer; of `correct`, a mark that is resolved once all materials are known."""
        layout = self._layout
        if layout.correct is not None:
            said = bare(cells.cell(layout.correct))
            right = {**RIGHT, **WRONG}.get(layout.answers.get(said, said).lower())
            if right is None and said not in ABSENT:
                remedy = self._remedy("map it", "--map", f"{said}=MARK")
                raise cells.refused(layout.correct, "1 and 0, true and false, or correct and incorrect", remedy)
            return NO_ANSWER if right is None else presented if right else _WRONG
        said = cells.cell(layout.answered or "")
        if said not in layout.answers:
            said = self._one(cells, layout.answered or "")
        self._said[said] += 1
        answer = layout.answers.get(said, NO_ANSWER if said in ABSENT and said not in self._materials else said)
        if second is None or answer == NO_ANSWER:
            return answer
        answer = layout.materials.get(answer, answer)
        places = {presented: FIRST, second: SECOND} if presented != second else {}
        places |= {FIRST: FIRST, SECOND: SECOND, **dict.fromkeys(TIES, TIE)}
        chosen = places.get(answer, places.get(answer.lower()))
        if chosen is None:
            allowed = f"{presented}, {second}, or what --map makes first, second or tie"
            meant = _akin(said, (presented, second)) or "PLACE"
            raise cells.refused(layout.answered or "", allowed, self._remedy("map it", "--map", f"{said}={meant}"))
        return chosen

    def _one(self, cells: "_Cells", column: str) -> str:
        """Return what a cell holds. Raises `DatasetError` for a list of several, which are one kind of error."""
        if is_several(cell := cells.cell(column)):
            remedy = self._remedy("leave such rows out", "--leave-out", f"{column}={SEVERAL}")
            field = f"column {column}"
            raise refused(
                cells.path, cells.place, field, "a list of several", "one answer, or a value given in --map", remedy
            )
        return bare(cell)

    def _time_s(self, cells: "_Cells") -> float | None:
        column = self._layout.time
        if column is None or self._one(cells, column) in ABSENT:
            return None
        cell = cells.cell(column)
        value = cells.times.value(cell)
        if self._layout.is_missing(cell, value):
            self._missing_times += 1
            return None
        if not (math.isfinite(value) and value >= 0):
            rule = "negative" if value < 0 else "NUMBER"
            remedy = self._remedy("mark such times as missing", "--missing-time", rule)
            if math.isnan(value):
                remedy = self._remedy("if it means a missing time, add --missing-time", "--missing-time", cell)
            error = cells.refused(column, "a number of at least 0, or an empty cell", remedy)
            self._no_times += [error] if math.isnan(value) else []
            raise error
        return value if self._layout.time_s else value / 1000

    def _strange_materials(self, shown: Counter[str]) -> dict[str, list[DatasetError]]:
        """Return the errors of what was presented and is neither mapped nor known, by cell.

        Where codes are mapped, one that is not was forgotten; where spellings are, each other stands for itself.
        """
        layout = self._layout
        if self._materials or all(_form(code) == _form(meant) for code, meant in layout.materials.items()):
            return {}
        answers = [layout.answers.get(said, said) for said in self._said]
        named = sorted(one for one in {*answers, *layout.answers.values()} if one not in ABSENT and not _KEY(one))
        known = tuple(dict.fromkeys((*layout.materials.values(), *(named if layout.correct is None else ()))))
        found: dict[str, list[DatasetError]] = {one: [] for one in shown if one not in known}
        for row in self._rows:
            for column, one in zip((layout.presented, layout.second or ""), _shown(row), strict=False):
                if one in found:
                    options = "--map-presented", f"{one}={_akin(one, known) or 'MATERIAL'}"
                    remedy = self._remedy("map it", *options)
                    found[one].append(self._refused(row, column, one, listed((*layout.materials, *known)), remedy))
        return found

    def _strange_answers(self, known: tuple[str, ...], shown: Counter[str], *, guessed: bool) -> list[DatasetError]:
        """Return the errors of answers that were never presented, `guessed`: of keys and other spellings alone."""
        answers = {row.answered for row in self._rows} - {*known, NO_ANSWER, _WRONG}
        commonest = sorted(known, key=lambda one: -shown[one])
        remedies = {
            one: self._as_presented(one, commonest) for one in answers if not guessed or _KEY(one) or _akin(one, known)
        }
        return [
            self._refused(
                row, self._layout.answered or "", row.answered, listed((*known, NO_ANSWER)), remedies[row.answered]
            )
            for row in self._rows
            if row.answered in remedies
        ]

    def _refused(self, row: Row, column: str, cell: str, allowed: str, remedy: Remedy | str) -> DatasetError:
        path = self._paths[row.file - 1]
        return refused(path, self._place(row), f"column {column}", quoted(cell), allowed, remedy)

    def _place(self, row: Row) -> Place:
        return _place(row, self._understood[row.file])

    def _as_presented(self, answered: str, known: Sequence[str]) -> Remedy | str:
        """Return what to do about an answer that was never presented; one that --map made may be a code there."""
        if akin := _akin(answered, known):
            return self._remedy("map it", "--map", f"{answered}={akin}")
        if code := next((code for code, meant in self._layout.answers.items() if meant == answered), ""):
            words = "if this code was presented, add --map-presented; if not, give its material with --material"
            return self._remedy(words, "--map-presented", f"{code}={answered}")
        words = "map it to a material, or give it with --material if it was never presented"
        return self._remedy(words, "--map", f"{answered}=MATERIAL")

    def _resolved(self, row: Row, known: tuple[str, ...]) -> Row:
        """Return a trial whose answer was right or wrong with what was answered."""
        if row.answered != _WRONG:
            return row
        if len(known) > 2:
            raise DatasetError(
                self._paths[row.file - 1],
                f"got a wrong answer; with {len(known)} materials, this does not reveal which answer was given",
                "give the column of the answers with --answered",
                allowed="--correct only with two materials, where a wrong answer must be the other material",
                field=f"column {self._layout.correct}",
                line=row.line,
            )
        return replace(row, answered=next(one for one in known if one != row.presented))

    def _check_materials(self, known: tuple[str, ...]) -> None:
        path, column = self._paths[0], self._layout.presented
        if not 2 <= len(known) <= MOST_MATERIALS:
            raise DatasetError(
                path,
                f"column {column}: got {len(known)} different materials ({listed(known)})",
                "give another column with --presented",
                allowed=f"2 to {MOST_MATERIALS}",
            )

    def _spellings(self, known: tuple[str, ...], shown: Counter[str]) -> list[DatasetError]:
        """Return the errors of materials that look like another one, of which the commonest spelling is taken."""
        best: dict[str, str] = {}
        found = []
        for material in sorted(known, key=lambda one: -shown[one]):
            if (other := best.setdefault(skeleton(material), material)) != material:
                same = f"{material}={other}"
                answered = self._said[material] and self._layout.second is None
                options = ("--map-presented", same, *(("--map", same) if answered else ()))
                found.append(
                    DatasetError(
                        self._paths[0],
                        f"got {quoted(other)} and {quoted(material)}, which look the same",
                        self._remedy("if they are the same, map one to the other", *options),
                        allowed="one spelling",
                        field=f"column {self._layout.presented}",
                    )
                )
        return found

    def _never_there(self) -> list[DatasetError]:
        """Return the errors of columns that only leave rows out, and that no file has."""
        absent = dict.fromkeys(column for column, _ in self._layout.leave_out if column not in (ANY, *self._columns))
        there = listed(dict.fromkeys(sorted(self._columns)))
        return [
            DatasetError(
                self._paths[0], "got no such column", "use the name in the header", allowed=f"one of {there}",
                field=f"column {column}",
            )
            for column in absent
            if self._columns
        ]  # fmt: skip

    def _twice(self) -> list[DatasetError]:
        first: dict[tuple[str, str, str, int], Row] = {}
        for row in self._rows:
            if row.trial is None:
                return []
            if (known := first.setdefault((row.participant, row.task, row.session, row.trial), row)) is not row:
                return [self._again(row, known)]
        return []

    def _again(self, row: Row, known: Row) -> DatasetError:
        """Return the error of a trial whose number occurs a second time, with the column that may tell sessions."""
        place = self._place(known)
        remedy: Remedy | str = (
            "if there were several sessions, give the session column with --session, or omit --trial; otherwise, "
            "select one row per trial with --where, or give the task with --task"
        )
        column = self._runs.apart([(one.participant, one.task, one.trial or 0) for one in self._rows])
        if column and self._layout.session is None:
            words = (
                f"{column} differs there: if a run was restarted, leave out one of the two with --leave-out; if both "
                "are sessions with this person, add --session"
            )
            remedy = self._remedy(words, "--session", column)
        return refused(
            self._paths[row.file - 1],
            self._place(row),
            f"column {self._layout.trial}",
            f"trial {row.trial} of participant {quoted(row.participant)} again, after "
            f"{self._paths[known.file - 1]}, {place.part} {place.number}",
            "each trial once per task",
            remedy,
        )

    def _doubts(self) -> tuple[Finding, ...]:
        """Return what is implausible of the trials."""
        times: dict[str, list[float]] = {}
        for row in self._rows:
            if row.response_time_s is not None:
                times.setdefault(row.participant, []).append(row.response_time_s)
        mixed = tuple(
            Finding(
                "some times have a decimal point and others a decimal comma; both are read as decimal signs",
                where=path, field=f"column {self._layout.time}",
                remedy="check that none of these is a thousands separator", verdict="warns", check="decimal signs",
            )
            for path in self._mixed
        )  # fmt: skip
        tenths = [
            Finding(
                "is a Presentation log, so its times are read in units of 0.1 ms", where=path,
                field=f"column {self._layout.time}", remedy="check one of them", verdict="warns", check="tenths",
            )
            for path in self._tenths
        ]  # fmt: skip
        again = [
            Finding(
                "numbers trials, but some numbers are repeated, as when files have been joined", where=path,
                field=f"column {column}", verdict="warns", check="numbers",
                remedy=self._remedy("if each task has its own, delete the dataset and import again", "--trial", column),
            )
            for path, column in self._renumbered
        ]  # fmt: skip
        rows = (*again, *self._practice.doubts(self._stated), *self._unanswered.doubts(self._stated))
        summary = summary_doubts((row.participant for row in self._rows), self._layout, self._stated)
        of_times = (*time_doubts(times, self._layout, self._stated), *mixed, *tenths)
        return (*wide_doubts(self._columns, self._layout), *rows, *summary, *of_times)

    def _remedy(self, words: str, *options: str) -> Remedy | str:
        return self._stated.remedy(words, *options)


_WRONG = "\0wrong"
"""Stands for an answer of which no more is known than that it was wrong."""


_KEY = re.compile(r".|[0-9]+(\.0+)?").fullmatch
"""What a participant presses, and no name of a material."""


def _place(row: Row, understood: Understood) -> Place:
    return Place(row.line, "element" if isinstance(understood, UnderstoodJson) else "line")


def _form(name: str) -> str:
    return skeleton(re.sub("[-_.]", "", name))


def _akin(cell: str, known: Sequence[str]) -> str:
    """Return the material of which a cell is another spelling, or nothing."""
    return next((one for one in known if one != cell and _form(one) == _form(cell)), "")


def _shown(row: Row) -> tuple[str, ...]:
    return (row.presented,) if row.second is None else (row.presented, row.second)


@dataclass(frozen=True)
class _Cells:
    """The cells of a row of a table; a row that is too short ends in empty cells."""

    path: Path
    line: int
    places: Mapping[str, int]
    cells: Sequence[str]
    table: Table
    times: Times

    @property
    def width(self) -> int:
        """Return how many columns the header has."""
        return len(self.table.header)

    def cell(self, column: str) -> str:
        place = self.places[column]
        return self.cells[place].strip() if place < len(self.cells) else ""

    @property
    def place(self) -> Place:
        return Place(self.line, "element" if isinstance(self.table.understood, UnderstoodJson) else "line")

    @property
    def fits(self) -> bool:
        return len(self.cells) == self.width or (
            len(self.cells) > self.width and not any(cell.strip() for cell in self.cells[self.width :])
        )

    def refused(self, column: str, allowed: str, remedy: Remedy | str) -> DatasetError:
        return refused(self.path, self.place, f"column {column}", quoted(self.cell(column)), allowed, remedy)
