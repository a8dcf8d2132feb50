"""The process in which a lab's own driver runs; `hosting` starts it, and hears of it whatever the driver does.

Its argument is a port of this machine to connect to, its first line of input the secret that it then shows, and the one
that it must then be shown. It gets the bytes of the driver's file, executes them, opens the device, and ends once that
line does, or on SIGTERM.
"""

from __future__ import annotations

import importlib
import json
import math
import operator
import os
import secrets
import select
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.host import beside
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, bounded
from palpate.experiment.apparatus.servo.serving import hold
from palpate.experiment.apparatus.wires.own.loading import error_words, module_in
from palpate.experiment.synthesis.contact.block import Pair

OPENED, FAILED, SENT, BLOCK = "opened", "failed", "sent", "block"
PREPARE, START, STOP = "prepare", "start", "stop"
"""Kinds of messages: from this process, and to it."""

SECRET_BYTES = 32

LEAD_S = 1.0
"""The longest time before its start that a driver may want to know of a stimulus, s."""

ENDS_S = 2.0
"""So long a driver may take to close once nobody listens any more, s."""

PUSH_S = 0.05
"""A push that goes on when it is looked at twice so far apart, s, hangs; ours."""

WATCHED_S, PART = 5.0, 0.05
"""Over so long, s, the times that a driver states may differ from its rate by this part; ours: they may be late."""


class DriverFault(Exception):
    """What a driver did at one of its parts, in words."""

    def __init__(self, part: str, what: str) -> None:
        super().__init__(part, what)
        self.part, self.what = part, what


def showing(secret: bytes, server: socket.socket, within_s: float | None) -> socket.socket:
    """Return the first connection that sends a secret, and close the others.

    It may take `within_s` seconds, or as long as it likes for None. Raises `OSError`.
    """
    ends_s, others = None if within_s is None else time.monotonic() + within_s, list[socket.socket]()
    with ExitStack() as stack:
        while ends_s is None or ends_s > time.monotonic():
            left_s = None if ends_s is None else max(0.0, ends_s - time.monotonic())
            for ready in select.select([server, *others], [], [], left_s)[0]:
                if ready is server:
                    others.append(stack.enter_context(server.accept()[0]))
                    continue
                others.remove(ready)
                # So few bytes come in one piece.
                with suppress(ConnectionError):
                    if secrets.compare_digest(ready.recv(SECRET_BYTES), secret):
                        return ready.dup()
                ready.close()
    raise TimeoutError(f"it did not connect within {within_s:g} s")


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
    if None not in (rate_hz, orders["rate_hz"]) and rate_hz != orders["rate_hz"]:
        raise DriverFault("rate_hz", f"it is {rate_hz!r:.40}, but {orders['rate_hz']} in the rig file")
    return driver


class Role:
    """What a driver is there for, until the other end is gone."""

    def __init__(self, line: Connection, driver: Any) -> None:
        self._line, self._driver = line, driver

    def opened(self) -> dict[str, Any]:
        """Return what the other end is told of the device."""
        return {}

    def run(self) -> None:
        """Hear the other end in a thread of its own, and work until it is gone. Raises `DriverFault`."""
        threading.Thread(target=self._listen, daemon=True).start()
        self._work()

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._hear(*self._line.recv())
        _end_soon()
        self._end()

    def _hear(self, what: str, number: int, content: Any) -> None:
        """Take a message."""

    def _work(self) -> None:
        raise NotImplementedError

    def _end(self) -> None:
        """Have `_work` return."""
        raise NotImplementedError


class Output(Role):
    """Plays one stimulus after the other by a driver, each from its start on until its end or a stop."""

    NEEDED = "prepare", "play", "close"

    def __init__(self, line: Connection, driver: Any, orders: dict[str, Any]) -> None:  # noqa: ARG002
        super().__init__(line, driver)
        self._changed = threading.Condition()
        self._number, self._begun, self._cut = 0, 0, -1.0
        self._samples: NDArray[np.float64] | None = None
        self._start_ns: int | None = None
        self.lead_s = blamed("lead_s", lambda: float(getattr(driver, "lead_s", 0.0)))
        if not 0 <= self.lead_s <= LEAD_S:
            raise DriverFault("lead_s", f"it is {self.lead_s!r:.40}, not 0 to {LEAD_S:g} s")

    def opened(self) -> dict[str, Any]:
        return {"lead_s": self.lead_s}

    def _work(self) -> None:
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
                        self._begun = self._number
                        return self._number, start_ns
                self._changed.wait(left_s)
            return None

    def _hear(self, what: str, number: float, content: Any) -> None:
        with self._changed:
            if what == PREPARE:
                self._number, self._samples, self._start_ns = int(number), content, None
            elif what == STOP:
                self._cut, self._samples, self._start_ns = number, None, None
            elif number == self._number > max(self._cut, self._begun):
                self._start_ns = content
            self._changed.notify_all()

    def _end(self) -> None:
        self._hear(STOP, math.inf, None)


def _sent(result: Any, length: int, asked_ns: int) -> tuple[int, int, int, int]:
    """Return what `play` says of so many samples. Raises `DriverFault` for what it cannot be."""
    wanted = "(began_ns, played, dropped, clipped), whole numbers"
    try:
        began_ns, played, dropped, clipped = map(operator.index, result)
    except (TypeError, ValueError) as error:
        raise DriverFault("play", f"it returned {result!r:.60}, not {wanted}") from error
    if min(played, dropped, clipped) < 0 or played + dropped > length or clipped > played:
        raise DriverFault("play", f"for {length} samples, it returned {result!r:.60}: {wanted}")
    if not asked_ns - 1e9 <= began_ns <= time.monotonic_ns() + LEAD_S * 1e9:
        raise DriverFault("play", f"it returned began_ns {began_ns}, which is not a time of time.monotonic_ns()")
    return began_ns, played, dropped, clipped


