"""The decimal sign of columns, and points in place of decimal commas where commas part the cells as well."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.headings import NEAREST, heading_cells
from palpate.experiment.recordings.text.shape import Shape, cells_of, rows_of
from palpate.experiment.settings.delimited import (
    SAMPLE,
    Record,
    Stated,
    decimal_sign,
    unclear_decimal,
)
from palpate.experiment.settings.units import (
    heading,
    is_clock,
)

_WHOLE = re.compile(r" *[+-]?[0-9]+ *")

_ZEROS = re.compile(r"0[0-9]")

_NOT_CLEAR = "export it with semicolons between cells, or, if all are whole, add the option"


def decimal_points(
    text: str, head: Sequence[tuple[int, str]], begins: Record, shape: Shape, stated: Stated
) -> str | None:
    """Return a text with points for its decimal commas, where commas part its cells as well; None for any other text.

    Two whole numbers are one with a decimal comma where headings with a time have half as many cells, or where it is
    stated that commas are decimal. Raises `RecordingError` where that is not clear.
    """
    rows = [cells_of(one, shape) for one in islice(rows_of(text, begins, shape), SAMPLE)]
    if stated.decimal == "." or not all(map(_are_whole, rows)):
        return None
    timed, named = _named(head, shape, np.array([float(row[0]) for row in rows]))
    if named == shape.width:
        return None
    half, paired = named * 2 == shape.width, _paired(text, begins, shape)
    if paired and (stated.decimal or (half and timed)):
        return text[: begins.start] + re.sub(r"([0-9]+),([0-9]+)", r"\1.\2", text[begins.start :])
    untimed = not named and stated.rate_hz is not None
    decimals = paired and _like_decimals([row[1::2] for row in rows], untimed=untimed)
    if not (stated.decimal or timed or half or decimals):
        return None
    words, sign = ("if they are decimals, add the option", ",") if paired else (_NOT_CLEAR, ".")
    raise RecordingError(
        f"got {shape.width} whole numbers{f' below {named} names' if named else ''}, perhaps decimals split at commas",
        remedy=stated.remedy(words, "--decimal", sign),
        allowed="decimal points, a cell separator other than the comma, or --decimal . if all are whole",
        line=begins.line,
    )


def _are_whole(cells: Sequence[str]) -> bool:
    return bool(cells) and all(map(_WHOLE.fullmatch, cells))


def _like_decimals(behind: Sequence[Sequence[str]], *, untimed: bool) -> bool:
    """Return whether each second cell looks like decimals: some begin with 0, or, without times, all are as long."""
    zeros = any(map(_ZEROS.match, chain.from_iterable(behind)))
    return zeros or (untimed and len({tuple(map(len, cells)) for cells in behind}) == 1)


def _named(head: Sequence[tuple[int, str]], shape: Shape, first: NDArray[np.float64]) -> tuple[bool, int]:
    """Return whether the headings of most columns, half as many as cells or more, have a time, and how many they are.

    `first` are values of the first column.
    """
    for width in range(shape.width, (shape.width + 1) // 2 - 1, -1):
        for _, raw in head[-NEAREST:]:
            if cells := heading_cells(raw, replace(shape, width=width), [first], ends=0):
                return any(is_clock(heading(cell).name) for cell in cells), width
    return False, 0


def _paired(text: str, begins: Record, shape: Shape) -> bool:
    """Return whether each second cell may be the decimals of the one before."""
    every = (cells_of(one, shape) for one in rows_of(text, begins, shape))
    fits = (len(row) == shape.width and all(cell.isdecimal() for cell in row[1::2]) for row in every)
    return shape.width % 2 == 0 and all(fits)


def decimal_of(text: str, begins: Record, shape: Shape, most: int | None, stated: Stated) -> str:
    def cells() -> Iterator[str]:
        return chain.from_iterable(cells_of(one, shape) for one in islice(rows_of(text, begins, shape), most))

    decimal = decimal_sign(cells(), shape.delimiter)
    if decimal is None and most is not None:
        return decimal_of(text, begins, shape, None, stated)
    if decimal is None:
        raise unclear_decimal("", stated, decimal_sign(cells(), shape.delimiter, printed=True))
    return decimal
