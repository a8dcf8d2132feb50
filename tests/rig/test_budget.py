"""The error budget against the truth: what a simulated panel behind a real port did, beside the spectrum asked for."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import Conditioner, open_drive
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.apparatus.rig import ActuatorRig
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.synthesis import tap
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from palpate.experiment.synthesis.spectra import spectrum
from palpate.experiment.synthesis.waveforms import Stimulus, prepare

pytestmark = pytest.mark.clocked

SPEEDS_MM_S = np.geomspace(20.0, 600.0, 10)
"""All that the shipped study counts."""

LIMIT_M_S2 = 30.0


@pytest.fixture(scope="module")
def materials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, CrinkleSpectra]:
    protocol = files.load(shipped("okamoto2012.toml"))
    folder = recorded_takes.make_recordings(tmp_path_factory.mktemp("made") / "r", protocol=protocol, seed=1).parent
    virtual = scene.plan(protocol=protocol, task_id="virtual")
    return preparation.load_spectra(scene=virtual, protocol=protocol, recordings=folder)


def in_volts() -> ActuatorRig:
    return rigs.load(shipped("rigs/rehearsal.toml")).actuator


def in_m_s2(rate_hz: int) -> ActuatorRig:
    return ActuatorRig(driver="pcm-tcp", address="rehearsal", rate_hz=rate_hz, full_scale_m_s2=50.0)


def apart(captured: np.ndarray, asked: np.ndarray) -> float:
    """The rms of the difference of a captured waveform's spectrum from the one asked for, as a part of the latter's."""
    c = spectrum(captured)
    wanted = np.zeros(max(c.size, asked.size))
    wanted[1 : asked.size] = asked[1:]
    difference = -wanted
    difference[: c.size] += c
    return float(np.sqrt(np.sum(difference**2) / np.sum(wanted**2)))


@pytest.mark.parametrize(
    ("actuator", "largest"),
    [(in_volts(), 0.5), (in_m_s2(5000), 0.2), (in_m_s2(48_000), 0.2), (in_m_s2(1000), 0.4)],
    ids=["volts", "m/s^2", "m/s^2 at 48 kHz", "m/s^2 at 1 kHz"],
)
def test_the_total_is_the_truth_for_every_material_at_ten_speeds(
    materials: dict[str, CrinkleSpectra], actuator: ActuatorRig, largest: float
) -> None:
    bases = {m: prepare(of, material=m, output_rate_hz=actuator.rate_hz) for m, of in materials.items()}
    drive = open_drive(
        shipped("rigs/rehearsal.toml").parent,
        actuator,
        limit_m_s2=LIMIT_M_S2,
        materials={"typing paper": bases["typing paper"]},
    )
    panel = Panel(actuator)
    condition = Conditioner(full_scale=actuator.full_scale, limit_m_s2=LIMIT_M_S2, drive=drive)
    port = PcmActuator(panel.address, condition, rate_hz=actuator.rate_hz)
    ratios, methods = {}, set()
    try:
        for material, speed_mm_s in ((m, float(v)) for m in materials for v in SPEEDS_MM_S):
            stimulus: Stimulus = bases[material].at(speed_mm_s)
            played = port.prepare(stimulus)
            port.landed(0)
            captured = panel.felt(5.0)
            assert captured is not None
            truth = apart(captured, at_speed(materials[material], speed_mm_s=speed_mm_s).coefficients)
            record = played.on_record().computed
            assert record.left_out is not None
            assert record.left_out <= record.relative_error <= largest
            ratios[material, round(speed_mm_s)] = record.relative_error / truth
            methods.add(record.method)
    finally:
        panel.close()
    assert len(ratios) == 40
    assert {place: ratio for place, ratio in ratios.items() if not 0.9 < ratio < 1.1} == {}
    if actuator.shaping is not None:
        assert methods == {"prepared voltages", "voltages shaped for the step"}
    else:
        assert methods == {"basis waveforms", "inverse DCT"}


@pytest.mark.parametrize("speed_mm_s", [50.0, 200.0, 400.0])
def test_the_total_is_the_truth_of_a_tap_on_a_panel_that_takes_volts(speed_mm_s: float) -> None:
    """A tap has a mean, which no panel carries; of aluminum's 4,000 Hz a table to 600 Hz has nearly nothing."""
    actuator = in_volts().model_copy(update={"rate_hz": 16_000})
    drive = open_drive(shipped("rigs/rehearsal.toml").parent, actuator, limit_m_s2=LIMIT_M_S2)
    panel = Panel(actuator)
    condition = Conditioner(full_scale=actuator.full_scale, limit_m_s2=LIMIT_M_S2, drive=drive)
    port = PcmActuator(panel.address, condition, rate_hz=actuator.rate_hz)
    shares: dict[str, float] = {}
    try:
        for surface in tap.SURFACES:
            ring = tap.rings(surface, rate_hz=actuator.rate_hz, aluminum_m_s2=40.0).at(speed_mm_s * 1e-3)
            record = port.prepare(ring).on_record().computed
            port.landed(0)
            captured = panel.felt(5.0)
            assert captured is not None
            missed = np.linalg.norm(captured - ring.waveform_m_s2) / np.linalg.norm(ring.waveform_m_s2)
            assert record.relative_error == pytest.approx(missed, rel=0.02)
            assert record.method.endswith(" tap")
            shares[surface.name] = record.left_out or 0.0
    finally:
        panel.close()
    assert 0.3 < shares["collapsed polystyrene"] < 0.6
    assert shares["basswood"] < shares["collapsed polystyrene"] < shares["plastic"] < shares["aluminum"] < 1
