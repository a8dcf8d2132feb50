"""Any recording from disk: WAV, text columns with a time column, or a LabVIEW measurement file (.lvm).

What a file is, its content tells, not its name. The sampling rate is that of the time column wherever there is one: a
rate in a header may lie, and is only reported beside it.

The samples of a WAV file as they are stored.

Numbers in text columns, separated by tabs, semicolons, commas or blanks, with decimal points or decimal commas.

The first line that reads as two numbers or more decides how all later lines are read. Lines before it are headings;
blank lines and comments (#, %, ;, //) may stand anywhere.

LabVIEW measurement files (.lvm): a file header, then segments, each with a header of its own and rows of cells.

Facts from the manufacturer's specification and from files in the wild: tags stand in the first cell of a line, in any
order, unknown tags are to be passed over, `***End_of_Header***` ends a header, `***Start_Special***` to
`***End_Special***` is a block of another kind. Every segment names its channels in a line that begins with `X_Value`
and may end with `Comment`. `X_Columns` is `One` (one column of times), `Multi` (one before each channel) or `No` (the
cell is there and empty). Version 1 files have no `Decimal_Separator`. A channel with fewer samples has empty cells.
"""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from experiment.errors import RecordingError


def wav_samples(content: bytes, *, file: str) -> tuple[int, NDArray[Any]]:
    """Decode a WAV file.

    Args:
        content: the file's bytes.
        file: how an error names it.

    Returns:
        Sampling rate in Hz, and the samples in their own type, shape (n,) or (n, channels).

    Raises:
        RecordingError: no WAV file, a damaged or truncated one, or one without samples.
    """
    try:
        with warnings.catch_warnings():
            # A file shorter than its header says is only warned about; a chunk of metadata is harmless.
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=r"Chunk \(non-data\) not understood")
            rate_hz, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:
        # scipy meets a damaged header with whatever the broken number leads to: ZeroDivisionError, TypeError, ...
        detail = " ".join(str(error).split()).rstrip(".")
        raise RecordingError(
            f"{file}: got a WAV file that cannot be decoded ({detail}); allowed: whole PCM or float; export it again"
        ) from error
    if rate_hz < 1 or samples.size == 0:
        raise RecordingError(
            f"{file}: got {samples.size} samples at {rate_hz} Hz; allowed: one or more at 1 Hz or more; export it again"
        )
    return int(rate_hz), np.asarray(samples)


_SEPARATORS = ("\t", ";", ",", None)
_DIALECTS = tuple(
    (separator, decimal) for separator in _SEPARATORS for decimal in (".", ",") if (separator, decimal) != (",", ",")
)
_COMMENT = re.compile(r"\s*(#|%|;|//)")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
_UNIT = re.compile(r"(?P<name>.*?)\s*[\(\[](?P<unit>[^()\[\]]*)[\)\]]\s*")


@dataclass(frozen=True)
class Column:
    """One channel of a file, or its time.

    Attributes:
        name: as the heading gives it, without the unit; empty where there is no heading.
        unit: as the heading gives it; empty where it gives none.
        values: shape (n,).
        lines: line of the file on which each value stands, from 1, shape (n,).
    """

    name: str
    unit: str
    values: NDArray[np.float64]
    lines: NDArray[np.int64]


def number(text: str, *, decimal: str = ".") -> float | None:
    """The number that `text` spells, or None. Words such as `nan` and `inf` are no numbers.

    Args:
        text: one cell.
        decimal: the decimal separator, a point or a comma.
    """
    text = text.strip()
    if decimal != ".":
        if "." in text:
            return None
        text = text.replace(decimal, ".")
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text.lower().replace("d", "e"))
    return value if isfinite(value) else None


def name_and_unit(heading: str) -> tuple[str, str]:
    """`("time", "s")` for `# time (s)`; the unit is empty where the heading gives none."""
    text = _COMMENT.sub("", heading).strip().strip('"')
    match = _UNIT.fullmatch(text)
    return (match["name"].strip(), match["unit"].strip()) if match else (text, "")


