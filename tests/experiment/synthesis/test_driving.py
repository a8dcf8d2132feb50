"""The voltages of a waveform: those of its spectrum, whether that is known or not, and within every limit."""

from __future__ import annotations

from math import cos, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.shaping import Response, Shaped, _moved_m_s2, at_bins, drive, shape_at
from palpate.experiment.synthesis.signals.weighting import shape
from palpate.experiment.synthesis.spectra import Bins, inverse, spectrum
from tests.approved import Refuses
from tests.experiment.synthesis.measured import (
    F_HZ,
    LEVELS_V,
    NO_LIMIT,
    NOTHING,
    TABLE,
    accelerations,
    bins_of_waveform,
    losses,
    some_bins,
)
from tests.experiment.synthesis.resampled import resampled


def test_equation_7_as_printed_with_amplitudes_from_the_table() -> None:
    # Bins 1, 2, 3 and 5 of six at 1200 Hz stand at the table's frequencies; bin 4, between two of them, asks nothing.
    asked = np.array([0.0, 0.9, -8.0, 1.0, 0.0, -0.25])
    look_up = {1: 1.0, 2: -2.0, 3: 0.5, 5: -0.5}
    printed = [sum(e * cos(pi * k * (i + 0.5) / 6) for k, e in look_up.items()) for i in range(6)]
    driven, did = drive(
        bins_of_waveform(inverse(asked), rate_hz=1200), rate_hz=1200, response=TABLE, gain_limit_v_per_m_s2=NO_LIMIT
    )
    assert driven == pytest.approx(printed, rel=0, abs=1e-12)
    assert losses(did) == (NOTHING, NOTHING, NOTHING)


def test_a_drive_that_is_taken_down_counts_its_losses_against_what_was_asked_for() -> None:
    """Three bins of one level: one beyond the table, one held back by the gain's limit, one free.

    Of 1 m/s^2 at 600 Hz nothing is reached, whatever the scale: the loss is 1 m/s^2, not `scale` of it.
    """
    n, rate_hz = 2500, 5000
    asked = np.zeros(n)
    asked[[200, 300, 600]] = 1.0
    waveform = inverse(asked)
    whole = drive(
        bins_of_waveform(waveform, rate_hz=rate_hz), rate_hz=rate_hz, response=TABLE, gain_limit_v_per_m_s2=1e3
    )[1]
    volts, did = drive(
        bins_of_waveform(waveform, rate_hz=rate_hz),
        rate_hz=rate_hz,
        response=TABLE,
        gain_limit_v_per_m_s2=1e3,
        limit_m_s2=0.5,
    )
    assert whole.scale == 1
    assert did.scale < 0.3
    assert whole.outside == did.outside
    assert did.outside.bins == 1
    assert did.outside.cost_m_s2 == pytest.approx(1.0, rel=1e-12)
    moved = accelerations(spectrum(volts)[[200, 300]], frequencies_hz=[200.0, 300.0], response=TABLE)
    np.testing.assert_allclose(np.abs(moved), did.scale, rtol=1e-9)
    # 3 m/s^2 asked of a bin with a gain limit that gives it a tenth of a volt for each m/s^2.
    held = drive(
        bins_of_waveform(3 * waveform, rate_hz=rate_hz),
        rate_hz=rate_hz,
        response=TABLE,
        gain_limit_v_per_m_s2=0.01,
        limit_m_s2=0.01,
    )[1]
    reached = accelerations([0.01 * 3 * held.scale] * 2, frequencies_hz=[200.0, 300.0], response=TABLE)
    assert held.scale < 1
    assert held.bounded.bins == 2
    assert held.bounded.cost_m_s2 == pytest.approx(float((3 - reached).sum()), rel=1e-9)


