"""An actuator behind a lab's own driver, which gets a whole waveform, and when its first sample is due.

A driver that states `lead_s` is told so long before, and schedules; another plays once the foot has landed. What was
played, from when on, what was dropped and what the device clipped is what the driver says, and goes on record.
"""

from __future__ import annotations

import threading
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.conditioning import Conditioner, Played
from palpate.experiment.apparatus.panel.pcm import AHEAD_S, CLOSE_S
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.wires.own import process
from palpate.experiment.apparatus.wires.own.hosting import DriverProcess
from palpate.experiment.clock import Clock, monotonic_ns
from palpate.experiment.errors import ActuatorError
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.synthesis.waveforms import Waveform

REACHES_NS = 3_000_000
"""So long before its driver is due a stimulus can no longer be moved: it takes that to another process, ns; ours."""

LATE_MS = 2.0
"""A scheduled stimulus may begin so much early or late, ms, as `delivered.onset_ms` of a laboratory's rig file is."""


class Output(Protocol):
    """What a lab's driver does, which is made with its table of the rig; times are `time.monotonic_ns()`.

    It may have `rate_hz`, the device's own, and `lead_s`.
    """

    def prepare(self, samples: NDArray[np.float64]) -> None:
        """Get a waveform ready at the rig's `rate_hz`, in V or m/s^2, in place of the one before."""

    def play(self, start_ns: int, stopped: Any) -> tuple[int, int, int, int]:
        """Play it from a time on, or at once if that has passed, to its end or within 0.2 s of `stopped()`.

        Returns when the first sample left, and how many were played, dropped, and changed because they were too large.
        """

    def close(self) -> None:
        """Silence the device, and let go of it."""


