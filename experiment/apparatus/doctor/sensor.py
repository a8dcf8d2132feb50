"""Checks of the accelerometer, with nobody on the panel: that a sensor answers at its address, lives, and is at rest.

Whether it lies on the panel that the actuator moves, and what else does, is heard only where that moves: `palpate
calibrate actuator` and the comparison with it (`panel/drift.py`), before a session or asked for, refuse what they find.
"""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus.doctor.checks import judged, passed, refused, unchecked
from palpate.experiment.apparatus.panel import drift
from palpate.experiment.apparatus.panel.accelerometer import Window, listener
from palpate.experiment.apparatus.rig import AccelerometerRig, Rig
from palpate.experiment.clock import Clock
from palpate.experiment.errors import Finding, PalpateError, RecordingError, Remedy

LISTEN_S = 1.0
"""How long the sensor is listened to, s."""

RATE_PART = 0.2
"""Part of the rig file's rate by which samples may come more or less often: pieces of a tenth of a second count."""

QUIETEST = 1e-9
"""A part of full scale: less than a last bit of 24 is no sensor's noise."""


LOAD = "panel's load"
"""The name of the comparison of a panel with its measurement."""


def load(rig_file: Path, rig: Rig, *, may_move: bool) -> Iterator[Finding]:
    """Yield whether the panel moves as it was measured, if it may; nothing of a rig whose panel nobody measured.

    A difference that a session warns of is red.
    """
    if (measured := rig.actuator.measured) is None:
        return
    if not drift.is_heard(rig):
        told = f"no accelerometer stays on the panel, which was measured with {measured.load} on it"
        yield unchecked(LOAD, told, "check that nothing else is on the panel")
    elif rig.rig.simulated:
        yield unchecked(LOAD, "a simulated panel moves only in rehearsals")
    elif not may_move:
        told = f"this check did not move the panel, which was measured with {measured.load} on it"
        again = ("palpate", "doctor", "--rig", f"{rig_file}", "--compare-panel")
        yield unchecked(LOAD, told, Remedy("with nobody on the panel, run {}", again))
    else:
        try:
            found, _ = drift.compare_panel(rig_file, rig)
        except PalpateError as error:
            yield refused(LOAD, error)
        else:
            yield replace(found, verdict="passes" if found.verdict == "passes" else "refuses", check=LOAD)


def checks(rig: Rig, settings: AccelerometerRig, address: str | None, *, clock: Clock) -> Iterator[Finding]:
    """Yield everything that an accelerometer shows, at an `address` or the rig's; the clock goes by itself."""
    name, where = "accelerometer", address or settings.address
    others = {"actuator": rig.actuator.address, "servo": rig.servo.address if rig.servo is not None else None}
    # Drivers of one's own may take one address, such as that of a card with inputs and outputs.
    if ":" not in settings.driver and (shared := [device for device, its in others.items() if its == where]):
        told, correct = f"its address, {where}, is also {shared[0]}.address", "correct one of them in the rig file"
        yield judged(name, False, told, allowed="a separate address", remedy=correct)
        return
    sensor = listener(rig, address=address, clock=clock)
    try:
        with closing(sensor):
            sensor.arm(round(LISTEN_S * settings.rate_hz))
            begun_ns = clock.now_ns()
            window = sensor.heard_since_armed()
            took_s = (clock.now_ns() - begun_ns) / 1e9
    except RecordingError as error:
        yield refused(name, error)
        return
    yield passed(name, f"{where} sends samples")
    yield from heard(window, settings, took_s=took_s)


def heard(window: Window, settings: AccelerometerRig, *, took_s: float) -> Iterator[Finding]:
    """Yield what the samples of `LISTEN_S`, which took so long to come, tell of their sensor."""
    samples, anew = window.samples_m_s2, "or correct accelerometer.address: it may belong to another device"
    taken = samples.size - window.lost_s * settings.rate_hz
    rate_hz, quiet_m_s2 = taken / took_s, float(np.std(samples))
    yield judged(
        "accelerometer rate",
        abs(rate_hz - settings.rate_hz) <= RATE_PART * settings.rate_hz,
        f"{rate_hz:.0f} samples per second",
        allowed=f"{settings.rate_hz}, within {RATE_PART:.0%}",
        remedy=f"set the device and accelerometer.rate_hz in the rig file to the same rate, {anew}",
    )
    peak_m_s2 = float(np.abs(samples).max())
    yield judged(
        "accelerometer at rest",
        quiet_m_s2 > QUIETEST * settings.full_scale_m_s2 and peak_m_s2 < settings.trigger_m_s2,
        f"{quiet_m_s2:.2g} m/s^2 (SD), {peak_m_s2:.2g} m/s^2 (peak)",
        allowed=f"some noise, with a peak below accelerometer.trigger_m_s2, {settings.trigger_m_s2:g} m/s^2",
        remedy=f"reconnect the sensor, try another cable, do not move the panel, {anew}",
    )
