"""An actuator behind a raw PCM port: mono samples as little-endian float32 on TCP.

Such a port knows no time, so a stimulus begins when the foot has landed. A server that is late has failed: the
connection is reset, and the stimulus may still play until the server closes a later connection.
"""

import errno
import socket
import struct
import sys
import threading
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.conditioning import Conditioner, Played
from palpate.experiment.apparatus.rig import DOCTOR
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.errors import ActuatorError, PalpateError, Remedy
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.synthesis.waveforms import Waveform

CONNECT_S = 1.0
"""How long a server may take to accept, s."""

AHEAD_S = 0.05
"""How long before its time a sample goes out at most, s, and how late a stimulus may begin."""

CLOSE_S = 1.0
"""How long after the time of the last sample a server may take to close, s."""

SIMULATED_CLOSE_S = 5.0
"""The same in simulated time, where a panel waits for its turn on a busy machine, s."""

LOOK_S = 0.002
"""Between two looks at a connection, s."""

RESTART = "restart its server, then resume the session"

SAMPLE = np.dtype("<f4")
PIECE_BYTES = 65536
_RESET = struct.pack("hh" if sys.platform == "win32" else "ii", 1, 0)
"""Closing a connection resets it at once."""


def connect(device: str, address: str, refused: type[PalpateError], timeout_s: float = CONNECT_S) -> socket.socket:
    """Return a connection to a device's server at `host:port`. Raises `refused` if nothing answers there."""
    host, _, port = address.rpartition(":")
    try:
        return socket.create_connection((host.strip("[]"), int(port)), timeout=timeout_s)
    except OSError as error:
        raise refused(
            f"{device} at {address}",
            f"no server answers ({error.strerror or error})",
            f"start its server, or correct {device}.address in the rig file",
        ) from error


