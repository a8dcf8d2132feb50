"""The simulated panel: the far end of the actuator's port. It keeps what was delivered, for whoever stands on it.

A rig whose actuator takes volts has a panel that answers them as `response.py` says.
"""

from __future__ import annotations

import queue
import socket
import threading

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus import cores
from experiment.apparatus.rig_panel import ActuatorRig
from experiment.rehearsal import response

_SAMPLE = np.dtype("<f4")
_DEAF_S = 5.0
"""A connection that sends nothing for this long has broken, s."""


class Panel:
    """Listens on the loopback interface for one connection a stimulus."""

    def __init__(self, actuator: ActuatorRig) -> None:
        """Listen at once.

        Args:
            actuator: says what a sample of 1.0 is, and whether samples are volts.
        """
        self._actuator = actuator
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        """Where it listens, `host:port`."""
        self._closing = False
        self._stimuli: queue.SimpleQueue[NDArray[np.float64]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._listen, name="panel", daemon=True)
        with cores.elsewhere():
            self._thread.start()

    def felt(self, timeout_s: float) -> NDArray[np.float64] | None:
        """The next stimulus that was delivered and not felt yet.

        Args:
            timeout_s: how long to wait for one, s; 0 for none.

        Returns:
            Acceleration, m/s^2, shape (n,), at the actuator's rate; None if nothing came. A stimulus is here before
            the actuator's `play` returns.
        """
        try:
            return self._stimuli.get(block=timeout_s > 0, timeout=timeout_s)
        except queue.Empty:
            return None

    def close(self) -> None:
        """Stop listening."""
        self._closing = True
        # Closing the server alone would not end an accept that is under way.
        with socket.create_connection(self._server.getsockname(), timeout=1.0):
            self._thread.join()
        self._server.close()

    def _listen(self) -> None:
        while True:
            connection, _ = self._server.accept()
            with connection:
                if self._closing:
                    return
                connection.settimeout(_DEAF_S)
                try:
                    data = _whole(connection)
                except OSError:
                    # A stimulus whose connection broke was not delivered.
                    continue
                if not data:
                    # Whoever sends nothing asked whether the panel is there.
                    continue
                data = data[: len(data) // _SAMPLE.itemsize * _SAMPLE.itemsize]
                self._stimuli.put(self._moved(np.frombuffer(data, _SAMPLE).astype(np.float64)))

    def _moved(self, samples: NDArray[np.float64]) -> NDArray[np.float64]:
        delivered = samples * self._actuator.full_scale
        if self._actuator.shaping is None or not samples.size:
            return delivered
        return response.moved(delivered, rate_hz=self._actuator.rate_hz)


def _whole(connection: socket.socket) -> bytes:
    pieces = []
    while piece := connection.recv(65536):
        pieces.append(piece)
    return b"".join(pieces)
