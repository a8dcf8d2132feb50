"""Predicted contact against conditioning a Gaussian process, closed forms and the model's own draws."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker import landing as landings
from palpate.experiment.apparatus.tracker.gate import Contact, Gate
from palpate.experiment.apparatus.tracker.landing import (
    FIRST_MM_S,
    SLOWEST_MM_S,
    WANDER_MM,
    Falling,
    Landing,
    LandingPredictor,
)
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.wires import foot
from tests.benchmarks.ruler import ruled, sensed

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
Heights = NDArray[np.float64]
Curve = Callable[[Heights], Heights]


def follow(predictor: LandingPredictor, us: NDArray[np.int64], mm: Heights) -> list[Falling | None]:
    states = [predictor.init()]
    for at_us, height_mm in zip(us.tolist(), mm.tolist(), strict=True):
        states.append(predictor.step(states[-1], at_us, height_mm))
    return states[1:]


def expected(predictor: LandingPredictor, us: NDArray[np.int64], mm: Heights, *, lead_ms: float) -> Landing:
    """The last prediction that is made at least `lead_ms` before the contact that it names."""
    landings = [predictor.landing(state) for state in follow(predictor, us, mm) if state is not None]
    return [one for one in landings if one is not None and one.us - one.from_us >= lead_ms * 1e3][-1]


def times(seconds: float, rate_hz: int = 1000, offset_us: int = 137) -> NDArray[np.int64]:
    return np.arange(0, seconds * 1e6, 1e6 / rate_hz).astype(np.int64) + offset_us


def gate(speed_mm_s: float) -> Gate:
    return Gate(0.0, 10e6 / speed_mm_s, speed_mm_s, 0)


@pytest.mark.parametrize("noise_mm", [0.01, 0.1, 0.5])
def test_the_filter_is_gaussian_conditioning_on_all_samples_at_once(noise_mm: float) -> None:
    # Slower than the slowest scale, so that the wander has one density throughout.
    rng = np.random.default_rng(1)
    seconds = np.sort(rng.choice(np.arange(1, 900), 40, replace=False)) / 1e3
    seconds -= seconds[0]
    mm = 18.0 - 10.0 * seconds + rng.normal(0, noise_mm, seconds.size)
    predictor = LandingPredictor(STEP, noise_mm=noise_mm)
    slow = Falling(0, mm[0], -10.0, 0.0, noise_mm**2, 0, 0, 4.0, 0, 9.0)
    state: Falling | None = slow
    for at_s, height_mm in zip(seconds[1:], mm[1:], strict=True):
        state = predictor.step(state, round(at_s * 1e6), float(height_mm))
    assert state is not None
    # Covariance of the height at s and t: prior of height, speed and acceleration, and white jerk integrated thrice.
    q = SLOWEST_MM_S**5 / WANDER_MM**3
    s, t = seconds[1:, None], seconds[None, 1:]
    early = np.minimum(s, t)
    wander = q * (early**5 / 20 + np.abs(s - t) * early**4 / 8 + (s - t) ** 2 * early**3 / 12)
    prior = noise_mm**2 + 4.0 * s * t + 9.0 * s**2 * t**2 / 4
    whole = wander + prior + noise_mm**2 * np.eye(seconds.size - 1)
    now = (wander + prior)[-1]
    mean_mm = mm[0] - 10.0 * seconds[1:]
    assert state.mm == pytest.approx(mean_mm[-1] + now @ np.linalg.solve(whole, mm[1:] - mean_mm), abs=1e-7)
    assert state.hh == pytest.approx((wander + prior)[-1, -1] - now @ np.linalg.solve(whole, now), rel=1e-6)


@pytest.mark.parametrize("speed_mm_s", [50.0, 130.0, 400.0])
@pytest.mark.parametrize("rate_hz", [1000, 5000])
def test_a_steady_foot_without_noise_is_predicted_exactly(speed_mm_s: float, rate_hz: int) -> None:
    us = times(30 / speed_mm_s, rate_hz)
    landing = expected(LandingPredictor(STEP, noise_mm=0.0), us, 30 - speed_mm_s * (us / 1e6), lead_ms=12)
    assert landing.us == pytest.approx(30e6 / speed_mm_s, abs=3)
    assert 12_000 <= landing.us - landing.from_us < 12_000 + 1e6 / rate_hz + 3


@pytest.mark.parametrize("slowing_part", [-1.0, 0.5, 1.0])
@pytest.mark.parametrize("speed_mm_s", [50.0, 130.0, 400.0])
def test_a_foot_of_steady_deceleration_is_predicted_to_within_what_is_unknown_of_its_acceleration(
    speed_mm_s: float, slowing_part: float
) -> None:
    # v^2 falls by at most half from the top of the gate to the panel, or rises by as much.
    slowing_mm_s2 = slowing_part * speed_mm_s**2 / 4 / 20
    contact_s = (speed_mm_s - np.sqrt(speed_mm_s**2 - 2 * slowing_mm_s2 * 20)) / slowing_mm_s2
    us = times(contact_s)
    mm = 20 - speed_mm_s * us / 1e6 + slowing_mm_s2 / 2 * (us / 1e6) ** 2
    landing = expected(LandingPredictor(STEP, noise_mm=0.0), us, mm, lead_ms=12)
    assert landing.us == pytest.approx(contact_s * 1e6, abs=10)


def wandering(rng: np.random.Generator, speed_mm_s: float, rate_hz: int = 1000) -> tuple[NDArray[np.int64], Heights]:
    """A foot whose acceleration wanders as the filter supposes, from 20 mm to below the panel."""
    step_s = 1 / rate_hz
    mm, mm_s, mm_s2 = 20.0, -speed_mm_s, float(rng.normal(0, speed_mm_s**2 / WANDER_MM / 2))
    heights: list[float] = []
    while mm > 0 and len(heights) < 3000:
        heights.append(mm)
        jump = rng.normal(0, np.sqrt(max(-mm_s, SLOWEST_MM_S) ** 5 / WANDER_MM**3 * step_s))
        mm += mm_s * step_s + mm_s2 * step_s**2 / 2
        mm_s += mm_s2 * step_s
        mm_s2 += jump
    part = heights[-1] / (heights[-1] - mm)
    return times(len(heights) * step_s, rate_hz, 0)[: len(heights)], np.append(heights, part)


@pytest.mark.parametrize("noise_mm", [0.02, 0.1])
def test_errors_are_as_large_as_their_standard_error_says(noise_mm: float) -> None:
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(500):
        us, drawn = wandering(rng, float(rng.uniform(50, 400)))
        if us.size > 1000:
            # An eighth of such feet come to rest above the panel instead.
            continue
        contact_us = us[-1] + drawn[-1] * 1000
        mm = drawn[:-1] + rng.normal(0, noise_mm, us.size)
        predictor = LandingPredictor(STEP, noise_mm=noise_mm)
        landing = expected(predictor, us, mm, lead_ms=12)
        errors.append((landing.us - contact_us) / landing.standard_error_us)
    # 400 draws: the standard deviation of unit normals is known to 3.5 %; a root of a parabola is not quite normal.
    assert len(errors) > 400
    assert abs(np.mean(errors)) < 0.15
    assert 0.85 < np.std(errors) < 1.15


@given(st.floats(50, 400), st.integers(0, 2**31), st.integers(0, 2**40))
def test_a_shift_in_time_and_the_unit_of_distance_do_not_matter(speed_mm_s: float, seed: int, shift_us: int) -> None:
    us = times(21 / speed_mm_s, offset_us=0)
    mm = 20 - speed_mm_s * us / 1e6 + np.random.default_rng(seed).normal(0, 0.1, us.size)
    here = follow(LandingPredictor(STEP, noise_mm=0.1), us, mm)
    there = follow(LandingPredictor(STEP, noise_mm=0.1), us + shift_us, mm)
    raised = STEP.model_copy(update={"gate_top_mm": 22.0, "gate_bottom_mm": 12.0, "contact_mm": 2.0})
    above = follow(LandingPredictor(raised, noise_mm=0.1), us, mm + 2)
    for one, later, higher in zip(here, there, above, strict=True):
        assert (one is None) == (later is None)
        if one is not None and later is not None and higher is not None:
            assert later.us - one.us == shift_us
            assert later[1:] == one[1:]
            assert higher[1:] == pytest.approx(one[1:], rel=1e-6, abs=1e-6)


def test_above_the_gate_nothing_is_followed_and_a_foot_that_goes_back_starts_anew() -> None:
    predictor = LandingPredictor(STEP, noise_mm=0.1)
    assert predictor.step(None, 0, 20.5) is None
    state = predictor.step(None, 0, 19.0)
    assert state is not None
    assert (state.mm, state.mm_s) == (19.0, -FIRST_MM_S)
    assert predictor.step(state, 1000, 20.5) is None


def test_a_rising_foot_is_not_predicted_to_land() -> None:
    predictor = LandingPredictor(STEP, noise_mm=0.1)
    us = times(0.05)
    state = follow(predictor, us, 5 + 100 * us / 1e6)[-1]
    assert state is not None
    assert predictor.landing(state) is None


def test_a_foot_that_will_stop_above_the_panel_comes_no_earlier_than_its_speed_allows() -> None:
    state = Falling(0, 5.0, -100.0, 2000.0, 1e-4, 0, 0, 1.0, 0, 1.0)
    landing = LandingPredictor(STEP, noise_mm=0.1).landing(state)
    assert landing is not None
    assert landing.us == pytest.approx(50_000)


def path(*points: tuple[float, float]) -> Curve:
    """Straight lines between (time s, height mm)."""
    at, mm = zip(*points, strict=True)
    return lambda t_s: np.interp(t_s, at, mm)


def said(curve: Curve, speed_mm_s: float, *, noise_mm: float = 0.1, seed: int = 0) -> tuple[str, float]:
    """What is said of a foot first, and the time at which it is, s."""
    us = times(1.0)
    mm = curve(us / 1e6) + np.random.default_rng(seed).normal(0, noise_mm, us.size)
    predictor = LandingPredictor(STEP, noise_mm=noise_mm)
    for state in follow(predictor, us, mm):
        if state is not None and state.mm < 9 and (reason := predictor.hesitates(state, gate(speed_mm_s))):
            return reason, state.us / 1e6
    return "", np.inf


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("speed_mm_s", [50.0, 100.0, 200.0, 400.0])
@pytest.mark.parametrize("back_part", [0.0, 1.0])
def test_a_foot_that_stops_or_turns_back_is_noticed(speed_mm_s: float, back_part: float, seed: int) -> None:
    # From 20 mm to 5 mm at one speed; then it stays, or goes back as fast as it came.
    turn_s = 15 / speed_mm_s
    reason, at_s = said(
        path((0, 20), (turn_s, 5), (turn_s + 0.3, 5 + back_part * speed_mm_s * 0.3)), speed_mm_s, seed=seed
    )
    assert reason in (landings.STOPPED, landings.TURNED_BACK)
    # It is noticed within a travel far below the one over which the filter forgets.
    assert turn_s < at_s < turn_s + 8 / speed_mm_s


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("speed_mm_s", [25.0, 50.0, 150.0, 400.0])
def test_a_foot_that_lands_is_not_said_to_hesitate(speed_mm_s: float, seed: int) -> None:
    """It slows down from the bottom of the gate on, to half of its speed at the panel."""
    bottom_s, slow_s = 10 / speed_mm_s, 10 / (0.75 * speed_mm_s)
    deceleration = 0.5 * speed_mm_s / slow_s

    def curve(t_s: Heights) -> Heights:
        after = np.clip(t_s - bottom_s, 0, slow_s)
        return 20 - speed_mm_s * np.minimum(t_s, bottom_s) - speed_mm_s * after + deceleration / 2 * after**2

    us = times(bottom_s + slow_s)
    mm = curve(us / 1e6) + np.random.default_rng(seed).normal(0, 0.1, us.size)
    predictor = LandingPredictor(STEP, noise_mm=0.1)
    reasons = {predictor.hesitates(s, gate(speed_mm_s)) for s in follow(predictor, us, mm) if s and s.mm < 9}
    assert reasons == {""}


def test_a_foot_above_the_gate_again_has_turned_back() -> None:
    assert LandingPredictor(STEP, noise_mm=0.1).hesitates(None, gate(100.0)) == landings.TURNED_BACK


def test_predictions_come_closer_as_the_foot_does() -> None:
    rng = np.random.default_rng(4)
    spread = []
    for lead_ms in (20.0, 10.0, 5.0):
        errors_us = []
        for _ in range(200):
            us = times(0.2, offset_us=int(rng.integers(1000)))
            mm = 25 - 150 * us / 1e6 + rng.normal(0, 0.1, us.size)
            errors_us.append(expected(LandingPredictor(STEP, noise_mm=0.1), us, mm, lead_ms=lead_ms).us - 25e6 / 150)
        spread.append(float(np.std(errors_us)))
    assert all(later < earlier for earlier, later in pairwise(spread))


@pytest.mark.parametrize(("noise_mm", "spread_ms"), [(0.1, 1.0), (0.0, 0.1)])
def test_onset_against_true_contact_over_500_steps(noise_mm: float, spread_ms: float) -> None:
    """Feet of 50-400 mm/s at 1 kHz; a stimulus that can be moved until 12 ms before its onset.

    A standard deviation of 500 draws is known to 3 %. The benchmark `onset` has 2,000 feet.
    """
    rng = np.random.default_rng(6)
    predictor = LandingPredictor(STEP, noise_mm=noise_mm)
    errors_ms = []
    for speed_mm_s in rng.uniform(50, 400, 500):
        step = foot.trajectory(rng, float(speed_mm_s), hesitation="none")
        us = np.arange(int(step.gate_top_us) - int(rng.integers(1000)), int(step.contact_us), 1000)
        mm = step.at(us.astype(np.float64)) + rng.normal(0, noise_mm, us.size)
        errors_ms.append((expected(predictor, us, mm, lead_ms=12).us - step.contact_us) / 1e3)
    assert abs(np.mean(errors_ms)) < 0.2
    assert np.std(errors_ms) < spread_ms


def recorded(us: NDArray[np.int64], mm: Heights, *, noise_mm: float) -> Landing:
    found = ruled(LandingPredictor(STEP, noise_mm=noise_mm), us, mm)
    assert found is not None
    return found.recorded


@pytest.mark.parametrize(
    ("noise_mm", "bias_ms", "sd_ms", "slow_ms", "worst_ms"),
    [(0.1, 0.05, 0.42, 0.65, 2.0), (0.0, 0.05, 0.05, 0.05, 0.1)],
)
def test_contact_as_recorded_is_nearer_to_the_truth_than_what_it_judges(
    noise_mm: float, bias_ms: float, sd_ms: float, slow_ms: float, worst_ms: float
) -> None:
    # The truth is where a simulated reach meets the panel. The bounds are those set for the ruler; the benchmark
    # `ruler` has 2,000 feet. A bias of 250 draws is known to 0.02 ms, a standard deviation to 5 %.
    rng = np.random.default_rng(11)
    errors_ms, in_errors = [], []
    speeds = np.concatenate([rng.uniform(50, 100, 50), rng.uniform(100, 400, 200)])
    for speed_mm_s in speeds.tolist():
        step = foot.trajectory(rng, speed_mm_s, hesitation="none")
        met = recorded(*sensed(rng, step, noise_mm=noise_mm, rate_hz=1000), noise_mm=noise_mm)
        errors_ms.append((met.us - step.contact_us) / 1e3)
        in_errors.append((met.us - step.contact_us) / met.standard_error_us)
    assert abs(np.mean(errors_ms)) < bias_ms
    assert np.std(errors_ms) < sd_ms
    assert np.std(errors_ms[:50]) < slow_ms
    assert np.max(np.abs(errors_ms)) < worst_ms
    # Positions without noise are taken to have a little, so that they are better than they say.
    assert np.std(in_errors) < 1.1
    if noise_mm:
        assert np.std(in_errors) > 0.85


@pytest.mark.parametrize("rest_mm", [-5.0, -0.3, 0.0])
@pytest.mark.parametrize("seconds", [0.35, 0.8, 1.5])
def test_contact_of_a_minimum_jerk_reach_is_the_root_of_its_polynomial_whatever_stops_it(
    seconds: float, rest_mm: float
) -> None:
    # Flash and Hogan 1985: 10 s^3 - 15 s^4 + 6 s^5, from 70 mm to 15 mm below the panel, stopped at once at `rest_mm`.
    (root,) = (r.real for r in np.roots([6, -15, 10, 0, 0, -70 / 85]) if abs(r.imag) < 1e-9 and 0 <= r.real <= 1)
    us = times(seconds)
    s = us / 1e6 / seconds
    mm = np.maximum(70 - 85 * (10 * s**3 - 15 * s**4 + 6 * s**5), rest_mm)
    assert recorded(us, mm, noise_mm=0.0).us == pytest.approx(root * seconds * 1e6, abs=50)


def test_a_foot_that_hovers_over_the_panel_is_not_said_to_have_met_it_at_a_known_moment() -> None:
    # From 100 mm/s it is braked steadily and comes to a halt at 0.3 mm, 0.4 s after it was at 20.3 mm.
    us = times(1.0)
    left_s = np.maximum(0.4 - us / 1e6, 0.0)
    met = recorded(us, 0.3 + 20.0 * (left_s / 0.4) ** 2, noise_mm=0.003)
    assert met.standard_error_us == pytest.approx(50_000 / np.sqrt(12))
    assert 350_000 < met.us < 450_000


def test_a_contact_without_a_passage_that_can_be_followed_is_where_it_was_seen() -> None:
    predictor, contact = LandingPredictor(STEP, noise_mm=0.1), Contact(us=151_000.0, given_us=150_000)
    touch = predictor.touching(None, contact)
    assert touch.landing.us == 151_000.0
    assert touch.landing.standard_error_us == pytest.approx(50_000 / np.sqrt(12))
    touch = predictor.touch(touch, 150_000, 0.2, contact)
    assert not touch.done
    assert predictor.touch(touch, 300_000, -0.1, contact).done
