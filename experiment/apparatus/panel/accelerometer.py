"""An accelerometer behind a raw PCM port: mono samples as little-endian float32 on TCP, without end.

Such a port knows no time: the least delayed piece dates the stream, but for the latency that every piece has. Where
all pieces are late from one on, samples were lost before it: zeros stand for them, so that what follows keeps its time.
"""

import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from math import inf
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.panel.pcm import PIECE_BYTES, SAMPLE, connect
from palpate.experiment.apparatus.rig import REHEARSAL, AccelerometerRig, Rig, needed
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.errors import RecordingError, RigError

ALIVE_S = 2.0
"""How long the first samples of an accelerometer may take, s."""

LATE_S = 2.0
"""How long after it is due a take's last sample may still come, s."""

SOON_S = 0.2
"""How long a session waits for a sample beyond its time, s."""

BEFORE_S = 0.002
"""How much of a take lies before its trigger, s."""

LOST_S, SURE_S = 0.004, 0.1
"""Samples were lost where all that come for so long are later than those just before, by so much or more, s. Ours:
what is held up comes at once in the end, and shorter than `listening.AFTER_S`."""

SLOW = 0.02
"""A sensor whose own clock is slow by up to so much loses nothing, however late it is in the end. Ours."""

RING_S = 10.0
"""How much is held besides a take, s: the slowest foot takes 2 s from gate to panel."""


@dataclass(frozen=True)
class Gap:
    """Where samples were lost: from how long after a take's first sample on, and for how long, s."""

    at_s: float
    lasts_s: float

    @property
    def sentence(self) -> str:
        """What is told of it."""
        return f"{self.lasts_s * 1e3:.0f} ms of samples were lost, {self.at_s * 1e3:.0f} ms after the first sample"


@dataclass(frozen=True)
class Window:
    """A take as the accelerometer heard it.

    Attributes:
        samples_m_s2: from just before the vibration's beginning, m/s^2, shape (n,); 0 in a gap.
        clipped: how many samples lie at or beyond full scale.
        gaps: where samples were lost.
    """

    samples_m_s2: NDArray[np.float64]
    clipped: int
    gaps: tuple[Gap, ...] = ()

    @property
    def lost_s(self) -> float:
        """How long all gaps are together, s."""
        return sum(gap.lasts_s for gap in self.gaps)


@dataclass(frozen=True)
class Heard:
    """What the accelerometer heard of a step. Times are the host's, ns.

    Attributes:
        window: the take; None if nothing shook the panel when it should have.
        begun_ns: when the take's vibration reached the trigger level; None without one.
        knock_ns: when that level was reached last before a take could begin; None if it was not.
    """

    window: Window | None
    begun_ns: int | None = None
    knock_ns: int | None = None


class Accelerometer(Protocol):
    """What measures the panel's vibration."""

    @property
    def rate_hz(self) -> int:
        """Samples a second."""

    def arm(self, samples: int) -> None:
        """Listen from now on for a take of that length; return when samples come. Raises `RecordingError`."""

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        """Return the take whose vibration begins between two times of the host's clock. Raises `RecordingError`."""

    def close(self) -> None: ...


