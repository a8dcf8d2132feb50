"""Trials whose number occurs again in a participant's task: sessions that a column tells apart, or a run begun anew."""

import re
from collections.abc import Sequence

from palpate.experiment.dataset.imports.layout import ABSENT

SESSION = re.compile(r"session|visit|date|(?<![a-z])(ses|day|run|expstart)(?![a-z])")
"""How the columns are called, in small letters, that name a session or when it was."""


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