def parse_columns(text: str, *, file: str) -> list[Column]:
    """Read every column of a text file.

    Args:
        text: of the file.
        file: how an error names it.

    Returns:
        Two columns or more, all of one length.

    Raises:
        RecordingError: no line of numbers, or a later line with another number of cells or a cell that is no number.
    """
    headings: list[str] = []
    dialect: tuple[str | None, str] | None = None
    rows: list[list[float]] = []
    lines: list[int] = []
    for place, line in enumerate(text.splitlines(), start=1):
        comment = bool(_COMMENT.match(line))
        if not line.strip() or (dialect and comment):
            continue
        if dialect is None:
            dialect = None if comment else _dialect(line)
            if dialect is None:
                headings.append(line)
                continue
        cells = _split(line, dialect[0])
        values = [number(cell, decimal=dialect[1]) for cell in cells]
        wrong = next((cell for cell, value in zip(cells, values, strict=True) if value is None), None)
        if wrong is not None:
            raise RecordingError(
                f"{file}: line {place}: got {wrong.strip()[:40]!r}; allowed: a number in each of "
                f"{len(rows[0]) if rows else len(cells)} columns; correct or remove the line"
            )
        if rows and len(values) != len(rows[0]):
            raise RecordingError(
                f"{file}: line {place}: got {len(values)} numbers; allowed: {len(rows[0])}, as in line {lines[0]}; "
                "correct or remove the line"
            )
        rows.append([value for value in values if value is not None])
        lines.append(place)
    if not rows:
        raise RecordingError(
            f"{file}: got no line of two or more numbers; allowed: WAV, LabVIEW .lvm, or text columns with a time "
            "column; name another file"
        )
    table = np.array(rows)
    named = _named(headings, len(rows[0]))
    where = np.array(lines)
    return [Column(*named[i], values=table[:, i], lines=where) for i in range(table.shape[1])]


def _split(line: str, separator: str | None) -> list[str]:
    cells = line.strip().split(separator)
    # A separator that ends every line makes no further column.
    return cells[:-1] if len(cells) > 1 and not cells[-1].strip() else cells


def _dialect(line: str) -> tuple[str | None, str] | None:
    for separator, decimal in _DIALECTS:
        cells = _split(line, separator)
        if len(cells) >= 2 and all(number(cell, decimal=decimal) is not None for cell in cells):
            return separator, decimal
    return None


def _named(headings: list[str], columns: int) -> list[tuple[str, str]]:
    """Names from the last heading line that has as many cells as there are columns."""
    for line in reversed(headings):
        bare = _COMMENT.sub("", line)
        for pattern in (r"\t", ";", ",", r"\s{2,}", r"\s+"):
            cells = [cell for cell in re.split(pattern, bare.strip()) if cell.strip(" \t,;")]
            if len(cells) == columns:
                return [name_and_unit(cell.strip(" \t,;")) for cell in cells]
    return [("", "")] * columns


MAGIC = "LabVIEW Measurement"
_LVM_SEPARATORS = {"tab": "\t", "comma": ","}
_TAG = re.compile(r"(?!nan$|inf$|infinity$)[A-Za-z]\w*", re.IGNORECASE)


@dataclass(frozen=True)
class Channel:
    """One channel of a segment.

    Attributes:
        samples: its values.
        times: the X column of the channel, in the X column's unit; None where the file has none.
        step: `Delta_X` of the segment's header; None where it gives none. It may lie.
        dimension: `X_Dimension` of the header, `Time` unless it says otherwise.
    """

    samples: Column
    times: Column | None
    step: float | None
    dimension: str


@dataclass
class _Segment:
    """What was read of a segment so far; cells per row, as they stand."""

    tags: dict[str, list[str]] = field(default_factory=dict)
    headings: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def parse_lvm(text: str, *, file: str) -> list[list[Channel]]:
    """Read every segment of a LabVIEW measurement file.

    Args:
        text: of the file.
        file: how an error names it.

    Returns:
        Channels of each segment that holds any samples; at least one segment with one channel.

    Raises:
        RecordingError: no end of the header, an unknown separator, a cell that is no number, or no samples.
    """
    separator, decimal, body = _file_header(text.splitlines(), file)
    segments: list[_Segment] = []
    current, in_rows, special, header_at = _Segment(), False, False, 0
    for place, line in body:
        cells = [cell.strip() for cell in line.split(separator)]
        if special or cells[0] == "***Start_Special***":
            special = cells[0] != "***End_Special***"
        elif not any(cells) or cells[0] == "***End_of_Header***":
            continue
        elif cells[0] == "X_Value":
            current.headings, in_rows = cells, True
            segments.append(current)
        elif in_rows and not _TAG.fullmatch(cells[0]):
            current.rows.append(cells)
            current.lines.append(place)
        else:
            if in_rows:
                current, in_rows, header_at = _Segment(), False, place
            if number(cells[0], decimal=decimal) is not None:
                raise RecordingError(
                    f"{file}: line {place}: got numbers in a header; allowed: numbers below a line that begins with "
                    f"X_Value{f'; line {header_at} began this header' if header_at else ''}; correct the file"
                )
            current.tags[cells[0]] = cells[1:]
    if not in_rows and header_at:
        raise RecordingError(
            f"{file}: line {header_at}: got a segment's header without rows; allowed: a line that begins with X_Value "
            "and rows below it; remove the lines from there on"
        )
    channels = [_channels(segment, decimal=decimal, file=file) for segment in segments]
    with_samples = [found for found in channels if found]
    if not with_samples:
        raise RecordingError(
            f"{file}: got a LabVIEW header without samples; allowed: rows below a line that begins with X_Value; "
            "export the measurement again"
        )
    return with_samples


