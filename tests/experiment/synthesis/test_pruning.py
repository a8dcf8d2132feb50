"""Pruning leaves out what lies outside the band, and states the largest error that this makes at any speed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiment.errors import SynthesisError
from experiment.synthesis.basis import Basis
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.first_block import FirstBlockFirst
from experiment.synthesis.pruning import BandPruned, largest_share, loudest_outside, prune
from experiment.synthesis.waveforms import InverseDct, PrintedSum
from tests.experiment.synthesis.oracle import random_spectra, spectrum_at

BAND_HZ = (2.0, 15.0)


def share_at(s: CrinkleSpectra, v: float) -> float:
    """Rms left out at one speed, by rms of all there (in extrapolation at least that at the nearest speed)."""
    c, _, outside = spectrum_at(s, v)
    f = np.arange(s.samples) * s.rate_hz / (2 * s.samples)
    left_out = (f < BAND_HZ[0]) | (f > BAND_HZ[1])
    whole = np.sum(c[1:] ** 2)
    if outside is not None:
        whole = max(whole, np.sum(s.amplitudes[outside, 1:].astype(np.longdouble) ** 2))
    return float(np.sqrt(np.sum(c[1:][left_out[1:]] ** 2) / whole)) if whole else 0.0


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bins=st.integers(2, 20))
def test_the_share_is_an_upper_bound_at_every_speed(seed: int, bins: int) -> None:
    s = random_spectra(np.random.default_rng(seed), speeds=3, bins=bins)
    v = s.speeds_mm_s
    stated = largest_share(s, band_hz=BAND_HZ, carried=bins)
    for speed in (0.0, *np.linspace(v[0] / 2, v[-1] * 2, 60), 1e4, 1e7):
        assert share_at(s, float(speed)) <= stated


@pytest.mark.parametrize("seed", range(10))
def test_between_measured_speeds_the_share_is_reached(seed: int) -> None:
    """Bins that do not change outside, so that the largest share lies between two speeds."""
    rng = np.random.default_rng(seed)
    middle = random_spectra(rng, speeds=2, bins=16, v=np.array([100.0, 200.0]))
    ends = np.abs(middle.amplitudes[[0, 0, 1, 1]])
    s = CrinkleSpectra(np.array([50.0, 100.0, 200.0, 300.0]), 50, ends, np.sign(rng.normal(size=ends.shape)))
    stated = largest_share(s, band_hz=BAND_HZ, carried=16)
    assert max(share_at(s, float(v)) for v in np.linspace(100, 200, 2001)) == pytest.approx(stated, rel=1e-4)


def test_a_share_that_peaks_between_two_speeds_is_found_there() -> None:
    """Within (3, 1) and (1, 3) the left-out bin stands still: at the middle it is 2 of sqrt(2^2 + 2^2 + 2^2)."""
    amplitudes = np.zeros((2, 10))
    amplitudes[:, 2], amplitudes[:, 3], amplitudes[:, 9] = [3.0, 1.0], [1.0, 3.0], [2.0, 2.0]
    s = CrinkleSpectra(np.array([100.0, 101.0]), 50, amplitudes, np.ones((2, 10)))
    at_ends = 2 / np.sqrt(14)
    assert at_ends < 1 / np.sqrt(3) <= largest_share(s, band_hz=BAND_HZ, carried=10)


def test_what_is_kept_is_kept_and_the_rest_is_not_held() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    held = prune(s, band_hz=BAND_HZ)
    assert held.samples == 20
    assert held.amplitudes.shape == (4, 13)
    np.testing.assert_array_equal(held.amplitudes[:, 2:], s.amplitudes[:, 2:13])
    assert not held.amplitudes[:, :2].any()
    assert held.grid(480).count == s.grid(480).count


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bins=st.integers(1, 24), rate_hz=st.sampled_from([480, 50, 20]))
def test_floored_and_dropped_bins_are_counted_on_the_whole_spectrum(seed: int, bins: int, rate_hz: int) -> None:
    s = random_spectra(np.random.default_rng(seed), speeds=3, bins=bins)
    v = s.speeds_mm_s
    dropped = sum(2 * k * s.rate_hz >= 2 * bins * rate_hz for k in range(bins))
    for inner in (Basis(), FirstBlockFirst(), Basis(single=True), InverseDct(), PrintedSum()):
        try:
            render = BandPruned(inner, BAND_HZ).prepare(s, output_rate_hz=rate_hz)
        except SynthesisError:
            assert bins * rate_hz <= s.rate_hz, "too short for a sample"
            continue
        for speed in (0.0, v[0] / 2, v[0], v[1] + 1e-3, v[-1], v[-1] * 1.01, v[-1] * 1.5, v[-1] * 9):
            made = render(float(speed))
            _, floored, _ = spectrum_at(s, float(speed))
            assert (made.floored_bins, made.dropped_bins) == (floored, dropped)


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
        stated = loudest_outside(s, band_hz=BAND_HZ, fastest_mm_s=fastest)
        assert stated == pytest.approx(float(max(levels)), rel=1e-12)


def test_a_band_without_a_bin_is_silence_and_says_that_all_is_left_out() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    method = BandPruned(InverseDct(), (24.9, 24.95))
    assert not method.prepare(s, output_rate_hz=480)(1.0).waveform_m_s2.any()
    assert method.estimate(s, output_rate_hz=480).relative_error == pytest.approx(1.0)


def test_a_band_around_all_bins_costs_nothing() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    whole, band = InverseDct(), BandPruned(InverseDct(), (0.0, 100.0))
    errors = [m.estimate(s, output_rate_hz=480).relative_error for m in (whole, band)]
    assert errors[0] == errors[1]
    waves = [m.prepare(s, output_rate_hz=480)(80.0).waveform_m_s2 for m in (whole, band)]
    np.testing.assert_array_equal(waves[0], waves[1])


def test_bins_that_the_output_cannot_carry_are_no_loss() -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    assert largest_share(s, band_hz=(1.25, 15.0), carried=13) == 0.0


@pytest.mark.parametrize("band_hz", [(500.0, 10.0), (-1.0, 10.0), (np.nan, 10.0), (10.0, 10.0)])
def test_a_band_that_is_none_is_refused(band_hz: tuple[float, float]) -> None:
    s = random_spectra(np.random.default_rng(1), speeds=4, bins=20)
    with pytest.raises(SynthesisError, match="band_hz: got"):
        prune(s, band_hz=band_hz)
