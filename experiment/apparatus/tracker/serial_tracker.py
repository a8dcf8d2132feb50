"""The foot's tracker behind a serial port.

A thread of its own takes what comes, stamps it at once and decodes it (frames.py), so that neither a slow reader nor
the system's small buffer loses a frame. Time comes from the device's counter; arrivals only tell which session time
that is (clock_map.py).

Reading less often costs less: after a read that found no backlog the thread pauses, longer while the foot rests
or rises (pace.py).

What a read costs is the process waking up, and code that meets cold caches: so it makes few calls, and reader and
thread share a queue and no condition. One thread at a time may read. In a session it runs just above the session's, so
that no computation keeps it from the line.

How often the tracker's line is read: as a falling foot needs it, and less often while the foot rests or rises.

Waking up costs more than the frames that a read finds. After a read that found no backlog the thread pauses, 1.6 ms at
1 kHz and 6 ms from 5 kHz on, and a sample is older by no more than that when it is read. Predictions bear it: at 5 kHz
with 0.1 mm of noise their SD is 0.39 ms at a lead of 8 ms, against 0.30 ms where every sample is read at once.

Most of a session the foot rests, above the panel or on it, or is lifted, and nothing waits for its samples: then the
pause is 12 ms. The newest height of each read tells. A foot that lies `MOVED_MM` or more from a reference replaces it:
below it falls, above it rises; a falling one must lie `RISEN_MM` above it. A reference older than `REFERENCE_US` of
device time is replaced too, and if the foot had not moved, it rests. Until the first reading it counts as falling. What
follows:

- A foot that falls faster than 20 mm/s, the least scale of the prediction, is read as if there were no rest once it is
  seen to, however its stream is cut into reads. A slower one may count as resting: in 12 ms it moves less than 0.24 mm.
- One that turns back above the panel counts as rising 3 mm or more above its lowest reading, and by then the prediction
  knows.
- One that turns to fall, and then falls faster than 20 mm/s, is seen at most one pause after it has fallen 3 mm below
  its highest reading. That may be late for a passage that begins within the gate, never for one that begins above it.
- A foot that falls from rest, faster than 20 mm/s, is seen at most one pause after it has fallen 2.5 mm: its reference
  may be half of one below it, and be replaced within the first 1.5. One that reaches 400 mm/s at the gate's top, 30 mm
  below, has fallen 2.5 mm after 43 ms: it is seen after 55 ms, 4.1 mm down, and reaches the gate after 150 ms.
- Above the highest calibrated point a foot seems to rest, however it moves. That point lies 5 mm or more above the
  gate: a foot of 400 mm/s that comes from there is seen 1.8 mm into the gate at the latest, and a gate is not given
  until 1 mm below its bottom.
- A foot of 100 mm/s that stops on its way down counts as falling for 34 ms more or longer: its reference is 10 ms old
  at most, and the read that finds it a millimetre lower comes up to 6 ms later. If its stop is not plain by then, it is
  noticed 12 ms later at most.
- Samples of a foot that rests or rises wait for up to 12 ms, and for the system's own delay, until they are read: the
  first after arming, and the last of the 100 ms that are recorded after a contact, may come so much later.
- The clock map gets eight reads in each of its shortest stretches, of which it keeps the one with the least delay.
- A line has to hold what comes in a pause: 720 bytes at 5 kHz, where systems hold 4096 or more.
- Silence is noticed as before: the reader waits as long, and the last frames before it are read within `SILENCE_PART`
  of it, which with the part that is spent waiting (serial_tracker.py) makes less than the whole; or, where that is
  longer, within a falling foot's pause: at 5 kHz and 50 ms of silence allowed, 51 ms after the last frame.
"""

from __future__ import annotations

import threading
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, NamedTuple

from experiment.apparatus import host
from experiment.apparatus.tracker import clock_map as clock_maps
from experiment.apparatus.tracker.clock_map import ClockMap, ClockState
from experiment.apparatus.tracker.frames import FRAME_BYTES, Decoder, LinkCounts, Samples
from experiment.apparatus.tracker.serial_port import VANISHED, SerialPort, identity_of, port_of, reason
from experiment.clock import Clock, MonotonicClock
from experiment.errors import TrackerError, TrackerStopped

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiment.apparatus.rig import TrackerRig


