"""Stimuli: equation (5) as printed; where the weighted sum of basis waveforms holds, and where it must not."""

from __future__ import annotations

from math import cos, pi

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from palpate.experiment.synthesis.spectra import inverse, inverse_on, spectrum
from palpate.experiment.synthesis.waveforms import CANCELLATION, Basis, prepare

SPEEDS = np.array([50.0, 100.0, 200.0, 300.0])


def of(amplitudes: NDArray[np.float64]) -> CrinkleSpectra:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], size=amplitudes.shape)
    return CrinkleSpectra(SPEEDS, 5000, amplitudes, signs)


def prepared(amplitudes: NDArray[np.float64]) -> Basis:
    return prepare(of(amplitudes), material="paper", output_rate_hz=48_000)


def rising(bins: int = 9) -> NDArray[np.float64]:
    """Each bin at 1, 2, 3 and 4 m/s^2, so that none is floored above, and at v = 0 all are at exactly zero."""
    return np.outer([1.0, 2.0, 3.0, 4.0], np.ones(bins))


def drawn(seed: int, *, bins: int = 12) -> CrinkleSpectra:
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(3, bins))
    return CrinkleSpectra(np.array([100.0, 200.0, 300.0]), 5000, rng.random((3, bins)), signs)


@pytest.mark.parametrize("v", [137.0, 420.0])
def test_the_stimulus_is_equation_5_of_the_spectrum_at_that_speed(v: float) -> None:
    s = drawn(5)
    wanted = at_speed(s, speed_mm_s=v)
    c, n = wanted.coefficients, s.samples
    expected = [sum(c[k] * cos(pi * k * (i + 0.5) / n) for k in range(1, n)) for i in range(n)]
    made = prepare(s, material="foil", output_rate_hz=5000).at(v)
    np.testing.assert_allclose(made.waveform_m_s2, expected, rtol=0, atol=1e-12)
    assert (made.basis.material, made.speed_mm_s) == ("foil", v)
    assert (made.floored_bins, made.extrapolated) == (wanted.floored_bins, v > 300)
    assert (made.floored_bins > 0) == (v > 300)
    np.testing.assert_array_equal(made.bins.coefficients, c)
    assert (made.bins.samples, made.bins.rate_hz) == (12, 5000)


def test_an_output_rate_drops_the_bins_at_or_above_half_of_it() -> None:
    s = drawn(6)
    basis = prepare(s, material="foil", output_rate_hz=2500)
    c = at_speed(s, speed_mm_s=150.0).coefficients
    expected = [sum(c[k] * cos(pi * k * (i + 0.5) / 6) for k in range(1, 6)) for i in range(6)]
    np.testing.assert_allclose(basis.at(150.0).waveform_m_s2, expected, rtol=0, atol=1e-12)
    assert s.dropped(basis.on) == 6


def test_nothing_is_worked_out_or_summed_before_it_is_asked_for() -> None:
    made = prepare(drawn(7), material="foil", output_rate_hz=5000).at(137.0)
    assert not {"spectrum", "waveform_m_s2"} & set(vars(made))
    assert made.floored_bins == 0
    assert made.waveform_m_s2 is made.waveform_m_s2
    assert "spectrum" not in vars(made)


@pytest.mark.parametrize("v", SPEEDS)
def test_a_measured_speed_is_its_own_basis_waveform_to_the_bit(v: float) -> None:
    basis = prepared(np.abs(np.random.default_rng(2).normal(size=(4, 9))))
    i = int(np.searchsorted(SPEEDS, v))
    own = basis.pairs[i][0][0] if i < 3 else basis.pairs[2][1][0]
    np.testing.assert_array_equal(basis.at(v).waveform_m_s2, own)


@pytest.mark.parametrize(
    ("v", "t"), [(100.0, 0.0), (125.0, 0.25), (150.0, 0.5), (175.0, 0.25), (350.0, -0.5), (25.0, -0.5)]
)
def test_the_difference_is_weighted_from_the_nearer_speed(v: float, t: float) -> None:
    where = prepared(rising()).at(v)
    assert where.held
    assert where.of_difference == t


def test_between_measured_speeds_the_two_terms_are_at_most_three_times_the_result() -> None:
    """Beside silence, half way, just three times: 1 and 1/2 make 1/2."""
    basis = prepared(np.outer([1.0, 0.0, 1.0, 2.0], np.ones(9)))
    for v in np.linspace(50.0, 300.0, 101):
        where = basis.at(v)
        assert where.held
        own, difference = basis.pairs[where.interval][where.nearer]
        terms = np.std(own) + where.of_difference * np.std(difference)
        assert terms <= 3 * np.std(where.waveform_m_s2) * (1 + 1e-12), v
    own, difference = basis.pairs[0][0]
    assert np.std(own) + np.std(difference) / 2 == pytest.approx(3 * np.std(basis.at(75.0).waveform_m_s2))


@pytest.mark.parametrize(("v", "sign"), [(75.0, 0), (np.nextafter(75.0, 100), 1), (150.0, 0), (151.0, 1), (299.0, 1)])
def test_a_tie_takes_the_signs_of_the_lower_speed(v: float, sign: int) -> None:
    where = prepared(rising()).at(v)
    assert where.held
    assert where.nearer == sign


