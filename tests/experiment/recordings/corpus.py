"""Recordings as other programs write them, made by a script: layouts x delimiters x decimal signs x units x encodings.

`python -m tests.experiment.recordings.corpus 5000` reads as many random rearrangements of the same data, and prints how
many were read right, refused with a remedy that works, and read as something else.
"""

from __future__ import annotations

import random
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import Stated

Outcome = Literal["right", "refused", "wrong"]

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
SPELT = {
    "bracket": "{name} ({unit})", "square": "{name} [{unit}]", "brace": "{name} {{{unit}}}", "slash": "{name}/{unit}",
    "suffix": "{name}_{unit}", "dot": "{name}.{unit}", "dash": "{name}-{unit}", "blank": "{name} {unit}",
    "break": "{name}\n({unit})", "in front": "{unit} {name}",
}  # fmt: skip
WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds"}
MARKS = {"utf-8-sig": "utf-8-sig", "utf-16": "utf-16"}


@dataclass(frozen=True)
class Layout:
    """How one file is written; the defaults are those of a plain export."""

    delimiter: str = ","
    decimal: str = "."
    unit: str = "ms"
    encoding: str = "utf-8"
    heading: str = "bracket"
    clock: str = "Time"
    channel: str = "Acc"
    channel_unit: str = "g"
    quoted: bool = False
    quoted_numbers: bool = False
    comment: str = ""
    units_below: Literal["", "bracket", "bare"] = ""
    preamble: tuple[str, ...] = ()
    gap: bool = False
    newline: str = "\n"
    trailing: bool = False
    clock_at: int = 0
    counter: Literal["", "named", "pandas", "R"] = ""
    further: int = 0
    leading_zero: bool = True
    thousands: str = ""
    exponent: str = ""
    comment_within: bool = False
    epoch: bool = False
    stamp: str = ""
    rate_hz: float = 3200.0

    @property
    def says_unit(self) -> bool:
        """Whether the file says in which unit its times are."""
        return self.heading not in ("none", "bare")


LAYOUTS: dict[str, Layout] = {
    "plain": Layout(),
    "square brackets": Layout(heading="square"),
    "braces": Layout(heading="brace"),
    "slash": Layout(heading="slash", clock="t"),
    "underscore": Layout(heading="suffix", clock="time"),
    "dot": Layout(heading="dot", clock="time"),
    "dash": Layout(heading="dash"),
    "blank": Layout(heading="blank", clock="time"),
    "unit in front": Layout(heading="in front", clock="time"),
    "long word": Layout(heading="word", clock="time"),
    "camel case": Layout(heading="camel", clock="elapsed"),
    "quoted headings": Layout(quoted=True),
    "quoted line break": Layout(quoted=True, heading="break"),
    "quoted numbers": Layout(quoted=True, quoted_numbers=True),
    "units below": Layout(units_below="bracket", gap=True),
    "bare units below": Layout(units_below="bare"),
    "behind a hash": Layout(comment="# "),
    "behind a percent": Layout(comment="%"),
    "behind a semicolon": Layout(comment="; "),
    "behind slashes": Layout(comment="// "),
    "preamble": Layout(preamble=("Recorder 7, made in May", 'Operator "A', "Sensor: ADXL345", "")),
    "long preamble": Layout(preamble=tuple(f"note {i}" for i in range(600))),
    "preamble in cells": Layout(preamble=("Sensor{d}ADXL345{d}x{d}1", "Rate{d}3200", "")),
    "commented preamble": Layout(preamble=("# it's 5\" long", "# rate 3200"), comment="# "),
    "numbered rows": Layout(counter="named"),
    "pandas index": Layout(counter="pandas"),
    "R row names": Layout(counter="R", quoted=True),
    "delimiter at the end": Layout(trailing=True),
    "time last": Layout(clock_at=9, further=1),
    "time in the middle": Layout(clock_at=1, further=2),
    "Windows lines": Layout(newline="\r\n"),
    "old Mac lines": Layout(newline="\r"),
    "no zero before the point": Layout(leading_zero=False),
    "thousands": Layout(thousands="other", quoted_numbers=True),
    "narrow blanks in thousands": Layout(thousands="\u202f", delimiter=";"),
    "exponents": Layout(exponent="E"),
    "Fortran": Layout(exponent="D"),
    "remarks between rows": Layout(comment_within=True),
    "German": Layout(clock="Zeit", channel="Beschleunigung für Fuß", channel_unit="m/s²"),
    "since 1970": Layout(epoch=True, unit="us"),
    "ISO 8601": Layout(stamp="%Y-%m-%dT%H:%M:%S.%fZ"),
    "day, month, year": Layout(stamp="%d.%m.%Y %H:%M:%S.%f", clock="Datum"),
    "time of day": Layout(stamp="%H:%M:%S.%f", clock="Uhrzeit"),
    "no unit": Layout(heading="bare"),
    "no headings": Layout(heading="none"),
}  # fmt: skip
DIALECTS = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", ","))
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252")


