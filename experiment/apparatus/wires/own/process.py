"""The process in which a lab's own driver runs; `hosting` starts it, and hears of it whatever the driver does.

Its argument is a port of this machine to connect to, its first line of input the secret that it then shows. It gets the
bytes of the driver's file, executes them, opens the device, and ends once that line does.
"""

from __future__ import annotations

import importlib
import json
import math
import operator
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, bounded
from palpate.experiment.apparatus.servo.serving import hold
from palpate.experiment.apparatus.wires.own.loading import error_words, module_in
from palpate.experiment.synthesis.contact.block import Pair

OPENED, FAILED, SENT, BLOCK = "opened", "failed", "sent", "block"
PREPARE, START, STOP = "prepare", "start", "stop"
"""Kinds of messages: from this process, and to it."""

LEAD_S = 1.0
"""The longest time before its start that a driver may want to know of a stimulus, s."""

ENDS_S = 2.0
"""So long a driver may take to close once nobody listens any more, s."""

WATCHED_S, PART = 5.0, 0.05
"""Over so long, s, the times that a driver states may differ from its rate by this part; ours: they may be late."""


class DriverFault(Exception):
    """What a driver did at one of its parts, in words."""

    def __init__(self, part: str, what: str) -> None:
        super().__init__(part, what)
        self.part, self.what = part, what


