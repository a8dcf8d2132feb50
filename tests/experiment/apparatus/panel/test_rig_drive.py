"""A rig's drive: voltages and losses as worked out at the speed, prepared or not, and tables that are refused."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from experiment.apparatus.panel.conditioning import open_drive
from experiment.apparatus.panel.response_table import read
from experiment.apparatus.ports import Waveform
from experiment.apparatus.rig import ActuatorRig, ShapingRig
from experiment.errors import RigError
from experiment.synthesis.basis import Basis
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.shaping import drive
from experiment.synthesis.spectra import Bins, Grid, inverse_on
from experiment.synthesis.waveforms import BinsAtSpeed, InverseDct, Renderer, Synthesised
from tests.experiment.apparatus.panel.tables import GOOD, Write


def actuator(path: Path, digest: str | None = None) -> ActuatorRig:
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    shaping = ShapingRig(
        response=path.name, response_sha256=digest or found, full_scale_v=9.0, gain_limit_v_per_m_s2=0.25
    )
    return ActuatorRig(driver="pcm-tcp", address="rehearsal", rate_hz=8000, shaping=shaping)


def test_a_drive_is_opened_from_a_rig_and_says_what_is_lost(written: Write) -> None:
    path = written(GOOD)
    drive = open_drive(path.parent, actuator(path), limit_m_s2=100.0)
    assert drive is not None
    # Bin 2 of 800 at 8 kHz stands at 10 Hz: 2 m/s^2 take sqrt 2 V, and the limit allows 0.5 V.
    cosine = np.cos(2 * np.pi * (np.arange(800) + 0.5) / 800)
    voltages = drive(Waveform(2.0 * cosine))
    lost = voltages.shaping()
    assert voltages.waveform_v == pytest.approx(0.5 * cosine, rel=1e-12, abs=1e-12)
    # Through (0.1 Vrms, 0.25 m/s^2) and (1 Vrms, 2 m/s^2), 0.5 V reach this:
    reached = 0.25 + (0.5 / 2**0.5 - 0.1) / 0.9 * 1.75
    assert (lost.saturated_bins, lost.outside_bins, lost.bounded_bins) == (0, 0, 1)
    assert lost.bounded_cost_m_s2 == pytest.approx(2.0 - reached)
    assert reached * (1 - 1e-12) <= voltages.peak_m_s2() <= 1.013 * reached
    assert (lost.saturated_cost_m_s2, lost.outside_cost_m_s2) == (0.0, 0.0)


def test_shaping_asks_for_no_waveform_of_a_stimulus_whose_bins_are_known(written: Write) -> None:
    summed: list[float] = []

    def sum_up() -> np.ndarray:
        summed.append(1.0)
        return np.zeros(800)

    path = written(GOOD)
    drive = open_drive(path.parent, actuator(path), limit_m_s2=100.0)
    assert drive is not None
    bins = Bins(np.array([0.0, 0.0, 2.0]), samples=800, rate_hz=8000)
    stimulus = Synthesised(sum_up, floored_bins=0, extrapolated=False, dropped_bins=0, bins=lambda: bins)
    cosine = np.cos(2 * np.pi * (np.arange(800) + 0.5) / 800)
    assert drive(stimulus).waveform_v == pytest.approx(0.5 * cosine, rel=1e-12, abs=1e-12)
    assert summed == []
    assert stimulus.waveform_m_s2 is stimulus.waveform_m_s2
    assert summed == [1.0]


def test_another_table_than_the_rig_names_is_refused(written: Write) -> None:
    path = written(GOOD)
    with pytest.raises(
        RigError, match=r"response\.csv: got a table with sha256 .*; allowed: 000.*, as the rig file says"
    ):
        open_drive(path.parent, actuator(path, "0" * 64), limit_m_s2=100.0)


def test_a_table_that_is_not_there_is_refused(written: Write, tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"response\.csv: cannot be read \(No such file or directory\).*; restore it"):
        open_drive(tmp_path / "elsewhere", actuator(written(GOOD)), limit_m_s2=100.0)


def test_an_actuator_that_takes_accelerations_has_no_drive(tmp_path: Path) -> None:
    plain = ActuatorRig(driver="pcm-tcp", address="rehearsal", rate_hz=8000, full_scale_m_s2=9.0)
    assert open_drive(tmp_path, plain, limit_m_s2=100.0) is None


def loud() -> CrinkleSpectra:
    """800 bins at 8 kHz, 5 Hz apart: those at 10, 15 and 20 Hz are within the table, the others have a thousandth."""
    amplitudes = np.full((2, 800), 1e-3)
    amplitudes[0, 2:5], amplitudes[1, 2:5] = (0.1, 0.2, 0.3), (1.5, 2.5, 0.9)
    return CrinkleSpectra(np.array([100.0, 200.0]), 8000, amplitudes, np.ones((2, 800)))


@pytest.mark.parametrize("method", [Basis(), InverseDct()])
@pytest.mark.parametrize("speed_mm_s", [50.0, 100.0, 130.0, 170.0, 199.0, 250.0, 299.0, 400.0])
@pytest.mark.parametrize("limit_m_s2", [100.0, 1.5])
def test_prepared_voltages_and_their_record_are_those_of_the_speed(
    written: Write, method: Basis | InverseDct, speed_mm_s: float, limit_m_s2: float
) -> None:
    render: Renderer = method.prepare(loud(), output_rate_hz=8000)
    path = written(GOOD)
    prepared = open_drive(path.parent, actuator(path), limit_m_s2=limit_m_s2, like=[render(0.0)])
    plain = open_drive(path.parent, actuator(path), limit_m_s2=limit_m_s2)
    assert prepared is not None
    assert plain is not None
    got, wanted = prepared(render(speed_mm_s)), plain(render(speed_mm_s))
    record = got.shaping()
    assert 0.97 * wanted.shaping().scale <= record.scale <= 1
    response, limit_v = read(path), actuator(path).full_scale
    volts, did = drive(
        BinsAtSpeed(loud(), speed_mm_s)(),
        rate_hz=8000,
        response=response,
        gain_limit_v_per_m_s2=0.25,
        limit_v=limit_v,
        scale=record.scale,
    )
    np.testing.assert_allclose(got.waveform_v, volts, rtol=0, atol=1e-12)
    assert (record.bounded_bins, record.outside_bins) == (did.bounded.bins, did.outside.bins)
    assert record.bounded_cost_m_s2 == pytest.approx(did.bounded.cost_m_s2, rel=1e-12)
    reached = did.reached_m_s2
    peak_m_s2 = np.abs(inverse_on(reached, Grid(p=16_000, q=1, count=16_000, carried=reached.size))).max()
    assert peak_m_s2 * (1 - 1e-12) <= got.peak_m_s2() <= 1.013 * peak_m_s2
    assert peak_m_s2 <= limit_m_s2


def test_of_what_is_prepared_no_spectrum_is_worked_out_before_it_is_asked_for(written: Write) -> None:
    one, other = (Basis().prepare(loud(), output_rate_hz=8000) for _ in range(2))
    path = written(GOOD)
    drive = open_drive(path.parent, actuator(path), limit_m_s2=100.0, like=[one(0.0)])
    assert drive is not None
    stimulus, unprepared = one(150.0), other(150.0)
    voltages, worked_out = drive(stimulus), drive(unprepared)
    assert "at" not in vars(stimulus.bins)
    assert "at" in vars(unprepared.bins), "another material, though it is of equal numbers"
    assert voltages.shaping() == worked_out.shaping()
    assert "at" in vars(stimulus.bins)
