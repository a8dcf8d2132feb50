"""Names and units of the columns of a recording, from headings as programs write them, and units of time.

`Zeit (ms)`, `t/s`, `time.ms`, `ms time`, `time {ms}`, `elapsedMillis` and `seconds_elapsed` all say which unit they are
in. What says nothing has no unit: nothing is taken for seconds.
"""

import re
from typing import NamedTuple

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
"""Seconds in a unit of time."""

SERIAL_DAYS = 36_526, 73_051
"""Days from the end of 1899, as spreadsheets count them, in this century."""

_M_S2 = {"g": 9.80665, "mg": 9.80665e-3, "m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "m s^-2": 1.0}
_SPELT = {
    "s": "s sec secs second seconds sek sekunde sekunden segundo segundos secondi seconde secondes 秒",
    "ms": "ms msec msecs millis millisec millisecs millisecond milliseconds millisekunde millisekunden msek",
    "us": "us µs μs usec usecs µsec μsec micros microsec microsecs microsecond microseconds mikrosekunden",
    "ns": "ns nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds nanosekunden",
    "min": "min mins minute minutes minuten",
    "h": "h hr hrs hour hours",
    "d": "days tage",
}
_TIMES = {spelling: unit for unit, spellings in _SPELT.items() for spelling in spellings.split()}
_CLOCKS = frozenset(
    ("t", "time", "times", "timestamp", "timestamps", "zeit", "zeitpunkt", "temps", "tiempo", "tempo", "tid", "tijd",
     "uptime", "elapsed", "clock", "epoch", "unixtime", "millis", "micros", "nanos", "時間", "时间")
)  # fmt: skip
_SIGNALS = frozenset(
    ("g", "mg", "V", "mV", "uV", "µV", "N", "mN", "kN", "Pa", "kPa", "mm", "um", "µm", "m/s2", "m/s^2", "m/s²", "mm/s",
     "dB")
)  # fmt: skip
"""Units of signals that a name may end in without brackets; a letter such as A is a name more often."""
_NO_NAMES = frozenset((*_TIMES, "volt", "sequence", "-"))

_BRACKETS = re.compile(
    r"(?P<name>.*?)(?<![\s/,])[\s/,]*[(\[{<](?P<unit>[^()\[\]{}<>]*(?:\([^()]*\))?[^()\[\]{}<>]*)[)\]}>]"
)
_PARTS = re.compile(r"[\s_.\-/:,;|]+")
_RATE = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([kM]?)(?:Hz|S/s|Sa/s|sps)\b")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_COUNTERS = frozenset(
    ("index", "idx", "sample", "samples", "sampleno", "nr", "no", "number", "count", "counter", "row", "id", "i", "n",
     "point", "points", "scan", "record")
)  # fmt: skip


class Heading(NamedTuple):
    """What a heading says: the name of a column, and its unit, empty where none is given."""

    name: str
    unit: str


def heading(text: str) -> Heading:
    """Return the name and the unit in a heading; a name without brackets keeps its unit in it."""
    text = " ".join(text.split()).strip('"').strip()
    bracketed = _BRACKETS.fullmatch(text)
    if bracketed:
        return Heading(bracketed["name"].strip(), bracketed["unit"].strip())
    name, slash, unit = text.partition("/")
    if slash and name.strip() and (unit.strip() in _SIGNALS or unit.strip().lower() in _TIMES):
        return Heading(name.strip(), unit.strip())
    parts = [part for part in _PARTS.split(text) if part]
    ends = text.split("_", 1)[-1].replace("m_s2", "m/s2")
    if len(parts) > 1 and not is_clock(text):
        for unit in (ends, re.split(r"[\s_]", text)[-1]):
            if unit in _SIGNALS:
                return Heading(text, unit)
    return Heading(text, "")


def is_clock(name: str) -> bool:
    """Return whether a name is one of times: a word of it says so, or is a unit of time."""
    words = _words(name)
    units = bool(words) and all(_TIMES.get(word) in ("s", "ms", "us", "ns") for word in words)
    clocks = _CLOCKS & {word.rstrip("0123456789") for word in words}
    return units or bool(clocks) or name.lower() == "x_value"


def is_counter(name: str) -> bool:
    """Return whether a name is one of a counter of samples."""
    words = _words(name)
    return bool(words) and set(words) <= _COUNTERS


def time_unit(column: Heading) -> str:
    """Return the unit of a clock, a key of `SECONDS`; empty where its heading says none or one that is not known."""
    if column.unit:
        return _TIMES.get(column.unit.lower().strip(". "), "")
    stated = {_TIMES[word] for word in _words(column.name.rpartition("/")[2]) if word in _TIMES}
    return stated.pop() if len(stated) == 1 else ""


def is_unit(text: str) -> bool:
    """Return whether a cell below a heading is a unit: in brackets, or one that is known."""
    bare = text.strip().strip('"').strip()
    return bool(re.fullmatch(r"[(\[{<].*[)\]}>]", bare)) or bare in _SIGNALS or bare.lower() in _NO_NAMES


def is_step(text: str) -> bool:
    """Return whether a heading is that of the time between samples, as scopes write it above them."""
    return heading(text).name.lower() == "increment"


def rate_in(text: str) -> str:
    """Return the rate that a text names, in Hz; `HZ` where it names none, or several."""
    named = {float(value) * {"": 1, "k": 1e3, "M": 1e6}[prefix] for value, prefix in _RATE.findall(text)}
    return f"{named.pop():.12g}" if len(named) == 1 else "HZ"


def likely_unit(step: float, first: float) -> str:
    """Return the unit in which a step between samples, and the first time, are most likely."""
    for unit, epoch in (("s", 1e9), ("ms", 1e12), ("us", 1e15), ("ns", 1e18)):
        if epoch <= first < 10 * epoch:
            return unit
    if SERIAL_DAYS[0] < first < SERIAL_DAYS[1] and step < 1e-3:
        return "d"
    rates = {unit: 1 / (step * SECONDS[unit]) for unit in ("s", "ms", "us", "ns") if step > 1e-290}
    for least, most in ((200.0, 2e5), (20.0, 1e7)):
        for unit, rate in rates.items():
            if least <= rate <= most:
                return unit
    return "s"


def in_unit(value: float, of: str, unit: str) -> float | None:
    """Return a value of one unit in another; None where palpate knows no factor between them."""
    if of == unit:
        return value
    return value * _M_S2[of] / _M_S2[unit] if {of, unit} <= set(_M_S2) else None


def _words(name: str) -> list[str]:
    return [word for part in _PARTS.split(name) for one in _CAMEL.split(part) if (word := one.lower())]
