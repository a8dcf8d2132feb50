"""The process of a session on its machine: priority, core, memory and collections, for as long as the session runs.

`experiment/decisions.md` says why. What begins at a sound server takes turns with palpate's others (`taking_turns`).
"""

import ctypes
import gc
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path

from filelock import FileLock
from threadpoolctl import threadpool_limits

FREQUENCY = "/sys/devices/system/cpu/cpu{}/cpufreq/cpuinfo_max_freq"
HELD = "\0palpate-core-{}"
"""Name of a socket without a file, held by a session that is pinned to a core; the kernel frees it in any case."""

IN_MEMORY = "/dev/shm" if os.path.isdir("/dev/shm") else None  # noqa: PTH112, S108
"""Where files never wait for a disk, and where JACK's servers and clients share theirs; None without such a place."""

TURN_S = 5.0
"""Longest turn of another process, s: a server starts or stops in less, so this one then waits no longer."""

_left: ContextVar[frozenset[int]] = ContextVar("_left", default=frozenset())
"""The cores that the session leaves to others; none where it keeps to no core."""

_waits_for_others = True


@contextmanager
def taking_turns() -> Iterator[None]:
    """Let no other process of palpate's begin at a sound server, or start or stop one, meanwhile.

    A user's JACK servers and clients share one database. Two that begin at once may miss each other or tear it; then
    whatever opens it ends with a bus error until `/dev/shm/jack_db-UID` is deleted.
    """
    global _waits_for_others
    with ExitStack() as held:
        if sys.platform == "linux" and IN_MEMORY and _waits_for_others:
            try:
                held.enter_context(FileLock(f"{IN_MEMORY}/palpate-sound-{os.getuid()}.lock", TURN_S, is_singleton=True))
            except OSError:  # It began out of turn rather than not at all.
                _waits_for_others = False
        yield


@contextmanager
def pinned() -> Iterator[int | None]:
    """Keep the calling thread, and what it starts meanwhile, on one core. Yields that core, None without one."""
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
    """Have what the thread that keeps to a core starts meanwhile run on the cores that it leaves."""
    before = _allowed()
    _go_to(_left.get())
    try:
        yield
    finally:
        _go_to(before)


def leaving() -> Callable[[], bool]:
    """Return what a thread that was there before calls, as its thread, to leave the core of the session asking here."""
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
    """Return what the core reaches; 0 where the system does not say, as on a virtual machine."""
    try:
        return int(Path(FREQUENCY.format(core)).read_text("ascii"))
    except (OSError, ValueError):
        return 0


if sys.platform == "linux":

    def _allowed() -> frozenset[int]:
        return frozenset(os.sched_getaffinity(0))

    def _go_to(cores: frozenset[int]) -> bool:
        """Return whether the system lets the thread run on these cores alone; no thread may run on none."""
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


REAL_TIME = 1
"""The lowest of the real-time priorities; what the session must never hold up is one higher."""

LEAST_NICE, FAVOURED_NICE = -20, -10

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's `mallopt`."""

KEPT_BYTES = 2**28
LARGEST_KEPT_BYTES = 2**25
"""An array larger than this goes back to the system whatever is kept; glibc allows no more."""

THROTTLE = Path("/proc/sys/kernel/sched_rt_runtime_us")
PERIOD = THROTTLE.with_name("sched_rt_period_us")
"""How much of each second real-time threads may take, us; -1 for all of it."""


@contextmanager
def raised() -> Iterator[str]:
    """Raise the calling thread, and what it starts meanwhile, until the end. Yields the priority in words.

    In real time it is also pinned, linear algebra uses no further threads, and existing objects are never collected.
    """
    gc.collect()
    gc.freeze()
    try:
        with threadpool_limits(1, user_api="blas"):
            if sys.platform == "linux":
                mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # glibc has it, other libraries may not
                if mallopt is not None:
                    mallopt(MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
                    mallopt(TRIM_THRESHOLD, KEPT_BYTES)
                with _raised_on_linux() as got:
                    yield got
            else:
                yield "ordinary, because palpate raises it only on Linux; close other programs"
    finally:
        gc.unfreeze()


def is_real_time() -> bool:
    """Return whether the calling thread runs in real time."""
    return _real_time_level() > 0


def joining() -> Callable[[], None]:
    """Return what a library's thread calls to run just above the caller, if that one runs in real time.

    Without a step above it runs beside it; a thread that is higher already stays there.
    """
    real_time = is_real_time()

    def join() -> None:
        for level in (REAL_TIME, REAL_TIME + 1):
            if real_time and _real_time_level() < level:
                with suppress(PermissionError):
                    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(level))

    return join


def favour() -> None:
    """Have the calling thread, for which a person waits, and what it starts wait less for other work, if allowed."""
    if sys.platform == "linux":
        _be_less_nice(os.getpriority(os.PRIO_PROCESS, 0), FAVOURED_NICE)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Collect nothing until the end of what must not wait; what would have been freed is freed soon after."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def _real_time_level() -> int:
    """Return the calling thread's real-time priority; 0 for none."""
    if sys.platform != "linux":
        return 0
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return os.sched_getparam(0).sched_priority if policy in (os.SCHED_RR, os.SCHED_FIFO) else 0


if sys.platform == "linux":

    @contextmanager
    def _raised_on_linux() -> Iterator[str]:
        policy, parameters, nice = os.sched_getscheduler(0), os.sched_getparam(0), os.getpriority(os.PRIO_PROCESS, 0)
        try:
            got = _raise(nice)
            with pinned() if is_real_time() else nullcontext() as core:
                yield got if core is None else f"{got}, on core {core} only"
        finally:
            # What was taken may be given back without any right.
            if os.sched_getscheduler(0) != policy:
                os.sched_setscheduler(0, policy, parameters)
            if os.getpriority(os.PRIO_PROCESS, 0) != nice:
                os.setpriority(os.PRIO_PROCESS, 0, nice)

    def _raise(nice: int) -> str:
        if _throttled():
            try:
                os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME))
            except PermissionError:
                pass
            else:
                return "real time"
        less_nice = _be_less_nice(nice, LEAST_NICE)
        return f"ordinary: {_MORE}" if less_nice is None else f"nice {less_nice}: {_MORE}"

    def _be_less_nice(nice: int, wanted: int) -> int | None:
        """Return the niceness that the thread has instead of `nice`: the wanted one, or as near as is allowed."""
        import resource

        allowed = 20 - resource.getrlimit(resource.RLIMIT_NICE)[0]
        for less_nice in sorted({wanted, max(wanted, allowed)}):
            if less_nice < nice:
                try:
                    os.setpriority(os.PRIO_PROCESS, 0, less_nice)
                except PermissionError:
                    continue
                return less_nice
        return None

    def _throttled() -> bool:
        """Return whether the kernel keeps real-time threads from taking a core for themselves."""
        try:
            share_us, of_us = (int(file.read_text("ascii")) for file in (THROTTLE, PERIOD))
            return 0 <= share_us < of_us
        except (OSError, ValueError):
            return False

    _MORE = (
        "the system allows no more; for real time, add the user to the group audio, set its rtprio to 10 in "
        "/etc/security/limits.d, and do not change kernel.sched_rt_runtime_us"
    )