PAUSE_S = 0.5e-3
PAUSE_PER_HZ_S = 1.1e-6
"""Pause after a read of a falling foot, s, and how much longer it is for each Hz of the device's rate."""

LONGEST_PAUSE_S = 6e-3
"""It is never longer, s."""

CALM_PAUSE_S = 12e-3
"""Pause after any other read, s: half as many reads as with 6 ms, and the fastest foot is seen in time."""

SILENCE_PART = 0.06
"""That pause is at most this part of the silence allowed, but never shorter than a falling foot's."""

MOVED_MM = 1.0
"""A height so far from the reference is a movement, mm: seven standard deviations of the difference between two
readings of a noisy sensor (0.1 mm)."""

RISEN_MM = 3.0
"""A foot that fell has to be so far above the reference to rise, mm: a noisier sensor does not make it rise, and one
that turned back is read often until the prediction knows."""

REFERENCE_US = 50_000
"""How long a reference lasts, device time, microseconds."""


class Pause(NamedTuple):
    """How long to pause after a read.

    Attributes:
        ns: its length, ns.
        calm_bytes: a read after it that brings no more than this found no backlog: what the pause brings, and as much
            again.
    """

    ns: int
    calm_bytes: int


class Pauses(NamedTuple):
    """The pauses for one device: after a read of a falling foot, and of one that rests or rises."""

    falling: Pause
    calm: Pause


def pauses(*, rate_hz: int, stall_ms: int) -> Pauses:
    """The pauses for a device.

    Args:
        rate_hz: frames a second.
        stall_ms: the silence allowed, ms.
    """
    falling_s = min(PAUSE_S + rate_hz * PAUSE_PER_HZ_S, LONGEST_PAUSE_S)
    calm_s = max(falling_s, min(CALM_PAUSE_S, SILENCE_PART * stall_ms * 1e-3))
    return Pauses(_pause(falling_s, rate_hz), _pause(calm_s, rate_hz))


class Pace(NamedTuple):
    """How the foot moves, as far as reading it goes.

    Attributes:
        device_us: when the reference was read, device time, microseconds.
        height_mm: height of the reference, mm.
        falls: whether the foot falls.
    """

    device_us: int
    height_mm: float
    falls: bool


def init(device_us: int, height_mm: float) -> Pace:
    """After the first read: the foot counts as falling.

    Args:
        device_us: device time of its newest sample, microseconds.
        height_mm: height of that sample, mm.
    """
    return Pace(device_us, height_mm, falls=True)


def step(pace: Pace, device_us: int, height_mm: float) -> Pace:
    """Take the next read.

    Args:
        pace: from `init` or the step before.
        device_us: device time of its newest sample, microseconds; later than any before.
        height_mm: height of that sample, mm.
    """
    moved_mm = height_mm - pace.height_mm
    if moved_mm <= -MOVED_MM or moved_mm >= (RISEN_MM if pace.falls else MOVED_MM):
        return Pace(device_us, height_mm, falls=moved_mm < 0)
    if device_us - pace.device_us > REFERENCE_US:
        return Pace(device_us, height_mm, falls=False)
    return pace


