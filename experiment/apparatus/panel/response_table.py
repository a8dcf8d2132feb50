"""The response table of a rig as a CSV file: the panel's acceleration for each drive level at each frequency.

```
# any number of comments
frequency_hz,drive_vrms,acceleration_pp_m_s2
10,0.1,0.0963
10,0.25,0.2405
12,0.1,0.138
12,0.25,0.345
```

One row is one measurement, as Okamoto et al. took theirs (section 4, Figure 9): a sinusoid of `drive_vrms` volts root
mean square at `frequency_hz` moves the loaded panel by `acceleration_pp_m_s2`, peak to peak. Frequencies rise, and each
has the same drive levels, rising. Reading turns both columns into amplitudes of sinusoids, here and nowhere else:
sqrt 2 times the rms, half the peak to peak.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from itertools import groupby
from math import isfinite, sqrt
from pathlib import Path

import numpy as np

from palpate.experiment.errors import PalpateError, RecordingError
from palpate.experiment.settings.characters import plain
from palpate.experiment.synthesis.shaping import Response, not_rising

READER = "palpate.experiment.settings.delimited"
"""Imported by name, since only a rig that names a table needs it."""

COLUMNS = ("frequency_hz", "drive_vrms", "acceleration_pp_m_s2")


@dataclass(frozen=True)
class _Row:
    line: int
    frequency_hz: float
    drive_vrms: float
    acceleration_pp_m_s2: float


@lru_cache(maxsize=2)
def parse(path: Path, content: bytes) -> Response:
    """Return the response in a table's content, which a process reads once.

    Raises `RecordingError` with file, line, value and what is allowed.
    """
    rows = _rows(path, content)
    at = [list(same) for _, same in groupby(rows, key=lambda row: row.frequency_hz)]
    if len(at) < 2:
        raise RecordingError(
            path, f"got {len(at)} frequencies", "measure the response", allowed="two or more, to interpolate between"
        )
    levels = [row.drive_vrms for row in at[0]]
    for same in at[1:]:
        if [row.drive_vrms for row in same] != levels:
            raise RecordingError(
                path,
                f"got drive levels {[row.drive_vrms for row in same]} at {same[0].frequency_hz:g} Hz",
                "measure what is missing",
                allowed=f"{levels}, as at {at[0][0].frequency_hz:g} Hz",
                line=same[0].line,
            )
    accelerations = np.array([[row.acceleration_pp_m_s2 for row in same] for same in at]) / 2
    place = not_rising(accelerations)
    if place is not None:
        i, j = place
        row, before = at[i][j], at[i][j - 1].acceleration_pp_m_s2 if j else 0.0
        raise RecordingError(
            path,
            f"acceleration_pp_m_s2: got {row.acceleration_pp_m_s2:g} at {row.drive_vrms:g} Vrms after {before:g} at "
            "the level below",
            "measure that frequency again",
            allowed="more, because a response that does not rise with the drive has no inverse",
            line=row.line,
        )
    return Response(
        frequencies_hz=np.array([same[0].frequency_hz for same in at]),
        levels_v=np.array(levels) * sqrt(2),
        accelerations_m_s2=accelerations,
    )


def comments(content: bytes) -> tuple[str, ...]:
    """Return what a table says of itself, such as when it was measured and under which load, a line each."""
    sign = import_module(READER).COMMENT_SIGN
    return tuple(plain(sign.sub("", line).strip()) for line in _text(content).splitlines() if sign.match(line))


def is_simulated(content: bytes) -> bool:
    """Return whether a table says of itself that it is SIMULATED."""
    # What stands above the header needs no comment sign to be passed over.
    return "SIMULATED" in _text(content)


def _text(content: bytes) -> str:
    try:
        return str(import_module(READER).decoded(content, "")[0])
    except PalpateError:
        return content.decode(errors="replace")


def _rows(path: Path, content: bytes) -> list[_Row]:
    """Return every row, each later than the one before in frequency or, at one frequency, in level."""
    try:
        table = import_module(READER).table_of(path, content, COLUMNS, COLUMNS)
    except PalpateError as error:
        finding = replace(
            error.finding, where=path, allowed="a CSV table", remedy="save it as UTF-8 with decimal points"
        )
        raise RecordingError.at(finding) from error
    if table.rows and table.header != COLUMNS:
        got, allowed = ",".join(table.header)[:60], f"the header {','.join(COLUMNS)}"
        raise _wrong(path, table.understood.heading_lines[0], repr(got), allowed, "add it")
    rows: list[_Row] = []
    lines: dict[tuple[float, float], int] = {}
    for record in table.rows:
        line, cells = record.line, [cell.strip() for cell in record.cells]
        if cells[0].startswith("#"):
            continue
        row = _row(path, line, cells, table.number)
        pair = row.frequency_hz, row.drive_vrms
        where = f"{row.frequency_hz:g} Hz at {row.drive_vrms:g} Vrms"
        if pair in lines:
            raise _wrong(path, line, f"{where}, as in line {lines[pair]}", "one row for each", "remove one of them")
        if rows and pair < (rows[-1].frequency_hz, rows[-1].drive_vrms):
            allowed = "rising frequencies, with rising drive levels at each"
            raise _wrong(path, line, f"{where} after line {rows[-1].line}", allowed, "sort the table")
        lines[pair] = line
        rows.append(row)
    if not rows:
        raise RecordingError(path, "got no rows", "measure the response", allowed=f"{', '.join(COLUMNS)} in each")
    return rows


def _row(path: Path, line: int, cells: list[str], number: Callable[[str], float]) -> _Row:
    if len(cells) != len(COLUMNS):
        raise _wrong(path, line, f"{len(cells)} cells", f"{len(COLUMNS)}: {', '.join(COLUMNS)}", "correct the line")
    values = []
    for name, cell in zip(COLUMNS, cells, strict=True):
        value = number(cell)
        if not isfinite(value) or value < 0 or (name == "drive_vrms" and value == 0):
            least = "above 0" if name == "drive_vrms" else "of 0 or more"
            raise _wrong(path, line, f"{name} {cell[:40]!r}", f"a finite number {least}", "correct or measure it")
        values.append(value)
    return _Row(line, *values)


def _wrong(path: Path, line: int, got: str, allowed: str, remedy: str) -> RecordingError:
    return RecordingError(path, f"got {got}", remedy, allowed=allowed, line=line)