@pytest.mark.parametrize("output_rate_hz", [5000, 44_100, 48_000, 96_000])
def test_a_waveform_at_any_rate_is_driven_by_the_voltages_of_its_spectrum(output_rate_hz: int) -> None:
    rng = np.random.default_rng(2)
    coefficients = rng.normal(0, 0.3, 2500)
    coefficients[[0, *range(600, 2500)]] = 0.0
    coefficients[rng.integers(1, 600, 50)] = 0.0
    shaped = shape(coefficients, frequencies_hz=np.arange(2500.0), response=TABLE, gain_limit_v_per_m_s2=3.0)
    waveform = resampled(coefficients, rate_hz=5000, output_rate_hz=output_rate_hz)
    volts, did = drive(
        bins_of_waveform(waveform, rate_hz=output_rate_hz),
        rate_hz=output_rate_hz,
        response=TABLE,
        gain_limit_v_per_m_s2=3.0,
    )
    wanted = resampled(shaped.coefficients_v, rate_hz=5000, output_rate_hz=output_rate_hz)
    assert np.max(np.abs(volts - wanted)) <= 1e-12 * np.max(np.abs(wanted))
    for name in ("saturated", "outside", "bounded"):
        one, other = getattr(did, name), getattr(shaped, name)
        assert one.bins == other.bins
        assert one.cost_m_s2 == pytest.approx(other.cost_m_s2, rel=1e-11)


def test_silence_is_driven_by_silence() -> None:
    volts, did = drive(
        bins_of_waveform(np.zeros(7), rate_hz=1000), rate_hz=1000, response=TABLE, gain_limit_v_per_m_s2=1.0
    )
    assert not volts.any()
    assert (did.saturated, did.outside, did.bounded) == (NOTHING, NOTHING, NOTHING)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bins_that_are_not_finite_are_refused(bad: float, refuses: Refuses) -> None:
    with refuses(SynthesisError):
        drive(Bins(np.array([1.0, bad]), 2, 1000), rate_hz=1000, response=TABLE, gain_limit_v_per_m_s2=1.0)


@pytest.mark.parametrize("output_rate_hz", [1000, 5000, 44_100, 48_000])
@pytest.mark.parametrize(("limit_m_s2", "limit_v"), [(np.inf, np.inf), (5.0, np.inf), (np.inf, 3.0), (5.0, 3.0)])
@pytest.mark.parametrize("held", [700, 2500])
def test_bins_that_are_known_give_what_a_transform_of_their_waveform_gives(
    output_rate_hz: int, limit_m_s2: float, limit_v: float, held: int
) -> None:
    bins = some_bins(3, held=held)
    whole = np.concatenate([bins.coefficients, np.zeros(bins.samples - held)])
    waveform = resampled(whole, rate_hz=5000, output_rate_hz=output_rate_hz)
    limits = {"gain_limit_v_per_m_s2": 3.0, "limit_m_s2": limit_m_s2, "limit_v": limit_v}
    volts, did = drive(bins, rate_hz=output_rate_hz, response=TABLE, **limits)
    its_own = bins_of_waveform(waveform, rate_hz=output_rate_hz)
    slowly, same = drive(its_own, rate_hz=output_rate_hz, response=TABLE, **limits)
    assert np.max(np.abs(volts - slowly)) <= 1e-12 * np.max(np.abs(slowly))
    assert did.scale == pytest.approx(same.scale, rel=1e-12)
    for one, other in zip(losses(did), losses(same), strict=True):
        assert one.bins == other.bins
        assert one.cost_m_s2 == pytest.approx(other.cost_m_s2, rel=1e-10)


def test_at_a_rate_whose_samples_do_not_fill_the_time_the_bins_are_those_of_the_recording() -> None:
    # 7 samples at 100 Hz at 44 Hz: 3.08 samples; their own transform knows of no bin of the recording.
    bins = Bins(np.array([0.0, 0.0, 0.0, 0.5, 0.0]), samples=7, rate_hz=100)
    table = Response(np.array([1.0, 50.0]), np.array([1.0]), np.array([[2.0], [2.0]]))
    waveform = 0.5 * np.cos(np.pi * 3 * (np.arange(3) + 0.5) * 100 / 44 / 7)
    volts, _ = drive(bins, rate_hz=44, response=table, gain_limit_v_per_m_s2=NO_LIMIT)
    np.testing.assert_allclose(volts, waveform / 2, rtol=0, atol=1e-15)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 1e3), st.floats(0.1, 1e3), st.sampled_from([5000, 48_000]))
