"""Any recording from disk: WAV, text columns with times, a LabVIEW file (.lvm), or one of `formats`.

The content decides the format; a LabVIEW file names its own separators, and is parted by them. The rate is the one that
is stated, or that of a column of times if there is one; a header's is only reported.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import Finding, PalpateError, RecordingError, Remedy
from palpate.experiment.recordings import grid
from palpate.experiment.recordings.axes import REDUCTIONS, Reduction
from palpate.experiment.recordings.formats import format_of
from palpate.experiment.recordings.formats.interface import Format
from palpate.experiment.recordings.formats.unfinished import completed
from palpate.experiment.recordings.text.columns import RowLines, read_columns
from palpate.experiment.recordings.wav import wav_samples
from palpate.experiment.settings import delimited
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated, Understood, number
from palpate.experiment.settings.units import (
    SECONDS,
    Heading,
    heading,
    is_clock,
    is_counter,
    likely_unit,
    rate_in,
    time_unit,
)

SLOWEST_HZ, FASTEST_HZ = 20.0, 1e7
"""Nobody records a vibration at rates outside of these: another unit of time is more likely."""

AGREES = 0.01
"""A step of a clock and a stated rate agree within this part, if the unit of the clock is right."""

AS_STATED = "option --rate"
COUNTER = "a counter of samples"
_LVM_TAG = re.compile(r"(?!nan$|inf$|infinity$)[A-Za-z]\w*", re.IGNORECASE)
_SAYS_NOTHING = ("", "x", "untitled")
"""Headings under which a rising first column may be taken for times; LabVIEW calls nameless channels Untitled."""


@dataclass(frozen=True)
class Recording:
    """One channel of a recording, evenly sampled.

    `channels` are all with samples, in order. `samples` are finite, float64, shape (n,), in `unit`, empty if unknown.
    `rate_source` is where the rate is from, `header_rate_hz` what a header claims beside a column of times. `jitter` is
    the largest departure from the even grid, in steps; 0 without times. The first of `segments` is read. `read_as` is
    how a text was read, and `doubts` what is not plausible.
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
    read_as: Understood | None = None
    doubts: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Axes:
    """Channels, by name or number, that are the axes of one sensor, and how they become one."""

    channels: tuple[str, ...]
    reduction: Reduction = "dft321"


@dataclass(frozen=True)
class _Column:
    """One column: heading, finite values, their lines from 1; in LabVIEW a time step (NaN for none) and a dimension."""

    name: str
    unit: str
    values: NDArray[Any]
    lines: Sequence[int] | RowLines
    step: float = np.nan
    dimension: str = "Time"


_Rows = list[tuple[int, list[str]]]
"""Each row's line, from 1, and its cells."""


@dataclass(frozen=True)
class _Table:
    """Channels, the column of times of each (None where it has none), the number of segments, and how it was read.

    `cut` says what makes its last row look cut off.
    """

    signals: Sequence[_Column]
    times: Sequence[_Column | None]
    segments: int = 1
    understood: Understood | None = None
    cut: str = ""


def read(
    path: Path, *, channel: str | None = None, axes: Axes | None = None, stated: Stated = NOTHING_STATED
) -> Recording:
    """Return one channel of a recording: the one of this name or number (from 1), or the first that counts no samples.

    With `axes`, it is made of several. Raises `RecordingError`, with a line if any, for an unreadable file, a missing
    channel, samples that are not finite, times that are missing, uneven, or in a unit that neither the file nor
    `stated` says, and axes that differ in rate, length or unit.
    """
    try:
        pick = _opened(path, stated)
        return pick(channel) if axes is None else _of_axes([pick(one) for one in axes.channels], axes.reduction)
    except PalpateError as error:
        raise RecordingError.at(replace(error.finding, where=path)) from None


