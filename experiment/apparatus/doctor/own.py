"""Checks of an actuator behind a lab's own driver, with nobody on the panel: zeros, played whole and stopped."""

import threading
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np

from palpate.experiment.apparatus.doctor.checks import CLOSES_MS, SERVED_S, judged, passed, refused
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.wires.own.actuator import DriverActuator
from palpate.experiment.clock import Clock
from palpate.experiment.errors import ActuatorError, Finding

MENDED = "check the device's settings and what its driver returns: palpate docs devices"


def checks(rig: Rig, clock: Clock) -> Iterator[Finding]:
    """Yield what the driver of a rig's actuator does with zeros; the clock goes by itself."""
    settings = rig.actuator
    condition = Conditioner(full_scale=settings.full_scale, limit_m_s2=settings.full_scale)
    zeros = np.zeros(round(SERVED_S * settings.rate_hz), np.float32)
    name = "actuator"
    try:
        with closing(DriverActuator(rig, condition, clock)) as actuator:
            lead = f"starts {actuator.lead_ns / 1e6:g} ms before" if actuator.lead_ns else "plays (no lead_s) after"
            yield passed(name, f"its driver '{settings.driver}' opened {settings.address} and {lead} contact")
            name = "actuator samples"
            begun_s = time.monotonic()
            actuator.play(zeros)
            took_s = time.monotonic() - begun_s
            yield judged(
                name,
                took_s >= SERVED_S - 0.01,
                f"all {zeros.size} samples were played; `play` returned after {took_s:.2f} s",
                allowed=f"at least {SERVED_S:g} s, the length of the stimulus",
                remedy=MENDED,
            )
            name = "actuator stop"
            stopped_ms = _stops(actuator, zeros)
            yield judged(
                name,
                stopped_ms <= CLOSES_MS[1],
                f"`play` returned {stopped_ms:.0f} ms after the stop request",
                allowed=f"at most {CLOSES_MS[1]:g} ms",
                remedy=MENDED,
            )
    except ActuatorError as error:
        yield refused(name, error)


def _stops(actuator: DriverActuator, zeros: np.ndarray) -> float:
    """Withdraw what plays in its middle, and return how long the driver went on, ms. Raises `ActuatorError`."""
    cut_s: list[float] = []

    def cut() -> None:
        actuator.withdraw()
        cut_s.append(time.monotonic())

    timer = threading.Timer(SERVED_S / 2, cut)
    timer.start()
    actuator.start(zeros)
    actuator.delivered(0)
    ended_s = time.monotonic()
    timer.join()
    return max(ended_s - cut_s[0], 0.0) * 1e3
