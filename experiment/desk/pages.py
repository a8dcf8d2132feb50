"""What the participant's screen looks like: from a prompt to a page, and from a page to a picture.

The background is always dark, no color is bright, and nothing moves or blinks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.display import ScreenKeys, ScreenRig, ScreenWords
from palpate.experiment.desk.messages import ENTER, Prompt
from palpate.experiment.errors import DisplayError
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY, SOFTER_KEY
from palpate.experiment.settings import characters

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont

Colour = tuple[int, int, int]

BACKGROUND: Colour = (34, 38, 42)
TEXT: Colour = (208, 203, 192)
MUTED: Colour = (150, 152, 150)
OUTLINE: Colour = (92, 98, 104)
CAP: Colour = (44, 50, 56)
LIT: dict[str, Colour] = {"slow": (128, 162, 200), "right": (132, 176, 136), "fast": (206, 164, 110)}
"""The pace of a step; its place and its words say it too."""

DESIGN_PX = (1280, 800)
"""Sizes are for a screen of this width and height, and grow and shrink with it."""

SIZES_PX = (60, 52, 46, 40, 36, 32, 28, 24, 20)
"""A text is as large as it fits."""

CAPS = {"up": "↑", "down": "↓", "left": "←", "right": "→", "return": "Enter", "space": "Space"}
"""What stands on a key, where that is not its name."""

NO_BREAK_BEFORE = "、。，．・：；？！」』）】〕〉》ー々ゝゞぁぃぅぇぉっゃゅょゎァィゥェォッャュョヮ…‥%)]}.,:;?!"
NO_BREAK_AFTER = "「『（【〔〈《([{"
UNSPACED = (("\u2e80", "\u9fff"), ("\uac00", "\ud7af"), ("\uf900", "\ufaff"), ("\uff00", "\uffef"))
"""Letters between which a line may break."""

OPTION_PX, LARGEST_OPTION_PX, MOST_ROWS = 72, 36, 6
"""The height of an option's row, the largest letters in it, and how many rows there are before another column."""

DIGITS = tuple("123456789")
"""Keys of the first options, by their places."""

HAND_MM, HAND_PX, BLOCK_PX = (-4.0, 20.0), 22, (360, 44)
"""How deep in the block and how high above it the hand is shown; its radius, and width and height of the block."""

_FACE_PX = 230
"""The block's face above the page's end, above the lamp; 1 mm is 9 pixels."""

REGULAR = ("NotoSansCJK-Regular", "NotoSans-Regular", "ipagp", "ipag", "DejaVuSans")
"""Fonts that are taken before others, by their files."""


@dataclass(frozen=True)
class Page:
    """One page: a text, a clock, keys with what they do, and the pace of the last step in its range.

    `keys` pairs a key, or nothing, with a text. `options` are answers that can be chosen, each in a box (`boxes`).
    `paces` are words and whether each was the last, as for a lamp. With a `block` the hand moves above it (`hand_px`).
    """

    text: str
    clock: str = ""
    keys: tuple[tuple[str, str], ...] = ()
    options: tuple[str, ...] = ()
    paces: tuple[tuple[str, str, bool], ...] = ()
    label: str = ""
    block: bool = False

    @property
    def letters(self) -> frozenset[str]:
        """Every letter that is drawn."""
        keys = (*sum(self.keys, ()), *self.options, "123456789" if self.options else "")
        said = (self.text, self.clock, self.label, *keys, *(words for _, words, _ in self.paces))
        return frozenset("".join(said)) - frozenset(" \n")


