"""Columns of numbers in delimited text: where they begin, what stands above them, and their values.

Rows are the records that are numbers throughout, as many as most have. Values are read by pandas; what it does not take
for a number is read again, record by record, for thousands, Fortran's exponents, or the line of an error.
"""

import csv
import io
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise
from math import inf, isfinite
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.behind import without_units
from palpate.experiment.recordings.text.cells import BEYOND, are_numbers, is_missing, is_number
from palpate.experiment.recordings.text.sections import has_rows, section_of
from palpate.experiment.recordings.text.stamps import without_stamps
from palpate.experiment.recordings.text.words import without_names, without_words
from palpate.experiment.settings.delimited import (
    COMMENT_SIGN,
    DELIMITERS,
    SAMPLE,
    Record,
    Stated,
    Understood,
    decimal_sign,
    number,
    records,
    unclear_decimal,
)
from palpate.experiment.settings.units import (
    ABSCISSAS,
    Heading,
    contradict,
    heading,
    is_clock,
    is_rate,
    is_step,
    is_unit,
    likely_unit,
    rate_in,
    time_unit,
)

NEAREST = 4
"""Records above the rows among which names and units are looked for."""

TAIL, LAST_ROWS = 4096, 12
"""Characters of a text's end, and rows among them, that are looked at for one that is cut off."""

SAID_IN_ROWS, EPOCH_S = 10, (1e9, 2e9)
"""Shorter columns have no row that says something of the others, and recordings began between these, s since 1970."""

BESIDE = " beside "
"""Stands between two units of one column that contradict each other: that of its heading, and that below."""

_TAGS = frozenset(("DESCRIPTION", "TIME_STAMP", "DATA_INCLUDED", "MARKER_NAMES", "CHANNEL_GAIN", "ANALOG_FREQUENCY"))
"""What lines above the rows begin with that hold no names of columns, as Qualisys writes them."""

_NAMES, _UNITS = ("ChannelTitle=", "CHANNEL_NAMES"), ("UnitName=",)
"""What lines of names and of units begin with, as LabChart and Qualisys write them."""

_WHOLE = re.compile(r" *[+-]?[0-9]+ *")
_ZEROS = re.compile(r"0[0-9]")
_NOT_CLEAR = "export it with semicolons between cells, or, if all are whole, state it"


class Lines(Protocol):
    """The line of each row in its file, from 1."""

    def __getitem__(self, row: int, /) -> int:
        """Return the line of a row, from 0."""
        ...


@dataclass(frozen=True)
class Columns:
    """The columns of a text: headings, values, each (n,) and whole where all are, and the lines of rows.

    A value is NaN where its cell is empty or says that it is missing, infinite where it says that it is beyond
    the range; a column whose last cells are empty ends there, and `short` are line and numbers of the first such row.

    Columns at the places `stamped` are dates or times of day, in nanoseconds. `cut` says what makes the last row look
    cut off, and is empty where nothing does. `step` are the name, unit and value of the times' increment, where a line
    above the rows has one. `head` is the text above the rows.
    """

    headings: tuple[Heading, ...]
    values: tuple[NDArray[Any], ...]
    lines: "RowLines"
    understood: Understood
    stamped: tuple[int, ...]
    cut: str
    step: tuple[Heading, float] | None
    head: str
    short: tuple[int, int] | None = None


@dataclass(frozen=True)
class _Shape:
    """How the rows of a text are parted: cells of a row after `first` empty ones, and where the rows begin.

    Rows whose cells are `again`, names with one of times, are a heading that a program wrote once more.
    """

    delimiter: str
    first: int
    width: int
    rows: int
    again: tuple[str, ...] = ()


class _Parted(NamedTuple):
    """A text, how its rows are parted, the records above them, the first row, and the decimal sign."""

    text: str
    shape: _Shape
    head: list[tuple[int, str]]
    begins: Record
    decimal: str


@dataclass(frozen=True)
class RowLines:
    """The line of each row, looked for when it is asked for: errors alone ask."""

    text: str
    begins: Record
    shape: _Shape

    def __getitem__(self, row: int) -> int:
        """Return the line of a row, from 0."""
        return next(islice(_rows(self.text, self.begins, self.shape), row, None)).line


