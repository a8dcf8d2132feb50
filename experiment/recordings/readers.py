"""Any recording from disk: WAV, text columns with a column of times, or a LabVIEW measurement file (.lvm).

The content decides the format. The rate is that of a column of times if there is one; a header's is only reported.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.wav import wav_samples

LARGEST_STEP_ERROR = 0.5
"""How far a time step may be from the median step, and a sample from its place on an even grid, in steps."""

LARGEST = 64 * 2**20
"""No recording is read that is larger, bytes: 11 minutes of 16 bits at 48 kHz. Its samples take eight times that."""

_LVM_TAG = re.compile(r"(?!nan$|inf$|infinity$)[A-Za-z]\w*", re.IGNORECASE)
_DIALECTS = [(separator, decimal) for separator in ("\t", ";", ",", None) for decimal in ".," if separator != decimal]
# No match begins inside of blanks, so that many of them take no longer than as many letters.
_COMMENT = re.compile(r"(?<!\s)\s*(#|%|;|//)")
_UNIT = re.compile(r"(?P<name>.*?)(?<!\s)\s*[\(\[](?P<unit>[^()\[\]]*)[\)\]]\s*")
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_TIME = re.compile(r"(?:t|(?:.*[\s_.-])?(?:times?|timestamp|zeit|x_value))(?:[\s_.-].*)?", re.IGNORECASE)
_UNIT_SUFFIX = re.compile(r".*[\s_](s|ms|us|ns)", re.IGNORECASE)
_SAYS_NOTHING = ("", "x", "s", "sec", "seconds", "untitled")
"""Headings under which a rising first column may be taken for times; LabVIEW calls nameless channels Untitled."""


@dataclass(frozen=True)
class Recording:
    """One channel of a recording, evenly sampled.

    `channels` are all with samples, in order. `samples` are finite, float64, shape (n,), in `unit`, empty if unknown.
    `rate_source` is where the rate is from, `header_rate_hz` what a header claims beside a column of times. `jitter` is
    the largest departure from the even grid, in steps; 0 without times. The first of `segments` is read.
    """

    file: str
    channel: str
    channels: tuple[str, ...]
    samples: NDArray[np.float64]
    unit: str
    rate_hz: float
    rate_source: str
    header_rate_hz: float | None = None
    jitter: float = 0.0
    segments: int = 1


@dataclass(frozen=True)
class _Column:
    """One column: heading, finite values, their lines from 1; in LabVIEW a time step (NaN for none) and a dimension."""

    name: str
    unit: str
    values: NDArray[np.float64]
    lines: Sequence[int]
    step: float = np.nan
    dimension: str = "Time"


_Rows = list[tuple[int, list[str]]]
"""Each row's line, from 1, and its cells."""

_Table = tuple[list[_Column], Sequence[_Column | None], int]
"""Channels, the column of times of each (None where it has none), and the number of segments."""


def read(path: Path, *, channel: str | None = None) -> Recording:
    """Return one channel of a recording: the one of this name or number (from 1), or the first.

    Raises `RecordingError`, with a line if any, for an unreadable file, a missing channel, samples that are not finite,
    and times that are missing or uneven.
    """
    try:
        content = storage.read_bytes(path, LARGEST)
    except OSError as error:
        raise RecordingError(
            path,
            f"cannot be read ({error.strerror})",
            "cut it, or name another file",
            allowed=f"a WAV, .lvm or text file of at most {LARGEST // 2**20} MiB",
        ) from error
    if content[:4] in (b"RIFF", b"RIFX", b"RF64"):
        return _from_wav(path, *wav_samples(content, file=str(path)), channel)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    table = _from_lvm if text.startswith("LabVIEW Measurement") else _from_columns
    try:
        return _recording(str(path), channel, *table(text.splitlines()))
    except RecordingError as error:
        raise RecordingError.at(replace(error.finding, where=path)) from None


def _from_wav(path: Path, rate_hz: int, stored: NDArray[Any], channel: str | None) -> Recording:
    table = stored[:, None] if stored.ndim == 1 else stored
    names = tuple(f"channel {i + 1}" for i in range(table.shape[1]))
    try:
        place = _chosen(names, channel)
    except RecordingError as error:
        raise RecordingError.at(replace(error.finding, where=path)) from None
    samples, unit = table[:, place].astype(np.float64), ""
    if stored.dtype.kind != "f":
        zero = 128.0 if stored.dtype == np.uint8 else 0.0
        samples -= zero
        samples /= 2.0 ** (8 * stored.dtype.itemsize - 1)
        unit = "full scale"
    if not np.all(np.isfinite(samples)):
        at = int(np.flatnonzero(~np.isfinite(samples))[0])
        raise RecordingError(path, f"sample {at}: got {samples[at]}", "record it again", allowed="finite numbers")
    return Recording(str(path), names[place], names, samples, unit, float(rate_hz), "WAV header")


