"""The error budget: shares by hand, curves of which lines miss a known part, and the panel's own closed form."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.rehearsal.wires.panel import FREQUENCIES_HZ, LEVELS_VRMS, answered
from palpate.experiment.synthesis import budget, tap
from palpate.experiment.synthesis.budget import Budget, of_accelerations, of_voltages
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, leave_out
from palpate.experiment.synthesis.shaping import Response, drive
from palpate.experiment.synthesis.waveforms import Stimulus, prepare
from tests.experiment.synthesis.stimuli import given, of_bins

FLAT = Response(np.array([10.0, 600.0]), np.array([1.0, 10.0]), np.array([[2.0, 20.0], [2.0, 20.0]]))
"""2 m/s^2 for each volt from 10 to 600 Hz, up to 10 V."""


def bins(**at: float) -> Stimulus:
    """Bins at frequencies such as f100, Hz, of 2,500 samples at 5 kHz: one a hertz."""
    coefficients = np.zeros(2500)
    for name, amplitude in at.items():
        coefficients[int(name.removeprefix("f"))] = amplitude
    return of_bins(coefficients, samples=2500, rate_hz=5000)


def in_volts(stimulus: Stimulus, response: Response = FLAT, *, gain: float = 1e9, **limits: float) -> Budget:
    rate_hz = stimulus.basis.output_rate_hz
    volts, shaped = drive(stimulus.bins, rate_hz=rate_hz, response=response, gain_limit_v_per_m_s2=gain, **limits)
    return of_voltages(stimulus, handed_v=volts, voltages_v=volts, shaped=shaped, response=response)


def test_what_an_actuator_is_handed_as_asked_differs_by_its_rounding() -> None:
    stimulus = bins(f100=0.3, f2000=0.1)
    exact = stimulus.waveform_m_s2
    handed = exact.astype(np.float32).astype(np.float64)
    found = of_accelerations(stimulus, handed_m_s2=handed, limited=0)
    # By Parseval the rms is that of the two cosines.
    assert found.asked_m_s2 == pytest.approx(sqrt((0.3**2 + 0.1**2) / 2))
    assert found.rounding == pytest.approx(np.sqrt(np.mean((handed - exact) ** 2)) / found.asked_m_s2)
    assert 0 < found.rounding < 2**-24
    assert (found.total, found.left_out, found.dissimilarity_m_s2) == (found.rounding, 0.0, 0.0)


@pytest.mark.parametrize("low_hz", [0.0, 30.0])
def test_what_a_device_does_not_carry_of_a_tap_is_its_share_of_the_sum_of_squares(low_hz: float) -> None:
    """By Parseval, with the cosines of (1) summed one by one; at 0 Hz stands the mean."""
    rate_hz, high_hz = 8000, 400.0
    ring = tap.rings(tap.SURFACES[1], rate_hz=rate_hz, aluminum_m_s2=40.0).at(0.2)
    n = ring.waveform_m_s2.size
    i, k = np.arange(n) + 0.5, np.arange(n)
    squares = (2 / n * np.cos(pi * np.outer(k, i) / n) @ ring.waveform_m_s2) ** 2 / 2
    squares[0] /= 2
    f = rate_hz * k / (2 * n)
    missing = (f < low_hz) | (f > high_hz)
    found = of_accelerations(ring, handed_m_s2=ring.waveform_m_s2, limited=0, carries_hz=(low_hz, high_hz))
    assert found.asked_m_s2 == pytest.approx(sqrt(np.mean(ring.waveform_m_s2**2)))
    assert found.left_out == pytest.approx(sqrt(squares[missing].sum() / squares.sum()))
    assert found.below == pytest.approx(sqrt(squares[f < low_hz].sum() / squares.sum()), abs=1e-12)
    assert found.rounding < 1e-12
    # Of a flat response only the mean is missing below, at whatever frequency the table begins.
    flat = Response(np.array([low_hz, high_hz]), np.array([1.0, 10.0]), np.array([[2.0, 20.0], [2.0, 20.0]]))
    volts, shaped = drive(ring.bins, rate_hz=rate_hz, response=flat, gain_limit_v_per_m_s2=1e9)
    found = of_voltages(ring, handed_v=volts, voltages_v=volts, shaped=shaped, response=flat)
    assert found.left_out == pytest.approx(sqrt(squares[missing | (k == 0)].sum() / squares.sum()))


def test_a_rate_that_cannot_carry_bins_leaves_out_their_share() -> None:
    coefficients = np.zeros(2500)
    coefficients[[0, 300, 400, 1200]] = 9.0, 3.0, -4.0, 12.0
    spectra = CrinkleSpectra(
        np.array([100.0, 200.0]), 5000, np.abs([coefficients] * 2), np.where([coefficients] * 2, 1.0, 1.0)
    )
    for rate_hz, share, missing in ((2000, 12 / 13, 0.0), (700, sqrt(160) / 13, 4.0), (5000, 0.0, 0.0)):
        stimulus = prepare(spectra, material="any", output_rate_hz=rate_hz).at(100.0)
        found = of_accelerations(stimulus, handed_m_s2=stimulus.waveform_m_s2, limited=0)
        # Bin 0 sounds in no stimulus.
        assert found.asked_m_s2 == pytest.approx(13 / sqrt(2))
        assert found.rate == pytest.approx(share)
        assert found.total == found.rate
        # Equation (6) sums to 500 Hz.
        assert found.dissimilarity_m_s2 == pytest.approx(missing)


@pytest.mark.parametrize("speed_mm_s", [100.0, 130.0, 160.0, 200.0])
def test_what_the_scene_left_out_is_still_known(speed_mm_s: float) -> None:
    rng = np.random.default_rng(3)
    spectra = CrinkleSpectra(np.array([100.0, 200.0]), 5000, rng.random((2, 50)), rng.choice([-1.0, 1.0], (2, 50)))
    whole = prepare(spectra, material="any", output_rate_hz=5000).at(speed_mm_s)
    held = prepare(leave_out(spectra, band_hz=(120.0, 1000.0)), material="any", output_rate_hz=5000).at(speed_mm_s)
    found = of_accelerations(held, handed_m_s2=held.waveform_m_s2, limited=0)
    missing = whole.waveform_m_s2 - held.waveform_m_s2
    rms = np.sqrt(np.mean(whole.waveform_m_s2**2))
    assert found.scene == pytest.approx(np.sqrt(np.mean(missing**2)) / rms)
    assert found.asked_m_s2 == pytest.approx(rms)
    assert found.total == found.scene
    # Bins stand 50 Hz apart: those at 50 and 100 Hz are left out below 500 Hz.
    assert found.dissimilarity_m_s2 == pytest.approx(np.abs(whole.spectrum.coefficients[1:3]).sum())


def test_the_limiter_takes_what_it_cuts_off() -> None:
    stimulus = bins(f100=3.0, f150=-4.0)
    handed = np.clip(stimulus.waveform_m_s2, -2.0, 2.0)
    found = of_accelerations(stimulus, handed_m_s2=handed, limited=5)
    cut = handed - stimulus.waveform_m_s2
    assert found.taken_down == pytest.approx(np.sqrt(np.mean(cut**2)) / (5 / sqrt(2)))
    assert (found.rounding, found.total) == (0.0, found.taken_down)
    # The naive sum of equation (1), bin by bin up to 500 Hz.
    i = np.arange(2500)
    c = np.array([2 / 2500 * np.sum(handed * np.cos(pi * k * (i + 0.5) / 2500)) for k in range(1, 501)])
    wanted = np.abs(stimulus.bins.coefficients[1:501])
    assert found.dissimilarity_m_s2 == pytest.approx(np.abs(np.abs(c) - wanted).sum(), rel=1e-9)


def test_each_bin_counts_once_under_what_kept_it() -> None:
    """5 Hz and 700 Hz lie outside of the table; 21 m/s^2 at 400 Hz are above the highest level, which reaches 20."""
    found = in_volts(bins(f5=1.0, f100=2.0, f400=21.0, f700=3.0))
    whole = sqrt(1 + 4 + 441 + 9)
    assert [found.below, found.above] == pytest.approx([1 / whole, 3 / whole])
    assert found.held_back == pytest.approx(1 / whole)
    assert (found.rate, found.scene, found.taken_down) == (0.0, 0.0, 0.0)
    assert found.table < 1e-15
    assert found.left_out == pytest.approx(sqrt(11) / whole)
    assert found.total == pytest.approx(sqrt(11) / whole)
    assert found.dissimilarity_m_s2 == pytest.approx(1 + 1)


def test_a_dead_band_within_the_table_is_left_out() -> None:
    """The panel answers 100 times less between 290 and 310 Hz, and the gain limit is 1 V for each m/s^2."""
    at_2 = np.array([[2.0, 20.0]])
    dead = Response(
        np.array([10.0, 280.0, 290.0, 310.0, 320.0, 600.0]),
        np.array([1.0, 10.0]),
        np.concatenate([at_2, at_2, at_2 / 100, at_2 / 100, at_2, at_2]),
    )
    found = in_volts(bins(f100=3.0, f300=4.0), dead, gain=1.0)
    # 4 V bring about 0.08 m/s^2 of the 4 that were asked for.
    assert found.left_out == found.held_back == pytest.approx(3.92 / 5)


def test_a_device_in_accelerations_leaves_out_what_it_is_said_not_to_carry() -> None:
    stimulus = bins(f5=1.0, f100=2.0, f700=3.0)
    handed = stimulus.waveform_m_s2
    found = of_accelerations(stimulus, handed_m_s2=handed, limited=0, carries_hz=(10.0, 600.0))
    whole = sqrt(1 + 4 + 9)
    assert [found.below, found.above] == pytest.approx([1 / whole, 3 / whole])
    assert found.left_out == pytest.approx(sqrt(10) / whole)
    # Equation (6) sums to 500 Hz.
    assert found.dissimilarity_m_s2 == pytest.approx(1)
    assert of_accelerations(stimulus, handed_m_s2=handed, limited=0).left_out == 0.0


@pytest.mark.parametrize("most_m_s2", [4.0, 1.0, 0.1, 0.0])
def test_what_a_device_does_not_carry_is_left_out_however_much_its_limiter_takes(most_m_s2: float) -> None:
    stimulus = bins(f5=1.0, f100=2.0, f700=3.0)
    handed = np.clip(stimulus.waveform_m_s2, -most_m_s2, most_m_s2)
    found = of_accelerations(stimulus, handed_m_s2=handed, limited=5, carries_hz=(10.0, 600.0))
    assert found.left_out == pytest.approx(sqrt(10 / 14))
    # The truth: only 10 to 600 Hz of what was handed over move the panel. What is cut off at 0 Hz counts all the same.
    i = np.arange(2500)
    at = {f: np.cos(pi * f * (i + 0.5) / 2500) for f in (*range(0, 10), *range(601, 2500))}
    felt = handed - sum(np.where(f, 2, 1) / 2500 * np.sum(handed * wave) * wave for f, wave in at.items())
    missed = stimulus.waveform_m_s2 - felt
    assert found.total == pytest.approx(np.sqrt(np.mean(missed**2)) / sqrt(14 / 2), rel=0.02)


def test_what_the_limits_take_down_as_a_whole_is_told_apart_from_what_a_bin_lacks() -> None:
    """A limit of 5 m/s^2 for a peak of 10; the gain limit gives the bin at 300 Hz half of its volts."""
    found = in_volts(bins(f100=10.0), limit_m_s2=5.0)
    assert found.taken_down == pytest.approx(0.5, rel=0.02)
    assert (found.held_back, found.total) == (0.0, found.taken_down)
    bounded = in_volts(bins(f300=10.0), gain=0.25)
    assert bounded.held_back == pytest.approx(0.5)
    assert bounded.taken_down == 0.0


def test_voltages_that_are_not_those_of_shaping_are_found_in_the_samples() -> None:
    stimulus = bins(f100=2.0)
    volts, shaped = drive(stimulus.bins, rate_hz=5000, response=FLAT, gain_limit_v_per_m_s2=1e9)
    found = of_voltages(stimulus, handed_v=1.01 * volts, voltages_v=volts, shaped=shaped, response=FLAT)
    assert found.rounding == pytest.approx(0.01)


def test_silence_asks_for_nothing_and_misses_nothing() -> None:
    assert of_accelerations(given([0.0]), handed_m_s2=np.zeros(1), limited=0).total == 0.0
    assert in_volts(bins()).total == 0.0


def table(a: NDArray[np.float64], f: NDArray[np.float64], levels: NDArray[np.float64]) -> Response:
    return Response(f, levels, a)


def test_of_a_response_that_is_a_parabola_of_the_frequency_the_miss_is_known_exactly() -> None:
    f, levels = np.array([100.0, 200.0, 350.0, 400.0]), np.array([1.0, 2.0, 10.0])

    def gain(hz: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(2.0 + ((hz - 180.0) / 100) ** 2)

    response = table(gain(f)[:, None] * levels, f, levels)
    for hz in (137, 200, 251, 349, 380):
        stimulus = bins(**{f"f{hz}": 3.0})
        _, shaped = drive(stimulus.bins, rate_hz=5000, response=response, gain_limit_v_per_m_s2=1e9)
        moves = gain(np.array(float(hz))) * np.abs(shaped.coefficients_v).max()
        assert in_volts(stimulus, response).table == pytest.approx(abs(moves - 3.0) / 3.0, abs=1e-12)


def test_of_a_response_that_is_a_parabola_of_the_level_the_miss_is_known_exactly() -> None:
    f, levels = np.array([100.0, 200.0, 400.0]), np.array([1.0, 2.5, 4.0])

    def moved(volts: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(2.0 * volts - 0.1 * volts**2)

    response = table(np.tile(moved(levels), (3, 1)), f, levels)
    for asked in (0.7, 1.9, 3.0, 5.5, 6.3):
        stimulus = bins(f150=asked)
        _, shaped = drive(stimulus.bins, rate_hz=5000, response=response, gain_limit_v_per_m_s2=1e9)
        moves = moved(np.abs(shaped.coefficients_v).max())
        assert in_volts(stimulus, response).table == pytest.approx(abs(moves - asked) / asked, abs=1e-12)


@pytest.mark.parametrize(("every", "within"), [(1, 0.1), (2, 0.1), (4, 0.35)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_table_s_share_is_that_of_the_panel_s_own_closed_form(seed: int, every: int, within: float) -> None:
    """Where nothing else is lost, on the simulated panel's table and on two that are coarser, up to 20 Hz apart."""
    f = np.array(FREQUENCIES_HZ, dtype=np.float64)
    f = np.concatenate([f[:-1:every], f[-1:]])
    levels = sqrt(2) * np.array(LEVELS_VRMS)
    response = table(answered(f[:, None], levels), f, levels)
    coefficients = np.zeros(2500)
    coefficients[20:590] = np.random.default_rng(seed).normal(size=570) * 0.05
    stimulus = of_bins(coefficients, samples=2500, rate_hz=5000)
    _, shaped = drive(stimulus.bins, rate_hz=5000, response=response, gain_limit_v_per_m_s2=4.0)
    moves = answered(np.arange(2500.0), shaped.coefficients_v)
    truth = np.sqrt(np.sum((moves - coefficients) ** 2) / np.sum(coefficients**2))
    found = in_volts(stimulus, response, gain=4.0)
    assert found.total == pytest.approx(found.table)
    assert found.table == pytest.approx(truth, rel=within)


def test_the_other_reading_of_equation_7_in_the_middle_of_two_frequencies() -> None:
    """1 and 3 m/s^2 a volt: A is 2 in the middle, so W = 1/2; the mean of both W is 2/3, which moves 4/3."""
    levels = np.array([1.0, 10.0])
    response = table(np.array([levels, 3 * levels]), np.array([100.0, 200.0]), levels)
    for hz, apart in ((150, 1 / 3), (100, 0.0), (200, 0.0)):
        stimulus = bins(**{f"f{hz}": 1.5})
        _, shaped = drive(stimulus.bins, rate_hz=5000, response=response, gain_limit_v_per_m_s2=1e9)
        found = budget.other_reading(stimulus, shaped=shaped, response=response)
        assert found == pytest.approx(apart, abs=1e-12)
