"""The simulated panel behind a simulated sound card: it listens to what the actuator's channel really carries.

The channel carries samples without end. A stimulus begins with the first that is not zero, and is over when `QUIET_S`
of zeros have followed.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus.rig_panel import ActuatorRig
from experiment.errors import AudioError
from experiment.rehearsal import response
from experiment.rehearsal.tap import Tap

QUIET_S = 0.03
"""Zeros that end a stimulus, s."""

LONGEST_S = 10.0
"""How much the tap must keep, s: a whole stimulus, and what came before it."""

_LOOK_S = 0.005


class CardPanel:
    """What the foot feels, as `Panel` does it for a raw PCM port."""

    def __init__(self, tap: Tap, actuator: ActuatorRig) -> None:
        """Begin with what was carried from the moment of tapping on.

        Args:
            tap: on the actuator's channel.
            actuator: says what a sample of 1.0 is, and whether samples are volts.
        """
        self._tap = tap
        self._actuator = actuator
        self._quiet = round(QUIET_S * actuator.rate_hz)
        self._at = 0

    def felt(self, timeout_s: float) -> NDArray[np.float64] | None:
        """The next stimulus that was delivered and not felt yet.

        Args:
            timeout_s: how long to wait for one to begin, s; 0 for none.

        Returns:
            Acceleration, m/s^2, shape (n,), at the actuator's rate; None if nothing came, or it is not over yet and
            `timeout_s` is 0.

        Raises:
            AudioError: one that has begun does not end, or nobody listens to the card any more.
        """
        ends = time.monotonic() + timeout_s
        while True:
            found, begun = self._next()
            if found is not None:
                return self._moved(found.astype(np.float64))
            late_s = time.monotonic() - ends
            if not timeout_s or (late_s > 0 and not begun):
                return None
            if late_s > LONGEST_S:
                raise AudioError(f"simulated sound card: a stimulus did not end within {LONGEST_S:g} s; start again")
            time.sleep(_LOOK_S)

    def close(self) -> None:
        """Listen no more."""
        self._tap.close()

    def _next(self) -> tuple[NDArray[np.float32] | None, bool]:
        """A stimulus that is over, if there is one; and whether one has begun."""
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

    def _moved(self, samples: NDArray[np.float64]) -> NDArray[np.float64]:
        delivered = samples * self._actuator.full_scale
        if self._actuator.shaping is None:
            return delivered
        return response.moved(delivered, rate_hz=self._actuator.rate_hz)
