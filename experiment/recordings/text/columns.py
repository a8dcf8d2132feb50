"""Columns of numbers in delimited text: where they begin, what stands above them, and their values.

Rows are the records that are numbers throughout, as many as most have. Values are read by pandas; what it does not take
for a number is read again, record by record, for thousands, Fortran's exponents, or the line of an error.
"""

import io
import warnings
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.behind import without_units
from palpate.experiment.recordings.text.cells import BEYOND, is_missing, remedy_of
from palpate.experiment.recordings.text.decimals import decimal_of, decimal_points
from palpate.experiment.recordings.text.headings import (
    SAID,
    clock_names,
    headings_of,
    is_timed,
    name_above,
    refuse_dropped,
    said_beside,
    step_of,
    units_beside,
    with_unit,
)
from palpate.experiment.recordings.text.sections import has_rows, section_of
from palpate.experiment.recordings.text.shape import (
    LAST_ROWS,
    TAIL,
    RowLines,
    Shape,
    cells_of,
    head_of,
    refuse_statistics,
    rows_of,
    shape_of,
    unreadable,
)
from palpate.experiment.recordings.text.stamps import without_stamps
from palpate.experiment.recordings.text.words import (
    refuse_hexadecimals,
    without_hexadecimals,
    without_names,
    without_words,
)
from palpate.experiment.settings.delimited import (
    SAMPLE,
    Record,
    Stated,
    Understood,
    number,
)
from palpate.experiment.settings.units import (
    Heading,
)

SAID_IN_ROWS, EPOCH_S = 10, (1e9, 2e9)
"""Shorter columns have no row that says something of the others, and recordings began between these, s since 1970."""


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


class _Parted(NamedTuple):
    """A text, how its rows are parted, the records above them, the first row, and the decimal sign."""

    text: str
    shape: Shape
    head: list[tuple[int, str]]
    begins: Record
    decimal: str


def read_columns(content: bytes, text: str, encoding: str, stated: Stated) -> Columns:
    """Return the columns of a text, and how they were read. Raises `RecordingError` with the line of what is wrong.

    `content` is that of its file.
    """
    original = text
    plain, (text, stamps_ns) = len(text) == len(content) and text.isascii(), without_stamps(text)
    # Of a large file each copy costs as much as some of its reading.
    raw = content if plain and not stamps_ns else text.encode()
    made = _columns(raw, text, stamps_ns, encoding, stated)
    # Arrows and names between numbers were replaced.
    if made.understood.delimiter in original:
        return made
    return replace(made, understood=replace(made.understood, delimiter=""))


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

    shape = shape_of(text, stated)
    if not shape.rows and (plain := _plain(text)) is not None:
        made = again(plain[0], stated)
        return _in_units(made, plain[1]) if plain[1] else made
    if stated.section is not None and (section := of_section()) is not None:
        return section
    head, begins = head_of(text, shape)
    if has_rows(text[: begins.start], shape.delimiter, shape.first) and (section := of_section()) is not None:
        return section
    shape = replace(shape, again=clock_names(head, shape))
    if next(rows_of(text, begins, shape), None) is None:
        raise unreadable()
    refuse_statistics(text, begins, shape)
    if shape.delimiter == "," and (points := decimal_points(text, head, begins, shape, stated)) is not None:
        made = again(points, replace(stated, decimal="."))
        return replace(made, understood=replace(made.understood, decimal=","))
    decimal = stated.decimal or decimal_of(text, begins, shape, SAMPLE, stated)
    values = _fast(raw, len(text[: begins.start].encode()), shape, decimal or ".")
    short = None
    if values is None and (section := of_section()) is not None:
        return section
    if values is None:
        decimal = stated.decimal or decimal_of(text, begins, shape, None, stated)
        values, short = _slow(text, head, begins, shape, decimal or ".")
    parted = _Parted(text, shape, head, begins, decimal)
    if (above := _rows_of_no_samples(values, first=not head)) > 0:
        return again(_as_comments(parted, above), stated)
    return _described(parted, values, short, stamps_ns, encoding, stated)


def _as_comments(parted: _Parted, rows: int) -> str:
    """Return a text with a comment sign before each of so many rows at the beginning."""
    starts = [one.start for one in islice(rows_of(parted.text, parted.begins, parted.shape), rows)]
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
    headings, lines = headings_of(head, shape, values, ends=ends)
    said = said_beside(head, islice(rows_of(text, begins, shape), SAID), shape)
    headings, rate = units_beside(headings, said)
    above = text[: begins.start] + rate
    stamped = _stamped(values, stamps_ns)
    for place in stamped:
        headings[place] = Heading(headings[place].name, "ns")
    if not any(map(is_timed, headings)):
        refuse_dropped(head, lines, shape, values, stated)
    names, units = tuple(one.name for one in headings), tuple(one.unit for one in headings)
    understood = Understood(encoding, shape.delimiter, decimal, lines, names, units, begins.line, len(values[0]))
    held = RowLines(text, begins, shape)
    cut, step = _cut(text, shape, decimal), step_of(head, shape, decimal)
    return Columns(tuple(headings), tuple(values), held, understood, stamped, cut, step, above, short)


def _plain(text: str) -> tuple[str, tuple[str, ...]] | None:
    """Return a text without the words among its numbers, and the units that stood behind these; None without any."""
    if (bare := without_units(text)) is not None:
        return bare
    others = without_hexadecimals(text) or without_names(text) or without_words(text)
    if others is None:
        refuse_hexadecimals(text)
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
    headings = tuple(with_unit(*both) for both in zip(made.headings, behind, strict=True))
    units = tuple(one.unit for one in headings)
    return replace(made, headings=headings, understood=replace(made.understood, units=units))


def _fast(raw: bytes, start: int, shape: Shape, decimal: str) -> list[NDArray[Any]] | None:
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


def _cut(text: str, shape: Shape, decimal: str) -> str:
    """Return what makes the last row look cut off: no line end, and fewer decimals than each of the rows before."""
    if not decimal or text.endswith(("\n", "\r")):
        return ""
    last = [line.rstrip() for line in text[-TAIL:].splitlines()[1:]][-LAST_ROWS:]
    decimals = [len(line.rpartition(shape.delimiter or " ")[2].strip('" ').partition(decimal)[2]) for line in last]
    fixed = len(decimals) == LAST_ROWS and len(set(decimals[:-1])) == 1 and decimals[-1] < decimals[0]
    return (
        f"the last row has no line ending and {decimals[-1]} decimals, but others have {decimals[0]}" if fixed else ""
    )


def _slow(
    text: str, head: Sequence[tuple[int, str]], begins: Record, shape: Shape, decimal: str
) -> tuple[list[NDArray[Any]], tuple[int, int] | None]:
    """Return the columns, and the line and numbers of the first row at which one of them ends before the others."""
    columns: list[list[float]] = [[] for _ in range(shape.width)]
    empty: list[list[tuple[int, int]]] = [[] for _ in range(shape.width)]
    for row, record in enumerate(rows_of(text, begins, shape)):
        cells = cells_of(record, shape)
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
                    f"got {bare[:40]!r} in column '{name_above(head, shape, place)}'",
                    remedy=remedy_of(bare, "correct the line, or put the rows above or below it in a separate file"),
                    allowed="a number in every row",
                    line=record.line,
                )
            columns[place].append(value if isfinite(value) or bare.lower() not in BEYOND else inf)
    short = _shortened(columns, empty)
    if not all(columns):
        raise unreadable()
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
