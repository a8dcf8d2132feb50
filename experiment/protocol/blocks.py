"""What a page is made of, one value for the two renderings of `page/rendering.py`."""

from dataclasses import dataclass

from palpate.experiment.settings.characters import plain

UNBROKEN, OPEN, CLOSE = "\ue000", "\ue002", "\ue003"
"""Stand for a blank inside a name while lines are broken, and for the double quotes about it; no text holds them."""


@dataclass(frozen=True)
class Free:
    """Text of the file, as the board is to read it, word for word."""

    text: str


@dataclass(frozen=True)
class Said:
    """A paragraph in words of palpate."""

    text: str
    indent: str = ""


@dataclass(frozen=True)
class Item:
    """An item of a list in words of palpate."""

    text: str


@dataclass(frozen=True)
class Quoted:
    """Free text behind bars, below what is said of it; or as an `item` of its own."""

    text: str
    item: bool = False


@dataclass(frozen=True)
class Facts:
    """Names with what is said or quoted beside each; an empty text reads as left empty."""

    known: tuple[tuple[str, str | Free], ...]


@dataclass(frozen=True)
class Rows:
    """Columns under a heading row, in words of palpate."""

    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Gap:
    """An empty line."""


Block = Said | Item | Quoted | Facts | Rows | Gap
"""What a page is made of, whether it becomes text or HTML."""


def facts(*known: tuple[str, str | Free]) -> Facts:
    return Facts(tuple((name, value if isinstance(value, str) else Free(value.text.strip())) for name, value in known))


def named(name: str) -> str:
    """Return a name of the file between double quotes, to be kept on one line."""
    return f"{OPEN}{plain(name, keep='')}{CLOSE}".replace(" ", UNBROKEN)


def number(value: float) -> str:
    """Return a number without a needless `.0`."""
    return str(int(value)) if value == int(value) else str(value)


def count(things: int, noun: str) -> str:
    return f"{things} {noun}{'s' if things != 1 else ''}"
