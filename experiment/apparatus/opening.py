"""From a rig file to opened devices; each driver is imported only when its device is opened."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from experiment import files
from experiment.apparatus import rig as rigs
from experiment.apparatus.clock_map import ClockMap
from experiment.apparatus.opening_audio import audio_of, simulated_only
from experiment.apparatus.ports import Accelerometer, Actuator, Drive, Tracker
from experiment.apparatus.rig import FRAMES, Rig
from experiment.apparatus.rig_panel import REHEARSAL, AccelerometerRig, response_table
from experiment.clock import Clock
from experiment.errors import ActuatorError, RigError, TrackerError

if TYPE_CHECKING:
    from experiment.apparatus.audio.stream import AudioStream


def keep(rig_file: Path, kept: Path) -> None:
    """Copy a rig file to `kept`, and beside it the response table that it names.

    Raises:
        RigError: the table is not the one that the rig file names, or another of its name is kept there.
    """
    shaping = rigs.load(rig_file).actuator.shaping
    if shaping is not None:
        table, content = kept.with_name(shaping.response), response_table(rig_file.parent, shaping)
        if table.exists() and table.read_bytes() != content:
            raise RigError(
                f"{table}: got another response table of this name from an earlier session; allowed: a name for each "
                "measurement; rename the new table, in the rig file too"
            )
        files.write(table, content)
    files.write(kept, rig_file.read_bytes())


def open_tracker(
    rig: Rig,
    *,
    clock: Clock,
    port: str | None = None,
    clock_map: ClockMap | None = None,
    contact_mm: float | None = None,
) -> Tracker:
    """Open the rig's tracker; where the rig has it zeroed, one that can be.

    Args:
        rig: the rig.
        clock: the session's; stamps arrivals.
        port: used instead of the one that the rig names.
        clock_map: of a simulated device whose clock is known; estimated from arrivals if None.
        contact_mm: the protocol's height of contact, mm; None where no foot steps, so that nothing is zeroed.

    Raises:
        TrackerError: the port cannot be opened.
        RigError: the rig names a driver that there is not.
    """
    if port is None and rig.tracker.port == REHEARSAL:
        raise TrackerError(simulated_only(rig, "tracker.port"))
    tracker = _driven(rig, port or rig.tracker.port, clock, clock_map)
    farthest_mm = rig.tracker.zeroing_mm
    if contact_mm is None or farthest_mm is None:
        return tracker
    from experiment.apparatus.zeroing import REST_S, ZeroedTracker

    samples = round(REST_S * rig.tracker.rate_hz)
    return ZeroedTracker(tracker, contact_mm=contact_mm, farthest_mm=farthest_mm, samples=samples)


def _driven(rig: Rig, where: str, clock: Clock, clock_map: ClockMap | None) -> Tracker:
    settings = rig.tracker
    if settings.driver == FRAMES:
        from experiment.apparatus.serial_tracker import SerialTracker

        return SerialTracker(where, settings, clock=clock, clock_map=clock_map)
    from experiment.apparatus.foreign import open_foreign

    return open_foreign(rig, where, clock=clock, clock_map=clock_map)


def open_actuator(
    rig: Rig,
    *,
    limit_m_s2: float,
    drive: Drive | None = None,
    address: str | None = None,
    stream: AudioStream | None = None,
) -> Actuator:
    """Open the rig's actuator.

    Args:
        rig: the rig.
        limit_m_s2: the protocol's limit for the magnitude of any sample, m/s^2.
        drive: frequency shaping, as `recordings.rig_drive.open_drive` opens it; for rigs with `actuator.shaping`.
        address: used instead of the one that the rig names.
        stream: the session's, for an actuator that is a channel of it.

    Raises:
        ActuatorError: the address or the limit cannot be used, nothing answers there, or the stream is missing.
        RigError: `drive` is missing, or there is one and the rig's actuator takes accelerations.
    """
    settings = rig.actuator
    where = address or settings.address
    if where == REHEARSAL:
        raise ActuatorError(simulated_only(rig, "actuator.address"))
    if (drive is None) != (settings.shaping is None):
        got, allowed = ("no", "one") if drive is None else ("a", "none")
        raise RigError(
            f"rig '{rig.rig.name}': got {got} frequency shaping for its actuator; allowed: {allowed}, as the rig file "
            "says; correct [actuator.shaping] there"
        )
    if where is not None:
        from experiment.apparatus.pcm_actuator import PcmActuator

        server = PcmActuator(
            where, rate_hz=settings.rate_hz, full_scale=settings.full_scale, limit_m_s2=limit_m_s2, drive=drive
        )
        server.reach()
        return server
    from experiment.apparatus.audio.actuator import AudioActuator

    if stream is None:
        raise ActuatorError(
            f"rig '{rig.rig.name}': got no audio stream for its actuator; allowed: the session's; open [audio] first"
        )
    return AudioActuator(stream, audio_of(rig), full_scale=settings.full_scale, limit_m_s2=limit_m_s2, drive=drive)


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
        raise RigError(simulated_only(rig, "accelerometer.address"))
    return PcmAccelerometer(
        address or settings.address,
        rate_hz=settings.rate_hz,
        full_scale_m_s2=settings.full_scale_m_s2,
        trigger_m_s2=settings.trigger_m_s2,
        clock=clock,
    )