def samples(further: int = 0) -> list[np.ndarray]:
    """Return the columns of samples of every file, the channel first: shape (40,) each."""
    t = np.arange(40.0)
    return [np.round(1500 * np.sin(t / 5 + 0.3) * (1 + k), 4) + 0.0625 for k in range(further + 1)]


def _digits(value: float, layout: Layout, places: int) -> str:
    text = f"{value:.10e}".replace("e", layout.exponent) if layout.exponent else f"{value:.{places}f}"
    if layout.thousands and not layout.exponent:
        sign = "," if layout.decimal == "." else "."
        text = f"{value:,.{places}f}".replace(",", "\0").replace(".", layout.decimal)
        return text.replace("\0", sign if layout.thousands == "other" else layout.thousands)
    if not layout.leading_zero:
        text = text.replace("-0.", "-.") if text.startswith("-") else text.removeprefix("0") or "0"
    return text.replace(".", layout.decimal)


def _stamped(after_s: float, layout: Layout) -> str:
    """Return a date or time of day, of a recording that goes on past midnight."""
    at = datetime(2026, 11, 30, 23, 59, 59, 995_000, tzinfo=UTC) + timedelta(seconds=after_s)
    text = at.strftime(layout.stamp)
    return re.sub(r"\.(?=[0-9]{6}Z?$)", "." if layout.delimiter == "," else layout.decimal, text)


def _heading(name: str, unit: str, layout: Layout) -> str:
    if not unit or layout.units_below or layout.heading in ("bare", "none"):
        return name
    if layout.heading == "word" and unit in SECONDS:
        return f"{name}_{WORDS[unit]}"
    if layout.heading == "camel":
        return f"{name}{unit.capitalize()}" if unit in SECONDS else f"{name} ({unit})"
    if unit not in SECONDS and layout.heading not in ("slash", "square", "brace", "break"):
        return f"{name} ({unit})"
    return SPELT[layout.heading].format(name=name, unit=unit)


def written(layout: Layout) -> bytes:
    """Return the bytes of a file in a layout."""
    d = layout.delimiter
    step = 1 / layout.rate_hz / SECONDS[layout.unit]
    start = 1.7e15 if layout.epoch else 0.0
    clock = [start + i * step for i in range(40)]
    signals = samples(layout.further)
    places = 0 if layout.epoch else {"s": 9, "ms": 6, "us": 3}[layout.unit]
    times = [f"{value:.0f}" if layout.epoch else _digits(value, layout, places) for value in clock]
    if layout.stamp:
        times = [_stamped(i / layout.rate_hz, layout) for i in range(40)]
    columns = [[_digits(value, layout, 4) for value in signal] for signal in signals]
    names = [layout.channel, *(f"more {k}" for k in range(layout.further))]
    heads = [(name, layout.channel_unit) for name in names]
    at = min(layout.clock_at, len(columns))
    columns.insert(at, times)
    heads.insert(at, (layout.clock, "" if layout.stamp else layout.unit))
    lines = [line.format(d=d) for line in layout.preamble]
    cells = [_heading(*head, layout) for head in heads]
    rows = [list(row) for row in zip(*columns, strict=True)]
    first: list[str] = []
    if layout.counter:
        rows = [[str(i), *row] for i, row in enumerate(rows, start=1)]
        first = {"named": ["No"], "pandas": [""], "R": []}[layout.counter]
    marks = ('"', '"') if layout.quoted or any(d in cell or "\n" in cell for cell in cells) else ("", "")
    if layout.heading != "none":
        lines.append(layout.comment + d.join(f"{marks[0]}{cell}{marks[1]}" for cell in (*first, *cells)))
    if layout.units_below:
        below = [f"({unit})" if layout.units_below == "bracket" else unit for _, unit in heads]
        lines.append(layout.comment + d.join(["", *below] if layout.counter in ("named", "pandas") else below))
    if layout.gap:
        lines.append("")
    body = [d.join(f'"{cell}"' if layout.quoted_numbers else cell for cell in row) for row in rows]
    body = [f"{line}{d}" for line in body] if layout.trailing else body
    if layout.comment_within:
        body.insert(20, "# the tap")
    text = layout.newline.join([*lines, *body, ""])
    return text.encode(layout.encoding)


