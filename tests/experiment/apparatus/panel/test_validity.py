"""A real rig's panel counts as measured for so many days, at the full scales that its rig file still states."""

from __future__ import annotations

from datetime import date, timedelta
from hashlib import sha256
from pathlib import Path

import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import checks
from palpate.experiment.apparatus.panel.validity import CALIBRATE, refuse_unmeasured, unmeasured_panel
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import Finding, Remedy, RigError
from palpate.experiment.protocol.files import shipped
from tests.rig.laboratory import write_rig

TODAY = date.today()


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    return write_rig(tmp_path, "rehearsal", port='"/dev/none"', address='"127.0.0.1:9"')


@pytest.fixture
def rig(rig_file: Path) -> Rig:
    return rigs.load(rig_file)


def changed(rig: Rig, **values: object) -> Rig:
    return rig.model_copy(update={"actuator": rig.actuator.model_copy(update=values)})


def refused(rig_file: Path, rig: Rig, day: date = TODAY) -> Finding:
    """What a session, the board's page and the doctor refuse alike."""
    with pytest.raises(RigError) as raised:
        refuse_unmeasured(rig_file, rig, day)
    found, check = raised.value.finding, checks.panel(rig, rig_file, day)
    assert (check.check, check.verdict, check.what, check.remedy) == ("panel", "refuses", found.what, found.remedy)
    return found


def commanded(finding: Finding) -> tuple[tuple[str, ...], bool]:
    assert isinstance(finding.remedy, Remedy)
    return finding.remedy.command, finding.remedy.suffices


def test_a_panel_measured_lately_may_shake_people(rig_file: Path, rig: Rig) -> None:
    for days in (0, 30):
        refuse_unmeasured(rig_file, rig, TODAY + timedelta(days))
        assert checks.panel(rig, rig_file, TODAY + timedelta(days)).verdict == "passes"


@pytest.mark.parametrize(("days", "suffices"), [(31, True), (-1, False)])
def test_a_measurement_is_valid_for_as_long_as_the_rig_states(
    rig_file: Path, rig: Rig, days: int, suffices: bool
) -> None:
    found = refused(rig_file, rig, TODAY + timedelta(days))
    assert (found.where, commanded(found)) == (rig_file, (CALIBRATE, suffices))
    assert f"{TODAY}" in found.what


def test_a_panel_that_nobody_measured_is_refused_with_the_command_that_measures_it(rig_file: Path, rig: Rig) -> None:
    assert commanded(refused(rig_file, changed(rig, measured=None))) == (CALIBRATE, True)


def test_a_panel_that_was_simulated_is_not_measured(rig_file: Path, rig: Rig) -> None:
    (rig_file.parent / "panel.csv").write_bytes(table := b"# SIMULATED: no panel was measured.\n")
    assert rig.actuator.measured is not None
    measured = rig.actuator.measured.model_copy(update={"response_sha256": sha256(table).hexdigest()})
    assert commanded(refused(rig_file, changed(rig, measured=measured))) == (CALIBRATE, True)


def test_a_table_that_is_not_that_of_the_measurement_is_refused(rig_file: Path, rig: Rig) -> None:
    (rig_file.parent / "panel.csv").write_bytes(b"# Another.\n")
    with pytest.raises(RigError) as raised:
        refuse_unmeasured(rig_file, rig, TODAY)
    assert raised.value.finding.where == rig_file.parent / "panel.csv"
    assert checks.panel(rig, rig_file, TODAY).verdict == "refuses"


def test_ten_times_the_full_scale_that_was_measured_is_refused(rig_file: Path, rig: Rig) -> None:
    accelerations = {"shaping": None, "low_hz": 10.0, "high_hz": 500.0}
    assert unmeasured_panel(rig_file, changed(rig, full_scale_m_s2=50.0, **accelerations), TODAY) is None
    found = refused(rig_file, changed(rig, full_scale_m_s2=500.0, **accelerations))
    assert (found.field, found.got, commanded(found)) == ("actuator.full_scale_m_s2", "500", (CALIBRATE, True))


def test_a_sensor_whose_full_scale_was_corrected_since_did_not_measure_this_panel(rig_file: Path, rig: Rig) -> None:
    sensor = rigs.load(shipped("rigs/rehearsal.toml")).accelerometer
    assert sensor is not None
    assert unmeasured_panel(rig_file, rig.model_copy(update={"accelerometer": sensor}), TODAY) is None
    corrected = sensor.model_copy(update={"full_scale_m_s2": 98.0})
    found = refused(rig_file, rig.model_copy(update={"accelerometer": corrected}))
    assert (found.field, found.got) == ("accelerometer.full_scale_m_s2", "98")