def read_columns(content: bytes, text: str, encoding: str, stated: Stated) -> Columns:
    """Return the columns of a text, and how they were read. Raises `RecordingError` with the line of what is wrong.

    `content` is that of its file.
    """
    plain, (text, stamps_ns) = len(text) == len(content) and text.isascii(), without_stamps(text)
    # Of a large file each copy costs as much as some of its reading.
    raw = content if plain and not stamps_ns else text.encode()
    return _columns(raw, text, stamps_ns, encoding, stated)


def _columns(raw: bytes, text: str, stamps_ns: Set[int], encoding: str, stated: Stated) -> Columns:
    """Return the columns of a text, which `raw` holds too, with whole nanoseconds in place of its stamps."""

    def again(other: str, stated: Stated) -> Columns:
        return _columns(other.encode(), other, stamps_ns, encoding, stated)

    def of_section() -> Columns | None:
        chosen = section_of(text, shape.delimiter, shape.first, stated)
        if chosen is None:
            return None
        made = again(chosen[0], replace(stated, section=None))
        return replace(made, understood=replace(made.understood, section=chosen[1]))

    shape = _shape_of(text, stated)
    if not shape.rows and (plain := _plain(text)) is not None:
        made = again(plain[0], stated)
        return _in_units(made, plain[1]) if plain[1] else made
    if stated.section is not None and (section := of_section()) is not None:
        return section
    head, begins = _head(text, shape)
    if has_rows(text[: begins.start], shape.delimiter, shape.first) and (section := of_section()) is not None:
        return section
    shape = replace(shape, again=_clock_names(head, shape))
    if next(_rows(text, begins, shape), None) is None:
        raise _unreadable()
    if shape.delimiter == "," and (points := _decimal_points(text, head, begins, shape, stated)) is not None:
        made = again(points, replace(stated, decimal="."))
        return replace(made, understood=replace(made.understood, decimal=","))
    decimal = stated.decimal or _decimal(text, begins, shape, SAMPLE, stated)
    values = _fast(raw, len(text[: begins.start].encode()), shape, decimal or ".")
    short = None
    if values is None and (section := of_section()) is not None:
        return section
    if values is None:
        decimal = stated.decimal or _decimal(text, begins, shape, None, stated)
        values, short = _slow(text, head, begins, shape, decimal or ".")
    parted = _Parted(text, shape, head, begins, decimal)
    if (above := _rows_of_no_samples(values, first=not head)) > 0:
        return again(_as_comments(parted, above), stated)
    return _described(parted, values, short, stamps_ns, encoding, stated)


def _as_comments(parted: _Parted, rows: int) -> str:
    """Return a text with a comment sign before each of so many rows at the beginning."""
    starts = [one.start for one in islice(_rows(parted.text, parted.begins, parted.shape), rows)]
    parts = (parted.text[one:end] for one, end in pairwise((*starts, len(parted.text))))
    return "# ".join((parted.text[: parted.begins.start], *parts))


def _described(
    parted: _Parted,
    values: Sequence[NDArray[Any]],
    short: tuple[int, int] | None,
    stamps_ns: Set[int],
    encoding: str,
    stated: Stated,
) -> Columns:
    """Return columns with what stands above them."""
    text, shape, head, begins, decimal = parted
    ends = len(begins.cells) - shape.first - shape.width
    headings, lines = _headings(head, shape, values, ends=ends)
    stamped = _stamped(values, stamps_ns)
    for place in stamped:
        headings[place] = Heading(headings[place].name, "ns")
    if not any(map(_is_timed, headings)):
        _refuse_dropped(head, lines, shape, values, stated)
    names, units = tuple(one.name for one in headings), tuple(one.unit for one in headings)
    understood = Understood(encoding, shape.delimiter, decimal, lines, names, units, begins.line, len(values[0]))
    held = RowLines(text, begins, shape)
    cut, step = _cut(text, shape, decimal), _step(head, shape, decimal)
    return Columns(tuple(headings), tuple(values), held, understood, stamped, cut, step, text[: begins.start], short)


