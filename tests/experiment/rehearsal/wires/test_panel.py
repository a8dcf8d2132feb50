"""The simulated rig's response: its table as shipped, and what shaping through the table makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.rehearsal.wires.panel import (
    FREQUENCIES_HZ,
    LEVELS_VRMS,
    SOFT_V,
    answered,
    gain,
    measured,
    moved,
)
from palpate.experiment.synthesis.signals.weighting import shape
from palpate.experiment.synthesis.spectra import inverse, spectrum
from tests.experiment.apparatus.panel.tables import read, write

WORST_INTERPOLATION = 0.01
"""Straight lines between the table's frequencies, relative to the closed form: worst at 11 Hz, where it is steepest."""

TYPICAL_INTERPOLATION = 4e-4
"""The same, median over the table."""


COMMENTS = (
    "SIMULATED frequency response of the rehearsal's rig; no rig was measured.",
    "A sinusoid of drive_vrms (V, root mean square) moves the panel by acceleration_pp_m_s2 (m/s^2, peak to peak).",
)


def test_the_shipped_table_is_the_one_this_code_writes(tmp_path: Path, repository_root: Path) -> None:
    write(tmp_path / "response.csv", measured(), comments=COMMENTS)
    shipped = repository_root / "protocols" / "rigs" / "rehearsal-response.csv"
    assert (tmp_path / "response.csv").read_bytes() == shipped.read_bytes()
    assert "SIMULATED" in shipped.read_text().splitlines()[0]


def test_the_shipped_table_is_the_closed_form_to_its_six_digits(repository_root: Path) -> None:
    read_back, wanted = read(repository_root / "protocols" / "rigs" / "rehearsal-response.csv"), measured()
    assert np.array_equal(read_back.frequencies_hz, wanted.frequencies_hz)
    assert read_back.levels_v == pytest.approx(wanted.levels_v, rel=1e-12)
    assert read_back.accelerations_m_s2 == pytest.approx(wanted.accelerations_m_s2, rel=5e-6)


def test_it_is_of_the_kind_that_the_paper_shows() -> None:
    f = np.arange(10.0, 601.0)
    at_one_vrms = 2 * answered(f, np.full(f.size, 2**0.5))
    # Okamoto et al., section 4: 'a peak frequency of around 360 Hz', and levels from 0.1 to 1.5 Vrms.
    assert f[np.argmax(at_one_vrms)] == pytest.approx(360, abs=10)
    assert (min(LEVELS_VRMS), max(LEVELS_VRMS)) == (0.1, 1.5)
    # 'changed almost linearly with the voltage inputs when the frequency was fixed'.
    levels = 2**0.5 * np.array(LEVELS_VRMS)
    departure = 1 - answered(np.array([360.0]), levels) / (gain(np.array([360.0])) * levels)
    assert 0.02 < departure.max() < 0.03
    assert np.all(np.diff(departure) > 0)


@pytest.mark.parametrize("a", [0.01, 0.1, 0.3, 1.0, 2.5])
def test_voltages_from_the_table_move_the_rig_as_asked_to_the_error_of_straight_lines(a: float) -> None:
    f = np.arange(10.0, 601.0)
    shaped = shape(np.full(f.size, a), frequencies_hz=f, response=measured(), gain_limit_v_per_m_s2=1e3)
    reachable = answered(f, np.full(f.size, 2**0.5 * max(LEVELS_VRMS))) > 1.01 * a
    error = np.abs(answered(f, shaped.coefficients_v) / a - 1)[reachable]
    assert error.max() < WORST_INTERPOLATION
    assert np.median(error) < TYPICAL_INTERPOLATION
    # Closed form of the inverse: e = E sinh(a / (G E)).
    exact = SOFT_V * np.sinh(a / (gain(f) * SOFT_V))
    assert np.max(np.abs(shaped.coefficients_v / exact - 1)[reachable]) < WORST_INTERPOLATION
    nodes = np.isin(f, FREQUENCIES_HZ) & reachable
    # At a measured frequency the lines between levels are left: to leading order h^2 / 8 of e'' / e = 1 / E^2.
    between_levels = (2**0.5 * max(np.diff(LEVELS_VRMS)) / SOFT_V) ** 2 / 8
    assert np.max(np.abs(shaped.coefficients_v / exact - 1)[nodes]) <= 1.05 * between_levels


def test_the_panel_answers_each_frequency_on_its_own() -> None:
    volts = np.zeros(500)
    volts[[20, 72]] = 0.5, -2.0
    got = spectrum(moved(inverse(volts), rate_hz=5000))
    # Bins of 500 samples at 5 kHz are 5 Hz wide.
    wanted = answered(np.arange(0.0, 2500.0, 5.0), volts)
    assert got == pytest.approx(wanted, abs=1e-13)
    assert not moved(np.zeros(9), rate_hz=5000).any()
