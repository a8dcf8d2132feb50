"""Serial ports of this machine: which there are, what is behind them, and who holds them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SerialDevice:
    """A serial port.

    Attributes:
        port: what a rig file names.
        description: what the system calls it.
        identity: the same wherever it is plugged in; empty for a port that has none.
        held_by: programs that have it open, as far as this user may see.
    """

    port: str
    description: str
    identity: str
    held_by: tuple[str, ...]


def devices() -> tuple[SerialDevice, ...]:
    """Every serial port, in the order of their names."""
    from serial.tools.list_ports import comports

    return tuple(
        SerialDevice(found.device, found.description or "", _identity(found), holders(found.device))
        for found in sorted(comports())
    )


def identity_of(port: str) -> str:
    """What is behind a port, wherever it is plugged in; empty for a port that has no such name."""
    from serial.tools.list_ports import comports

    resolved = str(Path(port).resolve())
    return next((_identity(found) for found in comports() if found.device in (port, resolved)), "")


def port_of(identity: str) -> str | None:
    """Where a device is now; None while it is not plugged in."""
    from serial.tools.list_ports import comports

    return next((found.device for found in comports() if identity and _identity(found) == identity), None)


def present() -> str:
    """What is connected, as part of a message."""
    found = ", ".join(device.port for device in devices())
    return f"connected are {found}; set tracker.port in the rig file" if found else "no serial port is connected"


def holders(port: str) -> tuple[str, ...]:
    """Programs that have a port open: `name (process number)`.

    Linux alone tells, and of another user's programs only to the superuser; this program is not among them.
    """
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
        # Another user's, or over by now.
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
    """Vendor, product and serial number of a USB device."""
    vid, pid, number = (getattr(found, name, None) for name in ("vid", "pid", "serial_number"))
    return f"{vid:04x}:{pid:04x}:{number}" if vid is not None and pid is not None and number else ""
