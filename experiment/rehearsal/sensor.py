"""SIMULATED accelerometer, at the far end of its port, and the time of a simulated recording.

Nobody waits in a simulated recording, so the machine's clock cannot tell which vibration belongs to which step. The
host's clock is simulated there: it shows the foot's device time, moves on as frames of the foot are read, and the
sensor sends what it heard until then.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.ports import Accelerometer, Heard, Tracker
from experiment.apparatus.rig_panel import AccelerometerRig
from experiment.apparatus.samples import LinkCounts, Samples
from experiment.clock import Clock, ManualClock

REST_NOISE_M_S2 = 0.002
"""Standard deviation of what the sensor hears of a panel at rest, m/s^2."""

AFTER_S = 1.0
"""It goes on for this long after a take: longer than one may begin late, s."""


class Sensor:
    """Listens on the loopback interface; one connection a take."""

    def __init__(self, settings: AccelerometerRig, clock: Clock) -> None:
        """Listen at once.

        Args:
            settings: rate and full scale.
            clock: of the simulated host; only what was heard until now is sent.
        """
        self._settings = settings
        self._clock = clock
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        """Where it listens, `host:port`."""
        self._connection: socket.socket | None = None
        self._begun_ns = 0
        self._unsent = np.empty(0)
        self._sent = 0
        self._closing = False
        self._thread = threading.Thread(target=self._listen, name="sensor", daemon=True)
        self._thread.start()

    def shake(self, heard_m_s2: NDArray[np.float64], at_ns: int, rng: np.random.Generator) -> None:
        """The panel will shake, and rest before and after; whoever is connected hears it when its time comes.

        Args:
            heard_m_s2: acceleration, m/s^2, shape (n,), at the sensor's rate.
            at_ns: when that begins.
            rng: noise of the sensor at rest.
        """
        after_m_s2 = rng.normal(0.0, REST_NOISE_M_S2, round(AFTER_S * self._settings.rate_hz))
        # Drawn from its end on, so that what comes just before does not depend on how long the panel has been at rest.
        before_m_s2 = rng.normal(0.0, REST_NOISE_M_S2, max(self._samples_until(at_ns) - self._sent, 0))[::-1]
        self._unsent = np.concatenate([before_m_s2, heard_m_s2, after_m_s2])

    @property
    def silent_ns(self) -> int:
        """When everything that it will hear has been heard."""
        samples = self._sent + self._unsent.size
        return self._begun_ns + -(-samples * 1_000_000_000 // self._settings.rate_hz)

    def send(self) -> None:
        """Send what was heard until now."""
        due = max(self._samples_until(self._clock.now_ns()) - self._sent, 0)
        piece, self._unsent = self._unsent[:due], self._unsent[due:]
        self._sent += piece.size
        self._put(piece)

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

    def _put(self, heard_m_s2: NDArray[np.float64]) -> None:
        # Who hangs up has heard enough.
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
            self._sent, self._unsent = 1, np.empty(0)
            self._put(np.zeros(1))


class PassingTime:
    """Implements `Tracker` and `Accelerometer` on others: time passes while they are waited for."""

    def __init__(self, tracker: Tracker, accelerometer: Accelerometer, sensor: Sensor, clock: ManualClock) -> None:
        """Take both ports.

        Args:
            tracker: the foot's.
            accelerometer: which listens to `sensor`.
            sensor: sends as time passes.
            clock: the simulated host's.
        """
        self._tracker = tracker
        self._accelerometer = accelerometer
        self._sensor = sensor
        self._clock = clock

    @property
    def counts(self) -> LinkCounts:
        return self._tracker.counts

    @property
    def clock_map(self) -> ClockMap | None:
        return self._tracker.clock_map

    def drain(self) -> None:
        self._tracker.drain()

    def read(self) -> Samples:
        samples = self._tracker.read()
        self._pass_until(int(samples.device_us[-1]) * 1000)
        return samples

    def reconnect(self, timeout_s: float) -> None:
        self._tracker.reconnect(timeout_s)

    @property
    def rate_hz(self) -> int:
        return self._accelerometer.rate_hz

    def arm(self, samples: int) -> None:
        self._accelerometer.arm(samples)

    def heard(self, *, earliest_ns: int, latest_ns: int) -> Heard:
        self._pass_until(self._sensor.silent_ns)
        return self._accelerometer.heard(earliest_ns=earliest_ns, latest_ns=latest_ns)

    def close(self) -> None:
        """Whoever opened the ports closes them."""

    def _pass_until(self, now_ns: int) -> None:
        self._clock.sleep_ns(now_ns - self._clock.now_ns())
        self._sensor.send()
