"""REHEARSAL: a process beside the simulated sound card, off the session's interpreter, that ends with its starter."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import BinaryIO

from palpate.experiment import storage

PATIENCE_S = 10.0
"""How long it may take to begin, to answer and to end, s."""

ENDS_S = 5
"""So long after its line has ended the process has ended too, s."""


class Neighbour:
    """The process as whoever starts it sees it: its `pid`, and the `line` to it, of which a read raises `OSError`."""

    def __init__(self, module: str, *arguments: str) -> None:
        """Run a module with its standard input and output on the line."""
        ours, theirs = socket.socketpair()
        with ours, theirs:
            ours.settimeout(PATIENCE_S)
            self.line = ours.makefile("rwb")
            self._process = subprocess.Popen(  # noqa: S603
                storage.python_command("-m", module, *arguments),
                stdin=theirs.fileno(),
                stdout=theirs.fileno(),
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        self.pid = self._process.pid

    def kill(self) -> None:
        """End it at once, and close the line."""
        self._process.kill()
        self.close()

    def close(self) -> None:
        """Close the line, and see the process end."""
        with suppress(OSError):  # It has gone.
            self.line.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:  # The server stands still.
            self._process.kill()
            self._process.wait()


def end_soon() -> None:
    """Have the system end this process after `ENDS_S`: a client whose server was killed cannot always be closed."""
    signal.alarm(ENDS_S)


@contextmanager
def far_end() -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Give what the process reads from its line, and what it writes to: a library that prints does not reach it."""
    with os.fdopen(os.dup(1), "wb") as told:
        os.dup2(2, 1)
        yield sys.stdin.buffer, told
