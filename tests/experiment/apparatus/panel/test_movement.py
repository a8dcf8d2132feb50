"""A panel's peak by its measured response, and the limit that rests on it, against a simulation in time."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import Drifted, open_conditioner, open_drive
from palpate.experiment.apparatus.panel.movement import COLUMNS, DRIFT_DB, Movement, Reference, read_reference
from palpate.experiment.apparatus.rig import MeasuredRig, Rig
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records.transcript.stimulus import played_line
from palpate.experiment.synthesis.waveforms import Ring
from tests.benchmarks import limit
from tests.experiment.synthesis.stimuli import of_bins

LINES = np.arange(5, 2001)


def stated(**given: object) -> MeasuredRig:
    values: dict[str, object] = {
        "response": "panel.csv",
        "response_sha256": "0" * 64,
        "load": "nobody",
        "full_scale_m_s2": 20.0,
        "low_hz": 5.0,
        "high_hz": 2000.0,
        "resonances_hz": (),
        "loudest": 0.2,
        "check_peak": 0.05,
        "compression_db": 0.0,
        "accelerometer_m_s2": 100.0,
        "calibrated_on": date(2026, 1, 1),
        "calibration_days": 30,
    }
    return MeasuredRig.model_validate(values | given)


def flat(m_s2: float, error_m_s2: float = 0.0, **given: object) -> Movement:
    """A panel that moves alike at all frequencies."""
    response = np.full(LINES.size, m_s2 + 0j)
    return Movement(Reference(LINES, response, np.full(LINES.size, error_m_s2)), stated(**given), 5000)


@pytest.mark.parametrize("name", ["four modes", "soft coil"])
def test_the_limit_holds_for_stimuli_that_look_for_the_worst(name: str) -> None:
    found = limit.row(limit.PANELS[name], 16, seed=4)
    assert (found.over, found.attenuated) == (0, 0)
    assert 0.9 < found.highest <= 1
    assert found.stated <= 2


def test_a_peak_between_samples_counts() -> None:
    """A cosine of a quarter of the rate, sampled at 45 degrees: no sample is above 0.71 of its peak."""
    samples = np.cos(np.pi / 2 * np.arange(2500) + np.pi / 4) * np.hanning(2500)
    assert np.abs(samples).max() < 0.708
    assert 1.0 <= flat(20.0).peak(samples).peak_m_s2 / 20.0 < 1.03


def test_each_line_is_off_by_two_standard_errors_at_once() -> None:
    t = np.arange(2500) / 5000
    samples = 0.1 * np.sin(2 * np.pi * 100 * t) * np.hanning(2500)
    peak = flat(20.0, 0.5).peak(samples)
    # All of a tone is at one line, and a window's side lobes add some.
    assert 2 * 0.5 * 0.1 <= peak.highest_m_s2 / 10**0.05 - peak.peak_m_s2 < 1.5 * 2 * 0.5 * 0.1
    assert flat(20.0).peak(samples).uncertainty_m_s2 == pytest.approx((10**0.05 - 1) * peak.peak_m_s2)


def test_what_a_soft_coil_loses_is_uncertain() -> None:
    samples = 0.2 * np.hanning(2500)
    firm, soft = flat(20.0).peak(samples), flat(20.0, compression_db=1.0).peak(samples)
    assert soft.peak_m_s2 == pytest.approx(firm.peak_m_s2 * 10**-0.05, rel=1e-3)
    assert soft.highest_m_s2 == pytest.approx(firm.highest_m_s2)


@pytest.mark.parametrize("drift_db", [-DRIFT_DB, DRIFT_DB])
def test_a_panel_keeps_the_limit_as_it_was_compared(drift_db: float) -> None:
    found = limit.row(limit.drawn(101), 16, seed=1, drift_db=drift_db)
    assert (found.over, found.attenuated) == (0, 0)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """The rehearsal's rig with a panel that was measured: 24 m/s^2 for a sample of 1.0, at all frequencies."""
    table = tmp_path / "panel.csv"
    rows = [",".join(COLUMNS), *(f"{hz},24,0,0.01,1" for hz in LINES)]
    table.write_text("\n".join(rows), "utf-8")
    (tmp_path / "rig.toml").write_text(shipped("rigs/rehearsal.toml").read_text("utf-8"), "utf-8")
    (tmp_path / "rehearsal-response.csv").write_bytes(shipped("rigs/rehearsal-response.csv").read_bytes())
    made = rigs.load(tmp_path / "rig.toml")
    measured = stated(response_sha256=hashlib.sha256(table.read_bytes()).hexdigest())
    made.__dict__["actuator"] = made.actuator.model_copy(update={"measured": measured})
    return made


