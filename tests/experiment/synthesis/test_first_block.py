"""The first block is the beginning of the stimulus, whichever way it was made."""

from __future__ import annotations

import numpy as np
import pytest

from experiment.synthesis.crinkle import CrinkleSpectra
from experiment.synthesis.first_block import FIRST_BLOCK, STRIDE, FirstBlockFirst
from experiment.synthesis.pruning import BandPruned
from experiment.synthesis.waveforms import synthesise
from tests.experiment.synthesis.oracle import exact, random_spectra

SPEEDS = np.array([50.0, 100.0, 200.0, 300.0])
ANYWHERE = [0.0, 20.0, 50.0, 75.0, 130.0, 300.0, 310.0, 1e4, 1e6]


def some(bins: int = 250) -> CrinkleSpectra:
    return random_spectra(np.random.default_rng(4), speeds=4, bins=bins, rate_hz=5000, v=SPEEDS)


@pytest.mark.parametrize("v", ANYWHERE)
@pytest.mark.parametrize("output_rate_hz", [48_000, 5000, 1000])
def test_the_first_block_opens_the_waveform_to_the_bit(v: float, output_rate_hz: int) -> None:
    """And so it does by whichever way the whole is made alone, to the errors that both claim."""
    s = some()
    begun = FirstBlockFirst().prepare(s, output_rate_hz=output_rate_hz).begin(v)
    first = begun.first_m_s2.copy()
    whole = begun.complete().waveform_m_s2
    assert first.size == min(FIRST_BLOCK, whole.size)
    np.testing.assert_array_equal(whole[: first.size], first)
    alone = synthesise(s, speed_mm_s=v, output_rate_hz=output_rate_hz).waveform_m_s2
    np.testing.assert_allclose(first, alone[: first.size], rtol=0, atol=1e-12 * np.max(np.abs(alone)))


@pytest.mark.parametrize("bins", [1, 32, 33, 34, 250, 2500])
@pytest.mark.parametrize("nearest", [50.0, 300.0])
def test_across_all_strides_the_first_block_keeps_the_error_claimed_for_it(bins: int, nearest: float) -> None:
    """At speeds between the falls of a bin and the next, beside every stride and inside it, against the oracle."""
    s = some(bins)
    method = FirstBlockFirst()
    render = method.prepare(s, output_rate_hz=48_000)
    side = render.above if nearest == 300.0 else render.below
    falls_mm_s = nearest + side.gap_mm_s * side.falls_after[np.isfinite(side.falls_after)]
    beside = np.arange(0, falls_mm_s.size, STRIDE)[:, None] + np.array([-1, 0, 1, STRIDE // 2])
    speeds_mm_s = falls_mm_s[np.unique(beside[(beside >= 0) & (beside < falls_mm_s.size)])]
    speeds_mm_s = np.concatenate([speeds_mm_s, [nearest * 1.5, 0.0, 5e4, 2e5]])
    speeds_mm_s = speeds_mm_s[(speeds_mm_s >= 0) & (speeds_mm_s < 1e9)]
    claim = method.estimate(s, output_rate_hz=48_000).first_block_error
    assert claim is not None
    wanted = exact(s, speeds_mm_s.tolist(), 48_000, tuple(range(min(FIRST_BLOCK, render.on.count))))
    for v, right, scale in zip(speeds_mm_s.tolist(), wanted.samples, wanted.scale, strict=True):
        # Of any sample, not of their rms alone: so the bound is derived.
        assert float(np.max(np.abs(render.begin(v).first_m_s2 - right))) <= claim * float(scale), v
    fallen = {int(side.falls_after.searchsorted((v - nearest) / side.gap_mm_s)) // STRIDE for v in speeds_mm_s}
    assert len(fallen) >= bins // (4 * STRIDE), "several strides are entered"


def test_a_running_sum_that_errs_by_more_than_is_claimed_is_seen() -> None:
    """One sum of a stride off by 1e-10: what the test above is there to notice."""
    s = some(2500)
    method = FirstBlockFirst()
    render = method.prepare(s, output_rate_hz=48_000)
    claim = method.estimate(s, output_rate_hz=48_000).first_block_error
    gaps = float(render.above.falls_after[5 * STRIDE]) * (1 + 1e-6)
    v = 300.0 + gaps * render.above.gap_mm_s
    wanted = exact(s, [v], 48_000, tuple(range(FIRST_BLOCK)))
    render.above.sums[0, 6] *= 1 + 1e-10
    error = float(np.max(np.abs(render.begin(v).first_m_s2 - wanted.samples[0])))
    assert claim is not None
    assert error > claim * float(wanted.scale[0])


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
