"""Leaving out what lies outside a band: what is kept, what of it is counted, and the most that is left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.crinkle import leave_out, rms_outside
from palpate.experiment.synthesis.waveforms import prepare
from tests.experiment.synthesis.oracle import random_spectra, spectrum_at

BAND_HZ = (2.0, 15.0)


def test_what_is_kept_is_kept_and_the_rest_is_not_held() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    held = leave_out(s, band_hz=BAND_HZ)
    assert (held.samples, held.band_hz) == (20, BAND_HZ)
    assert held.amplitudes.shape == (4, 13)
    np.testing.assert_array_equal(held.amplitudes[:, 2:], s.amplitudes[:, 2:13])
    assert not held.amplitudes[:, :2].any()
    assert held.grid(480).count == s.grid(480).count


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bins=st.integers(3, 24), rate_hz=st.sampled_from([480, 50]))
def test_the_rest_sounds_as_before_and_its_floored_bins_are_counted(seed: int, bins: int, rate_hz: int) -> None:
    s = random_spectra(np.random.default_rng(seed), speeds=3, bins=bins)
    f = np.arange(bins) * s.rate_hz / (2 * bins)
    inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    silenced = np.where(inside, s.amplitudes, 0.0)
    whole, band = (
        prepare(of, material="any", output_rate_hz=rate_hz)
        for of in (type(s)(s.speeds_mm_s, s.rate_hz, silenced, s.signs), leave_out(s, band_hz=BAND_HZ))
    )
    v = s.speeds_mm_s
    for speed in (0.0, v[0] / 2, v[0], v[1] + 1e-3, v[-1], v[-1] * 1.01, v[-1] * 1.5, v[-1] * 9):
        got, wanted = band.at(float(speed)), whole.at(float(speed))
        np.testing.assert_array_equal(got.waveform_m_s2, wanted.waveform_m_s2)
        assert got.floored_bins == wanted.floored_bins


def test_a_stimulus_says_which_band_is_held() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    for of, name in ((s, ""), (leave_out(s, band_hz=BAND_HZ), ", 2 to 15 Hz")):
        assert prepare(of, material="any", output_rate_hz=480).band == name


@pytest.mark.parametrize("seed", range(10))
def test_the_loudest_outside_is_an_upper_bound_that_is_reached(seed: int) -> None:
    s = random_spectra(np.random.default_rng(seed), speeds=3, bins=20)
    f = np.arange(20) * s.rate_hz / 40
    outside = (f < BAND_HZ[0]) | (f > BAND_HZ[1])
    outside[0] = False
    v = s.speeds_mm_s
    for fastest in (float(v[0] / 3), float(v[1]), float(v[-1] * 1.7)):
        speeds = {0.0, fastest, *np.linspace(0, fastest, 97), *v[v <= fastest]}
        levels = [np.sqrt(np.sum(spectrum_at(s, float(one))[0][outside] ** 2) / 2) for one in speeds]
        stated = rms_outside(s, band_hz=BAND_HZ, fastest_mm_s=fastest)
        assert stated == pytest.approx(float(max(levels)), rel=1e-12)


def test_a_band_without_a_bin_is_silence() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    held = leave_out(s, band_hz=(24.9, 24.95))
    assert not prepare(held, material="any", output_rate_hz=480).at(1.0).waveform_m_s2.any()


def test_a_band_around_all_bins_costs_nothing() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    held = leave_out(s, band_hz=(0.0, 100.0))
    np.testing.assert_array_equal(held.amplitudes, s.amplitudes)
    assert rms_outside(s, band_hz=(0.0, 100.0), fastest_mm_s=400.0) == 0.0


@pytest.mark.parametrize("band_hz", [(500.0, 10.0), (-1.0, 10.0), (np.nan, 10.0), (10.0, 10.0)])
def test_a_band_that_is_none_is_refused(band_hz: tuple[float, float]) -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    with pytest.raises(SynthesisError, match="band_hz: got"):
        leave_out(s, band_hz=band_hz)
    with pytest.raises(SynthesisError, match="band_hz: got"):
        rms_outside(s, band_hz=band_hz, fastest_mm_s=400.0)
