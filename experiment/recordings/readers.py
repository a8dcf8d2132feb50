"""Any recording from disk: WAV, text columns with times, a LabVIEW file (.lvm), or one of `formats`.

The content decides the format; a LabVIEW file names its own separators, and is parted by them. The rate is the one that
is stated, or that of a column of times if there is one; a header's is only reported.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import Finding, PalpateError, RecordingError, Remedy
from palpate.experiment.recordings import grid
from palpate.experiment.recordings.formats import AUDIO, format_of
from palpate.experiment.recordings.formats.interface import Format
from palpate.experiment.recordings.formats.unfinished import completed
from palpate.experiment.recordings.series.axes import REDUCTIONS, Reduction
from palpate.experiment.recordings.series.clocks import (
    AGREES,
    by_default,
    chosen,
    clock_beside,
    clock_of,
    clocks_among,
    differs,
    nameless_clock,
    names_times,
    since_first,
    unit_s,
)
from palpate.experiment.recordings.series.column import BESIDE, Column, Kept, Table
from palpate.experiment.recordings.text.columns import Columns, read_columns
from palpate.experiment.recordings.text.lvm import NO_STEP, read_lvm
from palpate.experiment.recordings.wav import header_and_samples
from palpate.experiment.settings import delimited
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated, Understood
from palpate.experiment.settings.units import SECONDS, Heading, heading, likely_unit, rate_in, rates_stated, time_unit

SLOWEST_HZ, FASTEST_HZ = 20.0, 1e7
"""Nobody records a vibration at rates outside of these: another unit of time is more likely."""

AS_STATED = "option --rate"

_LEVELS = re.compile(r"\bdB(FS)? scale\b", re.IGNORECASE)
"""What Audacity writes above samples that it exported as levels."""


@dataclass(frozen=True)
class Recording:
    """One channel of a recording, evenly sampled.

    `channels` are all with samples, in order. `samples` are finite, float64, shape (n,), in `unit`, empty if unknown.
    `rate_source` is where the rate is from, `header_rate_hz` what a header claims beside a column of times. `jitter` is
    the largest departure from the even grid, in steps; 0 without times. One of `segments` is read. `read_as` is
    how a text was read, and `doubts` what is not plausible. `other_clocks` are times that other channels have.
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
    other_clocks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Axes:
    """Channels, by name or number, that are the axes of one sensor, and how they become one."""

    channels: tuple[str, ...]
    reduction: Reduction = "dft321"


def read(
    path: Path, *, channel: str | None = None, axes: Axes | None = None, stated: Stated = NOTHING_STATED
) -> Recording:
    """Return one channel of a recording: the one of this name or number (from 1), or the first that counts no samples
    and varies.

    With `axes`, it is made of several. Raises `RecordingError`, with a line if any, for an unreadable file, a missing
    channel, samples that are not finite, times that are missing, uneven, or in a unit that neither the file nor
    `stated` says, and axes that differ in rate, length or unit.
    """
    try:
        pick = _opened(path, stated, () if axes is None else axes.channels)
        return pick(channel) if axes is None else _of_axes([pick(one) for one in axes.channels], axes.reduction)
    except PalpateError as error:
        raise RecordingError.at(replace(error.finding, where=path)) from None


