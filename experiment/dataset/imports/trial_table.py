"""A file of trials as a table that has every column its layout names, and times in the unit that its heading says."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from palpate.experiment.dataset.imports.layout import Layout
from palpate.experiment.dataset.imports.objects import (
    UnderstoodFrames,
    UnderstoodJson,
    frames_table,
    is_json,
    is_log,
    json_table,
)
from palpate.experiment.dataset.imports.refusals import listed
from palpate.experiment.dataset.imports.times import Times, times_of
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.settings.delimited import Record, Stated, Table, content, table_of
from palpate.experiment.settings.units import heading, time_unit

BELOW = 2
"""So many rows below the names are looked at for further headings."""


def trial_table(path: Path, layout: Layout, stated: Stated) -> tuple[Table, Times]:
    """Return the table in a CSV or JSON file, and how its times are read.

    Raises `DatasetError` where it has none that fits the layout.
    """
    try:
        table = json_table(path, stated) if is_json(path) else _of_text(path, layout, stated)
    except PalpateError as error:
        raise DatasetError.saying(error) from error
    if not table.header:
        raise DatasetError(path, "got an empty file", "give another file", allowed="a header, and one row per trial")
    _check_header(path, layout, table)
    _check_unit(path, layout)
    times = times_of(path, table, layout.time, "s" if layout.time_s else "ms", stated)
    if layout.time_ms and _is_of_presentation(path):
        times = replace(times, scale=0.1)
    if not isinstance(table.understood, UnderstoodJson | UnderstoodFrames):
        table = replace(table, understood=replace(table.understood, decimal="" if times.mixed else times.decimal_seen))
    return table, times


def _of_text(path: Path, layout: Layout, stated: Stated) -> Table:
    """Return the table in a text, without further rows of headings."""
    data = content(path)
    if is_log(data):
        return frames_table(path, data, stated)
    table = table_of(path, data, layout.needed(), (), stated)
    below = next((place for place, one in enumerate(table.rows[:BELOW], start=1) if _are_codes(one.cells)), 0)
    again = {one.line for one in table.rows[below:] if _is_header(path, one, table, layout)}
    rows = tuple(one for one in table.rows[below:] if one.line not in again)
    lines = (*table.understood.heading_lines, *(one.line for one in table.rows[:below]), *sorted(again))
    first = rows[0].line if rows else 0
    understood = replace(table.understood, heading_lines=lines, first_line=first, rows=len(rows))
    return replace(table, rows=rows, understood=understood)


def _is_of_presentation(path: Path) -> bool:
    """Return whether a file is a log of Presentation, whose times are tenths of a millisecond."""
    with path.open("rb") as file:
        return b"Scenario - " in file.read(64).replace(b"\0", b"")


def _are_codes(cells: Sequence[str]) -> bool:
    """Return whether cells are what Qualtrics writes below names and questions: objects with an `ImportId`."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and all(cell.startswith('{"ImportId"') for cell in filled)


def _is_header(path: Path, row: Record, table: Table, layout: Layout) -> bool:
    """Return whether a row is the header once more, as in files that were joined. Raises `DatasetError` for another."""
    if layout.presented not in row.cells or not set(layout.needed()) <= set(row.cells):
        return False
    if tuple(cell.strip() for cell in row.cells) == table.header:
        return True
    raise DatasetError(
        path,
        "got a second header, with its columns in a different order",
        "move the rows from there on to a separate file",
        allowed="one header, or the same header repeated",
        line=row.line,
    )


def _check_header(path: Path, layout: Layout, table: Table) -> None:
    header = table.header
    for column in layout.columns():
        times = header.count(column)
        if times > 1 or (not times and column in layout.needed()):
            got = "no such column" if not times else f"{times} such columns"
            if times:
                remedy = "rename the other columns in a copy"
            elif any(re.fullmatch(rf"{re.escape(column)}[_. ]?[0-9]+", name) for name in header):
                remedy = "write one row per trial, for example with R's pivot_longer"
            else:
                remedy = "use the name in the header"
            there = listed(dict.fromkeys(name for name in header if name))
            raise DatasetError(
                path,
                f"got {got}",
                remedy,
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
        f"got times in {says}, according to the heading",
        f"give the column with {option}" if option else "export them in seconds",
        allowed=unit,
        field=f"column {layout.time}",
    )
