"""The fault campaign: what is done to palpate, how often, and what it survived.

Each part is a module of this folder with a function `attacks(size)` that yields one `Count` a kind of fault. The suite
runs a small part of each; `python -m tests.faults` runs everything and writes `table.csv`, part by part, and its sums
into the README.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from itertools import groupby
from pathlib import Path

README = Path(__file__).with_name("README.md")
TABLE = README.with_name("table.csv")
BEGIN, END = "<!-- campaign -->", "<!-- end of campaign -->"

PARTS: tuple[str, ...] = (
    "kills",
    "writes",
    "rehearsals",
    "stalls",
    "exposure",
    "endurance",
    "files",
    "journals",
    "anchors",
    "texts",
    "inputs",
    "trackers",
    "planted",
)
"""Modules of this folder that hold the parts, in the order of the table."""


class Size(Enum):
    """How much of a part is run: a subset for every change, or all of it."""

    SUBSET = "subset"
    WHOLE = "whole"

    def of(self, subset: int, whole: int) -> int:
        """Return the number that belongs to this size."""
        return whole if self is Size.WHOLE else subset


@dataclass(frozen=True)
class Count:
    """How often a fault was tried, and how often palpate survived it.

    It survives where everything that the promise says holds afterwards: see the README for each kind. `lost` counts
    what was lost, doubled, invented or let in over all tries, whatever the kind's promise is about. `failures` say what
    happened in the tries that were not survived; the table does not hold them.
    """

    fault: str
    tried: int
    survived: int
    lost: int = 0
    failures: tuple[str, ...] = ()


def attacks(part: str, size: Size) -> Iterator[Count]:
    """Run one part."""
    yield from import_module(f"tests.faults.{part}").attacks(size)


def write(part: str, counts: Iterable[Count], table: Path = TABLE, readme: Path = README) -> None:
    """Replace the rows of one part in the table, which has the parts in their order, and the sums in the README."""
    with table.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    new = [[part, one.fault, *map(str, (one.tried, one.survived, one.lost))] for one in counts]
    rows = sorted([*(row for row in rows if row[0] != part), *new], key=lambda row: PARTS.index(row[0]))
    with table.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
    before, _, after = readme.read_text("utf-8").partition(BEGIN)
    readme.write_text("\n\n".join([before + BEGIN, sums(rows), END + after.partition(END)[2]]), "utf-8")


def sums(rows: Iterable[list[str]]) -> str:
    """Return the README's table: of each part that has rows, how many faults, and the sums of their counts."""
    lines = ["| part | faults | tried | survived | lost |", "|:--|--:|--:|--:|--:|"]
    for part, group in groupby(rows, key=lambda row: row[0]):
        counts = [[int(count) for count in row[2:]] for row in group]
        total = (f"{sum(column):,}" for column in zip(*counts, strict=True))
        lines.append(f"| `{part}` | {' | '.join([str(len(counts)), *total])} |")
    return "\n".join(lines)