class PcmAccelerometer:
    """Implements `Accelerometer`."""

    def __init__(self, settings: AccelerometerRig, *, clock: Clock | None = None) -> None:
        """Prepare to listen, a connection a take; the clock stamps samples, None is the machine's monotonic one."""
        self._settings = settings
        self._clock = clock or MonotonicClock()
        self._listening: Listening | None = None

    @property
    def rate_hz(self) -> int:
        return self._settings.rate_hz

    def arm(self, samples: int) -> None:
        """Listen from now on for the next take, of so many samples; `RecordingError` if nothing comes."""
        self._stop_listening()
        self._listening = self._begin(samples)
        if problem := self._listening.alive(ALIVE_S):
            self._stop_listening()
            raise self._failed(problem)

    def _begin(self, samples: int) -> "Listening":
        connection = connect("accelerometer", self._settings.address, RecordingError)
        connection.settimeout(None)
        return _Stream(connection, samples, rate_hz=self.rate_hz, clock=self._clock)

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        """Return the armed take, beginning between two times of the host's clock, once the foot is down.

        Raises `RecordingError`: not armed, the stream broke or ended too soon, or has samples that are not numbers.
        """
        if self._listening is None:
            raise RecordingError(
                "accelerometer", "got a step before the sensor was armed", "arm the sensor first, then step"
            )
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
        return Heard(self._window(samples), begun_ns, knock_ns)

    def heard_since_armed(self) -> Window:
        """Return the armed samples, from the first that came on, once all have. Raises `RecordingError` as `heard`."""
        if self._listening is None:
            raise RecordingError("accelerometer", "got a request before the sensor was armed", "arm it first")
        listening, self._listening = self._listening, None
        try:
            raw = listening.armed()
        finally:
            listening.stop()
        if isinstance(raw, str):
            raise self._failed(raw)
        return self._window(raw)

    def samples_from(self, begin_ns: int, samples: int) -> Window:
        """Return so many samples from a time of the host's clock on, and go on. Raises `RecordingError`."""
        raw = "nothing listens to it" if self._listening is None else self._listening.samples_from(begin_ns, samples)
        if isinstance(raw, str):
            raise self._failed(raw)
        return self._window(raw)

    def close(self) -> None:
        self._stop_listening()

    def _stop_listening(self) -> None:
        if self._listening is not None:
            self._listening.stop()
            self._listening = None

    def _window(self, taken: "_Samples") -> Window:
        samples, gaps = taken
        clipped = int(np.count_nonzero(np.abs(samples) >= 1.0))
        return Window(samples.astype(np.float64) * self._settings.full_scale_m_s2, clipped, gaps)

    def _failed(self, problem: str) -> RecordingError:
        return RecordingError(
            f"accelerometer at {self._settings.address}",
            problem,
            "check that its server is running and sends float32 continuously, then repeat the take",
        )


NOT_NUMBERS = "sent NaN or infinite samples"
"""What a broken server does."""

_Samples = tuple[NDArray[np.float32], tuple[Gap, ...]]
"""Samples in a row, zeros for those that were lost, and where these are."""

_Taken = tuple[_Samples | None, int | None, int | None]
"""A take, when it begins and when there was a knock before; see `Heard`."""


class Lateness:
    """How late the pieces of a stream come: at once, and for good, after samples that were lost."""

    def __init__(self) -> None:
        self.unsure = False
        """Whether what came last is late."""
        self._usual_ns: dict[int, float] = {}
        """The least `begun_ns` of each of the newest seconds."""
        self._newest: dict[int, tuple[float, float]] = {}
        """The least `begun_ns` if the sensor's clock were slow by `SLOW`, and that piece's own `begun_ns`."""
        self._since_ns, self._from, self._late_ns, self._lost_ns = 0, 0, inf, 0.0

    def add(self, first: int, begun_ns: float, arrived_ns: int) -> tuple[int, float] | None:
        """Take a piece; return before which sample some were lost, once it is sure, and for how long, ns.

        `first` is its first sample, and `begun_ns` when the stream began if it was not held up and nothing was lost but
        what was returned before. It may show that this was less: then both are returned again.
        """
        second, slow_ns = arrived_ns // 10**9, begun_ns - SLOW * arrived_ns
        early_ns = begun_ns - min(self._usual_ns.values(), default=begun_ns)
        if early_ns < -LOST_S * 1e9 / 2 and self._lost_ns:
            self._lost_ns = max(self._lost_ns + early_ns, 0.0)
            return self._from, self._lost_ns
        usual_slow_ns, newest_ns = min(self._newest.values(), default=(slow_ns, begun_ns))
        late_ns = begun_ns - usual_slow_ns - SLOW * (self._since_ns if self.unsure else arrived_ns)
        if late_ns < LOST_S * 1e9:
            self.unsure = False
            usual_ns = min(begun_ns, self._usual_ns.get(second, inf))
            newest = min((slow_ns, begun_ns), self._newest.get(second, (inf, inf)))
            self._usual_ns = {s: ns for s, ns in self._usual_ns.items() if s >= second - 1} | {second: usual_ns}
            self._newest = {s: ns for s, ns in self._newest.items() if s >= second - 1} | {second: newest}
            return None
        if not self.unsure:
            self.unsure, self._since_ns, self._from, self._late_ns, self._lost_ns = True, arrived_ns, first, inf, 0.0
        self._late_ns = min(self._late_ns, begun_ns - newest_ns)
        if arrived_ns - self._since_ns < SURE_S * 1e9:
            return None
        self.unsure, self._lost_ns = False, self._late_ns
        return self._from, self._lost_ns