class Input(Role):
    """Hands on what a driver reads, block by block."""

    NEEDED = "read", "close"

    def __init__(self, line: Connection, driver: Any, orders: dict[str, Any]) -> None:
        super().__init__(line, driver)
        self._rate_hz, self._over = orders["rate_hz"], False

    def _end(self) -> None:
        self._over = True

    def _work(self) -> None:
        count, recent = 0, deque[tuple[int, int]]()
        while not self._over:
            first_ns, samples = _block(blamed("read", self._driver.read))
            recent.append((count, first_ns))
            while len(recent) > 2 and first_ns - recent[1][1] > WATCHED_S * 1e9:
                recent.popleft()
            lasted_s, due_s = (first_ns - recent[0][1]) / 1e9, (count - recent[0][0]) / self._rate_hz
            if abs(lasted_s - due_s) > WATCHED_S * PART:
                came = f"{count - recent[0][0]} samples in {lasted_s:.3f} s by its timestamps"
                raise DriverFault("read", f"{came}, not {self._rate_hz} per second")
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
        raise DriverFault("read", f"it returned samples of shape {samples.shape}, not (n,) with at least one sample")
    if not np.isfinite(samples).all():
        raise DriverFault("read", "it returned NaN or infinite samples")
    if abs(first_ns - time.monotonic_ns()) > 60e9:
        raise DriverFault("read", f"it returned first_ns {first_ns}, which is not a time of time.monotonic_ns()")
    return first_ns, samples


class Force(Role):
    """Pushes by a driver what the servo asks for, and with nothing as soon as the servo is silent or gone."""

    NEEDED = "push", "close"

    def __init__(self, line: Connection, driver: Any, orders: dict[str, Any]) -> None:
        super().__init__(line, driver)
        self._most_n, self._pushes, self._is_pushing = orders["full_scale_n"], 0, False
        self._server, self._secret = socket.create_server(("127.0.0.1", 0)), secrets.token_bytes(SECRET_BYTES)
        self._servo: socket.socket | None = None
        self._over = False
        self._push(NO_FORCE, 0, False)

    def opened(self) -> dict[str, Any]:
        return {"port": self._server.getsockname()[1], "secret": self._secret.hex()}

    def _work(self) -> None:
        """Serve the connections that send the secret, one after another."""
        beside.raise_above_sessions()
        threading.Thread(target=self._guard, daemon=True).start()
        try:
            while True:
                with showing(self._secret, self._server, None) as self._servo:
                    if self._over:
                        break
                    hold(self._servo, self._push)
        except OSError:
            # Nobody starts a servo any more.
            pass
        finally:
            self._push(NO_FORCE, 0, False)

    def _guard(self) -> None:
        """End this process, and with it whatever it has open, once a push hangs."""
        before = 0
        while not (self._is_pushing and self._pushes == before):
            before = self._pushes
            time.sleep(PUSH_S)
        with suppress(OSError):
            self._line.send((FAILED, "push", f"it did not return within {2 * PUSH_S * 1e3:g} ms"))
        os._exit(1)

    def _end(self) -> None:
        self._over = True
        # Whoever waits for a connection, or at one, is not woken by its close alone.
        for one in (self._server, self._servo):
            with suppress(OSError):
                if one is not None:
                    one.shutdown(socket.SHUT_RDWR)

    def _push(self, force_n: Pair, _why: int, fast: bool) -> None:
        out_n, along_n = bounded(force_n, self._most_n)
        self._pushes, self._is_pushing = self._pushes + 1, True
        try:
            blamed("push", self._driver.push, out_n, along_n, fast)
        finally:
            self._is_pushing = False


ROLES: dict[str, Any] = {"actuator": Output, "accelerometer": Input, "servo": Force}


def _end_soon() -> None:
    """End this process, whatever its driver does meanwhile."""
    ends = threading.Timer(ENDS_S, os._exit, (1,))
    ends.daemon = True
    ends.start()


def _watch_opening(line: Connection, is_open: threading.Event) -> None:
    """End this process if the other end goes while the driver still opens its device."""
    while not is_open.wait(0.1):
        if line.poll():
            _end_soon()
            return


def _end_on_term(there: socket.socket) -> None:
    """Have SIGTERM end the line, so that the driver lets go of its device; also while it runs no Python."""
    woken, wakes = socket.socketpair()
    wakes.setblocking(False)
    signal.set_wakeup_fd(wakes.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGTERM, lambda *_: None)

    def wait() -> None:
        with wakes:
            while signal.SIGTERM not in woken.recv(64):
                pass
        there.shutdown(socket.SHUT_RD)

    threading.Thread(target=wait, daemon=True).start()


def main() -> None:
    """Be the process."""
    # Ctrl-C at the terminal, and its end, are the session's, which then ends this process.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    there = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
    line = Connection(there.dup().detach())
    shown, wanted = map(bytes.fromhex, sys.stdin.readline().split())
    there.sendall(shown)
    if line.recv_bytes(len(wanted)) != wanted:
        sys.exit("another program is listening there")
    orders = line.recv()
    role, is_open = ROLES[orders["role"]], threading.Event()
    threading.Thread(target=_watch_opening, args=(line, is_open), daemon=True).start()
    _end_on_term(there)
    try:
        driver = opened(orders, role.NEEDED)
        running = role(line, driver, orders)
        with host.raised():
            line.send((OPENED, running.opened()))
            is_open.set()
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
