"""SIMULATED surfaces: their ringing against equation (2), and how high it feels against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.rehearsal.kinds.tapping.surfaces import (
    FITTED,
    RATE_HZ,
    TABLE_1,
    felt_hz,
    frequencies_hz,
    generic,
    mixed,
    rings,
    virtual_hardness,
)

SURFACES = tuple(TABLE_1)


def test_a_tap_is_equation_2_at_the_frequency_of_table_1() -> None:
    assert frequencies_hz(SURFACES) == (43.0, 50.0, 100.0, 1000.0, 4000.0)
    waveform = rings(50.0)
    for i in (0, 100, 777):
        t = i / 40_000
        assert waveform[i] == pytest.approx(np.exp(-100 * t) * np.sin(2 * np.pi * 50 * t), abs=1e-12)


@pytest.mark.parametrize("frequency_hz", [43.0, 100.0, 1000.0])
def test_how_high_a_tap_feels_is_the_mean_frequency_of_what_passes(frequency_hz: float) -> None:
    """The spectrum of exp(-B t) sin(w t) is w / ((B + i x)^2 + w^2); the filter is Butterworth's, order 4, 300 Hz."""
    w = 2 * np.pi * frequency_hz

    def power(f: float) -> float:
        return abs(w / ((100 + 2j * np.pi * f) ** 2 + w**2)) ** 2 / (1 + (f / 300) ** 8)

    marks = {"limit": 500, "points": [frequency_hz, 300.0]}
    mean = quad(lambda f: f * power(f), 0, 20_000, **marks)[0] / quad(power, 0, 20_000, **marks)[0]
    found = felt_hz(rings(frequency_hz), RATE_HZ)
    assert found == pytest.approx(mean, rel=0.01)


def test_a_steady_tone_within_the_band_feels_as_high_as_it_is_however_loud() -> None:
    tone = np.sin(2 * np.pi * 150 * np.arange(40_000) / 40_000) * np.hanning(40_000)
    assert felt_hz(tone, 40_000) == pytest.approx(150, rel=1e-3)
    assert felt_hz(tone / 1024, 40_000) == felt_hz(tone, 40_000)


def test_silence_feels_like_nothing() -> None:
    assert felt_hz(np.zeros(100), 40_000) is None


def test_what_the_skin_does_not_pass_makes_aluminum_feel_no_higher_than_plastic() -> None:
    heights = [felt_hz(rings(hz), RATE_HZ) or 0.0 for hz in frequencies_hz(SURFACES)]
    assert sorted(heights[:4]) == heights[:4]
    assert heights[2] < heights[4] < heights[3]


def test_a_virtual_surface_is_as_hard_as_was_fitted_and_silence_softer_than_any() -> None:
    found = [virtual_hardness(felt_hz(rings(hz), RATE_HZ)) for hz in frequencies_hz(SURFACES)]
    assert found == [pytest.approx(one) for one in FITTED]
    assert virtual_hardness(None)[0] < FITTED[0][0]
    assert FITTED[1][0] < virtual_hardness(60.0)[0] < FITTED[2][0]


def test_other_materials_ring_generically_in_their_order_and_that_is_said(approved: SnapshotAssertion) -> None:
    found = frequencies_hz(["felt", "cork", "tin"])
    assert found[0] == pytest.approx(43.0)
    assert found[2] == pytest.approx(4000.0)
    assert found[0] < found[1] < found[2]
    assert "fitted to Table 3" in generic(SURFACES)
    assert generic(["basswood", "felt"]) == approved


def test_materials_without_an_order_are_as_stiff_whatever_their_order_in_the_file() -> None:
    assert mixed(["felt", "cork", "tin"]) == mixed(["tin", "felt", "cork"])
    assert sorted(mixed(["felt", "cork", "tin"])) == ["cork", "felt", "tin"]
