"""Blocks of a page as lines of plain text, and as HTML in which nothing runs.

No quoted text can pass for words of palpate: free text stands behind a bar, on lines of its own where letters run from
right to left, and names stand between double quotes and are never broken.
"""

import textwrap
import unicodedata
from collections.abc import Iterable, Iterator
from functools import lru_cache
from html import escape

from palpate.experiment.protocol.blocks import (
    CLOSE,
    OPEN,
    UNBROKEN,
    Block,
    Facts,
    Free,
    Gap,
    Item,
    Quoted,
    Rows,
    Said,
)
from palpate.experiment.settings.characters import leftward, plain

WIDTH = 92
"""Columns of a line, at most."""

LEFT_EMPTY = "(left for the laboratory)"
"""How an empty field reads."""

BAR = "| "
"""Stands before each line of free text."""

SECOND_HALF = "\ue001"
"""Stands for the second column of a wide character while lines are broken; no text holds it."""


def lines(blocks: Iterable[Block]) -> Iterator[str]:
    """Yield blocks as lines of text."""
    for block in blocks:
        match block:
            case Said(text, indent):
                yield from _wrapped(text, indent, indent)
            case Item(text):
                yield from _wrapped(text, "    ", "  - ")
            case Quoted(text, item):
                yield from _quoted(text, "  - " if item else "    ")
            case Facts(known):
                yield from _facts(known)
            case Rows(rows):
                yield from _rows(rows)
            case Gap():
                yield ""


@lru_cache(maxsize=1024)
def _wrapped(text: str, indent: str, first: str) -> tuple[str, ...]:
    """Return a wrapped paragraph; `first` stands before its first line, and `indent` before the others."""
    wide = " ".join(text.split())
    if not wide.isascii():
        wide = "".join(one + SECOND_HALF * (unicodedata.east_asian_width(one) in "WF") for one in wide)
    found = textwrap.wrap(wide, WIDTH, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)
    return tuple(line.replace(SECOND_HALF, "").translate(_SHOWN) for line in found)


_SHOWN = str.maketrans({UNBROKEN: " ", OPEN: '"', CLOSE: '"'})
_NAMES = str.maketrans({OPEN: '<span class="name">&quot;', CLOSE: "&quot;</span>", UNBROKEN: " "})


def _barred(text: str, indent: str, first: str) -> tuple[str, ...]:
    if leftward(text) and first.strip():
        return first.rstrip(), *_barred(text, indent, indent)
    return _wrapped(plain(text, keep="\n"), indent + BAR, first + BAR)


def _quoted(text: str, first: str) -> Iterator[str]:
    """Yield free text in lines as its author broke it, each behind a bar."""
    line, *others = text.strip().split("\n")
    yield from _barred(line, "    ", first)
    for other in others:
        yield from _barred(other, "    ", "    ") or (f"    {BAR}".rstrip(),)


def _facts(known: tuple[tuple[str, str | Free], ...]) -> Iterator[str]:
    left = max(len(name) for name, _ in known) + 4
    for name, value in known:
        text = value.text if isinstance(value, Free) else value
        laid = _barred if isinstance(value, Free) and text else _wrapped
        yield from laid(text or LEFT_EMPTY, " " * left, f"  {name}".ljust(left))


def _rows(rows: tuple[tuple[str, ...], ...]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for place, row in enumerate(rows):
        yield "  " + "   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        if place == 0:
            yield "  " + "   ".join("-" * width for width in widths)


def html_text(text: str) -> str:
    """Return words of palpate, with the names in them kept whole."""
    return escape(text).translate(_NAMES)


def _free(text: str, of: str = "") -> str:
    """Return free text as a block of its own, which nothing in the text can leave."""
    return f'<blockquote dir="ltr"{of}>{escape(plain(text, keep=chr(10)))}</blockquote>\n'


def html_blocks(blocks: Iterable[Block]) -> str:
    """Return blocks as HTML, in which every text is escaped."""
    return "".join(map(_block, blocks))


def _block(block: Block) -> str:
    match block:
        case Said(text):
            return f"<p>{html_text(text)}</p>\n"
        case Item(text):
            return f'<p class="item">{html_text(text)}</p>\n'
        case Quoted(text, item):
            return _free(text, ' class="item"' if item else "")
        case Facts(known):
            said = (f'<tr><th scope="row">{html_text(name)}</th><td>{_fact(value)}</td></tr>' for name, value in known)
            return f'<table class="facts">{"".join(said)}</table>\n'
        case Rows(rows):
            cells = "".join(f'<th scope="col">{html_text(cell)}</th>' for cell in rows[0])
            body = "".join(f"<tr>{''.join(f'<td>{html_text(cell)}</td>' for cell in row)}</tr>" for row in rows[1:])
            return f'<table class="rows"><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>\n'
        case Gap():
            return ""


def _fact(value: str | Free) -> str:
    if isinstance(value, Free) and value.text:
        return _free(value.text)
    return html_text((value.text if isinstance(value, Free) else value) or LEFT_EMPTY)