def _opened(path: Path, stated: Stated, axes: Sequence[str]) -> Callable[[str | None], Recording]:
    """Read a file; return what returns one of its channels, of which `axes` begin and end together."""
    content = delimited.content(path)
    if (audio := next((name for begins, name in AUDIO.items() if content.startswith(begins)), None)) is not None:
        remedy = Remedy("convert it, for example: {}", ("ffmpeg", "-i", str(path), str(path.with_suffix(".wav"))))
        raise RecordingError(f"got a file in the {audio} format", remedy=remedy, allowed="WAV in PCM or float")
    binary = format_of(content)
    sound = content[:4] in (b"RIFF", b"RIFX", b"RF64")
    if stated.section is not None and (sound or binary is not None):
        raise RecordingError(f"got --section {stated.section}", remedy="leave it out", allowed="it, for text alone")
    if sound:
        whole, missing = completed(content)
        return partial(_from_wav, path, *header_and_samples(whole, file=str(path)), missing, stated)
    if binary is not None:
        table = _from_channels(binary, content, stated)
    else:
        text, encoding = delimited.decoded(content, path, stated)
        lvm = text.startswith("LabVIEW Measurement")
        table = read_lvm(text.splitlines(), stated.section) if lvm else _from_columns(content, text, encoding, stated)
    return partial(_recording, str(path), _together(table, axes) if stated.resample else table, stated)


def _together(table: Table, names: Sequence[str]) -> Table:
    """Return a table in which channels of these names miss the rows that one of them misses at its beginning or end."""
    places = {chosen(table.signals, name) for name in names}
    there = [rows for at in places if (rows := np.flatnonzero(np.isfinite(table.signals[at].values))).size]
    first, last = max((rows[0] for rows in there), default=0), min((rows[-1] for rows in there), default=0)
    signals = list(table.signals)
    for at in places:
        rows = np.arange(signals[at].values.size)
        if (outside := (rows < first) | (rows > last)).any():
            values = signals[at].values
            signals[at] = replace(signals[at], values=np.where(outside & np.isfinite(values), np.nan, values))
    return replace(table, signals=signals)


def _of_axes(axes: Sequence[Recording], reduction: Reduction) -> Recording:
    """Return one channel made of several axes."""
    first = axes[0]
    if len({one.channel for one in axes}) < len(axes):
        raise RecordingError("got one channel for several axes", remedy="name each once", allowed="different channels")
    for one in axes[1:]:
        got = f"got {one.channel!r} with {first.channel!r}"
        if (one.rate_hz, one.samples.size) != (first.rate_hz, first.samples.size):
            raise RecordingError(f"{got}, which differs in rate or length", allowed="axes sampled together")
        if one.unit != first.unit:
            raise RecordingError(f"{got}, in {one.unit!r} and {first.unit!r}", allowed="axes in the same unit")
    doubts = tuple(dict.fromkeys(doubt for one in axes for doubt in one.doubts))
    name = f"{reduction} of {', '.join(one.channel for one in axes)}"
    samples = REDUCTIONS[reduction](np.stack([one.samples for one in axes]))
    return replace(first, channel=name, samples=samples, doubts=doubts)


def _from_wav(
    path: Path, header_hz: int, stored: NDArray[Any], missing: str, stated: Stated, channel: str | None
) -> Recording:
    if header_hz < 1 and stated.rate_hz is None:
        remedy = stated.remedy("give the rate", "--rate", "HZ")
        raise RecordingError(f"got a rate of {header_hz} Hz in its header", remedy=remedy, allowed="1 Hz or more")
    table = stored[:, None] if stored.ndim == 1 else stored
    columns = [Column(f"channel {i + 1}", "", table[:, i], ()) for i in range(table.shape[1])]
    names, place = tuple(one.name for one in columns), 0 if channel is None else chosen(columns, channel)
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
    rate_hz = header_hz if stated.rate_hz is None else float(stated.rate_hz)
    doubts += _doubts(str(path), rate_hz, stated.remedy("if this rate is wrong, give the correct one", "--rate", "HZ"))
    source, header = ("WAV header", None) if stated.rate_hz is None else (AS_STATED, float(header_hz))
    return Recording(str(path), names[place], names, samples, unit, float(rate_hz), source, header, doubts=doubts)


