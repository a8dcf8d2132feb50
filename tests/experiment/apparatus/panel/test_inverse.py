"""An inverse of a measured panel moves it as asked, within its time, gain and full scale."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.inverse import BAND_HZ, MOST_GAIN, Inverse
from palpate.experiment.apparatus.panel.movement import Movement, Reference
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.modes import Modes, MovingPanel, read
from palpate.experiment.synthesis.waveforms import Ring
from tests.benchmarks.limit import response
from tests.experiment.apparatus.panel.test_movement import stated

RATE_HZ, FULL_SCALE_V = 5000, 12.0
LINES = np.arange(5, 2001)


@pytest.fixture(scope="module")
def panel() -> Modes:
    return read(shipped("rigs/rehearsal-panel.toml"))


@pytest.fixture(scope="module")
def movement(panel: Modes) -> Movement:
    """The rehearsal's panel, measured without any error."""
    found = Reference(LINES, response(panel, LINES.astype(float)), np.zeros(LINES.size))
    return Movement(found, stated(full_scale_m_s2=57.8), RATE_HZ)


def burst(hz: float, peak_m_s2: float = 1.0) -> Ring:
    wave: NDArray[np.float64] = np.hanning(2500) * np.sin(2 * np.pi * hz * np.arange(2500) / RATE_HZ)
    return Ring(peak_m_s2 * wave, RATE_HZ)


def opened(movement: Movement, ahead_s: float = 0.01) -> Conditioner:
    inverse = Inverse(movement, ahead_s=ahead_s)
    return Conditioner(full_scale=FULL_SCALE_V, limit_m_s2=1e6, movement=movement, inverse=inverse)


@pytest.mark.parametrize(("hz", "off"), [(12.0, 0.06), (35.0, 0.03), (150.0, 0.03), (360.0, 0.03), (480.0, 0.03)])
def test_a_panel_in_time_moves_as_asked_after_the_filter_began(
    panel: Modes, movement: Movement, hz: float, off: float
) -> None:
    """The truth is the panel with states, which shares no code with the filter."""
    condition, asked = opened(movement), burst(hz, 0.1)
    played = condition(asked)
    assert played.scale == 1.0
    moved = MovingPanel(panel).moved(played.samples.astype(np.float64) * FULL_SCALE_V, rate_hz=RATE_HZ)
    wanted = np.zeros(moved.size)
    wanted[50:2550] = asked.waveform_m_s2
    assert np.linalg.norm(moved - wanted) < off * np.linalg.norm(wanted)
    assert condition.ahead_s == 0.01
    assert played.budget()[0].inverse == pytest.approx(
        np.linalg.norm((moved - wanted)[50:2550]) / np.linalg.norm(wanted), abs=0.01
    )


def test_what_passes_full_scale_is_taken_down_as_a_whole_and_counted_as_that(movement: Movement) -> None:
    condition = opened(movement)
    soft, loud = condition(burst(150.0, 1.0)), condition(burst(150.0, 1000.0))
    assert soft.scale == 1.0
    assert loud.scale < 0.2
    assert loud.limited == 0
    assert np.abs(loud.samples).max() == pytest.approx(1.0)
    shares = loud.budget()[0]
    assert shares.taken_down == pytest.approx(1 - loud.scale, rel=0.05)
    assert shares.inverse == pytest.approx(soft.budget()[0].inverse, rel=0.05)
    record = loud.on_record()
    assert record.handed_unit == "m/s^2"
    assert record.shaping is None
    assert record.moved is not None


def test_no_frequency_takes_more_than_the_most_gain(movement: Movement) -> None:
    notch = 1 - 1 / (1 + ((LINES - 200.0) / 2.0) ** 2)
    dead = replace(movement.reference, response_m_s2=movement.reference.response_m_s2 * notch)
    inverse = Inverse(replace(movement, reference=dead, _grids={}), ahead_s=0.01)
    gain = np.abs(np.fft.rfft(inverse.taps, 2**15)) * 57.8
    assert gain.max() <= 1.02 * MOST_GAIN
    assert inverse.highest_gain <= MOST_GAIN
    f = np.fft.rfftfreq(2**15, 1 / RATE_HZ)
    within = np.where((f >= BAND_HZ[0]) & (f <= BAND_HZ[1]), gain, 0.0)
    assert inverse.gain == pytest.approx(within.max(), rel=0.06)
    assert inverse.gain_hz == pytest.approx(f[within.argmax()], abs=1.0)


def test_what_moves_before_a_stimulus_is_told_and_nothing_without_time_for_it(panel: Modes, movement: Movement) -> None:
    condition = opened(movement)
    for peak in (0.1, 1000.0):
        played = condition(burst(150.0, peak))
        moved = MovingPanel(panel).moved(played.samples.astype(np.float64) * FULL_SCALE_V, rate_hz=RATE_HZ)[:50]
        asked = played.scale * played.stimulus.waveform_m_s2
        told = played.budget()[0]
        assert told.before == pytest.approx(np.linalg.norm(moved) / np.linalg.norm(asked), abs=1e-3)
        assert told.gain > 0
    assert opened(movement, ahead_s=0.0)(burst(150.0)).budget()[0].before == 0.0


def test_a_panel_that_was_not_measured_through_the_band_has_no_inverse(movement: Movement) -> None:
    some = LINES[LINES <= 400]
    short = Reference(some, movement.reference.response_m_s2[: some.size], np.zeros(some.size))
    with pytest.raises(RigError):
        Inverse(replace(movement, reference=short), ahead_s=0.01)


def test_a_rig_without_a_measured_panel_states_no_inverse(tmp_path: Path) -> None:
    text = shipped("rigs/rehearsal.toml").read_text("utf-8")
    newest = text.replace("format = 2", "format = 6")
    (tmp_path / "rig.toml").write_text(newest, "utf-8")
    assert rigs.load(tmp_path / "rig.toml").actuator.inverse_ahead_ms is None
    given = newest.replace("[actuator]\n", "[actuator]\ninverse_ahead_ms = 10.0\n")
    (tmp_path / "rig.toml").write_text(given, "utf-8")
    with pytest.raises(RigError):
        rigs.load(tmp_path / "rig.toml")