def _chosen(names: tuple[str, ...], channel: str | None) -> int:
    if channel is None:
        return 0
    if channel in names:
        return names.index(channel)
    if channel.isdecimal() and 1 <= int(channel) <= len(names):
        return int(channel) - 1
    raise RecordingError(
        f"got channel {channel!r}",
        remedy="choose one of them",
        allowed=f"{', '.join(names)}, or a number from 1 to {len(names)}",
    )


def _number(cell: str, decimal: str) -> float:
    """Return the finite number in a cell, which may have a Fortran exponent; NaN where there is none."""
    if "_" in cell or (decimal == "," and "." in cell):
        return np.nan
    try:
        value = float(cell.replace(decimal, ".").lower().replace("d", "e"))
    except ValueError:
        return np.nan
    return value if isfinite(value) else np.nan


def _name_and_unit(heading: str) -> tuple[str, str]:
    """Return `("time", "s")` for `# time (s)`; the unit is empty where the heading gives none."""
    text = _COMMENT.sub("", heading).strip().strip('"')
    match = _UNIT.fullmatch(text)
    return (match["name"].strip(), match["unit"].strip()) if match else (text, "")


def _from_columns(lines: list[str]) -> _Table:
    headings, decimal, rows = _rows_below(lines)
    columns = [
        _Column(name, unit, *_values(rows, place, name or f"{place + 1}", decimal))
        for place, (name, unit) in enumerate(_named(headings, len(rows[0][1])))
    ]
    at = next((place for place, column in enumerate(columns) if _TIME.fullmatch(column.name)), None)
    if at is None:
        _look_like_times(columns[0])
    signals = [replace(column, name=column.name or f"column {i}") for i, column in enumerate(columns, start=1)]
    del signals[at or 0]
    return signals, [columns[at or 0]] * len(signals), 1


def _rows_below(lines: list[str]) -> tuple[list[str], str, _Rows]:
    """Return the headings of a file of columns, its decimal point, and its rows of cells."""
    headings: list[str] = []
    dialect: tuple[str | None, str] | None = None
    rows: _Rows = []
    for place, line in enumerate(lines, start=1):
        comment = bool(_COMMENT.match(line))
        if not line.strip() or (dialect and comment):
            continue
        dialect = dialect or (None if comment else _dialect(line))
        if dialect is None:
            headings.append(line)
            continue
        cells = _split(line, dialect[0])
        filled = sum(bool(cell.strip()) for cell in cells)
        if rows and filled != len(rows[0][1]):
            raise RecordingError(
                f"got {filled} numbers",
                remedy="correct or remove the line",
                allowed=f"{len(rows[0][1])}, as in line {rows[0][0]}",
                line=place,
            )
        rows.append((place, cells))
    if dialect is None:
        raise RecordingError(
            "got no line of two or more numbers",
            remedy="name another file",
            allowed="WAV, LabVIEW .lvm, or text columns with a column of times",
        )
    return headings, dialect[1], rows


def _split(line: str, separator: str | None) -> list[str]:
    cells = line.strip().split(separator)
    # A separator that ends every line makes no further column.
    return cells[:-1] if len(cells) > 1 and not cells[-1].strip() else cells


def _dialect(line: str) -> tuple[str | None, str] | None:
    for separator, decimal in _DIALECTS:
        cells = _split(line, separator)
        if len(cells) >= 2 and all(isfinite(_number(cell, decimal)) for cell in cells):
            return separator, decimal
    return None


def _named(headings: list[str], columns: int) -> list[tuple[str, str]]:
    """Return names and units from the last heading line that has as many cells as there are columns."""
    for line in reversed(headings):
        bare = _COMMENT.sub("", line).strip()
        for pattern in (r"\t", ";", ",", r"\s{2,}", r"\s+"):
            cells = [cell.strip(" \t,;") for cell in re.split(pattern, bare) if cell.strip(" \t,;")]
            if len(cells) == columns:
                return [_name_and_unit(cell) for cell in cells]
    return [("", "")] * columns


@dataclass
class _Segment:
    """What was read of a segment so far: tags of its header, channels' headings, and rows."""

    tags: dict[str, list[str]] = field(default_factory=dict)
    headings: list[str] = field(default_factory=list)
    rows: _Rows = field(default_factory=list)


