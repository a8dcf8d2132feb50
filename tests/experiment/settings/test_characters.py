"""Which characters a text may hold, and that none of the others leaves raw."""

from __future__ import annotations

import sys
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment.settings.characters import JOINERS, free, hidden, naming, one_line, plain, quoted

CATEGORIES = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


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


@pytest.mark.parametrize("text", ["copy paper", "和紙　薄", "l’aluminium", "65 g/m²", "فیلم", "हिन्दी", "ß", "3 mm"])
def test_names_of_any_language_are_kept(text: str) -> None:
    assert naming(text) == one_line(text) == free(text) == text


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
    assert len(shown) <= 60 + len(" with U+10FFFF") * 5
    for one in hidden(text, "\n" + JOINERS)[:5]:
        assert f"U+{ord(one):04X}" in shown
