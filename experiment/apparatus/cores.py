"""A session on one core of the machine, and all else on the others.

A thread that wakes another on the same core hands over in one switch; one on another core has to be called there, which
takes longer, on a virtual machine by far. The session waits for its tracker's thread, so both share a core. What works
beside them, such as the audio callback, has the other cores, and takes nothing from them but its turn at the
interpreter.

The core is the fastest that no other session keeps to; of equals the last, for systems give most of their own work to
the first. One is left to all else: a session that finds none, or runs elsewhere than on Linux, stays where it is.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from filelock import FileLock

FREQUENCY = "/sys/devices/system/cpu/cpu{}/cpufreq/cpuinfo_max_freq"
LOCK = "palpate-core-{}-{}.lock"
"""In the system's folder for temporary files, of a user and a core: held by the session that keeps to it."""

_left: ContextVar[frozenset[int]] = ContextVar("_left", default=frozenset())
"""The cores that the session leaves to others; none where it keeps to no core."""


@contextmanager
def kept() -> Iterator[None]:
    """Keep the calling thread, and what it starts meanwhile, on one core; at the end it may go anywhere again."""
    before = _allowed()
    with _taken(before) as own:
        token = _left.set(before - own if own else own)
        try:
            _go_to(own)
            yield
        finally:
            _go_to(before)
            _left.reset(token)


@contextmanager
def elsewhere() -> Iterator[None]:
    """What is started meanwhile runs on the cores that the session leaves."""
    before = _allowed()
    leaving()()
    try:
        yield
    finally:
        _go_to(before)


def leaving() -> Callable[[], None]:
    """What a thread that a library starts calls to leave the core of the session that asks here."""
    left = _left.get()
    return lambda: _go_to(left)


@contextmanager
def _taken(cores: frozenset[int]) -> Iterator[frozenset[int]]:
    """The session's own core, of those that it may use, held until the end; none where there is none."""
    for core in sorted(cores, key=lambda core: (_fastest_khz(core), core), reverse=True)[:-1]:
        lock = FileLock(Path(tempfile.gettempdir()) / LOCK.format(os.getuid(), core), timeout=0)
        try:
            lock.acquire()
        except OSError:  # Another session keeps to it, or nobody can tell.
            continue
        try:
            yield frozenset({core})
        finally:
            lock.release()
        return
    yield frozenset()


def _fastest_khz(core: int) -> int:
    """What the core reaches; 0 where the system does not say, as on a virtual machine."""
    try:
        return int(Path(FREQUENCY.format(core)).read_text("ascii"))
    except (OSError, ValueError):
        return 0


if sys.platform == "linux":

    def _allowed() -> frozenset[int]:
        return frozenset(os.sched_getaffinity(0))

    def _go_to(cores: frozenset[int]) -> None:
        if cores:
            os.sched_setaffinity(0, cores)

else:

    def _allowed() -> frozenset[int]:
        return frozenset()

    def _go_to(cores: frozenset[int]) -> None:
        pass
