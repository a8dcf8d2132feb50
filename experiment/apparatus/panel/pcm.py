"""An actuator and an accelerometer, each behind a raw PCM port: mono samples as little-endian float32 on TCP.

Such a port knows no time, so a stimulus begins when the foot has landed. A server that is late has failed: the
connection is reset, and the stimulus may still play until the server closes a later connection. An accelerometer's
least delayed piece dates its stream, but for the latency that every piece has.
"""

import errno
import socket
import struct
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.conditioning import Conditioner, Played
from palpate.experiment.apparatus.ports import Heard, Window
from palpate.experiment.apparatus.rig import AccelerometerRig
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.errors import ActuatorError, PalpateError, RecordingError
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

ALIVE_S = 2.0
"""How long the first samples of an accelerometer may take, s."""

LATE_S = 2.0
"""How long after it is due a take's last sample may still come, s."""

BEFORE_S = 0.002
"""How much of a take lies before its trigger, s."""

RING_S = 10.0
"""How much is held besides a take, s: the slowest foot takes 2 s from gate to panel."""

RESTART = "restart its server, then resume the session"

_SAMPLE = np.dtype("<f4")
_PIECE_BYTES = 65536
_RESET = struct.pack("hh" if sys.platform == "win32" else "ii", 1, 0)
"""Closing a connection resets it at once."""


