"""Small datasets of detection, with their protocols: yes or no at constant levels, and two intervals up and down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit

from tests.analysis.datasets import write_dataset
from tests.experiment.protocol.detection import CONSTANT, UP_DOWN, detecting

TABLES = {1: detecting(1, CONSTANT), 2: detecting(2, UP_DOWN)}
NAMES: tuple[str, ...] = tuple(one["id"] for one in TABLES[1]["materials"])
SIGNAL, BLANK = NAMES[0], NAMES[-1]

YES_NO: dict[str, Sequence[tuple[int, int]]] = {
    # Of each level, so many yes in so many trials; and last of the catch trials.
    "1": [(1, 10), (3, 10), (8, 10), (10, 10), (2, 20)],
    "2": [(0, 10), (5, 10), (9, 10), (10, 10), (1, 20)],
}

TRACK = "++++-++-+-++++-++-"
"""Right and wrong answers of one participant, two down and one up from level 1."""


def yes_no_rows(counts: Sequence[tuple[int, int]]) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for level, (yes, trials) in zip((*CONSTANT["grid"], None), counts, strict=True):
        shown: dict[str, object] = (
            {"presented": BLANK} if level is None else {"presented": SIGNAL, "level": level, "track": SIGNAL}
        )
        rows += [shown | {"answered": "yes" if place < yes else "no"} for place in range(trials)]
    return _numbered(rows)


def two_rows(track: str) -> list[dict[str, object]]:
    """Levels by hand: two right in a row lower the level, a wrong one raises it."""
    grid, place, run = UP_DOWN["grid"], len(UP_DOWN["grid"]) - 1, 0
    rows: list[dict[str, object]] = []
    for number, one in enumerate(track):
        lead = number % 2 == 0
        order = (SIGNAL, BLANK) if lead else (BLANK, SIGNAL)
        answered = "first" if lead == (one == "+") else "second"
        rows.append({"first": order[0], "second": order[1], "answered": answered, "level": grid[place]})
        run = run + 1 if one == "+" else 0
        if one == "-":
            place = min(place + 1, len(grid) - 1)
        elif run == 2:
            place, run = max(place - 1, 0), 0
    return _numbered(rows)


def _numbered(rows: Sequence[dict[str, object]]) -> list[dict[str, object]]:
    return [{"trial": number, "attempt": 1, "counted": True, **row} for number, row in enumerate(rows, start=1)]


def dataset(
    root: Path, intervals: int = 1, rows: Mapping[str, list[dict[str, object]]] | None = None, **changed: Any
) -> Path:
    tables = TABLES[intervals] | changed
    sessions = (
        {who: {"one": own} for who, own in rows.items()}
        if rows
        else (
            {who: {"one": yes_no_rows(counts)} for who, counts in YES_NO.items()}
            if intervals == 1
            else {"1": {"one": two_rows(TRACK)}}
        )
    )
    write_dataset(
        root, sessions, study="small", materials=NAMES, tasks=("one",), origin="REHEARSAL", kind="presented",
        answers=("yes", "no") if intervals == 1 else ("first", "second"), design="detection", intervals=intervals,
    )  # fmt: skip
    (root / "sourcedata").mkdir(exist_ok=True)
    (root / "sourcedata" / "protocol.toml").write_text(tomlkit.dumps(tables), "utf-8")
    return root


def sample(folder: Path) -> Path:
    return dataset(folder / "study")
