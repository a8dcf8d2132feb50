"""Numbers in text columns, separated by tabs, semicolons, commas or blanks, with decimal points or decimal commas.

The first line that reads as two numbers or more decides how all later lines are read. Lines before it are headings;
blank lines and comments (#, %, ;, //) may stand anywhere.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from experiment.errors import RecordingError

_SEPARATORS = ("\t", ";", ",", None)
_DIALECTS = tuple(
    (separator, decimal) for separator in _SEPARATORS for decimal in (".", ",") if (separator, decimal) != (",", ",")
)
_COMMENT = re.compile(r"\s*(#|%|;|//)")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
_UNIT = re.compile(r"(?P<name>.*?)\s*[\(\[](?P<unit>[^()\[\]]*)[\)\]]\s*")


@dataclass(frozen=True)
class Column:
    """One channel of a file, or its time.

    Attributes:
        name: as the heading gives it, without the unit; empty where there is no heading.
        unit: as the heading gives it; empty where it gives none.
        values: shape (n,).
        lines: line of the file on which each value stands, from 1, shape (n,).
    """

    name: str
    unit: str
    values: NDArray[np.float64]
    lines: NDArray[np.int64]


def number(text: str, *, decimal: str = ".") -> float | None:
    """The number that `text` spells, or None. Words such as `nan` and `inf` are no numbers.

    Args:
        text: one cell.
        decimal: the decimal separator, a point or a comma.
    """
    text = text.strip()
    if decimal != ".":
        if "." in text:
            return None
        text = text.replace(decimal, ".")
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text.lower().replace("d", "e"))
    return value if isfinite(value) else None


def name_and_unit(heading: str) -> tuple[str, str]:
    """`("time", "s")` for `# time (s)`; the unit is empty where the heading gives none."""
    text = _COMMENT.sub("", heading).strip().strip('"')
    match = _UNIT.fullmatch(text)
    return (match["name"].strip(), match["unit"].strip()) if match else (text, "")


def parse_columns(text: str, *, file: str) -> list[Column]:
    """Read every column of a text file.

    Args:
        text: of the file.
        file: how an error names it.

    Returns:
        Two columns or more, all of one length.

    Raises:
        RecordingError: no line of numbers, or a later line with another number of cells or a cell that is no number.
    """
    headings: list[str] = []
    dialect: tuple[str | None, str] | None = None
    rows: list[list[float]] = []
    lines: list[int] = []
    for place, line in enumerate(text.splitlines(), start=1):
        comment = bool(_COMMENT.match(line))
        if not line.strip() or (dialect and comment):
            continue
        if dialect is None:
            dialect = None if comment else _dialect(line)
            if dialect is None:
                headings.append(line)
                continue
        cells = _split(line, dialect[0])
        values = [number(cell, decimal=dialect[1]) for cell in cells]
        wrong = next((cell for cell, value in zip(cells, values, strict=True) if value is None), None)
        if wrong is not None:
            raise RecordingError(
                f"{file}: line {place}: got {wrong.strip()[:40]!r}; allowed: a number in each of "
                f"{len(rows[0]) if rows else len(cells)} columns; correct or remove the line"
            )
        if rows and len(values) != len(rows[0]):
            raise RecordingError(
                f"{file}: line {place}: got {len(values)} numbers; allowed: {len(rows[0])}, as in line {lines[0]}; "
                "correct or remove the line"
            )
        rows.append([value for value in values if value is not None])
        lines.append(place)
    if not rows:
        raise RecordingError(
            f"{file}: got no line of two or more numbers; allowed: WAV, LabVIEW .lvm, or text columns with a time "
            "column; name another file"
        )
    table = np.array(rows)
    named = _named(headings, len(rows[0]))
    where = np.array(lines)
    return [Column(*named[i], values=table[:, i], lines=where) for i in range(table.shape[1])]


def _split(line: str, separator: str | None) -> list[str]:
    cells = line.strip().split(separator)
    # A separator that ends every line makes no further column.
    return cells[:-1] if len(cells) > 1 and not cells[-1].strip() else cells


def _dialect(line: str) -> tuple[str | None, str] | None:
    for separator, decimal in _DIALECTS:
        cells = _split(line, separator)
        if len(cells) >= 2 and all(number(cell, decimal=decimal) is not None for cell in cells):
            return separator, decimal
    return None


def _named(headings: list[str], columns: int) -> list[tuple[str, str]]:
    """Names from the last heading line that has as many cells as there are columns."""
    for line in reversed(headings):
        bare = _COMMENT.sub("", line)
        for pattern in (r"\t", ";", ",", r"\s{2,}", r"\s+"):
            cells = [cell for cell in re.split(pattern, bare.strip()) if cell.strip(" \t,;")]
            if len(cells) == columns:
                return [name_and_unit(cell.strip(" \t,;")) for cell in cells]
    return [("", "")] * columns