def page(prompt: Prompt | None, settings: ScreenRig, now_ns: int) -> Page:
    """Return the page of a prompt at a time of the system's clock, ns; without a prompt that of a lost session."""
    words = settings.words or ScreenWords()
    if prompt is None:
        return Page(words.gone)
    text, clock = _text(prompt, words), ""
    if prompt.show == "break" and prompt.until_ns is not None:
        left_s = -((now_ns - prompt.until_ns) // 1_000_000_000)
        text = words.pause if left_s > 0 else words.pause_over
        clock = f"{left_s // 60}:{left_s % 60:02}" if left_s > 0 else ""
    paces = (("slow", words.slow), ("right", words.right), ("fast", words.fast)) if prompt.pace else ()
    lit = [(pace, said, pace == prompt.pace) for pace, said in paces]
    if prompt.lamp is not None:
        lit.append(("fast", words.fast, True) if prompt.lamp else ("right", words.right, False))
    answering = prompt.question is not None and prompt.show in ("answer", "compare")
    return Page(
        text=characters.plain(text),
        clock=clock,
        keys=tuple(_keys(prompt, settings)) if prompt.question is not None and not answering else (),
        options=prompt.answers if answering else (),
        paces=tuple(lit),
        label=prompt.label,
        block=prompt.hand_mm is not None,
    )


def hand_px(hand_mm: float, size_px: tuple[int, int]) -> tuple[float, float]:
    """Return how far the middle of the hand is above that of a page of this size, and the hand's radius, pixels."""
    unit = min(size_px[0] / DESIGN_PX[0], size_px[1] / DESIGN_PX[1])
    high_mm = min(max(hand_mm, HAND_MM[0]), HAND_MM[1])
    return (_FACE_PX + 9 * high_mm + HAND_PX) * unit - size_px[1] / 2, HAND_PX * unit


def chosen(prompt: Prompt | None, key: str, settings: ScreenRig) -> str | None:
    """Return what a key of the participant chooses of a prompt that is shown; None where it chooses nothing."""
    if prompt is not None and prompt.show in ("answer", "compare"):
        digit = key.removeprefix("num_")
        return _option(prompt, int(digit) - 1 if digit in DIGITS else -1)
    keys = settings.keys or ScreenKeys()
    louder = HEARD_KEY if prompt is not None and HEARD_KEY in prompt.keys else LOUDER_KEY
    means = {keys.louder: louder, keys.softer: SOFTER_KEY, keys.probe: PROBE_KEY, keys.done: ENTER}.get(key)
    return means if prompt is not None and prompt.question is not None and means in prompt.keys else None


def touched(prompt: Prompt | None, place_px: tuple[float, float], size_px: tuple[int, int]) -> str | None:
    """Return what is chosen where the participant clicked, or touched, on a page of this size: x and y from its upper
    left corner, pixels; None where nothing is.
    """
    if prompt is None or prompt.show not in ("answer", "compare"):
        return None
    x, y = place_px
    placed = enumerate(boxes(len(prompt.answers), size_px))
    return _option(prompt, next((n for n, (x0, y0, x1, y1) in placed if x0 <= x <= x1 and y0 <= y <= y1), -1))


def _option(prompt: Prompt, place: int) -> str | None:
    return prompt.keys[place] if prompt.question is not None and 0 <= place < len(prompt.keys) else None


def boxes(count: int, size_px: tuple[int, int]) -> list[tuple[float, float, float, float]]:
    """Return where so many options are on a page of this size: x and y of upper left and lower right corner, pixels.

    They fill rows from the page's end, above the lamp of the pace.
    """
    width, height = size_px
    unit = min(width / DESIGN_PX[0], height / DESIGN_PX[1])
    columns = 1 if count <= MOST_ROWS else 2 if count <= 2 * MOST_ROWS else 3
    rows = -(-count // columns)
    wide = min(1060 * unit, width - 80 * unit)
    each, top = wide / columns, height - (150 + OPTION_PX * rows) * unit
    return [
        (
            (left := (width - wide) / 2 + each * (n // rows)) + 8 * unit,
            (upper := top + OPTION_PX * unit * (n % rows)) + 6 * unit,
            left + each - 8 * unit,
            upper + (OPTION_PX - 6) * unit,
        )
        for n in range(count)
    ]


def _text(prompt: Prompt, words: ScreenWords) -> str:
    match prompt.show:
        case "instructions":
            return prompt.text
        case "masker":
            said = words.masker if prompt.question is not None else words.set_for_you
            return f"{said}\n\n{words.tread}" if prompt.unplayed else said
        case "rest":
            return words.rest
        case "ready":
            return f"{prompt.text}\n\n{words.again if prompt.again else words.ready}".strip()
        case "coming" if prompt.interval is not None:
            return words.interval.replace("{number}", str(prompt.interval))
        case "coming":
            return f"{prompt.text}\n\n{words.coming}".strip()
        case "answer" | "compare":
            return _asks(prompt, words)
        case "break":
            return words.pause
        case "finished":
            return f"{words.finished}\n\n{words.headphones}" if prompt.unmasked else words.finished
        case "thanks":
            return f"{words.thanks}\n\n{words.headphones}" if prompt.unmasked else words.thanks
        case "wait":
            return f"{prompt.text}\n\n{words.wait}".strip()


def _asks(prompt: Prompt, words: ScreenWords) -> str:
    """Return what asks for the answer, with the answers where they stand in no box."""
    answers = prompt.answers if prompt.mode != "screen" else ()
    if prompt.asks and prompt.show == "answer":
        how = {"oral": words.say, "keys": words.button, "screen": words.option if prompt.question is not None else ""}
        asks = f"{prompt.asks}\n\n{how[prompt.mode]}".strip()
    elif prompt.mode == "oral":
        asks = words.compare if prompt.show == "compare" else words.answer
    else:
        asks = words.press if prompt.mode == "keys" else words.choose if prompt.question is not None else ""
        asks = f"{words.feel} {asks}".strip() if prompt.show == "compare" else asks
    said = "\n".join((asks, *answers))
    if prompt.show == "answer":
        return said
    there = "" if prompt.second is None else words.second if prompt.second else words.first
    return "\n\n".join(filter(None, (prompt.text, prompt.asks, said, there)))


def _keys(prompt: Prompt, settings: ScreenRig) -> Iterator[tuple[str, str]]:
    keys, words = settings.keys or ScreenKeys(), settings.words or ScreenWords()
    if LOUDER_KEY in prompt.keys:
        yield _cap(keys.louder), words.louder
    elif HEARD_KEY in prompt.keys:
        yield "", words.loudest
        yield _cap(keys.louder), words.audible
    if SOFTER_KEY in prompt.keys:
        yield _cap(keys.softer), words.softer
    if PROBE_KEY in prompt.keys:
        yield _cap(keys.probe), words.probe
    if ENTER in prompt.keys:
        yield _cap(keys.done), words.begin if prompt.show == "coming" else words.inaudible


def _cap(key: str) -> str:
    return CAPS.get(key, key.upper())


def drawn(page: Page, size_px: tuple[int, int], font: Path) -> Image:
    """Return a page as a picture of `size_px`, width and height, with the letters of a font file."""
    from PIL import Image, ImageDraw

    width, height = size_px
    unit = min(width / DESIGN_PX[0], height / DESIGN_PX[1])
    picture = Image.new("RGB", size_px, BACKGROUND)
    draw = ImageDraw.Draw(picture)
    if page.label:
        draw.text((32 * unit, 24 * unit), page.label, MUTED, _letters(font, 24 * unit), anchor="la")
    bottom = height - 150 * unit if page.paces else height - 60 * unit
    if page.block:
        wide, high, face = BLOCK_PX[0] * unit / 2, BLOCK_PX[1] * unit, height - _FACE_PX * unit
        draw.rectangle((width / 2 - wide, face, width / 2 + wide, face + high), CAP, OUTLINE, max(1, round(2 * unit)))
        bottom = face - (9 * HAND_MM[1] + 2 * HAND_PX + 10) * unit
    if page.paces:
        _draw_paces(draw, page, width / 2, height - 110 * unit, unit, font)
    if page.options:
        placed = boxes(len(page.options), size_px)
        _draw_options(draw, page.options, placed, unit, font)
        bottom = min(bottom, placed[0][1] - 20 * unit)
    keys_px = 84 * unit * len(page.keys) + (30 * unit if page.keys else 0)
    clock_px = 190 * unit if page.clock else 0.0
    room = (min(1060 * unit, width - 80 * unit), bottom - 70 * unit - keys_px - clock_px)
    lines, letters, pitch = _fitted(page.text, room, unit, font)
    top = (70 * unit + bottom - pitch * len(lines) - keys_px - clock_px) / 2
    for line in lines:
        top += pitch
        draw.text((width / 2, top - pitch / 2), line, TEXT, letters, anchor="mm")
    if page.clock:
        draw.text((width / 2, top + 110 * unit), page.clock, TEXT, _letters(font, 120 * unit), anchor="mm")
    _draw_keys(draw, page, width / 2, top + clock_px + 30 * unit, unit, font)
    return picture


def _fitted(text: str, room: tuple[float, float], unit: float, font: Path) -> tuple[list[str], FreeTypeFont, float]:
    """Return a text in lines, its letters and line spacing in pixels, as large as fits in `room`, cut with dots."""
    for size in SIZES_PX:
        letters = _letters(font, size * unit)
        lines, pitch = wrapped(text, room[0], letters.getlength), 1.5 * size * unit
        if pitch * len(lines) <= room[1]:
            return _balanced(text, len(lines), room[0], letters), letters, pitch
    whole = max(1, int(room[1] / pitch))
    return [*lines[: whole - 1], f"{lines[whole - 1]} ..."], letters, pitch


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


def _draw_keys(draw: ImageDraw, page: Page, centre: float, top: float, unit: float, font: Path) -> None:
    if not page.keys:
        return
    letters = _letters(font, 32 * unit)
    cap_px = max(64 * unit, *(letters.getlength(cap) + 36 * unit for cap, _ in page.keys))
    said_px = max(letters.getlength(said) for _, said in page.keys)
    left = centre - (cap_px + 28 * unit + said_px) / 2
    for row, (cap, said) in enumerate(page.keys):
        middle = top + (84 * row + 42) * unit
        if cap:
            box = (left, middle - 32 * unit, left + cap_px, middle + 32 * unit)
            draw.rounded_rectangle(box, 10 * unit, CAP, OUTLINE, max(1, round(2 * unit)))
            draw.text((left + cap_px / 2, middle), cap, TEXT, letters, anchor="mm")
        draw.text((left + cap_px + 28 * unit, middle), said, TEXT if cap else MUTED, letters, anchor="lm")


def _draw_options(
    draw: ImageDraw,
    options: tuple[str, ...],
    placed: list[tuple[float, float, float, float]],
    unit: float,
    font: Path,
) -> None:
    for number, (said, box) in enumerate(zip(options, placed, strict=True), start=1):
        draw.rounded_rectangle(box, 10 * unit, CAP, OUTLINE, max(1, round(2 * unit)))
        middle, left = (box[1] + box[3]) / 2, box[0] + 24 * unit
        if str(number) in DIGITS:
            draw.text((left, middle), str(number), MUTED, _letters(font, 32 * unit), anchor="lm")
        room = box[2] - left - 64 * unit
        fits = (px for px in SIZES_PX if px <= LARGEST_OPTION_PX and _letters(font, px * unit).getlength(said) <= room)
        letters = _letters(font, next(fits, SIZES_PX[-1]) * unit)
        draw.text((left + 48 * unit, middle), said, TEXT, letters, anchor="lm")


def _draw_paces(draw: ImageDraw, page: Page, centre: float, middle: float, unit: float, font: Path) -> None:
    letters = _letters(font, 28 * unit)
    pill_px = max(letters.getlength(said) for _, said, _ in page.paces) + 56 * unit
    gap = 24 * unit
    left = centre - (len(page.paces) * pill_px + (len(page.paces) - 1) * gap) / 2
    for pace, said, lit in page.paces:
        box = (left, middle - 32 * unit, left + pill_px, middle + 32 * unit)
        edge = LIT[pace] if lit else OUTLINE
        draw.rounded_rectangle(box, 32 * unit, LIT[pace] if lit else None, edge, max(1, round(2 * unit)))
        draw.text((left + pill_px / 2, middle), said, BACKGROUND if lit else MUTED, letters, anchor="mm")
        left += pill_px + gap


@lru_cache(maxsize=64)
def _letters(font: Path, size_px: float) -> FreeTypeFont:
    from PIL import ImageFont

    try:
        return ImageFont.truetype(str(font), size_px)
    except OSError as error:
        raise DisplayError(
            "screen.font", f"{font}: got {error}", "name another, or none", allowed="a font file (.ttf, .otf, .ttc)"
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
