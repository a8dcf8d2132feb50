"""Columns of numbers in delimited text: where they begin, what stands above them, and their values.

Rows are the records that are numbers throughout, as many as most have. Values are read by pandas; what it does not take
for a number is read again, record by record, for thousands, Fortran's exponents, or the line of an error.
"""

import csv
import io
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.stamps import without_stamps
from palpate.experiment.settings.delimited import (
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
from palpate.experiment.settings.units import Heading, heading, is_unit

NEAREST = 4
"""Records above the rows among which names and units are looked for."""

TAIL, LAST_ROWS = 4096, 12
"""Characters of a text's end, and rows among them, that are looked at for one that is cut off."""

_SIGN = re.compile(r"\A\s*(?:#+|%+|//+|;+)\s?")


@dataclass(frozen=True)
class Columns:
    """The columns of a text: headings, finite values, each (n,) and whole where all are, and the lines of rows.

    Columns at the places `stamped` are dates or times of day, in nanoseconds. `cut` says what makes the last row look
    cut off, and is empty where nothing does.
    """

    headings: tuple[Heading, ...]
    values: tuple[NDArray[Any], ...]
    lines: "RowLines"
    understood: Understood
    stamped: tuple[int, ...]
    cut: str


@dataclass(frozen=True)
class _Shape:
    """How the rows of a text are parted: cells of a row after `first` empty ones, and where the rows begin."""

    delimiter: str
    first: int
    width: int
    rows: int


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
    shape = max(
        (_shape(text, delimiter, SAMPLE) for delimiter in (*DELIMITERS, "")), key=lambda one: (one.rows, one.width > 1)
    )
    if not shape.rows:
        # What stands above the rows may be longer than a sample.
        shape = max((_shape(text, delimiter, None) for delimiter in (*DELIMITERS, "")), key=lambda one: one.rows)
    if not shape.rows:
        raise RecordingError(
            "got no line of two or more numbers",
            remedy="name another file",
            allowed="WAV, LabVIEW .lvm, or text columns with a column of times",
        )
    head, begins = _head(text, shape)
    decimal = stated.decimal or _decimal(text, begins, shape, SAMPLE, stated)
    values = _fast(raw, len(text[: begins.start].encode()), shape, decimal or ".")
    if values is None:
        decimal = stated.decimal or _decimal(text, begins, shape, None, stated)
        values = _slow(text, begins, shape, decimal or ".")
    ends = len(begins.cells) > shape.first + shape.width
    headings, lines = _headings(head, shape, values, ends=ends)
    stamped = tuple(
        place
        for place, column in enumerate(values)
        if column.dtype.kind == "i" and {int(column[0]), int(column[-1])} <= stamps_ns
    )
    for place in stamped:
        headings[place] = Heading(headings[place].name, "ns")
    names, units = tuple(one.name for one in headings), tuple(one.unit for one in headings)
    understood = Understood(encoding, shape.delimiter, decimal, lines, names, units, begins.line, len(values[0]))
    held = RowLines(text, begins, shape)
    return Columns(tuple(headings), tuple(values), held, understood, stamped, _cut(text, shape, decimal))


def _cells(record: Record, shape: _Shape) -> list[str]:
    """Return the cells of a record without those before its numbers, or a last one that is empty or a remark."""
    cells = record.cells[shape.first :]
    return cells[:-1] if len(cells) == shape.width + 1 and not _is_number(cells[-1]) else cells


def _is_number(cell: str) -> bool:
    return any(isfinite(number(cell, decimal)) for decimal in ".,")


def _numeric(cells: Sequence[str]) -> bool:
    return len(cells) > 1 and all(map(_is_number, cells))


def _trimmed(cells: list[str]) -> tuple[int, list[str]]:
    first = next((place for place, cell in enumerate(cells[:-1]) if cell.strip()), 0)
    return first, cells[first : -1 if len(cells) > 1 and not cells[-1].strip() else None]


def _shape(text: str, delimiter: str, most: int | None) -> _Shape:
    shapes = Counter(
        (first, len(cells))
        for record in islice(records(text, delimiter, strict=False), most)
        if not record.comment and record.cells
        for first, cells in (_trimmed(record.cells),)
        if _numeric(cells)
    )
    (first, width), rows = shapes.most_common(1)[0] if shapes else ((0, 0), 0)
    return _Shape(delimiter, first, width, rows)


def _head(text: str, shape: _Shape) -> tuple[list[tuple[int, str]], Record]:
    """Return line and text of each record above the first row of numbers, and that row."""
    head: list[Record] = []
    for record in records(text, shape.delimiter, strict=False):
        cells = _cells(record, shape)
        if not record.comment and len(cells) == shape.width and _numeric(cells):
            break
        head.append(record)
    if head and _looks_like_row(head[-1], shape):
        wrong = next(cell for cell in _cells(head[-1], shape) if not _is_number(cell))
        raise RecordingError(
            f"got {wrong.strip()[:40]!r} among numbers",
            remedy="correct the line, or remove it",
            allowed="a number in every row",
            line=head[-1].line,
        )
    ends = [one.start for one in (*head, record)][1:]
    raw = [(one.line, text[one.start : end]) for one, end in zip(head, ends, strict=True)]
    return [(line, one) for line, one in raw if one.strip()], record


def _looks_like_row(record: Record, shape: _Shape) -> bool:
    """Return whether a record above the rows looks like one of them, in which some cells are no numbers."""
    numbers = [_is_number(cell) for cell in _cells(record, shape)]
    return not record.comment and len(numbers) == shape.width and numbers[0] and sum(numbers) * 2 >= shape.width > 1


def _rows(text: str, begins: Record, shape: _Shape) -> Iterator[Record]:
    below = records(text, shape.delimiter, begins.start, begins.line, strict=False)
    return (one for one in below if not one.comment and not one.blank)


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


def _cut(text: str, shape: _Shape, decimal: str) -> str:
    """Return what makes the last row look cut off: no line end, and fewer decimals than each of the rows before."""
    if not decimal or text.endswith(("\n", "\r")):
        return ""
    last = [line.rstrip() for line in text[-TAIL:].splitlines()[1:]][-LAST_ROWS:]
    decimals = [len(line.rpartition(shape.delimiter or " ")[2].strip('" ').partition(decimal)[2]) for line in last]
    fixed = len(decimals) == LAST_ROWS and len(set(decimals[:-1])) == 1 and decimals[-1] < decimals[0]
    return f"the last row has no line end, and {decimals[-1]} decimals where others have {decimals[0]}" if fixed else ""


def _slow(text: str, begins: Record, shape: _Shape, decimal: str) -> list[NDArray[Any]]:
    columns: list[list[float]] = [[] for _ in range(shape.width)]
    for record in _rows(text, begins, shape):
        cells = _cells(record, shape)
        filled = sum(bool(cell.strip()) for cell in cells)
        if filled != shape.width or len(cells) != shape.width:
            raise RecordingError(
                f"got {filled} numbers",
                remedy="correct or remove the line",
                allowed=f"{shape.width}, as in line {begins.line}",
                line=record.line,
            )
        for place, cell in enumerate(cells):
            bare = cell.strip()
            value = int(bare) if bare.isascii() and bare.isdecimal() else number(bare, decimal)
            if not isfinite(value):
                raise RecordingError(
                    f"got {bare[:40]!r} in column '{place + 1}'",
                    remedy="correct the line, or export the measurement again",
                    allowed="a number in every row",
                    line=record.line,
                )
            columns[place].append(value)
    return [_array(column) for column in columns]


def _array(values: list[float]) -> NDArray[Any]:
    made = np.array(values)
    return made if made.dtype.kind in "iuf" else np.array(values, dtype=np.float64)


def _headings(
    head: Sequence[tuple[int, str]], shape: _Shape, values: Sequence[NDArray[Any]], *, ends: bool
) -> tuple[list[Heading], tuple[int, ...]]:
    """Return the name and unit of each column, and the lines they are from; `ends` if rows end in a delimiter.

    Of the last `NEAREST` records above the rows, those count that have a cell for each column: the last one holds the
    names, or the last one above a row of units.
    """
    fitting = [
        (line, cells) for line, raw in head[-NEAREST:] if (cells := _heading_cells(raw, shape, values, ends=ends))
    ]
    if not fitting:
        return [Heading("", "")] * shape.width, ()
    below = [place for place, (_, cells) in enumerate(fitting) if all(is_unit(cell) for cell in cells if cell)]
    if below and below[-1] > 0:
        (named, names), (line, row) = fitting[below[-1] - 1], fitting[below[-1]]
        units = [heading(cell).unit or cell for cell in row]
        return [Heading(heading(name).name, unit) for name, unit in zip(names, units, strict=True)], (named, line)
    line, cells = fitting[-1]
    return [heading(cell) for cell in cells], (line,)


def _heading_cells(raw: str, shape: _Shape, values: Sequence[NDArray[Any]], *, ends: bool) -> list[str]:
    """Return the cells of a heading, one for each column; none where the record has another number of them.

    R leaves out the name of its numbers of rows. Where rows end in a delimiter, the last name may be that of a column
    in which nothing stands.
    """
    counts = bool(np.array_equal(values[0], np.arange(len(values[0])) + values[0][0]))
    # An empty first cell stands above numbers of rows; above others its semicolon is a comment sign.
    index = counts and not raw.lstrip().startswith("; ")
    for row in _heading_rows(raw, shape):
        cells = row[shape.first :]
        if len(cells) == shape.width + 1 and (not cells[-1] or (ends and (index or cells[0]))):
            cells = cells[:-1]
        if len(cells) == shape.width and any(cells) and not _numeric(cells):
            return cells
        if counts and values[0][0] == 1 and len(cells) == shape.width - 1 > 1 and all(cells):
            return ["", *cells]
    return []


def _heading_rows(raw: str, shape: _Shape) -> Iterator[list[str]]:
    """Yield the cells of a heading in each way to part them: its delimiter may be another than that of the rows, and a
    comment sign may stand at its beginning.
    """  # fmt: skip
    bare = _SIGN.sub("", raw, count=1)
    # A semicolon may be the delimiter behind an empty first cell, or a comment sign.
    texts = (raw, bare) if shape.delimiter and raw.lstrip(" ").startswith(shape.delimiter) else (bare,)
    for sign in dict.fromkeys((*filter(None, (shape.delimiter,)), *DELIMITERS)):
        for text in texts:
            lines = io.StringIO(text.strip("\r\n"), newline="")
            yield [cell.strip() for cell in next(csv.reader(lines, delimiter=sign), [])]
    for pattern in (r"\s{2,}", r"\s+") if not shape.delimiter or bare != raw else (r"\s{2,}",):
        yield [cell.strip(' \t,;"') for cell in re.split(pattern, bare.strip())]
