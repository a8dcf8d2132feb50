"""The foot's tracker behind a serial port: a device path, a pseudo-terminal, or pyserial's `socket://host:port`.

Time comes from the device's counter (frames.py), never from arrival; the clock here only measures silence.
"""

from __future__ import annotations

import errno
from importlib.util import find_spec
from typing import TYPE_CHECKING, NoReturn

from experiment.apparatus.frames import FRAME_BYTES, Decoder
from experiment.apparatus.ports import LinkCounts, Samples
from experiment.clock import Clock, MonotonicClock
from experiment.errors import TrackerError, TrackerStopped

if TYPE_CHECKING:
    import serial

    from experiment.apparatus.rig import TrackerRig

SLICES = 4
"""Silence is measured in this many slices. A pause of the whole machine ends one slice at most, so it is not taken
for a silent device."""

USABLE = 0.9
"""Part of the silence allowed that is spent waiting; the rest is left to the operating system."""

BACKLOG_S = 0.02
"""A look at the port is calm if it finds no more than the frames of this time, s."""

CALM_LOOKS = 2
"""Draining ends after this many calm looks one after the other."""

SETTLE_NS = 1_000_000
"""How long the operating system gets between two looks to pass on what it holds, ns."""

MOST_LOOKS = 1000
"""Draining ends after this many looks, even if the line is faster than it may be."""

LARGEST_READ = 65536

_VANISHED: tuple[type[Exception], ...] = (OSError,)
if find_spec("termios"):
    import termios

    _VANISHED = (OSError, termios.error)


class SerialTracker:
    """Implements `Tracker`."""

    def __init__(self, port: str, settings: TrackerRig, *, clock: Clock | None = None) -> None:
        """Open the port, for this process alone where the system can.

        Args:
            port: device path, pseudo-terminal or pyserial URL.
            settings: speed, rate, silence allowed and calibration.
            clock: measures silence; the machine's monotonic clock if None.

        Raises:
            TrackerError: the port cannot be opened.
        """
        self._name = port
        self._settings = settings
        self._clock = clock or MonotonicClock()
        self._is_device = "://" not in port
        self._slice_ns = int(settings.stall_ms * 1e6 * USABLE / SLICES)
        self._port = _opened(port, settings.baud, self._slice_ns / 1e9)
        self._decoder = Decoder()
        self._counts = LinkCounts()
        self._raw = b""

    @property
    def counts(self) -> LinkCounts:
        return self._counts

    def drain(self) -> None:
        """Throw away what arrived before now.

        Raises:
            TrackerStopped: the port has gone.
        """
        try:
            if self._is_device:
                self._port.reset_input_buffer()
            else:
                self._read_away()
        except _VANISHED as error:
            self._gone(error)
        self._decoder = self._decoder.skipped()
        self._raw = b""

    def read(self) -> Samples:
        """Wait for the next samples, at least one.

        Raises:
            TrackerStopped: no good frame for the silence allowed, or the port has gone.
            TrackerError: the device restarted.
        """
        silent_ns = 0
        heard = 0
        while silent_ns < (SLICES - 0.5) * self._slice_ns:
            begun_ns = self._clock.now_ns()
            data = self._received()
            heard += len(data)
            kept = len(self._raw)
            self._raw += data
            self._decoder, frames = self._decoder.feed(data)
            self._counts = self._counts.plus(frames.link)
            if frames.restarted:
                raise TrackerError(
                    f"tracker at {self._name}: the device's clock no longer runs on from {self._decoder.device_us} us; "
                    "it restarted, or its firmware does not count microseconds; see to it, then resume the session"
                )
            if frames.device_us.size:
                raw, self._raw = self._raw, b""
                return Samples(frames.device_us, self._settings.height_mm(frames.counts), raw, kept + frames.ends)
            silent_ns += min(self._clock.now_ns() - begun_ns, self._slice_ns)
        if heard:
            raise TrackerStopped(
                f"tracker at {self._name}: {heard} bytes within {self._settings.stall_ms} ms, but no good frame; "
                f"see that the device sends palpate's frames at {self._settings.baud} baud"
            )
        raise TrackerStopped(
            f"tracker at {self._name}: no frame for {self._settings.stall_ms} ms; "
            "see that the device is powered, connected and sampling, then resume the session"
        )

    def close(self) -> None:
        # pyserial leaves a socket open whose other end went away first.
        connection = getattr(self._port, "_socket", None)
        self._port.close()
        if connection is not None:
            connection.close()

    def _read_away(self) -> None:
        """Empty a port that cannot be told to: one look is not enough, for some may still be on its way."""
        backlog = max(FRAME_BYTES, round(self._settings.rate_hz * BACKLOG_S) * FRAME_BYTES)
        calm_looks = 0
        for _ in range(MOST_LOOKS):
            calm_looks = calm_looks + 1 if len(self._waiting()) <= backlog else 0
            if calm_looks == CALM_LOOKS:
                return
            self._clock.sleep_ns(SETTLE_NS)

    def _received(self) -> bytes:
        """Whatever comes within one slice; returns as soon as anything has come."""
        try:
            first = self._port.read(1)
            return first + self._waiting() if first else b""
        except OSError as error:
            self._gone(error)

    def _waiting(self) -> bytes:
        """What has arrived and can be taken without waiting."""
        if self._is_device:
            return bytes(self._port.read(self._port.in_waiting))
        # A URL handler says that something waits, not how much.
        self._port.timeout = 0
        try:
            return bytes(self._port.read(LARGEST_READ))
        finally:
            self._port.timeout = self._slice_ns / 1e9

    def _gone(self, error: Exception) -> NoReturn:
        raise TrackerStopped(
            f"tracker at {self._name}: the port has gone ({_reason(error)}); "
            "plug the device in again, then resume the session"
        ) from error


def _opened(port: str, baud: int, timeout_s: float) -> serial.Serial:
    import serial

    try:
        return serial.serial_for_url(port, baudrate=baud, timeout=timeout_s, exclusive=True)
    except OSError as error:
        remedy = {
            errno.ENOENT: f"no such port; {_present()}",
            errno.EACCES: "not permitted; let this user open serial ports (on Linux: group dialout)",
            errno.EBUSY: "another program holds it; close that program",
            errno.EAGAIN: "another program holds it; close that program",
        }.get(error.errno or 0, f"{_reason(error)}; see that it is a serial port and in order; {_present()}")
        raise TrackerError(f"tracker at {port}: {remedy}") from error
    except ValueError as error:
        raise TrackerError(f"tracker at {port}: {error}; correct [tracker] in the rig file") from error


def _present() -> str:
    from serial.tools.list_ports import comports

    found = ", ".join(sorted(port.device for port in comports()))
    return f"connected are {found}; set tracker.port in the rig file" if found else "no serial port is connected"


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())
