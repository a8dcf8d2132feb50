"""Any recording from disk: WAV, text columns with a time column, or a LabVIEW measurement file (.lvm).

What a file is, its content tells, not its name. The sampling rate is that of the time column wherever there is one: a
rate in a header may lie, and is only reported beside it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiment.errors import RecordingError
from experiment.recordings.columns import Column, name_and_unit, parse_columns
from experiment.recordings.lvm import MAGIC, Channel, parse_lvm
from experiment.recordings.wav import wav_samples

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
