"""Trials that occur again: sessions that a column tells apart, a run begun anew, or rows that were exported twice."""

import re
from collections.abc import Sequence

from palpate.experiment.dataset.imports.layout import ABSENT
from palpate.experiment.settings.delimited import Record

SESSION = re.compile(r"session|visit|date|(?<![a-z])(ses|day|run|expstart)(?![a-z])")
"""How the columns are called, in small letters, that name a session or when it was."""

TRIAL = re.compile(r"(.*[^a-z])?trials?[ _.-]*(n|nr|no|num|number|index|count)?\.?")
"""How the columns are called, in small letters, that number trials."""

FEWEST = 5
"""So many rows in turn that are those of an earlier place, cell by cell, were exported twice. Ours."""


class Runs:
    """The cells that may tell sessions apart, gathered a row at a time."""

    def __init__(self) -> None:
        """Begin with no row."""
        self._cells: list[dict[str, str]] = []

    def add(self, header: Sequence[str], cells: Sequence[str]) -> None:
        """Take the next trial."""
        pairs = zip(header, cells, strict=False)
        self._cells.append({column: cell.strip() for column, cell in pairs if SESSION.search(column.lower())})

    def apart(self, trials: Sequence[tuple[str, str, int]]) -> str:
        """Return the column that parts trials of one participant, task and number, or nothing.

        A column of each row's own time does so too, and is none of sessions.
        """
        columns = dict.fromkeys(column for cells in self._cells for column in cells)
        for column in sorted(columns, key=lambda one: "session" not in one.lower()):
            named = [cells.get(column, "") for cells in self._cells]
            parted = {(*trial, cell) for trial, cell in zip(trials, named, strict=True)}
            sessions = {(who, cell) for (who, _, _), cell in zip(trials, named, strict=True)}
            if len(parted) == len(trials) >= 2 * len(sessions) and not set(named).intersection(ABSENT):
                return column
        return ""


def rows_again(rows: Sequence[Record]) -> list[Record]:
    """Return the rows that stand above, too, cell by cell and in the same order, `FEWEST` in turn at least."""
    found: list[Record] = []
    run: list[Record] = []
    places: dict[tuple[str, ...], int] = {}
    lag = 0
    for place, row in enumerate(rows):
        cells = tuple(row.cells)
        back = place - places.get(cells, place)
        if back != lag:
            found += run if len(run) >= FEWEST else []
            run, lag = [], back
        # Closer ones are like each other: five pauses, or answers of which nothing else is known.
        run += [row] if back >= FEWEST else []
        places[cells] = place
    return found + (run if len(run) >= FEWEST else [])


def numbered_again(header: Sequence[str], trials: Sequence[tuple[str, ...]], rows: Sequence[Record]) -> str:
    """Return the column that numbers trials, of which some of a participant and task have one number, and that no other
    column parts by as many blocks; or nothing.
    """  # fmt: skip
    if not any(TRIAL.fullmatch(name.lower()) for name in header):
        return ""
    columns = list(zip(*(row.cells for row in rows), strict=False))
    named = list(zip(header, columns, strict=False))
    for column, numbers in named:
        if not TRIAL.fullmatch(column.lower()) or not all(one.strip().isdecimal() for one in numbers):
            continue
        keys = list(zip(trials, numbers, strict=True))
        if len(set(keys)) == len(keys):
            continue
        parting = (
            len({*zip(keys, other, strict=True)}) == len(keys) >= 2 * len({*zip(trials, other, strict=True)})
            for _, other in named
        )
        if not any(parting):
            return column
    return ""
