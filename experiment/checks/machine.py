"""Checks of the machine itself: its clocks, and whether it wakes in time."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from experiment.checks.verdict import Check, judged
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