def _from_columns(content: bytes, text: str, encoding: str, stated: Stated) -> Table:
    read_as = read_columns(content, text, encoding, stated)
    columns = [
        Column(name or f"column {place}", unit, values, read_as.lines)
        for place, ((name, unit), values) in enumerate(zip(read_as.headings, read_as.values, strict=True), start=1)
    ]
    head = read_as.head
    if _LEVELS.search(head):
        columns = [replace(one, unit=one.unit or "dB") for one in columns]
    clocks = _clocks_of_text(read_as, columns, head, stated)
    others = (*clocks, *read_as.stamped, *(at for at, one in enumerate(read_as.headings) if names_times(one)))
    signals = [place for place in range(len(columns)) if place not in others]
    if not signals:
        raise RecordingError("got only time columns", remedy="give another file", allowed="a column of samples")
    times: list[Column | None] = [columns[clocks[0]] if clocks else None] * len(signals)
    if stated.rate_hz is None and len(clocks) > 1:
        times = [clock_of(place, clocks, columns, stated) for place in signals]
    _refuse_short(read_as, [columns[place] for place in signals], times)
    return Table([columns[place] for place in signals], times, 1, read_as.understood, read_as.cut, rates_stated(head))


def _clocks_of_text(read_as: Columns, columns: list[Column], head: str, stated: Stated) -> list[int]:
    """Return the places of clocks; one that is made of other columns takes the place of one, or comes last."""
    of_day = read_as.stamped
    named = [at for at, one in enumerate(read_as.headings) if at not in of_day and names_times(one)]
    if (parts := _of_second(of_day, named, columns)) is not None and stated.time_column is None:
        columns[of_day[0]], named = parts, []
    clocks = clocks_among(named or [*of_day], columns, stated)
    if not clocks and read_as.step is not None:
        (name, unit), step = read_as.step
        columns.append(Column(name, unit, np.arange(len(read_as.values[0])) * step, read_as.lines))
        return [len(columns) - 1]
    if not clocks and len(columns) > 1:
        bare = [replace(one, name=named.name) for one, named in zip(columns, read_as.headings, strict=True)]
        return nameless_clock(bare, stated, rate_in(head))
    return clocks


def _refuse_short(read_as: Columns, signals: Sequence[Column], times: Sequence[Column | None]) -> None:
    """Refuse a row without a number in each column, unless the channels that end there end with clocks of their own."""
    if read_as.short is None:
        return
    own = len({id(one) for one in times}) > 1
    if not own or any(one.values.size != (clock or one).values.size for one, clock in zip(signals, times, strict=True)):
        line, filled = read_as.short
        raise RecordingError(
            f"got {filled} numbers",
            remedy="correct or remove the line",
            allowed=f"{len(read_as.values)}, as in line {read_as.understood.first_line}",
            line=line,
        )


def _of_second(of_day: Sequence[int], named: Sequence[int], columns: Sequence[Column]) -> Column | None:
    """Return the clock of stamps in whole seconds with a column of milliseconds or less beside them, ns; or None."""
    if not of_day or len(named) != 1:
        return None
    whole, part = columns[of_day[0]], columns[named[0]]
    unit = SECONDS.get(time_unit(Heading(part.name, part.unit)), 1.0)
    if part.values.dtype.kind not in "iu" or np.any(whole.values % 10**9) or unit >= 1:
        return None
    within = part.values.min() >= 0 and part.values.max() < round(1 / unit)
    return replace(whole, values=whole.values + part.values * round(unit * 1e9)) if within else None


def _from_channels(binary: Format, content: bytes, stated: Stated) -> Table:
    """Return the channels of a binary file; whose times are those of a clock among them."""
    channels, missing = binary.read(content)
    columns = [
        Column(heading(held.name).name, held.unit or heading(held.name).unit, held.values,
               range(1, held.values.size + 1), held.step_s, held.bare_step, held.dimension, held.over)
        for held in channels
    ]  # fmt: skip
    if not columns:
        raise RecordingError(
            f"got a {binary.name} file without numeric arrays", remedy="export the recording again",
            allowed="arrays with one dimension, or with a column for each channel",
        )  # fmt: skip
    over = {one.over for one in columns if one.over}
    scales = {held.name: columns[at] for at, held in enumerate(channels) if held.name in over}
    named = [
        at
        for at, one in enumerate(columns)
        if names_times(Heading(one.name.rpartition("/")[2], one.unit)) or channels[at].name in scales
    ]
    clocks = clocks_among(named, columns, stated)
    signals = [one for at, one in enumerate(columns) if at not in (*named, *clocks)]
    if not signals:
        raise RecordingError("got only time channels", remedy="export the samples too")
    times = [clock_beside(one, [columns[at] for at in clocks], scales, stated) for one in signals]
    return Table(signals, times, cut=missing)


