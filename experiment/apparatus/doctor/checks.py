"""What a check finds, and the checks that need no driver: of rig file and calibrations, disk, clocks and the machine.

A check is green, red with the remedy, or not checked with the reason. The actuator behind a raw PCM port is only asked
whether its server answers: nothing is sent, so nothing moves. The disk is asked for room, and how long an entry takes
until it is there for good; the machine for its clocks, and whether it wakes in time.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Literal

import numpy as np

from experiment.apparatus import rig as rigs
from experiment.apparatus.panel import response_table as response
from experiment.apparatus.panel.pcm_actuator import PcmActuator
from experiment.apparatus.rig import ActuatorRig, Rig, response_table
from experiment.apparatus.tracker import calibration
from experiment.apparatus.tracker.frames import FRAME_BYTES
from experiment.clock import Clock, day, wall_ns
from experiment.errors import ActuatorError, PalpateError
from experiment.protocol.models import Step

Verdict = Literal["green", "red", "not checked"]


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: what it is.
        verdict: whether a session may rely on it.
        measured: what was found, with units.
        allowed: what may be found; empty where nothing was compared.
        remedy: what to do; empty for green.
    """

    name: str
    verdict: Verdict
    measured: str
    allowed: str = ""
    remedy: str = ""


def judged(name: str, good: bool, measured: str, *, allowed: str, remedy: str) -> Check:
    """Green if `good`, else red with the remedy."""
    return Check(name, "green" if good else "red", measured, allowed, "" if good else remedy)


def unchecked(name: str, reason: str, remedy: str = "") -> Check:
    """What could not be looked at, and why."""
    return Check(name, "not checked", reason, remedy=remedy)


def refused(name: str, error: PalpateError) -> Check:
    """Red, with what an error of palpate says: what it got, what is allowed, and the remedy, which stands last."""
    lines = str(error).splitlines()
    if len(lines) > 1:
        return Check(name, "red", " ".join(line.strip() for line in lines), remedy="correct that file")
    rest, _, remedy = str(error).rpartition("; ")
    measured, _, allowed = rest.partition("; allowed: ")
    return Check(name, "red", measured or remedy, allowed, remedy)


def table(rig: Rig, folder: Path) -> Check | None:
    """Whether the response table is the one whose hash the rig file states, and can be used; None without one.

    Args:
        rig: the rig.
        folder: which holds the rig file.
    """
    shaping = rig.actuator.shaping
    if shaping is None:
        return None
    name = "response table"
    try:
        response_table(folder, shaping)
        measured = response.read(folder / shaping.response)
    except PalpateError as error:
        return refused(name, error)
    low_hz, high_hz = measured.frequencies_hz[0], measured.frequencies_hz[-1]
    return Check(name, "green", f"{shaping.response}: {low_hz:g} to {high_hz:g} Hz, hash as stated")


def reach(rig: Rig, step: Step) -> Check:
    """Whether the calibrated heights reach past a protocol's gate and panel."""
    name = "gate"
    try:
        rigs.check(rig, step)
    except PalpateError as error:
        return refused(name, error)
    heights_mm = [point.mm for point in rig.tracker.calibration]
    lowest, highest = rigs.reach_mm(rig, step)
    return judged(
        name,
        True,
        f"calibrated from {min(heights_mm):g} to {max(heights_mm):g} mm",
        allowed=f"from at most {lowest:g} to at least {highest:g} mm",
        remedy="",
    )


def ages(rig: Rig, today: date) -> tuple[Check, ...]:
    """How old the calibrations are: of the tracker, of the audio device's latency, of the headphones.

    Args:
        rig: the rig; those of a simulated one do not age.
        today: the day of the session.
    """
    tracker, audio = rig.tracker, rig.audio
    found = [
        _age(
            "tracker calibration",
            rig,
            lambda: calibration.check_age(rig, today),
            tracker.calibrated_on,
            tracker.calibration_days,
            today,
        )
    ]
    if audio is not None:
        made, days = audio.latency.calibrated_on, audio.latency.calibration_days
        found.append(_age("audio calibration", rig, lambda: rigs.check_latency(audio, today), made, days, today))
        made, days = audio.headphones.calibrated_on, audio.headphones.calibration_days
        found.append(_age("headphones", rig, lambda: rigs.check_headphones(audio, today), made, days, today))
    return tuple(found)


def _age(name: str, rig: Rig, check: Callable[[], None], made: date | None, days: int | None, today: date) -> Check:
    if rig.rig.simulated:
        return unchecked(name, "calibrations of a simulated rig do not age")
    try:
        check()
    except PalpateError as error:
        return refused(name, error)
    age = (today - made).days if made is not None else 0
    heard = "; its level: not checked, for the machine cannot hear it" if name == "headphones" else ""
    return judged(name, True, f"{age} days old{heard}", allowed=f"0 to {days} days", remedy="")


def answers(address: str, settings: ActuatorRig) -> Check:
    """Whether a connection is accepted.

    Args:
        address: `host:port`.
        settings: of the rig.
    """
    name = "actuator"
    try:
        PcmActuator(
            address, rate_hz=settings.rate_hz, full_scale=settings.full_scale, limit_m_s2=settings.full_scale
        ).reach()
    except ActuatorError as error:
        return refused(name, error)
    return Check(name, "green", f"{address} accepts a connection; nothing was sent")


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
"""99 of 100 sleeps end at most this late, ms, as `devices.DELAY_P99_MS` has it."""


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
