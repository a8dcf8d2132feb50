"""Serial ports: which ones this machine has, who uses them, and a port that one thread waits at while others use it.

A port is a device path, a pseudo-terminal, or a URL that pyserial opens, such as `socket://host:port`.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import threading
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.experiment.errors import TrackerError

if TYPE_CHECKING:
    import serial


@dataclass(frozen=True)
class SerialDevice:
    """A serial port's name, the system's name, its programs, and its identity wherever it is plugged in, if any."""

    port: str
    description: str
    identity: str
    held_by: tuple[str, ...]


def devices() -> tuple[SerialDevice, ...]:
    """Return every serial port, in the order of their names."""
    from serial.tools.list_ports import comports

    return tuple(
        SerialDevice(found.device, found.description or "", _identity(found), holders(found.device))
        for found in sorted(comports())
    )


def identity_of(port: str) -> str:
    """Return what is behind a port, wherever it is plugged in; empty for a port that has no such name."""
    from serial.tools.list_ports import comports

    resolved = str(Path(port).resolve())
    return next((_identity(found) for found in comports() if found.device in (port, resolved)), "")


def port_of(identity: str) -> str | None:
    """Return the port where a device is now; None while it is not plugged in."""
    from serial.tools.list_ports import comports

    return next((found.device for found in comports() if identity and _identity(found) == identity), None)


def present(table: str) -> str:
    """Return what is connected, as part of a message for who corrects a table of the rig file."""
    found = ", ".join(device.port for device in devices())
    return f"connected ports are {found}; set {table}.port in the rig file" if found else "no serial port is connected"


def holders(port: str) -> tuple[str, ...]:
    """Return the other programs, `name (process number)`, with a port open; Linux tells, of others to superusers."""
    try:
        device = Path(port).stat().st_rdev
    except OSError:
        return ()
    others = (process for process in Path("/proc").glob("[0-9]*") if int(process.name) != os.getpid())
    holding = [f"{_name(process)} ({process.name})" for process in others if device and _has_open(process, device)]
    return tuple(sorted(holding))


def _has_open(process: Path, device: int) -> bool:
    try:
        return any(_device(file) == device for file in (process / "fd").iterdir())
    except OSError:
        # The process is another user's, or has ended.
        return False


def _device(file: Path) -> int:
    try:
        return file.stat().st_rdev
    except OSError:
        return 0


def _name(process: Path) -> str:
    try:
        return (process / "comm").read_text("utf-8", "replace").strip()
    except OSError:
        return "a program"


def _identity(found: object) -> str:
    """Return vendor, product and serial number of a USB device."""
    vid, pid, number = (getattr(found, name, None) for name in ("vid", "pid", "serial_number"))
    return f"{vid:04x}:{pid:04x}:{number}" if vid is not None and pid is not None and number else ""


CALM_BYTES = 512
"""A look at a URL's port is calm if it finds no more than this."""

CALM_LOOKS = 2
"""Emptying a URL's port ends after this many calm looks one after the other."""

SETTLE_S = 0.001
"""How long the operating system gets between two looks to pass on what it holds, s."""

MOST_LOOKS = 1000
"""Emptying ends after this many looks, even if bytes still come."""

LOOK_S = 0.001
"""How often a port is looked at where the system cannot wait for it (Windows), s."""

LARGEST_READ = 65536

LINE_BYTES = 4095
"""What a full line of Linux gives to one read: more may wait behind it."""

VANISHED: tuple[type[Exception], ...] = (OSError,)
"""What a port that has gone raises."""
if find_spec("termios"):
    import termios

    VANISHED = (OSError, termios.error)


