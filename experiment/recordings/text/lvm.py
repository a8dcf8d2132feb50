"""LabVIEW measurement files (.lvm), which name their own separators and are parted by them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.series.clocks import AGREES, by_one, rises_evenly
from palpate.experiment.recordings.series.column import Column, Table
from palpate.experiment.settings.delimited import number
from palpate.experiment.settings.units import SECONDS, heading, is_clock, time_unit

_TAG = re.compile(r"(?!nan$|inf$|infinity$)[A-Za-z]\w*", re.IGNORECASE)

NO_STEP = 1.0
"""LabVIEW writes this between samples, s, where it knows no step."""

_Rows = list[tuple[int, list[str]]]
"""Each row's line, from 1, and its cells."""


@dataclass
class _Segment:
    """What was read of a segment so far: tags of its header, channels' headings, and rows."""

    tags: dict[str, list[str]] = field(default_factory=dict)
    headings: list[str] = field(default_factory=list)
    rows: _Rows = field(default_factory=list)


def read_lvm(lines: list[str], section: str | None = None) -> Table:
    """Return the channels of a segment of a file, by its lines: of the first, or of the one of this number, from 1.

    Raises `RecordingError`.
    """
    separator, decimal, header = _header(lines)
    segments = _segments(lines, header, separator, decimal)
    found = [channels for one in segments if (channels := _channels(one, decimal))[0]]
    if not found:
        raise RecordingError(
            "got a LabVIEW header without samples",
            remedy="export the measurement again",
            allowed="rows below a line that begins with X_Value",
        )
    numbers = [str(place) for place in range(1, len(found) + 1)]
    if section is not None and section not in numbers:
        raise RecordingError(f"got section {section!r}", remedy="choose one", allowed=f"1 to {len(found)}")
    signals, times = found[numbers.index(section or "1")]
    split = [heading(signal.name) for signal in signals]
    at = next((place for place, (name, _) in enumerate(split) if is_clock(name)), None)
    nameless = at is None and times[0] is None and rises_evenly(signals[0]) and not by_one(signals[0].values)
    if unit := _unit_of_steps(signals[0], signals) if nameless else "":
        at = 0
    if at is not None and len(signals) > 1:
        # The unit of a channel stands in its tag, but that of a time often in its name alone.
        own = replace(signals.pop(at), name=split[at].name, unit=time_unit(split[at]) or unit or "s")
        times = [own] * len(signals)
    return Table(signals, times, len(found))


def _unit_of_steps(clock: Column, signals: Sequence[Column]) -> str:
    """Return the first unit in which times have the steps that channels state, s where none does; empty for none."""
    step = float(np.diff(clock.values).mean())
    steps_s = [one.step for one in signals if one.step > 0 and one.step != NO_STEP]
    return next((unit for unit, s in SECONDS.items() if all(abs(step * s / one - 1) < AGREES for one in steps_s)), "")


def _header(lines: list[str]) -> tuple[str, str, int]:
    """Return the cells' separator, the decimal separator, and how many lines the file's header takes."""
    tags: dict[str, str] = {}
    for place, line in enumerate(lines, start=1):
        tag, _, value = re.split(r"([\t,]|$)", line, maxsplit=1)
        if tag.strip() == "***End_of_Header***":
            named = tags.get("Separator", "Tab")
            separator = {"tab": "\t", "comma": ","}.get(named.lower())
            decimal = tags.get("Decimal_Separator") or "."
            if separator is None or decimal not in (".", ",") or separator == decimal:
                raise RecordingError(
                    f"got Separator {named!r} with Decimal_Separator {decimal!r}",
                    remedy="export the measurement again",
                    allowed="Tab with '.' or ',', or Comma with '.'",
                )
            return separator, decimal, place
        # `Decimal_Separator<Tab>,` holds the other separator as its value; `Separator,Comma` may be followed by commas.
        tags[tag.strip()] = value.strip() if value.strip() == "," else value.strip("\t, ")
    raise RecordingError(
        "got a LabVIEW header without its last line", remedy="export it again", allowed="a line ***End_of_Header***"
    )


def _segments(lines: list[str], header: int, separator: str, decimal: str) -> list[_Segment]:
    segments: list[_Segment] = []
    current, in_rows, special, header_at = _Segment(), False, False, 0
    for place, line in enumerate(lines[header:], start=header + 1):
        cells = [cell.strip() for cell in line.split(separator)]
        if special or cells[0] == "***Start_Special***":
            special = cells[0] != "***End_Special***"
        elif not any(cells) or cells[0] == "***End_of_Header***":
            continue
        elif cells[0] == "X_Value":
            current.headings, in_rows = cells, True
            segments.append(current)
        elif in_rows and not _TAG.fullmatch(cells[0]):
            current.rows.append((place, cells))
        else:
            if in_rows:
                current, in_rows, header_at = _Segment(), False, place
            if isfinite(number(cells[0], decimal)):
                raise RecordingError(
                    "got numbers in a header",
                    remedy="correct the file",
                    allowed="numbers below a line that begins with "
                    f"X_Value{f'; line {header_at} began this header' if header_at else ''}",
                    line=place,
                )
            current.tags[cells[0]] = cells
    if not in_rows and header_at:
        raise RecordingError(
            "got a segment header without rows",
            remedy="remove the lines from here on",
            allowed="a line that begins with X_Value and rows below it",
            line=header_at,
        )
    return segments


def _channels(segment: _Segment, decimal: str) -> tuple[list[Column], list[Column | None]]:
    """Return the channels that hold samples, and the column of times to the left of each, None where it is empty."""
    headings = list(segment.headings)
    while headings and headings[-1] in ("", "Comment"):
        headings.pop()
    signals: list[Column] = []
    times: list[Column | None] = []
    clock: Column | None = None
    for place, name in enumerate(headings):
        values, lines = _values(segment.rows, place, name, decimal)
        if name == "X_Value":
            # The format has no other unit for times.
            clock = Column(name, "s", values, lines) if lines else None
        elif lines:
            # A tag stands above the column that it describes.
            unit, step, dimension = (
                cells[place] if place < len(cells := segment.tags.get(tag, [])) else ""
                for tag in ("Y_Unit_Label", "Delta_X", "X_Dimension")
            )
            signals.append(Column(name, unit, values, lines, number(step, decimal), dimension=dimension or "Time"))
            times.append(clock)
    return signals, times


def _values(rows: _Rows, place: int, name: str, decimal: str) -> tuple[NDArray[np.float64], list[int]]:
    """Return the filled cells of a column, shape (n,), and their lines; cells may be empty at its end only."""
    values: list[float] = []
    empty_at = 0
    for line, row in rows:
        cell = row[place].strip() if place < len(row) else ""
        if not cell:
            empty_at = empty_at or line
            continue
        values.append(number(cell, decimal))
        if np.isnan(values[-1]) or empty_at:
            wrong = f"{cell[:40]!r} in column {name!r}"
            got = wrong if np.isnan(values[-1]) else f"column {name!r} empty in line {empty_at}"
            raise RecordingError(
                f"got {got}",
                remedy="correct the line, or export the measurement again",
                allowed="a number in every row, and empty cells only at the end of a column",
                line=line,
            )
    return np.array(values), [line for line, _ in rows[: len(values)]]
