"""A serial line on this machine: a raw pseudo-terminal, or on Windows a TCP server on the loopback interface.

A participant's pedal is the simplest device at the end of one, and buttons are another.
"""

import os
import select
import socket
import threading
import time
from contextlib import suppress
from typing import Literal, Self

from palpate.experiment.clock import Clock

Kind = Literal["pty", "tcp"]

HERE: Kind = "pty" if os.name == "posix" else "tcp"
"""The kind of line that this system has."""

_PATIENCE_S = 0.05
"""How long a full line is given to make room before the writer looks again, s."""


class UnpluggedError(OSError):
    """The device's end of the line is gone."""


class SerialLine:
    """A line that stays usable from one opening of its port to the next, until it is unplugged."""

    def __init__(self, kind: Kind = HERE) -> None:
        """Lay a pseudo-terminal, or a TCP server on the loopback interface."""
        self._end = PseudoTerminal() if kind == "pty" else Server(port=0)
        self._lock = threading.Lock()
        self._unplugged = False
        self.url = self._end.url
        """What pyserial opens."""

    def offer(self, data: bytes | memoryview) -> int:
        """Write what the line takes at once, and return how many bytes. Raises `UnpluggedError`."""
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

    def _check(self) -> None:
        if self._unplugged:
            raise UnpluggedError("the line is unplugged")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()


class SimulatedPedal(SerialLine):
    """A pedal that nobody presses until `press`: it sends what the guide on rigs asks of a board."""

    def __init__(self) -> None:
        """Lay the line, and send heartbeats until it is unplugged."""
        super().__init__()
        self.sends = True
        """Whether its board is alive."""
        threading.Thread(target=self._send, name="pedal's board", daemon=True).start()

    def press(self) -> None:
        """Press and release it."""
        self.write(b"!")

    def _send(self) -> None:
        with suppress(UnpluggedError):
            while self.sends:
                self.offer(b".")
                time.sleep(0.1)


class SimulatedButtons(SerialLine):
    """Buttons that nobody presses until `press`: they send what the guide on rigs asks of a board."""

    def __init__(self, clock: Clock, *, beats: bool) -> None:
        """Lay the line; the board, powered now, counts the time of `clock`, and sends heartbeats if it `beats`."""
        super().__init__()
        self._clock = clock
        self.powered_ns = clock.now_ns()
        self.sends = beats
        """Whether its board is alive."""
        threading.Thread(target=self._send, name="buttons' board", daemon=True).start()

    def press(self, name: str) -> int:
        """Press and release a button; return the time of that by the board, microseconds."""
        at_us = (self._clock.now_ns() - self.powered_ns) // 1000
        self.write(f"{name} {at_us % 2**32}\n".encode())
        return at_us

    def _send(self) -> None:
        with suppress(UnpluggedError):
            while self.sends:
                self.press(".")
                time.sleep(0.05)


class PseudoTerminal:
    """The device's end of a pseudo-terminal."""

    def __init__(self) -> None:
        import pty
        import tty

        self._device, self._port = pty.openpty()
        # Held open, so that the line outlives each reader and keeps raw mode.
        tty.setraw(self._port)
        os.set_blocking(self._device, False)
        self.url = os.ttyname(self._port)

    def take(self, data: memoryview) -> int:
        with suppress(BlockingIOError):
            return os.write(self._device, data)
        return 0

    def wait(self, timeout_s: float) -> None:
        select.select([], [self._device], [], timeout_s)

    def close(self) -> None:
        os.close(self._device)
        os.close(self._port)


class Server:
    """The device's end of a line over TCP; port 0 is any that is free."""

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._server.setblocking(False)
        self._reader: socket.socket | None = None
        self.url = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

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