def _opened(path: Path, stated: Stated) -> Callable[[str | None], Recording]:
    """Read a file; return what returns one of its channels."""
    content = delimited.content(path)
    if content[:4] in (b"RIFF", b"RIFX", b"RF64"):
        whole, missing = completed(content)
        return partial(_from_wav, path, *wav_samples(whole, file=str(path)), missing, stated.rate_hz)
    if (binary := format_of(content)) is not None:
        table = _from_channels(binary, content, stated)
    else:
        text, encoding = delimited.decoded(content, path, stated)
        lvm = text.startswith("LabVIEW Measurement")
        table = _from_lvm(text.splitlines()) if lvm else _from_columns(content, text, encoding, stated)
    return partial(_recording, str(path), table, stated)


def _of_axes(axes: Sequence[Recording], reduction: Reduction) -> Recording:
    """Return one channel made of several axes."""
    first = axes[0]
    if len({one.channel for one in axes}) < len(axes):
        raise RecordingError("got one channel for several axes", remedy="name each once", allowed="different channels")
    for one in axes[1:]:
        got = f"got {one.channel!r} beside {first.channel!r}"
        if (one.rate_hz, one.samples.size) != (first.rate_hz, first.samples.size):
            raise RecordingError(f"{got}, with another rate or length", allowed="axes that were sampled together")
        if one.unit != first.unit:
            raise RecordingError(f"{got}, in {one.unit!r} and {first.unit!r}", allowed="axes in one unit")
    doubts = tuple(dict.fromkeys(doubt for one in axes for doubt in one.doubts))
    name = f"{reduction} of {', '.join(one.channel for one in axes)}"
    samples = REDUCTIONS[reduction](np.stack([one.samples for one in axes]))
    return replace(first, channel=name, samples=samples, doubts=doubts)


def _from_wav(
    path: Path, header_hz: int, stored: NDArray[Any], missing: str, rate_hz: float | None, channel: str | None
) -> Recording:
    table = stored[:, None] if stored.ndim == 1 else stored
    names = tuple(f"channel {i + 1}" for i in range(table.shape[1]))
    place = _chosen(names, channel)
    samples, unit = table[:, place].astype(np.float64), ""
    if stored.dtype.kind != "f":
        zero = 128.0 if stored.dtype == np.uint8 else 0.0
        samples -= zero
        samples /= 2.0 ** (8 * stored.dtype.itemsize - 1)
        unit = "full scale"
    if not np.all(np.isfinite(samples)):
        at = int(np.flatnonzero(~np.isfinite(samples))[0])
        raise RecordingError(path, f"sample {at}: got {samples[at]}", "record it again", allowed="finite numbers")
    doubts = _clipped(str(path), names[place], samples)
    if missing:
        doubts += (Finding(missing, where=path, remedy="check where it ends", verdict="warns", check="unfinished"),)
    made = Recording(str(path), names[place], names, samples, unit, float(header_hz), "WAV header", doubts=doubts)
    return made if rate_hz is None else replace(made, rate_hz=rate_hz, rate_source=AS_STATED, header_rate_hz=header_hz)


def _chosen(names: tuple[str, ...], asked: str | None, what: str = "channel") -> int:
    """Return the place of a name, of a whole heading with its unit, or of a number from 1; the first by default."""
    if asked is None:
        return 0
    for name in (asked, heading(asked).name):
        if names.count(name) == 1:
            return names.index(name)
    if asked.isdecimal() and 1 <= int(asked) <= len(names):
        return int(asked) - 1
    raise RecordingError(
        f"got {what} {asked!r}",
        remedy="choose one of them",
        allowed=f"{', '.join(names)}, or a number from 1 to {len(names)}",
    )