def outcome(layout: Layout, folder: Path) -> Outcome:
    """Return what comes of reading a file in a layout; refused is one whose remedy, as it is pasted, reads it right."""
    path = folder / "recording.csv"
    path.write_bytes(written(layout))
    given: dict[str, str] = {}
    for attempt in range(4):
        encoding, decimal, unit, column = map(given.get, ("--encoding", "--decimal", "--time-unit", "--time-column"))
        stated = Stated(encoding, decimal, unit, column, ("palpate",))
        try:
            made = read(path, stated=stated)
        except RecordingError as error:
            remedy = error.finding.remedy
            if not isinstance(remedy, Remedy):
                return "wrong"
            given |= dict(zip(remedy.command[1::2], remedy.command[2::2], strict=True))
            continue
        says = layout.heading != "none"
        same = (
            np.array_equal(made.samples, samples()[0])
            and abs(made.rate_hz / layout.rate_hz - 1) < 2e-3
            and (made.channel == layout.channel or not says or layout.heading in ("blank", "in front"))
            and (made.unit == layout.channel_unit or not layout.says_unit)
        )
        return "wrong" if not same else "refused" if attempt else "right"
    return "wrong"


def corpus() -> Iterator[tuple[str, Layout]]:
    """Yield the name and the layout of every file: each layout in every dialect that can hold it."""
    turn = 0
    for name, layout in LAYOUTS.items():
        for delimiter, decimal in DIALECTS:
            turn += 1
            if delimiter == "," and layout.thousands == "\u202f":
                continue
            unit = layout.unit if layout.epoch else tuple(SECONDS)[turn % 3]
            # A code page without the sign of thousands cannot hold it.
            encoding = ENCODINGS[turn % (4 if layout.thousands == "\u202f" else 5)]
            made = replace(layout, delimiter=delimiter, decimal=decimal, unit=unit, encoding=encoding)
            yield f"{name}, {delimiter!r} {decimal!r} {unit} {encoding}", made


def rearranged(seed: int) -> Layout:
    """Return a random layout of the same data."""
    draw = random.Random(seed)
    base = LAYOUTS[draw.choice(list(LAYOUTS))]
    delimiter, decimal = draw.choice(DIALECTS)
    fixed = base.heading in ("none", "bare")
    headings = [one for one in ("word", "camel", *SPELT) if not (base.comment and one == "break")]
    heading = base.heading if fixed else draw.choice(headings)
    thousands = draw.choice(["", "", "other"]) if not base.exponent else ""
    return replace(
        base,
        delimiter=delimiter,
        decimal=decimal,
        unit=base.unit if base.epoch else draw.choice(list(SECONDS)),
        encoding=draw.choice(ENCODINGS[:4] if base.thousands == "\u202f" else ENCODINGS),
        heading=heading,
        clock=draw.choice(["time", "t", "Zeit", "elapsed"]) if heading not in ("camel", "word") else "time",
        stamp="" if base.epoch else base.stamp or draw.choice(["", "", "", "%Y-%m-%dT%H:%M:%S.%f"]),
        quoted=base.quoted or heading == "break" or draw.random() < 0.3,
        thousands=thousands,
        quoted_numbers=base.quoted_numbers or thousands != "" or draw.random() < 0.2,
        newline=draw.choice(["\n", "\r\n", "\r"]),
        trailing=base.trailing or draw.random() < 0.2,
        clock_at=draw.randrange(3) if heading != "none" else 0,
        further=draw.randrange(3) if heading != "none" else 0,
        leading_zero=draw.random() < 0.7,
        comment_within=draw.random() < 0.2,
        gap=draw.random() < 0.2,
        rate_hz=draw.choice([1000.0, 3200.0, 8192.0, 48_000.0]) if not base.epoch else 1000.0,
    )


if __name__ == "__main__":
    with TemporaryDirectory() as place:
        print(Counter(outcome(layout, Path(place)) for _, layout in corpus()))
        made = {seed: outcome(rearranged(seed), Path(place)) for seed in range(int(sys.argv[1]))}
        print(Counter(made.values()), [seed for seed, one in made.items() if one == "wrong"][:20])
