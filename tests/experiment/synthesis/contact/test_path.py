"""The exact stepper in the plane: touch, release, several blocks, hands that turn, jump and rest."""

from __future__ import annotations

from itertools import pairwise
from math import cos, inf, pi, sin, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact import exact
from palpate.experiment.synthesis.contact.block import ENTERING, FREE, Block, Motion, Switch
from palpate.experiment.synthesis.contact.exact import advance, touch
from palpate.experiment.synthesis.contact.path import Left, Trajectory, init, step, trajectory
from tests.approved import Refuses

DT = 400e-6

OFF_THE_FACE_M = st.integers(-2000, 2000).filter(bool).map(lambda um: (um + 0.1) * 1e-6)
"""At the face itself rounding decides."""


def wall(**changed: Any) -> Block:
    return Block(**{"stiffness_n_m": (2500.0, 0.0), "damping_n_s_m": (10.0, 0.0), "mass_kg": (inf, inf), **changed})


def straight(block: Block, times: np.ndarray[Any, np.dtype[np.float64]], speed: float) -> Trajectory:
    return trajectory([block], times_s=times, hand_m=np.stack([-0.001 + speed * times, 0 * times], axis=1))


def test_a_held_block_pushes_back_with_its_spring_and_damper() -> None:
    """(4): F = -K r - C dr/dt, and the hand is pushed by it, straight from the equation."""
    times = np.arange(0.0, 0.05, DT)
    made = straight(wall(), times, 0.1)
    deep = -0.001 + 0.1 * times
    wanted = np.where(deep > 0, -(2500 * deep + 10 * 0.1), 0.0)
    np.testing.assert_allclose(made.force_n[:, 0], wanted, rtol=1e-12, atol=1e-12)
    assert [(i, one.kind) for _, i, one in made.switches] == [(0, "touch")]
    at, _, one = made.switches[0]
    assert at == pytest.approx(0.01, rel=1e-13)
    assert one.deep_m_s == pytest.approx(0.1, rel=1e-13)


def test_a_hand_that_draws_back_fast_is_let_go_at_once_and_never_pulled() -> None:
    times = np.arange(0.0, 0.2, DT)
    x = 0.004 * np.sin(2 * pi * 10 * times) - 0.001
    clamped = trajectory([wall()], times_s=times, hand_m=np.stack([x, 0 * x], axis=1))
    printed = trajectory([wall(law="printed")], times_s=times, hand_m=np.stack([x, 0 * x], axis=1))
    assert clamped.force_n[:, 0].max() == 0.0
    assert printed.force_n[:, 0].max() > 0.5
    for made in (clamped, printed):
        kinds = [one.kind for _, _, one in made.switches if one.kind != "deepest"]
        assert kinds == ["touch", "release"] * 2


def test_a_block_that_is_hit_flies_off_with_the_momentum_it_was_given() -> None:
    """A hand that goes on at one speed is a wall that moves: the block leaves it at twice the speed."""
    block = wall(stiffness_n_m=(4500.0, 0.0), damping_n_s_m=(0.0, 0.0), mass_kg=(0.1, 0.1))
    state = init([block], hand_m=(-0.001, 0.0))
    for n in range(1, 400):
        state = step([block], state, hand_m=(-0.001 + 0.2 * n * DT, 0.0), dt_s=DT).state
    left = state.blocks[0]
    assert isinstance(left, Left)
    assert left.face_m_s == pytest.approx(0.4, rel=1e-13)


def test_blocks_that_nothing_touches_take_no_steps() -> None:
    blocks = [wall(face_m=(1.0, 0.0)), wall(face_m=(-1.0, 0.0), into=(-1.0, 0.0))]
    before = init(blocks, hand_m=(0.0, 0.0))
    after = step(blocks, before, hand_m=(0.1, 0.1), dt_s=DT)
    assert [one is other for one, other in zip(before.blocks, after.state.blocks, strict=True)] == [True, True]
    assert (after.force_n, after.switches) == ((0.0, 0.0), ())


