"""The first block is the beginning of the stimulus, whichever way it was made."""

from __future__ import annotations

import numpy as np
import pytest

from experiment.synthesis.crinkle import CrinkleSpectra, synthesise
from experiment.synthesis.first_block import FIRST_BLOCK, FirstBlockFirst
from experiment.synthesis.pruning import BandPruned
from tests.experiment.synthesis.oracle import random_spectra

SPEEDS = np.array([50.0, 100.0, 200.0, 300.0])
ANYWHERE = [0.0, 20.0, 50.0, 75.0, 130.0, 300.0, 310.0, 1e4, 1e6]


def some(bins: int = 250) -> CrinkleSpectra:
    return random_spectra(np.random.default_rng(4), speeds=4, bins=bins, rate_hz=5000, v=SPEEDS)


@pytest.mark.parametrize("v", ANYWHERE)
@pytest.mark.parametrize("output_rate_hz", [48_000, 5000, 1000])
def test_the_first_block_opens_the_waveform_to_the_bit(v: float, output_rate_hz: int) -> None:
    begun = FirstBlockFirst().prepare(some(), output_rate_hz=output_rate_hz).begin(v)
    first = begun.first_m_s2.copy()
    whole = begun.complete().waveform_m_s2
    assert first.size == min(FIRST_BLOCK, whole.size)
    np.testing.assert_array_equal(whole[: first.size], first)


@pytest.mark.parametrize("v", ANYWHERE)
def test_completed_it_is_the_stimulus(v: float) -> None:
    s = some()
    made = FirstBlockFirst().prepare(s, output_rate_hz=48_000).begin(v).complete()
    wanted = synthesise(s, speed_mm_s=v, output_rate_hz=48_000)
    np.testing.assert_allclose(
        made.waveform_m_s2, wanted.waveform_m_s2, rtol=0, atol=1e-12 * np.max(np.abs(wanted.waveform_m_s2))
    )
    assert (made.floored_bins, made.extrapolated) == (wanted.floored_bins, wanted.extrapolated)


def test_materials_of_one_rate_share_the_cosines() -> None:
    a, b = (FirstBlockFirst().prepare(some(), output_rate_hz=48_000) for _ in range(2))
    assert a.first_cosines is b.first_cosines


def test_a_band_needs_cosines_of_its_bins_alone() -> None:
    whole = FirstBlockFirst().estimate(some(), output_rate_hz=48_000)
    band = BandPruned(FirstBlockFirst(), (10.0, 500.0)).estimate(some(), output_rate_hz=48_000)
    assert whole.memory_bytes - band.memory_bytes >= 8 * FIRST_BLOCK * (250 - 51)
