"""The fault campaign: what is done to palpate, how often, and what it survived.

Each part is a module of this folder with a function `attacks(size)` that yields one `Count` a kind of fault. The suite
runs a small part of each; `python -m tests.faults` runs everything and writes the table of this folder's README, part
by part.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from itertools import chain
from pathlib import Path

README = Path(__file__).with_name("README.md")
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


def write(part: str, counts: Iterable[Count], readme: Path = README) -> None:
    """Replace the rows of one part in the README's table, which has the parts in their order."""
    text = readme.read_text("utf-8")
    before, table, after = text.split(BEGIN)[0], text.split(BEGIN)[1].split(END)[0], text.split(END)[1]
    rows = {one: [line for line in table.splitlines() if line.startswith(f"| `{one}` |")] for one in PARTS}
    rows[part] = [f"| `{part}` | {one.fault} | {one.tried:,} | {one.survived:,} | {one.lost:,} |" for one in counts]
    lines = ["| part | fault | tried | survived | lost |", "|:--|:--|--:|--:|--:|", *chain(*rows.values())]
    readme.write_text("\n".join([f"{before}{BEGIN}", "", *lines, "", f"{END}{after}"]), "utf-8")
