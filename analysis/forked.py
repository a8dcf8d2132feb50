"""A call in a fork of this process, while this one does other work."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Found = TypeVar("Found")


@contextmanager
def forked(call: Callable[[], Found]) -> Iterator[Callable[[], Found]]:
    """Run `call` in a fork, and yield what waits for its result, which must be picklable.

    It runs here instead without forks, off the main thread, or after the fork ended early.
    """
    forks = sys.platform == "linux" and not multiprocessing.current_process().daemon
    if not forks or threading.current_thread() is not threading.main_thread():
        yield call
        return
    forking = multiprocessing.get_context("fork")
    receiving, sending = forking.Pipe(duplex=False)
    other = forking.Process(target=_send, args=(call, receiving, sending))
    # The fork keeps the mask: the keyboard interrupts whoever waits for it, and that process ends it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        with warnings.catch_warnings():
            # Another thread may turn the sign that something is being computed; see `_send` for the lock that it holds.
            warnings.simplefilter("ignore", DeprecationWarning)
            other.start()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield call
        return
    sending.close()

    def received() -> Found:
        try:
            return cast("Found", receiving.recv())
        except (EOFError, OSError):
            return call()

    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield received
    finally:
        other.kill()
        other.join()


def _send(call: Callable[[], object], receiving: Connection, sending: Connection) -> None:
    """Send what `call` returns, or nothing: whoever waits for it then calls, and tells what is wrong."""
    # While this end is open here, sending to nobody would never end.
    receiving.close()
    if sys.__stderr__ is not None:
        # The stream that stands in for it may be locked by a thread that this process does not have.
        sys.stderr = sys.__stderr__
    with suppress(Exception):
        sending.send(call())
