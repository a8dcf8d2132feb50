"""Ctrl-C while a step is under way, or a session's last line is written: it comes when what was felt is on file.

The wait for a foot may be interrupted (`Held.let_through`), for until contact nothing was felt that cannot be told.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Held:
    """An interrupt that waits."""

    def __init__(self) -> None:
        self.pressed = False
        """Whether one waits."""
        self._through = False

    @contextmanager
    def let_through(self) -> Iterator[None]:
        """One that comes meanwhile, or waits already, is raised at once; a second one waits again."""
        self._through = True
        try:
            self._raise()
            yield
        finally:
            self._through = False

    def come(self, *_: object) -> None:
        """The key was pressed."""
        self.pressed = True
        if self._through:
            self._raise()

    def _raise(self) -> None:
        if self.pressed:
            self.pressed = self._through = False
            raise KeyboardInterrupt


@contextmanager
def held() -> Iterator[Held]:
    """Interrupts wait until the end, and are raised then, unless something else was.

    Only where Ctrl-C is Python's own `KeyboardInterrupt`: in the main thread, and with no handler of somebody else's.

    Raises:
        KeyboardInterrupt: the key was pressed meanwhile.
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
