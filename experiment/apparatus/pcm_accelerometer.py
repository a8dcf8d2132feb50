"""An accelerometer behind a raw PCM port: one TCP connection a take.

The server sends mono samples as little-endian float32, 1.0 being the device's full scale, from the connection on and
without end; it may as well begin at a trigger of its own. PulseAudio is such a server:
`module-simple-protocol-tcp record=true playback=false format=float32le channels=1 rate=... port=...`. The stream is
neither encrypted nor authenticated: keep the server on the loopback interface.

A take begins with the vibration itself: `BEFORE_S` ahead of the first sample that reaches the rig's trigger level. So
the clocks of tracker and accelerometer need not agree.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.ports import Window
from experiment.errors import RecordingError

CONNECT_S = 1.0
"""How long a server may take to accept, s."""

LATE_S = 2.0
"""How long after the foot's contact, and beyond the take's length, samples may still come, s."""

BEFORE_S = 0.002
"""How much of a take lies before its trigger, s."""

_SAMPLE = np.dtype("<f4")
_PIECE_BYTES = 65536


class PcmAccelerometer:
    """Implements `Accelerometer`."""

    def __init__(self, address: str, *, rate_hz: int, full_scale_m_s2: float, trigger_m_s2: float) -> None:
        """Prepare; each take makes its own connection.

        Args:
            address: `host:port` of the server.
            rate_hz: sampling rate of the device, Hz.
            full_scale_m_s2: acceleration of a sample of 1.0.
            trigger_m_s2: magnitude at which a take begins, above the noise of a panel at rest.
        """
        host, _, port = address.rpartition(":")
        self._address = address
        self._peer = (host.strip("[]"), int(port))
        self._rate_hz = rate_hz
        self._full_scale_m_s2 = full_scale_m_s2
        self._trigger_m_s2 = trigger_m_s2
        self._listening: _Listening | None = None

    @property
    def rate_hz(self) -> int:
        return self._rate_hz

    def arm(self, samples: int) -> None:
        """Listen from now on for the next take.

        Args:
            samples: its length.

        Raises:
            RecordingError: nothing answers at the address.
        """
        self.close()
        try:
            connection = socket.create_connection(self._peer, timeout=CONNECT_S)
        except OSError as error:
            raise RecordingError(
                f"accelerometer at {self._address}: nothing answers there ({error.strerror or error}); "
                "start its server, or correct accelerometer.address in the rig file"
            ) from error
        connection.settimeout(None)
        level = self._trigger_m_s2 / self._full_scale_m_s2
        self._listening = _Listening(connection, samples, before=round(BEFORE_S * self._rate_hz), level=level)

    def window(self) -> Window | None:
        """The take that was armed for; call it once the foot is down.

        Returns:
            None if no sample reached the trigger level in time.

        Raises:
            RecordingError: not armed, the stream broke or ended too soon, or it holds samples that are no numbers.
        """
        if self._listening is None:
            raise RecordingError("accelerometer: got no arming before the step; arm it first, then step")
        listening, self._listening = self._listening, None
        raw = listening.result(listening.samples / self._rate_hz + LATE_S)
        if isinstance(raw, str):
            raise RecordingError(
                f"accelerometer at {self._address}: {raw}; see that its server runs and sends float32 without end, "
                "then do the take again"
            )
        if raw is None:
            return None
        clipped = int(np.count_nonzero(np.abs(raw) >= 1.0))
        return Window(samples_m_s2=raw.astype(np.float64) * self._full_scale_m_s2, clipped=clipped)

    def close(self) -> None:
        if self._listening is not None:
            self._listening.stop()
            self._listening = None


class _Listening:
    """A thread that takes what the server sends, so that nothing waits in the system until the foot is down."""

    def __init__(self, connection: socket.socket, samples: int, *, before: int, level: float) -> None:
        self.samples = samples
        self._before = before
        self._level = level
        self._connection = connection
        self._broken: str | None = None
        self._taken: NDArray[np.float32] | None = None
        self._begun = False
        self._thread = threading.Thread(target=self._run, name="accelerometer", daemon=True)
        self._thread.start()

    def result(self, timeout_s: float) -> NDArray[np.float32] | str | None:
        """The take; what went wrong; or None if it has not begun in time."""
        self._thread.join(timeout_s)
        late = self._thread.is_alive()
        self.stop()
        if self._taken is not None:
            return self._taken if np.all(np.isfinite(self._taken)) else "sent NaN or infinite samples"
        if late:
            return f"less than {self.samples} samples came within {timeout_s:.1f} s" if self._begun else None
        return self._broken

    def stop(self) -> None:
        # A server that has closed already is as good.
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._connection.close()

    def _run(self) -> None:
        held = np.empty(0, _SAMPLE)
        torn = b""
        while not (self._begun and held.size >= self.samples):
            try:
                piece = self._connection.recv(_PIECE_BYTES)
            except OSError as error:
                self._broken = f"the connection broke ({error.strerror or error})"
                return
            if not piece:
                self._broken = "the stream ended before the take was whole"
                return
            data = torn + piece
            whole = len(data) // _SAMPLE.itemsize * _SAMPLE.itemsize
            torn = data[whole:]
            searched = 0 if self._begun else held.size
            held = np.concatenate([held, np.frombuffer(data[:whole], _SAMPLE)])
            if not self._begun:
                # A sample that is no number begins a take too, so that it is reported.
                loud = np.flatnonzero(~(np.abs(held[searched:]) < self._level))
                self._begun = loud.size > 0
                begin = searched + int(loud[0]) - self._before if loud.size else held.size - self._before
                held = held[max(begin, 0) :]
        self._taken = held[: self.samples].astype(np.float32)
