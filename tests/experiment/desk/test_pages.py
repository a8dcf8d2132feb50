"""Pages of the participant's screen: what stands on them, how lines break, and that nothing of them startles."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from palpate.experiment.apparatus.display import ScreenKeys, ScreenRig, ScreenWords
from palpate.experiment.desk import pages, prompts
from palpate.experiment.desk.link.wire import Asked, View
from palpate.experiment.desk.messages import ENTER, Prompt, Show
from palpate.experiment.desk.pages import BACKGROUND, CAP, LIT, MUTED, OUTLINE, TEXT, Page, lettering
from palpate.experiment.desk.pages.lettering import Colour
from palpate.experiment.desk.questions import Play
from palpate.experiment.errors import DisplayError
from palpate.experiment.protocol.rules import HEARD_KEY
from tests.approved import Refuses

FONT = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
RIG = ScreenRig()
SIZE_PX = (1280, 800)
GERMAN = "Treten Sie, so oft Sie möchten, auf die Zylinder: Größe und Geschwindigkeitsänderung gehören Ihnen."
JAPANESE = (
    "四種類の円筒（コピー用紙、アルミホイル）を、何度でも自由に踏んでください。「準備」ができたら声をかけてください。"
)


def wide(text: str) -> float:
    """Return a width as of a Japanese font: one for each letter, a half for each of ASCII."""
    return sum(0.5 if letter.isascii() else 1.0 for letter in text)


def drawn(page: Page) -> NDArray[np.uint8]:
    return np.asarray(pages.drawn(page, SIZE_PX, FONT)[0])


SHOWN: dict[str, tuple[Prompt | None, str]] = {
    "wait": (Prompt(), "Please wait."),
    "instructions": (Prompt(show="instructions", text="Crinkle the foil."), "Crinkle the foil."),
    "wait before the first trial": (
        Prompt(show="wait", text="Step, and say what."),
        "Please wait.\n\nStep, and say what.",
    ),
    "rest": (Prompt(show="rest"), "Rest your foot on the panel and keep still."),
    "ready": (Prompt(show="ready"), "You may step now."),
    "another trial": (Prompt(show="coming", text="Say when."), "Focus on what you feel.\n\nSay when."),
    "an interval": (Prompt(show="coming", interval=2), "Interval 2"),
    "asked by a design": (
        Prompt(show="answer", asks="Did you feel anything?", answers=("yes", "no")),
        "Did you feel anything?\n\nSay your answer aloud.\nyes\nno",
    ),
    "asked by a design, with buttons": (
        Prompt(show="answer", asks="Which?", mode="keys"),
        "Which?\n\nPress the button for your answer.",
    ),
    "asked by a design, at the screen": (
        Prompt(show="answer", asks="Which?", mode="screen", answers=("yes", "no"), question=1, keys=("y", "n")),
        "Which?\n\nChoose your answer.",
    ),
    "ready for the first trial": (
        Prompt(show="ready", text="Step, and say what."),
        "You may step now.\n\nStep, and say what.",
    ),
    "ready once more": (
        Prompt(show="ready", again=True),
        "That step did not count. Lift your foot, then step again.",
    ),
    "masker without a probe": (
        Prompt(show="masker", unplayed=True),
        "Say when you can no longer hear the panel.\n\n"
        "The panel does not vibrate by itself. Touch it as you will in the trials, and listen.",
    ),
    "answer": (Prompt(show="answer"), "Say aloud what you felt."),
    "compare": (
        Prompt(show="compare", answers=("first", "second")),
        "Feel both as often as you like. Then say your answer aloud.\n\nfirst  ·  second",
    ),
    "second surface": (
        Prompt(show="compare", text="Tap.", second=True),
        "Feel both as often as you like. Then say your answer aloud.\n\n"
        "This is the second one. Say when you want the first.\n\nTap.",
    ),
    "first surface": (
        Prompt(show="compare", second=False),
        "Feel both as often as you like. Then say your answer aloud.\n\n"
        "This is the first one. Say when you want the second.",
    ),
    "finished": (
        Prompt(show="finished"),
        "You have finished this part. Please wait for the experimenter.",
    ),
    "finished, and silent": (
        Prompt(show="finished", unmasked=True),
        "You have finished this part. Please wait for the experimenter.\n\nYou may take off the headphones.",
    ),
    "break, and silent": (Prompt(show="break", unmasked=True), "Time for a break.\n\nYou may take off the headphones."),
    "break over": (
        Prompt(show="break", unmasked=True, until_ns=0),
        "The break is over. We will continue when you are ready.\n\nPlease put the headphones back on.",
    ),
    "thanks": (Prompt(show="thanks"), "This session is over. Thank you."),
    "no session": (None, "Please wait. The experimenter will be with you shortly."),
}


@pytest.mark.parametrize(("prompt", "text"), SHOWN.values(), ids=SHOWN)
def test_a_prompt_has_its_words(prompt: Prompt | None, text: str) -> None:
    page = pages.page(prompt, RIG, 0)
    assert f"{page.now}\n\n{page.text}".strip() == text


def test_words_may_be_of_another_language() -> None:
    words = ScreenWords(ready="踏んでください。", right="ちょうどよい")
    page = pages.page(Prompt(show="ready", pace="right"), ScreenRig(words=words), 0)
    assert (page.now, page.paces[1]) == ("踏んでください。", ("right", "ちょうどよい", True))


def test_the_masker_has_three_keys_with_what_they_do() -> None:
    asked = Prompt(show="masker", question=3, keys=("+", "-", ENTER))
    keys = (("↑", "louder"), ("↓", "softer"), ("Enter", "I can no longer hear it"))
    assert pages.page(asked, RIG, 0).keys == keys
    at_limit = asked.model_copy(update={"keys": (HEARD_KEY, "-", ENTER)})
    loudest = (("", "This is the loudest setting."), ("↑", "I still hear it"), *keys[1:])
    assert pages.page(at_limit, RIG, 0).keys == loudest
    assert [pages.chosen(one, "up", RIG) for one in (asked, at_limit)] == ["+", HEARD_KEY]
    assert pages.page(Prompt(show="masker"), RIG, 0).keys == ()


def test_whoever_sets_a_trial_off_reads_that_enter_begins_it() -> None:
    asked = Play(1, "participant")
    view = View(state="armed", question=Asked(number=3, kind=asked.kind, text=asked.text, choices=asked.choices))
    page = pages.page(prompts.prompt(view, {}), RIG, 0)
    assert page.keys == (("Enter", "I am ready"),)
    assert drawn(page).tobytes() != drawn(replace(page, keys=())).tobytes()


@pytest.mark.parametrize(
    ("key", "choice"), [("up", "+"), ("down", "-"), ("space", ENTER), ("return", None), ("a", None), ("q", None)]
)
def test_a_key_chooses_what_stands_beside_it(key: str, choice: str | None) -> None:
    settings = ScreenRig(keys=ScreenKeys(done="space"))
    asked = Prompt(show="masker", question=3, keys=("+", "-", ENTER))
    assert pages.chosen(asked, key, settings) == choice
    assert pages.chosen(asked.model_copy(update={"keys": ()}), key, settings) is None
    assert pages.chosen(asked.model_copy(update={"question": None}), key, settings) is None
    assert pages.chosen(None, key, settings) is None


@pytest.mark.parametrize(
    ("left_s", "text", "clock"),
    [
        (300.0, "Time for a break.", "5:00"),
        (299.001, "Time for a break.", "5:00"),
        (61.0, "Time for a break.", "1:01"),
        (0.5, "Time for a break.", "0:01"),
        (0.0, "The break is over. We will continue when you are ready.", ""),
        (-90.0, "The break is over. We will continue when you are ready.", ""),
    ],
)
def test_a_break_counts_down(left_s: float, text: str, clock: str) -> None:
    now_ns = 1_800_000_000_000_000_000
    page = pages.page(Prompt(show="break", until_ns=now_ns + int(left_s * 1e9)), RIG, now_ns)
    assert (page.now, page.clock) == (text, clock)


def test_a_break_without_an_end_has_no_clock() -> None:
    assert pages.page(Prompt(show="break"), RIG, 0).clock == ""


@given(
    text=st.text("ab äß\n漢字、。「」-", max_size=80),
    width=st.floats(1.0, 30.0),
)
def test_lines_lose_no_letter_and_are_no_wider(text: str, width: float) -> None:
    lines = lettering.wrapped(text, width, wide)
    assert "".join("".join(lines).split()) == "".join(text.split())
    assert all(wide(line) <= width or len(line) == 1 for line in lines)


@given(words=st.lists(st.text("abcäöü", min_size=1, max_size=9), min_size=1, max_size=20))
def test_words_that_fit_stay_whole(words: list[str]) -> None:
    assert " ".join(lettering.wrapped(" ".join(words), 9.0, wide)).split() == words


@pytest.mark.parametrize("width", [6.0, 8.0, 11.0, 20.0])
def test_japanese_breaks_between_letters_but_before_no_full_stop(width: float) -> None:
    lines = lettering.wrapped(JAPANESE, width, wide)
    assert len(lines) > 2
    assert not [line for line in lines if line[0] in "、。）」ーっ"]
    assert not [line for line in lines if line[-1] in "（「"]


def test_a_word_longer_than_a_line_is_broken() -> None:
    assert lettering.wrapped("Geschwindigkeit", 3.0, wide) == ["Geschw", "indigk", "eit"]


@pytest.mark.parametrize("page", [pages.page(prompt, RIG, 0) for prompt, _ in SHOWN.values()], ids=SHOWN)
def test_a_picture_is_dark_with_its_text_inside(page: Page) -> None:
    picture = drawn(page)
    edge = [picture[0], picture[-1], picture[:, 0], picture[:, -1]]
    assert all((part == BACKGROUND).all() for part in edge)
    assert 0.002 < (picture != BACKGROUND).any(axis=2).mean() < 0.2
    assert picture.max() < 220
    assert picture.mean() < 60


def test_pictures_differ_by_prompt_and_by_pace() -> None:
    prompts = [prompt for prompt, _ in SHOWN.values()]
    prompts += [Prompt.model_validate({"show": "ready", "pace": pace}) for pace in LIT]
    prompts += [Prompt(show="masker", question=1, keys=keys) for keys in (("+", "-", ENTER), ("-", ENTER))]
    pictures = [drawn(pages.page(prompt, RIG, 0)).tobytes() for prompt in prompts]
    assert len(set(pictures)) == len(pictures)


def test_the_pace_moves_no_text() -> None:
    """What the participant reads while stepping stays where it is, whatever the step before was like."""
    slow, fast = (
        drawn(pages.page(Prompt.model_validate({"show": "ready", "pace": pace}), RIG, 0)) for pace in ("slow", "fast")
    )
    assert (slow[:600] == fast[:600]).all()
    assert (slow[600:] != fast[600:]).any()


@pytest.mark.parametrize("show", ["instructions", "ready", "answer"])
def test_a_lamp_is_lit_or_dark_in_the_same_place(show: Show) -> None:
    dark, lit = (drawn(pages.page(Prompt(show=show, text="Tap.", lamp=lamp), RIG, 0)) for lamp in (False, True))
    assert (dark[:600] == lit[:600]).all()
    colours = {tuple(pixel) for pixel in lit[600:].reshape(-1, 3).tolist()}
    assert LIT["fast"] in colours
    # Words that reproach nobody stand on a dark one.
    assert [said for _, said, _ in pages.page(Prompt(show=show, lamp=False), RIG, 0).paces] == ["good speed"]
    assert LIT["fast"] not in {tuple(pixel) for pixel in dark[600:].reshape(-1, 3).tolist()}


def test_the_hand_moves_above_a_block_that_stays() -> None:
    shown = [pages.page(Prompt(show="instructions", text="Tap.", hand_mm=mm), RIG, 0) for mm in (0.0, 8.0)]
    assert shown[0] == shown[1]
    assert shown[0].block
    size_px = pages.DESIGN_PX
    picture = drawn(shown[0])
    (resting, radius), (above, _) = (pages.hand_px(mm, size_px) for mm in (0.0, 8.0))
    face = round(size_px[1] / 2 - (resting - radius))
    assert tuple(picture[face + 10, size_px[0] // 2]) == CAP
    assert tuple(picture[face - 10, size_px[0] // 2]) == BACKGROUND
    assert above > resting
    # A hand far away, or deep in the block, stays on the page, and below the text.
    assert pages.hand_px(1e9, size_px)[0] == pages.hand_px(20.0, size_px)[0]
    text = np.flatnonzero((picture[: face - 5] != BACKGROUND).any(axis=(1, 2)))
    assert text[-1] < size_px[1] / 2 - (pages.hand_px(1e9, size_px)[0] + radius)


def luminance(colour: Colour) -> float:
    """Return the relative luminance of WCAG 2.1, of 1."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (part / 255 for part in colour)]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