def _pause(pause_s: float, rate_hz: int) -> Pause:
    ns = round(pause_s * 1e9)
    return Pause(ns, FRAME_BYTES * (2 + 2 * ns * rate_hz // 1_000_000_000))


SLICES = 4
"""Silence is measured in this many slices. A pause of the whole machine ends one slice at most, so it is not taken
for a silent device."""

USABLE = 0.9
"""Part of the silence allowed that is spent waiting; the rest is left to the operating system."""

KEPT_S = 10.0
"""So much is kept of what nobody reads, s at the rig's rate. Then the line fills, and what it cannot take is lost."""

RETRY_S = 0.05
"""How often a port that has gone is looked for, s."""


_MACHINE = MonotonicClock()
"""Paces this machine's work, whatever the session's clock."""


class _Arrival(NamedTuple):
    samples: Samples
    link: LinkCounts


class SerialTracker:
    """Implements `Tracker`."""

    def __init__(
        self, port: str, settings: TrackerRig, *, clock: Clock | None = None, clock_map: ClockMap | None = None
    ) -> None:
        """Open the port, for this process alone where the system can.

        Args:
            port: device path, pseudo-terminal or pyserial URL.
            settings: speed, rate, silence allowed and calibration.
            clock: stamps arrivals: the session's; the machine's monotonic clock if None.
            clock_map: of a simulated device whose clock is known; estimated from arrivals if None.

        Raises:
            TrackerError: the port cannot be opened.
        """
        self._name = port
        self._settings = settings
        self._clock = clock or MonotonicClock()
        self._known_map = clock_map
        self._pauses = pauses(rate_hz=settings.rate_hz, stall_ms=settings.stall_ms)
        self._most_bytes = int(KEPT_S * settings.rate_hz) * FRAME_BYTES
        self._slice_s = settings.stall_ms * 1e-3 * USABLE / SLICES
        self._counts = LinkCounts()
        self._lock = threading.Lock()
        self._held: _Arrival | None = None
        self._decoder = Decoder()
        self._closing = False
        self._open(port)
        self._identity = identity_of(port)

    @property
    def counts(self) -> LinkCounts:
        return self._counts

    @property
    def clock_map(self) -> ClockMap | None:
        state = self._clock_state
        return None if state is None else self._known_map or state.map()

    def drain(self) -> None:
        """Throw away what arrived before now.

        Raises:
            TrackerStopped: the port has gone.
        """
        with self._lock:
            if isinstance(self._failure, TrackerStopped):
                raise self._failure
            try:
                self._port.discard()
            except VANISHED as error:
                raise self._gone(error) from error
            self._decoder = self._decoder.skipped()
            self._forget()

    def read(self) -> Samples:
        """Wait for the next samples, at least one.

        Raises:
            TrackerStopped: no good frame for the silence allowed, or the port has gone.
            TrackerError: the device restarted.
        """
        for _ in range(SLICES):
            arrival = self._next(self._slice_s)
            if arrival is not None or self._failure is not None:
                break
        else:
            self._look()
        arrival = arrival or self._next(0.0)
        if arrival is not None:
            self._given_bytes += len(arrival.samples.raw)
            self._counts = self._counts.plus(arrival.link)
            return arrival.samples
        if self._failure is not None:
            raise self._failure
        raise self._silent()

    def reconnect(self, timeout_s: float) -> None:
        """Wait until the device is back, at the same port or, if it has a USB serial number, at any, and speaks.

        Args:
            timeout_s: how long to wait.

        Raises:
            TrackerStopped: it was not back in time; it may be called again.
        """
        silent = "no frame since; see that the device is powered and sampling"
        why = silent
        self.close()
        for _ in range(max(round(timeout_s / RETRY_S), 1)):
            if not self._thread.is_alive():
                try:
                    self._open(port_of(self._identity) or self._name)
                except TrackerError as error:
                    why = str(error)
                    _MACHINE.sleep_ns(int(RETRY_S * 1e9))
                    continue
                why = silent
            self._held = self._next(RETRY_S)
            if self._held is not None:
                return
            if self._failure is not None:
                why = str(self._failure)
                self.close()
        self.close()
        raise TrackerStopped(
            f"tracker at {self._name}: not back within {timeout_s:g} s ({why}); plug the device in again"
        )

    def close(self) -> None:
        if self._closing:
            return
        self._closing = True
        self._port.wake()
        self._thread.join()
        self._port.close()

    def _open(self, port: str) -> None:
        self._port = SerialPort(port, self._settings.baud)
        self._decoder = Decoder()
        self._clock_state: ClockState | None = None
        self._pace: Pace | None = None
        self._failure: Exception | None = None
        self._closing = False
        self._forget()
        self._thread = threading.Thread(target=self._run, args=(host.joining(),), name="tracker", daemon=True)
        self._thread.start()

    def _forget(self) -> None:
        # None wakes the reader where reading failed.
        self._arrivals: SimpleQueue[_Arrival | None] = SimpleQueue()
        self._held = None
        # Bytes are queued by who holds the lock, and given by the one reader.
        self._queued_bytes = self._given_bytes = 0
        self._raw = b""
        self._link: LinkCounts | None = None

    def _next(self, timeout_s: float) -> _Arrival | None:
        """The oldest arrival; None where there is none within the time, or no more of them."""
        held, self._held = self._held, None
        if held is not None:
            return held
        try:
            return self._arrivals.get(self._failure is None, timeout_s)
        except Empty:
            return None

    def _run(self, join: Callable[[], None]) -> None:
        join()
        pause = self._pauses.falling
        try:
            while not self._closing:
                if self._queued_bytes - self._given_bytes + len(self._raw) >= self._most_bytes:
                    _MACHINE.sleep_ns(self._pauses.calm.ns)
                    continue
                # After a pause something has nearly always come.
                taken = self._take()
                if self._failure is not None:
                    return
                if not taken:
                    self._port.wait(self._slice_s)
                elif taken <= pause.calm_bytes:
                    falls = self._pace is None or self._pace.falls
                    pause = self._pauses.falling if falls else self._pauses.calm
                    _MACHINE.sleep_ns(pause.ns)
        except VANISHED as error:
            self._fail(self._gone(error), error)
        except Exception as error:
            # Whoever reads next learns of it.
            self._fail(error)

    def _look(self) -> None:
        """On a busy machine the thread may not have had its turn; what has come meanwhile is no silence."""
        try:
            self._take()
        except VANISHED as error:
            raise self._gone(error) from error

    def _take(self) -> int:
        with self._lock:
            data = self._port.take()
            if data:
                self._arrive(data, self._clock.now_ns())
        return len(data)

    def _fail(self, failure: Exception, cause: Exception | None = None) -> None:
        if cause is not None:
            failure.__cause__ = cause
        self._failure = failure
        self._arrivals.put(None)

    def _arrive(self, data: bytes, now_ns: int) -> None:
        kept = len(self._raw)
        self._raw += data
        self._decoder, frames = self._decoder.feed(data)
        self._link = frames.link if self._link is None else self._link.plus(frames.link)
        if frames.restarted:
            self._fail(
                TrackerError(
                    f"tracker at {self._name}: the device's clock no longer runs on from {self._decoder.device_us} us; "
                    "it restarted, or its firmware does not count microseconds; see to it, then resume the session"
                )
            )
        elif frames.device_us.size:
            newest_us = self._decoder.device_us
            if self._clock_state is None:
                self._clock_state = clock_maps.init(newest_us, now_ns)
            else:
                self._clock_state = clock_maps.step(self._clock_state, newest_us, now_ns)
            heights_mm = self._settings.height_mm(frames.counts)
            newest_mm = float(heights_mm[-1])
            if self._pace is None:
                self._pace = init(newest_us, newest_mm)
            else:
                self._pace = step(self._pace, newest_us, newest_mm)
            ends = kept + frames.ends if kept else frames.ends
            samples = Samples(frames.device_us, heights_mm, self._raw, ends, now_ns)
            self._queued_bytes += len(self._raw)
            self._arrivals.put(_Arrival(samples, self._link))
            self._raw, self._link = b"", None

    def _gone(self, error: Exception) -> TrackerStopped:
        return TrackerStopped(
            f"tracker at {self._name}: the port has gone ({reason(error)}); plug the device in again, then go on"
        )

    def _silent(self) -> TrackerStopped:
        if len(self._raw) > FRAME_BYTES:
            return TrackerStopped(
                f"tracker at {self._name}: {len(self._raw)} bytes, but no good frame for {self._settings.stall_ms} ms; "
                f"see that the device sends palpate's frames at {self._settings.baud} baud"
            )
        return TrackerStopped(
            f"tracker at {self._name}: no frame for {self._settings.stall_ms} ms; "
            "see that the device is powered, connected and sampling, then go on"
        )