def _plain(text: str) -> tuple[str, tuple[str, ...]] | None:
    """Return a text without the words among its numbers, and the units that stood behind these; None without any."""
    if (bare := without_units(text)) is not None:
        return bare
    others = without_names(text) or without_words(text)
    return None if others is None else (others, ())


def _stamped(values: Sequence[NDArray[Any]], stamps_ns: Set[int]) -> tuple[int, ...]:
    """Return the places of columns that begin and end with stamps."""
    return tuple(
        place
        for place, column in enumerate(values)
        if column.dtype.kind == "i" and {int(column[0]), int(column[-1])} <= stamps_ns
    )


def _in_units(made: Columns, behind: Sequence[str]) -> Columns:
    """Return columns with the units that stand behind their numbers."""
    headings = tuple(_with_unit(*both) for both in zip(made.headings, behind, strict=True))
    units = tuple(one.unit for one in headings)
    return replace(made, headings=headings, understood=replace(made.understood, units=units))


def _unreadable() -> RecordingError:
    return RecordingError(
        "got no line of two or more numbers",
        remedy="name another file",
        allowed="WAV, LabVIEW .lvm, or text columns with a column of times",
    )


def _cells(record: Record, shape: _Shape) -> list[str]:
    """Return the cells of a record without those before its numbers, or behind them if those are empty or remarks."""
    cells = record.cells[shape.first :]
    return cells if any(map(is_number, cells[shape.width :])) else cells[: shape.width]


def _trimmed(cells: list[str]) -> tuple[int, list[str]]:
    filled = [place for place, cell in enumerate(cells) if cell.strip()] or [0]
    return filled[0], cells[filled[0] : filled[-1] + 1]


def _shape_of(text: str, stated: Stated) -> _Shape:
    """Return how rows are parted; they have two or more cells where no rate is stated, since one is of times."""
    shapes: list[_Shape] = []
    # What stands above the rows may be longer than a sample.
    for least, most in ((2, SAMPLE), (2, None), (1, None)):
        shapes = [_shape(text, delimiter, most, least) for delimiter in (*DELIMITERS, "")]
        if any(one.rows for one in shapes):
            break
    shape = max(shapes, key=lambda one: (one.rows, one.width > 1))
    if shape.rows > 1 and shape.width == 1 and stated.rate_hz is None:
        remedy = stated.remedy("state its rate", "--rate", rate_in(text[:TAIL]))
        raise RecordingError("got one column and no times", remedy=remedy, allowed="times, or a rate that is stated")
    return shape


def _shape(text: str, delimiter: str, most: int | None, least: int) -> _Shape:
    shapes = Counter(
        (first, len(cells))
        for record in islice(records(text, delimiter, strict=False), most)
        if not record.comment and record.cells
        for first, cells in (_trimmed(record.cells),)
        if len(cells) >= least and are_numbers(cells)
    )
    (first, width), rows = shapes.most_common(1)[0] if shapes else ((0, 0), 0)
    # Some channels may end before the others.
    wider = [one for one, many in shapes.items() if one[0] + one[1] > first + width and many * 20 >= rows]
    if len(wider) == 1 and shapes[wider[0]] > 1 and wider[0][0] <= first:
        (first, width), rows = wider[0], shapes[wider[0]] + rows
    return _Shape(delimiter, first, width, rows)


def _head(text: str, shape: _Shape) -> tuple[list[tuple[int, str]], Record]:
    """Return line and text of each record above the first row of numbers, and that row."""
    if shape.rows < 1 + (shape.width < 2):
        raise _unreadable()
    head: list[Record] = []
    for record in records(text, shape.delimiter, strict=False):
        cells = _cells(record, shape)
        below_step = head and any(is_step(cell) for cell in head[-1].cells)
        if not record.comment and len(cells) == shape.width and are_numbers(cells) and not below_step:
            break
        head.append(record)
    if head and len(_cells(head[-1], shape)) == shape.width and are_numbers(_cells(head[-1], shape)):
        _refuse_unclear_step(*head[-2:])
        record = head.pop()
    if head and _looks_like_row(head[-1], shape):
        wrong = next(cell for cell in _cells(head[-1], shape) if not is_number(cell))
        raise RecordingError(
            f"got {wrong.strip()[:40]!r} among numbers",
            remedy="correct the line, or remove it",
            allowed="a number in every row",
            line=head[-1].line,
        )
    ends = [one.start for one in (*head, record)][1:]
    raw = [(one.line, text[one.start : end]) for one, end in zip(head, ends, strict=True)]
    return [(line, one) for line, one in raw if one.strip()], record