class PcmActuator:
    """Implements `Actuator`; `withdraw` and `is_silent` may be called from any thread, and wait for nothing."""

    lead_ns = 0

    def __init__(self, address: str, condition: Conditioner, *, rate_hz: int, clock: Clock | None = None) -> None:
        """Prepare for the server at `host:port`, or raise `ActuatorError`; `condition` limits every stimulus.

        The clock paces samples, None is the machine's; simulated time sends all at once.
        """
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise ActuatorError(f"actuator address '{address}'", "it must be host:port, such as 127.0.0.1:4711")
        self._address, self._name = address, f"actuator at {address}"
        self.rate_hz = rate_hz
        self._condition = condition
        self._clock = clock or MonotonicClock()
        self._prepared: NDArray[np.float32] | None = None
        self._cut = threading.Event()
        self._playing = False
        self._asking: socket.socket | None = None
        self._fault: Delivered | None = None
        self.closed_ms = 0.0
        """How long after the time of the last sample the server closed, ms; negative for earlier."""

    def prepare(self, stimulus: Waveform) -> Played:
        """Limit, shape and keep a stimulus; `ActuatorError` if there is none, or an earlier one may still play."""
        if not self.is_silent():
            raise ActuatorError(self._name, "an earlier stimulus may still be playing", RESTART)
        played = self._condition(stimulus)
        self._cut.clear()
        self._prepared, self._fault = played.samples, None
        return played

    def aim(self, onset_ns: int) -> bool:  # noqa: ARG002
        """Change nothing: this port cannot schedule, and `landed` plays the stimulus."""
        return True

    def landed(self, contact_ns: int) -> None:  # noqa: ARG002
        """Play the prepared stimulus to its end, or until it is withdrawn; `ActuatorError` if the server is late."""
        samples, self._prepared = self._prepared, None
        if samples is not None:
            self._play(samples.tobytes())
        elif self._cut.is_set():
            self._fault = _undelivered(self._clock.now_ns(), "it was canceled before it began")

    def play_silence(self, seconds: float) -> float:
        """Play zeros for so long, as `landed` plays a stimulus, and return `closed_ms`."""
        self.play(np.zeros(round(seconds * self.rate_hz), np.float32))
        return self.closed_ms

    def play(self, samples: NDArray[np.float32]) -> None:
        """Play samples that are no stimulus, as `landed` plays one; 1.0 is full scale, which nothing exceeds."""
        self._cut.clear()
        self._play(np.clip(samples, -1.0, 1.0).astype(SAMPLE).tobytes())

    def withdraw(self) -> bool:
        """Forget what was prepared, hang up on what plays, and return whether nothing of it will sound."""
        self._prepared = None
        self._cut.set()
        return self.is_silent()

    def is_silent(self) -> bool:
        """Return whether the server is done with every stimulus: it closed a later, empty connection, or is gone."""
        asking = self._asking
        if asking is not None and _is_answered(asking):
            self._asking = None
            asking.close()
        return self._asking is None and not self._playing

    def delivered(self, contact_ns: int) -> Delivered | None:  # noqa: ARG002
        """Return why a stimulus was not whole: it was withdrawn, or samples went out late; None if nothing is known."""
        return self._fault

    def close(self) -> None:
        """Play nothing more; nothing stays open between stimuli."""
        self.withdraw()
        if self._asking is not None:
            self._asking.close()

    def reach(self) -> None:
        """Connect and hang up, which plays nothing; `ActuatorError` if the server does not answer and close too."""
        with connect("actuator", self._address, ActuatorError) as connection:
            connection.shutdown(socket.SHUT_WR)
            connection.settimeout(CONNECT_S)
            try:
                sent = connection.recv(1)
            except OSError as error:
                problem = f"the server did not close within {CONNECT_S:g} s"
                raise ActuatorError(self._name, problem, RESTART) from error
        if sent:
            remedy = "correct actuator.address in the rig file"
            raise ActuatorError(self._name, "the server sends data, so it may be a sensor's server", remedy)

    def _play(self, data: bytes) -> None:
        connection = connect("actuator", self._address, ActuatorError, AHEAD_S)
        self._playing = True
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._hand_over(connection, data)
            if self._cut.is_set():
                self._reset(connection)
        except TimeoutError as error:
            self._reset(connection)
            remedy = Remedy("{} tests the server", DOCTOR, suffices=False)
            raise ActuatorError(self._name, str(error), remedy) from error
        except OSError as error:
            # Its far end has closed, so nothing plays there any more.
            problem = f"the connection broke ({error.strerror or error})"
            raise ActuatorError(self._name, problem, "check that its server is running") from error
        finally:
            connection.close()
            self._playing = False

    def _hand_over(self, connection: socket.socket, data: bytes) -> None:
        """Send each sample at most `AHEAD_S` before its time, and wait for the close; `TimeoutError` if it is late."""
        if self._clock.simulated:
            connection.settimeout(SIMULATED_CLOSE_S)
            connection.sendall(data)
            connection.shutdown(socket.SHUT_WR)
            connection.recv(1)
            return
        connection.setblocking(False)
        began_ns = self._clock.now_ns()
        at = late_ns = behind_ns = passed_ns = 0
        while not self._cut.is_set():
            behind_ns = passed_ns - at // SAMPLE.itemsize * 10**9 // self.rate_hz
            due = min(int((passed_ns / 1e9 + AHEAD_S) * self.rate_hz) * SAMPLE.itemsize, len(data))
            try:
                if at == len(data) and not connection.recv(PIECE_BYTES):
                    break
                if at < due:
                    at += connection.send(memoryview(data)[at:due])
                    late_ns = max(late_ns, behind_ns)
                    if at == len(data):
                        connection.shutdown(socket.SHUT_WR)
            except BlockingIOError:
                if at < len(data) and behind_ns > 0:
                    raise TimeoutError(f"the server stopped accepting samples after {passed_ns / 1e9:.2f} s") from None
                if behind_ns > CLOSE_S * 1e9:
                    raise TimeoutError(f"the server did not close within {CLOSE_S:g} s after the last sample") from None
            self._cut.wait(LOOK_S)
            passed_ns = self._clock.now_ns() - began_ns
        # A server that closes too early plays on.
        self._cut.wait(max(-behind_ns, 0) / 1e9)
        self.closed_ms = behind_ns / 1e6
        if self._cut.is_set() or late_ns > 0:
            reason = "it was cut off" if self._cut.is_set() else f"samples were sent {late_ns / 1e6:.0f} ms late"
            self._fault = _undelivered(began_ns, reason)

    def _reset(self, connection: socket.socket) -> None:
        """Have the server drop what it did not play, and ask when it is done, unless it is gone."""
        asking = socket.socket(connection.family, socket.SOCK_STREAM)
        asking.setblocking(False)
        with suppress(OSError):
            place = connection.getpeername()
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            connection.close()
            if asking.connect_ex(place) != errno.ECONNREFUSED:
                self._asking = asking
                return
        asking.close()


def _undelivered(requested_ns: int, reason: str) -> Delivered:
    return Delivered(requested_ns=requested_ns, xruns=0, delivered=False, reason=reason)


def _is_answered(asking: socket.socket) -> bool:
    """Return whether a server has closed a connection on which nothing is sent, or is gone; this waits for nothing."""
    try:
        return not asking.recv(PIECE_BYTES)
    except BlockingIOError:
        # Hanging up on a connection that is still being made would end that.
        with suppress(OSError):
            asking.getpeername()
            asking.shutdown(socket.SHUT_WR)
        return False
    except OSError as error:
        return isinstance(error, ConnectionError)
