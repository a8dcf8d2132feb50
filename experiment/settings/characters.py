"""Which characters a text may hold that a person will read, and how a text that holds others is shown.

Refused are control characters, those that change the direction of a line (bidirectional), those that cannot be seen,
and those that have no meaning of their own (private use, surrogates, unassigned): with them a text can rewrite what
stands around it. Free text may hold newlines where a field says so, and the two joiners, without which Persian and
Hindi cannot be spelt; names may not, because two names must not differ by what nobody sees.
"""

from __future__ import annotations

import unicodedata

JOINERS = "\u200c\u200d"
"""Zero-width non-joiner and joiner."""

BLANKS = "\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0"
"""Letters and signs that are drawn as nothing."""

QUOTES = '"\u201c\u201d\u201e\u201f\uff02'
"""Double quotes, between which names stand where palpate shows them."""


def hidden(text: str, but: str = "") -> tuple[str, ...]:
    """Return each character of a text that is refused, once, except those in `but`."""
    return tuple(one for one in dict.fromkeys(text) if one not in but and _is_hidden(one))


def free(text: str) -> str:
    """Return a text of one line or several. Raises `ValueError` if it holds a refused character."""
    return _without(text, hidden(text, but="\n" + JOINERS))


def one_line(text: str) -> str:
    """Return a text of one line. Raises `ValueError` if it holds a newline or a refused character."""
    return _without(text, hidden(text, but=JOINERS))


def naming(text: str) -> str:
    """Return a name. Raises `ValueError` if it holds what cannot be seen, or a double quote."""
    selectors = tuple(one for one in text if unicodedata.name(one, "").startswith("VARIATION SELECTOR"))
    return _without(text, (*hidden(text), *selectors, *(one for one in text if one in QUOTES)))


def plain(text: str, keep: str = "\n\t") -> str:
    """Return a text as it leaves for a screen: refused characters as <U+001B>, except joiners and those in `keep`."""
    return text.translate({ord(one): f"<{code(one)}>" for one in hidden(text, but=keep + JOINERS)})


def quoted(text: str, most: int = 60) -> str:
    """Return a text between quotes for a message: on one line, cut after `most` characters, refused ones named."""
    odd = hidden(text, but="\n" + JOINERS) or hidden(text)
    escaped = text.translate({ord(one): f"<{code(one)}>" for one in odd if not one.isspace()})
    shown = " ".join(f"'{escaped}'".split())
    shown = shown if len(shown) <= most else f"{shown[: most - 3]}..."
    return f"{shown} with {', '.join(map(code, odd[:5]))}" if odd else shown


def code(character: str) -> str:
    """Return the code of a character: `U+202E`."""
    return f"U+{ord(character):04X}"


def _is_hidden(character: str) -> bool:
    if character in BLANKS:
        return True
    return not character.isprintable() and unicodedata.category(character) != "Zs"


def _without(text: str, refused: tuple[str, ...]) -> str:
    if refused:
        raise ValueError(f"holds {', '.join(map(code, refused))}")
    return text