@pytest.mark.parametrize(
    ("ink", "paper", "least"),
    [
        (TEXT, BACKGROUND, 7.0),
        (TEXT, CAP, 7.0),
        (MUTED, BACKGROUND, 4.5),
        *((BACKGROUND, one, 4.5) for one in LIT.values()),
    ],
)
def test_text_stands_out_as_web_pages_must(ink: Colour, paper: Colour, least: float) -> None:
    """WCAG 2.1: 7 to 1 for text (AAA), 4.5 to 1 for what is beside it (AA)."""
    lighter, darker = sorted((luminance(ink), luminance(paper)), reverse=True)
    assert (lighter + 0.05) / (darker + 0.05) >= least


SIZES_PX = [(1280, 800), (1920, 1080), (1024, 768), (640, 1000)]


def inside(picture: NDArray[np.uint8]) -> bool:
    edges = (picture[:8], picture[-8:], picture[:, :8], picture[:, -8:])
    return all((part == BACKGROUND).all() for part in edges)


@pytest.mark.parametrize("text", ["Wait.", GERMAN * 6, "lang " * 250, "W" * 120])
@pytest.mark.parametrize("size_px", SIZES_PX)
def test_a_long_text_stays_on_the_screen(text: str, size_px: tuple[int, int]) -> None:
    keys = (("↑", "louder"), ("↓", "softer"))
    for page in (Page(text, clock="9:59", keys=keys, label="PRACTICE"), Page("Wait.", text, progress=(7, 40))):
        assert inside(np.asarray(pages.drawn(page, size_px, FONT)[0]))


