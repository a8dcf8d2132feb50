"""Lines of plain text: paragraphs, lists, facts and tables."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence

WIDTH = 92
"""Characters a line, at most."""

LEFT_EMPTY = "(left for the laboratory)"
"""How an empty field reads."""


def say(text: str, indent: str = "", first: str | None = None) -> list[str]:
    """A paragraph, wrapped; `first` stands before its first line instead of `indent`."""
    begin = indent if first is None else first
    return textwrap.wrap(" ".join(text.split()), WIDTH, initial_indent=begin, subsequent_indent=indent)


def item(text: str) -> list[str]:
    """One entry of a list."""
    return say(text, indent="    ", first="  - ")


def facts(*named: tuple[str, str]) -> Iterator[str]:
    """Names on the left, values on the right."""
    left = max(len(name) for name, _ in named) + 4
    for name, value in named:
        yield from say(value or LEFT_EMPTY, indent=" " * left, first=f"  {name}".ljust(left))


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Columns under a heading row."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for place, row in enumerate(rows):
        yield "  " + "   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        if place == 0:
            yield "  " + "   ".join("-" * width for width in widths)


def number(value: float) -> str:
    """A number without a needless `.0`."""
    return str(int(value)) if value == int(value) else str(value)


def quoted(words: Iterable[str]) -> str:
    """Words in quotes, with commas between."""
    return ", ".join(f'"{word}"' for word in words)


def count(things: int, noun: str) -> str:
    """How many things, in the plural where they are."""
    return f"{things} {noun}{'s' if things != 1 else ''}"
