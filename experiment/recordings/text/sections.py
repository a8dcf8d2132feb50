"""Sections of one text, each a table with a head of its own: motion capture writes force plates, then markers."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby, pairwise

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.text.cells import is_missing, is_number
from palpate.experiment.settings.delimited import Stated

FEWEST_ROWS = 3
"""Fewer lines of numbers in a row belong to what stands above them. Ours."""

_LINE = re.compile(r"[^\r\n]*(?:\r\n|\n|\r)|[^\r\n]+")
_COMMENT = re.compile(r"\s*(?:#|%|//)")


@dataclass(frozen=True)
class Section:
    """A head and the rows below it: its name, its first line, from 1, and where it begins and ends in the text."""

    name: str
    line: int
    start: int
    end: int
    rows: int


@dataclass(frozen=True)
class _Line:
    """A line that is neither empty nor a comment: cells, whether all are numbers, and whether an empty one is above."""

    line: int
    start: int
    cells: tuple[str, ...]
    numeric: bool
    apart: bool


def sections(text: str, delimiter: str, first: int = 0) -> list[Section]:
    """Return the sections of a text, in order; a text with one head has one, and one without rows none.

    Rows begin behind the `first` cells, in which a head may stand beside them. A remark, or a heading that a program
    wrote once more, begins no section.
    """
    runs = [
        (numeric, [*some]) for numeric, some in groupby(_lines(text, delimiter, first), key=lambda one: one.numeric)
    ]
    bodies = [place for place, (numeric, some) in enumerate(runs) if numeric and len(some) >= FEWEST_ROWS]
    heads: list[list[_Line]] = []
    rows: list[int] = []
    for before, body in pairwise((-1, *bodies)):
        head = [one for _, some in runs[before + 1 : body] for one in some]
        if not heads or _begins(head, heads[-1], runs[body][1]):
            heads.append(head or runs[body][1])
            rows.append(0)
        rows[-1] += len(runs[body][1])
    if not heads:
        return []
    starts = [0, *(head[0].start for head in heads[1:]), len(text)]
    return [
        Section(head[0].cells[0], head[0].line, *between, many)
        for head, between, many in zip(heads, pairwise(starts), rows, strict=True)
    ]


def has_rows(text: str, delimiter: str, first: int) -> bool:
    """Return whether a head holds rows of another section."""
    runs = groupby(_lines(text, delimiter, first), key=lambda one: one.numeric)
    return any(numeric and len([*some]) >= FEWEST_ROWS for numeric, some in runs)


def section_of(text: str, delimiter: str, first: int, stated: Stated) -> tuple[str, str] | None:
    """Return a text with empty lines in place of all sections but the one that is stated, and the name of that one.

    None for a text of one section. Raises `RecordingError` where it has several and none of
    them is stated, or one that is not there.
    """
    found = sections(text, delimiter, first)
    names = [one.name for one in found]
    asked = stated.section
    if len(found) < 2 and asked is None:
        return None
    place = names.index(asked) if asked is not None and names.count(asked) == 1 else -1
    if place < 0 and asked is not None and asked.isdecimal():
        place = int(asked) - 1
    if not 0 <= place < len(found):
        told = ", ".join(f"{at} {one.name!r} from line {one.line}" for at, one in enumerate(found, start=1))
        one = names[0] if names.count(names[0]) == 1 else "1"
        raise RecordingError(
            f"got {len(found)} sections with separate headings" if asked is None else f"got section {asked!r}",
            remedy=stated.remedy("choose one", "--section", one),
            allowed=f"one of {told}, by name or number",
        )
    if len(found) < 2:
        return None
    chosen = found[place]
    return "\n" * (chosen.line - 1) + text[chosen.start : chosen.end], chosen.name


def _lines(text: str, delimiter: str, first: int) -> Iterator[_Line]:
    apart = False
    for line, match in enumerate(_LINE.finditer(text), start=1):
        cells = tuple(cell.strip(' "\t\r\n') for cell in match[0].split(delimiter or None)[first:])
        filled = tuple(cell for cell in cells if cell)
        if not filled:
            apart = True
        elif not _COMMENT.match(match[0]):
            yield _Line(line, match.start(), filled, all(is_number(cell) or is_missing(cell) for cell in filled), apart)
            apart = False


def _begins(head: list[_Line], before: list[_Line], body: list[_Line]) -> bool:
    """Return whether these lines are the head of another section."""
    width = len(body[0].cells)
    named = [one for one in head if len(one.cells) >= width and not is_number(one.cells[0])]
    if len(head) == 1:
        return bool(named) and width > 1 and head[0].cells != before[-1].cells
    return bool(named) or head[0].apart
