"""Columns of numbers in delimited text: where they begin, what stands above them, and their values.

Rows are the records that are numbers throughout, as many as most have. Values are read by pandas; what it does not take
for a number is read again, record by record, for thousands, Fortran's exponents, or the line of an error.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.units import Heading, heading, is_unit
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

NEAREST = 4
"""Records above the rows among which names and units are looked for."""

_SIGN = re.compile(r"\A\s*(?:#+|%+|//+|;+)\s?")


@dataclass(frozen=True)
class Columns:
    """The columns of a text: headings, finite values, each (n,) and whole where all are, and the lines of rows."""

    headings: tuple[Heading, ...]
    values: tuple[NDArray[Any], ...]
    lines: "RowLines"
    understood: Understood


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


def read_columns(text: str, encoding: str, stated: Stated) -> Columns:
    """Return the columns of a text, and how they were read. Raises `RecordingError` with the line of what is wrong."""
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
    values = _fast(text[begins.start :], shape, decimal or ".")
    if values is None:
        decimal = stated.decimal or _decimal(text, begins, shape, None, stated)
        values = _slow(text, begins, shape, decimal or ".")
    headings, lines = _headings(head, shape, values)
    names, units = tuple(one.name for one in headings), tuple(one.unit for one in headings)
    understood = Understood(encoding, shape.delimiter, decimal, lines, names, units, begins.line, len(values[0]))
    return Columns(tuple(headings), tuple(values), RowLines(text, begins, shape), understood)


def _cells(record: Record, shape: _Shape) -> list[str]:
    """Return the cells of a record without the empty one that a delimiter at its end makes, or one at its beginning."""
    cells = record.cells[shape.first :]
    return cells[:-1] if len(cells) == shape.width + 1 and not cells[-1].strip() else cells


def _is_number(cell: str) -> bool:
    return any(isfinite(number(cell, decimal)) for decimal in ".,")


def _numeric(cells: Sequence[str]) -> bool:
    return len(cells) > 1 and all(map(_is_number, cells))


def _trimmed(cells: list[str]) -> tuple[int, list[str]]:
    first = int(len(cells) > 1 and not cells[0].strip())
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
    ends = [one.start for one in (*head, record)][1:]
    raw = [(one.line, text[one.start : end]) for one, end in zip(head, ends, strict=True)]
    return [(line, one) for line, one in raw if one.strip()], record


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


def _fast(body: str, shape: _Shape, decimal: str) -> list[NDArray[Any]] | None:
    """Return the columns as pandas reads them, None where they are no plain numbers throughout."""
    import pandas as pd

    if shape.first or any(sign in body for sign in ("#", "%", "//")) or decimal == shape.delimiter:
        return None
    try:
        frame = pd.read_csv(
            io.BytesIO(body.encode()),
            sep=shape.delimiter or r"\s+",
            decimal=decimal,
            header=None,
            na_filter=False,
            low_memory=False,
        )
    except (ValueError, OverflowError):
        return None
    columns = [frame[place].to_numpy() for place in frame.columns]
    if len(columns) != shape.width or any(
        one.dtype.kind not in "iuf" or not np.all(np.isfinite(one)) for one in columns
    ):
        return None
    return columns


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
    head: Sequence[tuple[int, str]], shape: _Shape, values: Sequence[NDArray[Any]]
) -> tuple[list[Heading], tuple[int, ...]]:
    """Return the name and unit of each column, and the lines they are from.

    Of the last `NEAREST` records above the rows, those count that have a cell for each column: the last one holds the
    names, or the last one above a row of units.
    """
    fitting = [(line, cells) for line, raw in head[-NEAREST:] if (cells := _heading_cells(raw, shape, values))]
    if not fitting:
        return [Heading("", "")] * shape.width, ()
    below = [place for place, (_, cells) in enumerate(fitting) if all(is_unit(cell) for cell in cells if cell)]
    if below and below[-1] > 0:
        (named, names), (line, row) = fitting[below[-1] - 1], fitting[below[-1]]
        units = [heading(cell).unit or cell for cell in row]
        return [Heading(heading(name).name, unit) for name, unit in zip(names, units, strict=True)], (named, line)
    line, cells = fitting[-1]
    return [heading(cell) for cell in cells], (line,)


def _heading_cells(raw: str, shape: _Shape, values: Sequence[NDArray[Any]]) -> list[str]:
    """Return the cells of a heading, one for each column; none where the record has another number of them.

    A heading may have another delimiter than the rows, and a comment sign at its beginning. R leaves out the name of
    its numbers of rows.
    """
    bare = _SIGN.sub("", raw, count=1)
    blank = (r"\s{2,}", r"\s+") if not shape.delimiter or bare != raw else (r"\s{2,}",)
    numbered = bool(np.array_equal(values[0], np.arange(1, len(values[0]) + 1)))
    # A semicolon may be the delimiter behind an empty first cell, or a comment sign.
    texts = (raw, bare) if shape.delimiter and raw.lstrip(" ").startswith(shape.delimiter) else (bare,)
    delimited = (
        [cell.strip() for cell in next(csv.reader(io.StringIO(text.strip("\r\n"), newline=""), delimiter=sign), [])]
        for sign in dict.fromkeys((*filter(None, (shape.delimiter,)), *DELIMITERS))
        for text in texts
    )
    blanks = ([cell.strip(' \t,;"') for cell in re.split(pattern, bare.strip())] for pattern in blank)
    for row in chain(delimited, blanks):
        cells = row[shape.first :]
        cells = cells[:-1] if len(cells) == shape.width + 1 and not cells[-1] else cells
        if len(cells) == shape.width and any(cells) and not _numeric(cells):
            return cells
        if numbered and len(cells) == shape.width - 1 > 1 and all(cells):
            return ["", *cells]
    return []
