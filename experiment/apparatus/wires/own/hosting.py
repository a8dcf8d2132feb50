"""Starts the process of a lab's own driver, and hears what it says until it ends."""

from __future__ import annotations

import secrets
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from palpate.experiment import storage
from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.rig import AccelerometerRig, ActuatorRig, Rig
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.apparatus.wires.own import process
from palpate.experiment.errors import PalpateError

STARTS_S, OPENS_S = 10.0, 8.0
"""How long the process may take to be there, and its driver then to open the device, s; ours."""

MENDED = "restart the device, or have the driver corrected; then continue"


class DriverProcess:
    """A driver at work, as whoever started it sees it; messages come in a thread of its own."""

    def __init__(
        self,
        rig: Rig,
        device: str,
        settings: ActuatorRig | AccelerometerRig | ServoRig,
        *,
        refused: type[PalpateError],
        hear: Callable[..., None],
    ) -> None:
        """Start the driver of a table, and return once its device is open; `hear` gets what comes then.

        Raises `refused` with what it did instead.
        """
        self.named, self._device, self._refused, self._hear = settings.driver, device, refused, hear
        self.changed = threading.Condition()
        self.fault = ""
        """Why nothing comes any more, in words; empty while it works."""
        self.opened: dict[str, Any] | None = None
        module, _, name = settings.driver.partition(":")
        file = rig.driver_file(settings.driver)
        orders = {
            "role": device,
            "module": module,
            "name": name,
            "file": None if file is None else str(file),
            "content": None if file is None else storage.read_bytes(file),
            "settings": settings.model_dump_json(),
            "rate_hz": getattr(settings, "rate_hz", None),
            "full_scale_n": getattr(settings, "full_scale_n", None),
        }
        self._thread = threading.Thread(target=self._run, name=f"driver of the {device}", daemon=True)
        try:
            self._start(orders)
            with host.elsewhere():
                self._thread.start()
            with self.changed:
                self.changed.wait_for(lambda: self.opened is not None or self.fault, OPENS_S)
        except BaseException:
            # Ctrl-C, at any moment.
            if hasattr(self, "_line"):
                self.close()
            raise
        if self.opened is None:
            fault = self.fault or f"its driver '{self.named}' was still opening the device after {OPENS_S:g} s"
            self.close()
            raise self.error(fault, "check that it is switched on and not in use, or have the driver corrected")

    def _start(self, orders: dict[str, Any]) -> None:
        wanted, shown = secrets.token_bytes(process.SECRET_BYTES), secrets.token_bytes(process.SECRET_BYTES)
        self._told = tempfile.TemporaryFile()  # noqa: SIM115
        with socket.create_server(("127.0.0.1", 0)) as server, host.elsewhere(), beside.held_back():
            command = storage.python_command("-m", process.__name__, str(server.getsockname()[1]))
            self._process = subprocess.Popen(  # noqa: S603
                command, stdin=subprocess.PIPE, stdout=self._told, stderr=self._told
            )
            try:
                with self._process.stdin or self._told as told:
                    told.write(f"{wanted.hex()} {shown.hex()}\n".encode())
                self._there = process.showing(wanted, server, STARTS_S)
                self._line = Connection(self._there.dup().detach())
                self._line.send_bytes(shown)
                self._line.send(orders)
            except BaseException as error:
                self._process.kill()
                if not isinstance(error, OSError):
                    raise
                raise self.error(f"its driver's process did not start ({error})", "try again") from error

    def send(self, *message: Any) -> None:
        """Send a message, unless nobody is there any more."""
        with suppress(OSError, ValueError):
            self._line.send(message)

    def error(self, what: str = "", remedy: str = MENDED) -> PalpateError:
        """Return what went wrong, or what the driver did, as an error of the device."""
        return self._refused(self._device, what or self.fault, remedy)

    def give_up(self, what: str) -> PalpateError:
        """End a driver that does nothing in time; return that as an error."""
        with self.changed:
            self.fault = self.fault or f"its driver '{self.named}' {what}"
        self._process.kill()
        return self.error()

    def close(self) -> None:
        """Let go of the driver, and end it if it does not let go of the device; a second time does nothing."""
        with suppress(OSError):
            self._there.shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(process.ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._thread.is_alive():
            self._thread.join()
        for one in (self._line, self._there, self._told):
            one.close()

    def _run(self) -> None:
        while True:
            try:
                what, *content = self._line.recv()
            except (EOFError, OSError):
                break
            if what == process.FAILED:
                part, words = content
                self._end(f"its driver '{self.named}' failed at `{part}` ({words})")
                break
            if what == process.OPENED:
                with self.changed:
                    (self.opened,) = content
                    self.changed.notify_all()
            else:
                self._hear(what, *content)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(2 * process.ENDS_S)
        self._end(f"its driver '{self.named}' ended its process ({self._last_words()})")

    def _end(self, fault: str) -> None:
        with self.changed:
            self.fault = self.fault or fault
            self.changed.notify_all()

    def _last_words(self) -> str:
        self._told.seek(0)
        lines = self._told.read().decode("utf-8", "replace").split("\n")
        said = [line.strip() for line in lines if line.strip()]
        code = self._process.returncode
        return said[-1][:120] if said and code and code > 0 else f"exit status {code}"
