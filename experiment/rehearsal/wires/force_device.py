"""SIMULATED force device: the far end of the servo's line, a process of its own with a clock of its own.

`python -m palpate.experiment.rehearsal.wires.force_device [FILE]` prints its port, and ends with its first connection.
It serves the others one after the other, as `apparatus.servo.device` demands, and writes what it pushed to a file: 24
bytes each, little-endian: the machine's monotonic clock in ns (int64), the force out of the block and along it, N
(float32), why (uint32: `PUSHED`, `SILENT` or `HUNG_UP`) and the lamp (uint32).
"""

import select
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import BinaryIO, Self

from palpate.experiment import storage
from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.servo.serving import hold

BEGINS_S = 10.0
"""Whoever starts it connects within this time, s."""

PUSH = struct.Struct("<qffII")


class ForceDeviceProcess:
    """The device as whoever starts it sees it."""

    def __init__(self, record: Path | None = None) -> None:
        """Start it; `record` is where it keeps what it pushed."""
        told = storage.python_command("-m", __name__, *([str(record)] if record is not None else []))
        with beside.held_back():
            self._process = subprocess.Popen(told, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)  # noqa: S603
        port = int((self._process.stdout or sys.stdin.buffer).readline())
        self._owner = socket.create_connection(("127.0.0.1", port))
        self.address = f"127.0.0.1:{port}"

    def close(self) -> None:
        """Switch it off: it ends once its first connection has."""
        with self._process, self._owner:
            pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve(server: socket.socket, record: BinaryIO | None) -> None:
    """Serve until the first connection ends."""
    server.settimeout(BEGINS_S)
    with server.accept()[0] as owner:
        while owner not in select.select([server, owner], [], [])[0]:
            with server.accept()[0] as line:
                _hold(line, record)


def _hold(line: socket.socket, record: BinaryIO | None) -> None:
    def keep(force: tuple[float, float], why: int, fast: bool) -> None:
        if record is not None:
            record.write(PUSH.pack(time.monotonic_ns(), *force, why, fast))

    hold(line, keep)


def main() -> None:
    """Be the process, which Ctrl-C at its terminal does not end: whoever started it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with host.raised(), host.undisturbed(), socket.create_server(("127.0.0.1", 0)) as server:
        beside.raise_above_sessions()
        sys.stdout.write(f"{server.getsockname()[1]}\n")
        sys.stdout.flush()
        record = Path(sys.argv[1]).open("wb", buffering=0) if len(sys.argv) > 1 else None  # noqa: SIM115
        serve(server, record)


if __name__ == "__main__":
    main()
