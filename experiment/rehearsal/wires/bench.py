"""SIMULATED bench for `palpate calibrate actuator`: a panel at the actuator's port, a sensor on it, and nobody near.

Ports and drivers are the real ones. Time passes as samples are played and heard.
"""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import gcd

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.apparatus.panel import accelerometer as accelerometers
from palpate.experiment.apparatus.panel.accelerometer import PcmAccelerometer, Window
from palpate.experiment.apparatus.panel.calibration import Devices
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import RigError
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.rehearsal.wires.modes import MovingPanel
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.sensor import REST_NOISE_M_S2, Sensor

LATE_NS = 12_345_678
"""How long after a sample is played the sensor sends what it moved, ns."""

FELT_S = 5.0
"""How long a delivered stimulus may take to be there, s, on a busy machine."""


class Bench:
    """Implements `Player` and `Listener` of a calibration."""

    def __init__(self, rig: Rig, panel: Panel, sensor: Sensor, clock: ManualClock, rng: np.random.Generator) -> None:
        settings = accelerometers.settings_of(rig)
        self._panel, self._sensor, self._clock, self._rng = panel, sensor, clock, rng
        self._rates_hz = rig.actuator.rate_hz, settings.rate_hz
        full_scale = rig.actuator.full_scale
        condition = Conditioner(full_scale=full_scale, limit_m_s2=full_scale)
        self._actuator = PcmActuator(panel.address, condition, rate_hz=rig.actuator.rate_hz, clock=clock)
        self._accelerometer = PcmAccelerometer(settings.model_copy(update={"address": sensor.address}), clock=clock)

    def play(self, samples: NDArray[np.float32]) -> None:
        """Play samples, and have the sensor hear what the panel moves."""
        self._actuator.play(samples)
        moved = self._panel.felt(FELT_S)
        if moved is not None:
            self._sensor.shake(self.sensed(moved), self._clock.now_ns() + LATE_NS, self._rng)
        self._clock.sleep_ns(self._sensor.silent_ns - self._clock.now_ns())
        self._sensor.send()

    def sensed(self, moved_m_s2: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what the sensor makes of what the panel moved, m/s^2, at its own rate."""
        played_hz, heard_hz = self._rates_hz
        common = gcd(played_hz, heard_hz)
        heard = signal.resample_poly(moved_m_s2, heard_hz // common, played_hz // common)
        return np.asarray(heard + self._rng.normal(0.0, REST_NOISE_M_S2, heard.size))

    def arm(self, samples: int) -> None:
        self._accelerometer.arm(samples)

    def heard_since_armed(self) -> Window:
        return self._accelerometer.heard_since_armed()

    def close(self) -> None:
        """Close both drivers."""
        self._accelerometer.close()
        self._actuator.close()


@contextmanager
def bench(rig: Rig, moving: MovingPanel | None, *, seed: int) -> Iterator[Devices]:
    """Yield the bench of a simulated rig with a server for its panel. Raises `RigError` for another actuator."""
    if rig.actuator.driver != "pcm-tcp":
        remedy = "use a rig whose actuator.driver is 'pcm-tcp'"
        raise RigError(f"rig '{rig.rig.name}'", "its panel is a channel of a simulated sound card", remedy)
    clock = ManualClock(0)
    sensor = Sensor(accelerometers.settings_of(rig), clock)
    panel = Panel(rig.actuator, real_time=False, moving=moving)
    with closing(sensor), closing(panel):
        made = Bench(rig, panel, sensor, clock, np.random.default_rng(seed))
        with closing(made):
            yield Devices(made, made, rig.actuator.rate_hz, accelerometers.settings_of(rig).rate_hz)