@pytest.mark.parametrize("size_px", SIZES_PX)
@pytest.mark.parametrize("room", [(1000.0, 300.0), (900.0, 90.0), (900.0, 1.0)])
def test_of_a_text_in_parts_no_word_is_lost(size_px: tuple[int, int], room: tuple[float, float]) -> None:
    text = " ".join(f"{GERMAN} {number}." for number in range(30))
    parts = lettering.parted(text, room, size_px[0] / 1280, FONT, np.inf)
    assert len(parts) > 1
    assert " ".join(" ".join(part.lines) for part in parts).split() == text.split()


@pytest.mark.parametrize("prompt", [Prompt(text=GERMAN * 12), Prompt(show="instructions", text=GERMAN * 12)])
def test_each_part_of_a_text_is_another_picture_with_its_keys_where_they_were(prompt: Prompt) -> None:
    page = pages.page(prompt, RIG, 0)
    assert page.turns == ("PgUp", "PgDn")
    _, count = pages.drawn(page, SIZE_PX, FONT)
    first, second, last, beyond = (drawn(replace(page, part=part)) for part in (0, 1, count - 1, 99))
    keys = [(picture == OUTLINE).all(axis=2) for picture in (first, second, last)]
    assert keys[0].any()
    assert (keys[0] == keys[1]).all()
    assert (keys[0] == keys[2]).all()
    assert (first != second).any()
    assert last.tobytes() == beyond.tobytes()


