"""What a cell of a recording is: a number, or a word for a sample that is missing or beyond the range."""

import re
from collections.abc import Sequence
from math import isfinite

from palpate.experiment.settings.delimited import number

BEYOND = frozenset(
    ("inf", "+inf", "-inf", "infinity", "-infinity", "∞", "+∞", "-∞", "ovf", "overflow", "overload", "overrange")
)
"""Cells, in small letters, that stand for a sample beyond the range."""

MISSING = BEYOND | {"nan", "na", "n/a", "#n/a", "null", "none", "#num!", "#div/0!"}
"""Cells, in small letters, that stand for a sample that is missing or beyond the range."""


STATISTIC = re.compile(
    r"(arithm\w* )?(mean|average|avg|median|mode|sd|std|st\.? ?dev|stdev|stddev|variance|min|max|minimum|maximum|range|"
    r"rms|sum|total|count|mittelwert|mittel|durchschnitt|standardabweichung|stabw|stdabw|varianz|spannweite|summe|anzahl|"
    r"moyenne|écart-type|media)[ .:=]*"
)
"""What a row below the samples is called, in small letters, that says something of all of them."""

_HEXADECIMAL = re.compile(r"[0-9]*[A-Fa-f][0-9A-Fa-f]*")


def remedy_of(cell: str, otherwise: str) -> str:
    """Return what to do about a cell that is no number."""
    hexadecimal = _HEXADECIMAL.fullmatch(cell.strip()) and re.search("[0-9]", cell)
    return (
        "if these numbers are hexadecimal, export decimal numbers, or put 0x before each" if hexadecimal else otherwise
    )


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with a decimal point or a decimal comma."""
    return any(isfinite(number(cell, decimal)) for decimal in ".,")


def is_missing(cell: str) -> bool:
    """Return whether a cell says that its sample is missing."""
    return cell.strip().lower() in MISSING


def are_numbers(cells: Sequence[str]) -> bool:
    """Return whether cells are numbers, but for some that say that they are missing."""
    return any(map(is_number, cells)) and all(is_number(cell) or is_missing(cell) for cell in cells)
