"""Equations (2) to (4) against naive transcriptions of the printed forms, then limits, floors and extremes."""

from __future__ import annotations

from math import cos, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.crinkle import Average, CrinkleSpectra, at_speed, subtract
from tests.approved import Refuses
from tests.experiment.synthesis.stimuli import waveform

SPEEDS = [50.0, 100.0, 200.0, 300.0]
BETWEEN = [50.1, 75.0, 99.0, 130.0, 150.0, 151.0, 250.0, 299.9]
BEYOND = [0.0, 1e-300, 10.0, 49.9, 300.1, 400.0, 1000.0]

Takes = NDArray[np.float64]


def takes(seed: int, *, n: int = 12, object_level: float = 2.0) -> tuple[Takes, Takes]:
    """Three takes with and two without the object at each speed."""
    rng = np.random.default_rng(seed)
    return object_level * rng.normal(size=(4, 3, n)), rng.normal(size=(4, 2, n))


def spectra_of(seed: int, *, n: int = 12, average: Average = "magnitude") -> CrinkleSpectra:
    both, bare = takes(seed, n=n)
    return subtract(speeds_mm_s=SPEEDS, rate_hz=5000, panel_object_takes=both, panel_takes=bare, average=average)


def naive_c(y: NDArray[np.float64]) -> list[float]:
    n = len(y)
    return [2 / n * sum(y[i] * cos(pi * k * (i + 0.5) / n) for i in range(n)) for k in range(n)]


def naive_equation_2(both: Takes, bare: Takes, average: Average) -> tuple[list[list[float]], list[list[float]]]:
    """C' and sign at each speed and bin, one at a time."""
    amplitudes, signs = [], []
    for speed in range(len(both)):
        with_object = [naive_c(y) for y in both[speed]]
        panel = [naive_c(y) for y in bare[speed]]
        row, row_signs = [], []
        for k in range(both.shape[2]):
            mine, theirs = [c[k] for c in with_object], [c[k] for c in panel]
            if average == "magnitude":
                difference = sum(map(abs, mine)) / len(mine) - sum(map(abs, theirs)) / len(theirs)
                sign = mine[0]
            else:
                difference = abs(sum(mine) / len(mine)) - abs(sum(theirs) / len(theirs))
                sign = sum(mine)
            row.append(difference if difference > 0 else 0.0)
            row_signs.append(1.0 if sign >= 0 else -1.0)
        amplitudes.append(row)
        signs.append(row_signs)
    return amplitudes, signs


def naive_equation_3(s: CrinkleSpectra, v: float, *, literal: bool) -> tuple[list[float], int]:
    """C'_k(v) bin by bin, and how many were floored."""
    speeds = list(s.speeds_mm_s)
    i = 0 if v < speeds[0] else max(n for n in range(len(speeds) - 1) if speeds[n] <= v)
    j = i if v - speeds[i] <= speeds[i + 1] - v else i + 1
    out, floored = [], 0
    for k in range(s.amplitudes.shape[1]):
        rise = s.amplitudes[i + 1][k] - s.amplitudes[i][k]
        value = (abs(rise) if literal else rise) / (speeds[i + 1] - speeds[i]) * (v - speeds[i]) + s.amplitudes[i][k]
        floored += value < 0
        out.append(max(value, 0.0) * s.signs[j][k])
    return out, floored


@pytest.mark.parametrize("average", ["magnitude", "signed"])
@pytest.mark.parametrize("n", [1, 2, 7, 12])
def test_subtraction_is_equation_2(average: Average, n: int) -> None:
    both, bare = takes(n, n=n)
    amplitudes, signs = naive_equation_2(both, bare, average)
    made = spectra_of(n, n=n, average=average)
    np.testing.assert_allclose(made.amplitudes, amplitudes, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(made.signs, signs)


@pytest.mark.parametrize("literal", [False, True])
@pytest.mark.parametrize("v", BETWEEN + BEYOND)
def test_any_speed_is_equations_3_and_4(v: float, literal: bool) -> None:
    s = spectra_of(1)
    expected, floored = naive_equation_3(s, v, literal=literal)
    made = at_speed(s, speed_mm_s=v, literal=literal)
    np.testing.assert_allclose(made.coefficients, expected, rtol=1e-12, atol=1e-12)
    assert made.floored_bins == floored
    assert made.extrapolated == (v in BEYOND)


@pytest.mark.parametrize("literal", [False, True])
@pytest.mark.parametrize("i", range(4))
def test_measured_speeds_come_back_exactly(i: int, literal: bool) -> None:
    s = spectra_of(2)
    made = at_speed(s, speed_mm_s=SPEEDS[i], literal=literal)
    np.testing.assert_array_equal(made.coefficients, s.amplitudes[i] * s.signs[i])
    assert (made.floored_bins, made.extrapolated) == (0, False)


@pytest.mark.parametrize("v", SPEEDS)
def test_magnitudes_are_continuous_at_measured_speeds(v: float) -> None:
    s = spectra_of(3)
    below, here, above = (np.abs(at_speed(s, speed_mm_s=v + d).coefficients) for d in (-1e-9, 0.0, 1e-9))
    np.testing.assert_allclose(below, here, rtol=0, atol=1e-9)
    np.testing.assert_allclose(above, here, rtol=0, atol=1e-9)


def test_the_printed_form_misses_its_own_measurement_where_a_bin_falls() -> None:
    """The erratum: falling from 4 at 100 to 1 at 200 mm/s, the printed form rises to 7."""
    amplitudes = np.array([[0.0, 4.0], [0.0, 4.0], [0.0, 1.0], [0.0, 1.0]])
    s = CrinkleSpectra(np.array(SPEEDS), 5000, amplitudes, np.ones((4, 2)))
    assert at_speed(s, speed_mm_s=150.0).coefficients[1] == 2.5
    assert at_speed(s, speed_mm_s=150.0, literal=True).coefficients[1] == 5.5
    assert at_speed(s, speed_mm_s=200 - 1e-9, literal=True).coefficients[1] == pytest.approx(7.0)


@pytest.mark.parametrize(("v", "sign"), [(75.0, 1.0), (75.0001, -1.0), (20.0, 1.0), (1000.0, -1.0)])
def test_the_sign_is_that_of_the_nearer_speed_and_of_the_lower_on_a_tie(v: float, sign: float) -> None:
    signs = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0], [-1.0, -1.0]])
    s = CrinkleSpectra(np.array(SPEEDS), 5000, np.ones((4, 2)), signs)
    assert at_speed(s, speed_mm_s=v).coefficients.tolist() == [sign, sign]


