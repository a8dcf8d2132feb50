"""Frequency shaping: equation (7) as printed, its inverse, and what is lost where the rig cannot follow."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import cos, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.shaping import Loss, Response
from palpate.experiment.synthesis.signals.weighting import shape
from palpate.experiment.synthesis.spectra import inverse
from tests.approved import Refuses
from tests.experiment.synthesis.measured import (
    F_HZ,
    LEVELS_V,
    MEASURED,
    NO_LIMIT,
    NOTHING,
    TABLE,
    accelerations,
    losses,
    responses,
)


def weight(f: float, a: float, response: Response) -> float:
    """W(f, a) naively and in exact fractions: look the nearest values up and follow straight lines; no limits."""
    frequencies = [Fraction(x) for x in response.frequencies_hz.tolist()]
    table = [[Fraction(x) for x in row] for row in response.accelerations_m_s2.tolist()]
    i = max(j for j in range(len(frequencies) - 1) if frequencies[j] <= Fraction(f))
    part = (Fraction(f) - frequencies[i]) / (frequencies[i + 1] - frequencies[i])
    answers = [Fraction(0)] + [low + part * (high - low) for low, high in zip(table[i], table[i + 1], strict=True)]
    volts = [Fraction(0)] + [Fraction(x) for x in response.levels_v.tolist()]
    for (a0, a1), (e0, e1) in zip(pairwise(answers), pairwise(volts), strict=True):
        if Fraction(a) <= a1:
            return float(e0 + (e1 - e0) * (Fraction(a) - a0) / (a1 - a0))
    return float(volts[-1])


def shaped_one(f: float, a: float, response: Response = TABLE, limit: float = NO_LIMIT) -> float:
    return float(
        shape([a], frequencies_hz=[f], response=response, gain_limit_v_per_m_s2=limit).coefficients_v[0],
    )


@pytest.mark.parametrize("i", range(4))
@pytest.mark.parametrize("j", range(3))
def test_it_is_exact_where_the_response_was_measured(i: int, j: int) -> None:
    assert shaped_one(F_HZ[i], MEASURED[i, j]) == LEVELS_V[j]
    assert shaped_one(F_HZ[i], -MEASURED[i, j]) == -LEVELS_V[j]


def test_equation_7_as_printed_with_amplitudes_from_the_table() -> None:
    # Bins 1, 2, 3 and 5 of six at 1200 Hz stand at the table's frequencies; bin 4, between two of them, asks nothing.
    asked = np.array([0.0, 0.9, -8.0, 1.0, 0.0, -0.25])
    look_up = {1: 1.0, 2: -2.0, 3: 0.5, 5: -0.5}
    printed = [sum(e * cos(pi * k * (i + 0.5) / 6) for k, e in look_up.items()) for i in range(6)]
    shaped = shape(asked, frequencies_hz=100.0 * np.arange(6), response=TABLE, gain_limit_v_per_m_s2=NO_LIMIT)
    assert inverse(shaped.coefficients_v) == pytest.approx(printed, rel=0, abs=1e-12)


@given(responses(), st.floats(0, 1), st.floats(0, 1.5))
def test_it_agrees_with_a_naive_look_up_in_exact_fractions(response: Response, along: float, part: float) -> None:
    low, high = response.frequencies_hz[[0, -1]]
    f = float(np.clip(low + along * (high - low), low, high))
    a = part * float(response.accelerations_m_s2.max())
    # Denormal numbers carry fewer digits.
    assert shaped_one(f, a, response) == pytest.approx(weight(f, a, response), rel=1e-12, abs=1e-307)


@given(responses(), st.floats(0, 1), st.lists(st.floats(-1, 1), min_size=1, max_size=20))
def test_it_is_the_inverse_of_the_response(response: Response, along: float, parts: list[float]) -> None:
    low, high = response.frequencies_hz[[0, -1]]
    f = np.full(len(parts), np.clip(low + along * (high - low), low, high))
    volts = np.array(parts) * response.levels_v[-1]
    asked = accelerations(volts, frequencies_hz=f, response=response)
    shaped = shape(asked, frequencies_hz=f, response=response, gain_limit_v_per_m_s2=NO_LIMIT)
    assert shaped.coefficients_v == pytest.approx(volts, rel=1e-6, abs=1e-12 * response.levels_v[-1])
    again = accelerations(shaped.coefficients_v, frequencies_hz=f, response=response)
    assert again == pytest.approx(asked, rel=1e-12, abs=1e-12 * response.accelerations_m_s2.max())
    assert shaped.outside == shaped.bounded == NOTHING
    assert shaped.saturated.cost_m_s2 <= 1e-12 * len(parts) * response.accelerations_m_s2.max()


@given(responses(), st.floats(0, 1), st.lists(st.floats(0, 2e3), min_size=2, max_size=20), st.floats(1e-6, 1e6))
def test_more_is_never_asked_of_less_voltage(
    response: Response, along: float, asked: list[float], limit: float
) -> None:
    low, high = response.frequencies_hz[[0, -1]]
    f = np.full(len(asked), np.clip(low + along * (high - low), low, high))
    shaped = shape(np.sort(asked), frequencies_hz=f, response=response, gain_limit_v_per_m_s2=limit)
    assert np.all(np.diff(shaped.coefficients_v) >= 0)
    assert shaped.coefficients_v[-1] <= response.levels_v[-1]


@given(responses(), st.integers(-40, 40), st.floats(0, 1), st.floats(1e-9, 2e3))
def test_it_knows_no_scale(response: Response, power: int, along: float, a: float) -> None:
    low, high = response.frequencies_hz[[0, -1]]
    f = float(np.clip(low + along * (high - low), low, high))
    by = 2.0**power
    larger = Response(response.frequencies_hz, response.levels_v * by, response.accelerations_m_s2 * by)
    assert shaped_one(f, a * by, larger) == shaped_one(f, a, response) * by


def test_between_measured_frequencies_it_lies_on_the_straight_line_of_the_response() -> None:
    # Half way from 100 to 200 Hz, 1 V moves the panel by (0.9 + 4.5) / 2.
    assert shaped_one(150.0, 2.7) == pytest.approx(1.0, rel=1e-15)


def test_below_the_lowest_level_it_is_proportional_down_to_zero() -> None:
    assert shaped_one(200.0, 0.0) == 0.0
    for a in (1e-300, 1e-9, 0.5, 1.5):
        assert shaped_one(200.0, a) == pytest.approx(a * 0.5 / 2.0, rel=1e-15)


def test_above_the_highest_level_it_saturates_and_says_what_is_missing() -> None:
    shaped = shape([9.0, 8.0, -20.0], frequencies_hz=[200.0] * 3, response=TABLE, gain_limit_v_per_m_s2=NO_LIMIT)
    assert shaped.coefficients_v.tolist() == [2.0, 2.0, -2.0]
    assert shaped.saturated == Loss(bins=2, cost_m_s2=1.0 + 12.0)
    assert (shaped.outside, shaped.bounded) == (NOTHING, NOTHING)


def test_beyond_the_measured_frequencies_nothing_is_driven_and_what_was_asked_is_counted() -> None:
    asked, f = [0.5, 1.0, 1.0, -2.0, 0.0], [0.0, 99.9, 100.0, 500.1, 600.0]
    shaped = shape(asked, frequencies_hz=f, response=TABLE, gain_limit_v_per_m_s2=NO_LIMIT)
    assert shaped.coefficients_v[[0, 1, 3, 4]].tolist() == [0.0] * 4
    assert shaped.coefficients_v[2] > 0
    assert shaped.outside == Loss(bins=3, cost_m_s2=3.5)


def test_the_mean_is_no_oscillation_even_if_the_table_reaches_to_0_hz() -> None:
    table = Response(np.array([0.0, 10.0]), np.array([1.0]), np.array([[1.0], [1.0]]))
    shaped = shape([0.5, 0.5], frequencies_hz=[0.0, 5.0], response=table, gain_limit_v_per_m_s2=1.0)
    assert shaped.coefficients_v.tolist() == [0.0, 0.5]
    assert shaped.outside == Loss(bins=1, cost_m_s2=0.5)


@pytest.mark.parametrize("depth", [0.0, 1e-12])
def test_near_a_null_the_gain_is_bounded_and_the_cost_is_what_the_bound_leaves_out(depth: float) -> None:
    null = np.array([[1.0, 2.0], [depth, 2 * depth], [1.0, 2.0]])
    table = Response(np.array([100.0, 200.0, 300.0]), np.array([1.0, 2.0]), null)
    f = [100.0, 190.0, 200.0, 210.0]
    shaped = shape([0.1] * 4, frequencies_hz=f, response=table, gain_limit_v_per_m_s2=4.0)
    # At 190 and 210 Hz a volt moves 0.1 m/s^2, so 0.1 m/s^2 would take 1 V; the limit allows 0.4 V, and those 0.04.
    assert shaped.coefficients_v == pytest.approx([0.1, 0.4, 0.4, 0.4])
    assert shaped.bounded.bins == 3
    assert shaped.bounded.cost_m_s2 == pytest.approx(0.06 + 0.1 + 0.06)
    assert (shaped.saturated, shaped.outside) == (NOTHING, NOTHING)


def test_at_a_null_the_highest_level_still_holds() -> None:
    table = Response(np.array([100.0, 200.0]), np.array([1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 2.0]]))
    shaped = shape([1e300, 0.0], frequencies_hz=[100.0, 100.0], response=table, gain_limit_v_per_m_s2=1e3)
    assert shaped.coefficients_v.tolist() == [2.0, 0.0]
    assert shaped.saturated == Loss(bins=1, cost_m_s2=1e300)
    assert shaped.bounded == NOTHING


@given(
    responses(),
    st.lists(st.floats(-2e3, 2e3), min_size=1, max_size=30),
    st.floats(1e-3, 1e3),
    st.integers(0, 99),
    st.sampled_from([1.0, 0.9, 0.25]),
)
def test_every_loss_counts_once_and_the_costs_add_up(
    response: Response, asked: list[float], limit: float, seed: int, scale: float
) -> None:
    """Asked minus reached over all bins is the sum of the losses, and what the scale takes from bins without any."""
    f = np.random.default_rng(seed).uniform(0, 1.2 * response.frequencies_hz[-1], len(asked))
    shaped = shape(asked, frequencies_hz=f, response=response, gain_limit_v_per_m_s2=limit, scale=scale)
    inside = (f >= response.frequencies_hz[0]) & (f <= response.frequencies_hz[-1])
    reached = np.zeros(len(asked))
    if inside.any():
        reached[inside] = accelerations(shaped.coefficients_v[inside], frequencies_hz=f[inside], response=response)
    short = np.abs(asked) - np.abs(reached)
    size = np.abs(asked).sum() + response.accelerations_m_s2.max()
    free = np.abs(scale * np.abs(asked) - np.abs(reached)) <= 1e-9 * size
    losses = (shaped.saturated, shaped.outside, shaped.bounded)
    lost = sum(loss.cost_m_s2 for loss in losses)
    # A bin that a limit just touches may count either way.
    assert short[~free].sum() - 1e-9 * size <= lost <= short.sum() + 1e-9 * size
    if scale == 1:
        assert lost == pytest.approx(short.sum(), rel=1e-9, abs=1e-9 * size)
    assert sum(loss.bins for loss in losses) >= np.count_nonzero(~free)
    assert np.all(np.abs(shaped.coefficients_v) <= limit * np.abs(asked) * (1 + 1e-15))
    assert np.all(shaped.coefficients_v * np.array(asked) >= 0)


@given(
    responses(),
    st.lists(st.floats(-2e3, 2e3), min_size=1, max_size=30),
    st.floats(1e-3, 1e3),
    st.integers(0, 99),
    st.sampled_from([1.0, 0.9, 0.25, 1e-9]),
)
def test_what_is_reached_is_what_the_response_says_of_the_voltages(
    response: Response, asked: list[float], limit: float, seed: int, scale: float
) -> None:
    f = np.random.default_rng(seed).uniform(0, 1.2 * response.frequencies_hz[-1], len(asked))
    shaped = shape(asked, frequencies_hz=f, response=response, gain_limit_v_per_m_s2=limit, scale=scale)
    inside = (f >= response.frequencies_hz[0]) & (f <= response.frequencies_hz[-1])
    assert not shaped.reached_m_s2[~inside].any()
    if inside.any():
        said = accelerations(shaped.coefficients_v[inside], frequencies_hz=f[inside], response=response)
        # Of two levels that differ by a millionth of themselves nine digits are left.
        assert shaped.reached_m_s2[inside] == pytest.approx(
            said, rel=1e-9, abs=1e-9 * response.accelerations_m_s2.max()
        )
    assert np.all(np.abs(shaped.reached_m_s2) <= scale * np.abs(asked) * (1 + 1e-9))


def test_what_is_reached_by_each_cause_is_read_off_the_table() -> None:
    """At a measured frequency: free, saturated, held back by the gain, and beyond the table; then half of each asked.

    At 200 Hz 0.5, 1 and 2 V bring about 2, 4.5 and 8 m/s^2; at 500 Hz they bring about 0.25, 0.75 and 1.
    """
    asked, f = [-4.5, 20.0, -0.75, 3.0], [200.0, 200.0, 500.0, 501.0]
    whole = shape(asked, frequencies_hz=f, response=TABLE, gain_limit_v_per_m_s2=2 / 3)
    assert whole.reached_m_s2 == pytest.approx([-4.5, 8.0, -0.25, 0.0], rel=1e-15)
    assert [loss.bins for loss in losses(whole)] == [1, 1, 1]
    half = shape(asked, frequencies_hz=f, response=TABLE, gain_limit_v_per_m_s2=2 / 3, scale=0.5)
    # A quarter of a volt is half of the lowest level.
    assert half.reached_m_s2 == pytest.approx([-2.25, 8.0, -0.125, 0.0], rel=1e-15)


def test_at_a_null_nothing_is_reached() -> None:
    table = Response(np.array([100.0, 200.0]), np.array([1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 2.0]]))
    shaped = shape([1.0, -1.0], frequencies_hz=[100.0, 200.0], response=table, gain_limit_v_per_m_s2=1e3)
    assert shaped.coefficients_v.tolist() == [2.0, -1.0]
    assert shaped.reached_m_s2.tolist() == [0.0, -1.0]


@pytest.mark.parametrize("scale", [0.0, -1.0, 1.1, np.nan, np.inf])
def test_what_is_no_scale_is_refused(scale: float, refuses: Refuses) -> None:
    with refuses(SynthesisError):
        shape([1.0], frequencies_hz=[200.0], response=TABLE, gain_limit_v_per_m_s2=1.0, scale=scale)


@pytest.mark.parametrize("extreme", [5e-324, 1e-310, 1e300, 1.7e308])
def test_extreme_amplitudes_stay_finite(extreme: float) -> None:
    shaped = shape([extreme, -extreme], frequencies_hz=[150.0, 400.0], response=TABLE, gain_limit_v_per_m_s2=1e3)
    assert np.all(np.isfinite(shaped.coefficients_v))
    assert shaped.coefficients_v[0] == -shaped.coefficients_v[1] or extreme < 1
    assert np.all(np.abs(shaped.coefficients_v) <= 2.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(bad: float, refuses: Refuses) -> None:
    with refuses(SynthesisError):
        shape([1.0, bad], frequencies_hz=[1.0, 2.0], response=TABLE, gain_limit_v_per_m_s2=1.0)
    with refuses(SynthesisError):
        shape([1.0, 1.0], frequencies_hz=[1.0, bad], response=TABLE, gain_limit_v_per_m_s2=1.0)
    with refuses(SynthesisError):
        Response(F_HZ[:2], LEVELS_V[:1], np.array([[1.0], [bad]]))


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf])
def test_what_is_no_limit_is_refused(limit: float, refuses: Refuses) -> None:
    with refuses(SynthesisError):
        shaped_one(200.0, 1.0, limit=limit)


def test_shapes_that_do_not_fit_are_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        shape([1.0, 2.0], frequencies_hz=[1.0], response=TABLE, gain_limit_v_per_m_s2=1.0)
