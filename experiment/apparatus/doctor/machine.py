"""Checks of the machine itself: its clocks, and whether it wakes in time.

Checks of the disk that a session is written to: room, and how long an entry takes until it is there for good.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiment.apparatus.doctor.verdict import Check, judged
from experiment.apparatus.tracker.frames import FRAME_BYTES
from experiment.clock import Clock, day, wall_ns

BUILT_YEAR = 2026
"""No session is run before palpate was written."""

RESOLUTION_US = 10.0
"""Coarsest step of the monotonic clock, microseconds."""

SET_MS = 10.0
"""By how much wall clock and session clock may part during the checks, ms: one that is slewed parts by 0.5 ms a second,
one that is set by any amount."""

SLEEPS = 200
SLEEP_NS = 1_000_000
LATE_MS = 10.0
"""99 of 100 sleeps end at most this late, ms, as `tracker.DELAY_P99_MS` has it."""


@dataclass(frozen=True)
class Mark:
    """Both clocks at a moment, ns."""

    clock_ns: int
    wall_ns: int


def mark(clock: Clock) -> Mark:
    """Both clocks now."""
    return Mark(clock.now_ns(), wall_ns())


def resolution(clock: Clock) -> Check:
    """How fine the session's clock is.

    Args:
        clock: the session's; it must go by itself.
    """
    steps_ns: list[int] = []
    before_ns = clock.now_ns()
    while len(steps_ns) < 100:
        now_ns = clock.now_ns()
        if now_ns > before_ns:
            steps_ns.append(now_ns - before_ns)
            before_ns = now_ns
    finest_us = min(steps_ns) / 1e3
    return judged(
        "clock resolution",
        finest_us <= RESOLUTION_US,
        f"{finest_us:.3g} us between two readings",
        allowed=f"at most {RESOLUTION_US:g} us",
        remedy="on Linux choose the clock source tsc; run sessions on a machine of its own, not a virtual one",
    )


def wall(begun: Mark, ended: Mark) -> Check:
    """Whether the wall clock is set, and nobody set it meanwhile.

    Args:
        begun: before the other checks.
        ended: after them.
    """
    today = day(ended.wall_ns)
    parted_ms = ((ended.wall_ns - begun.wall_ns) - (ended.clock_ns - begun.clock_ns)) / 1e6
    seconds = (ended.clock_ns - begun.clock_ns) / 1e9
    return judged(
        "wall clock",
        today.year >= BUILT_YEAR and abs(parted_ms) <= SET_MS,
        f"{today}, parted from the session's clock by {parted_ms:+.3f} ms in {seconds:.1f} s",
        allowed=f"{BUILT_YEAR} or later, at most {SET_MS:g} ms",
        remedy="set the clock, or wait until the time service has",
    )


def waking(clock: Clock) -> Check:
    """How late sleeps end, and how loaded the machine is.

    Args:
        clock: the session's.
    """
    late_ms = []
    for _ in range(SLEEPS):
        begun_ns = clock.now_ns()
        clock.sleep_ns(SLEEP_NS)
        late_ms.append((clock.now_ns() - begun_ns - SLEEP_NS) / 1e6)
    median, p99, longest = (float(np.quantile(late_ms, q)) for q in (0.5, 0.99, 1.0))
    return judged(
        "machine load",
        p99 <= LATE_MS,
        f"sleeps end late by {median:.2f} ms (median), {p99:.2f} ms (p99), {longest:.2f} ms (longest){_load()}",
        allowed=f"p99 at most {LATE_MS:g} ms",
        remedy="close other programs, or raise palpate's priority",
    )


def _load() -> str:
    if not hasattr(os, "getloadavg"):
        return ""
    return f"; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, niceness {os.nice(0)}"


ARMED_S = 60.0
"""How long the foot may be recorded in a trial, s. In the rehearsal it is 0.9 s (10.7 kB a trial at 1 kHz), because a
simulated foot never waits."""

COPIES = 2
"""The raw frames, and the dataset's own form of them, which compressed takes a fifth."""

JOURNAL_BYTES = 2000
"""Entries of a trial in the journal: 1,450 bytes in the rehearsal."""

ENTRIES = 20
"""How many entries are written."""

ENTRY = b"palpate doctor".ljust(500, b".") + b"\n"

BUDGET_MS = 50.0
"""Time between an answer and the next trial's arming that the experimenter does not notice, ms."""


def session_bytes(*, trials: int, rate_hz: int) -> int:
    """What a session writes at most.

    Args:
        trials: of the session.
        rate_hz: of the tracker.
    """
    return math.ceil(trials * (COPIES * ARMED_S * rate_hz * FRAME_BYTES + JOURNAL_BYTES))


def space(folder: Path, *, trials: int, rate_hz: int) -> Check:
    """Whether a session has room.

    Args:
        folder: of the dataset; it need not be there yet.
        trials: of the longest task.
        rate_hz: of the tracker.
    """
    name, there = "disk space", _there(folder)
    needed = session_bytes(trials=trials, rate_hz=rate_hz)
    try:
        free = shutil.disk_usage(there).free
    except OSError as error:
        return Check(
            name, "red", f"{there}: {error.strerror or error}", remedy="see to the disk, or name another folder"
        )
    return judged(
        name,
        free >= needed,
        f"{free / 1e6:,.0f} MB free at {there}",
        allowed=f"at least {needed / 1e6:,.0f} MB: {trials} trials of {ARMED_S:g} s at {rate_hz} Hz, kept twice",
        remedy="make room, or name a dataset on another disk",
    )


def writing(folder: Path, clock: Clock) -> Check:
    """Whether this user may write there, and how long an entry takes to be on disk.

    Args:
        folder: of the dataset; where it is not there yet, the nearest folder above that is.
        clock: times the writing.
    """
    name, there = "disk writing", _there(folder)
    took_ms = []
    try:
        with tempfile.TemporaryFile(prefix=".palpate-doctor-", dir=there, buffering=0) as file:
            for _ in range(ENTRIES):
                begun_ns = clock.now_ns()
                file.write(ENTRY)
                os.fsync(file.fileno())
                took_ms.append((clock.now_ns() - begun_ns) / 1e6)
    except OSError as error:
        return Check(
            name,
            "red",
            f"{there}: nothing can be written ({error.strerror or error})",
            remedy="let this user write there, or name another folder with --dataset",
        )
    median, worst = float(np.median(took_ms)), max(took_ms)
    return judged(
        name,
        worst <= BUDGET_MS,
        f"an entry is on disk in {median:.2f} ms (median), {worst:.2f} ms (worst of {ENTRIES}) at {there}",
        allowed=f"at most {BUDGET_MS:g} ms, so that no participant waits",
        remedy="keep the dataset on a local disk, not a network's or a memory stick; close what else writes",
    )


def _there(folder: Path) -> Path:
    resolved = folder.resolve()
    return next((one for one in (resolved, *resolved.parents) if one.is_dir()), resolved)
