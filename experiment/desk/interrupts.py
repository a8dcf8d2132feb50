"""Ctrl-C while a step is under way, or a session's last line is written: it comes when what was felt is on file.

A terminal that is closed, and a system that shuts down, end a session as Ctrl-C does. The wait for a foot may be
interrupted (`Held.let_through`), for until contact nothing was felt that cannot be told.
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


class Held:
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
def held() -> Iterator[Held]:
    """Have interrupts wait until the end; one that came is raised then, unless something else was.

    This holds only for signals that are Python's own `KeyboardInterrupt`: in the main thread, and with nobody else's
    handler.
    """
    waits = Held()
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
    """Have each signal written to a descriptor as it comes, whatever the main thread does; -1 is for none.

    Return the descriptor before, and -1 outside of the main thread, where this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        return -1
    return signal.set_wakeup_fd(descriptor, warn_on_full_buffer=False)


def _handled_by(handler: object) -> list[int]:
    if threading.current_thread() is not threading.main_thread():
        return []
    return [number for number in SIGNALS if signal.getsignal(number) is handler]
