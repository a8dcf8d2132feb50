"""An accelerometer behind a lab's own driver, which reads blocks, each with the time of its first sample."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel.accelerometer import Listening, PcmAccelerometer, settings_of
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.wires.own.hosting import MENDED, DriverProcess
from palpate.experiment.clock import Clock, monotonic_ns
from palpate.experiment.errors import RecordingError


class Input(Protocol):
    """What a lab's driver does, which is made with its table of the rig. It may have `rate_hz`, the device's own."""

    def read(self) -> tuple[int, NDArray[np.float64]]:
        """Wait for the next samples, at most 0.2 s, and return when the first was taken, by `time.monotonic_ns()`.

        They are in V where the rig file has `full_scale_v`, else in m/s^2, shape (n,).
        """

    def close(self) -> None:
        """Let go of the device."""


class DriverAccelerometer(PcmAccelerometer):
    """Implements `Accelerometer`; the driver reads from the first `arm` on until it is closed."""

    def __init__(self, rig: Rig, clock: Clock | None) -> None:
        settings = settings_of(rig)
        super().__init__(settings, clock=clock)
        self._rig, self._full_scale = rig, settings.full_scale_v or settings.full_scale_m_s2
        self._process: DriverProcess | None = None
        self._blocks: _Blocks | None = None

    def _begin(self, samples: int) -> Listening:
        if self._process is None or self._process.fault:
            self._let_go()
            self._process = DriverProcess(
                self._rig, "accelerometer", self._settings, refused=RecordingError, hear=self._hear
            )
        self._blocks = _Blocks(self._process, samples, rate_hz=self.rate_hz, clock=self._clock)
        return self._blocks

    def _hear(self, _what: str, first_ns: int, samples: NDArray[np.float64]) -> None:
        if (blocks := self._blocks) is not None and not blocks.over:
            ends_ns = first_ns + round(samples.size * 1e9 / self.rate_hz) + self._clock.now_ns() - monotonic_ns()
            blocks.add((samples / self._full_scale).astype(np.float32), ends_ns)

    def _failed(self, problem: str) -> RecordingError:
        if self._process is not None and self._process.fault:
            problem = self._process.fault
        return RecordingError("accelerometer", problem, MENDED)

    def _let_go(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None

    def close(self) -> None:
        super().close()
        self._let_go()


class _Blocks(Listening):
    """What a driver's process sends."""

    def __init__(self, process: DriverProcess, samples: int, *, rate_hz: int, clock: Clock) -> None:
        super().__init__(samples, rate_hz=rate_hz, clock=clock)
        self._process = process
        self.over = False
        # What fails wakes whoever waits here.
        self._changed = process.changed

    @property
    def broken(self) -> str | None:
        return self._process.fault or None

    def stop(self) -> None:
        self.over = True
