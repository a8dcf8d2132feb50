"""A session on a core of its own, and what works beside it on the others.

A thread that wakes another on the same core hands over in one switch; one on another core has to be called there, which
takes longer, on a virtual machine by far. The session waits for its tracker's thread, so both share a core. What is
started `elsewhere`, such as the audio callback, takes nothing from them but its turn at the interpreter.

The core is the fastest that no other session keeps to; of equals the last, for systems give most of their own work to
the first. One is left to all else: a session that finds none, that the system does not let go there, or that runs
elsewhere than on Linux, stays where it is.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

FREQUENCY = "/sys/devices/system/cpu/cpu{}/cpufreq/cpuinfo_max_freq"
HELD = "\0palpate-core-{}"
"""Name of a socket without a file, which the session holds that keeps to a core; the kernel frees it however that
ends."""

_left: ContextVar[frozenset[int]] = ContextVar("_left", default=frozenset())
"""The cores that the session leaves to others; none where it keeps to no core."""


@contextmanager
def kept() -> Iterator[int | None]:
    """Keep the calling thread, and what it starts meanwhile, on one core; at the end the thread goes back.

    Yields:
        The core; None where there is none to keep to.
    """
    before = _allowed()
    with _taken(before) as core:
        if core is None:
            yield None
            return
        token = _left.set(before - {core})
        try:
            yield core
        finally:
            _left.reset(token)
            _go_to(before)


@contextmanager
def elsewhere() -> Iterator[None]:
    """What the thread that keeps to a core starts meanwhile runs on the cores that it leaves."""
    before = _allowed()
    _go_to(_left.get())
    try:
        yield
    finally:
        _go_to(before)


def leaving() -> Callable[[], bool]:
    """What a thread that was there before calls to leave the core of the session that asks here, as its thread."""
    left = _left.get()
    return lambda: _go_to(left)


@contextmanager
def _taken(cores: frozenset[int]) -> Iterator[int | None]:
    """Go to one of the cores and hold it."""
    for core in sorted(cores, key=lambda core: (_fastest_khz(core), core), reverse=True)[:-1]:
        with socket.socket(socket.AF_UNIX) as held:
            try:
                held.bind(HELD.format(core))
            except OSError:  # Another session keeps to it.
                continue
            if _go_to(frozenset({core})):
                yield core
                return
    yield None


def _fastest_khz(core: int) -> int:
    """What the core reaches; 0 where the system does not say, as on a virtual machine."""
    try:
        return int(Path(FREQUENCY.format(core)).read_text("ascii"))
    except (OSError, ValueError):
        return 0


if sys.platform == "linux":

    def _allowed() -> frozenset[int]:
        return frozenset(os.sched_getaffinity(0))

    def _go_to(cores: frozenset[int]) -> bool:
        """Whether the system lets the thread run on these cores alone; on none it lets nobody."""
        try:
            os.sched_setaffinity(0, cores)
        except OSError:
            return False
        return True

else:

    def _allowed() -> frozenset[int]:
        return frozenset()

    def _go_to(_cores: frozenset[int]) -> bool:
        return False
