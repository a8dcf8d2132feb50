"""Names and units of the columns of a recording, from headings as programs write them, and units of time.

`Zeit (ms)`, `t/s`, `time.ms`, `ms time`, `time {ms}`, `elapsedMillis` and `seconds_elapsed` all say which unit they are
in. What says nothing has no unit: nothing is taken for seconds.
"""

import re
from collections.abc import Iterable
from math import inf, nan
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
_NO_NAMES = frozenset(
    (*_TIMES, "volt", "sequence", "-", "deg", "rad", "°", "°c", "%", "cm", "nm", "ma", "ua", "µa", "hpa", "bar")
)
_COMPOUND = re.compile(
    r"(?:[mcuµn]?m|deg|rad|°|[mk]?N|[mu]?V|g)/\(?s(?:\^?[23]|[²³])?\)?\*?|[mk]?N[ .·*]?[mcµ]?m|[mk]?N/m?m"
)
"""Units made of others, as headings and rows of units have them: mm/s^2, m/(s^2), N.mm."""
_IN = re.compile(r"(?:(?P<name>.*\S)\s+)?in\s+(?P<unit>\S+)")

_BRACKETS = re.compile(
    r"(?P<name>.*?)(?<![\s/,])[\s/,]*[(\[{<](?P<unit>[^()\[\]{}<>]*(?:\([^()]*\))?[^()\[\]{}<>]*)[)\]}>]"
)
_PARTS = re.compile(r"[\s_.\-/:,;|]+")
_RATE = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([kM]?)(?:Hz|S/s|Sa/s|sps)\b")
_HEADER = 65_536
"""Characters above the rows that are looked at for a rate."""
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "1/s": 1.0, "s/s": 1.0, "ks/s": 1e3, "ms/s": 1e6, "sa/s": 1.0,
          "ksa/s": 1e3, "sps": 1.0, "ksps": 1e3, "samples/s": 1.0}  # fmt: skip
_BETWEEN = (
    r"[^0-9A-Za-z\n]*(?:[(\[{{]?(?P<before>{units})[)\]}}]?)?[^0-9A-Za-z\n+-]*"
    r"(?P<value>[0-9][0-9.,]*(?:[eE][+-]?[0-9]+)?)"
)
_BEHIND = r"[\s\"';,\t(\[]*(?P<behind>{units})?(?![A-Za-z/])"
_RATE_LINE = re.compile(
    r"(?:^\W*rate|(?<![A-Za-z])(?:fs|sfreq|(?:sampl(?:e|ing)|scan)[\s_]*(?:rate|freq(?:uency|\.)?)"
    r"|abtast(?:rate|frequenz)|fréquence d.échantillonnage|taux d.échantillonnage))(?![A-Za-z])"
    + (_BETWEEN + _BEHIND).format(units="|".join(map(re.escape, _HERTZ))), re.IGNORECASE,
)  # fmt: skip
_OWN = re.compile(
    r"\A\W*(?:(?:Devices|Trajectories|Model Outputs|Segments|Joints)[\s,;]*\n\s*"
    r"|NO_OF_(?:FRAMES|SAMPLES)\t(?s:.*?)\nFREQUENCY\t|(?:1[0-9]{9}(?:\.[0-9]*)?[\s,;]*)+\n\W*)"
    r"(?P<value>[0-9]+(?:\.[0-9]+)?)[\s,;]"
)
"""The rate in a line of its own (Vicon), behind a word alone (Qualisys), and below the time of the start (Empatica)."""
_STEP_LINE = re.compile(
    r"(?:^interval=|(?:(?<![A-Za-z])(?:sampl(?:e|ing)[\s_]*(?:interval|period)|delta[\s_]?[tx]|dt)|abtastintervall)"
    r"(?![A-Za-z]))"
    + (_BETWEEN + _BEHIND).format(units="|".join(sorted(map(re.escape, _TIMES), key=len, reverse=True))), re.IGNORECASE,
)  # fmt: skip
_PER_SAMPLE = re.compile(
    rf"^\W*(?P<value>[0-9][0-9.,]*)\s*(?P<behind>{'|'.join(sorted(_TIMES, key=len, reverse=True))})/sample",
    re.IGNORECASE,
)
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_COUNTERS = frozenset(
    ("index", "idx", "sample", "samples", "sampleno", "nr", "no", "number", "count", "counter", "row", "id", "i", "n",
     "point", "points", "scan", "record", "frame", "sub", "subframe", "seq")
)  # fmt: skip


ABSCISSAS = ("x", "x-axis", "x axis")
"""What a column of times is called by what plots it; its unit says that they are times."""


class Heading(NamedTuple):
    """What a heading says: the name of a column, and its unit, empty where none is given."""

    name: str
    unit: str