def _from_columns(content: bytes, text: str, encoding: str, stated: Stated) -> _Table:
    read_as = read_columns(content, text, encoding, stated)
    columns = [
        _Column(name or f"column {place}", unit, values, read_as.lines)
        for place, ((name, unit), values) in enumerate(zip(read_as.headings, read_as.values, strict=True), start=1)
    ]
    of_day = read_as.stamped
    named = [at for at, one in enumerate(read_as.headings) if at not in of_day and _names_times(one)] or [*of_day]
    clocks = _clocks(named, columns, stated)
    if not clocks and read_as.step is not None:
        (name, unit), step = read_as.step
        clocks = [len(columns)]
        columns.append(_Column(name, unit, np.arange(len(read_as.values[0])) * step, read_as.lines))
    if not clocks and len(columns) > 1:
        first = replace(columns[0], name=read_as.headings[0].name)
        clocks = _nameless_clock(first, stated, rate_in(text[: read_as.begins]))
    signals = [place for place in range(len(columns)) if place not in (*clocks, *named, *of_day)]
    if not signals:
        raise RecordingError(
            "got no column but those of times", remedy="name another file", allowed="a column of samples"
        )
    times: list[_Column | None] = [columns[clocks[0]] if clocks else None] * len(signals)
    if stated.rate_hz is None and len({_step_s(columns[place], stated) for place in clocks}) > 1:
        times = [_clock_of(place, clocks, columns, stated) for place in signals]
    return _Table([columns[place] for place in signals], times, 1, read_as.understood, read_as.cut)


def _nameless_clock(first: _Column, stated: Stated, likely: str) -> list[int]:
    """Return the place of times that no heading names; where a rate is stated, there may be none."""
    if stated.rate_hz is None:
        _look_like_times(first, stated, likely)
    return [0] if stated.rate_hz is None or (_rises_evenly(first) and not _counts(first)) else []


def _from_channels(binary: Format, content: bytes, stated: Stated) -> _Table:
    """Return the channels of a binary file; whose times are those of a clock among them."""
    channels, missing = binary.read(content)
    columns = [
        _Column(heading(held.name).name, held.unit or heading(held.name).unit, held.values,
                range(1, held.values.size + 1), held.step_s, held.dimension)
        for held in channels
    ]  # fmt: skip
    if not columns:
        raise RecordingError(
            f"got a file of {binary.name} without a series of numbers", remedy="export the recording again",
            allowed="arrays of one dimension, or of a column for each channel",
        )  # fmt: skip
    for one in columns:
        if not np.all(np.isfinite(one.values)):
            at = int(np.flatnonzero(~np.isfinite(one.values))[0])
            raise RecordingError(
                f"got {one.values[at]} in {one.name!r}, sample {at + 1}", remedy="export it again",
                allowed="finite numbers",
            )  # fmt: skip
    named = [at for at, one in enumerate(columns) if _names_times(Heading(one.name.rpartition("/")[2], one.unit))]
    clocks = _clocks(named, columns, stated)
    signals = [one for at, one in enumerate(columns) if at not in (*named, *clocks)]
    if not signals:
        raise RecordingError("got no channel but those of times", remedy="export the samples, too")
    times = [_clock_beside(one, [columns[at] for at in clocks], stated) for one in signals]
    return _Table(signals, times, cut=missing)


def _clock_beside(signal: _Column, clocks: Sequence[_Column], stated: Stated) -> _Column | None:
    """Return the clock of a channel: the only one of its length, in its group if several are.

    A clock whose unit nothing says has the one by which it keeps the rate that the file states, if one does.
    """
    fitting = [one for one in clocks if one.values.size == signal.values.size]
    own = [one for one in fitting if one.name.rpartition("/")[0] == signal.name.rpartition("/")[0]]
    found = (own or fitting)[0] if len(own or fitting) == 1 else None
    if found is None or stated.time_unit or time_unit(Heading(found.name, found.unit)) or not signal.step > 0:
        return found
    with np.errstate(over="ignore", invalid="ignore"):
        step = float(np.median(np.diff(found.values))) if found.values.size > 1 else np.nan
    unit = next((unit for unit, s in SECONDS.items() if abs(step * s / signal.step - 1) < AGREES), "")
    return replace(found, unit=unit) if unit else found


