"""SIMULATED panel: the far end of the actuator's port. It keeps what was delivered, for whoever stands on it.

`Panel` is a raw PCM port, `CardPanel` is behind a simulated sound card. Volts get a simulated response, like that in
Figure 9 of Okamoto et al.; no rig was measured. It answers each frequency on its own, without a phase, as equation (7)
assumes; a panel with states (`modes.py`) answers in time.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from functools import partial
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus import host
from palpate.experiment.apparatus.rig import ActuatorRig
from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires.listener import Tap
from palpate.experiment.synthesis.shaping import Response
from palpate.experiment.synthesis.spectra import bin_frequencies_hz, inverse, spectrum

if TYPE_CHECKING:
    from palpate.experiment.rehearsal.wires.modes import MovingPanel

SUSPENSION_HZ, SUSPENSION_DAMPING = 35.0, 0.5
PANEL_HZ, PANEL_DAMPING = 360.0, 0.12
GAIN_M_S2_PER_V = 4.0
SOFT_V = 5.0

FREQUENCIES_HZ = (*range(10, 30, 2), *range(30, 605, 5))
"""Where the simulated rig was measured: closer together where the response is relatively steep."""

LEVELS_VRMS = (0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)


def gain(frequencies_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return G(f), acceleration for each volt of a small drive, both amplitudes, m/s^2/V, elementwise."""
    low, high = frequencies_hz / SUSPENSION_HZ, frequencies_hz / PANEL_HZ
    passed = low**2 / np.hypot(1 - low**2, 2 * SUSPENSION_DAMPING * low)
    return np.asarray(GAIN_M_S2_PER_V * passed / np.hypot(1 - high**2, 2 * PANEL_DAMPING * high))


def answered(frequencies_hz: NDArray[np.float64], amplitudes_v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return A(f, e), m/s^2, with the sign of e; Hz and V are broadcast against each other."""
    return np.asarray(gain(frequencies_hz) * SOFT_V * np.arcsinh(amplitudes_v / SOFT_V))


def moved(waveform_v: NDArray[np.float64], *, rate_hz: int) -> NDArray[np.float64]:
    """Return the panel's movement, m/s^2, shape (n,), by frequency. Raises `SynthesisError` unless volts are finite."""
    coefficients_v = spectrum(waveform_v)
    frequencies_hz = bin_frequencies_hz(bins=coefficients_v.size, rate_hz=rate_hz)
    return inverse(answered(frequencies_hz, coefficients_v))


def measured() -> Response:
    """Return the response at the frequencies and levels of the shipped table."""
    frequencies_hz, levels_v = np.array(FREQUENCIES_HZ, dtype=np.float64), sqrt(2) * np.array(LEVELS_VRMS)
    return Response(frequencies_hz, levels_v, answered(frequencies_hz[:, None], levels_v))


_SAMPLE = np.dtype("<f4")
_DEAF_S = 5.0
"""A connection that sends nothing for this long has broken, s."""


class Panel:
    """Listens on the loopback interface for one connection a stimulus."""

    def __init__(self, actuator: ActuatorRig, *, real_time: bool = True, moving: MovingPanel | None = None) -> None:
        """Listen at once. In real time a connection closes after its last sample was played, simulated at its end."""
        self._actuator = actuator
        self._moving = moving
        self._real_time = real_time
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._closing = threading.Event()
        self._stimuli: queue.SimpleQueue[NDArray[np.float64]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._listen, name="panel", daemon=True)
        with host.elsewhere():
            self._thread.start()

    def felt(self, timeout_s: float) -> NDArray[np.float64] | None:
        """Return the next delivered stimulus, m/s^2, shape (n,), at the actuator's rate; None after `timeout_s`.

        It is here before the actuator's `landed` returns.
        """
        try:
            return self._stimuli.get(block=timeout_s > 0, timeout=timeout_s)
        except queue.Empty:
            return None

    def close(self) -> None:
        """Stop listening."""
        self._closing.set()
        # Closing the server alone would not end an accept that is under way.
        with socket.create_connection(self._server.getsockname(), timeout=1.0):
            self._thread.join()
        self._server.close()

    def _listen(self) -> None:
        while True:
            connection, _ = self._server.accept()
            with connection:
                if self._closing.is_set():
                    return
                connection.settimeout(_DEAF_S)
                try:
                    data = connection.recv(65536)
                    began_s = time.monotonic()
                    data += b"".join(iter(partial(connection.recv, 65536), b""))
                except OSError:
                    # A stimulus whose connection broke was not delivered.
                    continue
                if not data:
                    # A connection without data only asks whether the panel is there.
                    continue
                samples = np.frombuffer(data[: len(data) // _SAMPLE.itemsize * _SAMPLE.itemsize], _SAMPLE)
                if self._real_time:
                    self._closing.wait(began_s + samples.size / self._actuator.rate_hz - time.monotonic())
                self._stimuli.put(_delivered(samples, self._actuator, self._moving))


def _delivered(samples: NDArray[np.float32], actuator: ActuatorRig, moving: MovingPanel | None) -> NDArray[np.float64]:
    delivered = samples.astype(np.float64) * actuator.full_scale
    if actuator.shaping is None or not samples.size:
        return delivered
    rate_hz = actuator.rate_hz
    return moved(delivered, rate_hz=rate_hz) if moving is None else moving.moved(delivered, rate_hz=rate_hz)


QUIET_S = 0.03
"""Zeros that end a stimulus, s."""

LONGEST_S = 10.0
"""How much the tap must keep, s: a whole stimulus, and what came before it."""

_LOOK_S = 0.005


class CardPanel:
    """What the foot feels behind a sound card: a stimulus begins above zero, and ends after `QUIET_S` of zeros."""

    def __init__(self, tap: Tap, actuator: ActuatorRig, moving: MovingPanel | None = None) -> None:
        """Begin with what is carried from now on; `tap` is on the actuator's channel."""
        self._tap = tap
        self._actuator = actuator
        self._moving = moving
        self._quiet = round(QUIET_S * actuator.rate_hz)
        self._at = 0

    def felt(self, timeout_s: float) -> NDArray[np.float64] | None:
        """Return the next delivered stimulus, m/s^2, shape (n,), at the actuator's rate; None after `timeout_s`.

        With a `timeout_s` of 0 it is also None before the stimulus ends. Raises `AudioError` if it does not end, or
        nobody listens to the card.
        """
        ends = time.monotonic() + timeout_s
        while True:
            found, begun = self._next()
            if found is not None:
                return _delivered(found, self._actuator, self._moving)
            late_s = time.monotonic() - ends
            if not timeout_s or (late_s > 0 and not begun):
                return None
            if late_s > LONGEST_S:
                raise AudioError(
                    "simulated sound card", f"a stimulus did not end within {LONGEST_S:g} s", "start again"
                )
            time.sleep(_LOOK_S)

    def close(self) -> None:
        """Listen no more."""
        self._tap.close()

    def _next(self) -> tuple[NDArray[np.float32] | None, bool]:
        """Return a stimulus that is over, if there is one, and whether one has begun."""
        self._at, carried = self._tap.since(self._at)
        sounding = np.flatnonzero(carried)
        if not sounding.size:
            self._at += len(carried)
            return None, False
        gaps = np.flatnonzero(np.diff(sounding) > self._quiet)
        last = int(sounding[gaps[0]] if gaps.size else sounding[-1])
        if not gaps.size and carried.size - last <= self._quiet:
            return None, True
        self._at += last + 1
        return carried[int(sounding[0]) : last + 1], True