def test_beyond_the_measured_speeds_the_sum_holds_until_the_first_bin_is_floored() -> None:
    """A bin from 3 at 200 to 2 at 300 mm/s is at zero at 500 mm/s; one from 2 at 100 to 1 at 50 is there at 0."""
    amplitudes = rising()
    amplitudes[:, 4] = [1.0, 1.0, 3.0, 2.0]
    basis = prepared(amplitudes)
    assert basis.highest_mm_s == pytest.approx(500.0, rel=1e-8)
    assert basis.highest_mm_s < 500.0
    assert basis.lowest_mm_s == pytest.approx(0.0, abs=1e-6)
    assert basis.at(499.9).floored_bins == 0
    assert basis.at(500.1).floored_bins == 1
    for v in (499.9, 500.1, 1.0, 0.0):
        expected = inverse_on(at_speed(basis.spectra, speed_mm_s=v).coefficients, basis.on)
        np.testing.assert_allclose(basis.at(v).waveform_m_s2, expected, rtol=0, atol=1e-12)


def test_a_bin_that_is_zero_at_the_last_speed_and_was_not_leaves_nothing_to_extrapolate() -> None:
    amplitudes = rising()
    amplitudes[3, 4] = 0.0
    basis = prepared(amplitudes)
    assert basis.highest_mm_s == 300.0
    assert basis.at(300.0).held
    assert not basis.at(float(np.nextafter(300.0, 400))).held


def test_bins_that_sound_in_no_waveform_do_not_end_the_weighted_sum() -> None:
    """Bin 0 and those at or above half of the output rate fall to zero at 310 mm/s, and are counted as floored."""
    amplitudes = np.concatenate([rising(), rising()], axis=1)
    for silent in (0, 13):
        amplitudes[:, silent] = [1.0, 1.0, 11.0, 1.0]
    spectra = CrinkleSpectra(np.array([50.0, 100.0, 200.0, 300.0]), 5000, amplitudes, np.ones(amplitudes.shape))
    basis = prepare(spectra, material="paper", output_rate_hz=2500)
    made = basis.at(350.0)
    assert made.held
    assert made.floored_bins == 2
    expected = inverse_on(made.spectrum.coefficients, basis.on)
    np.testing.assert_allclose(made.waveform_m_s2, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("levels", "end", "measured_mm_s"),
    [((1, 1.6e15, 1, 1), "lowest_mm_s", 36.0), ((1, 1, 1.6e15, 1), "highest_mm_s", 60.0)],
)
def test_where_bins_fall_to_zero_before_the_next_number_the_sum_ends_at_the_measured_speed(
    levels: tuple[float, ...], end: str, measured_mm_s: float
) -> None:
    """They do so 8 / 1.6e15 = 5.0e-15 mm/s beyond it, and numbers between 32 and 64 are 7.1e-15 apart."""
    speeds_mm_s = np.array([36.0, 44.0, 52.0, 60.0])
    spectra = CrinkleSpectra(speeds_mm_s, 5000, np.outer(levels, np.ones(9)), np.ones((4, 9)))
    basis = prepare(spectra, material="paper", output_rate_hz=48_000)
    assert getattr(basis, end) == measured_mm_s


def test_a_weighted_sum_over_a_floored_bin_would_be_wrong_by_that_bin() -> None:
    """Why the inverse DCT takes over: at 600 mm/s the bin of the test above would sound at -1 m/s^2."""
    amplitudes = rising()
    amplitudes[:, 4] = [1.0, 1.0, 3.0, 2.0]
    basis = prepared(amplitudes)
    own, difference = basis.pairs[2][1]
    summed = own - 3.0 * difference
    assert np.max(np.abs(summed - basis.at(600.0).waveform_m_s2)) == pytest.approx(1.0, rel=0.01)


def test_far_beyond_the_measured_speeds_cancellation_ends_the_weighted_sum() -> None:
    basis = prepared(rising())
    gaps = (basis.highest_mm_s - 300.0) / 100.0
    assert gaps * 3.0 + (1 + gaps) * 4.0 == pytest.approx(CANCELLATION * 4.0)
    assert not basis.at(1e4).held


def test_silence_has_nothing_to_weight_and_stays_silent() -> None:
    basis = prepared(np.zeros((4, 9)))
    assert not basis.at(0.0).waveform_m_s2.any()
    assert not basis.at(120.0).waveform_m_s2.any()


def test_shaped_waveforms_must_not_be_weighted_but_a_weighted_one_may_be_shaped() -> None:
    """Equation (7) where W saturates as a square root: from 2 to 3 m/s^2, W(2.5) is not the mean of W(2) and W(3)."""
    signs = np.ones((4, 9))
    right = inverse(np.full(9, np.sqrt(2.5)))
    before = prepare(CrinkleSpectra(SPEEDS, 5000, np.sqrt(rising()), signs), material="paper", output_rate_hz=5000)
    assert np.max(np.abs(before.at(150.0).waveform_m_s2 - right)) > 1e-3 * np.max(np.abs(right))
    after = prepare(CrinkleSpectra(SPEEDS, 5000, rising(), signs), material="paper", output_rate_hz=5000)
    asked = after.at(150.0).waveform_m_s2
    np.testing.assert_allclose(inverse(np.sqrt(np.maximum(spectrum(asked), 0.0))), right, rtol=0, atol=1e-12)