def _names_times(one: Heading) -> bool:
    return is_clock(one.name) if one.name else bool(time_unit(one))


def _clocks(named: Sequence[int], columns: Sequence[_Column], stated: Stated) -> list[int]:
    """Return the places of the columns of times: the one that is stated, or of those named so, those with a unit."""
    if stated.time_column is not None:
        return [_chosen(tuple(column.name for column in columns), stated.time_column, "column")]
    return [at for at in named if time_unit(Heading(columns[at].name, columns[at].unit))] or list(named)


def _step_s(clock: _Column, stated: Stated) -> float:
    """Return the mean step of a clock, s, to four digits."""
    span = (float(clock.values[-1]) - float(clock.values[0])) / max(clock.values.size - 1, 1)
    return float(f"{span * _unit_s(clock, stated):.3e}")


def _clock_of(place: int, clocks: Sequence[int], columns: Sequence[_Column], stated: Stated) -> _Column:
    """Return the clock of a channel, where clocks differ: the one to its left, if channels follow each of them."""
    follow = all(clock + 1 not in clocks and clock + 1 < len(columns) for clock in clocks)
    if clocks[0] == 0 and follow:
        return columns[max(clock for clock in clocks if clock < place)]
    names = [columns[clock].name for clock in clocks]
    raise RecordingError(
        f"got several columns of times that differ: {', '.join(names)}",
        remedy=stated.remedy("state which one counts", "--time-column", names[0]),
        allowed="one, or one to the left of the channels that it is of",
    )


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
    split = [heading(signal.name) for signal in signals]
    at = next((place for place, (name, _) in enumerate(split) if is_clock(name)), None)
    if at is None and times[0] is None and _rises_evenly(signals[0]) and not _by_one(signals[0].values):
        at = 0
    if at is not None and len(signals) > 1:
        # The unit of a channel stands in its tag, but that of a time often in its name alone.
        own = replace(signals.pop(at), name=split[at].name, unit=time_unit(split[at]) or "s")
        times = [own] * len(signals)
    return _Table(signals, times, len(found))


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
            if isfinite(number(cells[0], decimal)):
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
            # The format has no other unit for times.
            clock = _Column(name, "s", values, lines) if lines else None
        elif lines:
            # A tag stands above the column that it describes.
            unit, step, dimension = (
                cells[place] if place < len(cells := segment.tags.get(tag, [])) else ""
                for tag in ("Y_Unit_Label", "Delta_X", "X_Dimension")
            )
            signals.append(_Column(name, unit, values, lines, number(step, decimal), dimension or "Time"))
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
        values.append(number(cell, decimal))
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


def _recording(file: str, table: _Table, stated: Stated, channel: str | None) -> Recording:
    """Return the channel asked for, at the rate of its column of times, or of its header where it has none."""
    names = tuple(signal.name for signal in table.signals)
    first = next((place for place, signal in enumerate(table.signals) if not _counts(signal)), 0)
    place = first if channel is None else _chosen(names, channel)
    chosen, clock = table.signals[place], table.times[place]
    if chosen.dimension.lower() != "time":
        raise RecordingError(
            f"channel {chosen.name!r} stands over {chosen.dimension}", remedy="choose another channel", allowed="Time"
        )
    claimed_hz = 1 / chosen.step if chosen.step > 0 and isfinite(1 / chosen.step) else None
    samples, doubts = chosen.values.astype(np.float64), _clipped(file, chosen.name, chosen.values)
    if stated.rate_hz is not None:
        on, source = grid.Grid(float(stated.rate_hz), 0.0), AS_STATED
        doubts += _differs(file, clock, stated)
    elif clock is not None:
        on, samples, timed = _on_grid(file, chosen, clock, stated)
        source, doubts = f"time column {clock.name!r}", doubts + timed
    elif claimed_hz is not None:
        on, claimed_hz = grid.Grid(claimed_hz, 0.0), None
        source = "header, no time column to check it against"
        doubts += _doubts(file, on.rate_hz, stated.remedy("if that is wrong, state the rate", "--rate", "HZ"))
    else:
        raise RecordingError(
            f"got neither times nor a rate for channel {chosen.name!r}",
            remedy=stated.remedy("export them with it, in LabVIEW with X_Columns One, or state a rate", "--rate", "HZ"),
            allowed="a column of times, or a rate or step above zero",
        )
    if table.cut:
        doubts += (Finding(table.cut, where=file, remedy="check where it ends", verdict="warns", check="unfinished"),)
    read_as = (source, claimed_hz, on.jitter, table.segments, table.understood, doubts)
    return Recording(file, chosen.name, names, samples, chosen.unit, on.rate_hz, *read_as)