def _file_header(lines: list[str], file: str) -> tuple[str, str, list[tuple[int, str]]]:
    """Separator, decimal separator, and the numbered lines below the file's header."""
    tags: dict[str, str] = {}
    for place, line in enumerate(lines, start=1):
        tag, _, value = (part.strip() for part in _first_cell(line))
        if tag == "***End_of_Header***":
            named = tags.get("Separator", "Tab")
            separator = _LVM_SEPARATORS.get(named.lower())
            decimal = tags.get("Decimal_Separator") or "."
            if separator is None or decimal not in (".", ",") or separator == decimal:
                raise RecordingError(
                    f"{file}: got Separator {named!r} with Decimal_Separator {decimal!r}; allowed: Tab or Comma, with "
                    "'.' or, after Tab, ','; export the measurement again"
                )
            return separator, decimal, list(enumerate(lines, start=1))[place:]
        tags[tag] = value
    raise RecordingError(
        f"{file}: got a LabVIEW header without its end; allowed: a line ***End_of_Header***; export it again"
    )


def _first_cell(line: str) -> tuple[str, str, str]:
    """First cell, separator and rest, before the separator is known."""
    match = re.match(r"([^\t,]*)([\t,]?)(.*)", line)
    tag, found, rest = match.groups() if match else (line, "", "")
    # `Decimal_Separator<Tab>,` holds the other separator as its value; `Separator,Comma` may be followed by commas.
    return tag, found, rest if rest.strip() == "," else rest.rstrip("\t, ")


def _channels(segment: _Segment, *, decimal: str, file: str) -> list[Channel]:
    headings = list(segment.headings)
    while headings and headings[-1] in ("", "Comment"):
        headings.pop()
    multi = headings.count("X_Value") > 1
    found = []
    for place, name in enumerate(headings):
        if name == "X_Value":
            continue
        at_times = place - 1 if multi else 0
        samples = _column(
            segment, place, name=name, unit=_tag(segment, "Y_Unit_Label", place), decimal=decimal, file=file
        )
        if not samples.values.size:
            continue
        times = _column(segment, at_times, name="X_Value", unit="", decimal=decimal, file=file)
        step = number(_tag(segment, "Delta_X", place), decimal=decimal)
        dimension = _tag(segment, "X_Dimension", place) or "Time"
        found.append(Channel(samples, times if times.values.size else None, step, dimension))
    return found


def _tag(segment: _Segment, tag: str, place: int) -> str:
    """What a tag says of the channel in column `place`: tags stand above their column."""
    values = segment.tags.get(tag, [])
    return values[place - 1] if 0 < place <= len(values) else ""


def _column(segment: _Segment, place: int, *, name: str, unit: str, decimal: str, file: str) -> Column:
    """The filled cells of a column; cells may be empty at its end only."""
    values: list[float] = []
    empty_at: int | None = None
    for row, line in zip(segment.rows, segment.lines, strict=True):
        cell = row[place] if place < len(row) else ""
        if not cell:
            empty_at = empty_at or line
            continue
        value = number(cell, decimal=decimal)
        if value is None or empty_at is not None:
            got = f"{cell[:40]!r} in column {name!r}" if value is None else f"column {name!r} empty in line {empty_at}"
            raise RecordingError(
                f"{file}: line {line}: got {got}; allowed: a number in every row, empty cells at the end only; "
                "export the measurement again"
            )
        values.append(value)
    return Column(
        name, unit, np.array(values, dtype=np.float64), np.array(segment.lines[: len(values)], dtype=np.int64)
    )


LARGEST_STEP_ERROR = 0.5
"""How far a time step may be from the median step, and a sample from its place on an even grid, in steps."""