@pytest.mark.parametrize("size_px", SIZES_PX)
@pytest.mark.parametrize("side_px", [(40, 40), (3000, 100), (100, 3000)])
def test_a_picture_follows_the_text_whole_and_above_its_keys(
    size_px: tuple[int, int], side_px: tuple[int, int]
) -> None:
    red, made = (200, 20, 20), BytesIO()
    Image.new("RGB", side_px, red).save(made, "PNG")
    page = replace(pages.page(Prompt(show="ready", text=GERMAN), RIG, 0), pictures=(made.getvalue(),))
    _, count = pages.drawn(page, size_px, FONT)
    first, last = (np.asarray(pages.drawn(replace(page, part=n), size_px, FONT)[0]) for n in (0, count - 1))
    assert count >= 2
    assert not (first == red).all(axis=2).any()
    rows, columns = np.nonzero((last == red).all(axis=2))
    high, wide_px = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert wide_px / high == pytest.approx(side_px[0] / side_px[1], rel=0.2)
    keys = [(one == OUTLINE).all(axis=2) for one in (first, last)]
    assert (keys[0] == keys[1]).all()
    assert rows.max() < np.flatnonzero(keys[1].any(axis=1)).min()


def test_progress_moves_no_text_and_is_drawn_below_it() -> None:
    page = pages.page(Prompt(show="ready", progress=(3, 40)), RIG, 0)
    none, some, more = (drawn(replace(page, progress=done)) for done in (None, (3, 40), (30, 40)))
    assert (none[:740] == some[:740]).all()
    lit = [int((one[760:770] == MUTED).all(axis=2).any(axis=0)[440:840].sum()) for one in (none, some, more)]
    assert lit == [0, 31, 301]


