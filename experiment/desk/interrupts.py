"""Ctrl-C during a step, or a session's last line: it is raised once what was felt is on file.

Closing a terminal or shutting down is the same. The wait for a foot may be interrupted
(`DeferredInterrupt.let_through`).
"""

import multiprocessing
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE_S = 5.0
"""A key pressed again so long after the first is raised at once, s: what it waits for may never end."""

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""What interrupts a session, Ctrl-C first."""


class DeferredInterrupt:
    """An interrupt that waits."""

    def __init__(self) -> None:
        self._pressed_s: float | None = None
        self._through = False

    @property
    def pressed(self) -> bool:
        """Whether one waits."""
        return self._pressed_s is not None

    @contextmanager
    def let_through(self) -> Iterator[None]:
        """Raise at once an interrupt that comes meanwhile, or waits already; a second one waits again."""
        self._through = True
        try:
            if self.pressed:
                self._raise()
            yield
        finally:
            self._through = False

    def come(self, *_: object) -> None:
        """Take note that the key was pressed."""
        now_s = time.monotonic()
        if self._pressed_s is None:
            self._pressed_s = now_s
        if self._through or now_s - self._pressed_s > PATIENCE_S:
            self._raise()

    def _raise(self) -> None:
        self._pressed_s, self._through = None, False
        raise KeyboardInterrupt


@contextmanager
def deferred() -> Iterator[DeferredInterrupt]:
    """Defer interrupts until the end, then raise one that came, unless something else was raised.

    This is for Python's own `KeyboardInterrupt` in the main thread, without another handler.
    """
    waits = DeferredInterrupt()
    held = _handled_by(signal.default_int_handler)
    for number in held:
        signal.signal(number, waits.come)
    try:
        yield waits
    finally:
        for number in held:
            signal.signal(number, signal.default_int_handler)
    if waits.pressed:
        raise KeyboardInterrupt


@contextmanager
def all_alike() -> Iterator[None]:
    """Have every signal that would end the process interrupt it as Ctrl-C does; a worker is for its parent to end."""
    ending = _handled_by(signal.SIG_DFL) if multiprocessing.parent_process() is None else []
    for number in ending:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in ending:
            signal.signal(number, signal.SIG_DFL)


def report_to(descriptor: int) -> int:
    """Write signals to a descriptor, -1 for none, as they come; return the one before, -1 off the main thread."""
    if threading.current_thread() is not threading.main_thread():
        return -1
    return signal.set_wakeup_fd(descriptor, warn_on_full_buffer=False)


def _handled_by(handler: object) -> list[int]:
    if threading.current_thread() is not threading.main_thread():
        return []
    return [number for number in SIGNALS if signal.getsignal(number) is handler]
