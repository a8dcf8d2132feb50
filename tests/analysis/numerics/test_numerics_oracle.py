"""The oracle against transcriptions that share nothing with it."""

from __future__ import annotations

from fractions import Fraction
from math import fsum, pi

import numpy as np
import pytest

from palpate.analysis.numerics import oracle
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from tests.experiment.synthesis.oracle import exact, random_spectra

PLACES = [0.0, 12.0, 77.0, 150.0, 1e4]


@pytest.mark.parametrize("bins", [1, 2, 13, 20])
@pytest.mark.parametrize("output_rate_hz", [480, 53, 37, 50])
def test_a_stimulus_is_that_of_the_suite_s_own_oracle(bins: int, output_rate_hz: int) -> None:
    spectra = random_spectra(np.random.default_rng(bins), speeds=4, bins=bins)
    wanted = exact(spectra, PLACES, output_rate_hz)
    for i, v in enumerate(PLACES):
        got = oracle.stimulus(spectra, speed_mm_s=v, output_rate_hz=output_rate_hz)
        assert got.samples.shape == wanted.samples[i].shape
        assert got.floored == wanted.floored[i]
        assert float(abs(got.scale - wanted.scale[i])) <= 1e-16 * float(wanted.scale[i])
        assert float(np.max(np.abs(got.samples - wanted.samples[i]), initial=0)) <= 1e-16 * float(
            np.sum(np.abs(spectra.amplitudes)) * max(1.0, v / 10)
        )


def test_equation_3_in_fractions() -> None:
    spectra = random_spectra(np.random.default_rng(3), speeds=3, bins=8)
    speeds = [Fraction(v) for v in spectra.speeds_mm_s.tolist()]
    v = (speeds[1] * 2 + speeds[2]) / 3
    got, floored, nearest = oracle.spectrum_at(spectra, float(v))
    v = Fraction(float(v))
    for k in range(8):
        a, b = (Fraction(spectra.amplitudes[i, k]) for i in (1, 2))
        wanted = (a + (b - a) * (v - speeds[1]) / (speeds[2] - speeds[1])) * int(spectra.signs[1, k])
        assert float(got[k]) == pytest.approx(float(wanted), rel=1e-15, abs=1e-300)
    assert (floored, nearest) == (0, None)


def test_the_forward_transform_as_printed() -> None:
    y = np.random.default_rng(1).normal(size=11)
    for k, got in enumerate(oracle.forward(y)):
        wanted = 2 / 11 * fsum(y[i] * np.cos(pi * k * (i + 0.5) / 11) for i in range(11))
        assert float(got) == pytest.approx(wanted, abs=1e-15)


def test_an_error_is_the_rms_of_the_difference() -> None:
    spectra = CrinkleSpectra(np.array([1.0, 2.0]), 50, np.ones((2, 5)), np.ones((2, 5)))
    wanted = oracle.stimulus(spectra, speed_mm_s=1.5, output_rate_hz=50)
    made = wanted.samples.astype(np.float64)
    made[0] += 1.0
    assert float(oracle.error(made, wanted)) == pytest.approx(5**-0.5, rel=1e-14)
    assert float(wanted.scale) == pytest.approx(2**0.5, rel=1e-15)
    assert float(oracle.error(made * 1e300, wanted)) == pytest.approx(float(np.sqrt(np.mean(made**2))) * 1e300)


def test_the_response_and_its_inverse_undo_each_other() -> None:
    f, v = np.linspace(1.0, 700.0, 60), np.linspace(0.01, 3.0, 60)
    np.testing.assert_allclose(oracle.voltage_v(f, oracle.answered_m_s2(f, v)), v, rtol=1e-14)
    peak = f[np.argmax(oracle.answered_m_s2(f, np.ones(60)))]
    assert abs(peak - 360.0) < 15.0


def test_octave_bands_see_a_band_that_is_too_loud() -> None:
    rate_hz, n = 48_000, 48_000
    f = np.fft.rfftfreq(n, 1 / rate_hz)
    amplitudes = np.where(f > 0, np.maximum(f, 1.0) ** -0.5, 0.0)
    amplitudes[(f >= 178.0) & (f < 355.0)] *= 10 ** (3 / 20)
    deviations = oracle.octave_deviations_db(np.fft.irfft(amplitudes), rate_hz=rate_hz, db_per_octave=0.0)
    assert deviations[3] == pytest.approx(3.0, abs=0.1)
    assert np.max(np.abs(np.delete(deviations, 3))) < 0.1
    short = np.random.default_rng(1).normal(size=96)
    assert oracle.octave_deviations_db(short, rate_hz=rate_hz, db_per_octave=0.0)[0] == -np.inf
