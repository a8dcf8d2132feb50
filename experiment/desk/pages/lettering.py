"""Letters of the participant's screen: fonts, lines, and texts that are as large as they fit, or in parts."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.errors import DisplayError

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont

Colour = tuple[int, int, int]

SIZES_PX = (72, 60, 52, 46, 40, 36, 32, 28, 24, 20)
"""The line that says what to do now is as large as it fits."""

LARGEST_PX, LEGIBLE_PX, FEWEST_LINES = 46, 28, 3
"""Letters of the text beside it: the largest, and those below which it is divided instead, if that leaves so many lines
to a part.
"""

NO_BREAK_BEFORE = "、。，．・：；？！」』）】〕〉》ー々ゝゞぁぃぅぇぉっゃゅょゎァィゥェォッャュョヮ…‥%)]}.,:;?!"
NO_BREAK_AFTER = "「『（【〔〈《([{"
UNSPACED = (("\u2e80", "\u9fff"), ("\uac00", "\ud7af"), ("\uf900", "\ufaff"), ("\uff00", "\uffef"))
"""Letters between which a line may break."""

TURNS_PX = 96
"""The height of the row below a divided text that shows which part it is."""

REGULAR = ("NotoSansCJK-Regular", "NotoSans-Regular", "ipagp", "ipag", "DejaVuSans")
"""Fonts that are taken before others, by their files."""


@dataclass(frozen=True)
class Lines:
    """Lines in letters of a size, pixels."""

    lines: list[str]
    size_px: float

    @property
    def pitch(self) -> float:
        return 1.5 * self.size_px

    @property
    def height(self) -> float:
        return self.pitch * len(self.lines)

    def draw(self, draw: ImageDraw, centre: float, top: float, colour: Colour, font: Path) -> float:
        """Draw the lines one below the other, and return where they end."""
        for row, line in enumerate(self.lines):
            middle = top + self.pitch * (row + 0.5)
            draw.text((centre, middle), line, colour, typeface(font, self.size_px), anchor="mm")
        return top + self.height


@lru_cache(maxsize=64)
def _laid(text: str, width: float, size_px: float, font: Path) -> Lines:
    return Lines(wrapped(text, width, typeface(font, size_px).getlength), size_px)


def fitted(text: str, room: tuple[float, float], unit: float, font: Path) -> Lines:
    """Return a text in lines, as large as fits in `room`, width and height in pixels, cut with dots."""
    if not text:
        return Lines([], unit)
    for size in SIZES_PX:
        laid = _laid(text, room[0], size * unit, font)
        if laid.height <= room[1]:
            return Lines(_balanced(text, len(laid.lines), room[0], typeface(font, laid.size_px)), laid.size_px)
    whole = max(1, int(room[1] / laid.pitch))
    return Lines([*laid.lines[: whole - 1], f"{laid.lines[whole - 1]} ..."], laid.size_px)


def parted(text: str, room: tuple[float, float], unit: float, font: Path, below_px: float) -> list[Lines]:
    """Return a text in lines, as large as fits in `room`, width and height in pixels, else in parts of which each does.

    Its letters are smaller than `below_px`.
    """
    for size in SIZES_PX:
        if not text or size > LARGEST_PX or (size * unit >= below_px and size != SIZES_PX[-1]):
            continue
        laid = _laid(text, room[0], size * unit, font)
        if laid.height <= room[1]:
            return [Lines(_balanced(text, len(laid.lines), room[0], typeface(font, laid.size_px)), laid.size_px)]
        most = max(1, int((room[1] - TURNS_PX * unit) / laid.pitch))
        if (size <= LEGIBLE_PX and most >= FEWEST_LINES) or size == SIZES_PX[-1]:
            each = -(-len(laid.lines) // -(-len(laid.lines) // most))
            return [Lines(laid.lines[at : at + each], laid.size_px) for at in range(0, len(laid.lines), each)]
    return [Lines([], unit)]


def _balanced(text: str, count: int, width: float, letters: FreeTypeFont) -> list[str]:
    """Return a text in `count` lines, which fit in `width`, of about one length, so that no word is left alone."""
    too_narrow = width / 2
    while width - too_narrow > width / 50:
        middle = (width + too_narrow) / 2
        if len(wrapped(text, middle, letters.getlength)) > count:
            too_narrow = middle
        else:
            width = middle
    return wrapped(text, width, letters.getlength)


@lru_cache(maxsize=64)
def typeface(font: Path, size_px: float) -> FreeTypeFont:
    from PIL import ImageFont

    try:
        return ImageFont.truetype(str(font), size_px)
    except OSError as error:
        raise DisplayError(
            "screen.font",
            f"{font}: got {error}",
            "choose another font, or none",
            allowed="a font file (.ttf, .otf, .ttc)",
        ) from error


def wrapped(text: str, width: float, measure: Callable[[str], float]) -> list[str]:
    """Return a text in lines no wider than `width` by `measure`, except for a single letter.

    A line ends at a blank, between letters of a script without blanks, or else in a word.
    """
    lines = []
    for paragraph in text.strip().split("\n"):
        line = ""
        for part in _parts(paragraph):
            if line and measure((line + part).rstrip()) > width:
                lines.append(line.rstrip())
                line = ""
            line += part.lstrip() if not line else part
            while measure(line.rstrip()) > width and len(line) > 1:
                fits = next(n for n in range(len(line) - 1, 0, -1) if n == 1 or measure(line[:n]) <= width)
                lines.append(line[:fits])
                line = line[fits:]
        lines.append(line.rstrip())
    return lines


def _parts(text: str) -> Iterator[str]:
    """Yield the parts of a text that stay together on a line, blanks at their ends."""
    part = ""
    for before, after in pairwise(text + " "):
        part += before
        blank = before.isspace() and not after.isspace()
        between = (_unspaced(before) or _unspaced(after)) and not after.isspace()
        if blank or (between and after not in NO_BREAK_BEFORE and before not in NO_BREAK_AFTER):
            yield part
            part = ""
    if part:
        yield part


def _unspaced(letter: str) -> bool:
    return any(first <= letter <= last for first, last in UNSPACED)


def font_for(letters: frozenset[str], wanted: Path | None) -> tuple[Path, str]:
    """Return the font file for letters, and those that it lacks: the wanted, matplotlib's, or a complete one."""
    import matplotlib as mpl

    first = wanted or Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    missing = letters - _glyphs(first)
    if missing and wanted is None:
        for path in _of_this_machine():
            if letters <= _glyphs(path):
                return path, ""
    return first, "".join(sorted(missing))


@lru_cache(maxsize=1)
def _of_this_machine() -> tuple[Path, ...]:
    from matplotlib import font_manager

    paths = [Path(path) for path in font_manager.findSystemFonts()]

    def preferred(path: Path) -> tuple[int, int, str]:
        place = REGULAR.index(path.stem) if path.stem in REGULAR else len(REGULAR)
        return place, len(path.stem), os.fspath(path)

    return tuple(sorted(paths, key=preferred))


@lru_cache(maxsize=512)
def _glyphs(font: Path) -> frozenset[str]:
    """Return the letters that a font file holds; none where it cannot be read."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(map(chr, FT2Font(os.fspath(font)).get_charmap()))
    except (OSError, RuntimeError):
        return frozenset()
