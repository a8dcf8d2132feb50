"""What the participant's screen looks like: from a prompt to a page, and from a page to a picture.

The background is always dark, no color is bright, and nothing moves or blinks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.display import ScreenKeys, ScreenRig, ScreenWords
from palpate.experiment.desk.messages import ENTER, Prompt
from palpate.experiment.desk.pages.lettering import (
    LEGIBLE_PX,
    SIZES_PX,
    TURNS_PX,
    Colour,
    Lines,
    fitted,
    parted,
    typeface,
)
from palpate.experiment.protocol.rules import HEARD_KEY, LOUDER_KEY, PROBE_KEY, SOFTER_KEY
from palpate.experiment.settings import characters

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

BACKGROUND: Colour = (34, 38, 42)
TEXT: Colour = (208, 203, 192)
MUTED: Colour = (150, 152, 150)
OUTLINE: Colour = (92, 98, 104)
CAP: Colour = (44, 50, 56)
LIT: dict[str, Colour] = {"slow": (128, 162, 200), "right": (132, 176, 136), "fast": (206, 164, 110)}
"""The pace of a step; its place and its words say it too."""

DESIGN_PX = (1280, 800)
"""Sizes are for a screen of this width and height, and grow and shrink with it."""

CAPS = {
    "up": "↑",
    "down": "↓",
    "left": "←",
    "right": "→",
    "return": "Enter",
    "space": "Space",
    "pageup": "PgUp",
    "pagedown": "PgDn",
}
"""What stands on a key, where that is not its name."""

OPTION_PX, LARGEST_OPTION_PX, MOST_ROWS = 72, 36, 6
"""The height of an option's row, the largest letters in it, and how many rows there are before another column."""

DIGITS = tuple("123456789")
"""Keys of the first options, by their places."""

HAND_MM, HAND_PX, BLOCK_PX = (-4.0, 20.0), 22, (360, 44)
"""How deep in the block and how high above it the hand is shown; its radius, and width and height of the block."""

NOW_SHARES = (0.6, 0.45, 0.3)
"""How much of the height the line that says what to do now may take, so that a text has room below it."""

_FACE_PX = 230
"""The block's face above the page's end, above the lamp; 1 mm is 9 pixels."""


@dataclass(frozen=True)
class Page:
    """One page: what to do now, a text beside it, a clock, keys with what they do, and the pace of the last step.

    Of a text that is too long, and of the `pictures` (PNG) after it, one `part` is shown, by its number from 0; `turns`
    are the keys that go back and on.
    `progress` is answered trials and all. `keys` pairs a key, or nothing, with a text. `options` are answers that can
    be chosen, each in a box (`boxes`).
    `paces` are words and whether each was the last, as for a lamp. With a `block` the hand moves above it (`hand_px`).
    """

    now: str
    text: str = ""
    pictures: tuple[bytes, ...] = ()
    part: int = 0
    clock: str = ""
    progress: tuple[int, int] | None = None
    keys: tuple[tuple[str, str], ...] = ()
    options: tuple[str, ...] = ()
    paces: tuple[tuple[str, str, bool], ...] = ()
    turns: tuple[str, str] = ("", "")
    label: str = ""
    block: bool = False

    @property
    def letters(self) -> frozenset[str]:
        """Every letter that is drawn."""
        digits = "0123456789/" if self.options or self.text or self.progress else ""
        keys = (*sum(self.keys, ()), *self.turns, *self.options, digits)
        said = (self.now, self.text, self.clock, self.label, *keys, *(words for _, words, _ in self.paces))
        return frozenset("".join(said)) - frozenset(" \n")


