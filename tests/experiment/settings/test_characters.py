"""Which characters a text may hold, and that none of the others leaves raw."""

from __future__ import annotations

import sys
import unicodedata
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.settings.characters import (
    JOINERS,
    deceptive,
    free,
    hidden,
    keyed,
    leftward,
    looks,
    naming,
    one_line,
    plain,
    quoted,
    skeleton,
)

CATEGORIES = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")

MANY: tuple[str, ...] = (
    "µm",
    "kΩ",
    "Δt",
    "шум 3D",
    "LED-лампа",
    "Tシャツ",
    "PDFไฟล์น้ำ",
    "t检验",
    "πΕΡΙ",
    "Nº 1ª",
    "ʻokina",
    "पढ़ूँ",
    "ရွှေ့",
)
MANY += (unicodedata.normalize("NFD", "tiếng Việt ợ ặ"),)
DECEPTIVE = [
    ("p\u0430per", "\u0430"),
    ("\u0391luminum", "\u0391"),
    ("H2\u041e", "\u041e"),
    ("p\u0301\u0430\u0301per", "\u0430"),
    ("\uff50aper", "\uff50"),
    ("grade \uff13", "\uff13"),
    ("\U0001d429aper", "\U0001d429"),
    ("type \u2160", "\u2160"),
    ("300 \u212a", "\u212a"),
    ("paper\u0301\u0302\u0303", "\u0303"),
    ("paper 3\u0338", "\u0338"),
    ("paper \u0338", "\u0338"),
    ("पढ" + "\u093c" * 5, "\u093c"),
]


def test_every_character_of_unicode_is_judged_by_its_category_alone() -> None:
    everything = [chr(one) for one in range(sys.maxunicode + 1)]
    refused = set(hidden("".join(everything)))
    by_category = {one for one in everything if unicodedata.category(one) in CATEGORIES}
    assert by_category <= refused
    # Eight more that are drawn as nothing, though they count as letters, marks or signs.
    drawn_as_nothing = {"COMBINING GRAPHEME JOINER", "BRAILLE PATTERN BLANK", "KHMER VOWEL INHERENT AQ"}
    drawn_as_nothing |= {"KHMER VOWEL INHERENT AA", "HANGUL FILLER", "HALFWIDTH HANGUL FILLER"}
    drawn_as_nothing |= {"HANGUL CHOSEONG FILLER", "HANGUL JUNGSEONG FILLER"}
    assert {unicodedata.name(one) for one in refused - by_category} == drawn_as_nothing


@pytest.mark.parametrize("text", ["copy paper", "和紙　薄", "l’aluminium", "65 g/m²", "हिन्दी", "ß", "3 mm", *MANY])
def test_names_of_any_language_are_kept(text: str) -> None:
    assert naming(text) == one_line(text) == free(text) == text


@pytest.mark.parametrize(("text", "odd"), DECEPTIVE, ids=ascii)
@pytest.mark.parametrize("kind", [free, one_line, naming])
def test_what_is_taken_for_another_letter_is_refused(kind: Callable[[str], str], text: str, odd: str) -> None:
    assert deceptive(text) == (odd,)
    with pytest.raises(ValueError, match=rf"^contains U\+{ord(odd):04X}$"):
        kind(text)
    assert quoted(text).endswith(f"with U+{ord(odd):04X} ({unicodedata.name(odd)})")
    assert odd not in quoted(text)


def test_a_mark_at_the_start_stands_on_no_letter() -> None:
    assert deceptive("\u0301a\n\u0338b") == ("\u0301", "\u0338")


@given(st.text(st.characters(max_codepoint=0x24F)))
def test_a_text_of_latin_deceives_by_special_forms_alone(text: str) -> None:
    assert all(unicodedata.normalize("NFKC", one) != one for one in deceptive(text))


@pytest.mark.parametrize("text", ["فیلم", "נייר 3", "a١"])
def test_what_runs_from_right_to_left_is_for_texts_and_not_for_names(text: str) -> None:
    assert free(text) == one_line(text) == text
    with pytest.raises(ValueError, match=rf"U\+{ord(leftward(text)[0]):04X}"):
        naming(text)


@pytest.mark.parametrize(
    "name", ["copypaper", "Copy  Paper", "\u0441\u043e\u0440\u0443 \u0440aper", "\uff43opy paper", "COP\u03a5 PAPER"]
)
def test_names_that_look_the_same_share_a_skeleton(name: str) -> None:
    assert skeleton(name) == skeleton("copy paper") != skeleton("copy papers")


@pytest.mark.parametrize(
    "name", ["aIuminum foil", "a1uminum foiI", "A|UMINUM FO\u0406L", "aluminum f0il", "\u00e1luminum f\u00f6il"]
)
def test_names_that_are_taken_for_one_another_have_a_form_in_common(name: str) -> None:
    known = set(looks("aluminum foil"))
    assert known & set(looks(name))
    assert not known & {*looks("aluminum fol"), *looks("aiuminum foil"), *looks("aluminum fo\u3099il")}
    assert set(looks("A1")) & set(looks("Al")) & set(looks("AI"))


def test_what_was_typed_is_told_as_keys() -> None:
    assert keyed("c\n \x1b\u0301\u05d0\u00e9") == "c, Enter, Space, U+001B, U+0301, U+05D0, \u00e9"
    assert keyed("c" * 21) == f"{'c, ' * 20}..."


def test_joiners_are_for_free_text_alone() -> None:
    word = "می\u200cخواهم"
    assert free(f"{word}\n{word}") == f"{word}\n{word}"
    assert one_line(word) == word
    with pytest.raises(ValueError, match=r"U\+200C"):
        naming(word)
    with pytest.raises(ValueError, match=r"U\+000A"):
        one_line(f"{word}\n")


@pytest.mark.parametrize("text", ['a "b"', "a “b”", "a\ufe0f", "a\U000e0100"])
def test_a_name_can_be_quoted_and_told_from_others(text: str) -> None:
    assert free(text) == text
    with pytest.raises(ValueError, match=r"U\+"):
        naming(text)


@given(st.text(st.characters()))
def test_what_leaves_has_no_hidden_character(text: str) -> None:
    shown = plain(text)
    assert not hidden(shown, "\n\t" + JOINERS)
    for one in hidden(text, "\n\t" + JOINERS):
        assert f"<U+{ord(one):04X}>" in shown
    assert plain(shown) == shown


@given(st.text(st.characters()))
def test_a_message_has_one_line_and_names_what_is_refused(text: str) -> None:
    shown = quoted(text)
    assert not hidden(shown)
    assert len(shown) <= 60 + sum(len(f" with U+10FFFF ({unicodedata.name(one, '')})") for one in set(text))
    for one in hidden(text, "\n" + JOINERS)[:5]:
        assert f"U+{ord(one):04X}" in shown