class DriverActuator:
    """Implements `Actuator`; `withdraw` and `is_silent` may be called from any thread, and wait for nothing."""

    def __init__(self, rig: Rig, condition: Conditioner, clock: Clock) -> None:
        """Open the device of a rig. Raises `ActuatorError`; `condition` limits every stimulus."""
        self._rig, self._condition, self._clock = rig, condition, clock
        settings = rig.actuator
        self._full_scale = cast("float", settings.output)
        self.rate_hz = settings.rate_hz
        self._number = self._size = 0
        self._start_ns: int | None = None
        self._aimed = self._withdrawn = self._lost = False
        self._sent: tuple[int, int, int, int] | None = None
        self._turn = threading.RLock()
        self._open()

    def _open(self) -> None:
        self._process = DriverProcess(self._rig, "actuator", self._rig.actuator, refused=ActuatorError, hear=self._hear)
        opened = self._process.opened or {}
        self._lead_ns = round(opened["lead_s"] * 1e9)
        self._lost, self._start_ns = False, None

    @property
    def lead_ns(self) -> int:
        return self._lead_ns + REACHES_NS if self._lead_ns else 0

    def prepare(self, stimulus: Waveform) -> Played:
        """Limit, shape and send a stimulus; a driver that has failed is opened anew first. Raises `ActuatorError`."""
        if self._process.fault:
            self._process.close()
            self._open()
        if not self.is_silent():
            raise ActuatorError("actuator", "an earlier stimulus may still be playing", "stop the device, then resume")
        played = self._condition(stimulus)
        self._send(played.samples)
        return played

    def _send(self, samples: NDArray[np.float32]) -> None:
        with self._turn:
            self._number, self._size = self._number + 1, samples.size
            self._start_ns, self._sent = None, None
            self._aimed = self._withdrawn = False
            self._process.send(process.PREPARE, self._number, samples.astype(np.float64) * self._full_scale)

    def aim(self, onset_ns: int) -> bool:
        """Have the first sample leave at `onset_ns`; see `Actuator.aim`. Without `lead_s` nothing is changed."""
        if not self._lead_ns:
            return True
        with self._turn:
            late = onset_ns - self.lead_ns < self._clock.now_ns()
            if late or self._withdrawn or self._is_committed():
                return False
            self._aimed = True
            self._start(onset_ns)
            return True

    def landed(self, contact_ns: int) -> None:  # noqa: ARG002
        """Play at once what was never aimed. Raises `ActuatorError` for a driver that has failed."""
        with self._turn:
            if self._process.fault:
                raise self._failed()
            if self._number and self._start_ns is None and not self._withdrawn:
                self._start(self._clock.now_ns())

    def _start(self, onset_ns: int) -> None:
        self._start_ns = onset_ns
        self._process.send(process.START, self._number, onset_ns + self._later_ns())

    def _later_ns(self) -> int:
        return monotonic_ns() - self._clock.now_ns()

    def _is_committed(self) -> bool:
        return self._start_ns is not None and self._clock.now_ns() >= self._start_ns - self.lead_ns

    def withdraw(self) -> bool:
        """Take back what has not begun, stop what plays, and return whether nothing of it will sound."""
        with self._turn:
            if not self._is_committed():
                self._withdrawn = True
                self._start_ns = None
            self._process.send(process.STOP, self._number, None)
            return self.is_silent()

    def is_silent(self) -> bool:
        """Return whether nothing plays, as the driver says; after its failure in the middle of one nobody knows."""
        return not self._lost and (self._sent is not None or not self._is_committed())

    def delivered(self, contact_ns: int) -> Delivered | None:  # noqa: ARG002
        """Wait until the stimulus has ended, and return what its driver says of it.

        Raises `ActuatorError` if nothing set it off, or for a driver that failed or did not return in time.
        """
        if self._withdrawn:
            now_ns = self._clock.now_ns()
            return Delivered(requested_ns=now_ns, xruns=0, delivered=False, reason="it was canceled before it began")
        if (requested_ns := self._start_ns) is None:
            raise ActuatorError("actuator", "got a request for a stimulus that was never started", "aim it first")
        began_ns, played, dropped, clipped = self._wait(requested_ns)
        onset_ns = began_ns - self._later_ns()
        error_ms = (onset_ns - requested_ns) / 1e6
        most_ms = LATE_MS if self._aimed else AHEAD_S * 1e3
        reason = ""
        if dropped:
            reason = f"{dropped} of its {self._size} samples were dropped"
        elif played < self._size:
            reason = f"it was cut off after {played} of {self._size} samples"
        elif clipped:
            reason = f"the device clipped {clipped} of its {self._size} samples"
        elif abs(error_ms) > most_ms:
            reason = f"it began {error_ms:+.1f} ms off; allowed: {most_ms:g} ms"
        return Delivered(
            requested_ns=requested_ns,
            onset_ns=onset_ns,
            onset_error_ms=error_ms,
            xruns=dropped,
            delivered=not reason,
            reason=reason,
        )

    def _wait(self, start_ns: int) -> tuple[int, int, int, int]:
        """Return what the driver says of what plays. Raises `ActuatorError` for one that fails, or hangs."""
        ends_s = (start_ns - self._clock.now_ns()) / 1e9 + self._size / self.rate_hz + CLOSE_S
        with self._process.changed:
            self._process.changed.wait_for(lambda: self._sent is not None or self._process.fault, max(ends_s, 0.0))
        if self._sent is None:
            raise self._failed(f"did not return from `play` within {CLOSE_S:g} s after the last sample")
        return self._sent

    def _failed(self, hangs: str = "") -> ActuatorError:
        """Return why a driver plays nothing more; nobody knows then what the device does."""
        self._lost = self._start_ns is not None
        return cast("ActuatorError", self._process.error() if self._process.fault else self._process.give_up(hangs))

    def _hear(self, what: str, number: int, *sent: int) -> None:
        with self._process.changed:
            if what == process.SENT and number == self._number:
                self._sent = cast("tuple[int, int, int, int]", sent)
                self._process.changed.notify_all()

    def play(self, samples: NDArray[np.float32]) -> None:
        """Play samples that are no stimulus, to their end; 1.0 is full scale, which nothing exceeds.

        Raises `ActuatorError` for what was not played whole.
        """
        self.start(samples)
        delivered = self.delivered(0)
        if delivered is not None and not delivered.delivered:
            raise ActuatorError("actuator", delivered.reason, "check the device's limits, or have its driver corrected")

    def start(self, samples: NDArray[np.float32]) -> None:
        """Begin to play samples as `play` does. Raises `ActuatorError` for a driver that has failed."""
        self._send(np.clip(samples, -1.0, 1.0).astype(np.float32))
        self.landed(0)

    def close(self) -> None:
        """Play nothing more, and let go of the device."""
        self.withdraw()
        self._process.close()
