"""An actuator behind a raw PCM port: one TCP connection a stimulus.

The connection carries mono samples as little-endian float32, 1.0 being the device's full scale, and ends with the
stimulus; the server reads to the end and then closes its side, which is the sign that it took all of it. It sounds
when the foot has landed: such a port knows no time, so nothing can be scheduled or measured. PulseAudio
is such a server: `module-simple-protocol-tcp playback=true record=false format=float32le channels=1 rate=... port=...`.
The stream is neither encrypted nor authenticated: keep the server on the loopback interface.
"""

from __future__ import annotations

import socket

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.panel.conditioning import Conditioner, Played
from experiment.errors import ActuatorError
from experiment.records.stimulus import Delivered
from experiment.synthesis.voltages import Drive
from experiment.synthesis.waveforms import Stimulus

CONNECT_S = 1.0
"""How long a server may take to accept, s."""

TAKE_S = 2.0
"""How long a server may take beyond the length of the stimulus until it has read all of it, s."""


class PcmActuator:
    """Implements `Actuator`."""

    def __init__(
        self, address: str, *, rate_hz: int, full_scale: float, limit_m_s2: float, drive: Drive | None = None
    ) -> None:
        """Prepare for the server at `host:port`; nothing is connected yet. `Conditioner` says what the limits are.

        Raises:
            ActuatorError: `address` is no `host:port`, or the limit is negative or not finite.
        """
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise ActuatorError(f"actuator address '{address}': allowed is host:port, such as 127.0.0.1:4711")
        self._address = address
        self._peer = (host.strip("[]"), int(port))
        self._rate_hz = rate_hz
        self._condition = Conditioner(full_scale=full_scale, limit_m_s2=limit_m_s2, drive=drive)
        self._prepared: NDArray[np.float32] | None = None

    @property
    def rate_hz(self) -> int:
        return self._rate_hz

    @property
    def lead_ns(self) -> int:
        return 0

    def prepare(self, stimulus: Stimulus) -> Played:
        """Limit, shape and keep a stimulus at `rate_hz`; `ActuatorError` if there is nothing to play."""
        played = self._condition(stimulus)
        self._prepared = played.samples
        return played

    def aim(self, onset_ns: int) -> bool:  # noqa: ARG002
        """Change nothing: this port cannot schedule, and `landed` plays the stimulus."""
        return True

    def landed(self, contact_ns: int) -> None:  # noqa: ARG002
        """Hand the prepared stimulus to the device; it sounds now, whenever contact was.

        Raises:
            ActuatorError: no server answers, the connection broke, or the server did not take all of it.
        """
        samples, self._prepared = self._prepared, None
        if samples is not None:
            self._send(samples.tobytes(), TAKE_S + samples.size / self._rate_hz)

    def withdraw(self) -> bool:
        self._prepared = None
        return True

    def delivered(self, contact_ns: int) -> Delivered | None:  # noqa: ARG002
        return None

    def close(self) -> None:
        """Nothing stays open between stimuli."""

    def reach(self) -> None:
        """Connect and hang up, which plays nothing; `ActuatorError` if nothing answers at the address."""
        self._connected().close()

    def _connected(self) -> socket.socket:
        try:
            return socket.create_connection(self._peer, timeout=CONNECT_S)
        except OSError as error:
            raise ActuatorError(
                f"actuator at {self._address}: nothing answers there ({error.strerror or error}); "
                "start its server, or correct actuator.address in the rig file"
            ) from error

    def _send(self, data: bytes, timeout_s: float) -> None:
        connection = self._connected()
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