@given(angle=st.floats(0.0, 2 * pi), shift=st.floats(-1.0, 1.0))
@settings(max_examples=25)
def test_the_plane_may_be_turned(angle: float, shift: float) -> None:
    into = cos(angle), sin(angle)
    values: dict[str, Any] = {
        "stiffness_n_m": (2500.0, 900.0),
        "damping_n_s_m": (10.0, 3.0),
        "mass_kg": (0.5, 0.5),
    }
    times = np.arange(0.0, 0.04, DT)
    path = np.stack([-0.00103 + 0.1 * times, 0.05 * times**2 + 0.02 * times], axis=1)
    turn = np.array([[into[0], -into[1]], [into[1], into[0]]])
    plain = trajectory([wall(**values)], times_s=times, hand_m=path)
    turned = trajectory(
        [wall(**values, into=into, face_m=(shift * into[0], shift * into[1]))],
        times_s=times,
        hand_m=path @ turn.T + shift * np.array(into),
    )
    np.testing.assert_allclose(turned.force_n, plain.force_n @ turn.T, atol=1e-9)
    assert np.abs(plain.force_n[:, 1]).max() > 0.01


@given(
    seed=st.integers(0, 1000), mass=st.sampled_from([inf, 1.0, 0.01, 1e-6]), law=st.sampled_from(["clamped", "printed"])
)
@settings(max_examples=30)
def test_samples_between_which_the_hand_goes_straight_change_nothing(seed: int, mass: float, law: str) -> None:
    rng = np.random.default_rng(seed)
    coarse = np.cumsum(rng.uniform(0.2, 3.0, 60)) * DT
    x = np.concatenate([[-0.001], -0.001 + np.cumsum(rng.normal(0.0001, 0.001, 59))])
    x[0] = -0.001
    fine = np.unique(np.concatenate([coarse, (coarse[1:] + coarse[:-1]) / 2]))
    block = wall(mass_kg=(mass, mass), law=law)
    few = trajectory([block], times_s=coarse, hand_m=np.stack([x, 0 * x], axis=1))
    between = np.interp(fine, coarse, x)
    many = trajectory([block], times_s=fine, hand_m=np.stack([between, 0 * between], axis=1))
    np.testing.assert_allclose(many.force_n[::2], few.force_n, atol=1e-7 * max(1.0, np.abs(few.force_n).max()))


@given(stiffness=st.floats(0.0, 9.0), mass=st.floats(-6.0, 0.0), ratio=st.floats(0.0, 5.0), size=st.floats(-2.0, 1.5))
def test_energy_is_never_created(stiffness: float, mass: float, ratio: float, size: float) -> None:
    k, m = 10**stiffness, 10**mass
    w = sqrt(k / m)
    block = Block((k, 0.0), (2 * ratio * sqrt(k * m), 0.0), (m, m))
    at, before = Motion(FREE, 0.0, 1.0), 1.0
    for _ in range(30):
        at, _seen = advance(block, at, 10**size / w)
        now = at.deep_m_s**2 + ((w * at.deep_m) ** 2 if at.phase else 0.0)
        assert now <= before + 1e-13
        before = now


def test_a_mass_that_is_let_go_and_pressed_back_touches_again_before_it_has_left() -> None:
    """Released while the spring is compressed; a strong force turns it round inside: K r + C dr/dt rises through 0."""
    block = Block((4500.0, 0.0), (60.0, 0.0), (0.1, 0.1))
    at, _ = advance(block, Motion(ENTERING, 0.0, 0.2), 0.0105)
    assert at.phase == FREE
    assert at.deep_m > 0
    pressed = Block((4500.0, 0.0), (60.0, 0.0), (0.1, 0.1), force_n=(50.0, 0.0))
    after, x, u = touch(pressed, at.deep_m, at.deep_m_s)
    assert 0 < after < inf
    assert x > 0
    assert 4500 * x + 60 * u == pytest.approx(0.0, abs=1e-10)


