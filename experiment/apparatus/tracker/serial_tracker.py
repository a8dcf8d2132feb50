"""The foot's tracker behind a serial port.

A thread takes, stamps and decodes what comes (frames.py), so that no frame is lost; in a session it runs just above the
session's. Time is the device's counter, dated by arrivals (clock_map.py). One thread at a time may read.
"""

from __future__ import annotations

import math
import threading
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.tracker import clock_map as clock_maps
from palpate.experiment.apparatus.tracker.clock_map import ClockMap, ClockState
from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES, Decoder, LinkCounts, Samples
from palpate.experiment.apparatus.tracker.serial_port import VANISHED, SerialPort, identity_of, port_of, reason
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.errors import TrackerError, TrackerStopped

if TYPE_CHECKING:
    from collections.abc import Callable

    from palpate.experiment.apparatus.tracker.settings import TrackerRig

FALLING_NS = 1_000_000
"""A falling foot is read so often at most, ns."""

LONGEST_PAUSE_NS = 12_000_000
"""Pause after any other read, ns."""

SILENCE_PART = 0.06
"""That pause is at most this part of the silence allowed."""

FALLEN_MM = 1.0
"""A foot this far below its reference falls, mm: seven sd of a difference of readings with noise of 0.1 mm."""

LOOKBACK_US = 50_000
"""How long a reference lasts, and how long a foot counts as falling after a read that found so, microseconds."""

SLICES = 4
"""Silence is measured in this many slices, of which a pause of the machine ends at most one."""

USABLE = 0.9
"""Part of the silence allowed that is spent waiting; the rest is left to the operating system."""

REFILL_S = 0.001
"""What waits behind a full line is given so long to take its place, s: a backlog is then decoded at once."""

KEPT_S = 10.0
"""This much is kept of what nobody reads, s at the rig's rate. Then the line fills, and what it cannot take is lost."""

