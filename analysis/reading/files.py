"""The files of a dataset, each refused with its place where it is broken: texts, JSON, tables, and tables of trials."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from palpate.analysis.documents.tables import plural
from palpate.analysis.reading.study import TaskDesign
from palpate.experiment import storage
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER, PLACES, Columns, columns_of
from palpate.experiment.settings.characters import JOINERS, hidden, quoted

T = TypeVar("T")

MISSING = "n/a"
FURTHER = {
    "masker_db_a": "masker_level",
    "level": "level",
    **{f"{column}_s": column for column in ("prediction_error", "delivery_error", "gate_to_scheduled", "dead_time")},
    "foot_force_n": "foot_force",
    "foot_force_peak_n": "foot_force_peak",
    "stimulus_error": "stimulus_error",
    "left_out": "left_out",
    "dissimilarity_m_s2": "dissimilarity",
    "sent_peak_m_s2": "sent_peak",
    "heard_peak_m_s2": "heard_peak",
    "heard_delay_s": "heard_delay",
    "heard_gain": "heard_gain",
}
"""The name of each further column of numbers in the frame, and in the events file."""

OF_STEPS = {
    "foot_speed_mm_s": ("foot_speed", "a number from 0"),
    "frames_lost": ("frames_lost", "a whole number from 0"),
    "delivered": ("delivered", "0, 1"),
    "onset_error_s": ("onset_error", "a number"),
}
"""What only footsteps have: its name in the frame, its column, and what that may hold; NaN of other trials."""

THIRDS = 18
"""So many third octaves are from 10 to 500 Hz."""

PRESENTED = ("presented", *PLACES)
"""Columns that say what a trial presented; a kind has the first, or the others."""

NEEDED = ("trial", "attempt", "counted", "answered", "response_time", "redo_reason", "origin")
"""Columns without which no trial is read; a dataset of an older format may lack others that came later."""


@dataclass(frozen=True)
class Levels:
    """What the cells of an events file may hold."""

    presented: tuple[str, ...]
    design: TaskDesign
    origin: str
    older: bool


def _text(path: Path, remedy: str) -> str:
    try:
        return storage.read_text(path)
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is missing", remedy=remedy) from error
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path} cannot be read ({storage.why(error)})", remedy=remedy) from error


def json_of(path: Path, remedy: str) -> dict[str, Any]:
    text = _text(path, remedy)
    try:
        content = storage.json_of(text)
    except json.JSONDecodeError as error:
        raise DatasetError(path, f"line {error.lineno} is not JSON ({error.msg})", "rebuild the dataset") from error
    except ValueError as error:
        raise DatasetError(path, f"is not JSON ({error})", "rebuild the dataset") from error
    if not isinstance(content, dict):
        raise DatasetError(path, f"got {type(content).__name__}", "rebuild the dataset", allowed="a JSON object")
    # Without escapes and without such a character in the text, none can stand in what it holds.
    if "\\" in text or hidden(text, "\n" + JOINERS):
        refuse_hidden(path, content)
    return content


def refuse_hidden(path: Path, held: object) -> None:
    """Refuse a text, wherever it stands in a document, with a character that a page or a table must not show."""
    if isinstance(held, Mapping):
        held = [*held, *held.values()]
    if isinstance(held, list):
        for one in held:
            refuse_hidden(path, one)
    elif isinstance(held, str) and hidden(held, "\n" + JOINERS):
        raise DatasetError(
            path,
            f"got {quoted(held)}",
            "rebuild the dataset",
            allowed="text without control or invisible characters",
        )


def wrong(path: Path, key: str, got: object, allowed: str) -> DatasetError:
    return DatasetError(path, f"{key} is {got!r}", "rebuild the dataset", allowed=allowed)


def table_of(path: Path) -> tuple[list[str], list[list[str]]]:
    text = _text(path, "rebuild the dataset")
    if not text.endswith("\n"):
        raise DatasetError(f"{path} ends in the middle of a line", remedy="it is truncated: rebuild the dataset")
    refuse_hidden(path, text.replace("\t", " "))
    lines = [line.split("\t") for line in text.removesuffix("\n").split("\n")]
    for number, line in enumerate(lines, start=1):
        if len(line) != len(lines[0]):
            raise DatasetError(path, f"{len(line)} cells in {len(lines[0])} columns", "correct the line", line=number)
    return lines[0], lines[1:]


def columns_in(asked: TaskDesign) -> Columns:
    """Return the columns of a table of trials of a kind and a design."""
    return columns_of(asked.kind, asked.intervals)


def presented_in(asked: TaskDesign) -> list[str]:
    """Return those that say what a trial presented."""
    return [column for column in PRESENTED if column in columns_in(asked)]


def trials_in(path: Path, participant: str, task: str, levels: Levels, count: int) -> dict[str, Sequence[object]]:
    """Return the columns of a table of trials, by their names in the frame."""
    header, lines = table_of(path)
    own = list(columns_in(levels.design))
    if levels.older:
        own = [column for column in own if column in (*NEEDED, *PRESENTED)]
    if missing := [column for column in own if column not in header]:
        raise DatasetError(path, f"missing columns: {', '.join(missing)}", "rebuild the dataset")
    if len(lines) != count:
        raise DatasetError(path, f"{plural(len(lines), 'row')}, its sidecar lists {count}", "rebuild the dataset")
    cells = {name: [line[place] for line in lines] for place, name in enumerate(header)}
    _check_choices(path, cells, levels)
    found = _parsed(path, cells, presented_in(levels.design))
    known: set[object] = set()
    for number, (trial, counts) in enumerate(zip(found["trial"], found["counted"], strict=True), start=2):
        if counts and trial in known:
            raise DatasetError(path, f"trial {trial} counts twice", "mark only one attempt as counted", line=number)
        known |= {trial} if counts else set()
    return {"participant": [participant] * count, "task": [task] * count, **found}


def _check_choices(path: Path, cells: Mapping[str, Sequence[str]], levels: Levels) -> None:
    """Raise `DatasetError` for the first cell of a column that is none of those that it may have."""
    answers = (*levels.design.answers, NO_ANSWER)
    choices: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
        "counted": (("0", "1"),) * 2,
        **dict.fromkeys(presented_in(levels.design), (levels.presented,) * 2),
        "answered": ((*answers, MISSING), answers),
        "origin": ((levels.origin,),) * 2,
    }
    for column, allowed in choices.items():
        for number, (cell, counted) in enumerate(zip(cells[column], cells["counted"], strict=True), start=2):
            if cell not in (may := allowed[counted == "1"]):
                where, got = f"{path}: line {number}", f"{column}: got {cell!r}"
                raise DatasetError(where, got, "correct the row", allowed=", ".join(may))


def _parsed(path: Path, cells: Mapping[str, list[str]], presented: Sequence[str]) -> dict[str, Sequence[Any]]:
    """Return the columns of the frame from the cells of each column."""
    none = [MISSING] * len(cells["trial"])

    def numbers(column: str, allowed: str = "a number") -> Sequence[float]:
        if column not in cells:
            return array("d", [math.nan]) * len(none)
        return array("d", _each(path, column, cells[column], partial(_number, allowed=allowed)))

    together = [" | ".join(of) for of in zip(*(cells[column] for column in presented), strict=True)]
    counted = [cell == "1" for cell in cells["counted"]]
    return {
        **{column: _each(path, column, cells[column], _whole) for column in ("trial", "attempt")},
        "counted": counted,
        "presented": together,
        **{column: cells[column] for column in presented},
        "answered": cells["answered"],
        "response_time_s": numbers("response_time", "a number from 0"),
        **{name: numbers(column, allowed) for name, (column, allowed) in OF_STEPS.items()},
        **{name: numbers(column) for name, column in FURTHER.items()},
        **{name: _each(path, name, cells.get(name, none), _levels_db) for name in ("sent_thirds", "heard_thirds")},
        "stimulus_method": cells.get("stimulus_method", none),
        "heard_of": cells.get("heard_of", together),
        "redo_reason": cells["redo_reason"],
        "included": counted,
    }


def _each(path: Path, column: str, cells: Sequence[str], parse: Callable[[str], T]) -> list[T]:
    """Return what each cell of a column holds. Raises `DatasetError` for the first that `parse` refuses."""
    known: dict[str, T] = {}
    for number, cell in enumerate(cells, start=2):
        if cell not in known:
            try:
                known[cell] = parse(cell)
            except ValueError as error:
                got, allowed = error.args
                where = f"{path}: line {number}: {column}"
                raise DatasetError(where, got, "correct the row", allowed=allowed) from None
    return [known[cell] for cell in cells]


def _levels_db(cell: str) -> tuple[float, ...] | None:
    """Return the levels of third octaves, dB, shape (18,); None for none."""
    parts = [] if cell == MISSING else cell.split(" | ")
    if parts and len(parts) != THIRDS:
        raise ValueError(f"got {plural(len(parts), 'level')}", f"{THIRDS} levels, or {MISSING}")
    return tuple(map(_number, parts)) or None


def _whole(cell: str) -> int:
    if not (cell.isascii() and cell.isdigit() and len(cell) < 8 and int(cell) > 0):
        raise ValueError(f"got {cell!r}", "a whole number from 1")
    return int(cell)


ALLOWED: Mapping[str, Callable[[float], bool]] = {
    "a number": math.isfinite,
    "a number from 0": lambda value: 0 <= value < math.inf,
    "a whole number from 0": lambda value: 0 <= value < 2**53 and value.is_integer(),
    "0, 1": lambda value: value in (0, 1),
}
"""The words of an error -> the check of a value."""


def _number(cell: str, allowed: str = "a number") -> float:
    if cell == MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not ALLOWED[allowed](value):
        raise ValueError(f"got {cell!r}", f"{allowed}, or {MISSING}")
    return value