def test_short_texts_are_large() -> None:
    """A capital of You may step now. is at least 5 % of the height: read from four metres on a screen of 30 cm."""
    rows = np.flatnonzero((drawn(pages.page(Prompt(show="ready"), RIG, 0)) != BACKGROUND).any(axis=(1, 2)))
    assert rows[-1] - rows[0] >= 0.05 * SIZE_PX[1]


def test_no_word_is_left_alone() -> None:
    text = (
        "Crinkle the four kinds of real cylinders on the panel, as often as you like, until you feel familiar with "
        "them."
    )
    picture = drawn(pages.page(Prompt(show="instructions", text=text), RIG, 0))
    columns = [np.flatnonzero((row != BACKGROUND).any(axis=1)) for row in picture]
    widths = [column[-1] - column[0] for column in columns if column.size]
    gaps = [i for i, (one, other) in enumerate(pairwise(columns)) if not one.size and other.size]
    assert len(gaps) > 1
    assert min(sorted(widths)[-20:]) > 600


def test_german_has_its_letters_in_the_font_that_is_always_there() -> None:
    page = Page(GERMAN)
    assert lettering.font_for(page.letters, None) == (FONT, "")


def test_japanese_finds_a_font_of_the_machine() -> None:
    font, missing = lettering.font_for(Page(JAPANESE).letters, None)
    if missing:
        pytest.skip("needs a font with Japanese letters (package fonts-ipafont-gothic)")
    assert font != FONT
    boxes = np.asarray(pages.drawn(Page("一一一一"), SIZE_PX, font)[0])
    letters = np.asarray(pages.drawn(Page("踏準備声"), SIZE_PX, font)[0])
    assert (letters != BACKGROUND).sum() > 2 * (boxes != BACKGROUND).sum() > 0


def test_letters_that_no_font_has_are_told() -> None:
    nowhere = "\ue000"
    font, missing = lettering.font_for(frozenset("a" + nowhere), None)
    assert (font, missing) == (FONT, nowhere)


def test_a_font_that_is_none_is_refused_in_words(tmp_path: Path, refuses: Refuses) -> None:
    broken = tmp_path / "broken.ttf"
    broken.write_bytes(b"no font")
    assert lettering.font_for(frozenset("ab"), broken) == (broken, "ab")
    with refuses(DisplayError):
        pages.drawn(Page("ab"), SIZE_PX, broken)


def test_controls_in_an_instruction_are_shown_as_what_they_are() -> None:
    assert pages.page(Prompt(show="instructions", text="a\u202eb"), RIG, 0).text == "a<U+202E>b"