def test_no_limit_is_passed(seed: int, limit_m_s2: float, limit_v: float, output_rate_hz: int) -> None:
    bins = some_bins(seed, samples=400, held=400)
    f_hz = np.arange(400) * 5000 / 800
    within = (f_hz >= F_HZ[0]) & (f_hz <= F_HZ[-1])
    volts, did = drive(
        bins,
        rate_hz=output_rate_hz,
        response=TABLE,
        gain_limit_v_per_m_s2=3.0,
        limit_m_s2=limit_m_s2,
        limit_v=limit_v,
    )
    # Round-off of the transform may pass the highest level.
    driven = np.clip(spectrum(volts)[:400], -LEVELS_V[-1], LEVELS_V[-1])
    moved = np.zeros(400)
    moved[within] = accelerations(driven[within], frequencies_hz=f_hz[within], response=TABLE)
    for rate_hz in (output_rate_hz, 200_000):
        moved_m_s2 = resampled(moved, rate_hz=5000, output_rate_hz=rate_hz)
        assert np.abs(moved_m_s2).max() <= limit_m_s2 * (1 + 1e-12)
    assert np.abs(volts).max() <= limit_v
    assert 0 < did.scale <= 1


@pytest.mark.parametrize("output_rate_hz", [5000, 48_000])
def test_a_bin_beyond_the_table_that_flattened_the_peaks_does_not_hide_them_from_the_limit(output_rate_hz: int) -> None:
    """cos x - cos(3 x) / 6 peaks at sqrt(3) / 2; without its second term at 1."""
    c = np.zeros(700)
    c[[200, 600]] = 1.0, -1 / 6
    waveform = resampled(np.pad(c, (0, 1800)), rate_hz=5000, output_rate_hz=output_rate_hz)
    assert np.abs(waveform).max() == pytest.approx(3**0.5 / 2, rel=0.03)
    asked = Bins(c, samples=2500, rate_hz=5000)
    _, did = drive(asked, rate_hz=output_rate_hz, response=TABLE, gain_limit_v_per_m_s2=3.0, limit_m_s2=0.9)
    assert 0.9 / 1.001 / 1.013 <= did.scale <= 0.9 / 1.001 * (1 + 1e-12)


@pytest.mark.parametrize("output_rate_hz", [5000, 48_000])
def test_a_waveform_is_taken_down_for_an_acceleration_beyond_the_limit_or_hardly_within_it(output_rate_hz: int) -> None:
    bins = some_bins(5)

    def driven(limit_m_s2: float) -> Shaped:
        return drive(bins, rate_hz=output_rate_hz, response=TABLE, gain_limit_v_per_m_s2=3.0, limit_m_s2=limit_m_s2)[1]

    peak_m_s2 = float(np.abs(resampled(driven(np.inf).reached_m_s2, rate_hz=5000, output_rate_hz=200_000)).max())
    assert driven(peak_m_s2 * 1.013).scale == 1
    assert 0.98 < driven(peak_m_s2 * (1 - 1e-3)).scale < 1


def test_the_same_is_said_of_the_acceleration_at_any_rate() -> None:
    slow, fast = (
        drive(some_bins(6), rate_hz=rate_hz, response=TABLE, gain_limit_v_per_m_s2=3.0)[1] for rate_hz in (5000, 48_000)
    )
    assert slow.peak_m_s2 == fast.peak_m_s2


def test_bins_that_are_none_or_no_numbers_are_refused() -> None:
    for coefficients, problem in (([], r"bins: got shape \(0,\)"), ([0.0, np.nan], "bins: got 1 NaN or infinite")):
        with pytest.raises(SynthesisError, match=problem):
            drive(
                Bins(np.array(coefficients), samples=10, rate_hz=5000),
                rate_hz=5000,
                response=TABLE,
                gain_limit_v_per_m_s2=1.0,
            )


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95))
def test_the_round_before_bounds_what_moves_less_though_some_bins_go_down_by_less(seed: int, scale: float) -> None:
    bins = some_bins(seed, samples=400, held=400)
    asked = 20 * bins.coefficients
    at = at_bins(TABLE, np.arange(400) * 5000 / 800)
    more, less = (shape_at(asked, at, gain_limit_v_per_m_s2=3.0, scale=one) for one in (1.0, scale))
    peak_m_s2 = float(np.abs(resampled(less.reached_m_s2, rate_hz=5000, output_rate_hz=200_000)).max())
    bound_m_s2 = _moved_m_s2(less, (more, more.peak_m_s2), 0.999 * float(np.abs(less.reached_m_s2).sum()))
    assert peak_m_s2 * (1 - 1e-12) <= bound_m_s2
    assert more.saturated.bins > 0
