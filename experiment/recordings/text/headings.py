"""What stands above columns of numbers: their names and units, an increment of times, names written again."""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.cells import are_numbers, is_number
from palpate.experiment.recordings.text.shape import Shape
from palpate.experiment.settings.delimited import (
    COMMENT_SIGN,
    DELIMITERS,
    Record,
    Stated,
    number,
    records,
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

BESIDE = " beside "
"""Stands between two units of one column that contradict each other: that of its heading, and that below."""

_TAGS = frozenset(("DESCRIPTION", "TIME_STAMP", "DATA_INCLUDED", "MARKER_NAMES", "CHANNEL_GAIN", "ANALOG_FREQUENCY"))
"""What lines above the rows begin with that hold no names of columns, as Qualisys writes them."""

SAID = 40
"""Rows at the beginning that may have something of the recording before their numbers."""

_SAID = ("Horizontal Units", "Vertical Units", "Source", "Sample Interval")

_NAMES, _UNITS = ("ChannelTitle=", "CHANNEL_NAMES"), ("UnitName=",)
"""What lines of names and of units begin with, as LabChart and Qualisys write them."""


def step_of(head: Sequence[tuple[int, str]], shape: Shape, decimal: str) -> tuple[Heading, float] | None:
    """Return the name, unit and value of an increment, which scopes write above the rows in place of times."""
    rows = [next(csv.reader([raw.strip()], delimiter=shape.delimiter or " "), []) for _, raw in head]
    for names, below in pairwise(rows):
        for name, cell in zip(names, below, strict=False):
            if is_step(name) and number(cell, decimal or ".") > 0:
                of_rigol = (names[0].strip(), below[0].strip()) == ("X", "Sequence")
                return Heading(name, "s") if of_rigol else heading(name), number(cell, decimal or ".")
    return None


def said_beside(head: Sequence[tuple[int, str]], rows: Iterable[Record], shape: Shape) -> dict[str, str]:
    """Return what a scope of Tektronix says above the rows, or before the first ones: its labels, and their values."""
    above = (next(csv.reader([raw.strip()], delimiter=shape.delimiter or " "), []) for _, raw in head)
    beside = (one.cells[: shape.first] for one in rows)
    lines = [[cell.strip() for cell in cells] for cells in (*above, *beside)]
    # Some write the unit of times behind their interval.
    lines += [[_SAID[0], cells[2]] for cells in lines if cells[:1] == [_SAID[-1]] and is_unit("".join(cells[2:3]))]
    return {cells[0]: cells[1] for cells in lines if len(cells) > 1 and cells[0] in _SAID and cells[1]}


def units_beside(headings: Sequence[Heading], said: Mapping[str, str]) -> tuple[list[Heading], str]:
    """Return headings with the names and units that `said` has for them, and a line of the sampling rate.

    Units are those of the first column and of the only other one.
    """
    time, signal, source, interval = (said.get(one, "") for one in _SAID)
    made = list(headings)
    if time and not made[0].unit and (not made[0].name or is_clock(made[0].name)):
        made[0] = Heading(made[0].name or "time", time)
    if len(made) == 2 and not made[1].unit:
        made[1] = Heading(made[1].name or source, signal)
    return made, f"\nSample Interval: {interval} {time}\n" if interval and time else ""


def clock_names(head: Sequence[tuple[int, str]], shape: Shape) -> tuple[str, ...]:
    """Return the cells of the last record above the rows, if they are names of times and more, as they stand there."""
    last = next(records(head[-1][1], shape.delimiter, strict=False), None) if head else None
    cells = () if last is None else tuple(cell.strip() for cell in last.cells)
    return cells if any(is_clock(heading(cell).name) for cell in cells) else ()


def name_above(head: Sequence[tuple[int, str]], shape: Shape, place: int) -> str:
    """Return the name of a column, its number from 1 where no record above the rows has a name for each."""
    for _, raw in head[: -NEAREST - 1 : -1]:
        for cells in _heading_rows(raw, shape):
            if len(own := cells[shape.first :]) == shape.width and not all(map(is_unit, own)) and not are_numbers(own):
                return heading(own[place]).name or str(place + 1)
    return str(place + 1)


def _is_no_name(cell: str) -> bool:
    return bool(cell) and (is_unit(cell) or is_number(cell))


def _are_names(cells: Sequence[str]) -> bool:
    """Return whether cells above units are names: those of times and more, or none of them a number or a unit."""
    unlike = any(map(_is_no_name, cells))
    clocks = (is_clock(heading(cell).name) or cell.lower() in ABSCISSAS for cell in cells if not _is_no_name(cell))
    return not unlike or any(clocks)


def headings_of(
    head: Sequence[tuple[int, str]], shape: Shape, values: Sequence[NDArray[Any]], *, ends: int
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
        return [with_unit(name, cell) for name, cell in zip(names, row, strict=True)], (named, line)
    line, cells = fitting[-1]
    return [heading(cell) for cell in cells], (line,)


def _tagged(head: Sequence[tuple[int, str]], shape: Shape) -> tuple[list[Heading], tuple[int, ...]] | None:
    """Return names and units in lines that say so, as `headings_of` does; a column of times before them has none."""
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
    head: Sequence[tuple[int, str]], shape: Shape, values: Sequence[NDArray[Any]], *, ends: int
) -> list[tuple[int, list[str]]]:
    """Return line and cells of the records that may be headings: above one column, none if some are sentences."""
    made = [(line, cells) for line, raw in head[-NEAREST:] if (cells := heading_cells(raw, shape, values, ends=ends))]
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


def with_unit(name: str | Heading, below: str) -> Heading:
    """Return a heading with the unit that stands below it; with both, where they contradict each other."""
    above, unit = heading(name) if isinstance(name, str) else name, heading(below).unit or below
    own = above.unit or (time_unit(above) if is_clock(above.name) else "")
    if unit and own and contradict(own, unit):
        return Heading(above.name, f"{own}{BESIDE}{unit}")
    return Heading(above.name, unit or own)


def _names_in(raw: str, shape: Shape) -> list[str]:
    """Return the cells of a record that looks like names of columns, with times or units; none of another record."""
    comment = COMMENT_SIGN.match(raw) is not None and not raw.lstrip().startswith(shape.delimiter)
    bare = COMMENT_SIGN.sub("", raw, count=1) if comment else raw
    row = next(csv.reader([bare.strip("\r\n")], delimiter=shape.delimiter), [])
    cells = [cell.strip() for cell in row if cell.strip()]
    like = any(is_clock(heading(cell).name) or heading(cell).unit for cell in cells)
    other = any(map(is_number, cells)) or any(map(is_step, cells))
    return cells if like and not other and len(cells) > 1 and not _is_remark(cells) else []


def is_timed(one: Heading) -> bool:
    return is_clock(one.name) or bool(time_unit(one))


def refuse_dropped(
    head: Sequence[tuple[int, str]],
    lines: Sequence[int],
    shape: Shape,
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
    words = "correct the line in a copy, or ignore names and give the number and unit of the time column"
    clock = next((place for place, cell in enumerate(cells) if is_clock(heading(cell).name)), 0)
    unit = time_unit(heading(cells[clock])) or likely_unit(float(np.median(np.diff(values[0]))), float(values[0][0]))
    options: tuple[str, ...] = ("--time-column", "1", "--time-unit", unit)
    if values[0].dtype.kind in "iu" and not any(is_clock(heading(cell).name) for cell in cells):
        words = "correct the line in a copy, or ignore names and give the rate"
        options = ("--rate", rate_in("".join(above for _, above in head)))
    raise RecordingError(
        f"got {len(cells)} names above rows of {shape.width} numbers",
        remedy=stated.remedy(words, *options),
        allowed="a name for each column",
        line=line,
    )


def _is_of_no_column(cell: str) -> bool:
    """Return whether a cell behind the names is empty, or of a scope's start and increment."""
    return cell in ("", "Start") or is_number(cell) or is_step(cell)


def heading_cells(raw: str, shape: Shape, values: Sequence[NDArray[Any]], *, ends: int) -> list[str]:
    """Return the cells of a heading, one for each column; none where the record has another number of them.

    R leaves out the name of its numbers of rows. Where rows have `ends` more cells, as many more names may be those of
    columns in which nothing stands.
    """
    counts = bool(np.array_equal(values[0], np.arange(len(values[0])) + values[0][0]))
    # An empty first cell stands above numbers of rows; above others its semicolon is a comment sign.
    index = counts and not raw.lstrip().startswith("; ")
    for row in _heading_rows(raw, shape):
        cells = row[shape.first :]
        while len(cells) > shape.width and _is_of_no_column(cells[-1]):
            cells = cells[:-1]
        if shape.width < len(cells) <= shape.width + ends and (index or cells[0]):
            cells = cells[: shape.width]
        if len(cells) == shape.width and not are_numbers([cell for cell in cells if cell] or ["0"]):
            return cells
        if counts and values[0][0] == 1 and len(cells) == shape.width - 1 > 1 and all(cells):
            return ["", *cells]
    return []


def _heading_rows(raw: str, shape: Shape) -> Iterator[list[str]]:
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