def _refuse_levels(signal: Column) -> None:
    if signal.unit.lower().startswith("db"):
        raise RecordingError(
            f"got levels in {signal.unit} in channel {signal.name!r}",
            remedy="export the samples on a linear scale",
            allowed="samples, which oscillate about their mean",
        )


def _recording(file: str, table: Table, stated: Stated, channel: str | None) -> Recording:
    """Return the channel asked for, at the rate of its column of times, or of its header where it has none."""
    names = tuple(signal.name for signal in table.signals)
    place = by_default(table.signals) if channel is None else chosen(table.signals, channel)
    signal, clock = table.signals[place], table.times[place]
    if signal.dimension.lower() != "time":
        raise RecordingError(
            f"channel {signal.name!r} has {signal.dimension} as its x axis",
            remedy="choose another channel",
            allowed="Time",
        )
    if BESIDE in signal.unit:
        raise RecordingError(
            f"got the units {signal.unit} for channel {signal.name!r}, in its heading and in the line below",
            remedy="write the correct unit in both places, in a copy",
            allowed="one unit",
        )
    _refuse_levels(signal)
    claimed_hz = _claimed_hz(signal, stated)
    source = f"time column {clock.name!r}" if clock is not None else "header, without a time column to check it"
    if stated.rate_hz is not None:
        source, differs_by = AS_STATED, differs(clock, stated)
        samples, doubts = _in_turn(file, signal, float(stated.rate_hz), stated)
        on = grid.Grid(float(stated.rate_hz), 0.0)
        doubts += tuple(
            Finding(what, where=file, remedy="check which one is right", verdict="warns", check="rate")
            for what in ((differs_by,) if differs_by else ())
        )
    elif clock is not None:
        on, samples, doubts = _on_grid(file, signal, clock, stated, table.header_rates_hz)
    elif claimed_hz is not None:
        on, (samples, doubts) = grid.Grid(claimed_hz, 0.0), _in_turn(file, signal, claimed_hz, stated)
        claimed_hz = None
        doubts += _doubts(
            file, on.rate_hz, stated.remedy("if this rate is wrong, give the correct one", "--rate", "HZ")
        )
    else:
        raise RecordingError(
            f"got no times and no rate for channel {signal.name!r}",
            remedy=stated.remedy(
                "export the times as well (in LabVIEW: X_Columns One), or give the rate", "--rate", "HZ"
            ),
            allowed="a time column, or a rate or step above zero",
        )
    if table.header_rates_hz:
        agreeing = (one for one in table.header_rates_hz if abs(one / on.rate_hz - 1) < AGREES)
        claimed_hz = next(agreeing, table.header_rates_hz[0])
    if claimed_hz is not None and (table.header_rates_hz or signal.step != NO_STEP):
        doubts += _contradicts(file, claimed_hz, on.rate_hz, source)
    if table.segments > 1 and stated.section is None:
        what, remedy = (
            f"has {table.segments} segments; palpate reads only the first",
            ("choose another one", "--section", "2"),
        )
        doubts += (Finding(what, where=file, remedy=stated.remedy(*remedy), verdict="warns", check="segments"),)
    if table.cut:
        doubts += (Finding(table.cut, where=file, remedy="check where it ends", verdict="warns", check="unfinished"),)
    doubts = _clipped(file, signal.name, signal.values[np.isfinite(signal.values)]) + doubts
    read_as = (source, claimed_hz, on.jitter, table.segments, table.understood, doubts, _others(table, clock))
    return Recording(file, signal.name, names, samples, signal.unit, on.rate_hz, *read_as)