def _connected(device: str, address: str, refused: type[PalpateError], timeout_s: float = CONNECT_S) -> socket.socket:
    """Return a connection to a device's server at `host:port`. Raises `refused` if nothing answers there."""
    host, _, port = address.rpartition(":")
    try:
        return socket.create_connection((host.strip("[]"), int(port)), timeout=timeout_s)
    except OSError as error:
        raise refused(
            f"{device} at {address}",
            f"nothing answers there ({error.strerror or error})",
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
            raise ActuatorError(f"actuator address '{address}'", "allowed is host:port, such as 127.0.0.1:4711")
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
            raise ActuatorError(self._name, "an earlier stimulus may still play", RESTART)
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
            self._fault = _undelivered(self._clock.now_ns(), "it was taken back before it began")

    def play_silence(self, seconds: float) -> float:
        """Play zeros for so long, as `landed` plays a stimulus, and return `closed_ms`."""
        self._cut.clear()
        self._play(bytes(round(seconds * self.rate_hz) * _SAMPLE.itemsize))
        return self.closed_ms

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
        with _connected("actuator", self._address, ActuatorError) as connection:
            connection.shutdown(socket.SHUT_WR)
            connection.settimeout(CONNECT_S)
            try:
                connection.recv(1)
            except OSError as error:
                problem = f"the server did not close within {CONNECT_S:g} s"
                raise ActuatorError(self._name, problem, RESTART) from error

    def _play(self, data: bytes) -> None:
        connection = _connected("actuator", self._address, ActuatorError, AHEAD_S)
        self._playing = True
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._hand_over(connection, data)
            if self._cut.is_set():
                self._reset(connection)
        except TimeoutError as error:
            self._reset(connection)
            raise ActuatorError(self._name, str(error), "palpate doctor measures what a server does") from error
        except OSError as error:
            # Its far end has closed, so nothing plays there any more.
            problem = f"the connection broke ({error.strerror or error})"
            raise ActuatorError(self._name, problem, "see that its server runs") from error
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
            behind_ns = passed_ns - at // _SAMPLE.itemsize * 10**9 // self.rate_hz
            due = min(int((passed_ns / 1e9 + AHEAD_S) * self.rate_hz) * _SAMPLE.itemsize, len(data))
            try:
                if at == len(data) and not connection.recv(_PIECE_BYTES):
                    break
                if at < due:
                    at += connection.send(memoryview(data)[at:due])
                    late_ns = max(late_ns, behind_ns)
                    if at == len(data):
                        connection.shutdown(socket.SHUT_WR)
            except BlockingIOError:
                if at < len(data) and behind_ns > 0:
                    raise TimeoutError(f"the server stopped taking samples after {passed_ns / 1e9:.2f} s") from None
                if behind_ns > CLOSE_S * 1e9:
                    raise TimeoutError(f"the server did not close within {CLOSE_S:g} s after the last sample") from None
            self._cut.wait(LOOK_S)
            passed_ns = self._clock.now_ns() - began_ns
        # A server that closes too early plays on.
        self._cut.wait(max(-behind_ns, 0) / 1e9)
        self.closed_ms = behind_ns / 1e6
        if self._cut.is_set() or late_ns > 0:
            reason = "it was cut off" if self._cut.is_set() else f"samples went out {late_ns / 1e6:.0f} ms late"
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
        return not asking.recv(_PIECE_BYTES)
    except BlockingIOError:
        # Hanging up on a connection that is still being made would end that.
        with suppress(OSError):
            asking.getpeername()
            asking.shutdown(socket.SHUT_WR)
        return False
    except OSError as error:
        return isinstance(error, ConnectionError)


class PcmAccelerometer:
    """Implements `Accelerometer`."""

    def __init__(self, settings: AccelerometerRig, *, clock: Clock | None = None) -> None:
        """Prepare to listen, a connection a take; the clock stamps samples, None is the machine's monotonic one."""
        self._settings = settings
        self._clock = clock or MonotonicClock()
        self._listening: _Listening | None = None

    @property
    def rate_hz(self) -> int:
        return self._settings.rate_hz

    def arm(self, samples: int) -> None:
        """Listen from now on for the next take, of so many samples; `RecordingError` if nothing comes."""
        self.close()
        connection = _connected("accelerometer", self._settings.address, RecordingError)
        connection.settimeout(None)
        self._listening = _Listening(connection, samples, rate_hz=self.rate_hz, clock=self._clock)
        if problem := self._listening.alive(ALIVE_S):
            self.close()
            raise self._failed(problem)

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        """Return the armed take, beginning between two times of the host's clock, once the foot is down.

        Raises `RecordingError`: not armed, the stream broke or ended too soon, or has samples that are not numbers.
        """
        if self._listening is None:
            raise RecordingError("accelerometer", "got a step before it was armed", "arm it first, then step")
        listening, self._listening = self._listening, None
        try:
            level = self._settings.trigger_m_s2 / self._settings.full_scale_m_s2
            raw = listening.take(earliest_ns, latest_ns, level=level)
        finally:
            listening.stop()
        if isinstance(raw, str):
            raise self._failed(raw)
        samples, begun_ns, knock_ns = raw
        if samples is None:
            return Heard(None, knock_ns=knock_ns)
        clipped = int(np.count_nonzero(np.abs(samples) >= 1.0))
        return Heard(Window(samples.astype(np.float64) * self._settings.full_scale_m_s2, clipped), begun_ns, knock_ns)

    def close(self) -> None:
        if self._listening is not None:
            self._listening.stop()
            self._listening = None

    def _failed(self, problem: str) -> RecordingError:
        return RecordingError(
            f"accelerometer at {self._settings.address}",
            problem,
            "see that its server runs and sends float32 without end, then do the take again",
        )


_Taken = tuple[NDArray[np.float32] | None, int | None, int | None]
"""A take, when it begins and when there was a knock before; see `Heard`."""


class _Listening:
    """A thread that takes what the server sends, so that nothing waits in the system until the foot is down."""

    def __init__(self, connection: socket.socket, samples: int, *, rate_hz: int, clock: Clock) -> None:
        self._samples = samples
        self._rate_hz = rate_hz
        self._most = round(RING_S * rate_hz) + samples
        self._clock = clock
        self._connection = connection
        self._changed = threading.Condition()
        self._broken: str | None = None
        self._pieces: deque[tuple[NDArray[np.float32], int]] = deque()
        self._first = 0
        self._count = 0
        self._thread = threading.Thread(target=self._run, name="accelerometer", daemon=True)
        self._thread.start()

    def alive(self, timeout_s: float) -> str | None:
        """Return what is wrong if no samples come in time; None once the first have."""
        with self._changed:
            self._changed.wait_for(lambda: self._count or self._broken, timeout_s)
            return None if self._count else self._broken or f"nothing came within {timeout_s:g} s"

    def take(self, earliest_ns: int, latest_ns: int, *, level: float) -> _Taken | str:
        """Return the take that begins in the stretch, or what went wrong."""
        before = round(BEFORE_S * self._rate_hz)
        with self._changed:
            if not self._wait(lambda: self._sample_at(latest_ns) + 1):
                return self._missing()
            first, held = self._held()
            begin = min(max(self._sample_at(earliest_ns) - first, 0), held.size)
            end = max(self._sample_at(latest_ns) - first, begin)
            start_ns = self._start_ns()
            # A sample that is no number counts as loud, so that it is reported.
            loud = np.flatnonzero(~(np.abs(held[: end + 1]) < level))
            early, within = loud[loud < begin], loud[loud >= begin]
            knock_ns = self._time_ns(first + int(early[-1]), start_ns) if early.size else None
            if not within.size:
                return None, None, knock_ns
            triggered = first + int(within[0])
            start = max(triggered - before, first)
            if not self._wait(lambda: start + self._samples):
                return self._missing()
            first, held = self._held()
        taken = held[start - first : start - first + self._samples]
        if not np.all(np.isfinite(taken)):
            return "sent NaN or infinite samples"
        return taken, self._time_ns(triggered, start_ns), knock_ns

    def stop(self) -> None:
        # A server that has closed already raises an error that does not matter.
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._connection.close()

    def _wait(self, wanted: Callable[[], int]) -> bool:
        """Return whether as many samples as wanted have come, in time."""
        due_s = max(wanted() - self._count, 0) / self._rate_hz
        self._changed.wait_for(lambda: self._count >= wanted() or self._broken, due_s + LATE_S)
        return self._count >= wanted()

    def _missing(self) -> str:
        return self._broken or f"only {self._count} samples came, fewer than {self._rate_hz} a second"

    def _start_ns(self) -> float:
        """Return when the stream's first sample was taken, as the piece that was held up least has it."""
        end, starts = self._first, []
        for piece, arrived_ns in self._pieces:
            end += piece.size
            starts.append(arrived_ns - end * 1e9 / self._rate_hz)
        return min(starts)

    def _sample_at(self, time_ns: int) -> int:
        return round((time_ns - self._start_ns()) * self._rate_hz / 1e9)

    def _time_ns(self, sample: int, start_ns: float) -> int:
        return round(start_ns + sample * 1e9 / self._rate_hz)

    def _held(self) -> tuple[int, NDArray[np.float32]]:
        return self._first, np.concatenate([piece for piece, _ in self._pieces])

    def _run(self) -> None:
        torn = b""
        while True:
            try:
                data = self._connection.recv(_PIECE_BYTES)
            except OSError as error:
                return self._end(f"the connection broke ({error.strerror or error})")
            if not data:
                return self._end("the stream ended before the take was whole")
            arrived_ns = self._clock.now_ns()
            data = torn + data
            whole = len(data) // _SAMPLE.itemsize * _SAMPLE.itemsize
            torn = data[whole:]
            if not whole:
                continue
            piece = np.frombuffer(data[:whole], _SAMPLE).astype(np.float32)
            with self._changed:
                self._pieces.append((piece, arrived_ns))
                self._count += piece.size
                while self._count - self._first - self._pieces[0][0].size > self._most:
                    self._first += self._pieces.popleft()[0].size
                self._changed.notify_all()

    def _end(self, why: str) -> None:
        with self._changed:
            self._broken = why
            self._changed.notify_all()
