"""Response times as cells hold them: a number, a list of one as PsychoPy writes it, or a number with its unit."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, isnan, nan
from pathlib import Path

from palpate.experiment.errors import DatasetError
from palpate.experiment.settings import delimited
from palpate.experiment.settings.delimited import Stated, Table
from palpate.experiment.settings.units import Heading, time_unit

_LISTED = re.compile(r"\[\s*(?:'([^']*)'|\"([^\"]*)\"|([^\[\],'\"]*))\s*\]")
_SEVERAL = re.compile(r"\[[^\[\]]*[^\[\]\s,][^\[\],]*,[^\[\]]*\]")
_WITH_UNIT = re.compile(r"(.*[0-9.,])\s*([^\W\d_]+\.?)")


def bare(cell: str) -> str:
    """Return what a list, or a JSON object, of one element holds; any other cell as it is."""
    if (listed := _LISTED.fullmatch(cell)) is not None:
        return next((part for part in listed.groups() if part is not None), "").strip()
    if cell.startswith("{"):
        try:
            held = json.loads(cell)
        except (ValueError, RecursionError):
            return cell
        values = list(held.values()) if isinstance(held, dict) else []
        return values[0].strip() if len(values) == 1 and isinstance(values[0], str) else cell
    return cell


def is_several(cell: str) -> bool:
    """Return whether a cell is a list of several elements, such as the keys that were pressed in one trial."""
    return cell.startswith("[") and _SEVERAL.fullmatch(cell) is not None


@dataclass(frozen=True)
class Times:
    """How the times of one table are read: `mixed` where some have a decimal point and others a decimal comma.

    `decimal_seen` is empty where no time has any; `scale` is that of what stands in its column, in its unit.
    """

    decimal_seen: str
    unit: str
    mixed: bool = False
    scale: float = 1.0

    def value(self, cell: str) -> float:
        """Return the time in a cell, in the unit of its column, NaN where it holds none in that unit."""
        text, unit = _parts(cell)
        if unit not in ("", self.unit):
            return nan
        bare_text, sign = (text.replace(",", "."), ".") if self.mixed else (text, self.decimal_seen or ".")
        return delimited.number(bare_text, sign) * self.scale


def times_of(path: Path, table: Table, column: str | None, unit: str, stated: Stated) -> Times:
    """Return how the times in a column are read, in `unit` where their cells name none.

    Raises `DatasetError` where their decimal sign is not clear, and where their cells name another unit.
    """
    if column is None or column not in table.header:
        return Times("", unit)
    place = table.header.index(column)
    cells = [_parts(one.cells[place].strip()) for one in table.rows if place < len(one.cells)]
    others = sorted({own for _, own in cells if own in _other_units(unit)})
    if others:
        option = {"s": "--seconds", "ms": "--milliseconds"}[others[0]]
        raise DatasetError(
            path, f"got times in {others[0]}, according to the cells", f"give the column with {option}", allowed=unit,
            field=f"column {column}",
        )  # fmt: skip
    texts = [text for text, _ in cells]
    if stated.decimal is None and _mixed(texts):
        return Times("", unit, mixed=True)
    decimal = stated.decimal or delimited.decimal_sign(texts, table.understood.delimiter)
    if decimal is None:
        likely = delimited.decimal_sign(texts, table.understood.delimiter, printed=True)
        raise DatasetError.saying(delimited.unclear_decimal(path, stated, likely))
    return Times(decimal, unit)


def _other_units(unit: str) -> tuple[str, ...]:
    """Return the units of time that cells may name besides that of their column."""
    return tuple(one for one in ("s", "ms") if one != unit)


def _parts(cell: str) -> tuple[str, str]:
    """Return the number in a cell as text, and the unit of time behind it, empty without one."""
    text = bare(cell)
    match = _WITH_UNIT.fullmatch(text)
    unit = time_unit(Heading("", match[2])) if match is not None else ""
    return (match[1].strip(), unit) if match is not None and unit else (text, "")


def _mixed(texts: Sequence[str]) -> bool:
    """Return whether some cells can only have a decimal point, others only a decimal comma, and none has both."""
    points, commas = (
        any(sign in text and isfinite(delimited.number(text, sign)) and isnan(delimited.number(text, other))
            for text in texts)
        for sign, other in (".,", ",.")
    )  # fmt: skip
    return points and commas and not any("." in text and "," in text for text in texts)