def _others(table: Table, clock: Column | None) -> tuple[str, ...]:
    """Return the names of the other clocks of a table."""
    return tuple(dict.fromkeys(one.name for one in table.times if one is not None and one is not clock))


def _claimed_hz(signal: Column, stated: Stated) -> float | None:
    """Return the rate that a file states for a channel; a step without a unit is in that of times."""
    step = signal.step
    if not step > 0 and signal.bare_step > 0 and stated.rate_hz is None:
        likely = likely_unit(signal.bare_step, 0.0)
        if stated.time_unit not in SECONDS:
            raise RecordingError(
                f"got a step of {signal.bare_step:g} between samples of {signal.name!r}, without a unit",
                remedy=stated.remedy("give its unit", "--time-unit", likely),
                allowed=f"a unit in or next to its name, or given as an option: {', '.join(SECONDS)}",
            )
        step = signal.bare_step * SECONDS[stated.time_unit]
    return 1 / step if step > 0 and isfinite(1 / step) else None


def _contradicts(file: str, claimed_hz: float, rate_hz: float, source: str) -> tuple[Finding, ...]:
    if abs(claimed_hz / rate_hz - 1) < AGREES:
        return ()
    what = f"the rate is {claimed_hz:.6g} Hz in the header, but {rate_hz:.6g} Hz from the {source}"
    return (Finding(what, where=file, remedy="check which one is right", verdict="warns", check="header"),)


def _present(signal: Column, stated: Stated) -> NDArray[np.intp]:
    """Return the places of samples that are there. Raises `RecordingError` where some are not, unless a curve may
    bridge them, or those at the ends may be cut.
    """
    there = np.isfinite(signal.values)
    if there.all():
        return np.arange(signal.values.size)
    kept, at = np.flatnonzero(there), int(np.argmin(there))
    gaps = np.diff(np.concatenate(([-1], kept, [there.size]))) - 1
    bridged = kept.size > 2 and gaps.max() <= grid.LONGEST_GAP
    if not (stated.resample and bridged):
        words = "export it again, or interpolate the missing samples"
        raise RecordingError(
            f"{there.size - kept.size} of {there.size} samples of {signal.name!r} are not numbers (the first is sample "
            f"{at + 1}; at most {gaps.max()} are in a row)",
            remedy=stated.remedy(words, "--resample") if bridged else "export it again, or truncate the file there",
            allowed=f"finite numbers, or gaps of at most {grid.LONGEST_GAP} samples to interpolate",
            line=None if isinstance(signal.lines, range) else signal.lines[at],
        )
    return kept


def _in_turn(
    file: str, signal: Column, rate_hz: float, stated: Stated
) -> tuple[NDArray[np.float64], tuple[Finding, ...]]:
    """Return samples at a known rate, where missing ones are bridged, and what is doubtful of that."""
    kept, samples = _present(signal, stated), signal.values.astype(np.float64)
    if kept.size == samples.size:
        return samples, ()
    made = grid.resampled((kept - kept[0]) / rate_hz, samples[kept], Kept(signal.lines, kept))
    doubts = _missing(file, signal, kept)
    return (samples[kept], doubts) if made is None else (made.samples, (_resampled(file, signal.name, made), *doubts))


