"""The foot's tracker behind a serial port.

A thread of its own takes what comes, stamps it at once and decodes it (frames.py), so that neither a slow reader nor
the system's small buffer loses a frame. Time comes from the device's counter; arrivals only tell which session time
that is (clock_map.py).

What a read costs is the process waking up, and code that meets cold caches: so it makes few calls, reader and thread
share a queue and no condition, and after a read that found no backlog the thread pauses for `PAUSE_NS`, 4 ms. A sample
is older by no more than that when it is read, and predictions bear it: for feet of 300 mm/s with 0.1 mm of noise their
SD is 0.51 ms at 1 kHz and 0.40 ms at 5 kHz for a lead of 12 ms, against 0.35 ms and 0.23 ms for one of 8 ms (150
simulated falls each). A line has to hold what comes in a pause: 240 bytes at 5 kHz, where systems hold 4096 or more.

One thread at a time may read. In a session it runs just above the session's, so that no computation keeps it from the
line.
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


PAUSE_NS = 4_000_000
"""Pause after a read that found no backlog, ns."""

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
        # What a pause brings, and as much again: a read that brings no more found no backlog.
        self._calm_bytes = FRAME_BYTES * (2 + 2 * PAUSE_NS * settings.rate_hz // 1_000_000_000)
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
        try:
            while not self._closing:
                if self._queued_bytes - self._given_bytes + len(self._raw) >= self._most_bytes:
                    _MACHINE.sleep_ns(PAUSE_NS)
                    continue
                # After a pause something has nearly always come.
                taken = self._take()
                if self._failure is not None:
                    return
                if not taken:
                    self._port.wait(self._slice_s)
                elif taken <= self._calm_bytes:
                    _MACHINE.sleep_ns(PAUSE_NS)
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