def _refuse_unclear_step(names: Record, numbers: Record) -> None:
    """Refuse numbers right above the rows and below an increment, unless it is a column's name beside that of times."""
    if not any(is_clock(heading(cell).name) for cell in names.cells):
        raise RecordingError(
            "got numbers below an increment, right above the rows",
            remedy="write the name of each column above the rows, or remove the line",
            allowed="names between an increment and the rows",
            line=numbers.line,
        )


def _step(head: Sequence[tuple[int, str]], shape: _Shape, decimal: str) -> tuple[Heading, float] | None:
    """Return the name, unit and value of an increment, which scopes write above the rows in place of times."""
    rows = [next(csv.reader([raw.strip()], delimiter=shape.delimiter or " "), []) for _, raw in head]
    for names, below in pairwise(rows):
        for name, cell in zip(names, below, strict=False):
            if is_step(name) and number(cell, decimal or ".") > 0:
                return heading(name), number(cell, decimal or ".")
    return None


def _decimal_points(
    text: str, head: Sequence[tuple[int, str]], begins: Record, shape: _Shape, stated: Stated
) -> str | None:
    """Return a text with points for its decimal commas, where commas part its cells as well; None for any other text.

    Two whole numbers are one with a decimal comma where headings with a time have half as many cells, or where it is
    stated that commas are decimal. Raises `RecordingError` where that is not clear.
    """
    rows = [_cells(one, shape) for one in islice(_rows(text, begins, shape), SAMPLE)]
    if stated.decimal == "." or not all(map(_are_whole, rows)):
        return None
    timed, named = _named(head, shape, np.array([float(row[0]) for row in rows]))
    if named == shape.width:
        return None
    half, paired = named * 2 == shape.width, _paired(text, begins, shape)
    if paired and (stated.decimal or (half and timed)):
        return text[: begins.start] + re.sub(r"([0-9]+),([0-9]+)", r"\1.\2", text[begins.start :])
    untimed = not named and stated.rate_hz is not None
    decimals = paired and _like_decimals([row[1::2] for row in rows], untimed=untimed)
    if not (stated.decimal or timed or half or decimals):
        return None
    words, sign = ("if so, state it", ",") if paired else (_NOT_CLEAR, ".")
    raise RecordingError(
        f"got {shape.width} whole numbers{f' below {named} names' if named else ''}, as if some were decimals",
        remedy=stated.remedy(words, "--decimal", sign),
        allowed="decimal points, another sign than commas between cells, or --decimal . if all are whole",
        line=begins.line,
    )


def _are_whole(cells: Sequence[str]) -> bool:
    return bool(cells) and all(map(_WHOLE.fullmatch, cells))


def _like_decimals(behind: Sequence[Sequence[str]], *, untimed: bool) -> bool:
    """Return whether each second cell looks like decimals: some begin with 0, or, without times, all are as long."""
    zeros = any(map(_ZEROS.match, chain.from_iterable(behind)))
    return zeros or (untimed and len({tuple(map(len, cells)) for cells in behind}) == 1)