def test_a_chain_of_bounces_in_one_step_is_that_of_many() -> None:
    block = Block((4500.0, 0.0), (0.5, 0.0), (0.1, 0.1), force_n=(1.0, 0.0))
    one, seen = advance(block, Motion(FREE, 0.0, 0.2), 0.3)
    many, rest = Motion(FREE, 0.0, 0.2), list[Switch]()
    for _ in range(300):
        many, more = advance(block, many, 0.001)
        rest += more
    assert [a.kind for a in seen] == [a.kind for a in rest]
    assert [a.since_s for a in seen] == pytest.approx([a.since_s for a in rest], rel=1e-10)
    assert one.deep_m == pytest.approx(many.deep_m, rel=1e-9)


def test_endless_bounces_in_one_step_are_refused(monkeypatch: pytest.MonkeyPatch, refuses: Refuses) -> None:
    monkeypatch.setattr(exact, "MOST_SWITCHES", 500)
    block = Block((1e9, 0.0), (0.0, 0.0), (1e-6, 1e-6), force_n=(1.0, 0.0))
    with refuses(SynthesisError):
        advance(block, Motion(FREE, 0.0, 1e-3), 1.0)


@pytest.mark.parametrize(
    ("hand", "dt", "words"),
    [
        ((float("nan"), 0.0), DT, r"hand: got \(nan, 0.0\) m; allowed: finite numbers; check the tracker"),
        ((0.0, inf), DT, "hand: got"),
        ((0.0, 0.0), 0.0, "step: got 0 s; allowed: a finite time above zero"),
        ((0.0, 0.0), float("nan"), "step: got nan s"),
        ((1e308, 0.0), 1e-9, "allowed: a finite speed"),
    ],
)
def test_samples_that_are_none_are_refused(hand: tuple[float, float], dt: float, words: str) -> None:
    with pytest.raises(SynthesisError, match=words):
        step([wall()], init([wall()], hand_m=(-1.0, 0.0)), hand_m=hand, dt_s=dt)


def test_what_is_no_block_or_path_is_refused(refuses: Refuses) -> None:
    with pytest.raises(SynthesisError, match="a direction of length 1"):
        wall(into=(1.0, 1.0))
    with pytest.raises(SynthesisError, match="mass: got -1 kg"):
        wall(mass_kg=(-1.0, 1.0))
    with pytest.raises(SynthesisError, match="nominal_s: got -1"):
        wall(nominal_s=-1.0)
    with pytest.raises(SynthesisError, match="inside block 1"):
        init([wall()], hand_m=(0.1, 0.0))
    with refuses(SynthesisError):
        trajectory([wall()], times_s=[0.0, 1.0], hand_m=[[0.0, 0.0]])


@given(data=st.data())
def test_a_speed_that_is_the_difference_of_two_places_changes_nothing(data: st.DataObject) -> None:
    places = data.draw(st.lists(OFF_THE_FACE_M, min_size=2, max_size=12))
    block = wall(damping_n_s_m=(100.0, 0.0))
    told = alone = init((block,), hand_m=(-3e-3, 0.0))
    for before, place in pairwise([-3e-3, *places]):
        alone, force_n, _ = step((block,), alone, hand_m=(place, 0.0), dt_s=DT)
        told, told_n, _ = step((block,), told, hand_m=(place, 0.0), dt_s=DT, hand_m_s=((place - before) / DT, 0.0))
        assert told_n == pytest.approx(force_n, abs=1e-9)


@given(data=st.data())
def test_where_a_speed_is_told_the_force_is_the_law_at_the_place_and_speed_told(data: st.DataObject) -> None:
    """A block that is held has no memory: K r + C v where that is above zero and the hand inside, and nothing else."""
    block = wall(damping_n_s_m=(100.0, 0.0))
    state = init((block,), hand_m=(-1e-3, 0.0))
    for place, speed in data.draw(st.lists(st.tuples(OFF_THE_FACE_M, st.floats(-0.5, 0.5)), min_size=1, max_size=12)):
        state, (out_n, _), _ = step((block,), state, hand_m=(place, 0.0), dt_s=DT, hand_m_s=(speed, 0.0))
        law_n = max(2500.0 * place + 100.0 * speed, 0.0) if place > 0 else 0.0
        assert -out_n == pytest.approx(law_n, abs=1e-6)
