"""What is pushed for a path of the hand, by equation (4) alone, and that nothing unbelievable pushes at all."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import hypot, inf, nan, pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from palpate.experiment.apparatus.servo.rendering import AGAIN_MM, NO_FORCE, Rendered, Touch, bounded, step
from palpate.experiment.synthesis.contact.block import Block, Pair
from tests.benchmarks.force import felt, taps_off

K, C, DT_US = 800.0, 5.0, 500
BLOCK = Block((K, K), (C, C), (inf, inf), into=(-1.0, 0.0), nominal_s=DT_US * 1e-6)
ANY = st.floats(allow_nan=True, allow_infinity=True)


def followed(heights_mm: list[float], *, block: Block | None = BLOCK) -> tuple[list[Pair], list[Touch], Rendered]:
    at = Rendered()
    forces: list[Pair] = []
    touches: list[Touch] = []
    for n, mm in enumerate(heights_mm):
        at, touched = step(block, at, n * DT_US, (mm, 0.0))
        forces.append(at.force_n)
        touches += touched
    return forces, touches, at


def falling(speed_mm_s: float = 100.0, *, from_mm: float = 2.0, to_mm: float = -3.0) -> list[float]:
    step_mm = speed_mm_s * DT_US * 1e-6
    return [from_mm - n * step_mm for n in range(int((from_mm - to_mm) / step_mm) + 1)]


def test_a_held_block_pushes_as_equation_4_says() -> None:
    heights = falling()
    forces, touches, _ = followed(heights)
    # F = -K r - C dr/dt on the block, -F on the hand: out, along +x; the hand goes down by 0.1 m/s.
    wanted = [K * -mm * 1e-3 + C * 0.1 if mm < -1e-9 else 0.0 for mm in heights]
    assert np.allclose([out for out, _ in forces], wanted, rtol=1e-9, atol=1e-12)
    assert [along for _, along in forces] == [0.0] * len(forces)
    # 2 mm above the face, at 100 mm/s.
    (touch,) = touches
    assert touch == pytest.approx((20_000.0, 100.0, 100.0))


CROSSED = replace(BLOCK, damping_n_s_m=(40.0, 40.0), crossover_hz=20.0)


def test_a_force_below_a_crossover_is_the_law_low_passed() -> None:
    """The filter of first order, of K r + C dr/dt from the touch on, by scipy; a hand of 50 mm/s stays below 3 N."""
    heights = falling(50.0)
    forces, touches, _ = followed(heights, block=CROSSED)
    assert len(touches) == 1
    inside = [n for n, mm in enumerate(heights) if mm < 1e-9]
    turns, t = 2 * pi * 20.0, np.arange(len(inside)) * DT_US * 1e-6
    _, wanted, _ = lsim(([turns * 40.0, turns * K], [1.0, turns, 0.0]), np.full(t.size, 0.05), t)
    assert np.allclose([forces[n][0] for n in inside], wanted, rtol=1e-3, atol=5e-3)
    assert [along for _, along in forces] == [0.0] * len(forces)


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.sampled_from([7.0, 20.0, 200.0]))
def test_a_force_below_a_crossover_stays_within_its_limit_and_gives_no_energy(seed: int, hz: float) -> None:
    """A hand of any path, which begins and ends outside: work of the mean force from sample to sample, finely sampled.

    800 N/m and 40 N s/m let a crossover of 3.2 Hz be passive. A limit of 0.5 N is often reached.
    """
    rng, us = np.random.default_rng(seed), 50
    knots = np.concatenate([[2.0], rng.uniform(-2.0, 0.5, 6), [2.0]])
    heights = np.interp(np.arange(0.0, 7.0, 0.005), np.arange(8.0), knots)
    at, forces = Rendered(), []
    for n, mm in enumerate(heights.tolist()):
        at, _ = step(replace(CROSSED, crossover_hz=hz), at, n * us, (mm, 3.0 * mm), limit_n=0.5)
        forces.append(at.force_n[0])
    assert min(forces) >= 0.0
    assert max(forces) <= 0.5
    pushed = np.array(forces)
    given_j = np.cumsum((pushed[1:] + pushed[:-1]) / 2 * np.diff(heights) * 1e-3)
    assert given_j.max() <= 1e-5


def test_a_planar_hand_is_pushed_along_the_face_too() -> None:
    """It comes down at 100 mm/s and slides at 50: the spring along the face begins where the hand touched."""
    at, forces = Rendered(), []
    heights = falling()
    for n, mm in enumerate(heights):
        at, _ = step(BLOCK, at, n * DT_US, (mm, 5.0 + 50.0 * n * DT_US * 1e-6))
        forces.append(at.force_n)
    slid_mm = [-mm / 2 for mm in heights]
    wanted = [-K * slid * 1e-3 - C * 0.05 if slid > 1e-9 else 0.0 for slid in slid_mm]
    assert np.allclose([along for _, along in forces], wanted, rtol=1e-9, atol=1e-12)
    assert [out for out, _ in forces] == pytest.approx([out for out, _ in followed(heights)[0]])


@given(
    st.floats(0.0, 3000.0),
    st.floats(0.0, 120.0),
    st.floats(-150.0, 150.0),
    st.floats(-20.0, 20.0),
    st.integers(0, 10**6),
)
def test_the_force_along_the_face_is_that_of_its_own_spring_and_damper(
    k: float, c: float, along_mm_s: float, begins_mm: float, begins_us: int
) -> None:
    """By equation (4) for the second axis of K and C: -K y - C dy/dt, y counted from where the hand touched."""
    block = Block((K, k), (C, c), (inf, inf), into=(-1.0, 0.0), nominal_s=DT_US * 1e-6)
    at, down_mm_s, touched_us = Rendered(), 100.0, 20_000
    touches: list[Touch] = []
    for n in range(60):
        us = n * DT_US
        at, touched = step(block, at, begins_us + us, (2.0 - down_mm_s * us * 1e-6, begins_mm + along_mm_s * us * 1e-6))
        touches += touched
        inside_s = (us - touched_us) * 1e-6
        wanted = -k * along_mm_s * 1e-3 * inside_s - c * along_mm_s * 1e-3 if inside_s > 1e-9 else 0.0
        if abs(inside_s) > 1e-9:
            assert at.force_n[1] == pytest.approx(wanted, rel=1e-7, abs=1e-9)
    assert at.speed_mm_s == pytest.approx(hypot(down_mm_s, along_mm_s))
    assert [one.mean_mm_s for one in touches] == pytest.approx([hypot(down_mm_s, along_mm_s)])


def test_a_hand_that_slides_over_the_face_and_stays_above_it_is_fast_and_feels_nothing() -> None:
    at = Rendered()
    for n in range(50):
        at, _ = step(BLOCK, at, n * DT_US, (1.0, 300.0 * n * DT_US * 1e-6))
    assert at.speed_mm_s == pytest.approx(300.0)
    assert at.force_n == NO_FORCE


def test_nothing_is_pushed_without_a_block_or_beside_it() -> None:
    assert set(followed(falling(), block=None)[0]) == {NO_FORCE}
    assert set(followed(falling(to_mm=0.5))[0]) == {NO_FORCE}


@pytest.mark.parametrize("bad", [nan, inf, -inf, 1e300, -50.0])
def test_a_sample_that_cannot_be_silences_until_the_hand_is_outside(bad: float) -> None:
    down = falling(to_mm=-2.0)
    forces, touches, _ = followed([*down, bad, *[-2.0] * 5])
    assert any(forces[len(down) - 1])
    assert forces[len(down) :] == [NO_FORCE] * 6
    assert len(touches) == 1
    up = down[::-1]
    forces, touches, _ = followed([*down, bad, *[-2.0] * 5, *up, *down])
    assert any(forces[-1])
    assert len(touches) == 2


@pytest.mark.parametrize("later_us", [0, -500, 10_000, 10**9])
def test_a_time_that_cannot_be_silences(later_us: int) -> None:
    _, _, at = followed(falling())
    assert any(at.force_n)
    after, touches = step(BLOCK, at, (at.us or 0) + later_us, (-3.0, 0.0))
    assert (after.force_n, after.state, touches) == (NO_FORCE, None, ())


def test_a_hand_that_begins_inside_is_pushed_only_after_it_was_outside() -> None:
    assert set(followed([-2.0] * 50)[0]) == {NO_FORCE}
    assert any(followed([-2.0, -1.0, 0.5, *falling(from_mm=0.5)])[0][-1])


@pytest.mark.parametrize("last_mm", [0.01, 0.5])
def test_a_hand_that_touches_in_the_sample_after_a_fault_is_pushed_and_counts(last_mm: float) -> None:
    """A cycle came late, with nothing rendered of before: the path from the sample before begins outside."""
    _, _, at = followed(falling(to_mm=last_mm))
    at, touches = step(BLOCK, at.silent(), (at.us or 0) + DT_US, (-0.03, 0.0))
    assert len(touches) == 1
    assert at.force_n[0] > K * 0.03e-3


@pytest.mark.parametrize("bad_mm", [nan, 1e300])
def test_a_touch_counts_after_a_sample_that_cannot_be_near_the_face(bad_mm: float) -> None:
    forces, touches, _ = followed([*falling(to_mm=0.5), bad_mm, *falling(from_mm=0.4)])
    assert any(forces[-1])
    assert len(touches) == 1


def test_a_hand_that_trembles_inside_touches_once() -> None:
    """The damper lets go of a hand that goes back faster than K r / C, and catches it again."""
    trembling = [-0.2 + 0.05 * (-1) ** n for n in range(100)]
    _, touches, _ = followed([*falling(to_mm=-0.2), *trembling, *[AGAIN_MM / 2] * 3, *falling(from_mm=0.5)])
    assert len(touches) == 1
    assert len(followed([*falling(to_mm=-0.2), AGAIN_MM * 1.5, *falling(from_mm=1.5)])[1]) == 2


def test_the_speed_is_a_mean_over_five_milliseconds() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.01, 400)
    heights = [30.0 - n * 0.1 + noise[n] for n in range(400)]
    assert followed(heights)[2].speed_mm_s == pytest.approx(200.0, abs=10.0)


@given(ANY, ANY, st.floats(min_value=1e-3, max_value=50.0))
def test_no_force_is_above_the_limit_whatever_comes_in(x: float, y: float, limit_n: float) -> None:
    assert _size(bounded((x, y), limit_n)) <= limit_n


@pytest.mark.parametrize("limit_n", [0.0, -1.0, nan])
def test_a_limit_that_is_none_allows_no_force(limit_n: float) -> None:
    assert bounded((1.0, 1.0), limit_n) == NO_FORCE


def test_the_force_out_of_the_block_comes_first_within_the_limit() -> None:
    assert bounded((0.3, 0.4), 1.0) == (0.3, 0.4)
    assert bounded((0.6, -40.0), 1.0) == pytest.approx((0.6, -0.8))
    assert bounded((30.0, 40.0), 1.0) == pytest.approx((1.0, 0.0), abs=1e-3)


def dragged(path_mm: list[Pair], *, limit_n: float = 3.0) -> list[Pair]:
    """Return the force sent at each place of a path that begins above the face, a sample a place."""
    block = Block((2500.0, 2500.0), (0.0, 0.0), (inf, inf), into=(-1.0, 0.0))
    at, forces = Rendered(), []
    for n, place_mm in enumerate(path_mm):
        at, _ = step(block, at, n * DT_US, place_mm, None, NO_FORCE, limit_n)
        forces.append(bounded(at.force_n, limit_n))
    return forces


def straight(begin: Pair, end: Pair, n: int = 400) -> list[Pair]:
    return [(begin[0] + (end[0] - begin[0]) * i / n, begin[1] + (end[1] - begin[1]) * i / n) for i in range(1, n + 1)]


def test_a_hand_that_is_dragged_along_the_face_feels_all_of_the_force_out_of_it() -> None:
    """Half a millimetre inside of 2500 N/m is 1.25 N; the face has what that leaves of 3 N."""
    forces = dragged([*straight((1.0, 0.0), (-0.5, 0.0)), *straight((-0.5, 0.0), (-0.5, 10.0))])
    assert forces[-1] == pytest.approx((1.25, -((9 - 1.25**2) ** 0.5)), rel=1e-6)
    back = dragged([*straight((1.0, 0.0), (-0.5, 0.0)), *straight((-0.5, 0.0), (-0.5, 10.0)), (-0.5, 9.5), (-0.5, 8.5)])
    # The spring was stretched by 1.09 mm, and begins there.
    assert [along for _, along in back[-2:]] == pytest.approx([-2.7271 + 1.25, -2.7271 + 3.75], rel=1e-3)


def test_no_way_round_along_the_face_takes_energy_from_the_limit() -> None:
    """Drawn out while pressed hard, where nothing is left for the face, and let back where much is."""
    deep, light = -1.2, -0.1
    around = [(deep, 0.0), (deep, 8.0), (light, 8.0), (light, -2.0), (deep, -2.0), (deep, 0.0)]
    path = straight((1.0, 0.0), around[0])
    begins = len(path)
    for one, other in pairwise(around):
        path += straight(one, other)
    forces = dragged(path)
    given_mj = [
        (x * (at[0] - was[0]) + y * (at[1] - was[1]))
        for (x, y), was, at in zip(forces[begins:], path[begins - 1 : -1], path[begins:], strict=True)
    ]
    assert sum(given_mj) < 0.0


@given(st.lists(st.tuples(st.integers(-(2**40), 2**40), ANY, ANY), max_size=30))
def test_any_samples_at_all_push_no_more_than_the_limit(samples: list[tuple[int, float, float]]) -> None:
    at = Rendered()
    for us, x, y in samples:
        at, _ = step(BLOCK, at, us, (x, y))
        assert _size(bounded(at.force_n, 2.0)) <= 2.0


def _size(force_n: Pair) -> float:
    """How large a force is in single precision, as the device is given it."""
    return hypot(float(np.float32(force_n[0])), float(np.float32(force_n[1])))


def test_a_hand_that_the_force_moves_rests_inside_and_is_not_shaken() -> None:
    """Half a millimetre inside of 2500 N/m is 1.25 N; the difference of two samples shakes it by 92 %."""
    for late in (0, 1):
        still = felt(0.1, lasts_s=0.5, damping_n_s_m=1.0, late=late).held_n
        assert still.mean() == pytest.approx(1.25, rel=0.01)
        assert 0 < still.std() < 0.06 * 1.25
        assert still.min() > 0


def test_a_tap_is_within_seven_tenths_of_the_law() -> None:
    assert 0 < taps_off(0.05, 100, 2) < 0.7