def blamed(part: str, call: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a driver's part returns. Raises `DriverFault` for whatever it raises."""
    try:
        return call(*arguments)
    except (Exception, SystemExit, KeyboardInterrupt) as error:  # a driver may raise anything
        raise DriverFault(part, error_words(error)) from error


def opened(orders: dict[str, Any], needed: tuple[str, ...]) -> Any:
    """Return the driver with its device open. Raises `DriverFault`."""

    def construct() -> Any:
        file, name = orders["file"], orders["name"]
        module = importlib.import_module(orders["module"]) if file is None else module_in(orders["content"], Path(file))
        found = getattr(module, name)
        if missing := [part for part in needed if not hasattr(found, part)]:
            raise AttributeError(f"it has no {', '.join(missing)}")
        return found(json.loads(orders["settings"], object_hook=lambda table: SimpleNamespace(**table)))

    driver = blamed("open", construct)
    rate_hz = blamed("rate_hz", getattr, driver, "rate_hz", None)
    if rate_hz is not None and rate_hz != orders["rate_hz"]:
        raise DriverFault("rate_hz", f"it is {rate_hz!r:.40}, and {orders['rate_hz']} in the rig file")
    return driver


class Output:
    """Plays one stimulus after the other by a driver, each from its start on until its end or a stop."""

    NEEDED = "prepare", "play", "close"

    def __init__(self, line: Connection, driver: Any, orders: dict[str, Any]) -> None:  # noqa: ARG002
        self._line, self._driver = line, driver
        self._changed = threading.Condition()
        self._number, self._cut = 0, -1.0
        self._samples: NDArray[np.float64] | None = None
        self._start_ns: int | None = None
        self.lead_s = blamed("lead_s", lambda: float(getattr(driver, "lead_s", 0.0)))
        if not 0 <= self.lead_s <= LEAD_S:
            raise DriverFault("lead_s", f"it is {self.lead_s!r:.40}, not 0 to {LEAD_S:g} s")

    def opened(self) -> dict[str, Any]:
        """Return what the other end is told of the device."""
        return {"lead_s": self.lead_s}

    def run(self) -> None:
        """Prepare and play until the other end is gone. Raises `DriverFault`."""
        threading.Thread(target=self._hear, daemon=True).start()
        length = 0
        while (due := self._due()) is not None:
            number, what = due
            if isinstance(what, int):
                asked_ns = time.monotonic_ns()
                result = blamed("play", self._driver.play, what, lambda number=number: self._cut >= number)
                self._line.send((SENT, number, *_sent(result, length, asked_ns)))
            else:
                length = what.size
                blamed("prepare", self._driver.prepare, what)

    def _due(self) -> tuple[int, NDArray[np.float64] | int] | None:
        """Wait until samples are to be prepared, or played from a time on, and return them; None at the end."""
        with self._changed:
            while self._cut < math.inf:
                if self._samples is not None:
                    samples, self._samples = self._samples, None
                    return self._number, samples
                left_s = None
                if self._start_ns is not None:
                    left_s = (self._start_ns - time.monotonic_ns()) / 1e9 - self.lead_s
                    if left_s <= 0:
                        start_ns, self._start_ns = self._start_ns, None
                        return self._number, start_ns
                self._changed.wait(left_s)
            return None

    def _hear(self) -> None:
        while True:
            try:
                what, number, content = self._line.recv()
            except (EOFError, OSError):
                what, number, content = STOP, math.inf, None
            with self._changed:
                if what == PREPARE:
                    self._number, self._samples, self._start_ns = number, content, None
                elif what == STOP:
                    self._cut, self._samples, self._start_ns = number, None, None
                elif number == self._number > self._cut:
                    self._start_ns = content
                self._changed.notify_all()
            if number == math.inf:
                _end_soon()
                return


def _sent(result: Any, length: int, asked_ns: int) -> tuple[int, int, int, int]:
    """Return what `play` says of so many samples. Raises `DriverFault` for what it cannot be."""
    wanted = "(began_ns, played, dropped, clipped), whole numbers"
    try:
        began_ns, played, dropped, clipped = map(operator.index, result)
    except (TypeError, ValueError) as error:
        raise DriverFault("play", f"it returned {result!r:.60}, not {wanted}") from error
    if min(played, dropped, clipped) < 0 or played + dropped > length or clipped > played:
        raise DriverFault("play", f"of {length} samples it returned {result!r:.60}: {wanted}")
    if not asked_ns - 1e9 <= began_ns <= time.monotonic_ns() + LEAD_S * 1e9:
        raise DriverFault("play", f"it returned began_ns {began_ns}, which is not of time.monotonic_ns()")
    return began_ns, played, dropped, clipped


class Input:
    """Hands on what a driver reads, block by block."""

    NEEDED = "read", "close"

    def __init__(self, line: Connection, driver: Any, orders: dict[str, Any]) -> None:
        self._line, self._driver, self._rate_hz = line, driver, orders["rate_hz"]

    def opened(self) -> dict[str, Any]:
        """Return what the other end is told of the device."""
        return {}

    def run(self) -> None:
        """Read until the other end is gone. Raises `DriverFault`."""
        count, recent = 0, deque[tuple[int, int]]()
        while not self._line.poll():
            first_ns, samples = _block(blamed("read", self._driver.read))
            recent.append((count, first_ns))
            while len(recent) > 2 and first_ns - recent[1][1] > WATCHED_S * 1e9:
                recent.popleft()
            lasted_s, due_s = (first_ns - recent[0][1]) / 1e9, (count - recent[0][0]) / self._rate_hz
            if abs(lasted_s - due_s) > WATCHED_S * PART:
                came = f"{count - recent[0][0]} samples in {lasted_s:.3f} s by its times"
                raise DriverFault("read", f"{came}, not {self._rate_hz} a second")
            count += samples.size
            self._line.send((BLOCK, first_ns, samples))


def _block(result: Any) -> tuple[int, NDArray[np.float64]]:
    """Return a block that `read` returned. Raises `DriverFault` for what it cannot be."""
    try:
        first_ns, samples = result
        first_ns, samples = operator.index(first_ns), np.asarray(samples, np.float64)
    except (TypeError, ValueError) as error:
        raise DriverFault("read", f"it returned {result!r:.60}, not (first_ns, samples)") from error
    if samples.ndim != 1 or not samples.size:
        raise DriverFault("read", f"it returned samples of shape {samples.shape}, not (n,), at least one")
    if not np.isfinite(samples).all():
        raise DriverFault("read", "it returned NaN or infinite samples")
    if abs(first_ns - time.monotonic_ns()) > 60e9:
        raise DriverFault("read", f"it returned first_ns {first_ns}, which is not of time.monotonic_ns()")
    return first_ns, samples


class Force:
    """Pushes by a driver what the servo asks for, and with nothing as soon as the servo is silent or gone."""

    NEEDED = "push", "close"

    def __init__(self, line: Connection, driver: Any, orders: dict[str, Any]) -> None:
        self._line, self._driver = line, driver
        self._most_n = orders["full_scale_n"]
        self._server = socket.create_server(("127.0.0.1", 0))
        self._push(NO_FORCE, 0, False)

    def opened(self) -> dict[str, Any]:
        """Return what the other end is told of the device."""
        return {"port": self._server.getsockname()[1]}

    def run(self) -> None:
        """Serve one connection after the other until the other end is gone. Raises `DriverFault`."""
        host.raise_above_sessions()
        watched = threading.Thread(target=self._watch, daemon=True)
        watched.start()
        try:
            while True:
                with self._server.accept()[0] as servo:
                    hold(servo, self._push)
        except OSError:
            # Nobody starts a servo any more.
            pass
        finally:
            self._push(NO_FORCE, 0, False)

    def _watch(self) -> None:
        with suppress(EOFError, OSError):
            self._line.recv()
        _end_soon()
        # Whoever waits for a connection is not woken by its close alone.
        self._server.shutdown(socket.SHUT_RDWR)

    def _push(self, force_n: Pair, _why: int, fast: bool) -> None:
        out_n, along_n = bounded(force_n, self._most_n)
        blamed("push", self._driver.push, out_n, along_n, fast)


ROLES: dict[str, Any] = {"actuator": Output, "accelerometer": Input, "servo": Force}


def _end_soon() -> None:
    """End this process, whatever its driver does meanwhile."""
    ends = threading.Timer(ENDS_S, os._exit, (1,))
    ends.daemon = True
    ends.start()


def main() -> None:
    """Be the process."""
    # Ctrl-C at the terminal is the session's, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line = Connection(socket.create_connection(("127.0.0.1", int(sys.argv[1]))).detach())
    line.send_bytes(bytes.fromhex(sys.stdin.readline()))
    orders = line.recv()
    role = ROLES[orders["role"]]
    try:
        driver = opened(orders, role.NEEDED)
        running = role(line, driver, orders)
        with host.raised():
            line.send((OPENED, running.opened()))
            running.run()
    except DriverFault as fault:
        line.send((FAILED, fault.part, fault.what))
    except OSError:
        # Nobody listens any more.
        pass
    finally:
        _end_soon()
        if "driver" in locals():
            blamed("close", driver.close)


if __name__ == "__main__":
    main()
