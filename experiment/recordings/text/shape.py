"""How the rows of delimited text are parted: its delimiter, the cells of a row, and the record at which rows begin."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.cells import STATISTIC, are_numbers, is_number, remedy_of
from palpate.experiment.settings.delimited import (
    DELIMITERS,
    SAMPLE,
    Record,
    Stated,
    records,
)
from palpate.experiment.settings.units import (
    heading,
    is_clock,
    is_step,
    rate_in,
)

TAIL, LAST_ROWS = 4096, 12
"""Characters of a text's end, and rows among them, that are looked at for one that is cut off."""


class Lines(Protocol):
    """The line of each row in its file, from 1."""

    def __getitem__(self, row: int, /) -> int:
        """Return the line of a row, from 0."""
        ...


@dataclass(frozen=True)
class Shape:
    """How the rows of a text are parted: cells of a row after `first` empty ones, and where the rows begin.

    Rows whose cells are `again`, names with one of times, are a heading that a program wrote once more.
    """

    delimiter: str
    first: int
    width: int
    rows: int
    again: tuple[str, ...] = ()


@dataclass(frozen=True)
class RowLines:
    """The line of each row, looked for when it is asked for: errors alone ask."""

    text: str
    begins: Record
    shape: Shape

    def __getitem__(self, row: int) -> int:
        """Return the line of a row, from 0."""
        return next(islice(rows_of(self.text, self.begins, self.shape), row, None)).line


def unreadable() -> RecordingError:
    return RecordingError(
        "got no line with two or more numbers",
        remedy="give another file",
        allowed="WAV, LabVIEW .lvm, or text columns with a time column",
    )


def cells_of(record: Record, shape: Shape) -> list[str]:
    """Return the cells of a record without those before its numbers, or behind them if those are empty or remarks."""
    cells = record.cells[shape.first :]
    return cells if any(map(is_number, cells[shape.width :])) else cells[: shape.width]


def _trimmed(cells: list[str]) -> tuple[int, list[str]]:
    filled = [place for place, cell in enumerate(cells) if cell.strip()] or [0]
    return filled[0], cells[filled[0] : filled[-1] + 1]


def shape_of(text: str, stated: Stated) -> Shape:
    """Return how rows are parted; they have two or more cells where no rate is stated, since one is of times."""
    shapes: list[Shape] = []
    # What stands above the rows may be longer than a sample.
    for least, most in ((2, SAMPLE), (2, None), (1, None)):
        shapes = [_shape(text, delimiter, most, least) for delimiter in (*DELIMITERS, "")]
        if any(one.rows for one in shapes):
            break
    shape = max(shapes, key=lambda one: (one.rows, one.width > 1))
    if shape.rows > 1 and shape.width == 1 and stated.rate_hz is None:
        remedy = stated.remedy("give its rate", "--rate", rate_in(text[:TAIL]))
        raise RecordingError(
            "got one column without times", remedy=remedy, allowed="times, or a rate given as an option"
        )
    return shape


def _shape(text: str, delimiter: str, most: int | None, least: int) -> Shape:
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
    return Shape(delimiter, first, width, rows)


def head_of(text: str, shape: Shape) -> tuple[list[tuple[int, str]], Record]:
    """Return line and text of each record above the first row of numbers, and that row."""
    if shape.rows < 1 + (shape.width < 2):
        raise unreadable()
    head: list[Record] = []
    for record in records(text, shape.delimiter, strict=False):
        cells = cells_of(record, shape)
        below_step = head and any(is_step(cell) for cell in head[-1].cells)
        if not record.comment and len(cells) == shape.width and are_numbers(cells) and not below_step:
            break
        head.append(record)
    if head and len(cells_of(head[-1], shape)) == shape.width and are_numbers(cells_of(head[-1], shape)):
        _refuse_unclear_step(*head[-2:])
        record = head.pop()
    if head and _looks_like_row(head[-1], shape):
        wrong = next(cell for cell in cells_of(head[-1], shape) if not is_number(cell))
        raise RecordingError(
            f"got {wrong.strip()[:40]!r} among numbers",
            remedy=remedy_of(wrong, "correct the line, or remove it"),
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
            "got numbers between an increment and the rows",
            remedy="write the name of each column above the rows, or remove the line",
            allowed="names between an increment and the rows",
            line=numbers.line,
        )


def _looks_like_row(record: Record, shape: Shape) -> bool:
    """Return whether a record above the rows looks like one of them, in which some cells are no numbers."""
    numbers = [is_number(cell) for cell in cells_of(record, shape)]
    return not record.comment and len(numbers) == shape.width and numbers[0] and sum(numbers) * 2 >= shape.width > 1


def refuse_statistics(text: str, begins: Record, shape: Shape) -> None:
    """Refuse a row near the end that is called a mean or the like, where the first row has no word."""
    start = max(begins.start, text.rfind("\n", 0, max(len(text) - TAIL, 0)) + 1)
    for record in records(text, shape.delimiter, start, text.count("\n", 0, start) + 1, strict=False):
        for cell, first in zip(record.cells, (*begins.cells, *[""] * len(record.cells)), strict=False):
            if STATISTIC.fullmatch(cell.strip().lower()) and (is_number(first) or not first.strip()):
                raise RecordingError(
                    f"got a row called {cell.strip()!r} below the samples, probably a summary",
                    remedy="put the rows above it in a separate file",
                    allowed="rows of samples",
                    line=record.line,
                )


def rows_of(text: str, begins: Record, shape: Shape) -> Iterator[Record]:
    below = records(text, shape.delimiter, begins.start, begins.line, strict=False)
    return (one for one in below if not one.comment and not one.blank and (not shape.again or _is_row(one, shape)))


def _is_row(record: Record, shape: Shape) -> bool:
    return tuple(cell.strip() for cell in record.cells) != shape.again
