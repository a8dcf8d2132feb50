"""Ctrl-C while a step is under way, or a session's last line is written: it comes when what was felt is on file.

The wait for a foot may be interrupted (`Held.let_through`), for until contact nothing was felt that cannot be told.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE_S = 5.0
"""A key pressed again so long after the first is raised at once, s: what it waits for may never end."""


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

    This holds only where Ctrl-C is Python's own `KeyboardInterrupt`: in the main thread, and with nobody else's
    handler.
    """
    waits = Held()
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield waits
        return
    signal.signal(signal.SIGINT, waits.come)
    try:
        yield waits
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if waits.pressed:
        raise KeyboardInterrupt