def test_another_voltage_of_a_sample_than_was_measured_is_refused(rig_file: Path, rig: Rig) -> None:
    assert rig.actuator.measured is not None
    assert rig.actuator.shaping is not None
    full_scale_v = rig.actuator.shaping.full_scale_v
    known = changed(rig, measured=rig.actuator.measured.model_copy(update={"output": full_scale_v}))
    assert unmeasured_panel(rig_file, known, TODAY) is None
    halved = rig.actuator.shaping.model_copy(update={"full_scale_v": full_scale_v / 2})
    found, key = refused(rig_file, changed(known, shaping=halved)), "full_scale_v"
    assert (found.field, found.got) == (f"actuator.shaping.{key}", f"{full_scale_v / 2:g}")


@pytest.mark.parametrize("key", ["output_v", "output_m_s2"])
def test_another_output_of_a_driver_of_ones_own_than_was_measured_is_refused(
    rig_file: Path, rig: Rig, key: str
) -> None:
    assert rig.actuator.measured is not None
    measured = rig.actuator.measured.model_copy(update={"output": 5.0})
    own = changed(rig, shaping=None, full_scale_m_s2=50.0, measured=measured, **{key: 5.0})
    assert unmeasured_panel(rig_file, own, TODAY) is None
    found = refused(rig_file, changed(own, **{key: 10.0}))
    assert (found.field, found.got, commanded(found)) == (f"actuator.{key}", "10", (CALIBRATE, True))


def test_another_voltage_of_the_sensor_than_was_measured_is_refused(rig_file: Path, rig: Rig) -> None:
    sensor = rigs.load(shipped("rigs/rehearsal.toml")).accelerometer
    assert sensor is not None
    assert rig.actuator.measured is not None
    measured = rig.actuator.measured.model_copy(update={"accelerometer_v": 10.0})
    heard = changed(rig, measured=measured)
    same, other = (sensor.model_copy(update={"full_scale_v": volts}) for volts in (10.0, 5.0))
    assert unmeasured_panel(rig_file, heard.model_copy(update={"accelerometer": same}), TODAY) is None
    found, key = refused(rig_file, heard.model_copy(update={"accelerometer": other})), "full_scale_v"
    assert (found.field, found.got) == (f"accelerometer.{key}", "5")


def test_another_driver_than_that_with_which_the_panel_was_measured_is_refused(rig_file: Path) -> None:
    file = rig_file.with_name("converter.py")
    file.write_bytes(b"class Converter: ...\n")

    def of(content: bytes) -> Rig:
        rig = rigs.load(rig_file)
        assert rig.actuator.measured is not None
        measured = {"driver_sha256": sha256(content).hexdigest()}
        return changed(rig, driver="converter:Converter", measured=rig.actuator.measured.model_copy(update=measured))

    assert unmeasured_panel(rig_file, of(b"class Converter: ...\n"), TODAY) is None
    found = refused(rig_file, of(b"class Converter: pass\n"))
    assert (found.field, commanded(found)) == ("actuator.driver", (CALIBRATE, True))


@pytest.mark.parametrize(("stays", "days"), [(None, 90), (True, 90), (False, 30)])
def test_a_panel_that_no_sensor_hears_before_a_session_is_measured_every_30_days(
    rig_file: Path, rig: Rig, stays: bool | None, days: int
) -> None:
    sensor = rigs.load(shipped("rigs/rehearsal.toml")).accelerometer
    assert sensor is not None
    assert rig.actuator.measured is not None
    long = changed(rig, measured=rig.actuator.measured.model_copy(update={"calibration_days": 90}))
    sensed = long.model_copy(update={"accelerometer": sensor.model_copy(update={"stays": stays})})
    for one, valid in ((sensed, days), (long, 30)):
        assert unmeasured_panel(rig_file, one, TODAY + timedelta(valid)) is None
        assert f"0 to {valid} days" in refused(rig_file, one, TODAY + timedelta(valid + 1)).allowed


def test_a_simulated_rig_needs_no_measurement() -> None:
    file = shipped("rigs/rehearsal.toml")
    refuse_unmeasured(file, rigs.load(file), TODAY)
    assert checks.panel(rigs.load(file), file, TODAY).verdict == "unknown"
