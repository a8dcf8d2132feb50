"""Which characters a text may hold that a person will read, and how a text that holds others is shown.

Refused are characters with which a text can rewrite its surroundings: control, bidirectional, invisible, private,
surrogate and unassigned ones. Free text may hold newlines where a field says so, and the two joiners, which Persian and
Hindi need; names may not.

Refused too are look-alikes (a second alphabet inside a word, full-width forms), marks that pile up or have no letter,
and, in names, letters that run from right to left, since those reorder numbers beside them.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import groupby

JOINERS = "\u200c\u200d"
"""Zero-width non-joiner and joiner."""

BLANKS = "\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0"
"""Letters and signs that are drawn as nothing."""

QUOTES = '"\u201c\u201d\u201e\u201f\uff02'
"""Double quotes, between which names stand where palpate shows them."""

SYMBOLS = "ΓΔΘΛΞΠΣΦΨΩβδεζηθκλμξπστφχψω"
"""Letters of Greek that look like none of Latin and stand for quantities and units: in words of any alphabet."""

UNSPACED = ("CJK", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO", "THAI", "LAO", "KHMER", "MYANMAR", "TIBETAN")
"""Scripts that put no blank between their words and those of another, and look like none."""

LOOK_ALIKES = str.maketrans(
    "АВСЕНІЈКМОРЅТУХаеіјорсухѕһԁԛԝΑΒΕΖΗΙΚΜΝΟΡΤΥΧανορυιγɑɡı‐‑‒–—−‘’ʼ",
    "ABCEHIJKMOPSTYXaeijopcyxshdqwABEZHIKMNOPTYXavopuiyagi------'''",
)
"""What looks like a letter of Latin, a hyphen or an apostrophe, after the confusables of Unicode (UTS 39)."""

MOST_MARKS, MOST_OWN_MARKS = 2, 4
"""On one letter: of the marks of all scripts (ours: Vietnamese has two), and with those of its own script (UTS 39)."""


def hidden(text: str, but: str = "") -> tuple[str, ...]:
    """Return each character of a text that is refused, once, except those in `but`."""
    if text.isascii() and text.isprintable():
        return ()
    others = [one for one in dict.fromkeys(text) if one not in but]
    return tuple(one for one in others if one in BLANKS or not (one.isprintable() or unicodedata.category(one) == "Zs"))


def deceptive(text: str) -> tuple[str, ...]:
    """Return each character, once, that is taken for another, or that sits on what it does not belong to."""
    odd: dict[str, None] = {}
    for run in dict.fromkeys(text.split()):
        if not run.isascii():
            odd |= dict.fromkeys((*filter(_is_special_form, run), *_stray_marks(run), *_of_second_alphabet(run)))
    return tuple(odd)


def leftward(text: str) -> tuple[str, ...]:
    """Return each letter and digit of a text, once, that runs from right to left."""
    return tuple(one for one in dict.fromkeys(text) if unicodedata.bidirectional(one) in ("R", "AL", "AN"))


def skeleton(name: str) -> str:
    """Return what two names share that look the same but for case and blanks."""
    return "".join(unicodedata.normalize("NFKC", name).translate(LOOK_ALIKES).casefold().split())


def looks(name: str) -> tuple[str, str]:
    """Return two forms of a name; names look alike if any forms of the two are equal.

    Both are as `skeleton`, without accents, and with 0 as O and 1 and | as l; the second has capital I as l too.
    """
    bare = re.sub("[\u0300-\u036f]", "", unicodedata.normalize("NFD", name)).translate(LOOK_ALIKES)
    printed = bare.translate(str.maketrans("01|", "oll"))
    return skeleton(printed), skeleton(printed.replace("I", "l"))


def free(text: str) -> str:
    """Return a text of one line or several. Raises `ValueError` if it holds a refused character."""
    return _refuse_characters(text, (*hidden(text, but="\n" + JOINERS), *deceptive(text)))


def one_line(text: str) -> str:
    """Return a text of one line. Raises `ValueError` if it holds a newline or a refused character."""
    return _refuse_characters(text, (*hidden(text, but=JOINERS), *deceptive(text)))


def naming(text: str) -> str:
    """Return a name. Raises `ValueError` if it holds what cannot be seen, a double quote, or what runs to the left."""
    odd = (one for one in text if one in QUOTES or _is_selector(one))
    return _refuse_characters(text, (*hidden(text), *deceptive(text), *leftward(text), *odd))


def plain(text: str, keep: str = "\n\t") -> str:
    """Return a text as it leaves for a screen: refused characters as <U+001B>, except joiners and those in `keep`."""
    return text.translate({ord(one): f"<{code(one)}>" for one in hidden(text, but=keep + JOINERS)})


def quoted(text: str, most: int = 60) -> str:
    """Return a text quoted on one line, at most `most` characters, with refused characters named."""
    seen = (*deceptive(text), *leftward(text))
    odd = (*hidden(text, but="\n" + JOINERS), *seen) or hidden(text)
    escaped = text.translate({ord(one): f"<{code(one)}>" for one in odd if not one.isspace()})
    shown = " ".join(f"'{escaped}'".split())
    shown = shown if len(shown) <= most else f"{shown[: most - 3]}..."
    named = (f"{code(one)} ({unicodedata.name(one)})" if one in seen else code(one) for one in odd[:5])
    return f"{shown} with {', '.join(named)}" if odd else shown


def keyed(text: str, most: int = 20) -> str:
    """Return what was typed as the keys that were pressed, such as `c, Enter`: the first `most` of them."""
    named = {"\n": "Enter", "\r": "Enter", " ": "Space"}
    keys = [named.get(one) or (code(one) if (*hidden(one), *deceptive(one), *leftward(one)) else one) for one in text]
    return ", ".join(keys[:most] + ["..."] * (len(keys) > most))


def code(character: str) -> str:
    """Return the code of a character: `U+202E`."""
    return f"U+{ord(character):04X}"


def _is_selector(character: str) -> bool:
    return unicodedata.name(character, "").startswith("VARIATION SELECTOR")


def _is_special_form(character: str) -> bool:
    """Return whether a letter or digit is another form of one of ASCII; raised and lowered ones are seen to be."""
    if character.isascii() or unicodedata.category(character) not in ("Lu", "Ll", "Lt", "Lo", "Nd", "Nl"):
        return False
    raised = unicodedata.decomposition(character).startswith(("<super>", "<sub>"))
    return not raised and any(one.isascii() for one in unicodedata.normalize("NFKC", character))


def _stray_marks(text: str) -> Iterator[str]:
    """Yield marks that stand on no letter, and those beyond `MOST_MARKS`."""
    on_letter, marks = False, 0
    for one in text:
        if unicodedata.category(one)[0] != "M":
            if one not in JOINERS:
                on_letter, marks = unicodedata.category(one)[0] == "L", 0
        elif not _is_selector(one):
            marks += 1 if unicodedata.category(one) != "Mc" else 0
            most = MOST_MARKS if unicodedata.name(one, "").startswith("COMBINING") else MOST_OWN_MARKS
            if not on_letter or marks > most:
                yield one


def _of_second_alphabet(text: str) -> Iterator[str]:
    """Yield the letters of each word that are not of the alphabet of most of its letters."""
    for is_word, word in groupby(text, lambda one: one in JOINERS or unicodedata.category(one)[0] in "LMN"):
        letters = [(alphabet, one) for one in word if (alphabet := _alphabet(one))] if is_word else []
        counts = Counter(alphabet for alphabet, _ in letters)
        own = max(counts, key=lambda alphabet: (counts[alphabet], alphabet == "LATIN"), default="")
        yield from (one for alphabet, one in letters if alphabet != own)


@cache
def _alphabet(character: str) -> str:
    """Return the first word of a letter's name, such as LATIN; nothing for what stands in words of any alphabet."""
    base = unicodedata.normalize("NFKC", character)[0]
    if unicodedata.category(base) not in ("Lu", "Ll", "Lt", "Lo") or base in SYMBOLS:
        return ""
    alphabet = unicodedata.name(base, "").split(" ")[0]
    return "" if alphabet in UNSPACED else alphabet


def _refuse_characters(text: str, refused: tuple[str, ...]) -> str:
    if refused:
        raise ValueError(f"contains {', '.join(map(code, refused))}")
    return text
