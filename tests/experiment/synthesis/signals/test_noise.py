"""Noise: its spectrum by an independent estimate, its limits, and what is refused."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.signals.noise import LOWEST_HZ, Colour, noise

CENTRES_HZ = 1000.0 * 10.0 ** (0.3 * np.arange(-5, 5))
"""Exact centres of the octave bands from 31.5 Hz to 16 kHz (IEC 61260-1, base ten)."""


def octave_levels_db(samples: NDArray[np.float64], rate_hz: int) -> NDArray[np.float64]:
    """Of one period, by the periodogram of another library than the one under test."""
    f, density = signal.periodogram(samples, rate_hz, detrend=False)
    edge = 10**0.15
    return 10 * np.log10([density[(f >= centre / edge) & (f < centre * edge)].sum() for centre in CENTRES_HZ])


def slope_error_db(samples: NDArray[np.float64], rate_hz: int, colour: Colour) -> float:
    wanted = 0.0 if colour == "pink" else 3.0
    levels = octave_levels_db(samples, rate_hz) - wanted * np.arange(10)
    return float(np.max(np.abs(levels - levels[5])))


@settings(max_examples=60, deadline=None)
@given(
    colour=st.sampled_from(get_args(Colour)),
    seconds=st.floats(0.5, 3.0),
    rate_hz=st.sampled_from([44_100, 48_000, 96_000]),
    seed=st.integers(0, 2**32 - 1),
)
def test_octave_bands_are_within_half_a_decibel_from_half_a_second_on(
    colour: Colour, seconds: float, rate_hz: int, seed: int
) -> None:
    samples = int(np.ceil(seconds * rate_hz))
    made = noise(colour=colour, samples=samples, rate_hz=rate_hz, rng=np.random.default_rng(seed))
    assert slope_error_db(made, rate_hz, colour) <= 0.5
    assert made.shape == (samples,)
    assert abs(made.mean()) < 1e-12
    assert np.sqrt(np.mean(made**2)) == pytest.approx(1.0, rel=1e-12)


def test_the_slope_is_exact_bin_by_bin() -> None:
    n, rate_hz = 48_000, 48_000
    pink = noise(colour="pink", samples=n, rate_hz=rate_hz, rng=np.random.default_rng(1))
    power = np.abs(np.fft.rfft(pink)) ** 2
    f = np.fft.rfftfreq(n, 1 / rate_hz)
    sounding = (f >= LOWEST_HZ) & (f < rate_hz / 2)
    products = power[sounding] * f[sounding]
    np.testing.assert_allclose(products, products[0], rtol=1e-9)
    assert power[~sounding].max() < 1e-20 * power.max()


def test_an_excerpt_seen_through_filters_has_the_colour_too() -> None:
    rate_hz = 48_000
    pink = noise(colour="pink", samples=20 * rate_hz, rate_hz=rate_hz, rng=np.random.default_rng(2))
    levels = []
    for centre in (250.0, 1000.0, 4000.0):
        band = signal.butter(4, [centre / 2**0.5, centre * 2**0.5], "bandpass", fs=rate_hz, output="sos")
        levels.append(10 * np.log10(np.mean(signal.sosfilt(band, pink)[rate_hz : 9 * rate_hz] ** 2)))
    assert max(levels) - min(levels) < 0.5


def test_it_goes_round_without_a_seam_and_is_near_to_normal() -> None:
    white = noise(colour="white", samples=96_000, rate_hz=48_000, rng=np.random.default_rng(3))
    steps = np.abs(np.diff(np.concatenate([white, white[:1]])))
    assert steps[-1] <= steps[:-1].max()
    assert np.mean(np.abs(white) < 1.0) == pytest.approx(0.6827, abs=0.01)
    assert np.max(np.abs(white)) < 6.5


def test_the_same_generator_draws_the_same_noise() -> None:
    first, second, other = (
        noise(colour="pink", samples=4800, rate_hz=48_000, rng=np.random.default_rng(seed)) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, second)
    assert abs(float(np.corrcoef(first, other)[0, 1])) < 0.2


@pytest.mark.parametrize("samples", [2400, 2401, 2411, 83_390])
def test_even_odd_and_prime_lengths_have_the_same_rms(samples: int) -> None:
    made = noise(colour="pink", samples=samples, rate_hz=48_000, rng=np.random.default_rng(7))
    assert made.shape == (samples,)
    assert np.sqrt(np.mean(made**2)) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("colour", "samples", "rate_hz", "match"),
    [
        ("brown", 4800, 48_000, r"colour: got 'brown'; allowed: pink or white; correct the protocol"),
        ("pink", 2399, 48_000, r"samples: got 2399; allowed: 2400 or more at 48000 Hz"),
        ("pink", 0, 48_000, r"samples: got 0"),
        ("pink", 2205, 44_101, r"samples: got 2205; allowed: 2206 or more"),
        ("white", 4800, 79, r"rate_hz: got 79; allowed: 80 Hz or more"),
        ("white", 4800, -1, r"rate_hz: got -1"),
    ],
)
def test_what_no_noise_can_be_made_of_is_refused(colour: Colour, samples: int, rate_hz: int, match: str) -> None:
    with pytest.raises(SynthesisError, match=match):
        noise(colour=colour, samples=samples, rate_hz=rate_hz, rng=np.random.default_rng(1))


@pytest.mark.parametrize(("samples", "rate_hz"), [(4, 80), (5, 80), (5, 81), (2400, 48_000)])
def test_the_shortest_noise_sounds(samples: int, rate_hz: int) -> None:
    made = noise(colour="pink", samples=samples, rate_hz=rate_hz, rng=np.random.default_rng(1))
    assert np.sqrt(np.mean(made**2)) == pytest.approx(1.0, rel=1e-12)