SIMULATED_STALL_S = 60.0
"""In simulated time a device has ended after this silence by the machine's clock, s: other work may delay frames."""

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
        """Open the device path, pseudo-terminal or pyserial URL, exclusively if possible. Raises `TrackerError`.

        `clock` stamps arrivals, by default the machine's monotonic one; without a `clock_map` arrivals give it.
        """
        self._name = port
        self._settings = settings
        self._clock = clock or MonotonicClock()
        self._known_map = clock_map
        # The wait for a frame after it makes up the rest.
        self._falling_pause_ns = max(FALLING_NS - round(1e9 / settings.rate_hz), 0)
        self._calm_pause_ns = min(LONGEST_PAUSE_NS, int(SILENCE_PART * settings.stall_ms * 1e6))
        # What a pause brings, and as much again: a read that brings no more found no backlog.
        frame_bytes = FRAME_BYTES[settings.readings]
        self._calm_bytes = frame_bytes * (2 + 2 * self._calm_pause_ns * settings.rate_hz // 1_000_000_000)
        self._most_bytes = int(KEPT_S * settings.rate_hz) * frame_bytes
        self._stall_ms = round(SIMULATED_STALL_S * 1e3) if self._clock.simulated else settings.stall_ms
        self._slice_s = self._stall_ms * 1e-3 * USABLE / SLICES
        self.counts = LinkCounts()
        self._lock = threading.Lock()
        self._held: _Arrival | None = None
        self._decoder = Decoder()
        self._closing = False
        self._open(port)
        self._identity = identity_of(port)

    @property
    def gone(self) -> bool:
        """Whether nothing can come until it is reconnected; it may be asked from any thread."""
        return self._failure is not None

    @property
    def clock_map(self) -> ClockMap | None:
        state = self._clock_state
        return None if state is None else self._known_map or state.map()

    def drain(self) -> None:
        """Throw away what arrived before now; raise `TrackerStopped` if the port has gone."""
        with self._lock:
            if isinstance(self._failure, TrackerStopped):
                raise self._failure
            try:
                self._port.discard()
            except VANISHED as error:
                raise self._unplugged(error) from error
            self._decoder = self._decoder.skipped()
            self._forget()

    def read(self) -> Samples:
        """Return the next samples, as `Tracker.read` does; a device that restarted is a `TrackerError`."""
        for _ in range(SLICES):
            arrival = self._next(self._slice_s)
            if arrival is not None or self._failure is not None:
                break
        else:
            # On a busy machine the thread may not have had its turn; what has come meanwhile is no silence.
            try:
                self._take()
            except VANISHED as error:
                raise self._unplugged(error) from error
        arrival = arrival or self._next(0.0)
        if arrival is not None:
            self._given_bytes += len(arrival.samples.raw)
            self.counts = self.counts.plus(arrival.link)
            return arrival.samples
        if self._failure is not None:
            raise self._failure
        raise self._silent()

    def reconnect(self, timeout_s: float) -> None:
        """Wait as `Tracker.reconnect` does: at the same port or, if the device has a USB serial number, at any."""
        why = silent = "no frame since"
        self.close()
        for _ in range(max(round(timeout_s / RETRY_S), 1)):
            if not self._thread.is_alive():
                try:
                    self._open(port_of(self._identity) or self._name)
                except TrackerError as error:
                    why = error.finding.what
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
        away = f"not back within {timeout_s:g} s ({why})"
        raise TrackerStopped(f"tracker at {self._name}", away, "plug it in again, and check that it is sampling")

    def close(self) -> None:
        if self._closing:
            return
        self._closing = True
        self._port.wake()
        self._thread.join()
        if self._failure is None:
            self._fail(TrackerStopped(f"tracker at {self._name}", "it was closed", "open it again"))
        self._port.close()

    def _open(self, port: str) -> None:
        self._port = SerialPort(port, self._settings.baud)
        self._decoder = Decoder(period_us=1e6 / self._settings.rate_hz, readings=self._settings.readings)
        self._clock_state: ClockState | None = None
        self._failure: Exception | None = None
        self._closing = False
        # Until the first reading the foot counts as falling.
        self._reference_us, self._reference_mm, self._falls_until_us = 0, math.inf, 0
        self._falls = True
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
        """Return the oldest arrival; None if none came within the time, or if reading failed."""
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
                    self._port.check()
                    _MACHINE.sleep_ns(self._calm_pause_ns)
                    continue
                # After a pause something has nearly always come.
                taken = self._take()
                if self._failure is not None:
                    return
                if not taken:
                    self._port.wait(self._slice_s)
                elif taken <= self._calm_bytes:
                    self._pause()
        except VANISHED as error:
            self._fail(self._unplugged(error), error)
        except Exception as error:
            # Whoever reads next learns of it.
            self._fail(error)

    def _pause(self) -> None:
        if not self._falls:
            _MACHINE.sleep_ns(self._calm_pause_ns)
            return
        if self._falling_pause_ns:
            _MACHINE.sleep_ns(self._falling_pause_ns)
        self._port.wait(self._slice_s)

    def _take(self) -> int:
        with self._lock:
            data = self._port.take(REFILL_S)
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
                    f"tracker at {self._name}",
                    f"the device's clock no longer continues from {self._decoder.device_us} us; it restarted, or its "
                    "firmware does not count microseconds",
                    "plug it in again, then resume the session",
                )
            )
        elif frames.device_us.size:
            newest_us = self._decoder.device_us
            if self._clock_state is None:
                self._clock_state = clock_maps.init(newest_us, now_ns)
            elif self._known_map is None:
                self._clock_state = clock_maps.step(self._clock_state, newest_us, now_ns)
            heights_mm = self._settings.height_mm(frames.counts)
            self._pace(newest_us, float(heights_mm[-1]))
            # The bytes of a frame that had waited may have gone out before.
            ends = np.maximum(kept + frames.ends, 0)
            along_mm = self._settings.along_mm(frames.along)
            samples = Samples(frames.device_us, heights_mm, self._raw, ends, now_ns, along_mm)
            self._queued_bytes += len(self._raw)
            self._arrivals.put(_Arrival(samples, self._link))
            self._raw, self._link = b"", None

    def _pace(self, newest_us: int, newest_mm: float) -> None:
        fell = newest_mm < self._reference_mm - FALLEN_MM
        if fell:
            self._falls_until_us = newest_us + LOOKBACK_US
        if fell or newest_mm >= self._reference_mm or newest_us >= self._reference_us + LOOKBACK_US:
            self._reference_us, self._reference_mm = newest_us, newest_mm
        self._falls = newest_us < self._falls_until_us

    def _unplugged(self, error: Exception) -> TrackerStopped:
        return TrackerStopped(
            f"tracker at {self._name}", f"the port has disappeared ({reason(error)})", "plug in the device again"
        )

    def _silent(self) -> TrackerStopped:
        if len(self._raw) > FRAME_BYTES[self._settings.readings]:
            return TrackerStopped(
                f"tracker at {self._name}",
                f"{len(self._raw)} bytes, but no valid frame for {self._stall_ms} ms",
                f"check that the device sends palpate's frames at {self._settings.baud} baud, {self._decoder.kind}",
            )
        return TrackerStopped(
            f"tracker at {self._name}",
            f"no frame for {self._stall_ms} ms",
            "check that the device is powered, connected to tracker.port and sampling",
        )