def _named(head: Sequence[tuple[int, str]], shape: _Shape, first: NDArray[np.float64]) -> tuple[bool, int]:
    """Return whether the headings of most columns, half as many as cells or more, have a time, and how many they are.

    `first` are values of the first column.
    """
    for width in range(shape.width, (shape.width + 1) // 2 - 1, -1):
        for _, raw in head[-NEAREST:]:
            if cells := _heading_cells(raw, replace(shape, width=width), [first], ends=0):
                return any(is_clock(heading(cell).name) for cell in cells), width
    return False, 0


def _paired(text: str, begins: Record, shape: _Shape) -> bool:
    """Return whether each second cell may be the decimals of the one before."""
    every = (_cells(one, shape) for one in _rows(text, begins, shape))
    fits = (len(row) == shape.width and all(cell.isdecimal() for cell in row[1::2]) for row in every)
    return shape.width % 2 == 0 and all(fits)


def _looks_like_row(record: Record, shape: _Shape) -> bool:
    """Return whether a record above the rows looks like one of them, in which some cells are no numbers."""
    numbers = [is_number(cell) for cell in _cells(record, shape)]
    return not record.comment and len(numbers) == shape.width and numbers[0] and sum(numbers) * 2 >= shape.width > 1


def _rows(text: str, begins: Record, shape: _Shape) -> Iterator[Record]:
    below = records(text, shape.delimiter, begins.start, begins.line, strict=False)
    return (one for one in below if not one.comment and not one.blank and (not shape.again or _is_row(one, shape)))


def _is_row(record: Record, shape: _Shape) -> bool:
    return tuple(cell.strip() for cell in record.cells) != shape.again


def _clock_names(head: Sequence[tuple[int, str]], shape: _Shape) -> tuple[str, ...]:
    """Return the cells of the last record above the rows, if they are names of times and more, as they stand there."""
    last = next(records(head[-1][1], shape.delimiter, strict=False), None) if head else None
    cells = () if last is None else tuple(cell.strip() for cell in last.cells)
    return cells if any(is_clock(heading(cell).name) for cell in cells) else ()


def _name_above(head: Sequence[tuple[int, str]], shape: _Shape, place: int) -> str:
    """Return the name of a column, its number from 1 where no record above the rows has a name for each."""
    for _, raw in head[: -NEAREST - 1 : -1]:
        for cells in _heading_rows(raw, shape):
            if len(own := cells[shape.first :]) == shape.width and not all(map(is_unit, own)) and not are_numbers(own):
                return heading(own[place]).name or str(place + 1)
    return str(place + 1)


def _decimal(text: str, begins: Record, shape: _Shape, most: int | None, stated: Stated) -> str:
    def cells() -> Iterator[str]:
        return chain.from_iterable(_cells(one, shape) for one in islice(_rows(text, begins, shape), most))

    decimal = decimal_sign(cells(), shape.delimiter)
    if decimal is None and most is not None:
        return _decimal(text, begins, shape, None, stated)
    if decimal is None:
        raise unclear_decimal("", stated, decimal_sign(cells(), shape.delimiter, printed=True))
    return decimal


def _fast(raw: bytes, start: int, shape: _Shape, decimal: str) -> list[NDArray[Any]] | None:
    """Return the columns below a place as pandas reads them, None where they are no plain numbers throughout."""
    import pandas as pd

    if shape.first or any(raw.find(sign, start) >= 0 for sign in b"#%/") or decimal == shape.delimiter:
        return None
    below = io.BytesIO(raw)
    below.seek(start)
    try:
        # A column of which some parts are no numbers is only warned of.
        with warnings.catch_warnings(action="error", category=pd.errors.DtypeWarning):
            frame = pd.read_csv(
                below,
                sep=shape.delimiter or r"\s+",
                decimal=decimal,
                header=None,
                na_filter=False,
            )
    except (ValueError, OverflowError, pd.errors.DtypeWarning):
        return None
    columns = [frame[place].to_numpy() for place in frame.columns]
    if len(columns) != shape.width or any(
        one.dtype.kind not in "iuf" or not np.all(np.isfinite(one)) for one in columns
    ):
        return None
    return columns


def _rows_of_no_samples(values: Sequence[NDArray[Any]], *, first: bool) -> int:
    """Return how many rows at the beginning hold no samples, but one value in all columns: one says how many rows
    follow; two, `first` in a text, when they began, s since 1970, and at which rate.
    """
    rows = min(map(len, values))
    tops = [{float(one[row]) for one in values} for row in range(min(rows, 2))]
    if rows <= SAID_IN_ROWS or len(tops[0]) > 1:
        return 0
    if tops[0] == {rows - 1.0} and len(values) > 1:
        return 1
    (began,), rate = tops[0], min(tops[1])
    return 2 if first and len(tops[1]) == 1 and EPOCH_S[0] < began < EPOCH_S[1] and 0 < rate < EPOCH_S[0] else 0


def _cut(text: str, shape: _Shape, decimal: str) -> str:
    """Return what makes the last row look cut off: no line end, and fewer decimals than each of the rows before."""
    if not decimal or text.endswith(("\n", "\r")):
        return ""
    last = [line.rstrip() for line in text[-TAIL:].splitlines()[1:]][-LAST_ROWS:]
    decimals = [len(line.rpartition(shape.delimiter or " ")[2].strip('" ').partition(decimal)[2]) for line in last]
    fixed = len(decimals) == LAST_ROWS and len(set(decimals[:-1])) == 1 and decimals[-1] < decimals[0]
    return f"the last row has no line end, and {decimals[-1]} decimals where others have {decimals[0]}" if fixed else ""


def _slow(
    text: str, head: Sequence[tuple[int, str]], begins: Record, shape: _Shape, decimal: str
) -> tuple[list[NDArray[Any]], tuple[int, int] | None]:
    """Return the columns, and the line and numbers of the first row at which one of them ends before the others."""
    columns: list[list[float]] = [[] for _ in range(shape.width)]
    empty: list[list[tuple[int, int]]] = [[] for _ in range(shape.width)]
    for row, record in enumerate(_rows(text, begins, shape)):
        cells = _cells(record, shape)
        filled = sum(bool(cell.strip()) for cell in cells)
        if len(cells) > shape.width or not filled or (len(cells) < shape.width and not shape.delimiter):
            raise RecordingError(
                f"got {filled} numbers",
                remedy="correct or remove the line",
                allowed=f"{shape.width}, as in line {begins.line}",
                line=record.line,
            )
        for place in range(shape.width):
            bare = cells[place].strip() if place < len(cells) else ""
            value = int(bare) if bare.isascii() and bare.isdecimal() else number(bare, decimal)
            if not bare:
                empty[place].append((row, record.line))
            elif not isfinite(value) and not is_missing(bare):
                raise RecordingError(
                    f"got {bare[:40]!r} in column '{_name_above(head, shape, place)}'",
                    remedy="correct the line, or keep the rows above it, or below it, in a file of their own",
                    allowed="a number in every row",
                    line=record.line,
                )
            columns[place].append(value if isfinite(value) or bare.lower() not in BEYOND else inf)
    short = _shortened(columns, empty)
    if not all(columns):
        raise _unreadable()
    return [_array(column) for column in columns], short


def _shortened(columns: list[list[float]], empty: list[list[tuple[int, int]]]) -> tuple[int, int] | None:
    """Cut the empty cells at the end of each column, of row and line; return the first such line, and its numbers."""
    lasts: list[tuple[int, int]] = []
    for column, gaps in zip(columns, empty, strict=True):
        line = 0
        while gaps and gaps[-1][0] == len(column) - 1:
            line = gaps.pop()[1]
            column.pop()
        lasts += [(line, len(column))] if line else []
    first = min(lasts, default=None)
    return None if first is None else (first[0], sum(len(column) > first[1] for column in columns))


def _array(values: list[float]) -> NDArray[Any]:
    made = np.array(values)
    return made if made.dtype.kind in "iuf" else np.array(values, dtype=np.float64)


def _is_no_name(cell: str) -> bool:
    return bool(cell) and (is_unit(cell) or is_number(cell))


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether cells above units are names: those of times and more, or none of them a number or a unit."""
    unlike = any(map(_is_no_name, cells))
    clocks = (is_clock(heading(cell).name) or cell.lower() in ABSCISSAS for cell in cells if not _is_no_name(cell))
    return not unlike or any(clocks)


def _headings(
    head: Sequence[tuple[int, str]], shape: _Shape, values: Sequence[NDArray[Any]], *, ends: int
) -> tuple[list[Heading], tuple[int, ...]]:
    """Return the name and unit of each column, and the lines they are from; rows have `ends` more cells.

    Of the last `NEAREST` records above the rows, those count that have a cell for each column: the last one holds the
    names, or the last one above a row of units.
    """
    if (tagged := _tagged(head, shape)) is not None:
        return tagged
    fitting = _fitting(head, shape, values, ends=ends)
    if not fitting:
        return [Heading("", "")] * shape.width, ()
    below = [
        place
        for place, (_, cells) in enumerate(fitting)
        if all(is_unit(cell) for cell in cells if cell) or (place and _times_below(fitting[place - 1][1], cells))
    ]
    above = fitting[below[-1] - 1][1] if below else []
    if below and not (below[-1] and _are_names(above)):
        # No names stand above these units.
        return [Heading("", cell) for cell in fitting[below[-1]][1]], (fitting[below[-1]][0],)
    if below and below[-1] > 0:
        (named, names), (line, row) = fitting[below[-1] - 1], fitting[below[-1]]
        return [_with_unit(name, cell) for name, cell in zip(names, row, strict=True)], (named, line)
    line, cells = fitting[-1]
    return [heading(cell) for cell in cells], (line,)


def _tagged(head: Sequence[tuple[int, str]], shape: _Shape) -> tuple[list[Heading], tuple[int, ...]] | None:
    """Return names and units in lines that say so, as `_headings` does; a column of times before them has none."""
    found: dict[tuple[str, ...], tuple[int, list[str]]] = {}
    for line, raw in head:
        tag, *cells = (cell.strip() for cell in raw.rstrip("\r\n").split(shape.delimiter or None))
        for tags in (_NAMES, _UNITS):
            if tag in tags and 0 <= shape.width - len(cells) <= 1:
                found[tags] = line, ["Time", *cells] if len(cells) < shape.width else cells
    if _NAMES not in found:
        return None
    units = found.get(_UNITS, (0, [""] * shape.width))[1]
    made = [Heading(name, "" if unit == "Time" else unit) for name, unit in zip(found[_NAMES][1], units, strict=True)]
    return made, tuple(line for line, _ in found.values())


def _fitting(
    head: Sequence[tuple[int, str]], shape: _Shape, values: Sequence[NDArray[Any]], *, ends: int
) -> list[tuple[int, list[str]]]:
    """Return line and cells of the records that may be headings: above one column, none if some are sentences."""
    made = [(line, cells) for line, raw in head[-NEAREST:] if (cells := _heading_cells(raw, shape, values, ends=ends))]
    names = [one for one in made if not _is_remark(one[1])]
    return names if shape.width > 1 or len(names) == len(made) else []


def _is_remark(cells: Sequence[str]) -> bool:
    """Return whether cells say something of the recording: `Y unit:` and `m/s2`, rates, or a sentence above one column.

    Several columns have no heading of one word, nor do they share one.
    """
    filled = [cell for cell in cells if cell]
    alone = len(filled) == 1 and ":" in cells[0]
    alike = len(filled) > 1 and len(set(filled)) == 1 and not is_unit(filled[0])
    return cells[0].endswith((":", "=")) or cells[0] in _TAGS or alone or alike or all(map(is_rate, filled))


def _times_below(names: Sequence[str], cells: Sequence[str]) -> bool:
    """Return whether a unit of time stands below a name of times, and below the other names no such ones."""
    clocks = [is_clock(heading(name).name) and not is_unit(name) for name in names]
    units = [bool(time_unit(Heading("", heading(cell).unit or cell))) for cell in cells]
    return any(clocks) and clocks == units


def _with_unit(name: str | Heading, below: str) -> Heading:
    """Return a heading with the unit that stands below it; with both, where they contradict each other."""
    above, unit = heading(name) if isinstance(name, str) else name, heading(below).unit or below
    own = above.unit or (time_unit(above) if is_clock(above.name) else "")
    if unit and own and contradict(own, unit):
        return Heading(above.name, f"{own}{BESIDE}{unit}")
    return Heading(above.name, unit or own)


def _names_in(raw: str, shape: _Shape) -> list[str]:
    """Return the cells of a record that looks like names of columns, with times or units; none of another record."""
    comment = COMMENT_SIGN.match(raw) is not None and not raw.lstrip().startswith(shape.delimiter)
    bare = COMMENT_SIGN.sub("", raw, count=1) if comment else raw
    row = next(csv.reader([bare.strip("\r\n")], delimiter=shape.delimiter), [])
    cells = [cell.strip() for cell in row if cell.strip()]
    like = any(is_clock(heading(cell).name) or heading(cell).unit for cell in cells)
    other = any(map(is_number, cells)) or any(map(is_step, cells))
    return cells if like and not other and len(cells) > 1 and not _is_remark(cells) else []


def _is_timed(one: Heading) -> bool:
    return is_clock(one.name) or bool(time_unit(one))


def _refuse_dropped(
    head: Sequence[tuple[int, str]],
    lines: Sequence[int],
    shape: _Shape,
    values: Sequence[NDArray[Any]],
    stated: Stated,
) -> None:
    """Refuse names right above the rows that are more or fewer than the columns, where no others are for certain."""
    line, raw = head[-1] if head else (0, "")
    aside = stated.rate_hz is not None or (stated.time_column or "").isdecimal()
    if aside or not shape.delimiter or (lines and line <= lines[-1]):
        return
    cells = _names_in(raw, shape)
    if not cells:
        return
    words = "correct the line in a copy, or leave names aside: state the number of the column of times, and its unit"
    clock = next((place for place, cell in enumerate(cells) if is_clock(heading(cell).name)), 0)
    unit = time_unit(heading(cells[clock])) or likely_unit(float(np.median(np.diff(values[0]))), float(values[0][0]))
    options: tuple[str, ...] = ("--time-column", "1", "--time-unit", unit)
    if values[0].dtype.kind in "iu" and not any(is_clock(heading(cell).name) for cell in cells):
        words = "correct the line in a copy, or leave names aside: state the rate"
        options = ("--rate", rate_in("".join(above for _, above in head)))
    raise RecordingError(
        f"got {len(cells)} names above rows of {shape.width} numbers",
        remedy=stated.remedy(words, *options),
        allowed="a name for each column",
        line=line,
    )


def _heading_cells(raw: str, shape: _Shape, values: Sequence[NDArray[Any]], *, ends: int) -> list[str]:
    """Return the cells of a heading, one for each column; none where the record has another number of them.

    R leaves out the name of its numbers of rows. Where rows have `ends` more cells, as many more names may be those of
    columns in which nothing stands.
    """
    counts = bool(np.array_equal(values[0], np.arange(len(values[0])) + values[0][0]))
    # An empty first cell stands above numbers of rows; above others its semicolon is a comment sign.
    index = counts and not raw.lstrip().startswith("; ")
    for row in _heading_rows(raw, shape):
        cells = row[shape.first :]
        while len(cells) > shape.width and not cells[-1]:
            cells = cells[:-1]
        if shape.width < len(cells) <= shape.width + ends and (index or cells[0]):
            cells = cells[: shape.width]
        if len(cells) == shape.width and not are_numbers([cell for cell in cells if cell] or ["0"]):
            return cells
        if counts and values[0][0] == 1 and len(cells) == shape.width - 1 > 1 and all(cells):
            return ["", *cells]
    return []


def _heading_rows(raw: str, shape: _Shape) -> Iterator[list[str]]:
    """Yield the cells of a heading in each way to part them: its delimiter may be another than that of the rows, and a
    comment sign may stand at its beginning.
    """  # fmt: skip
    bare = COMMENT_SIGN.sub("", raw, count=1)
    # A semicolon may be the delimiter behind an empty first cell, or a comment sign.
    texts = (raw, bare) if shape.delimiter and raw.lstrip(" ").startswith(shape.delimiter) else (bare,)
    for sign in dict.fromkeys((*filter(None, (shape.delimiter,)), *DELIMITERS)):
        for text in texts:
            lines = io.StringIO(text.strip("\r\n"), newline="")
            yield [cell.strip() for cell in next(csv.reader(lines, delimiter=sign), [])]
    for pattern in (r"\s{2,}", r"\s+") if not shape.delimiter or bare != raw else (r"\s{2,}",):
        yield [cell.strip(' \t,;"') for cell in re.split(pattern, bare.strip())]