def _from_lvm(lines: list[str]) -> _Table:
    separator, decimal, header = _lvm_header(lines)
    segments = _lvm_segments(lines, header, separator, decimal)
    found = [channels for one in segments if (channels := _lvm_channels(one, decimal))[0]]
    if not found:
        raise RecordingError(
            "got a LabVIEW header without samples",
            remedy="export the measurement again",
            allowed="rows below a line that begins with X_Value",
        )
    signals, times = found[0]
    split = [_name_and_unit(signal.name) for signal in signals]
    at = next((place for place, (name, _) in enumerate(split) if _TIME.fullmatch(name)), None)
    if at is None and times[0] is None and _rises_evenly(signals[0]):
        at = 0
    if at is not None and len(signals) > 1:
        # The unit of a channel stands in its tag, but that of a time often in its name alone.
        own = replace(signals.pop(at), name=split[at][0], unit=split[at][1])
        times = [own] * len(signals)
    return signals, times, len(found)


def _lvm_header(lines: list[str]) -> tuple[str, str, int]:
    """Return the cells' separator, the decimal separator, and how many lines the file's header takes."""
    tags: dict[str, str] = {}
    for place, line in enumerate(lines, start=1):
        tag, _, value = re.split(r"([\t,]|$)", line, maxsplit=1)
        if tag.strip() == "***End_of_Header***":
            named = tags.get("Separator", "Tab")
            separator = {"tab": "\t", "comma": ","}.get(named.lower())
            decimal = tags.get("Decimal_Separator") or "."
            if separator is None or decimal not in (".", ",") or separator == decimal:
                raise RecordingError(
                    f"got Separator {named!r} with Decimal_Separator {decimal!r}",
                    remedy="export the measurement again",
                    allowed="Tab or Comma, with '.' or, after Tab, ','",
                )
            return separator, decimal, place
        # `Decimal_Separator<Tab>,` holds the other separator as its value; `Separator,Comma` may be followed by commas.
        tags[tag.strip()] = value.strip() if value.strip() == "," else value.strip("\t, ")
    raise RecordingError(
        "got a LabVIEW header without its end", remedy="export it again", allowed="a line ***End_of_Header***"
    )


def _lvm_segments(lines: list[str], header: int, separator: str, decimal: str) -> list[_Segment]:
    segments: list[_Segment] = []
    current, in_rows, special, header_at = _Segment(), False, False, 0
    for place, line in enumerate(lines[header:], start=header + 1):
        cells = [cell.strip() for cell in line.split(separator)]
        if special or cells[0] == "***Start_Special***":
            special = cells[0] != "***End_Special***"
        elif not any(cells) or cells[0] == "***End_of_Header***":
            continue
        elif cells[0] == "X_Value":
            current.headings, in_rows = cells, True
            segments.append(current)
        elif in_rows and not _LVM_TAG.fullmatch(cells[0]):
            current.rows.append((place, cells))
        else:
            if in_rows:
                current, in_rows, header_at = _Segment(), False, place
            if isfinite(_number(cells[0], decimal)):
                raise RecordingError(
                    "got numbers in a header",
                    remedy="correct the file",
                    allowed="numbers below a line that begins with "
                    f"X_Value{f'; line {header_at} began this header' if header_at else ''}",
                    line=place,
                )
            current.tags[cells[0]] = cells
    if not in_rows and header_at:
        raise RecordingError(
            "got a segment's header without rows",
            remedy="remove the lines from there on",
            allowed="a line that begins with X_Value and rows below it",
            line=header_at,
        )
    return segments


def _lvm_channels(segment: _Segment, decimal: str) -> tuple[list[_Column], list[_Column | None]]:
    """Return the channels that hold samples, and the column of times to the left of each, None where it is empty."""
    headings = list(segment.headings)
    while headings and headings[-1] in ("", "Comment"):
        headings.pop()
    signals: list[_Column] = []
    times: list[_Column | None] = []
    clock: _Column | None = None
    for place, name in enumerate(headings):
        values, lines = _values(segment.rows, place, name, decimal)
        if name == "X_Value":
            clock = _Column(name, "", values, lines) if lines else None
        elif lines:
            # A tag stands above the column that it describes.
            unit, step, dimension = (
                cells[place] if place < len(cells := segment.tags.get(tag, [])) else ""
                for tag in ("Y_Unit_Label", "Delta_X", "X_Dimension")
            )
            signals.append(_Column(name, unit, values, lines, _number(step, decimal), dimension or "Time"))
            times.append(clock)
    return signals, times