class SerialPort:
    """An open port."""

    def __init__(self, name: str, baud: int, *, device: str = "tracker") -> None:
        """Open a path or pyserial URL, alone if possible; `device` is its table in the rig. Raises `TrackerError`."""
        self._port = open_port(name, baud, device)
        self._is_device = "://" not in name
        self._selectable = hasattr(self._port, "fileno")
        self._woken = threading.Event()
        self._waker, self._wakes = socket.socketpair()

    def wait(self, timeout_s: float) -> bool:
        """Return True once something has come or the port has gone, False after the time or `wake`."""
        if not self._selectable:
            for _ in range(max(round(timeout_s / LOOK_S), 1)):
                if self._port.in_waiting:
                    return True
                if self._woken.wait(LOOK_S):
                    return False
            return False
        return self._ready(timeout_s)

    def take(self, refill_s: float = 0.0) -> bytes:
        """Return what has come, without waiting, or raise one of `VANISHED`; a full line refills within `refill_s`."""
        if self._selectable and os.name == "posix":
            # Another look may have taken what `wait` saw. A port that has gone seems ready all the time, and is empty.
            data = part = self._read()
            if not data and self._ready(0.0) and not (data := self._read()):
                raise OSError(errno.EIO, "it seems ready but returns no data; it may be unplugged")
            while len(part) >= LINE_BYTES and len(data) < LARGEST_READ and self._ready(refill_s):
                try:
                    data += (part := self._read())
                except VANISHED:
                    # What was read before is given; whoever takes next learns of it.
                    break
            return data
        # A URL handler says that something waits, not how much.
        size = (self._port.in_waiting or 1) if self._is_device else LARGEST_READ
        return bytes(self._port.read(size))

    def check(self) -> None:
        """Read nothing; raise one of `VANISHED` if the port has gone."""
        self._port.in_waiting  # noqa: B018

    def discard(self) -> None:
        """Throw away what came before now; raise one of `VANISHED` if the port has gone."""
        if self._is_device:
            self._port.reset_input_buffer()
            return
        # Nothing can tell it to. One look is not enough, for some bytes may still be on their way.
        calm_looks = 0
        for _ in range(MOST_LOOKS):
            calm_looks = calm_looks + 1 if len(self.take()) <= CALM_BYTES else 0
            if calm_looks == CALM_LOOKS:
                return
            time.sleep(SETTLE_S)

    def _ready(self, timeout_s: float) -> bool:
        woken = self._wakes.fileno()
        ready, _, _ = select.select([self._port.fileno(), woken], [], [], timeout_s)
        return bool(ready) and woken not in ready

    def _read(self) -> bytes:
        try:
            return os.read(self._port.fileno(), LARGEST_READ)
        except BlockingIOError:
            return b""

    def wake(self) -> None:
        """Have `wait` return at once, now and from now on."""
        self._woken.set()
        self._waker.send(b"\0")

    def close(self) -> None:
        """Close it; nobody may be waiting any more."""
        # pyserial leaves a socket open whose other end went away first.
        connection = getattr(self._port, "_socket", None)
        self._port.close()
        for end in (connection, self._waker, self._wakes):
            if end is not None:
                end.close()


def reason(error: BaseException) -> str:
    """Return an operating system's words on one line."""
    return " ".join(str(error).split())


def open_port(port: str, baud: int, device: str) -> serial.Serial:
    import serial

    try:
        return serial.serial_for_url(port, baudrate=baud, timeout=0, exclusive=True)
    except OSError as error:
        busy = f"{', '.join(holders(port)) or 'another program'} is using it", "close that program"
        unknown = reason(error), f"check that it is a working serial port; {present(device)}"
        what, remedy = {
            errno.ENOENT: ("no such port", present(device)),
            errno.EACCES: ("not permitted", "let this user open serial ports (on Linux: group dialout)"),
            errno.EBUSY: busy,
            errno.EAGAIN: busy,
        }.get(error.errno or 0, unknown)
        raise TrackerError(f"{device} at {port}", what, remedy) from error
    except ValueError as error:
        raise TrackerError(f"{device} at {port}", str(error), f"correct [{device}] in the rig file") from error