def page(prompt: Prompt | None, settings: ScreenRig, now_ns: int) -> Page:
    """Return the page of a prompt at a time of the system's clock, ns; without a prompt that of a lost session."""
    words, caps = settings.words or ScreenWords(), settings.keys or ScreenKeys()
    if prompt is None:
        return Page(words.gone)
    (now, text), clock = _words(prompt, words), ""
    if prompt.show == "break" and prompt.until_ns is not None:
        left_s = -((now_ns - prompt.until_ns) // 1_000_000_000)
        clock = f"{left_s // 60}:{left_s % 60:02}" if left_s > 0 else ""
        if not clock:
            now, text = words.pause_over, words.headphones_on if prompt.unmasked else ""
    paces = (("slow", words.slow), ("right", words.right), ("fast", words.fast)) if prompt.pace else ()
    lit = [(pace, said, pace == prompt.pace) for pace, said in paces]
    if prompt.lamp is not None:
        lit.append(("fast", words.fast, True) if prompt.lamp else ("right", words.right, False))
    answering = prompt.question is not None and prompt.show in ("answer", "compare")
    return Page(
        now=characters.plain(now),
        text=characters.plain(text),
        clock=clock,
        progress=prompt.progress,
        keys=tuple(_keys(prompt, settings)) if prompt.question is not None and not answering else (),
        options=prompt.answers if answering else (),
        turns=(_cap(caps.back), _cap(caps.forth)),
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


def turned(key: str, settings: ScreenRig) -> int:
    """Return how many parts of a long text a key of the participant goes on, or back."""
    keys = settings.keys or ScreenKeys()
    return (key == keys.forth) - (key == keys.back)


def _words(prompt: Prompt, words: ScreenWords) -> tuple[str, str]:
    """Return what to do now, and what is said beside it."""
    headphones = words.headphones if prompt.unmasked else ""
    match prompt.show:
        case "instructions":
            return "", prompt.text
        case "masker":
            now = words.masker if prompt.question is not None else words.set_for_you
            return now, words.tread if prompt.unplayed else ""
        case "rest":
            return words.rest, ""
        case "ready":
            return words.again if prompt.again else words.ready, prompt.text
        case "coming" if prompt.interval is not None:
            return words.interval.replace("{number}", str(prompt.interval)), ""
        case "coming":
            return words.coming, prompt.text
        case "answer" | "compare":
            return _asks(prompt, words)
        case "break":
            return words.pause, headphones
        case "finished":
            return words.finished, headphones
        case "thanks":
            return words.thanks, headphones
        case "wait":
            return words.wait, prompt.text


def _asks(prompt: Prompt, words: ScreenWords) -> tuple[str, str]:
    """Return what asks for the answer, and beside it the answers where they stand in no box."""
    answers = prompt.answers if prompt.mode != "screen" else ()
    if prompt.asks and prompt.show == "answer":
        how = {"oral": words.say, "keys": words.button, "screen": words.option if prompt.question is not None else ""}
        return prompt.asks, "\n".join(filter(None, (how[prompt.mode], *answers)))
    if prompt.mode == "oral":
        asks = words.compare if prompt.show == "compare" else words.answer
    else:
        asks = words.press if prompt.mode == "keys" else words.choose if prompt.question is not None else ""
        asks = f"{words.feel} {asks}".strip() if prompt.show == "compare" else asks
    if prompt.show == "answer":
        return asks, "\n".join(answers)
    there = "" if prompt.second is None else words.second if prompt.second else words.first
    return asks, "\n\n".join(filter(None, (there, prompt.asks, "  ·  ".join(answers), prompt.text)))


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


def drawn(page: Page, size_px: tuple[int, int], font: Path) -> tuple[Image, int]:
    """Return a page as a picture of `size_px`, width and height, with the letters of a font file; and how many parts
    text and pictures have.
    """
    from PIL import Image, ImageDraw

    width, height = size_px
    unit = min(width / DESIGN_PX[0], height / DESIGN_PX[1])
    picture = Image.new("RGB", size_px, BACKGROUND)
    draw = ImageDraw.Draw(picture)
    if page.label:
        draw.text((32 * unit, 24 * unit), page.label, MUTED, typeface(font, 24 * unit), anchor="la")
    bottom = height - 150 * unit if page.paces else height - 60 * unit
    if page.block:
        bottom = _draw_block(draw, size_px, unit)
    if page.paces:
        _draw_paces(draw, page, width / 2, height - 110 * unit, unit, font)
    if page.progress is not None:
        _draw_progress(draw, *page.progress, (width / 2, height - 36 * unit), unit, font)
    if page.options:
        placed = boxes(len(page.options), size_px)
        _draw_options(draw, page.options, placed, unit, font)
        bottom = min(bottom, placed[0][1] - 20 * unit)
    keys_px = _row_px(page, unit) * len(page.keys) + (30 * unit if page.keys else 0)
    clock_px = 190 * unit if page.clock else 0.0
    wide, room_px = min(1060 * unit, width - 80 * unit), bottom - 70 * unit - keys_px - clock_px
    gap_px = 30 * unit if page.now and page.text else 0.0
    illustrated_px = TURNS_PX * unit if page.pictures else 0.0
    now, parts = _laid_out(page, (wide, room_px - illustrated_px), gap_px, unit, font)
    count = len(parts) + len(page.pictures)
    at, turns_px = min(page.part, count - 1), TURNS_PX * unit if count > 1 else 0.0
    # Every part begins where the first does; a picture takes all the room that there is.
    tallest_px = max(part.height for part in parts)
    body_px = max(tallest_px, room_px - now.height - gap_px - turns_px) if page.pictures else tallest_px
    used_px = now.height + gap_px + body_px + turns_px + clock_px + keys_px
    top = now.draw(draw, width / 2, (70 * unit + bottom - used_px) / 2, TEXT, font) + gap_px
    if at < len(parts):
        parts[at].draw(draw, width / 2, top + (body_px - tallest_px) / 2, TEXT, font)
    else:
        _put(picture, page.pictures[at - len(parts)], (width / 2, top + body_px / 2), (wide, body_px))
    top += body_px
    if turns_px:
        said = f"{at + 1} / {count}"
        _draw_turns(draw, said, page.turns, (width / 2, top + turns_px / 2), unit, font)
    top += turns_px
    if page.clock:
        draw.text((width / 2, top + 110 * unit), page.clock, TEXT, typeface(font, 120 * unit), anchor="mm")
    _draw_keys(draw, page, width / 2, top + clock_px + 30 * unit, unit, font)
    return picture, count


def _put(page: Image, png: bytes, centre: tuple[float, float], room: tuple[float, float]) -> None:
    """Put a picture on a page around a centre, as large as fits in `room`, width and height, pixels."""
    from PIL import Image

    with Image.open(BytesIO(png)) as opened:
        picture = opened.convert("RGBA")
    scale = min(room[0] / picture.width, room[1] / picture.height)
    size_px = max(1, round(picture.width * scale)), max(1, round(picture.height * scale))
    shown = picture.resize(size_px, Image.Resampling.LANCZOS)
    page.paste(shown, (round(centre[0] - size_px[0] / 2), round(centre[1] - size_px[1] / 2)), shown)


def _laid_out(
    page: Page, room: tuple[float, float], gap_px: float, unit: float, font: Path
) -> tuple[Lines, list[Lines]]:
    """Return what to do now, and the parts of the text beside it, so that both fit in `room`, pixels."""
    for share in NOW_SHARES if page.text else (1.0,):
        now = fitted(page.now, (room[0], share * room[1]), unit, font)
        rest = room[0], room[1] - now.height - gap_px
        parts = parted(page.text, rest, unit, font, 0.75 * now.size_px if page.now else inf)
        if len(parts) == 1 and parts[0].size_px >= LEGIBLE_PX * unit:
            break
    return now, parts


def _row_px(page: Page, unit: float) -> float:
    """Return the height of a key's row: many stand closer."""
    return (84 if len(page.keys) < 4 else 72) * unit


def _draw_keys(draw: ImageDraw, page: Page, centre: float, top: float, unit: float, font: Path) -> None:
    if not page.keys:
        return
    letters = typeface(font, 32 * unit)
    cap_px = max(64 * unit, *(letters.getlength(cap) + 36 * unit for cap, _ in page.keys))
    said_px = max(letters.getlength(said) for _, said in page.keys)
    left = centre - (cap_px + 28 * unit + said_px) / 2
    for row, (cap, said) in enumerate(page.keys):
        middle = top + _row_px(page, unit) * (row + 0.5)
        if cap:
            box = (left, middle - 32 * unit, left + cap_px, middle + 32 * unit)
            draw.rounded_rectangle(box, 10 * unit, CAP, OUTLINE, max(1, round(2 * unit)))
            draw.text((left + cap_px / 2, middle), cap, TEXT, letters, anchor="mm")
        draw.text((left + cap_px + 28 * unit, middle), said, TEXT if cap else MUTED, letters, anchor="lm")


def _draw_block(draw: ImageDraw, size_px: tuple[int, int], unit: float) -> float:
    """Draw the block, and return where the room of the hand above it begins."""
    wide, high, face = BLOCK_PX[0] * unit / 2, BLOCK_PX[1] * unit, size_px[1] - _FACE_PX * unit
    middle = size_px[0] / 2
    draw.rectangle((middle - wide, face, middle + wide, face + high), CAP, OUTLINE, max(1, round(2 * unit)))
    return face - (9 * HAND_MM[1] + 2 * HAND_PX + 10) * unit


def _draw_turns(
    draw: ImageDraw, said: str, caps: tuple[str, str], centre: tuple[float, float], unit: float, font: Path
) -> None:
    """Draw which part of a text is shown, between the keys that go back and on."""
    letters = typeface(font, 28 * unit)
    apart = letters.getlength(said) / 2 + 24 * unit
    draw.text(centre, said, TEXT, letters, anchor="mm")
    for side, cap in zip((-1, 1), caps, strict=True):
        wide = max(56 * unit, letters.getlength(cap) + 32 * unit)
        middle = centre[0] + side * (apart + wide / 2)
        box = (middle - wide / 2, centre[1] - 28 * unit, middle + wide / 2, centre[1] + 28 * unit)
        draw.rounded_rectangle(box, 10 * unit, CAP, OUTLINE, max(1, round(2 * unit)))
        draw.text((middle, centre[1]), cap, TEXT, letters, anchor="mm")


def _draw_progress(
    draw: ImageDraw, answered: int, trials: int, centre: tuple[float, float], unit: float, font: Path
) -> None:
    """Draw how many trials are answered, as a bar and in digits."""
    left, right = centre[0] - 200 * unit, centre[0] + 200 * unit
    upper, lower = centre[1] - 4 * unit, centre[1] + 4 * unit
    draw.rectangle((left, upper, right, lower), OUTLINE)
    draw.rectangle((left, upper, left + (right - left) * answered / max(trials, 1), lower), MUTED)
    said = f"{answered} / {trials}"
    draw.text((right + 20 * unit, centre[1]), said, MUTED, typeface(font, 24 * unit), anchor="lm")


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
            draw.text((left, middle), str(number), MUTED, typeface(font, 32 * unit), anchor="lm")
        room = box[2] - left - 64 * unit
        fits = (px for px in SIZES_PX if px <= LARGEST_OPTION_PX and typeface(font, px * unit).getlength(said) <= room)
        letters = typeface(font, next(fits, SIZES_PX[-1]) * unit)
        draw.text((left + 48 * unit, middle), said, TEXT, letters, anchor="lm")


def _draw_paces(draw: ImageDraw, page: Page, centre: float, middle: float, unit: float, font: Path) -> None:
    letters = typeface(font, 28 * unit)
    pill_px = max(letters.getlength(said) for _, said, _ in page.paces) + 56 * unit
    gap = 24 * unit
    left = centre - (len(page.paces) * pill_px + (len(page.paces) - 1) * gap) / 2
    for pace, said, lit in page.paces:
        box = (left, middle - 32 * unit, left + pill_px, middle + 32 * unit)
        edge = LIT[pace] if lit else OUTLINE
        draw.rounded_rectangle(box, 32 * unit, LIT[pace] if lit else None, edge, max(1, round(2 * unit)))
        draw.text((left + pill_px / 2, middle), said, BACKGROUND if lit else MUTED, letters, anchor="mm")
        left += pill_px + gap
