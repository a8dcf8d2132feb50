"""Basis waveforms: where the weighted sum holds, where it must not, and what it makes of equation (7)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from experiment.synthesis.basis import CANCELLATION, Basis, BasisRenderer
from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.spectra import inverse, spectrum
from experiment.synthesis.waveforms import synthesise

SPEEDS = np.array([50.0, 100.0, 200.0, 300.0])


def of(amplitudes: NDArray[np.float64]) -> CrinkleSpectra:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], size=amplitudes.shape)
    return CrinkleSpectra(SPEEDS, 5000, amplitudes, signs)


def prepared(amplitudes: NDArray[np.float64]) -> BasisRenderer:
    return Basis().prepare(of(amplitudes), output_rate_hz=48_000)


def rising(bins: int = 9) -> NDArray[np.float64]:
    """Each bin at 1, 2, 3 and 4 m/s^2, so that none is floored above, and at v = 0 all are at exactly zero."""
    return np.outer([1.0, 2.0, 3.0, 4.0], np.ones(bins))


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("v", SPEEDS)
def test_a_measured_speed_is_its_own_basis_waveform_to_the_bit(v: float, single: bool) -> None:
    amplitudes = np.abs(np.random.default_rng(2).normal(size=(4, 9)))
    render = Basis(single=single).prepare(of(amplitudes), output_rate_hz=48_000)
    i = int(np.searchsorted(SPEEDS, v))
    own = render.pairs[i][0][0] if i < 3 else render.pairs[2][1][0]
    np.testing.assert_array_equal(render(v).waveform_m_s2, own.astype(np.float64) * render.scales[i])


@pytest.mark.parametrize(
    ("v", "t"), [(100.0, 0.0), (125.0, 0.25), (150.0, 0.5), (175.0, 0.25), (350.0, -0.5), (25.0, -0.5)]
)
def test_the_difference_is_weighted_from_the_nearer_speed(v: float, t: float) -> None:
    where = prepared(rising()).weight(v)
    assert where is not None
    assert where.of_difference == t


def test_between_measured_speeds_the_two_terms_are_at_most_three_times_the_result() -> None:
    """Beside silence, half way, just three times: 1 and 1/2 make 1/2."""
    render = prepared(np.outer([1.0, 0.0, 1.0, 2.0], np.ones(9)))
    for v in np.linspace(50.0, 300.0, 101):
        where = render.weight(v)
        assert where is not None
        own, difference = render.pairs[where.interval][where.nearer]
        terms = np.std(own) + where.of_difference * np.std(difference)
        assert terms <= 3 * np.std(render(v).waveform_m_s2) * (1 + 1e-12), v
    own, difference = render.pairs[0][0]
    assert np.std(own) + np.std(difference) / 2 == pytest.approx(3 * np.std(render(75.0).waveform_m_s2))


@pytest.mark.parametrize(("v", "sign"), [(75.0, 0), (np.nextafter(75.0, 100), 1), (150.0, 0), (151.0, 1), (299.0, 1)])
def test_a_tie_takes_the_signs_of_the_lower_speed(v: float, sign: int) -> None:
    where = prepared(rising()).weight(v)
    assert where is not None
    assert where.nearer == sign


def test_beyond_the_measured_speeds_the_sum_holds_until_the_first_bin_is_floored() -> None:
    """A bin from 3 at 200 to 2 at 300 mm/s is at zero at 500 mm/s; one from 2 at 100 to 1 at 50 is there at 0."""
    amplitudes = rising()
    amplitudes[:, 4] = [1.0, 1.0, 3.0, 2.0]
    render = prepared(amplitudes)
    assert render.highest_mm_s == pytest.approx(500.0, rel=1e-8)
    assert render.highest_mm_s < 500.0
    assert render.lowest_mm_s == pytest.approx(0.0, abs=1e-6)
    assert render(499.9).floored_bins == 0
    assert render(500.1).floored_bins == 1
    for v in (499.9, 500.1, 1.0, 0.0):
        expected = synthesise(render.spectra, speed_mm_s=v, output_rate_hz=48_000)
        np.testing.assert_allclose(render(v).waveform_m_s2, expected.waveform_m_s2, rtol=0, atol=1e-12)


def test_a_bin_that_is_zero_at_the_last_speed_and_was_not_leaves_nothing_to_extrapolate() -> None:
    amplitudes = rising()
    amplitudes[3, 4] = 0.0
    render = prepared(amplitudes)
    assert render.highest_mm_s == 300.0
    assert render.weight(300.0) is not None
    assert render.weight(np.nextafter(300.0, 400)) is None


@pytest.mark.parametrize(
    ("levels", "end", "measured_mm_s"),
    [((1, 1.6e15, 1, 1), "lowest_mm_s", 36.0), ((1, 1, 1.6e15, 1), "highest_mm_s", 60.0)],
)
def test_where_bins_fall_to_zero_before_the_next_number_the_sum_ends_at_the_measured_speed(
    levels: tuple[float, ...], end: str, measured_mm_s: float
) -> None:
    """They do so 8 / 1.6e15 = 5.0e-15 mm/s beyond it, and numbers between 32 and 64 are 7.1e-15 apart."""
    speeds_mm_s = np.array([36.0, 44.0, 52.0, 60.0])
    render = Basis().prepare(
        CrinkleSpectra(speeds_mm_s, 5000, np.outer(levels, np.ones(9)), np.ones((4, 9))), output_rate_hz=48_000
    )
    assert getattr(render, end) == measured_mm_s


def test_a_weighted_sum_over_a_floored_bin_would_be_wrong_by_that_bin() -> None:
    """Why the inverse DCT takes over: at 600 mm/s the bin of the test above would sound at -1 m/s^2."""
    amplitudes = rising()
    amplitudes[:, 4] = [1.0, 1.0, 3.0, 2.0]
    render = prepared(amplitudes)
    own, difference = render.pairs[2][1]
    summed = own - 3.0 * difference
    assert np.max(np.abs(summed - render(600.0).waveform_m_s2)) == pytest.approx(1.0, rel=0.01)


def test_far_beyond_the_measured_speeds_cancellation_ends_the_weighted_sum() -> None:
    render = prepared(rising())
    gaps = (render.highest_mm_s - 300.0) / 100.0
    assert gaps * 3.0 + (1 + gaps) * 4.0 == pytest.approx(CANCELLATION * 4.0)
    assert render.weight(1e4) is None


def test_silence_has_nothing_to_weight_and_stays_silent() -> None:
    render = prepared(np.zeros((4, 9)))
    assert not render(0.0).waveform_m_s2.any()
    assert not render(120.0).waveform_m_s2.any()


def test_pieces_have_the_bits_of_the_whole() -> None:
    for single in (False, True):
        amplitudes = np.abs(np.random.default_rng(3).normal(size=(4, 250)))
        render = Basis(single=single).prepare(of(amplitudes), output_rate_hz=48_000)
        where = render.weight(130.0)
        assert where is not None
        pieces = [render.weighted(where, slice(a, b)) for a, b in ((0, 64), (64, 1001), (1001, None))]
        np.testing.assert_array_equal(np.concatenate(pieces), render.weighted(where))


def test_shaped_waveforms_must_not_be_weighted_but_a_weighted_one_may_be_shaped() -> None:
    """Equation (7) where W saturates as a square root: from 2 to 3 m/s^2, W(2.5) is not the mean of W(2) and W(3)."""
    signs = np.ones((4, 9))
    right = inverse(np.full(9, np.sqrt(2.5)))
    before = Basis().prepare(CrinkleSpectra(SPEEDS, 5000, np.sqrt(rising()), signs), output_rate_hz=5000)
    assert np.max(np.abs(before(150.0).waveform_m_s2 - right)) > 1e-3 * np.max(np.abs(right))
    asked = Basis().prepare(CrinkleSpectra(SPEEDS, 5000, rising(), signs), output_rate_hz=5000)(150.0).waveform_m_s2
    np.testing.assert_allclose(inverse(np.sqrt(np.maximum(spectrum(asked), 0.0))), right, rtol=0, atol=1e-12)
