"""Tests as a paper's sentences print them, such as `t(11) = 8.14, p < .001`: t, F, chi-squared, r and z.

They are found as statcheck finds them (Nuijten et al. 2016, Behav. Res. Methods 48, 1205-1226): in the style of the
APA, a statistic with its df, and its P behind it; other numbers, such as an effect size or an interval, may stand
between. The df may stand behind the statistic, a sample size in place of that of r, and P before both. Spaces, minus
signs, subscripts, decimal commas, and powers of ten may be written in any way. What looks like a test, a P or an
interval and is none of these is named with the reason.
"""

import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html.parser import HTMLParser
from itertools import chain
from typing import Literal, NamedTuple

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
_ABOVE = r"([0-9]+(?:\.[0-9]+)?|[0-9]+,[0-9]+(?= ?; ?[0-9]|, [0-9]+,[0-9]+ ?[)\]}]))"
_BELOW = rf"({_THOUSANDS}|[0-9]+(?:[.,][0-9]+)?)"
_N = r"(?: ?[,;] ?[Nn] ?= ?[0-9]+)?"
_ONE = r"[0-9]+(?:[.,][0-9]+)?"
_SIGN = r" ?(=|<|>|≤|≥) ?"
_CHI = (
    r"(?:[χΧ] ?\^?\{?2?\}?|(?<![A-Za-z])(?:[Cc]hi(?:[- ]?(?:squared?|[Qq]uadrat)| ?\^?2|sq)|X ?\^?\{?2\}?"
    r"|Q(?:_?\{?(?:[bBwW]|between|within)\}?)?))"
)
_HEADS: dict[Statistic, str] = {
    "t": rf"(?<![A-Za-z])t{_OPEN}{_DF}{_N}{_CLOSE}",
    "F": rf"(?<![A-Za-z])F{_OPEN}{_ABOVE} ?[,;] ?{_BELOW}{_CLOSE}",
    "chi2": rf"{_CHI}{_OPEN}{_DF}{_N}{_CLOSE}",
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
_APART: dict[Statistic, str] = {
    "t": r"(?<![A-Za-z])t",
    "F": r"(?<![A-Za-z])F",
    "chi2": _CHI,
    "r": r"(?<![A-Za-z])r",
}
_DF_BEHIND = (
    rf" ?[,;(] ?(?:(?:df|dof|d\.f\.) ?= ?(?P<df>{_ONE}(?: ?[,;] {_ONE}|;{_ONE}|/{_ONE})?)"
    rf"|(?P<before>{_ONE}) ?df|[nN] ?= ?(?P<n>[0-9]+)) ?\)?"
)
"""The df behind a statistic, those of F with a blank or a slash between, or the sample size of r."""
_GROUPED = re.compile(_THOUSANDS)
_FIRST = (
    rf"(?<![A-Za-z])[pP](?:[- ]?values?)?(?P<ps> ?(?:=|<|>|≤|≥) ?)(?P<p>{_NUMBER}){_POWER}"
    r" ?(?:[,;(\[]|for|in|with|by|from|bei|für|mit)(?: [A-Za-zäöüß-]{1,20}){0,8},? ?[(\[]?"
)
"""A P that stands before its statistic."""
_TESTS = [(name, re.compile(f"{head}{_SIGN}({_NUMBER}){_POWER}{_BETWEEN}{_P}")) for name, head in _HEADS.items()] + [
    (name, re.compile(f"{head}{_SIGN}({_NUMBER}){_POWER}{_DF_BEHIND}{_BETWEEN}{_P}")) for name, head in _APART.items()
]
_REVERSED = [(name, re.compile(f"{_FIRST}(?P<stat>{head}{_SIGN}({_NUMBER}){_POWER})")) for name, head in _HEADS.items()]
_BEHIND_P = [pattern for _, pattern in _REVERSED] + [
    re.compile(f"{_FIRST}(?P<stat>{head}{_SIGN}({_NUMBER}){_POWER}{_DF_BEHIND})") for head in _APART.values()
]
_KNOWN = rf"(?:(?<![A-Za-z])(?:[tFzZ]|r)(?![A-Za-z])|{_CHI})"
_OTHER = (
    r"(?:(?<![A-Za-z])(?:[UWHVTKGBDRb]|r_?\{?s\}?|rho|tau|beta|Wald|LRT?|OR|HR)(?![A-Za-z])"
    r"|[ρτβΔΛη](?:2|\^2)?(?:_?\{?p\}?)?)"
)
_LOOKS = re.compile(
    rf"(?P<name>{_KNOWN}|{_OTHER})(?P<df>{_OPEN}[^)\]}}\n=]{{1,30}}(?:= ?[0-9]+)?[)\]}}])?{_SIGN}{_NUMBER}"
)
_ANY_P = re.compile(
    r"(?<![A-Za-z])[pP](?:[- ]?values?)?(?: ?\([^)\n]{1,20}\)|_?\{?[A-Za-z]{1,10}\}?)? ?(?:=|<|>|≤|≥|≈) ?"
    rf"{_NUMBER}"
)
_ANY_INTERVAL = re.compile(
    rf"[0-9]{{2}} ?%[ -]?(?:CI|KI|confidence interval|Konfidenzintervall|credible interval)s?[^.\n0-9]{{0,6}}{_NUMBER}"
    rf"[^\n0-9]{{1,5}}{_NUMBER}[)\]]?"
)
NEAR = 80
"""Characters within which a P belongs to what stands before it."""
MOST_NAMED = 30
"""The most of what could not be checked that is named."""
_INTERVAL = re.compile(
    rf"([0-9]{{2}}) ?%[ -]?(?:CI|KI|confidence interval|Konfidenzintervall)s? ?[:=]? ?"
    rf"(?:[\[(] ?({_NUMBER}) ?(?:[,;]|to|bis) ?({_NUMBER}) ?[\])]|({_NUMBER}) ?(?:to|bis) ?({_NUMBER}))"
)
_ONE_TAILED = re.compile(
    r"one[- ](?:tailed|sided)|(?<![-\w])directional (?:tests?|hypothes[ei]s|predictions?)\b", re.IGNORECASE
)
_SUBSCRIPT = re.compile("[\u2080-\u2089]+(?:[,;] ?[\u2080-\u2089]+)*")
_DASHES = str.maketrans(dict.fromkeys("\u2212\u2013\u2010\u2011\ufe63", "-") | dict.fromkeys("\u200b\u2060\ufeff"))


_Match = tuple[re.Match[str], "Reported"]


class Prose(NamedTuple):
    """The first `MOST_TESTS` tests of a text in their order, and sentences on what looks like one and was not read."""

    tests: tuple[Reported, ...]
    unchecked: tuple[str, ...]


def reported_tests(text: str) -> Prose:
    """Return the tests in the sentences of a text."""
    even = _even(text)
    taken = bytearray(len(even))
    found, unclear = _followed(_matching(_TESTS, even, taken), even)
    for match, _ in (*found, *unclear):
        _take(match.span(), taken)
    found += _matching(_REVERSED, even, taken)
    taken = bytearray(len(even))
    for match, _ in found:
        _take(match.span(), taken)
    found.sort(key=lambda each: each[0].span())
    return Prose(tuple(one for _, one in found[:MOST_TESTS]), _unchecked(even, taken))


def _matching(patterns: Iterable[tuple[Statistic, re.Pattern[str]]], even: str, taken: bytearray) -> list[_Match]:
    return [
        (match, one)
        for name, pattern in patterns
        for match in pattern.finditer(even)
        if _free(match.span(), taken) and (one := _reported(name, match)) is not None
    ]


def _followed(tests: Iterable[_Match], even: str) -> tuple[list[_Match], list[_Match]]:
    """Return the tests whose P is the one behind them, and those of which that is not clear.

    Tests in a row, each right behind the P of the one before, are one list. Where it begins with a P, each P is that of
    the statistic behind it if the list ends with a statistic. If it ends with a P, an inequality at its beginning is a
    level; of another number nobody knows.
    """
    before: dict[int, tuple[int, str]] = {}
    for match in chain.from_iterable(pattern.finditer(even) for pattern in _BEHIND_P):
        before[match.start("stat")] = match.start("ps"), match["ps"].strip()
    leading = {at for at, _ in before.values()}
    lists: list[tuple[str, list[_Match]]] = []
    own: dict[int, list[_Match]] = {}
    for test in sorted(tests, key=lambda each: each[0].span()):
        at, sign = before.get(test[0].start(), (-1, ""))
        if at not in own:
            lists.append((sign, own.setdefault(at, [])))
        row = own.pop(at)
        row.append(test)
        own[test[0].start("ps")] = row
        own.pop(-1, None)
    kept: list[_Match] = []
    unclear: list[_Match] = []
    for sign, row in lists:
        last = row[-1][0].start("ps")
        if not sign or (sign != "=" and last not in leading):
            kept += row
        elif last not in leading:
            unclear += row
    return kept, unclear


def _free(span: tuple[int, int], taken: bytearray) -> bool:
    """Return whether no character of a span is taken."""
    return taken.find(1, *span) < 0


def _take(span: tuple[int, int], taken: bytearray) -> None:
    begin, end = span
    taken[begin:end] = b"\1" * (end - begin)


def _unchecked(even: str, taken: bytearray) -> tuple[str, ...]:
    """Return a sentence on each statistic, P and interval outside of the tests that were read."""
    found: list[tuple[int, str, str]] = []
    for match in _LOOKS.finditer(even):
        if not _free(match.span(), taken):
            continue
        known = re.fullmatch(_KNOWN, match["name"]) is not None
        behind = _p_behind(even, match.end(), taken)
        if behind or (known and match["df"]):
            lacks = "it has no df" if not match["df"] else "its df or its P is unclear"
            why = "it has no P" if not behind else lacks
            span = match.start(), behind or match.end()
            _take(span, taken)
            found.append(
                (span[0], even[slice(*span)], why if known else "only t, F, chi-squared, r and z are recomputed")
            )
    for pattern, why in ((_ANY_P, "it has no statistic with df"), (_ANY_INTERVAL, "it has no t, r or z")):
        for match in pattern.finditer(even):
            if _free(match.span(), taken):
                _take(match.span(), taken)
                found.append((match.start(), match[0], why))
    told = [f"'{' '.join(text.split())}' was not checked: {why}." for _, text, why in sorted(found)]
    more = len(told) - MOST_NAMED
    return (*told[:MOST_NAMED], *([f"{more} more like this were not checked."] if more > 0 else ()))


def _p_behind(even: str, end: int, taken: bytearray) -> int:
    """Return where the P ends that follows in the same sentence, before another test; 0 without one."""
    other = taken.find(1, end, end + NEAR)
    found = _ANY_P.search(even, end, min(end + NEAR, len(even)) if other < 0 else other)
    if found is None or re.search(r"[.!?] \S", even[end : found.start()]):
        return 0
    return found.end()


def mentions_one_tailed(text: str) -> bool:
    """Return whether a text says that tests are one-tailed."""
    return _ONE_TAILED.search(_even(text)) is not None


def _even(text: str) -> str:
    text = _SUBSCRIPT.sub(lambda match: f"_{{{match[0]}}}", text)
    even = unicodedata.normalize("NFKC", text).translate(_DASHES)
    return re.sub(r"[ \t\r\f\v]*\n?[ \t\r\f\v]+|(?<=\S)\n(?=\S)", " ", even.replace("$", ""))


def _reported(name: Statistic, match: re.Match[str]) -> Reported | None:
    """Return the test that a pattern found; None where its df or its P cannot be."""
    named = match.groupdict()
    first = "stat" in named
    groups = match.groups()[4:] if first else match.groups()
    count = 0 if "before" in named else {"F": 2, "z": 0}.get(name, 1)
    sign, value, power = groups[count : count + 3]
    points = name == "F" or "." in value + (match["p"] or "")
    texts = _df_behind(name, named) if "before" in named else list(groups[:count])
    df = tuple(_printed(one.replace(",", "") if points and _GROUPED.fullmatch(one) else one, None) for one in texts)
    if len(df) != {"F": 2, "z": 0}.get(name, 1) or any(one.exact <= 0 for one in df):
        return None
    shown, p_sign = _p_of(match, match.groups()[2] if first else groups[-1], behind=not first)
    if name == "z" and not 0 <= shown.exact <= 1:
        return None
    head = match["stat"] if first else match.string[match.start() : match.end(count + 3 if power else count + 2)]
    head = f"{head}, df = {', '.join(one.text for one in df)}" if "before" in named else head
    ends, level = _interval(named.get("between") or "")
    return Reported(" ".join(head.split()), name, df, _printed(value, power), sign, shown, p_sign, ends, level)


def _p_of(match: re.Match[str], power: str | None, *, behind: bool) -> tuple[Printed, str]:
    """Return P as printed and its sign, `behind` its statistic or before it."""
    if match["p"] is None:
        return Printed(str(NS)), ">"
    percent = behind and match.string[match.end() :].lstrip(" ")[:1] == "%"
    shown = _printed(match["p"], "-2" if percent else power)
    sign = {"≤": "<", "≥": ">"}.get(match["ps"].strip(), match["ps"].strip())
    return (Printed(f"<{shown.text}") if sign == "<" else shown), sign


def _df_behind(name: Statistic, named: Mapping[str, str | None]) -> list[str]:
    """Return the df that stand behind a statistic as printed; of r, those of a sample size."""
    if size := named.get("n"):
        return [str(int(size) - 2)] if name == "r" else []
    return re.split(r" ?[;/] ?|, ", named.get("df") or named.get("before") or "")


def _interval(between: str) -> tuple[tuple[Printed, Printed] | None, float]:
    """Return the ends of the interval in a text, and its level."""
    found = _INTERVAL.search(between)
    if found is None:
        return None, 0.95
    low, high = (_printed(one, None) for one in found.groups()[1:] if one)
    return (low, high), int(found[1]) / 100


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