def test_a_measured_panel_is_limited_by_what_it_does_and_what_is_lost_goes_on_record(rig: Rig) -> None:
    assert rig.folder is not None
    drive = open_drive(rig.folder, rig.actuator, limit_m_s2=1.0)
    assert drive is not None
    assert drive.limit_m_s2 == np.inf
    coefficients = np.zeros(2500)
    coefficients[100:300:10] = 0.4
    condition = open_conditioner(rig, limit_m_s2=1.0, drive=drive)
    played = condition(of_bins(coefficients, samples=2500, rate_hz=5000))
    record = played.on_record()
    assert record.moved is not None
    assert record.shaping is not None
    assert record.shaping.scale == 1.0
    assert record.moved.peak_m_s2 + record.moved.uncertainty_m_s2 == record.reached_peak_m_s2
    assert record.reached_peak_m_s2 == pytest.approx(1.0, rel=1e-6)
    assert record.reached_peak_m_s2 <= 1.0
    # A flat panel moves by the samples, and overshoots between them where they begin with a jump.
    assert 1 < record.moved.peak_m_s2 / (np.abs(played.samples).max() * 24) < 1.2
    free = open_conditioner(rig, limit_m_s2=100.0, drive=drive)(played.stimulus)
    assert np.abs(played.samples).max() / np.abs(free.samples).max() == pytest.approx(record.moved.scale, rel=1e-6)
    assert free.on_record().moved is not None
    # Nothing compared the panel, so that it may be 1 dB louder.
    compared = open_conditioner(rig, limit_m_s2=1.0, drive=drive, drifted=Drifted(0.0, 0.0))(played.stimulus)
    assert compared.panel_scale / played.panel_scale == pytest.approx(10**0.05)
    assert free.panel_scale == 1.0
    # What the limit takes is counted as that, and nothing as rounding.
    budget = played.budget()[0]
    assert budget.taken_down == pytest.approx(1 - record.moved.scale, rel=0.1)
    assert budget.rounding < 1e-5
    between = record.moved.third_octave_between_db
    assert between is not None
    assert all(said in played_line(record, None) for said in (f"{record.moved.scale:.1%}", f"{between[1]:.1f} dB"))


def test_a_device_that_takes_accelerations_is_scaled_as_a_whole(rig: Rig) -> None:
    takes = rig.actuator.model_copy(update={"shaping": None, "full_scale_m_s2": 24.0})
    rig.__dict__["actuator"] = takes
    condition = open_conditioner(rig, limit_m_s2=1.0, drive=None)
    assert condition.ceiling == 1.0
    wanted = 4.0 * np.hanning(2500) * np.sin(2 * np.pi * 100 * np.arange(2500) / 5000)
    played = condition(Ring(wanted, 5000))
    assert played.limited == 0
    assert played.samples * 24.0 == pytest.approx(wanted * played.panel_scale, abs=1e-5)
    assert played.budget()[0].taken_down == pytest.approx(1 - played.panel_scale, rel=1e-3)
    assert replace(played, panel_scale=1.0).on_record().reached_peak_m_s2 <= 1.0
    broken = condition(Ring(np.array([np.nan, np.inf, -np.inf, 0.0]), 5000))
    assert broken.moved is not None
    assert broken.moved.highest_m_s2 <= 1.0


@pytest.mark.parametrize(
    "rows", ["", "5,1,0,0,1", "5,1,0,0,1\n5,1,0,0,1", "5,nan,0,0,1\n6,1,0,0,1", "5,1,0\n6,1,0", "5,1,0,0,1\n6,1,x,0,1"]
)
def test_a_table_that_is_no_response_is_refused(rows: str) -> None:
    with pytest.raises(RigError):
        read_reference(Path("panel.csv"), f"{','.join(COLUMNS)}\n{rows}\n".encode())
    with pytest.raises(RigError):
        read_reference(Path("panel.csv"), b"# measured\n")


def test_a_measured_rig_without_its_table_conditions_nothing(rig: Rig) -> None:
    assert rig.folder is not None
    (rig.folder / "panel.csv").unlink()
    with pytest.raises(RigError):
        open_conditioner(rig, limit_m_s2=1.0, drive=None)