def test_extrapolation_below_zero_is_floored_and_counted() -> None:
    """Rising by 1 per 50 mm/s from 0.5 at 50 mm/s: below zero at v = 0; the flat bin stays."""
    amplitudes = np.array([[0.5, 3.0], [1.5, 3.0], [1.5, 3.0], [1.5, 3.0]])
    s = CrinkleSpectra(np.array(SPEEDS), 5000, amplitudes, np.ones((4, 2)))
    made = at_speed(s, speed_mm_s=0.0)
    assert made.coefficients.tolist() == [0.0, 3.0]
    assert (made.floored_bins, made.extrapolated) == (1, True)


def test_a_panel_that_is_louder_everywhere_leaves_silence() -> None:
    both, bare = takes(4, object_level=1e-6)
    s = subtract(speeds_mm_s=SPEEDS, rate_hz=5000, panel_object_takes=both, panel_takes=bare)
    made = waveform(s, speed_mm_s=120.0, output_rate_hz=48_000)
    assert not s.amplitudes.any()
    assert not made.any()


def test_takes_of_nothing_make_silence() -> None:
    nothing = np.zeros((4, 3, 5))
    s = subtract(speeds_mm_s=SPEEDS, rate_hz=5000, panel_object_takes=nothing, panel_takes=nothing)
    assert not waveform(s, speed_mm_s=400.0, output_rate_hz=5000).any()


def test_signed_averaging_of_incoherent_takes_loses_about_sqrt_3() -> None:
    """Gaussian coefficients: E|mean of 3| / mean of E|c| is exactly 1 / sqrt 3."""
    both = np.random.default_rng(6).normal(size=(2, 3, 4000))
    loud = {
        average: subtract(
            speeds_mm_s=[1.0, 2.0],
            rate_hz=5000,
            panel_object_takes=both,
            panel_takes=np.zeros((2, 1, 4000)),
            average=average,
        ).amplitudes.mean()
        for average in ("magnitude", "signed")
    }
    assert loud["magnitude"] / loud["signed"] == pytest.approx(np.sqrt(3), rel=0.03)


@given(v=st.floats(0, 1e6), seed=st.integers(0, 20), literal=st.booleans())
def test_every_speed_gives_finite_magnitudes_and_known_signs(v: float, seed: int, literal: bool) -> None:
    s = spectra_of(seed)
    made = at_speed(s, speed_mm_s=v, literal=literal)
    assert np.all(np.isfinite(made.coefficients))
    assert np.all(np.isin(np.sign(made.coefficients), [-1.0, 0.0, 1.0]))
    assert made.floored_bins <= np.count_nonzero(made.coefficients == 0)


@pytest.mark.parametrize("v", [-1.0, np.nan, np.inf, 1e308])
def test_impossible_speeds_are_refused(v: float) -> None:
    s = CrinkleSpectra(np.array([1.0, 1.5]), 5000, np.array([[0.0, 0.0], [0.0, 9.0]]), np.ones((2, 2)))
    with pytest.raises(SynthesisError, match="speed_mm_s: got"):
        at_speed(s, speed_mm_s=v)


@pytest.mark.parametrize("speeds", [[50.0], [50.0, 50.0], [100.0, 50.0], [np.nan, 50.0], []])
def test_speeds_that_do_not_rise_are_refused(speeds: list[float]) -> None:
    some = np.ones((max(len(speeds), 1), 1, 4))
    with pytest.raises(SynthesisError, match="speeds_mm_s"):
        subtract(speeds_mm_s=speeds, rate_hz=5000, panel_object_takes=some, panel_takes=some)


@pytest.mark.parametrize(
    ("both", "bare"), [((2, 3, 8), (2, 3, 9)), ((3, 3, 8), (3, 3, 8)), ((2, 3, 8), (1, 3, 8)), ((2, 8), (2, 8))]
)
def test_takes_that_do_not_fit_are_refused(both: tuple[int, ...], bare: tuple[int, ...]) -> None:
    with pytest.raises(SynthesisError, match="takes: got shapes"):
        subtract(speeds_mm_s=[50.0, 100.0], rate_hz=5000, panel_object_takes=np.ones(both), panel_takes=np.ones(bare))


def test_takes_that_are_not_finite_are_refused(refuses: Refuses) -> None:
    both, bare = takes(7)
    both[1, 1, 1] = np.nan
    with refuses(SynthesisError):
        subtract(speeds_mm_s=SPEEDS, rate_hz=5000, panel_object_takes=both, panel_takes=bare)
