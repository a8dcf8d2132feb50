"""Dates and times of day in delimited text, as whole nanoseconds: `2026-11-28T12:00:00.001Z`, `28.11.2026 12:00:00`.

A row's stamp needs hours, minutes and seconds, or minutes and seconds with a part of one; a date may stand before it,
also in a cell of its own, and AM, PM or an offset from UTC behind it.
A time of day that is earlier than the one before by more than half a day is one of the next day; so is one behind a
date with slashes, of which nobody knows whether days or months come first.
"""

import re
from datetime import date
from typing import NamedTuple

from palpate.experiment.settings.delimited import DELIMITERS

SECOND_NS = 10**9
DAY_NS = 86_400 * SECOND_NS

ORIGIN_NS = 10**18
"""What stands for the beginning of 1970, or for midnight: no other column of a recording has numbers as large."""

_STAMP = (
    r"(?<![^\s;,|\"'])"
    r"(?:(?:(?P<y>[0-9]{{4}})-(?P<m>[0-9]{{2}})-(?P<d>[0-9]{{2}})"
    r"|(?P<D>[0-9]{{2}})\.(?P<M>[0-9]{{2}})\.(?P<Y>[0-9]{{4}})|[0-9]{{1,4}}/[0-9]{{1,2}}/[0-9]{{1,4}})"
    r"(?P<between>[T ]|\"?[;,\t|]\"?))?"
    r"(?:(?P<hour>[0-9]{{1,2}}):|(?=[0-9]+:[0-9]+{sign}[0-9]))(?P<minute>[0-5][0-9]):(?P<second>[0-5][0-9])"
    r"(?:(?:{sign}|:(?=[0-9]{{3}}(?![0-9])))(?P<part>[0-9]{{1,9}}))?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?|Z|(?P<offset>[+-][0-9]{{2}}:?[0-9]{{2}}))?"
    r"(?![^\s;,|\"'])"
)
_STAMPS = {sign: re.compile(_STAMP.format(sign=sign)) for sign in (r"\.", r"[.,]")}

_ARROW = re.compile(r"^([0-9]{1,2}:[0-5][0-9]:[0-5][0-9]\.[0-9]{3}) -> ", re.MULTILINE)
"""What the Arduino IDE writes before each line, if it is asked to show when it came."""

HEAD = 65_536
"""Characters in which a text has a stamp, if it has any in its rows."""


class Stamped(NamedTuple):
    """A text whose stamps are whole nanoseconds, and these; of a text without any, itself and nothing."""

    text: str
    stamps_ns: frozenset[int]


def without_stamps(text: str) -> Stamped:
    """Return a text with each stamp as nanoseconds since 1970, or since midnight, both from `ORIGIN_NS` on."""
    head = text[:HEAD]
    if _ARROW.search(head):
        behind = [sign for sign in DELIMITERS if sign in head]
        text = _ARROW.sub(rf"\1{behind[0] if behind else ','}", text)
        head = text[:HEAD]
    rows = sum(1 for _ in _STAMPS[r"\."].finditer(head)) or sum(1 for _ in _STAMPS[r"[.,]"].finditer(head))
    if not rows:
        return Stamped(text, frozenset())
    # Where commas part the cells, one ends a time.
    stamp = _STAMPS[r"[.,]" if max(map(head.count, ";\t|")) >= rows else r"\."]
    found: set[int] = set()
    before_ns, days = 0, 0

    def nanoseconds(match: re.Match[str]) -> str:
        nonlocal before_ns, days
        try:
            on = _day(match)
        except ValueError:
            return match[0]
        hour = int(match["hour"] or 0)
        if half := match["half"]:
            hour = hour % 12 + 12 * (half in "Pp")
        clock_s = (hour * 60 + int(match["minute"]) - _offset_minutes(match["offset"])) * 60
        time_ns = (clock_s + int(match["second"])) * SECOND_NS + int((match["part"] or "0").ljust(9, "0"))
        if on is None:
            days += time_ns < before_ns - DAY_NS // 2
            before_ns, on = time_ns, days
        stamp_ns = ORIGIN_NS + on * DAY_NS + time_ns
        found.add(stamp_ns)
        # A date in a cell of its own becomes the whole stamp, too, so that no cell is lost.
        apart = match["between"] if (match["between"] or "T") not in "T " else ""
        return f"{stamp_ns}{apart}{stamp_ns}" if apart else str(stamp_ns)

    return Stamped(stamp.sub(nanoseconds, text), frozenset(found))


def _day(match: re.Match[str]) -> int | None:
    """Return the day of a date, from that of 1970 on; None without one. Raises `ValueError` for no date."""
    if match["y"]:
        return (date(int(match["y"]), int(match["m"]), int(match["d"])) - date(1970, 1, 1)).days
    if match["Y"]:
        return (date(int(match["Y"]), int(match["M"]), int(match["D"])) - date(1970, 1, 1)).days
    return None


def _offset_minutes(offset: str | None) -> int:
    if not offset:
        return 0
    minutes = int(offset[1:3]) * 60 + int(offset[-2:])
    return -minutes if offset[0] == "-" else minutes