_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_TIME = re.compile(r"(?:t|(?:.*[\s_.-])?(?:times?|timestamp|zeit|x_value))(?:[\s_.-].*)?", re.IGNORECASE)
_UNIT_SUFFIX = re.compile(r".*[\s_](s|ms|us|ns)", re.IGNORECASE)
_SAYS_NOTHING = ("", "x", "s", "sec", "seconds", "untitled")
"""Headings under which a rising first column may be taken for times; LabVIEW calls nameless channels Untitled."""


@dataclass(frozen=True)
class Recording:
    """One channel of a recording, evenly sampled.

    Attributes:
        file: as it was named.
        channel: the channel's name.
        channels: names of all channels that hold samples, in the file's order.
        samples: finite, in `unit`, float64, shape (n,).
        unit: as the file gives it; empty where it gives none.
        rate_hz: sampling rate, Hz.
        rate_source: what the rate was taken from.
        header_rate_hz: what a header claims, where both a header and a time column speak; else None.
        jitter: largest departure of a sample from the even grid, in steps; 0 without a time column.
        segments: segments of the file that hold samples; the first is read.
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


def read(path: Path, *, channel: str | None = None) -> Recording:
    """Read one channel of a recording.

    Args:
        path: the file.
        channel: name of the channel, or its number from 1 in the file's order; None for the first.

    Raises:
        RecordingError: a file that cannot be read or understood, no such channel, samples that are not finite, no
            time column, or times that do not rise in even steps; with the line where there is one.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read ({error.strerror}); allowed: a WAV, .lvm or text file; name another file"
        ) from error
    if content[:4] in (b"RIFF", b"RIFX", b"RF64"):
        return _from_wav(content, file=str(path), channel=channel)
    text = _decoded(content)
    if text.startswith(MAGIC):
        return _from_lvm(text, file=str(path), channel=channel)
    return _from_columns(text, file=str(path), channel=channel)