def _on_grid(
    file: str, signal: _Column, clock: _Column, stated: Stated
) -> tuple[grid.Grid, NDArray[np.float64], tuple[Finding, ...]]:
    """Return the grid of a channel by its clock, its samples on it, and what is doubtful of both."""
    samples, doubts = signal.values.astype(np.float64), tuple[Finding, ...]()
    if clock.values.size < samples.size:
        raise RecordingError(
            "got a sample without a time",
            remedy="export the measurement again",
            allowed="a time in every row",
            line=signal.lines[clock.values.size],
        )
    times_s = _since_first(clock, _unit_s(clock, stated))[: samples.size]
    made = grid.resampled(times_s, samples, clock.lines) if stated.resample else None
    on = grid.even(times_s, clock.lines, stated) if made is None else made.grid
    if made is not None:
        samples, doubts = made.samples, (_resampled(file, signal.name, made),)
    rounded = (_rounded(file, on),) if on.resolution_s else ()
    likely = likely_unit(1 / on.rate_hz, 0.0)
    remedy = stated.remedy(f"if its times are in {likely}, state it", "--time-unit", likely)
    return on, samples, (*doubts, *rounded, *_doubts(file, on.rate_hz, remedy))


def _since_first(clock: _Column, unit_s: float) -> NDArray[np.float64]:
    """Return times since the first, s: those since 1970 in nanoseconds have more digits than a float."""
    with np.errstate(over="ignore", invalid="ignore"):
        times: NDArray[np.float64] = (clock.values - clock.values[0]).astype(np.float64) * unit_s
    return times


def _differs(file: str, clock: _Column | None, stated: Stated) -> tuple[Finding, ...]:
    """Return a doubt where a rate is stated and times have another, in their unit or, if that is not known, in any."""
    if clock is None:
        return ()
    unit, rate_hz = stated.time_unit or time_unit(Heading(clock.name, clock.unit)), stated.rate_hz or 0.0
    steps_s = [_step_s(clock, replace(stated, time_unit=one)) for one in ([unit] if unit else SECONDS)]
    if any(abs(step_s * rate_hz - 1) < AGREES for step_s in steps_s):
        return ()
    mean = f"is {steps_s[0]:g} s" if unit else "does not fit in any unit"
    what = f"got --rate {rate_hz:g} beside times in {clock.name!r}, whose mean step {mean}"
    return (Finding(what, where=file, remedy="check which is right", verdict="warns", check="rate"),)


def _rounded(file: str, on: grid.Grid) -> Finding:
    what = f"has times in steps of {on.resolution_s:g} s, so that its rate is that of all samples over all the time"
    return Finding(what, where=file, remedy="export more digits for better", verdict="warns", check="rounded")


def _resampled(file: str, channel: str, made: grid.Resampled) -> Finding:
    gaps = f"; {made.bridged} missing samples are bridged, {made.longest} in a row at most" if made.bridged else ""
    error = f"with an error of some {made.error:.2g} of its rms"
    what = f"{channel} was resampled at {made.grid.rate_hz:.6g} Hz, {error}{gaps}"
    return Finding(what, where=file, remedy="record at a steady rate", verdict="warns", check="resampled")