def _on_grid(
    file: str, signal: Column, clock: Column, stated: Stated, header_rates_hz: Sequence[float]
) -> tuple[grid.Grid, NDArray[np.float64], tuple[Finding, ...]]:
    """Return the grid of a channel by its clock, its samples on it, and what is doubtful of both."""
    if clock.values.size < signal.values.size:
        raise RecordingError(
            "got a sample without a time",
            remedy="export the measurement again",
            allowed="a time in every row",
            line=signal.lines[clock.values.size],
        )
    if not np.all(there := np.isfinite(clock.values)):
        raise RecordingError(
            f"got no number in {clock.name!r}", remedy="correct the line, or export it again",
            allowed="a time in every row", line=clock.lines[int(np.argmin(there))],
        )  # fmt: skip
    second, kept = unit_s(clock, stated, header_rates_hz), _present(signal, stated)
    times_s, samples, lines = since_first(clock, second), signal.values.astype(np.float64), clock.lines
    if kept.size < signal.values.size:
        times_s, samples, lines = times_s[kept] - times_s[kept[0]], samples[kept], Kept(clock.lines, kept)
    times_s, over = grid.unwrapped(times_s[: samples.size])
    made = grid.resampled(times_s, samples, lines) if stated.resample else None
    on = grid.even(times_s, lines, stated) if made is None else made.grid
    doubts = _missing(file, signal, kept)
    if made is not None:
        samples, doubts = made.samples, (_resampled(file, signal.name, made), *doubts)
    rounded: tuple[Finding, ...] = (_rounded(file, on),) if on.resolution_s else ()
    if over:
        what = f"{clock.name} is a 32-bit counter that overflowed; its times were continued from there"
        rounded += (
            Finding(what, where=file, remedy="check that no samples are missing", verdict="warns", check="counter"),
        )
    likely = likely_unit(1 / on.rate_hz, 0.0)
    remedy = stated.remedy(f"if its times are in {likely}, give that unit", "--time-unit", likely)
    return on, samples, (*doubts, *rounded, *_doubts(file, on.rate_hz, remedy))


def _rounded(file: str, on: grid.Grid) -> Finding:
    what = f"has times in steps of {on.resolution_s:g} s, so the rate was averaged over the whole recording"
    return Finding(what, where=file, remedy="export times with more digits", verdict="warns", check="rounded")


def _resampled(file: str, channel: str, made: grid.Resampled) -> Finding:
    gaps = (
        f"; {made.bridged} missing samples were interpolated, at most {made.longest} in a row" if made.bridged else ""
    )
    error = f"with an error of about {made.error:.2g} times its rms"
    what = f"{channel} was resampled at {made.grid.rate_hz:.6g} Hz, {error}{gaps}"
    return Finding(what, where=file, remedy="record at a constant rate", verdict="warns", check="resampled")


def _missing(file: str, signal: Column, kept: NDArray[np.intp]) -> tuple[Finding, ...]:
    """Return what is doubtful of samples that are not `kept`: those cut at the ends, and those beyond the range."""
    begin, end = int(kept[0]), signal.values.size - 1 - int(kept[-1])
    beyond = np.count_nonzero(np.isinf(signal.values))
    cut = f"{signal.name} lacks {begin} samples at the beginning and {end} at the end, so it was trimmed"
    over = f"{signal.name} is out of range in {beyond} samples; interpolation cannot recover their true values"
    told = ((begin or end, cut, "export it again", "ends"), (beyond, over, "record at a lower gain", "clipping"))
    return tuple(
        Finding(what, where=file, remedy=remedy, verdict="warns", check=check)
        for some, what, remedy, check in told
        if some
    )


def _clipped(file: str, channel: str, samples: NDArray[Any]) -> tuple[Finding, ...]:
    if (mark := grid.mark(samples)) is not None:
        what = f"{channel} is {mark.value:g} in {mark.samples} samples, far from all others: a code for missing ones?"
        remedy = "remove these samples, and resample the rest"
        return (Finding(what, where=file, remedy=remedy, verdict="warns", check="marks"),)
    if (found := grid.clipping(samples)) is None:
        return ()
    ends = " and ".join(f"{end:.6g}" for end in found.ends)
    what = f"{channel} looks clipped: {found.samples} samples (in {found.runs} runs) are at {ends}"
    return (Finding(what, where=file, remedy="record at a lower gain", verdict="warns", check="clipping"),)


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
