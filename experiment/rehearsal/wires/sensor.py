"""SIMULATED accelerometer: the far end of its port, on the loopback interface, which sends what a panel moved."""

import socket
import threading
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.rig import AccelerometerRig
from palpate.experiment.clock import Clock

REST_NOISE_M_S2 = 0.002
"""Standard deviation of the acceleration of a panel at rest, m/s^2."""

AFTER_S = 1.0
"""The sensor goes on for this long after a take, s: longer than a take may begin late."""


class Sensor:
    """SIMULATED accelerometer at the far end of its port, on the loopback interface; one connection a take."""

    def __init__(self, settings: AccelerometerRig, clock: Clock) -> None:
        """Listen at once; only what was recorded until now, on the simulated host's clock, is sent."""
        self._settings = settings
        self._clock = clock
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._connection: socket.socket | None = None
        self._begun_ns = 0
        self._unsent = np.empty(0)
        self.sent = 0
        """Number of samples sent since the connection was made."""
        self._closing = False
        self._thread = threading.Thread(target=self._listen, name="sensor", daemon=True)
        self._thread.start()

    def shake(self, heard_m_s2: NDArray[np.float64], at_ns: int, rng: np.random.Generator) -> None:
        """Have the panel shake from `at_ns` on by an acceleration, m/s^2, shape (n,); `rng` draws the noise at rest."""
        after_m_s2 = rng.normal(0.0, REST_NOISE_M_S2, round(AFTER_S * self._settings.rate_hz))
        # Drawn from its end on, so that what comes just before does not depend on how long the panel has been at rest.
        before_m_s2 = rng.normal(0.0, REST_NOISE_M_S2, max(self._samples_until(at_ns) - self.sent, 0))[::-1]
        self._unsent = np.concatenate([before_m_s2, heard_m_s2, after_m_s2])

    @property
    def silent_ns(self) -> int:
        """Return when everything that will be recorded has been recorded, ns."""
        samples = self.sent + self._unsent.size
        return self._begun_ns + -(-samples * 1_000_000_000 // self._settings.rate_hz)

    def send(self) -> None:
        """Send what was recorded until now."""
        due = max(self._samples_until(self._clock.now_ns()) - self.sent, 0)
        piece, self._unsent = self._unsent[:due], self._unsent[due:]
        self.sent += piece.size
        self._send(piece)

    def close(self) -> None:
        """Stop listening."""
        self._closing = True
        # Closing the server alone would not end an accept that is under way.
        with suppress(OSError), socket.create_connection(self._server.getsockname(), timeout=1.0):
            pass
        self._thread.join()
        self._server.close()
        if self._connection is not None:
            self._connection.close()

    def _samples_until(self, now_ns: int) -> int:
        return (now_ns - self._begun_ns) * self._settings.rate_hz // 1_000_000_000

    def _send(self, heard_m_s2: NDArray[np.float64]) -> None:
        # A client that hangs up has heard enough.
        with suppress(OSError):
            if self._connection is not None:
                self._connection.sendall((heard_m_s2 / self._settings.full_scale_m_s2).astype("<f4").tobytes())

    def _listen(self) -> None:
        while True:
            connection, _ = self._server.accept()
            if self._connection is not None:
                self._connection.close()
            self._connection = connection
            if self._closing:
                return
            # One sample at once: time stands still until it has arrived, so it tells when the stream began.
            self._begun_ns = self._clock.now_ns() - 1_000_000_000 // self._settings.rate_hz
            self.sent, self._unsent = 1, np.empty(0)
            self._send(np.zeros(1))
