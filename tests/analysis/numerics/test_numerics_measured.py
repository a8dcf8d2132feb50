"""Measurements: the error column by a known injected error, the clock, and what each subject should show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from palpate.analysis.numerics import numerics
from palpate.analysis.numerics.cases import INVERSE_DCT, PRINTED_SUM, WAYS, Render, Way
from palpate.analysis.numerics.numerics import FULL, QUICK, Extent, Measured, Timed, timed, usual_length
from palpate.analysis.numerics.oracle import stimulus
from palpate.experiment.synthesis.crinkle import CrinkleSpectra

TINY = Extent(
    lengths=(50, 60),
    output_rates_hz=(44_100, 48_000),
    most_terms=60_000,
    table_sizes=(60, 120),
    table_levels=(120,),
    noise_s=(0.1, 0.5),
    budget_s=0.0,
    least_repeats=1,
    places=40,
    diagrams=((4.5e3, 0.1),),
    contact_steps=(8, 16, 32),
    devices=(),
)


def wrong(part: float, claimed: float) -> Way:
    """An inverse DCT whose waveform is too large by a known part."""

    def prepare(spectra: CrinkleSpectra, output_rate_hz: int) -> tuple[Render, int]:
        right, nbytes = INVERSE_DCT.prepare(spectra, output_rate_hz)
        return lambda speed_mm_s: right(speed_mm_s) * (1 + part), nbytes

    return Way("wrong", lambda _: claimed, prepare)


@pytest.mark.parametrize("part", [1e-2, 1e-6, 1e-10])
def test_the_error_column_is_an_injected_error(part: float) -> None:
    rows = [measure() for measure in numerics.synthesis(TINY, [wrong(part, 2 * part)])]
    whole = [one for one in rows if one.given["output_rate_hz"] == 48_000 and one.given["speed_mm_s"] < 300]
    assert len(whole) == 2
    for one in whole:
        # N F' / F is whole, so the rms of the samples is that of the spectrum, to the last digits.
        assert one.error == pytest.approx(part, rel=1e-4)
        assert one.holds
    assert all(one.holds for one in rows)


def test_an_error_above_the_claim_does_not_hold() -> None:
    rows = [measure() for measure in numerics.synthesis(TINY, [wrong(1e-6, 1e-7)])]
    assert not any(one.holds for one in rows)


def test_without_a_claim_an_error_need_only_be_a_number() -> None:
    one = Measured("shaping", "any", {}, Timed(1.0, (1.0, 1.0), 1), error=10.0)
    assert one.holds
    assert not replace(one, error=float("nan")).holds
    assert not replace(one, error=float("nan"), claimed=1.0).holds


def test_every_way_is_measured_and_keeps_its_claim() -> None:
    rows = [measure() for measure in numerics.synthesis(TINY, WAYS)]
    assert {one.way for one in rows} == {way.name for way in WAYS}
    assert all(one.holds and one.error < 1e-14 for one in rows)


def test_large_printed_sums_are_left_out() -> None:
    extent = replace(TINY, most_terms=50 * 50 * 48_000 // 5000)
    points = [measure() for measure in numerics.synthesis(extent, WAYS)]
    assert [one.given["samples"] for one in points if one.way == PRINTED_SUM.name] == [50]
    assert {one.given["samples"] for one in points if one.way != PRINTED_SUM.name} == {50, 60}


def test_spectra_made_to_order_are_the_same_at_every_call() -> None:
    first = numerics.made_to_order(30)
    numerics.made_to_order.cache_clear()
    np.testing.assert_array_equal(first.amplitudes, numerics.made_to_order(30).amplitudes)


def test_beyond_the_measured_speeds_bins_are_floored() -> None:
    for extent in (QUICK, FULL):
        spectra = numerics.made_to_order(extent.usual)
        assert stimulus(spectra, speed_mm_s=numerics.BEYOND_MM_S, output_rate_hz=5000).floored > 0


def test_resampling_by_the_inverse_dct_is_exact_and_the_others_are_not() -> None:
    rows = [measure() for measure in numerics.resampling(replace(TINY, lengths=(500,)))]
    errors = {way: [one.error for one in rows if one.way == way] for way in {one.way for one in rows}}
    assert max(errors["inverse DCT"]) < 1e-14
    assert all(one.holds for one in rows)
    for way in ("polyphase filter", "linear interpolation"):
        assert all(1e-5 < error < 0.05 for error in errors[way])


def test_the_error_of_shaping_falls_with_the_square_of_the_spacing() -> None:
    coarse, fine = (measure().error for measure in numerics.shaping(TINY))
    assert 3.0 < coarse / fine < 5.0


def test_noise_is_measured_in_decibels_and_claims_from_half_a_second_on() -> None:
    rows = [measure() for measure in numerics.noises(TINY)]
    assert [one.claimed for one in rows] == [None, 0.5, None, 0.5]
    assert all(one.holds for one in rows)
    assert rows[0].error > rows[1].error


def test_the_usual_length_is_the_paper_s_where_it_is_measured() -> None:
    assert usual_length([250, 2500, 5000]) == 2500
    assert usual_length([250, 1000]) == 1000


def ticking(*took: int) -> Iterator[int]:
    """A clock, read twice a call."""
    now = 0
    for duration in took:
        yield now
        now += duration
        yield now


def test_a_median_of_repeats_without_the_first_which_warms_up() -> None:
    clock = ticking(900, 5, 1, 3, 7, 4)
    result = timed(lambda: None, budget_s=1e-6, least_repeats=5, clock=lambda: next(clock, 0))
    assert (result.repeats, result.median_s) == (2000, 0.0)
    clock = ticking(90, 50, 10, 30)
    result = timed(lambda: None, budget_s=90e-9, least_repeats=2, clock=lambda: next(clock))
    assert (result.repeats, result.median_s) == (3, 30e-9)
    assert result.quartiles_s == pytest.approx((20e-9, 40e-9))


def test_a_slow_call_is_repeated_no_more_than_it_must_be_and_its_first_counts() -> None:
    clock = ticking(200, 100, 300)
    result = timed(lambda: None, budget_s=100e-9, least_repeats=3, clock=lambda: next(clock))
    assert (result.repeats, result.median_s) == (3, 200e-9)
