"""Units that stand behind the numbers in rows of text: `0,5 ms;1,2 g`."""

import csv
import re
from collections import Counter

from palpate.experiment.settings.delimited import DELIMITERS

_CELL = re.compile(
    r"(?P<number>[+-]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"(?:[ \u00a0\u202f]?(?P<unit>[A-Za-zµμ°%][\w/²^*-]*))?"
)


def without_units(text: str) -> tuple[str, tuple[str, ...]] | None:
    """Return a text without those units, and that of each column, empty for none; None where they are not the same in
    all rows that have some.
    """  # fmt: skip
    lines = text.splitlines(keepends=True)
    for delimiter in DELIMITERS:
        rows = {at: cells for at, line in enumerate(lines) if delimiter in line and (cells := _row(line, delimiter))}
        units = Counter(tuple(unit for _, unit in cells) for cells in rows.values())
        if len(units) == 1 and any(only := next(iter(units))) and len(rows) > 1:
            quoted = {at: delimiter.join(f'"{number}"' for number, _ in cells) for at, cells in rows.items()}
            made = (f"{quoted[at]}\n" if at in quoted else line for at, line in enumerate(lines))
            return "".join(made), only
    return None


def _row(line: str, delimiter: str) -> list[tuple[str, str]]:
    """Return number and unit of each cell of a row; nothing for another line."""
    cells = [_CELL.fullmatch(cell.strip()) for cell in next(csv.reader([line.strip()], delimiter=delimiter))]
    found = [(cell["number"], cell["unit"] or "") for cell in cells if cell is not None]
    return found if len(found) == len(cells) > 1 else []
