"""Equations (1), (5) and (6) against naive transcriptions of the printed sums, then limits and invariants."""

from __future__ import annotations

from math import cos, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.signals.dissimilarity import dissimilarity, dissimilarity_matrix
from palpate.experiment.synthesis.spectra import BAND_HZ, bin_frequencies_hz, grid, highest, inverse, spectrum
from tests.approved import Refuses
from tests.experiment.synthesis.resampled import resampled

LENGTHS = [1, 2, 3, 7, 16, 25]
ACCELERATIONS = arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e3, 1e3))


def equation_1(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """C_k = (2/N) sum_i y_i cos(pi k (i + 1/2) / N), as printed."""
    n = len(y)
    return np.array([2 / n * sum(y[i] * cos(pi * k * (i + 0.5) / n) for i in range(n)) for k in range(n)])


def equation_5(c: NDArray[np.float64]) -> NDArray[np.float64]:
    """y'_i = sum_{k=1}^{N-1} C'_k cos(pi k (i + 1/2) / N), as printed."""
    n = len(c)
    return np.array([sum(c[k] * cos(pi * k * (i + 0.5) / n) for k in range(1, n)) for i in range(n)])


def equation_5_at(c: NDArray[np.float64], rate_hz: int, output_rate_hz: int) -> NDArray[np.float64]:
    """The same sum at t = (i' + 1/2) / F' while t < N / F, over the bins below F' / 2."""
    n = len(c)
    frequencies = [rate_hz * k / (2 * n) for k in range(n)]
    out: list[float] = []
    while (t := (len(out) + 0.5) / output_rate_hz) < n / rate_hz:
        terms = (c[k] * cos(2 * pi * f * t) for k, f in enumerate(frequencies) if k >= 1 and f < output_rate_hz / 2)
        out.append(sum(terms))
    return np.array(out)


@pytest.mark.parametrize("n", LENGTHS)
def test_spectrum_is_the_printed_sum(n: int) -> None:
    y = np.random.default_rng(n).normal(size=n)
    np.testing.assert_allclose(spectrum(y), equation_1(y), rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", LENGTHS)
def test_inverse_is_the_printed_sum(n: int) -> None:
    c = np.random.default_rng(n).normal(size=n)
    np.testing.assert_allclose(inverse(c), equation_5(c), rtol=0, atol=1e-12)


def test_spectrum_works_along_the_last_axis() -> None:
    takes = np.random.default_rng(1).normal(size=(2, 3, 10))
    together = spectrum(takes)
    assert together.shape == takes.shape
    np.testing.assert_allclose(together[1, 2], equation_1(takes[1, 2]), rtol=0, atol=1e-12)


def test_round_trip_loses_only_the_mean() -> None:
    y = np.random.default_rng(2).normal(size=2500)
    np.testing.assert_allclose(inverse(spectrum(y)), y - y.mean(), rtol=0, atol=1e-13)


@given(ACCELERATIONS)
def test_round_trip_of_anything_loses_only_the_mean(y: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(inverse(spectrum(y)), y - y.mean(), rtol=0, atol=1e-13 * max(1.0, np.abs(y).max()))


@given(ACCELERATIONS)
def test_parseval(y: NDArray[np.float64]) -> None:
    """sum y^2 = N (C_0^2 / 4 + sum_{k>=1} C_k^2 / 2), from the orthogonality of the DCT-II basis."""
    c = spectrum(y)
    energy = len(y) * (c[0] ** 2 / 4 + (c[1:] ** 2).sum() / 2)
    assert energy == pytest.approx((y**2).sum(), rel=1e-12, abs=1e-9)


def test_a_cosine_stands_at_its_frequency() -> None:
    """The erratum: 100 Hz at F = 5000 Hz and N = 2500 is bin 100, where the printed F k / N would make it bin 50."""
    times_s = (np.arange(2500) + 0.5) / 5000
    c = spectrum(3.0 * np.cos(2 * pi * 100 * times_s))
    frequencies_hz = bin_frequencies_hz(bins=2500, rate_hz=5000)
    assert frequencies_hz[int(np.argmax(np.abs(c)))] == 100.0
    assert c[100] == pytest.approx(3.0, abs=1e-12)
    assert frequencies_hz[1] == 1.0


@pytest.mark.parametrize(
    ("n", "rate_hz", "output_rate_hz"),
    [(10, 5000, 5000), (10, 5000, 48_000), (10, 5000, 44_100), (11, 5000, 44_101), (10, 5000, 2000), (11, 5000, 3001)],
)
def test_any_output_rate_is_the_same_sum_at_its_own_times(n: int, rate_hz: int, output_rate_hz: int) -> None:
    c = np.random.default_rng(n).normal(size=n)
    made = resampled(c, rate_hz=rate_hz, output_rate_hz=output_rate_hz)
    np.testing.assert_allclose(made, equation_5_at(c, rate_hz, output_rate_hz), rtol=0, atol=1e-12)


def test_its_own_rate_is_the_plain_inverse_and_drops_nothing() -> None:
    c = np.random.default_rng(3).normal(size=2500)
    made = resampled(c, rate_hz=5000, output_rate_hz=5000)
    np.testing.assert_allclose(made, inverse(c), rtol=0, atol=1e-13)


def test_a_higher_rate_keeps_the_spectrum_and_adds_nothing_above() -> None:
    c = np.random.default_rng(4).normal(size=2500)
    made = resampled(c, rate_hz=5000, output_rate_hz=48_000)
    again = spectrum(made)
    assert made.shape == (24_000,)
    np.testing.assert_allclose(again[1:2500], c[1:], rtol=0, atol=1e-12)
    assert np.abs(again[2500:]).max() < 1e-12


def test_a_lower_rate_drops_and_counts_the_bins_it_cannot_carry() -> None:
    c = np.ones(2500)
    made = resampled(c, rate_hz=5000, output_rate_hz=1000)
    assert made.shape == (500,)
    assert grid(samples=2500, bins=2500, rate_hz=5000, output_rate_hz=1000).carried == 2500 - 2000
    np.testing.assert_allclose(spectrum(made)[1:], c[1:500], rtol=0, atol=1e-12)


def test_one_bin_is_silence() -> None:
    assert resampled([5.0], rate_hz=5000, output_rate_hz=48_000).tolist() == [0.0] * 10


def peak_on_a_fine_grid(c: NDArray[np.float64]) -> float:
    """Largest magnitude of the sum of (5) at 64 times for each bin, both ends of the recording among them.

    Between two of them the sum, a polynomial of degree K - 1 in cos(pi t F / N), rises by less than 0.031 % more.
    """
    angles = pi * np.arange(64 * c.size + 1) / (64 * c.size)
    return float(np.abs(np.cos(np.outer(angles, np.arange(1, c.size))) @ c[1:]).max())


def assert_just_above(bound_m_s2: float, c: NDArray[np.float64]) -> None:
    peak_m_s2, round_off = peak_on_a_fine_grid(c), 1e-14 * float(np.abs(c).sum())
    assert peak_m_s2 - round_off <= bound_m_s2 <= 1.013 * peak_m_s2 + round_off


@given(
    arrays(np.float64, st.integers(1, 40), elements=st.floats(-1, 1)),
    st.one_of(st.integers(-300, 300), st.sampled_from([-300, 0, 300])),
)
def test_no_magnitude_passes_the_highest_which_is_at_most_a_little_more(c: NDArray[np.float64], power: int) -> None:
    c = c * 10.0**power
    assert_just_above(highest(c), c)


@pytest.mark.parametrize("bins", [2, 3, 7, 16, 40, 81])
@pytest.mark.parametrize("amplitude", [1e-300, 1.0, 1e300])
def test_the_highest_of_spectra_whose_peak_is_known(bins: int, amplitude: float) -> None:
    """Equal bins meet at the start, alternating ones at the end; a single one peaks at its amplitude."""
    equal = np.full(bins, amplitude)
    for c in (equal, -equal, equal * (-1.0) ** np.arange(bins)):
        assert (bins - 1) * amplitude * (1 - 1e-14) <= highest(c) <= 1.013 * (bins - 1) * amplitude
    for k in range(1, bins):
        single = np.zeros(bins)
        single[k] = -amplitude
        assert amplitude * (1 - 1e-14) <= highest(single) <= 1.013 * amplitude


@pytest.mark.parametrize("bins", [1, 2, 31, 200])
def test_the_highest_of_random_spectra(bins: int) -> None:
    rng = np.random.default_rng(bins)
    for c in rng.normal(size=(5, bins)):
        assert_just_above(highest(c), c)


@pytest.mark.parametrize("mean", [0.0, 5.0, -1e300])
def test_the_mean_is_not_part_of_the_highest(mean: float) -> None:
    assert highest([mean]) == 0.0
    assert highest([mean, -3.0]) == pytest.approx(3.0, rel=1e-14)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_there_is_no_highest_of_what_is_no_number_or_overflows(bad: float, refuses: Refuses) -> None:
    with refuses(SynthesisError):
        highest([0.0, 1.0, bad])
    with pytest.raises(SynthesisError, match="their sum overflows"):
        highest([0.0, *[1.7e308] * 40])


def test_dissimilarity_is_the_printed_sum_over_0_to_500_hz() -> None:
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 2500))
    printed = sum(abs(abs(a[f]) - abs(b[f])) for f in range(501))
    f = bin_frequencies_hz(bins=2500, rate_hz=5000)
    assert BAND_HZ == (0.0, 500.0)
    assert float(dissimilarity(a, b, frequencies_hz=f)) == pytest.approx(printed, rel=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_dissimilarity_is_a_distance_blind_to_sign(seed: int) -> None:
    a, b, c = np.random.default_rng(seed).normal(size=(3, 60))
    f = bin_frequencies_hz(bins=60, rate_hz=1000)
    ab, bc, ac = (float(dissimilarity(x, y, frequencies_hz=f)) for x, y in ((a, b), (b, c), (a, c)))
    assert ab == float(dissimilarity(-b, a, frequencies_hz=f))
    assert float(dissimilarity(a, -a, frequencies_hz=f)) == 0.0
    assert ac <= ab + bc + 1e-12


def test_matrix_has_the_form_of_table_3() -> None:
    """Levels 1, 3 and 6 over equal bins: differences 2, 5 and 3, the highest of which becomes 1."""
    f = bin_frequencies_hz(bins=10, rate_hz=100)
    matrix = dissimilarity_matrix(np.outer([1.0, 3.0, 6.0], np.ones(10)), frequencies_hz=f)
    np.testing.assert_allclose(matrix, [[0, 0.4, 1], [0.4, 0, 0.6], [1, 0.6, 0]], rtol=0, atol=1e-15)


def test_matrix_of_equal_spectra_is_zero() -> None:
    assert not dissimilarity_matrix(np.ones((3, 4)), frequencies_hz=np.arange(4.0)).any()


@pytest.mark.parametrize("bad", [[np.nan, 1.0], [np.inf, 1.0], []])
def test_values_that_are_no_spectrum_are_refused(bad: list[float]) -> None:
    for kernel in (spectrum, inverse, highest):
        with pytest.raises(SynthesisError, match="allowed"):
            kernel(bad)
    with pytest.raises(SynthesisError, match="allowed"):
        resampled(bad, rate_hz=5000, output_rate_hz=48_000)
    with pytest.raises(SynthesisError, match="allowed"):
        dissimilarity(bad, bad, frequencies_hz=[0.0, 1.0])


@pytest.mark.parametrize(
    ("rate_hz", "output_rate_hz", "message"),
    [(0, 48_000, "rate_hz: got 0"), (5000, -1, "output_rate_hz: got -1"), (5000, 1, "at least one sample")],
)
def test_impossible_rates_are_refused(rate_hz: int, output_rate_hz: int, message: str) -> None:
    with pytest.raises(SynthesisError, match=message):
        resampled(np.ones(10), rate_hz=rate_hz, output_rate_hz=output_rate_hz)


def test_rates_in_an_absurd_ratio_are_refused_before_memory_is_taken() -> None:
    with pytest.raises(SynthesisError, match="use a rounder rate"):
        resampled(np.ones(99_991), rate_hz=99_989, output_rate_hz=191_999)


def test_spectra_of_unequal_length_are_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        dissimilarity(np.ones(3), np.ones(4), frequencies_hz=np.arange(4.0))