def _decoded(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _from_wav(content: bytes, *, file: str, channel: str | None) -> Recording:
    rate_hz, stored = wav_samples(content, file=file)
    table = stored[:, None] if stored.ndim == 1 else stored
    names = tuple(f"channel {i + 1}" for i in range(table.shape[1]))
    place = _chosen(names, channel, file=file)
    samples, unit = table[:, place].astype(np.float64), ""
    if stored.dtype.kind != "f":
        zero = 128.0 if stored.dtype == np.uint8 else 0.0
        samples, unit = (samples - zero) / 2.0 ** (8 * stored.dtype.itemsize - 1), "full scale"
    if not np.all(np.isfinite(samples)):
        at = int(np.flatnonzero(~np.isfinite(samples))[0])
        raise RecordingError(f"{file}: sample {at}: got {samples[at]}; allowed: finite numbers; record it anew")
    return Recording(file, names[place], names, samples, unit, float(rate_hz), "WAV header")


def _from_columns(text: str, *, file: str, channel: str | None) -> Recording:
    columns = parse_columns(text, file=file)
    at = next((i for i, column in enumerate(columns) if _TIME.fullmatch(column.name)), None)
    if at is None:
        at = 0
        _look_like_times(columns[0], file=file)
    names = tuple(column.name or f"column {i + 1}" for i, column in enumerate(columns) if i != at)
    place = _chosen(names, channel, file=file)
    chosen = [column for i, column in enumerate(columns) if i != at][place]
    rate_hz, jitter = _even(columns[at], file=file)
    source = f"time column {columns[at].name!r}" if columns[at].name else "first column"
    return Recording(file, names[place], names, chosen.values, chosen.unit, rate_hz, source, None, jitter)


def _from_lvm(text: str, *, file: str, channel: str | None) -> Recording:
    segments = parse_lvm(text, file=file)
    channels = segments[0]
    at = _times_among(channels, file=file)
    signals = [found for i, found in enumerate(channels) if i != at]
    names = tuple(found.samples.name or f"channel {i + 1}" for i, found in enumerate(signals))
    place = _chosen(names, channel, file=file)
    chosen = signals[place]
    if chosen.dimension.lower() != "time":
        raise RecordingError(
            f"{file}: channel {names[place]!r} stands over {chosen.dimension}; allowed: Time; choose another channel"
        )
    claimed_hz = 1 / chosen.step if chosen.step is not None and chosen.step > 0 else np.inf
    header_rate_hz = claimed_hz if np.isfinite(claimed_hz) else None
    times = chosen.times if at is None else _heading_split(channels[at].samples)
    if times is not None:
        rate_hz, jitter = _even(_cut(times, chosen, file=file), file=file)
        source = f"time column {times.name!r}"
    elif header_rate_hz is not None:
        rate_hz, jitter, header_rate_hz = header_rate_hz, 0.0, None
        source = "header (Delta_X), no time column to check it against"
    else:
        raise RecordingError(
            f"{file}: got neither an X column nor a Delta_X above zero; allowed: a column of times; "
            "export the measurement with X_Columns One"
        )
    return Recording(
        file,
        names[place],
        names,
        chosen.samples.values,
        chosen.samples.unit,
        rate_hz,
        source,
        header_rate_hz,
        jitter,
        len(segments),
    )


def _times_among(channels: list[Channel], *, file: str) -> int | None:
    """Which channel holds times: one named so or, in a file without X column, a first one that rises in even steps."""
    if len(channels) < 2:
        return None
    for i, found in enumerate(channels):
        if _TIME.fullmatch(_heading_split(found.samples).name):
            return i
    first = channels[0]
    if first.times is not None:
        return None
    try:
        _look_like_times(first.samples, file=file)
        _even(first.samples, file=file)
    except RecordingError:
        return None
    return 0


def _heading_split(column: Column) -> Column:
    """A LabVIEW column with the unit taken out of its name: only times are named so there."""
    return Column(*name_and_unit(column.name), values=column.values, lines=column.lines)


def _cut(times: Column, chosen: Channel, *, file: str) -> Column:
    """The times of the rows in which the chosen channel has a sample."""
    wanted = chosen.samples.values.size
    if times.values.size < wanted:
        raise RecordingError(
            f"{file}: line {chosen.samples.lines[times.values.size]}: got a sample without a time; allowed: a time in "
            "every row; export the measurement again"
        )
    return Column(times.name, times.unit, times.values[:wanted], times.lines[:wanted])


def _chosen(names: tuple[str, ...], channel: str | None, *, file: str) -> int:
    if channel is None:
        return 0
    if channel in names:
        return names.index(channel)
    if channel.isdecimal() and 1 <= int(channel) <= len(names):
        return int(channel) - 1
    raise RecordingError(
        f"{file}: got channel {channel!r}; allowed: {', '.join(names)}, or a number from 1 to {len(names)}; choose one"
    )


def _look_like_times(first: Column, *, file: str) -> None:
    """Refuse a first column that nothing calls a time and that is none."""
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
            f"{file}: line {first.lines[0]}: got {what} in the first column and no column named time; "
            "allowed: a column of times; write a heading such as 'time (s), acceleration (g)'"
        )


def _even(times: Column, *, file: str) -> tuple[float, float]:
    """Sampling rate in Hz from a column of times, and the largest departure from an even grid in steps."""
    suffix = _UNIT_SUFFIX.fullmatch(times.name)
    unit = (times.unit or (suffix[1] if suffix else "s")).lower()
    if unit not in _SECONDS:
        raise RecordingError(
            f"{file}: got times in {times.unit!r}; allowed: {', '.join(_SECONDS)}; correct the heading"
        )
    t = times.values * _SECONDS[unit]
    if t.size < 2:
        raise RecordingError(f"{file}: got {t.size} rows; allowed: two or more, for a sampling rate; record longer")
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(t)
        median = float(np.median(steps))
        worst = int(np.argmax(np.abs(steps - median)))
        if not (0 < median < np.inf and abs(steps[worst] - median) <= LARGEST_STEP_ERROR * median):
            raise RecordingError(
                f"{file}: line {times.lines[worst + 1]}: got a time step of {steps[worst]:g} s; allowed: within "
                f"{LARGEST_STEP_ERROR:.0%} of the median step, {median:g} s; record without gaps or resample it evenly"
            )
        mean = float((t[-1] - t[0]) / steps.size)
        off = np.abs(t - (t[0] + mean * np.arange(t.size))) / mean
    at = int(np.argmax(off))
    if not off[at] <= LARGEST_STEP_ERROR:
        raise RecordingError(
            f"{file}: line {times.lines[at]}: got a sample {off[at]:.1f} steps away from an even grid; allowed: "
            f"{LARGEST_STEP_ERROR} steps; record at a steady rate or resample it evenly"
        )
    if not np.isfinite(1 / mean):
        raise RecordingError(f"{file}: got time steps of {mean:g} s; allowed: longer ones; correct the unit of time")
    return 1 / mean, float(off[at])
