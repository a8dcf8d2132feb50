"""An actuator and an accelerometer, each behind a raw PCM port: mono samples as little-endian float32 on TCP.

A sample of 1.0 is the device's full scale. PulseAudio is such a server: `module-simple-protocol-tcp format=float32le
channels=1 rate=... port=...` with `playback=true record=false` for an actuator, and the reverse for an accelerometer.
The stream is neither encrypted nor authenticated: keep the server on the loopback interface.

**Actuator.** One connection a stimulus, which ends with it. The server reads to the end and then closes its side, which
is the sign that it took all of it. The stimulus sounds when the foot has landed: such a port knows no time, so nothing
can be scheduled or measured.

**Accelerometer.** One connection a take; the server sends from the connection on and without end. Samples carry no
time. They come at the device's rate, and each piece of the stream arrives some time after its last sample; the piece
that was held up least tells when the stream began. So a sample's time on the host's clock is known but for the latency
that every piece has. What came within `RING_S` is held, and a take begins `BEFORE_S` ahead of the first sample that
reaches the rig's trigger level in the stretch that is asked for, whatever shook the panel before.
"""

import socket
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
from palpate.experiment.synthesis.waveforms import Ring, Stimulus

CONNECT_S = 1.0
"""How long a server may take to accept, s."""

TAKE_S = 2.0
"""How long a server may take beyond the length of the stimulus until it has read all of it, s."""

ALIVE_S = 2.0
"""How long after that the first samples of an accelerometer may take, s."""

LATE_S = 2.0
"""How long after it is due a take's last sample may still come, s."""

BEFORE_S = 0.002
"""How much of a take lies before its trigger, s."""

RING_S = 10.0
"""How much is held besides a take, s: the slowest foot takes 2 s from gate to panel."""

_SAMPLE = np.dtype("<f4")
_PIECE_BYTES = 65536


def _connected(device: str, address: str, refused: type[PalpateError]) -> socket.socket:
    """Return a connection to a device's server at `host:port`. Raises `refused` if nothing answers there."""
    host, _, port = address.rpartition(":")
    try:
        return socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S)
    except OSError as error:
        raise refused(
            f"{device} at {address}: nothing answers there ({error.strerror or error}); start its server, or correct "
            f"{device}.address in the rig file"
        ) from error


class PcmActuator:
    """Implements `Actuator`."""

    def __init__(self, address: str, condition: Conditioner, *, rate_hz: int) -> None:
        """Prepare for the server at `host:port`; nothing is connected yet. Every stimulus passes through `condition`.

        Raises `ActuatorError` if `address` is no `host:port`.
        """
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise ActuatorError(f"actuator address '{address}': allowed is host:port, such as 127.0.0.1:4711")
        self._address = address
        self.rate_hz = rate_hz
        self._condition = condition
        self._prepared: NDArray[np.float32] | None = None

    @property
    def lead_ns(self) -> int:
        return 0

    def prepare(self, stimulus: Stimulus | Ring) -> Played:
        """Limit, shape and keep a stimulus at `rate_hz`; `ActuatorError` if there is nothing to play."""
        played = self._condition(stimulus)
        self._prepared = played.samples
        return played

    def aim(self, onset_ns: int) -> bool:  # noqa: ARG002
        """Change nothing: this port cannot schedule, and `landed` plays the stimulus."""
        return True

    def landed(self, contact_ns: int) -> None:  # noqa: ARG002
        """Hand the prepared stimulus over; it sounds now. `ActuatorError` if the server does not take all of it."""
        samples, self._prepared = self._prepared, None
        if samples is not None:
            self._send(samples.tobytes(), TAKE_S + samples.size / self.rate_hz)

    def withdraw(self) -> bool:
        self._prepared = None
        return True

    def delivered(self, contact_ns: int) -> Delivered | None:  # noqa: ARG002
        return None

    def close(self) -> None:
        """Nothing stays open between stimuli."""

    def reach(self) -> None:
        """Connect and hang up, which plays nothing; `ActuatorError` if nothing answers at the address."""
        _connected("actuator", self._address, ActuatorError).close()

    def _send(self, data: bytes, timeout_s: float) -> None:
        connection = _connected("actuator", self._address, ActuatorError)
        try:
            with connection:
                connection.settimeout(timeout_s)
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):
                    pass
        except TimeoutError as error:
            raise ActuatorError(
                f"actuator at {self._address}: the server did not take the stimulus within {timeout_s:.1f} s; "
                "see that it reads to the end of the connection and then closes it"
            ) from error
        except OSError as error:
            raise ActuatorError(
                f"actuator at {self._address}: the connection broke ({error.strerror or error}); "
                "see that its server runs, then do the trial again"
            ) from error


class PcmAccelerometer:
    """Implements `Accelerometer`."""

    def __init__(self, settings: AccelerometerRig, *, clock: Clock | None = None) -> None:
        """Prepare to listen to the server that the rig file names; each take makes its own connection.

        The host's clock stamps samples: None is the machine's monotonic one.
        """
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
        """Return the take that was armed for, once the foot is down; it begins between two times of the host's clock.

        Raises `RecordingError`: not armed, the stream broke or ended too soon, or it holds samples that are no numbers.
        """
        if self._listening is None:
            raise RecordingError("accelerometer: got a step before it was armed; arm it first, then step")
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
            f"accelerometer at {self._settings.address}: {problem}; see that its server runs and sends float32 "
            "without end, then do the take again"
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
