"""Gate and contact against trajectories whose crossings are known in closed form."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector, Scrutiny, Sifted
from palpate.experiment.protocol.models import Step

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
Heights = NDArray[np.float64]
Curve = Callable[[Heights], Heights]
Events = tuple[Gate | Contact, ...]


def samples(us: NDArray[np.int64], mm: Heights) -> Samples:
    return Samples(us, mm, b"", np.zeros(us.size, np.int64), 0)


def watch(us: NDArray[np.int64], mm: Heights, places: list[int] | None = None, step: Step = STEP) -> Events:
    """Every event, with the samples cut at `places`."""
    detector = GateDetector(step)
    state = detector.init()
    events: list[Gate | Contact] = []
    edges = [0, *sorted(place % (us.size + 1) for place in places or []), us.size]
    for a, b in pairwise(edges):
        state, more = detector.step(state, samples(us[a:b], mm[a:b]))
        events += more
    return tuple(events)


def times(seconds: float, rate_hz: int = 1000, offset_us: int = 137) -> NDArray[np.int64]:
    return np.arange(0, seconds * 1e6, 1e6 / rate_hz).astype(np.int64) + offset_us


def constant(speed_mm_s: float, from_mm: float = 30.0) -> Curve:
    """Falls at one speed and lies still on the panel."""
    return lambda t_s: np.maximum(from_mm - speed_mm_s * t_s, 0.0)


def minimum_jerk(s: Heights) -> Heights:
    """Flash and Hogan 1985: position from 0 to 1 over time from 0 to 1."""
    return 10 * s**3 - 15 * s**4 + 6 * s**5


def solved(level_mm: float, from_mm: float, to_mm: float, seconds: float) -> float:
    """When a minimum-jerk fall passes a level, s: the root of its polynomial."""
    progress = (level_mm - from_mm) / (to_mm - from_mm)
    roots = np.roots([6, -15, 10, 0, 0, -progress])
    (root,) = (r.real for r in roots if abs(r.imag) < 1e-9 and 0 <= r.real <= 1)
    return float(root) * seconds


def documented_error_us(speed_mm_s: float, slowing_mm_s2: float) -> float:
    """Bound on how early contact is put for a foot that slows down, as gate.py documents it."""
    return 1e6 * 9 * slowing_mm_s2 / (7 * speed_mm_s**3)


def path(*points: tuple[float, float]) -> Curve:
    """Straight lines between (time s, height mm)."""
    at, mm = zip(*points, strict=True)
    return lambda t_s: np.interp(t_s, at, mm)


def only(events: Events) -> tuple[Gate, Contact]:
    (gate, contact) = events
    assert isinstance(gate, Gate)
    assert isinstance(contact, Contact)
    return gate, contact


@pytest.mark.parametrize("rate_hz", [1000, 2000, 5000])
@pytest.mark.parametrize("speed_mm_s", [37.0, 50.0, 123.4, 200.0, 400.0])
def test_constant_speed_is_read_exactly(speed_mm_s: float, rate_hz: int) -> None:
    us = times(1.5, rate_hz)
    gate, contact = only(watch(us, constant(speed_mm_s)(us / 1e6)))
    assert gate.top_us == pytest.approx(10e6 / speed_mm_s, abs=1e-3)
    assert gate.bottom_us == pytest.approx(20e6 / speed_mm_s, abs=1e-3)
    assert gate.speed_mm_s == pytest.approx(speed_mm_s, rel=1e-7)
    assert contact.us == pytest.approx(30e6 / speed_mm_s, abs=1e-3)


@pytest.mark.parametrize("seconds", [0.35, 0.5, 0.8, 1.5])
def test_a_minimum_jerk_movement_is_read_to_within_its_curvature(seconds: float) -> None:
    us = times(seconds)
    gate, contact = only(watch(us, 70 - 85 * minimum_jerk(us / 1e6 / seconds)))
    top_us, bottom_us, contact_us = (solved(level, 70, -15, seconds) * 1e6 for level in (20, 10, 0))
    # A straight line between samples 1 ms apart is off by at most a h^2 / 8, with a <= 5.78 D / T^2.
    speed_mm_s = 85 / seconds
    bound_us = 5.78 * 85 / seconds**2 * 1e-6 / 8 / speed_mm_s * 1e6
    assert gate.top_us == pytest.approx(top_us, abs=bound_us)
    assert gate.bottom_us == pytest.approx(bottom_us, abs=bound_us)
    assert gate.speed_mm_s == pytest.approx(10e6 / (bottom_us - top_us), rel=1e-3)
    s = contact_us / 1e6 / seconds
    contact_mm_s = 85 / seconds * 30 * s**2 * (1 - s) ** 2
    slowing_mm_s2 = -85 / seconds**2 * 60 * s * (1 - s) * (1 - 2 * s)
    assert 0 < contact_us - contact.us < documented_error_us(contact_mm_s, slowing_mm_s2)


@pytest.mark.parametrize(("speed_mm_s", "slowing_mm_s2"), [(100.0, 500.0), (200.0, 1000.0), (400.0, 4000.0)])
def test_slowing_down_makes_contact_early_by_the_documented_error(speed_mm_s: float, slowing_mm_s2: float) -> None:
    us = times(0.4, 5000)
    t_s = us / 1e6 - 0.3
    mm = np.where(t_s < 0, -speed_mm_s * t_s + slowing_mm_s2 / 2 * t_s**2, 0.0)
    _, contact = only(watch(us, mm))
    documented_us = documented_error_us(speed_mm_s, slowing_mm_s2)
    assert documented_us / 2 < 300_000 - contact.us < documented_us


@given(st.lists(st.integers(0, 2000), max_size=40), st.integers(0, 2**31))
def test_chunks_do_not_matter(places: list[int], seed: int) -> None:
    us = times(1.2)
    rng = np.random.default_rng(seed)
    mm = path((0, 70), (0.2, 12), (0.4, 27), (0.7, 8), (0.8, 12), (0.9, 0), (1.0, 0), (1.2, 60))(us / 1e6)
    mm = mm + rng.normal(0, 0.1, us.size)
    assert watch(us, mm, places) == watch(us, mm)


@given(st.integers(0, 2**40))
def test_a_shift_in_time_shifts_the_events(shift_us: int) -> None:
    us = times(0.6)
    mm = constant(130.0)(us / 1e6) + np.random.default_rng(5).normal(0, 0.1, us.size)
    gate, contact = only(watch(us, mm))
    later_gate, later_contact = only(watch(us + shift_us, mm))
    assert later_gate.top_us - shift_us == pytest.approx(gate.top_us, abs=1e-3)
    assert later_gate.bottom_us - shift_us == pytest.approx(gate.bottom_us, abs=1e-3)
    assert later_contact.us - shift_us == pytest.approx(contact.us, abs=1e-3)


@pytest.mark.parametrize("speed_mm_s", [50.0, 100.0, 200.0, 400.0])
def test_sensor_noise_costs_little(speed_mm_s: float) -> None:
    rng = np.random.default_rng(int(speed_mm_s))
    speed_errors, contact_errors_ms = [], []
    for _ in range(300):
        us = times(0.3 + 30 / speed_mm_s, offset_us=int(rng.integers(1000)))
        mm = constant(speed_mm_s)(us / 1e6) + rng.normal(0, 0.1, us.size)
        gate, contact = only(watch(us, mm))
        speed_errors.append(gate.speed_mm_s / speed_mm_s - 1)
        contact_errors_ms.append((contact.us - 30e6 / speed_mm_s) / 1e3)
    # Two crossings, each off by at most 0.1 mm rms, in a gate of 10 mm: 1.4 % rms.
    assert abs(np.mean(speed_errors)) < 0.003
    assert np.std(speed_errors) < 0.0142
    # At 400 mm/s the line runs through six samples, 0.4 mm apart and 1.75 mm above the panel on average: at its root
    # it is off by 0.1 mm sqrt(1/6 + 1.75^2 / 2.8) = 0.112 mm rms, and by less where there are more samples.
    assert abs(np.mean(contact_errors_ms)) < 0.03e3 / speed_mm_s
    assert np.std(contact_errors_ms) < 0.125e3 / speed_mm_s


@pytest.mark.parametrize("rest_mm", [-0.3, 0.0, 0.2])
def test_noise_of_a_foot_at_rest_on_the_panel_does_not_decide_contact(rest_mm: float) -> None:
    for seed in range(50):
        us = times(0.8)
        mm = np.maximum(constant(150.0)(us / 1e6), rest_mm)
        _, contact = only(watch(us, mm + np.random.default_rng(seed).normal(0, 0.1, us.size)))
        assert contact.us == pytest.approx(200_000, abs=2500)


def test_a_pause_inside_the_gate_makes_a_slow_foot() -> None:
    us = times(1.0)
    gate, contact = only(watch(us, path((0, 30), (0.1, 15), (0.4, 15), (0.6, -15), (1, -15))(us / 1e6)))
    assert gate.speed_mm_s == pytest.approx(10e6 / (433_333.3 - 66_666.7), rel=1e-5)
    assert contact.us == pytest.approx(500_000, abs=1)


def test_a_foot_that_turns_inside_the_gate_and_rises_above_it_starts_anew() -> None:
    us = times(1.0)
    gate, contact = only(watch(us, path((0, 30), (0.1, 12), (0.3, 25), (0.5, -15), (1, -15))(us / 1e6)))
    assert gate.top_us == pytest.approx(325_000, abs=1)
    assert gate.speed_mm_s == pytest.approx(200.0, rel=1e-6)
    assert contact.us == pytest.approx(425_000, abs=1)


@pytest.mark.parametrize(("rises_to_mm", "top_us"), [(15.0, 50_000.0), (30.0, 450_000.0)])
def test_a_foot_that_left_the_gate_and_came_back_gives_a_second_gate(rises_to_mm: float, top_us: float) -> None:
    us = times(1.0)
    turn = path((0, 30), (0.1, 10 - 1e-9), (0.12, 6), (0.4, rises_to_mm), (0.4 + (rises_to_mm + 15) / 200, -15))
    first, second, contact = watch(us, turn(us / 1e6))
    assert isinstance(first, Gate)
    assert isinstance(second, Gate)
    assert first.speed_mm_s == pytest.approx(200.0, rel=1e-5)
    assert second.top_us == pytest.approx(top_us, abs=1)
    assert second.bottom_us == pytest.approx(400_000 + (rises_to_mm - 10) * 5000, abs=1)
    assert isinstance(contact, Contact)
    assert contact.us > second.bottom_us


def test_a_bounce_is_not_a_second_step_but_the_next_step_is() -> None:
    us = times(2.0)
    one = [(0.0, 30.0), (0.15, 0.0), (0.2, 0.0), (0.23, 12.0), (0.26, 0.0), (0.5, 0.0), (0.8, 40.0)]
    again = [(time + 1.0, height) for time, height in one]
    events = watch(us, path(*one, *again)(us / 1e6))
    assert [type(event) for event in events] == [Gate, Contact, Gate, Contact]
    assert isinstance(events[1], Contact)
    assert events[1].us == pytest.approx(150_000, abs=1)


def test_a_foot_that_began_inside_the_gate_must_be_lifted_first() -> None:
    us = times(0.5)
    assert watch(us, path((0, 18), (0.1, 0), (0.5, 0))(us / 1e6)) == ()


def test_a_foot_that_hovers_at_the_top_is_as_fast_as_when_it_leaves() -> None:
    us = times(1.5)
    noise = np.random.default_rng(3).normal(0, 0.1, us.size)
    gate, _ = only(watch(us, path((0, 20), (1.0, 20), (1.1, 0), (1.5, 0))(us / 1e6) + noise))
    assert gate.speed_mm_s == pytest.approx(200.0, rel=0.05)


@pytest.mark.parametrize("seed", range(10))
def test_lost_frames_do_not_move_the_crossings_of_a_steady_foot(seed: int) -> None:
    us = times(0.6)
    kept = np.random.default_rng(seed).random(us.size) > 0.6
    gate, contact = only(watch(us[kept], constant(130.0)(us[kept] / 1e6)))
    assert gate.speed_mm_s == pytest.approx(130.0, rel=1e-7)
    assert contact.us == pytest.approx(30e6 / 130.0, abs=1e-3)


def test_a_hole_over_gate_and_contact_still_gives_both() -> None:
    us = np.array([0, 1000, 150_000, 151_000], dtype=np.int64)
    gate, contact = only(watch(us, np.array([30.2, 30.0, 0.2, 0.0])))
    assert gate.speed_mm_s == pytest.approx(200.0, rel=1e-9)
    assert contact.us == pytest.approx(151_000, abs=1e-6)


def test_other_levels_of_a_protocol_are_followed() -> None:
    us = times(1.0)
    step = Step(gate_top_mm=40.0, gate_bottom_mm=4.0, contact_mm=1.0)
    gate, contact = only(watch(us, np.maximum(50 - 100 * us / 1e6, 1.0), step=step))
    assert gate.top_us == pytest.approx(100_000, abs=1e-3)
    assert gate.bottom_us == pytest.approx(460_000, abs=1e-3)
    assert contact.us == pytest.approx(490_000, abs=1e-3)


def test_no_samples_are_no_event() -> None:
    nothing = np.empty(0, dtype=np.int64)
    assert watch(nothing, np.empty(0), [0, 0]) == ()


def test_the_speed_is_known_before_the_gate_is_given_and_is_its_speed() -> None:
    us = np.arange(0, 200_000, 1000)
    mm = 25.0 - us * 100.0 / 1e6
    detector = GateDetector(STEP)
    state, known_us = detector.init(), None
    for at_us, height_mm in zip(us.tolist(), mm.tolist(), strict=True):
        one = Samples(np.array([at_us]), np.array([height_mm]), b"", np.array([0]), 0)
        state, events = detector.step(state, one)
        if known_us is None and detector.speed_mm_s(state) is not None:
            known_us = at_us
        if events:
            break
    (gate,) = events
    assert isinstance(gate, Gate)
    assert known_us == 150_000
    assert gate.given_us == pytest.approx(160_000, abs=1000)
    assert gate.speed_mm_s == detector.speed_mm_s(state) == pytest.approx(100.0)


def only_scrutiny(us: NDArray[np.int64], mm: Heights, places: list[int] | None = None) -> tuple[list[float], int]:
    """Heights that are believed, with the samples cut at `places`, and how many readings were dropped."""
    scrutiny, state, passed = Scrutiny(rate_hz=1000, noise_mm=0.01), Sifted(), list[float]()
    edges = [0, *sorted(place % (us.size + 1) for place in places or []), us.size]
    for a, b in pairwise(edges):
        state, believed = scrutiny.sift(state, samples(us[a:b], mm[a:b]))
        passed += believed.height_mm.tolist()
    return passed, state.dropped


@given(st.integers(2, 500), st.floats(-90, 90).filter(lambda mm: abs(mm) > 2), st.lists(st.integers(0, 600)))
def test_one_false_reading_is_dropped_and_nothing_else_however_samples_are_cut(
    at: int, off_mm: float, places: list[int]
) -> None:
    us = times(0.6)
    mm = constant(130.0)(us / 1e6)
    false = mm.copy()
    false[at] += off_mm
    assert only_scrutiny(us, false, places) == (np.delete(mm, at).tolist(), 1)
    assert only_scrutiny(us, mm, places) == (mm.tolist(), 0)


def test_two_false_readings_that_agree_are_believed() -> None:
    us, mm = times(0.3), np.full(300, 50.0)
    mm[[100, 101]] = 1.0
    assert only_scrutiny(us, mm) == (mm.tolist(), 0)


def test_a_lone_reading_at_the_panel_is_no_contact() -> None:
    us = times(0.5)
    mm = constant(100.0)(us / 1e6)
    false = mm.copy()
    false[np.searchsorted(us, 260_000)] = 0.3
    gate, contact = only(watch(us, false))
    assert isinstance(gate, Gate)
    assert contact == only(watch(us, mm))[1]


def fault(us: NDArray[np.int64], mm: Heights, *, missing: int = 0, rate_hz: int = 1000) -> str:
    events = watch(us, mm)
    gate, contact = events[-2:]
    assert isinstance(gate, Gate)
    assert isinstance(contact, Contact)
    path = [samples(us[at : at + 7], mm[at : at + 7]) for at in range(0, us.size, 7)]
    return Scrutiny(rate_hz=rate_hz, noise_mm=0.01).fault(path, gate, contact.given_us, missing)


@pytest.mark.parametrize("speed_mm_s", [50.0, 170.0, 400.0])
@pytest.mark.parametrize("drift", [-0.01, 0.0, 0.01])
def test_nothing_speaks_against_a_good_passage(speed_mm_s: float, drift: float) -> None:
    us = times(0.8)
    mm = constant(speed_mm_s)(us / 1e6) + np.random.default_rng(2).normal(0, 0.01, us.size)
    assert fault((us * (1 + drift)).astype(np.int64), mm) == ""


@pytest.mark.parametrize(
    ("factor", "jump_us", "missing", "told"),
    [
        (2.0, 0, 0, "times have gaps for"),
        (0.5, 0, 0, "times are 500 us apart, but at 1000 frames per second they should be 1000 us apart"),
        (1.03, 0, 0, "times are 1030 us apart"),
        (1.0, 5_000, 0, "times have gaps for 5 frames, but only 0 are missing"),
        (1.0, 20_000, 5, "times have gaps for 20 frames, but only 5 are missing"),
        (1.0, 5_000, 5, "heights jump"),
    ],
)
def test_times_that_cannot_be_are_named(factor: float, jump_us: int, missing: int, told: str) -> None:
    us = times(0.8)
    mm = constant(200.0)(us / 1e6)
    lie = (us * factor).astype(np.int64) + jump_us * (us > 75_000)
    assert told in fault(lie, mm, missing=missing)


def test_heights_that_jump_inside_the_gate_are_named() -> None:
    us = times(0.8)
    mm = constant(100.0, from_mm=40.0)(us / 1e6)
    assert "heights jump from" in fault(us, np.maximum(mm - 1.0 * (us > 250_000), 0.0))


def test_frames_missing_where_the_foot_crosses_are_named() -> None:
    us = times(0.8)
    kept = (us < 95_000) | (us > 107_000)
    told = fault(us[kept], constant(100.0)(us[kept] / 1e6), missing=13)
    (gap_ms,) = re.findall(r"\d+(?= ms)", told)
    assert gap_ms in ("13", "14")