def heading(text: str) -> Heading:
    """Return the name and the unit in a heading; a name without brackets keeps its unit in it."""
    text = " ".join(text.split()).strip('"').strip()
    if _COMPOUND.fullmatch(text):
        return Heading("", text)
    if (apart := _IN.fullmatch(text)) and is_unit(apart["unit"]):
        return Heading(apart["name"] or "", apart["unit"])
    bracketed = _BRACKETS.fullmatch(text)
    if bracketed:
        return Heading(bracketed["name"].strip(), bracketed["unit"].strip())
    name, slash, unit = text.partition("/")
    if slash and name.strip() and (unit.strip() in _SIGNALS or unit.strip().lower() in _TIMES):
        return Heading(name.strip(), unit.strip())
    parts = [part for part in _PARTS.split(text) if part]
    ends = text.split("_", 1)[-1].replace("m_s2", "m/s2")
    if len(parts) > 1 and not is_clock(text):
        for unit in (ends, re.split(r"[\s_,]", text)[-1]):
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
        # The CF conventions write from when times count: "milliseconds since 2024-03-12".
        return _TIMES.get(column.unit.lower().partition(" since ")[0].strip(". "), "")
    stated = {_TIMES[word] for word in _words(column.name.rpartition("/")[2]) if word in _TIMES}
    return stated.pop() if len(stated) == 1 else ""


def is_unit(text: str) -> bool:
    """Return whether a cell below a heading is a unit: in brackets, or one that is known."""
    bare = text.strip().strip('"').strip()
    known = bare in _SIGNALS or bare.lower() in _NO_NAMES or _COMPOUND.fullmatch(bare)
    return bool(known or re.fullmatch(r"[(\[{<].*[)\]}>]", bare))


def is_rate(text: str) -> bool:
    """Return whether a cell is a sampling rate, and no name."""
    return _RATE.fullmatch(text.strip()) is not None


def contradict(one: str, other: str) -> bool:
    """Return whether two units of one column are known, and not the same."""
    times = [time_unit(Heading("", unit)) for unit in (one, other)]
    if all(times):
        return times[0] != times[1]
    if not all(unit in _SIGNALS or time for unit, time in zip((one, other), times, strict=True)):
        return False
    return in_unit(1.0, one, other) != 1.0


def bare_clock(name: str, beside: Iterable[str]) -> frozenset[str]:
    """Return the words of a clock's name, without numbers, units, and words of the names of channels beside it."""
    others = {word for one in beside for word in _words(one)}
    words = {word.rstrip("0123456789") for word in _words(name) if word not in others and word not in _TIMES}
    return frozenset(words - {""})


def is_step(text: str) -> bool:
    """Return whether a heading is that of the time between samples, as scopes write it above them."""
    return heading(text).name.lower() == "increment"


def rate_in(text: str) -> str:
    """Return the sampling rate that a text names, in Hz; `HZ` where it names none, or several."""
    if stated := rates_stated(text):
        return f"{stated[0]:.12g}"
    named = {float(value) * {"": 1, "k": 1e3, "M": 1e6}[prefix] for value, prefix in _RATE.findall(text)}
    return f"{named.pop():.12g}" if len(named) == 1 else "HZ"


def rates_stated(text: str) -> tuple[float, ...]:
    """Return the readings of the sampling rate, Hz, that lines of a header state, as a rate or as an interval.

    Of `2.000` both 2 and 2000 are readings; several lines of different rates state none.
    """
    if own := _OWN.match(text):
        return (float(own["value"]),)
    found: list[tuple[float, ...]] = []
    for line in text[-_HEADER:].splitlines():
        rate, step = _RATE_LINE.search(line), _STEP_LINE.search(line) or _PER_SAMPLE.match(line)
        if rate is not None:
            factor = _HERTZ.get((rate["behind"] or rate["before"] or "hz").lower(), nan)
            found.append(tuple(value * factor for value in _readings(rate["value"])))
        elif step is not None and (
            unit := _TIMES.get((step["behind"] or step.groupdict().get("before") or "").lower(), "")
        ):
            found.append(tuple(1 / (value * SECONDS[unit]) for value in _readings(step["value"]) if value > 0))
    usable = [tuple(one for one in each if 0 < one < inf) for each in found]
    return usable[0] if usable and all(each == usable[0] for each in usable) else ()


def _readings(value: str) -> tuple[float, ...]:
    """Return what a number with either decimal sign may be."""
    bare = value.strip(".,")
    points = re.sub(r",(?=[0-9]{3}(?![0-9]))", "", bare)
    commas = re.sub(r"\.(?=[0-9]{3}(?![0-9]))", "", bare).replace(",", ".")
    numbers = (one for one in (points, commas) if re.fullmatch(r"[0-9]*\.?[0-9]+([eE][+-]?[0-9]+)?", one))
    return tuple(dict.fromkeys(map(float, numbers)))


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
