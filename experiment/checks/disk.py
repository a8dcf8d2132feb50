"""Checks of the disk that a session is written to: room, and how long an entry takes until it is there for good."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np

from experiment.apparatus.frames import FRAME_BYTES
from experiment.checks.verdict import Check, judged
from experiment.clock import Clock

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
