"""Which column holds the times of a channel, and in which unit, as headings say or whoever gives the file states."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings import grid
from palpate.experiment.recordings.series.column import BESIDE, Column
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated
from palpate.experiment.settings.units import (
    ABSCISSAS,
    SECONDS,
    Heading,
    bare_clock,
    heading,
    is_clock,
    is_counter,
    likely_unit,
    time_unit,
)

AGREES = 0.01
"""A step of a clock and a stated rate agree within this part, if the unit of the clock is right."""

COUNTER = "a counter of samples"

_AT_FIRST = 1000
"""Values that tell most other columns from a counter."""

_SAYS_NOTHING = ("", "x", "untitled")
"""Headings under which a rising first column may be taken for times; LabVIEW calls nameless channels Untitled."""


def chosen(columns: Sequence[Column], asked: str, what: str = "channel") -> int:
    """Return the place of a whole heading with its unit, of a name, or of a number from 1.

    Raises `RecordingError` for one that is not there, and for a name that several have.
    """
    headings = [Heading(one.name, one.unit) for one in columns]
    names = [one.name for one in columns]
    meant = heading(asked)
    for every, one in ((headings, meant), (names, asked), (names, "" if meant.unit else meant.name)):
        if list(every).count(one) == 1:
            return list(every).index(one)
    if names.count(meant.name) == 1 and not headings[names.index(meant.name)].unit:
        return names.index(meant.name)
    if f"column {asked}" in names:
        return names.index(f"column {asked}")
    if asked.isdecimal() and 1 <= int(asked) <= len(names):
        return int(asked) - 1
    told = [f"{name} ({unit})" if unit and (names.count(name) > 1 or meant.unit) else name for name, unit in headings]
    raise RecordingError(
        f"got {what} {asked!r}",
        remedy="choose one of these",
        allowed=f"{', '.join(told)}, or a number from 1 to {len(names)}",
    )


def names_times(one: Heading) -> bool:
    """Return whether a heading is that of times."""
    if one.name and one.name.lower() not in ABSCISSAS:
        return is_clock(one.name)
    return is_clock(one.name) or bool(time_unit(Heading("", one.unit)))


def clocks_among(named: Sequence[int], columns: Sequence[Column], stated: Stated) -> list[int]:
    """Return the places of columns of times: the one that is stated, or those named so which rise.

    Of several that keep the same time, the first whose unit is known is all. Others are returned together.
    """
    if stated.time_column is not None:
        return [chosen(columns, stated.time_column, "column")]
    rising = [at for at in named if _rises(columns[at].values)] or list(named)
    known = [at for at in rising if _unit_of(columns[at], stated)] or rising
    first = columns[known[0]] if known else None
    if first is None or all(_keep_one_time(first, columns[at], stated) for at in rising):
        return known[:1]
    return rising


def _rises(values: NDArray[Any]) -> bool:
    """Return whether values never fall, and rise on the whole; the start of a second run apart."""
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(values)
    return bool(np.count_nonzero(steps < 0) * 100 < values.size and np.count_nonzero(steps > 0) * 50 > values.size)


def _unit_of(clock: Column, stated: Stated) -> str:
    return stated.time_unit or time_unit(Heading(clock.name, clock.unit))


def _keep_one_time(one: Column, other: Column, stated: Stated) -> bool:
    """Return whether two clocks have as many times, at the same mean step, in a unit that fits where none is known."""
    if one is other:
        return True
    unit, also = (_unit_of(each, stated) for each in (one, other))
    step, its = _span(one), _span(other)
    if one.values.size != other.values.size:
        return False
    if unit not in SECONDS and also not in SECONDS:
        return abs(step - its) <= 1e-3 * abs(step)
    step_s = step * SECONDS[unit] if unit in SECONDS else its * SECONDS[also]
    bare = its if unit in SECONDS else step
    units = [also] if unit in SECONDS and also in SECONDS else [*SECONDS]
    return any(abs(bare * SECONDS[each] - step_s) <= 1e-3 * abs(step_s) for each in units)


def _span(clock: Column) -> float:
    """Return the mean step of a clock in its unit."""
    return (float(clock.values[-1]) - float(clock.values[0])) / max(clock.values.size - 1, 1)


def clock_of(place: int, clocks: Sequence[int], columns: Sequence[Column], stated: Stated) -> Column:
    """Return the clock of a channel, where clocks differ: the one to its left, if channels follow each of them.

    The names of clocks have to say no more than time, apart from numbers and the channels that follow: an exposure time
    is none of another kind. Raises `RecordingError` for any others.
    """
    follow = all(clock + 1 not in clocks and clock + 1 < len(columns) for clock in clocks)
    ends = [*clocks[1:], len(columns)]
    own = {at: [columns[each].name for each in range(at + 1, end)] for at, end in zip(clocks, ends, strict=True)}
    plain = {bare_clock(columns[at].name, names) for at, names in own.items()}
    alike = len(plain) == 1 or len({columns[at].name for at in clocks}) == 1
    if clocks[0] == 0 and follow and alike:
        return columns[max(clock for clock in clocks if clock < place)]
    names = [columns[clock].name for clock in clocks]
    told = [
        f"{one.name} ({one.unit})" if one.unit and names.count(one.name) > 1 else one.name
        for one in (columns[clock] for clock in clocks)
    ]
    raise RecordingError(
        f"got several different time columns: {', '.join(told)}",
        remedy=stated.remedy(
            "choose one", "--time-column", str(clocks[0] + 1) if len(set(told)) < len(told) else told[0]
        ),
        allowed="one time column, or one to the left of each group of channels",
    )


def clock_beside(
    signal: Column, clocks: Sequence[Column], scales: Mapping[str, Column], stated: Stated
) -> Column | None:
    """Return the clock of a channel: that of its file's `scales`, or the only one of its length, or in its group.

    A clock whose unit nothing says has the one by which it keeps the rate that the file states, if one does.
    """
    if (over := scales.get(signal.over)) is not None and stated.time_column is None:
        return over
    fitting = [one for one in clocks if one.values.size == signal.values.size]
    own = [one for one in fitting if one.name.rpartition("/")[0] == signal.name.rpartition("/")[0]]
    found = (own or fitting)[0] if len(own or fitting) == 1 else None
    if found is None or stated.time_unit or time_unit(Heading(found.name, found.unit)) or not signal.step > 0:
        return found
    with np.errstate(over="ignore", invalid="ignore"):
        step = float(np.median(np.diff(found.values))) if found.values.size > 1 else np.nan
    unit = next((unit for unit, s in SECONDS.items() if abs(step * s / signal.step - 1) < AGREES), "")
    return replace(found, unit=unit) if unit else found


def step_s(clock: Column, stated: Stated) -> float:
    """Return the mean step of a clock, s, to four digits."""
    return float(f"{_span(clock) * unit_s(clock, stated):.3e}")


def unit_s(clock: Column, stated: Stated, header_rates_hz: Sequence[float] = ()) -> float:
    """Return the unit of a column of times, s, which the file or its user states.

    Raises `RecordingError` for none, with the one in which the times keep a rate of the header; where none does, they
    count samples, and the rate is asked for.
    """
    unit = _unit_of(clock, stated)
    if unit in SECONDS:
        return SECONDS[unit]
    with np.errstate(over="ignore"):
        spans = np.diff(clock.values)
    step = float(np.median(spans)) if spans.size else 0.0
    likely = likely_unit(step, float(clock.values[0]))
    remedy = stated.remedy("give their unit", "--time-unit", likely)
    if header_rates_hz:
        keeps = [one for one, s in SECONDS.items() for hz in header_rates_hz if abs(step * s * hz - 1) < AGREES]
        rate = ("if these numbers count samples, give the rate", "--rate", f"{header_rates_hz[0]:.12g}")
        remedy = stated.remedy(*(("give their unit", "--time-unit", keeps[0]) if keeps else rate))
    told = f"in {clock.unit!r}" if clock.unit else "without a unit"
    if BESIDE in clock.unit:
        told = f"in {clock.unit.replace(BESIDE, ' in the heading and ')} below it"
    raise RecordingError(
        f"got times {told} in {clock.name!r}" if stated.time_unit is None else f"got the time unit {unit!r}",
        remedy=remedy,
        allowed=f"a unit in the heading, or given as an option: {', '.join(SECONDS)}",
    )


def since_first(clock: Column, second: float) -> NDArray[np.float64]:
    """Return times since the first, s: those since 1970 in nanoseconds have more digits than a float."""
    with np.errstate(over="ignore", invalid="ignore"):
        times: NDArray[np.float64] = (clock.values - clock.values[0]).astype(np.float64) * second
    return times


def differs(clock: Column | None, stated: Stated) -> str:
    """Return what is doubtful where a rate is stated and times have another, in their unit or, if that is not known, in
    any; empty where nothing is.
    """  # fmt: skip
    if clock is None:
        return ""
    unit, rate_hz = _unit_of(clock, stated), stated.rate_hz or 0.0
    if not unit and clock.values.dtype.kind in "iu" and by_one(clock.values):
        return ""
    steps_s = [step_s(clock, replace(stated, time_unit=one)) for one in ([unit] if unit else SECONDS)]
    if any(abs(step * rate_hz - 1) < AGREES for step in steps_s):
        return ""
    mean = f"is {steps_s[0]:g} s" if unit else "fits no unit"
    return f"got --rate {rate_hz:g}, but the mean time step in {clock.name!r} {mean}"


def counts(signal: Column) -> bool:
    """Return whether a column numbers the samples, if need be from its least number again."""
    return is_counter(signal.name) or (signal.values.dtype.kind in "iu" and _by_one_in_turns(signal.values))


def _by_one_in_turns(values: NDArray[Any]) -> bool:
    """Return whether each value is one more than the one before, or the least after the largest."""
    if values.size < 2 or np.any((steps := np.diff(values[:_AT_FIRST])) > 1) or steps[0] != 1:
        return False
    low, high = values.min(), values.max()
    return bool(np.all((np.diff(values) == 1) | ((values[1:] == low) & (values[:-1] == high))))


def by_default(signals: Sequence[Column]) -> int:
    """Return the place of the first column that does not number the samples, rises like no times, and varies."""
    samples = [place for place, one in enumerate(signals) if not counts(one) and not _ramps(one)] or [0]
    varies = (place for place in samples if np.any(signals[place].values[1:] != signals[place].values[0]))
    return next(varies, samples[0])


def _ramps(signal: Column) -> bool:
    """Return whether values rise in even steps, as those of times do of which only the rate is known."""
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(signal.values[:_AT_FIRST])
    rises = steps.size > 1 and bool(np.isfinite(steps).all()) and bool(steps.min() > 0)
    return rises and bool(np.ptp(steps) <= 0.5 * steps.mean())


def by_one(values: NDArray[Any]) -> bool:
    """Return whether each value is the one before, and one more."""
    return values.size > 1 and bool(np.all(np.diff(values) == 1))


def rises_evenly(column: Column) -> bool:
    """Return whether a column that no heading names rises as times do, or as a counter."""
    if column.unit or column.name.lower() not in _SAYS_NOTHING or np.any(column.values[1:] <= column.values[:-1]):
        return False
    try:
        grid.even(since_first(column, 1.0), column.lines, NOTHING_STATED)
    except RecordingError:
        return False
    return True


def nameless_clock(columns: Sequence[Column], stated: Stated, rate: str) -> list[int]:
    """Return the place of times that no heading names; where a rate is stated, there may be none.

    They are the first column, or the second, behind a counter. Raises `RecordingError`, with the likely `rate`, where
    none is stated and the first column does not look like times.
    """
    place = int(len(columns) > 2 and all(map(rises_evenly, columns[:2])) and counts(columns[0]))
    clock = columns[place]
    if stated.rate_hz is None:
        _look_like_times(clock, stated, rate)
    return [place] if stated.rate_hz is None or (rises_evenly(clock) and not counts(clock)) else []


def _look_like_times(first: Column, stated: Stated, rate: str) -> None:
    """Refuse a first column that no heading calls a time and that does not look like times."""
    with np.errstate(over="ignore"):
        steps = np.diff(first.values)
    what = ""
    if first.name.lower() not in _SAYS_NOTHING or first.unit:
        what = f"{first.name!r}"
    elif not np.all(steps > 0):
        what = "values that do not increase"
    elif by_one(first.values):
        what = COUNTER
    if what:
        words = "write a heading such as 'time (s), acceleration (g)', or give the rate"
        options = ("--time-column", "1", "--time-unit", likely_unit(1.0, float(first.values[0])))
        times = what == COUNTER and rate == "HZ" and first.values.dtype.kind not in "iu"
        remedy = (
            ("if this column contains the times, say so with options", *options) if times else (words, "--rate", rate)
        )
        raise RecordingError(
            f"got {what} in the first column, and no column named time",
            remedy=stated.remedy(*remedy),
            allowed="a time column, or a rate given as an option",
            line=first.lines[0],
        )
