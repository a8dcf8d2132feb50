"""What a device is handed and what goes on record of it; voltages prepared or not; and tables that are refused."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus.panel.conditioning import Conditioner, open_drive
from palpate.experiment.apparatus.rig import ActuatorRig, ShapingRig
from palpate.experiment.errors import RigError
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from palpate.experiment.synthesis.shaping import drive
from palpate.experiment.synthesis.spectra import Bins, Grid, inverse_on
from palpate.experiment.synthesis.voltages import Driven
from palpate.experiment.synthesis.waveforms import Basis, prepare
from tests.approved import Refuses
from tests.experiment.apparatus.panel.tables import GOOD, Write, read
from tests.experiment.synthesis.stimuli import given, of_bins


def actuator(path: Path, digest: str | None = None) -> ActuatorRig:
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    shaping = ShapingRig(
        response=path.name, response_sha256=digest or found, full_scale_v=9.0, gain_limit_v_per_m_s2=0.25
    )
    return ActuatorRig(driver="pcm-tcp", address="rehearsal", rate_hz=8000, shaping=shaping)


def test_a_drive_is_opened_from_a_rig_and_what_is_lost_goes_on_record(written: Write) -> None:
    path = written(GOOD)
    drive = open_drive(path.parent, actuator(path), limit_m_s2=100.0)
    # Bin 2 of 800 at 8 kHz stands at 10 Hz: 2 m/s^2 take sqrt 2 V, and the limit allows 0.5 V.
    cosine = np.cos(2 * np.pi * (np.arange(800) + 0.5) / 800)
    played = Conditioner(full_scale=9.0, limit_m_s2=100.0, drive=drive)(
        of_bins([0.0, 0.0, 2.0], samples=800, rate_hz=8000)
    )
    assert played.samples * 9.0 == pytest.approx(0.5 * cosine, rel=1e-6, abs=1e-6)
    record = played.on_record()
    assert record.handed_unit == "V"
    assert record.handed_peak == pytest.approx(0.5, rel=1e-4)
    assert record.handed_peak == float(np.abs(played.samples).max()) * 9.0
    assert record.handed_sha256 == hashlib.sha256(played.samples.tobytes()).hexdigest()
    assert record.asked_sha256 == hashlib.sha256(np.array([0.0, 0.0, 2.0]).tobytes()).hexdigest()
    assert (record.samples, record.rate_hz, record.limited) == (800, 8000, 0)
    # Through (0.1 Vrms, 0.25 m/s^2) and (1 Vrms, 2 m/s^2), 0.5 V reach this:
    reached = 0.25 + (0.5 / 2**0.5 - 0.1) / 0.9 * 1.75
    assert reached * (1 - 1e-12) <= record.reached_peak_m_s2 <= 1.013 * reached
    lost = record.shaping
    assert lost is not None
    assert (lost.saturated_bins, lost.outside_bins, lost.bounded_bins) == (0, 0, 1)
    assert lost.bounded_cost_m_s2 == pytest.approx(2.0 - reached)
    assert (lost.saturated_cost_m_s2, lost.outside_cost_m_s2) == (0.0, 0.0)
    told = record.computed
    assert told.method == "voltages shaped for the step"
    # What the bound leaves, and what two frequencies and levels cannot say of the table's lines.
    assert told.relative_error == pytest.approx((2.0 - reached) / 2.0, rel=0.01)
    assert told.dissimilarity_m_s2 == pytest.approx(2.0 - reached)
    assert told.left_out == pytest.approx((2.0 - reached) / 2.0), "the gain limit leaves out what it holds back"


def test_of_a_stimulus_in_volts_no_waveform_is_summed_not_even_for_the_record(written: Write) -> None:
    path = written(GOOD)
    drive = open_drive(path.parent, actuator(path), limit_m_s2=100.0)
    played = Conditioner(full_scale=9.0, limit_m_s2=100.0, drive=drive)(
        of_bins([0.0, 0.0, 2.0], samples=800, rate_hz=8000)
    )
    played.on_record()
    assert "waveform_m_s2" not in vars(played.stimulus)


def test_of_a_device_that_takes_accelerations_their_own_peak_and_hash_go_on_record() -> None:
    played = Conditioner(full_scale=64.0, limit_m_s2=20.0)(given([1.0, -32.0, 2.0], floored=3))
    assert (played.samples * 64).tolist() == [1.0, -20.0, 2.0]
    record = played.on_record()
    assert (record.handed_unit, record.handed_peak, record.reached_peak_m_s2) == ("m/s^2", 20.0, 20.0)
    assert (record.samples, record.rate_hz, record.limited, record.floored_bins) == (3, 5000, 1, 3)
    handed = (np.array([1, -20, 2]) / 64).astype("<f4").tobytes()
    assert record.handed_sha256 == hashlib.sha256(handed).hexdigest()
    assert record.shaping is None
    assert record.computed.method == "basis waveforms"


def test_the_record_says_what_was_played_and_not_what_a_method_can_do() -> None:
    """Beyond the floor of a bin the inverse DCT takes over; what the limiter cuts off is an error like any other."""
    far = basis().at(92.0)
    record = Conditioner(full_scale=9.0, limit_m_s2=0.2)(far).on_record()
    assert (record.computed.method, record.limited > 0) == ("inverse DCT", True)
    off = np.clip(far.waveform_m_s2, -0.2, 0.2) - far.waveform_m_s2
    wanted = np.sqrt(np.mean(off**2) / np.mean(far.waveform_m_s2**2))
    assert record.computed.relative_error == pytest.approx(wanted, rel=1e-3)
    assert record.computed.left_out == 0.0


def test_the_limiter_bounds_what_shaping_makes_whatever_that_is() -> None:
    class Broken:
        limit_m_s2 = 20.0

        def __call__(self, stimulus: object) -> Driven:
            return Driven(np.array([3.0, -12.0, np.nan, np.inf]), 1.0, prepared=False)

    played = Conditioner(full_scale=9.0, limit_m_s2=20.0, drive=Broken())(given([0.0]))  # type: ignore[arg-type]
    assert (played.samples * 9.0).tolist() == [3.0, -9.0, 0.0, 9.0]
    assert played.limited == 3


def test_another_table_than_the_rig_names_is_refused(written: Write, refuses: Refuses) -> None:
    path = written(GOOD)
    with refuses(RigError):
        open_drive(path.parent, actuator(path, "0" * 64), limit_m_s2=100.0)


def test_a_table_that_is_not_there_is_refused(written: Write, tmp_path: Path, refuses: Refuses) -> None:
    with refuses(RigError):
        open_drive(tmp_path / "elsewhere", actuator(written(GOOD)), limit_m_s2=100.0)


def test_an_actuator_that_takes_accelerations_has_no_drive(tmp_path: Path) -> None:
    plain = ActuatorRig(driver="pcm-tcp", address="rehearsal", rate_hz=8000, full_scale_m_s2=9.0)
    assert open_drive(tmp_path, plain, limit_m_s2=100.0) is None


def loud() -> CrinkleSpectra:
    """800 bins at 8 kHz, 5 Hz apart: those at 10, 15 and 20 Hz are within the table, the others have a thousandth."""
    amplitudes = np.full((2, 800), 1e-3)
    amplitudes[0, 2:5], amplitudes[1, 2:5] = (0.1, 0.2, 0.3), (1.5, 2.5, 0.9)
    return CrinkleSpectra(np.array([100.0, 200.0]), 8000, amplitudes, np.ones((2, 800)))


def basis(material: str = "loud") -> Basis:
    return prepare(loud(), material=material, output_rate_hz=8000)


@pytest.mark.parametrize("speed_mm_s", [50.0, 100.0, 130.0, 170.0, 199.0, 250.0, 299.0, 400.0])
@pytest.mark.parametrize("limit_m_s2", [100.0, 1.5])
def test_prepared_voltages_and_their_record_are_those_of_the_speed(
    written: Write, speed_mm_s: float, limit_m_s2: float
) -> None:
    path = written(GOOD)
    prepared = open_drive(path.parent, actuator(path), limit_m_s2=limit_m_s2, materials={"loud": basis()})
    plain = open_drive(path.parent, actuator(path), limit_m_s2=limit_m_s2)
    assert prepared is not None
    assert plain is not None
    stimulus = basis().at(speed_mm_s)
    waveform_v, scale, held = prepared(stimulus)
    _, wanted_scale, _ = plain(stimulus)
    record = Conditioner(full_scale=9.0, limit_m_s2=limit_m_s2, drive=prepared)(stimulus).on_record()
    assert record.shaping is not None
    assert record.shaping.scale == scale
    assert record.computed.method == ("prepared voltages" if held else "voltages shaped for the step")
    assert 0.97 * wanted_scale <= scale <= 1
    c = at_speed(loud(), speed_mm_s=speed_mm_s).coefficients
    volts, did = drive(
        Bins(c, samples=800, rate_hz=8000),
        rate_hz=8000,
        response=read(path),
        gain_limit_v_per_m_s2=0.25,
        limit_v=actuator(path).full_scale,
        scale=scale,
    )
    np.testing.assert_allclose(waveform_v, volts, rtol=0, atol=1e-12)
    assert (record.shaping.bounded_bins, record.shaping.outside_bins) == (did.bounded.bins, did.outside.bins)
    assert record.shaping.bounded_cost_m_s2 == pytest.approx(did.bounded.cost_m_s2, rel=1e-12)
    reached = did.reached_m_s2
    peak_m_s2 = np.abs(inverse_on(reached, Grid(p=16_000, q=1, count=16_000, carried=reached.size))).max()
    assert peak_m_s2 * (1 - 1e-12) <= record.reached_peak_m_s2 <= 1.013 * peak_m_s2
    assert peak_m_s2 <= limit_m_s2


def test_of_what_is_prepared_no_spectrum_is_worked_out_before_it_is_asked_for(written: Write) -> None:
    path = written(GOOD)
    drive = open_drive(path.parent, actuator(path), limit_m_s2=100.0, materials={"loud": basis()})
    condition = Conditioner(full_scale=9.0, limit_m_s2=100.0, drive=drive)
    played, unprepared = condition(basis().at(150.0)), condition(basis("another").at(150.0))
    assert "spectrum" not in vars(played.stimulus)
    assert "spectrum" in vars(unprepared.stimulus), "another material, though it is of equal numbers"
    assert played.on_record().shaping == unprepared.on_record().shaping
    assert "spectrum" in vars(played.stimulus)
