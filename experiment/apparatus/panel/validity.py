"""Whether what a rig file states of its panel was measured, and still counts: without that a session shakes nobody.

A real rig is refused whose panel nobody measured, or somebody too long ago, and one that states another full scale than
was measured, or has another driver of its own.
"""

from collections.abc import Iterator
from datetime import date
from pathlib import Path

from palpate.experiment.apparatus.panel.response_table import is_simulated
from palpate.experiment.apparatus.rig import Rig, at_site, response_table
from palpate.experiment.errors import Finding, Remedy, RigError

CALIBRATE = ("palpate", "calibrate", "actuator", "--rig", "RIG", "--out", "NEW-RIG")

UNHEARD_DAYS = 30
"""For so long a measurement counts at most if no accelerometer stays on the panel, which sessions compare with it."""


def refuse_unmeasured(rig_file: Path, rig: Rig, today: date) -> None:
    """Raise `RigError` if a real rig would shake a panel, or make its voltages, by what was not measured lately."""
    refused = simulated_table(rig_file, rig_file.parent, rig) or unmeasured_panel(rig_file, rig, today)
    if refused is not None:
        raise RigError.at(refused)


def simulated_table(where: Path | str, rig_folder: Path, rig: Rig) -> Finding | None:
    """Return what is wrong with a real rig, named by `where`, whose response table is SIMULATED; None otherwise."""
    shaping = rig.actuator.shaping
    if rig.rig.simulated or shaping is None or not is_simulated(response_table(rig_folder, shaping)):
        return None
    what, remedy = f"{shaping.response} is marked SIMULATED", "measure the loaded panel, and enter its table"
    return Finding(what, where, allowed="a measured table", remedy=remedy)


def unmeasured_panel(rig_file: Path, rig: Rig, today: date) -> Finding | None:
    """Return why the panel of a real rig may shake nobody on a day; None otherwise.

    Raises `RigError` for a table of its response that is missing or is another.
    """
    at = "" if rig.site is None else f" at {rig.site}"
    command = at_site(CALIBRATE, rig.site)
    measured, remedy = rig.actuator.measured, Remedy("run {}", command)
    if rig.rig.simulated:
        return None
    if measured is None:
        return Finding(
            f"its panel{at} was never measured", rig_file, allowed="an [actuator.measured] table", remedy=remedy
        )
    if is_simulated(response_table(rig_file.parent, measured)):
        what = f"{measured.response} is marked SIMULATED"
        return Finding(what, rig_file, allowed="a measured panel", remedy=remedy)
    made, days = measured.calibrated_on, measured.calibration_days
    if rig.accelerometer is None or rig.accelerometer.stays is False:
        days = min(days, UNHEARD_DAYS)
    if not 0 <= (today - made).days <= days:
        if made > today:
            remedy = Remedy("check that the clock is right, or run {}", command, suffices=False)
        allowed = f"0 to {days} days before {today}"
        return Finding(f"its panel{at} was measured on {made}", rig_file, allowed=allowed, remedy=remedy)
    for key, stated, then in _scales(rig):
        if stated != then:
            allowed = f"{then:g}, the value when its panel was measured"
            return Finding(f"got {stated:g}", rig_file, field=key, got=f"{stated:g}", allowed=allowed, remedy=remedy)
    for key, found, then_sha256 in _drivers(rig):
        if found != then_sha256:
            what = "its driver differs from the one used to measure the panel"
            return Finding(what, rig_file, field=key, allowed="the same file", remedy=remedy)
    return None


def _drivers(rig: Rig) -> Iterator[tuple[str, str | None, str | None]]:
    """Yield the hash of each driver of one's own that plays or hears, by its key, and that of the measurement."""
    if (measured := rig.actuator.measured) is None:
        return
    yield "actuator.driver", rig.driver_sha256(rig.actuator), measured.driver_sha256
    if rig.accelerometer is not None:
        yield "accelerometer.driver", rig.driver_sha256(rig.accelerometer), measured.accelerometer_driver_sha256


def _scales(rig: Rig) -> Iterator[tuple[str, float, float]]:
    """Yield each full scale that a measured rig states, m/s^2 or V, by its key, and what it was in the measurement."""
    actuator, sensor = rig.actuator, rig.accelerometer
    if (measured := actuator.measured) is None:
        return
    if (full_m_s2 := actuator.full_scale_m_s2) is not None:
        yield "actuator.full_scale_m_s2", full_m_s2, measured.full_scale_m_s2
    if (output := actuator.output) is not None and measured.output is not None:
        key = "shaping.full_scale_v" if actuator.shaping else "output_v" if actuator.output_v else "output_m_s2"
        yield f"actuator.{key}", output, measured.output
    if sensor is not None:
        yield "accelerometer.full_scale_m_s2", sensor.full_scale_m_s2, measured.accelerometer_m_s2
        if sensor.full_scale_v is not None and measured.accelerometer_v is not None:
            yield "accelerometer.full_scale_v", sensor.full_scale_v, measured.accelerometer_v