class Listening:
    """What has come since an accelerometer was armed."""

    def __init__(self, samples: int, *, rate_hz: int, clock: Clock) -> None:
        self._samples = samples
        self._rate_hz = rate_hz
        self._most = round(RING_S * rate_hz) + samples
        self._clock = clock
        self._changed = threading.Condition()
        self._why: str | None = None
        self._pieces: deque[tuple[NDArray[np.float32], int]] = deque()
        self._first = 0
        self._count = 0
        self._lateness = Lateness()
        self._lost: list[tuple[int, int]] = []
        """Each gap: the first of its zeros, and how many these are."""

    @property
    def broken(self) -> str | None:
        """Why nothing comes any more."""
        return self._why

    def alive(self, timeout_s: float) -> str | None:
        """Return what is wrong if no samples come in time; None once the first have."""
        with self._changed:
            self._changed.wait_for(lambda: self._count or self.broken, timeout_s)
            return None if self._count else self.broken or f"no samples arrived within {timeout_s:g} s"

    def take(self, earliest_ns: int, latest_ns: int, *, level: float) -> _Taken | str:
        """Return the take that begins in the stretch, or what went wrong."""
        before = round(BEFORE_S * self._rate_hz)
        with self._changed:
            if not self._wait(lambda: self._sample_at(latest_ns) + 1):
                return self._missing()
            first, held = self._kept_samples()
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
            taken = self._cut(start, self._samples)
        return taken if isinstance(taken, str) else (taken, self._time_ns(triggered, start_ns), knock_ns)

    def armed(self) -> _Samples | str:
        """Return the first samples that came, or what went wrong."""
        with self._changed:
            if not self._wait(lambda: self._samples):
                return self._missing()
            return self._cut(self._first, self._samples)

    def samples_from(self, begin_ns: int, samples: int) -> _Samples | str:
        """Return so many samples from a time on, or what went wrong; a stream that is late is not waited for long."""
        with self._changed:
            if not self._wait(lambda: self._sample_at(begin_ns) + samples, late_s=SOON_S):
                return self._missing()
            return self._cut(self._sample_at(begin_ns), samples)

    def _cut(self, begin: int, samples: int) -> _Samples | str:
        """Return so many samples from one on that have all come, or what is wrong with them."""
        first, held = self._kept_samples()
        if begin < first:
            return "the samples are no longer available"
        taken = held[begin - first : begin - first + samples]
        if not np.all(np.isfinite(taken)):
            return NOT_NUMBERS
        ends = [(max(at - begin, 0), min(at + count - begin, samples)) for at, count in self._lost]
        gaps = (Gap(at / self._rate_hz, (end - at) / self._rate_hz) for at, end in ends if at < end)
        return taken, tuple(gaps)

    def add(self, piece: NDArray[np.float32], ended_ns: int) -> None:
        """Take samples, the last of which was there at a time of the clock's, at the latest."""
        with self._changed:
            self._pieces.append((piece, ended_ns))
            self._count += piece.size
            # In simulated time pieces come whenever their thread has its turn.
            if not self._clock.simulated:
                begun_ns = ended_ns - self._count * 1e9 / self._rate_hz
                if lost := self._lateness.add(self._count - piece.size, begun_ns, ended_ns):
                    self._fill(*lost)
            while self._count - self._first - self._pieces[0][0].size > self._most:
                self._first += self._pieces.popleft()[0].size
            self._changed.notify_all()

    def _fill(self, before: int, lasts_ns: float) -> None:
        """Put zeros before a sample, for as many as were lost there, in place of those that stand there already."""
        had = self._lost.pop()[1] if self._lost and self._lost[-1][0] == before else 0
        count = round(lasts_ns * self._rate_hz / 1e9)
        self._count += count - had
        self._lost += [(before, count)] if count else []
        if before < self._first:
            # Those zeros are gone; what came after them is numbered anew.
            self._first += count - had
            return
        place, at = 0, self._first
        while at < before:
            place, at = place + 1, at + self._pieces[place][0].size
        if had:
            del self._pieces[place]
        if count:
            ended_ns = self._pieces[place - 1][1] + round(count * 1e9 / self._rate_hz)
            self._pieces.insert(place, (np.zeros(count, np.float32), ended_ns))

    def stop(self) -> None:
        """Take nothing more."""

    def _wait(self, wanted: Callable[[], int], late_s: float = LATE_S) -> bool:
        """Return whether as many samples as wanted have come, in time."""
        due_s = max(wanted() - self._count, 0) / self._rate_hz
        self._changed.wait_for(
            lambda: (self._count >= wanted() and not self._lateness.unsure) or self.broken, due_s + late_s
        )
        return self._count >= wanted()

    def _missing(self) -> str:
        return self.broken or f"only {self._count} samples arrived, fewer than {self._rate_hz} per second"

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

    def _kept_samples(self) -> tuple[int, NDArray[np.float32]]:
        return self._first, np.concatenate([piece for piece, _ in self._pieces])


