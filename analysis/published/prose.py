"""Tests as a paper's sentences print them, such as `t(11) = 8.14, p < .001`: t, F, chi-squared, r and z.

They are found as statcheck finds them (Nuijten et al. 2016, Behav. Res. Methods 48, 1205-1226): in the style of the
APA, a statistic with its df, and its P behind it; other numbers, such as an effect size or an interval, may stand
between. Spaces, minus signs, subscripts, decimal commas, and powers of ten may be written in any way.
"""

import re
import unicodedata
from dataclasses import dataclass
from html.parser import HTMLParser
from itertools import islice
from operator import itemgetter
from typing import Literal

from palpate.analysis.published.printed import Printed

Statistic = Literal["t", "F", "chi2", "r", "z"]

MOST_TESTS = 2_000
"""The most tests that are read of one paper."""

NS = 0.05
"""`ns` in the place of P says that it is above this."""


@dataclass(frozen=True)
class Reported:
    """One test in a sentence: its `head`, df as printed, the statistic and P with the signs before them.

    `interval` has the ends of a confidence interval at its level behind the statistic, if any.
    """

    head: str
    statistic: Statistic
    df: tuple[Printed, ...]
    value: Printed
    sign: str
    p: Printed
    p_sign: str
    interval: tuple[Printed, Printed] | None = None
    level: float = 0.95


_NUMBER = r"[-+]?(?:[0-9]{1,3}(?:,[0-9]{3})+\.[0-9]+|[0-9]*[.,][0-9]+|[0-9]+)"
_POWER = r"(?: ?(?:[x*·×] ?10 ?\^? ?\{?\(?|[eE])(-[0-9]{1,2})\)?\}?)?"
_OPEN, _CLOSE = r" ?(?:\(|_\{?|\[) ?", r" ?(?:\)|\}|\])?"
_THOUSANDS = r"[1-9][0-9]{0,2}(?:,[0-9]{3})+(?![0-9])"
_DF = rf"(?:df ?= ?)?({_THOUSANDS}|[0-9]+(?:[.,][0-9]+)?)"
_ABOVE = r"([0-9]+(?:\.[0-9]+)?)"
_BELOW = rf"({_THOUSANDS}|[0-9]+(?:\.[0-9]+)?)"
_N = r"(?: ?[,;] ?[Nn] ?= ?[0-9]+)?"
_SIGN = r" ?(=|<|>|≤|≥) ?"
_HEADS: dict[Statistic, str] = {
    "t": rf"(?<![A-Za-z])t{_OPEN}{_DF}{_N}{_CLOSE}",
    "F": rf"(?<![A-Za-z])F{_OPEN}{_ABOVE} ?[,;] ?{_BELOW}{_CLOSE}",
    "chi2": rf"(?:χ ?\^?\{{?2?\}}?|(?<![A-Za-z])(?:[Cc]hi[- ]?squared?|chi2|X\^?2)){_OPEN}{_DF}{_N}{_CLOSE}",
    "r": rf"(?<![A-Za-z])r{_OPEN}{_DF}{_N}{_CLOSE}",
    "z": r"(?<![A-Za-z])[zZ]",
}
_BETWEEN = (
    r"(?P<between>(?: ?[,;] ?(?![pP][ <=>-])[^,;()=<>\n]{1,30}?(?:=|<|>)? ?"
    r"(?:\[[^\]\n]{1,40}\]|[-+0-9.,]*[0-9])%?){0,4}?)"
)
_NS = r"n\. ?s\.|ns\b"
_P = (
    rf" ?[,;.)(]? ?\(?(?:{_NS}|[pP](?:[- ]?values?)?(?P<ps>(?: ?(?:=|<|>|≤|≥)) ?)"
    rf"(?:{_NS}|(?P<p>{_NUMBER}){_POWER}))"
)
_GROUPED = re.compile(_THOUSANDS)
_TESTS = {name: re.compile(f"{head}{_SIGN}({_NUMBER}){_POWER}{_BETWEEN}{_P}") for name, head in _HEADS.items()}
_INTERVAL = re.compile(rf"([0-9]{{2}}) ?% ?(?:CI|confidence interval)s? ?[:=]? ?\[ ?({_NUMBER}) ?[,;] ?({_NUMBER}) ?\]")
_ONE_TAILED = re.compile(
    r"one[- ](?:tailed|sided)|(?<![-\w])directional (?:tests?|hypothes[ei]s|predictions?)\b", re.IGNORECASE
)
_DASHES = str.maketrans(dict.fromkeys("\u2212\u2013\u2010\u2011\ufe63", "-") | dict.fromkeys("\u200b\u2060\ufeff"))


