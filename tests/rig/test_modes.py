"""A panel with states at the far end of a real port, and in a rehearsal: it moves by what the actuator delivers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import fft

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import Conditioner, open_drive
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.errors import DatasetError, ProtocolError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.session import PANEL_FILE, moving_panel
from palpate.experiment.rehearsal.wires.modes import MovingPanel, read
from palpate.experiment.rehearsal.wires.panel import Panel
from tests.approved import Refuses
from tests.experiment.synthesis.stimuli import of_bins
from tests.rig.rehearsed import counted, rehearse

PANEL = shipped("rigs/rehearsal-panel.toml")


def test_it_moves_by_the_volts_that_the_actuator_sent() -> None:
    """Beside a multiplication by H of the transform of the same volts, long enough for all that rings."""
    actuator = rigs.load(shipped("rigs/rehearsal.toml")).actuator
    coefficients = np.zeros(2500)
    coefficients[20:550:7] = 0.2 * np.random.default_rng(2).normal(size=76)
    stimulus = of_bins(coefficients, samples=2500, rate_hz=5000)
    drive = open_drive(shipped("rigs/rehearsal.toml").parent, actuator, limit_m_s2=30.0)
    panel = Panel(actuator, real_time=False, moving=MovingPanel(read(PANEL)))
    port = PcmActuator(
        panel.address,
        Conditioner(full_scale=actuator.full_scale, limit_m_s2=30.0, drive=drive),
        rate_hz=actuator.rate_hz,
    )
    try:
        port.prepare(stimulus)
        port.landed(0)
        felt = panel.felt(5.0)
    finally:
        panel.close()
    assert felt is not None
    assert drive is not None
    sent_v = drive(stimulus).voltages_v
    padded = fft.rfft(sent_v, 8 * sent_v.size)
    s = 2j * np.pi * fft.rfftfreq(8 * sent_v.size, 1 / actuator.rate_hz)
    low, high = 2 * np.pi * 35.0, 2 * np.pi * 360.0
    passed = 4.0 * s**2 / (s**2 + low * s + low**2) * high**2 / (s**2 + 0.24 * high * s + high**2)
    wanted = fft.irfft(padded * passed)[: felt.size]
    assert np.abs(felt - wanted).max() <= 0.02 * np.abs(wanted).max()
    # Neither of them is what was asked for: a panel has a phase.
    asked = stimulus.waveform_m_s2
    assert np.linalg.norm(felt[: asked.size] - asked) > 0.5 * np.linalg.norm(asked)


def test_a_rehearsal_keeps_the_panel_that_it_was_given_and_no_other_goes_on_with_it(
    tmp_path: Path, refuses: Refuses
) -> None:
    root = rehearse(tmp_path / "moving", panel_file=PANEL)
    kept = storage.protocol_path(root).with_name(PANEL_FILE)
    assert kept.read_bytes() == PANEL.read_bytes()
    assert moving_panel(root) is not None
    assert len(counted(root, "virtual")) == 40
    with refuses(DatasetError):
        rehearse(root)
    other = tmp_path / "other.toml"
    other.write_text(PANEL.read_text().replace("damping = 0.12", "damping = 0.1"))
    with refuses(DatasetError):
        rehearse(root, panel_file=other)


def test_a_panel_of_modes_needs_a_rig_in_volts(tmp_path: Path, refuses: Refuses) -> None:
    folder = tmp_path / "rig"
    folder.mkdir()
    text = shipped("rigs/rehearsal.toml").read_text()
    before, _, rest = text.partition("[actuator.shaping]")
    _, _, after = rest.partition("[accelerometer]")
    rig = folder / "rig.toml"
    rig.write_text(
        before.replace("rate_hz = 5000\n", "rate_hz = 5000\nfull_scale_m_s2 = 50.0\n", 1) + "[accelerometer]" + after
    )
    with refuses(DatasetError):
        rehearse(tmp_path / "moving", rig_file=rig, panel_file=PANEL)
    assert not (tmp_path / "moving").exists()


@pytest.mark.parametrize("change", [("damping = 0.12", "damping = 1.5"), ("simulated = true", "simulated = false")])
def test_a_file_that_is_no_panel_is_refused_before_anything_is_made(
    tmp_path: Path, change: tuple[str, str], refuses: Refuses
) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(PANEL.read_text().replace(*change))
    with refuses(ProtocolError):
        rehearse(tmp_path / "moving", panel_file=wrong)
    assert not (tmp_path / "moving").exists()
