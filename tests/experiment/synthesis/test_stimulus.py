"""Stimuli against equation (5) as printed, and when what is computed."""

from __future__ import annotations

from math import cos, pi

import numpy as np

from experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from experiment.synthesis.waveforms import BinsAtSpeed, synthesise


def drawn(seed: int, *, bins: int = 12) -> CrinkleSpectra:
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(3, bins))
    return CrinkleSpectra(np.array([100.0, 200.0, 300.0]), 5000, rng.random((3, bins)), signs)


def test_the_stimulus_is_equation_5_of_the_spectrum_at_that_speed() -> None:
    of = drawn(5)
    wanted = at_speed(of, speed_mm_s=420.0)
    c, n = wanted.coefficients, of.samples
    expected = [sum(c[k] * cos(pi * k * (i + 0.5) / n) for k in range(1, n)) for i in range(n)]
    made = synthesise(of, speed_mm_s=420.0, output_rate_hz=5000)
    np.testing.assert_allclose(made.waveform_m_s2, expected, rtol=0, atol=1e-12)
    assert wanted.floored_bins > 0
    assert (made.floored_bins, made.extrapolated, made.dropped_bins) == (wanted.floored_bins, True, 0)


def test_an_output_rate_drops_the_bins_at_or_above_half_of_it() -> None:
    of = drawn(6)
    made = synthesise(of, speed_mm_s=150.0, output_rate_hz=2500)
    c = at_speed(of, speed_mm_s=150.0).coefficients
    expected = [sum(c[k] * cos(pi * k * (i + 0.5) / 6) for k in range(1, 6)) for i in range(6)]
    np.testing.assert_allclose(made.waveform_m_s2, expected, rtol=0, atol=1e-12)
    assert made.dropped_bins == 6


def test_bins_say_what_they_are_of_and_what_they_are() -> None:
    of = drawn(7)
    bins = BinsAtSpeed(of, 137.0)
    assert (bins.spectra, bins.speed_mm_s) == (of, 137.0)
    got = bins()
    np.testing.assert_array_equal(got.coefficients, at_speed(of, speed_mm_s=137.0).coefficients)
    assert (got.samples, got.rate_hz) == (12, 5000)