class _Stream(Listening):
    """A thread that takes what the server sends, so that nothing waits in the system until the foot is down."""

    def __init__(self, connection: socket.socket, samples: int, *, rate_hz: int, clock: Clock) -> None:
        super().__init__(samples, rate_hz=rate_hz, clock=clock)
        self._connection = connection
        self._thread = threading.Thread(target=self._run, name="accelerometer", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        # A server that has closed already raises an error that does not matter.
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._connection.close()

    def _run(self) -> None:
        torn = b""
        while True:
            try:
                data = self._connection.recv(PIECE_BYTES)
            except OSError as error:
                return self._end(f"the connection broke ({error.strerror or error})")
            if not data:
                return self._end("the stream ended before the take was complete")
            arrived_ns = self._clock.now_ns()
            data = torn + data
            whole = len(data) // SAMPLE.itemsize * SAMPLE.itemsize
            torn = data[whole:]
            if not whole:
                continue
            self.add(np.frombuffer(data[:whole], SAMPLE).astype(np.float32), arrived_ns)

    def _end(self, why: str) -> None:
        with self._changed:
            self._why = why
            self._changed.notify_all()


def settings_of(rig: Rig) -> AccelerometerRig:
    """Return the settings of the rig's accelerometer; `RigError` if the rig has none."""
    remedy = "add driver, address, rate_hz, full_scale_m_s2 and trigger_m_s2 to the rig file"
    return needed(rig, "accelerometer", rig.accelerometer, remedy, "because recording needs it")


def open_accelerometer(
    rig: Rig, *, rate_hz: int, address: str | None = None, clock: Clock | None = None
) -> Accelerometer:
    """Open the rig's accelerometer, at its address or another, at the protocol's `rate_hz`.

    Raises `RigError` if there is none, at another rate, or in simulation alone.
    """
    settings = settings_of(rig)
    if settings.rate_hz != rate_hz:
        raise RigError(
            f"rig '{rig.rig.name}'",
            f"got {settings.rate_hz}",
            "set the device and the rig file to that rate",
            allowed=f"{rate_hz}, the protocol's synthesis.rate_hz",
            field="accelerometer.rate_hz",
        )
    if address is None and settings.address == REHEARSAL:
        raise RigError.at(opening.simulated_only(rig, "accelerometer.address"))
    return listener(rig, address=address, clock=clock)


def listener(rig: Rig, *, clock: Clock | None, address: str | None = None) -> PcmAccelerometer:
    """Return what listens to the rig's accelerometer, or to a server at another address. Raises `RigError`."""
    settings = settings_of(rig)
    if address is None and ":" in settings.driver:
        own = import_module("palpate.experiment.apparatus.wires.own.accelerometer")
        return cast("PcmAccelerometer", own.DriverAccelerometer(rig, clock))
    return PcmAccelerometer(settings.model_copy(update={"address": address or settings.address}), clock=clock)