def _values(rows: _Rows, place: int, name: str, decimal: str) -> tuple[NDArray[np.float64], list[int]]:
    """Return the filled cells of a column, shape (n,), and their lines; cells may be empty at its end only."""
    values: list[float] = []
    empty_at = 0
    for line, row in rows:
        cell = row[place].strip() if place < len(row) else ""
        if not cell:
            empty_at = empty_at or line
            continue
        values.append(_number(cell, decimal))
        if np.isnan(values[-1]) or empty_at:
            wrong = f"{cell[:40]!r} in column {name!r}"
            got = wrong if np.isnan(values[-1]) else f"column {name!r} empty in line {empty_at}"
            raise RecordingError(
                f"got {got}",
                remedy="correct the line, or export the measurement again",
                allowed="a number in every row, and empty cells only at the end of a column",
                line=line,
            )
    return np.array(values), [line for line, _ in rows[: len(values)]]


def _recording(
    file: str, channel: str | None, signals: list[_Column], times: Sequence[_Column | None], segments: int
) -> Recording:
    """Return the channel asked for, at the rate of its column of times, or of its header where it has none."""
    names = tuple(signal.name for signal in signals)
    place = _chosen(names, channel)
    chosen, clock = signals[place], times[place]
    if chosen.dimension.lower() != "time":
        raise RecordingError(
            f"channel {chosen.name!r} stands over {chosen.dimension}", remedy="choose another channel", allowed="Time"
        )
    claimed_hz = 1 / chosen.step if chosen.step > 0 and isfinite(1 / chosen.step) else None
    if clock is not None:
        count = chosen.values.size
        if clock.values.size < count:
            raise RecordingError(
                "got a sample without a time",
                remedy="export the measurement again",
                allowed="a time in every row",
                line=chosen.lines[clock.values.size],
            )
        rate_hz, jitter = _even(replace(clock, values=clock.values[:count]))
        source = f"time column {clock.name!r}" if clock.name else "first column"
    elif claimed_hz is not None:
        rate_hz, jitter, claimed_hz = claimed_hz, 0.0, None
        source = "header (Delta_X), no time column to check it against"
    else:
        raise RecordingError(
            "got neither an X column nor a Delta_X above zero",
            remedy="export the measurement with X_Columns One",
            allowed="a column of times",
        )
    of_channel = (file, chosen.name, names, chosen.values, chosen.unit)
    return Recording(*of_channel, rate_hz, source, claimed_hz, jitter, segments)


def _rises_evenly(column: _Column) -> bool:
    try:
        _look_like_times(column)
        _even(column)
    except RecordingError:
        return False
    return True


def _look_like_times(first: _Column) -> None:
    """Refuse a first column that no heading calls a time and that does not look like times."""
    with np.errstate(over="ignore"):
        steps = np.diff(first.values)
    what = ""
    if first.name.lower() not in _SAYS_NOTHING and first.unit.lower() not in _SECONDS:
        what = f"{first.name!r}"
    elif np.any(steps <= 0):
        what = "values that do not rise"
    elif steps.size and np.all(steps == 1):
        what = "a counter of samples"
    if what:
        raise RecordingError(
            f"got {what} in the first column and no column named time",
            remedy="write a heading such as 'time (s), acceleration (g)'",
            allowed="a column of times",
            line=first.lines[0],
        )


def _even(times: _Column) -> tuple[float, float]:
    """Return the sampling rate in Hz of a column of times, and the largest departure from an even grid in steps."""
    suffix = _UNIT_SUFFIX.fullmatch(times.name)
    unit = (times.unit or (suffix[1] if suffix else "s")).lower()
    if unit not in _SECONDS:
        raise RecordingError(f"got times in {unit!r}", remedy="correct the heading", allowed=", ".join(_SECONDS))
    t = times.values * _SECONDS[unit]
    if t.size < 2:
        raise RecordingError(f"got {t.size} rows", remedy="record longer", allowed="two or more, for a sampling rate")
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(t)
        median = float(np.median(steps))
        worst = int(np.argmax(np.abs(steps - median)))
        if not (0 < median < np.inf and abs(steps[worst] - median) <= LARGEST_STEP_ERROR * median):
            raise RecordingError(
                f"got a time step of {steps[worst]:g} s",
                remedy="record without gaps or resample it evenly",
                allowed=f"within {LARGEST_STEP_ERROR:.0%} of the median step, {median:g} s",
                line=times.lines[worst + 1],
            )
        mean = float((t[-1] - t[0]) / steps.size)
        off = np.abs(t - (t[0] + mean * np.arange(t.size))) / mean
    at = int(np.argmax(off))
    if not off[at] <= LARGEST_STEP_ERROR:
        raise RecordingError(
            f"got a sample {off[at]:.1f} steps away from an even grid",
            remedy="record at a steady rate or resample it evenly",
            allowed=f"{LARGEST_STEP_ERROR} steps",
            line=times.lines[at],
        )
    if not np.isfinite(1 / mean):
        raise RecordingError(f"got time steps of {mean:g} s", remedy="correct the unit of time", allowed="longer ones")
    return 1 / mean, float(off[at])