def reported_tests(text: str) -> tuple[Reported, ...]:
    """Return the first `MOST_TESTS` tests in the sentences of a text, in their order."""
    even = _even(text)
    matches = sorted(
        ((match.start(), name, match) for name, pattern in _TESTS.items() for match in pattern.finditer(even)),
        key=itemgetter(0),
    )
    found = (_reported(name, match) for _, name, match in matches)
    return tuple(islice((one for one in found if one is not None), MOST_TESTS))


def mentions_one_tailed(text: str) -> bool:
    """Return whether a text says that tests are one-tailed."""
    return _ONE_TAILED.search(_even(text)) is not None


def _even(text: str) -> str:
    even = unicodedata.normalize("NFKC", text).translate(_DASHES)
    return re.sub(r"[ \t\r\f\v]*\n?[ \t\r\f\v]+|(?<=\S)\n(?=\S)", " ", even.replace("$", ""))


def _reported(name: Statistic, match: re.Match[str]) -> Reported | None:
    groups = match.groups()
    count = {"t": 1, "F": 2, "chi2": 1, "r": 1, "z": 0}[name]
    sign, value, power = groups[count : count + 3]
    points = name == "F" or "." in value + (match["p"] or "")
    df = tuple(
        _printed(one.replace(",", "") if points and _GROUPED.fullmatch(one) else one, None) for one in groups[:count]
    )
    if any(one.exact <= 0 for one in df):
        return None
    p, p_sign = match["p"], (match["ps"] or "").strip()
    if p is None:
        shown, p_sign = Printed(str(NS)), ">"
    else:
        percent = match.string[match.end() :].lstrip(" ")[:1] == "%"
        shown = _printed(p, "-2" if percent else groups[-1])
        if name == "z" and not 0 <= shown.exact <= 1:
            return None
        p_sign = {"≤": "<", "≥": ">"}.get(p_sign, p_sign)
        shown = Printed(f"<{shown.text}") if p_sign == "<" else shown
    interval = _INTERVAL.search(match["between"])
    ends = (_printed(interval[2], None), _printed(interval[3], None)) if interval else None
    level = int(interval[1]) / 100 if interval else 0.95
    head = " ".join(match.string[match.start() : match.end(count + 3) if power else match.end(count + 2)].split())
    return Reported(head, name, df, _printed(value, power), sign, shown, p_sign, ends, level)


def _printed(number: str, power: str | None) -> Printed:
    """Return a number with a point, a digit before it, and its power of ten."""
    bare = number.lstrip("+")
    bare = bare.replace(",", "") if "." in bare else bare.replace(",", ".")
    minus, bare = ("-", bare[1:]) if bare.startswith("-") else ("", bare)
    bare = f"0{bare}" if bare.startswith(".") else bare
    return Printed(f"{minus}{bare}{f'e{power}' if power else ''}")


class _Words(HTMLParser):
    """Collects the text of a page, a line for each block; subscripts stand in braces, as in TeX."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.parts: list[str] = []
        self._hidden = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: ARG002
        self._hidden += tag in ("script", "style", "template")
        self.parts.append({"sub": "_{", "sup": "^"}.get(tag, "" if tag in INLINE else "\n\n"))

    def handle_endtag(self, tag: str) -> None:
        if tag in ("script", "style", "template"):
            self._hidden = max(0, self._hidden - 1)
        self.parts.append({"sub": "}", "sup": ""}.get(tag, "" if tag in INLINE else "\n\n"))

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.parts.append(data)


INLINE = ("i", "em", "b", "strong", "span", "a", "small", "font", "mark", "u", "var", "abbr", "cite", "mi", "mo", "mn")
"""Elements that part no words."""


def words(page: str) -> str:
    """Return the text of an HTML page."""
    collected = _Words()
    # Without `close`, which tries every `<` of an unfinished page again.
    collected.feed(page)
    return "".join(collected.parts)
