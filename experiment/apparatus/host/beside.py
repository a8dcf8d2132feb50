"""Processes beside that of a session: simulated devices, the ear, consoles."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import connection

from palpate.experiment.apparatus.host import REAL_TIME, is_real_time


def raise_above_sessions() -> None:
    """Have the calling thread, which simulates a device, run above every session in real time: else it seems late."""
    if is_real_time():
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME + 2))


def end_with_parent() -> None:
    """Have this process, which another one started, end with that one, however that ends."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def be_ordinary() -> None:
    """Take the calling thread from real time, where it inherited that, so that the session never waits for it."""
    if is_real_time():
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def held_back() -> Iterator[None]:
    """Keep Ctrl-C, which reaches every process of a terminal, from those that begin here before they can ignore it."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