def _clipped(file: str, channel: str, samples: NDArray[Any]) -> tuple[Finding, ...]:
    if (mark := grid.mark(samples)) is not None:
        what = f"{channel} is {mark.value:g} in {mark.samples} samples, far from all others: a mark of missing ones?"
        remedy = "take them out, and have the rest resampled"
        return (Finding(what, where=file, remedy=remedy, verdict="warns", check="marks"),)
    if (found := grid.clipping(samples)) is None:
        return ()
    ends = " and ".join(f"{end:.6g}" for end in found.ends)
    what = f"{channel} looks clipped: {found.samples} samples in {found.runs} runs stand at {ends}"
    return (Finding(what, where=file, remedy="record at a lower gain", verdict="warns", check="clipping"),)


def _counts(signal: _Column) -> bool:
    """Return whether a column numbers the samples."""
    return (signal.values.dtype.kind in "iu" and _by_one(signal.values)) or is_counter(signal.name)


def _by_one(values: NDArray[Any]) -> bool:
    return values.size > 1 and bool(np.all(np.diff(values) == 1))


def _unit_s(clock: _Column, stated: Stated) -> float:
    """Return the unit of a column of times, s, which the file or its user states."""
    unit = stated.time_unit or time_unit(Heading(clock.name, clock.unit))
    if unit in SECONDS:
        return SECONDS[unit]
    with np.errstate(over="ignore"):
        spans = np.diff(clock.values)
    likely = likely_unit(float(np.median(spans)) if spans.size else 0.0, float(clock.values[0]))
    told = f"in {clock.unit!r}" if clock.unit else "without a unit"
    raise RecordingError(
        f"got times {told} in {clock.name!r}" if stated.time_unit is None else f"got the unit {unit!r} of time",
        remedy=stated.remedy("state their unit", "--time-unit", likely),
        allowed=f"a unit in the heading, or one that is stated: {', '.join(SECONDS)}",
    )


def _doubts(file: str, rate_hz: float, remedy: Remedy | str) -> tuple[Finding, ...]:
    if SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        return ()
    return (
        Finding(
            f"got a rate of {rate_hz:.4g} Hz, which is implausible for a vibration",
            where=file,
            allowed=f"{SLOWEST_HZ:g} Hz to {FASTEST_HZ / 1e6:g} MHz",
            remedy=remedy,
            verdict="warns",
            check="rate",
        ),
    )


def _rises_evenly(column: _Column) -> bool:
    """Return whether a column that no heading names rises as times do, or as a counter."""
    if column.unit or column.name.lower() not in _SAYS_NOTHING or np.any(column.values[1:] <= column.values[:-1]):
        return False
    try:
        grid.even(_since_first(column, 1.0), column.lines, NOTHING_STATED)
    except RecordingError:
        return False
    return True


def _look_like_times(first: _Column, stated: Stated = NOTHING_STATED, rate: str = "HZ") -> None:
    """Refuse a first column that no heading calls a time and that does not look like times."""
    with np.errstate(over="ignore"):
        steps = np.diff(first.values)
    what = ""
    if first.name.lower() not in _SAYS_NOTHING or first.unit:
        what = f"{first.name!r}"
    elif np.any(steps <= 0):
        what = "values that do not rise"
    elif _by_one(first.values):
        what = COUNTER
    if what:
        words = "write a heading such as 'time (s), acceleration (g)', or state their rate"
        options = ("--time-column", "1", "--time-unit", likely_unit(1.0, float(first.values[0])))
        counts = what == COUNTER
        raise RecordingError(
            f"got {what} in the first column and no column named time",
            remedy=stated.remedy("if it holds the times, state it", *options)
            if counts
            else stated.remedy(words, "--rate", rate),
            allowed="a column of times, or a rate that is stated",
            line=first.lines[0],
        )
