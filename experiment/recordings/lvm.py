"""LabVIEW measurement files (.lvm): a file header, then segments, each with a header of its own and rows of cells.

Facts from the manufacturer's specification and from files in the wild: tags stand in the first cell of a line, in any
order, unknown tags are to be passed over, `***End_of_Header***` ends a header, `***Start_Special***` to
`***End_Special***` is a block of another kind. Every segment names its channels in a line that begins with `X_Value`
and may end with `Comment`. `X_Columns` is `One` (one column of times), `Multi` (one before each channel) or `No` (the
cell is there and empty). Version 1 files have no `Decimal_Separator`. A channel with fewer samples has empty cells.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from experiment.errors import RecordingError
from experiment.recordings.columns import Column, number

MAGIC = "LabVIEW Measurement"
_SEPARATORS = {"tab": "\t", "comma": ","}
_TAG = re.compile(r"(?!nan$|inf$|infinity$)[A-Za-z]\w*", re.IGNORECASE)


@dataclass(frozen=True)
class Channel:
    """One channel of a segment.

    Attributes:
        samples: its values.
        times: the X column of the channel, in the X column's unit; None where the file has none.
        step: `Delta_X` of the segment's header; None where it gives none. It may lie.
        dimension: `X_Dimension` of the header, `Time` unless it says otherwise.
    """

    samples: Column
    times: Column | None
    step: float | None
    dimension: str


@dataclass
class _Segment:
    """What was read of a segment so far; cells per row, as they stand."""

    tags: dict[str, list[str]] = field(default_factory=dict)
    headings: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def parse_lvm(text: str, *, file: str) -> list[list[Channel]]:
    """Read every segment of a LabVIEW measurement file.

    Args:
        text: of the file.
        file: how an error names it.

    Returns:
        Channels of each segment that holds any samples; at least one segment with one channel.

    Raises:
        RecordingError: no end of the header, an unknown separator, a cell that is no number, or no samples.
    """
    separator, decimal, body = _file_header(text.splitlines(), file)
    segments: list[_Segment] = []
    current, in_rows, special, header_at = _Segment(), False, False, 0
    for place, line in body:
        cells = [cell.strip() for cell in line.split(separator)]
        if special or cells[0] == "***Start_Special***":
            special = cells[0] != "***End_Special***"
        elif not any(cells) or cells[0] == "***End_of_Header***":
            continue
        elif cells[0] == "X_Value":
            current.headings, in_rows = cells, True
            segments.append(current)
        elif in_rows and not _TAG.fullmatch(cells[0]):
            current.rows.append(cells)
            current.lines.append(place)
        else:
            if in_rows:
                current, in_rows, header_at = _Segment(), False, place
            if number(cells[0], decimal=decimal) is not None:
                raise RecordingError(
                    f"{file}: line {place}: got numbers in a header; allowed: numbers below a line that begins with "
                    f"X_Value{f'; line {header_at} began this header' if header_at else ''}; correct the file"
                )
            current.tags[cells[0]] = cells[1:]
    if not in_rows and header_at:
        raise RecordingError(
            f"{file}: line {header_at}: got a segment's header without rows; allowed: a line that begins with X_Value "
            "and rows below it; remove the lines from there on"
        )
    channels = [_channels(segment, decimal=decimal, file=file) for segment in segments]
    with_samples = [found for found in channels if found]
    if not with_samples:
        raise RecordingError(
            f"{file}: got a LabVIEW header without samples; allowed: rows below a line that begins with X_Value; "
            "export the measurement again"
        )
    return with_samples


def _file_header(lines: list[str], file: str) -> tuple[str, str, list[tuple[int, str]]]:
    """Separator, decimal separator, and the numbered lines below the file's header."""
    tags: dict[str, str] = {}
    for place, line in enumerate(lines, start=1):
        tag, _, value = (part.strip() for part in _first_cell(line))
        if tag == "***End_of_Header***":
            named = tags.get("Separator", "Tab")
            separator = _SEPARATORS.get(named.lower())
            decimal = tags.get("Decimal_Separator") or "."
            if separator is None or decimal not in (".", ",") or separator == decimal:
                raise RecordingError(
                    f"{file}: got Separator {named!r} with Decimal_Separator {decimal!r}; allowed: Tab or Comma, with "
                    "'.' or, after Tab, ','; export the measurement again"
                )
            return separator, decimal, list(enumerate(lines, start=1))[place:]
        tags[tag] = value
    raise RecordingError(
        f"{file}: got a LabVIEW header without its end; allowed: a line ***End_of_Header***; export it again"
    )


def _first_cell(line: str) -> tuple[str, str, str]:
    """First cell, separator and rest, before the separator is known."""
    match = re.match(r"([^\t,]*)([\t,]?)(.*)", line)
    tag, found, rest = match.groups() if match else (line, "", "")
    # `Decimal_Separator<Tab>,` holds the other separator as its value; `Separator,Comma` may be followed by commas.
    return tag, found, rest if rest.strip() == "," else rest.rstrip("\t, ")


def _channels(segment: _Segment, *, decimal: str, file: str) -> list[Channel]:
    headings = list(segment.headings)
    while headings and headings[-1] in ("", "Comment"):
        headings.pop()
    multi = headings.count("X_Value") > 1
    found = []
    for place, name in enumerate(headings):
        if name == "X_Value":
            continue
        at_times = place - 1 if multi else 0
        samples = _column(
            segment, place, name=name, unit=_tag(segment, "Y_Unit_Label", place), decimal=decimal, file=file
        )
        if not samples.values.size:
            continue
        times = _column(segment, at_times, name="X_Value", unit="", decimal=decimal, file=file)
        step = number(_tag(segment, "Delta_X", place), decimal=decimal)
        dimension = _tag(segment, "X_Dimension", place) or "Time"
        found.append(Channel(samples, times if times.values.size else None, step, dimension))
    return found


def _tag(segment: _Segment, tag: str, place: int) -> str:
    """What a tag says of the channel in column `place`: tags stand above their column."""
    values = segment.tags.get(tag, [])
    return values[place - 1] if 0 < place <= len(values) else ""


def _column(segment: _Segment, place: int, *, name: str, unit: str, decimal: str, file: str) -> Column:
    """The filled cells of a column; cells may be empty at its end only."""
    values: list[float] = []
    empty_at: int | None = None
    for row, line in zip(segment.rows, segment.lines, strict=True):
        cell = row[place] if place < len(row) else ""
        if not cell:
            empty_at = empty_at or line
            continue
        value = number(cell, decimal=decimal)
        if value is None or empty_at is not None:
            got = f"{cell[:40]!r} in column {name!r}" if value is None else f"column {name!r} empty in line {empty_at}"
            raise RecordingError(
                f"{file}: line {line}: got {got}; allowed: a number in every row, empty cells at the end only; "
                "export the measurement again"
            )
        values.append(value)
    return Column(
        name, unit, np.array(values, dtype=np.float64), np.array(segment.lines[: len(values)], dtype=np.int64)
    )
