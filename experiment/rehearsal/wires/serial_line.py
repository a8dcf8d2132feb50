"""A serial line with both ends on this machine: pyserial opens one, the simulated device writes to the other.

On POSIX it is a pseudo-terminal in raw mode; where there is none (Windows) a TCP server on the loopback interface.
"""

import os
import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Literal, Self

Kind = Literal["pty", "tcp"]

HERE: Kind = "pty" if os.name == "posix" else "tcp"
"""The kind of line that this system has."""

_PATIENCE_S = 0.05
"""How long a full line is given to make room before the writer looks again, s."""


class UnpluggedError(OSError):
    """The device's end of the line is gone."""


class SerialLine:
    """A line that stays usable from one opening of its port to the next, until it is unplugged."""

    def __init__(self, kind: Kind = HERE, *, link: Path | None = None) -> None:
        """Lay a pseudo-terminal, or a TCP server on the loopback interface.

        `link` gives a pseudo-terminal a name that outlasts unplugging, as Linux does under /dev/serial/by-id.
        """
        self._lay: Callable[[], _PseudoTerminal | _Server]
        self._lay = (lambda: _PseudoTerminal(link)) if kind == "pty" else (lambda: _Server(self._tcp_port))
        self._tcp_port = 0
        self._end = self._lay()
        self._tcp_port = self._end.tcp_port
        self._lock = threading.Lock()
        self._unplugged = False
        self.url = self._end.url
        """What pyserial opens."""

    def offer(self, data: bytes | memoryview) -> int:
        """Write what the line takes at once, and return how many bytes that was.

        Raises `UnpluggedError` if the line was unplugged.
        """
        with self._lock:
            self._check()
            return self._end.take(memoryview(data))

    def wait(self) -> None:
        """Give a full line a moment to make room. Raises `UnpluggedError` as `offer`."""
        with self._lock:
            self._check()
            self._end.wait(_PATIENCE_S)

    def write(self, data: bytes) -> None:
        """Write all of it from the device's end, however long the reader takes. Raises `UnpluggedError` as `offer`."""
        left = memoryview(data)
        while left := left[self.offer(left) :]:
            self.wait()

    def unplug(self) -> None:
        """Take the device's end away: the port vanishes under whoever reads it."""
        with self._lock:
            if not self._unplugged:
                self._unplugged = True
                self._end.close()

    def replug(self) -> None:
        """Bring the device's end back after `unplug`, on an empty line; without a link a pseudo-terminal moves."""
        with self._lock:
            if self._unplugged:
                self._end = self._lay()
                self.url = self._end.url
                self._unplugged = False

    def _check(self) -> None:
        if self._unplugged:
            raise UnpluggedError("the line is unplugged")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()


class _PseudoTerminal:
    tcp_port = 0

    def __init__(self, link: Path | None) -> None:
        import pty
        import tty

        self._device, self._port = pty.openpty()
        # Held open, so that the line outlives each reader and keeps raw mode.
        tty.setraw(self._port)
        os.set_blocking(self._device, False)
        self._link = link
        self.url = os.ttyname(self._port)
        if link is not None:
            link.symlink_to(self.url)
            self.url = str(link)

    def take(self, data: memoryview) -> int:
        with suppress(BlockingIOError):
            return os.write(self._device, data)
        return 0

    def wait(self, timeout_s: float) -> None:
        select.select([], [self._device], [], timeout_s)

    def close(self) -> None:
        if self._link is not None:
            self._link.unlink()
        os.close(self._device)
        os.close(self._port)


class _Server:
    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._server.setblocking(False)
        self._reader: socket.socket | None = None
        self.tcp_port = int(self._server.getsockname()[1])
        self.url = f"socket://127.0.0.1:{self.tcp_port}"

    def take(self, data: memoryview) -> int:
        self._accept()
        if self._reader is None:
            return 0
        try:
            return self._reader.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._reader.close()
            self._reader = None
            return 0

    def wait(self, timeout_s: float) -> None:
        if self._reader is None:
            select.select([self._server], [], [], timeout_s)
        else:
            select.select([self._server], [self._reader], [], timeout_s)

    def close(self) -> None:
        for end in (self._reader, self._server):
            if end is not None:
                end.close()

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            connection, _ = self._server.accept()
            if self._reader is not None:
                self._reader.close()
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._reader = connection
