"""From a rig file to opened devices; each driver is imported only when its device is opened."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

from experiment import files
from experiment.apparatus import rig as rigs
from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.ports import Accelerometer, Actuator, Drive, Tracker
from experiment.apparatus.rig import FRAMES, REHEARSAL, AccelerometerRig, Rig
from experiment.clock import Clock
from experiment.errors import ActuatorError, RigError, TrackerError


def keep(rig_file: Path, kept: Path) -> None:
    """Copy a rig file to `kept`, and beside it the response table that it names.

    Raises:
        RigError: the table is not the one that the rig file names, or another of its name is kept there.
    """
    shaping = rigs.load(rig_file).actuator.shaping
    if shaping is not None:
        table, content = kept.with_name(shaping.response), rigs.response_table(rig_file.parent, shaping)
        if table.exists() and table.read_bytes() != content:
            raise RigError(
                f"{table}: got another response table of this name from an earlier session; allowed: a name for each "
                "measurement; rename the new table, in the rig file too"
            )
        files.write(table, content)
    files.write(kept, rig_file.read_bytes())


def open_tracker(rig: Rig, *, clock: Clock, port: str | None = None, clock_map: ClockMap | None = None) -> Tracker:
    """Open the rig's tracker.

    Args:
        rig: the rig.
        clock: the session's; stamps arrivals.
        port: used instead of the one that the rig names.
        clock_map: of a simulated device whose clock is known; estimated from arrivals if None.

    Raises:
        TrackerError: the port cannot be opened.
        RigError: the rig names a driver that there is not.
    """
    if port is None and rig.tracker.port == REHEARSAL:
        raise TrackerError(_simulated_only(rig, "tracker.port"))
    return _tracker_driver(rig)(port or rig.tracker.port, rig.tracker, clock=clock, clock_map=clock_map)


def _tracker_driver(rig: Rig) -> Callable[..., Tracker]:
    if rig.tracker.driver == FRAMES:
        from experiment.apparatus.serial_tracker import SerialTracker

        return SerialTracker
    module, _, name = rig.tracker.driver.partition(":")
    try:
        driver: Callable[..., Tracker] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise RigError(
            f"rig '{rig.rig.name}': tracker.driver: got '{rig.tracker.driver}' ({error}); allowed: {FRAMES}, or a "
            "class that can be imported; install the package that holds it, or correct the rig file"
        ) from error
    return driver


def open_actuator(rig: Rig, *, limit_m_s2: float, drive: Drive | None = None, address: str | None = None) -> Actuator:
    """Open the rig's actuator.

    Args:
        rig: the rig.
        limit_m_s2: the protocol's limit for the magnitude of any sample, m/s^2.
        drive: frequency shaping, as `recordings.response.open_drive` opens it; for rigs with `actuator.shaping`.
        address: used instead of the one that the rig names.

    Raises:
        ActuatorError: the address or the limit cannot be used.
        RigError: `drive` is missing, or there is one and the rig's actuator takes accelerations.
    """
    from experiment.apparatus.pcm_actuator import PcmActuator

    if address is None and rig.actuator.address == REHEARSAL:
        raise ActuatorError(_simulated_only(rig, "actuator.address"))
    if (drive is None) != (rig.actuator.shaping is None):
        got, allowed = ("no", "one") if drive is None else ("a", "none")
        raise RigError(
            f"rig '{rig.rig.name}': got {got} frequency shaping for its actuator; allowed: {allowed}, as the rig file "
            "says; correct [actuator.shaping] there"
        )
    return PcmActuator(
        address or rig.actuator.address,
        rate_hz=rig.actuator.rate_hz,
        full_scale=rig.actuator.full_scale,
        limit_m_s2=limit_m_s2,
        drive=drive,
    )


def accelerometer_of(rig: Rig) -> AccelerometerRig:
    """The settings of the rig's accelerometer.

    Raises:
        RigError: the rig has none.
    """
    if rig.accelerometer is None:
        raise RigError(
            f"rig '{rig.rig.name}': got no table [accelerometer]; allowed: one, for recording needs it; add driver, "
            "address, rate_hz, full_scale_m_s2 and trigger_m_s2 to the rig file"
        )
    return rig.accelerometer


def open_accelerometer(
    rig: Rig, *, rate_hz: int, address: str | None = None, clock: Clock | None = None
) -> Accelerometer:
    """Open the rig's accelerometer.

    Args:
        rig: the rig.
        rate_hz: sampling rate that the protocol asks of recordings, Hz.
        address: used instead of the one that the rig names.
        clock: the host's; the machine's monotonic clock if None.

    Raises:
        RigError: the rig has none, it samples at another rate, or it exists in simulation alone.
    """
    from experiment.apparatus.pcm_accelerometer import PcmAccelerometer

    settings = accelerometer_of(rig)
    if settings.rate_hz != rate_hz:
        raise RigError(
            f"rig '{rig.rig.name}': accelerometer.rate_hz: got {settings.rate_hz}; allowed: {rate_hz}, the protocol's "
            "synthesis.rate_hz; set the device and the rig file to it"
        )
    if address is None and settings.address == REHEARSAL:
        raise RigError(_simulated_only(rig, "accelerometer.address"))
    return PcmAccelerometer(
        address or settings.address,
        rate_hz=settings.rate_hz,
        full_scale_m_s2=settings.full_scale_m_s2,
        trigger_m_s2=settings.trigger_m_s2,
        clock=clock,
    )


def _simulated_only(rig: Rig, key: str) -> str:
    return (
        f"rig '{rig.rig.name}' is simulated: its devices exist only inside `palpate rehearse`; "
        f"give a rig file whose {key} names a real one"
    )
