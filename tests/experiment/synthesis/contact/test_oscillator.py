"""The damped oscillator against extended precision, over slow, fast, equal and nearly equal rates."""

from __future__ import annotations

from math import inf, sqrt

import mpmath as mp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact.oscillator import carry, falls_through_zero, moved, oscillator, parabola_rises
from palpate.experiment.synthesis.stepping.impact import Collision
from tests.experiment.synthesis.collisions import Exact

RATIOS = st.one_of(
    st.sampled_from([0.0, 1.0, 1 - 1e-3, 1 - 1e-9, 1 + 1e-9, 1 - 1e-15, 1 + 1e-15, 5.0]),
    st.floats(0.0, 5.0),
    st.floats(-8.0, 4.0).map(lambda x: 10**x),
)


@given(
    stiffness=st.floats(-2.0, 9.0),
    mass=st.floats(-6.0, 0.0),
    ratio=RATIOS,
    size=st.floats(-7.0, 1.3),
    push=st.sampled_from([0.0, 1.0, -1.0]),
)
def test_every_time_carries_a_motion_to_its_digits(
    stiffness: float, mass: float, ratio: float, size: float, push: float
) -> None:
    k, m = 10**stiffness, 10**mass
    c, w = 2 * ratio * sqrt(k * m), sqrt(k / m)
    force = push * m * w
    of = oscillator(stiffness_n_m=k, damping_n_s_m=c, mass_kg=m, force_n=force)
    t = 10**size / w
    x, u = moved(of, carry(of, t), 0.0, 1.0)
    wanted_x, wanted_u = Exact(Collision(k, c, m, 1.0, force)).motion(mp.mpf(t))
    # A phase of n radians has lost n roundings; a fast rate that is over leaves what the slow one has.
    assert abs(x - wanted_x) * w <= 3e-15 * (1 + 10**size) * max(1.0, abs(wanted_x) * w)
    assert abs(u - wanted_u) <= 3e-15 * (1 + 10**size) * max(1.0, 2 * ratio * w * abs(wanted_x))


def test_a_million_short_steps_add_up() -> None:
    of = oscillator(stiffness_n_m=4500.0, damping_n_s_m=0.0, mass_kg=1.0)
    t, n = 1e-7, 100_000
    by, x, u = carry(of, t), 0.0, 1.0
    for _ in range(n):
        x, u = moved(of, by, x, u)
    wanted_x, wanted_u = Exact(Collision(4500.0, 0.0, 1.0, 1.0)).motion(mp.mpf(t) * n)
    assert abs(x / wanted_x - 1) < 1e-13
    assert abs(u / wanted_u - 1) < 1e-13


def test_an_infinite_mass_moves_on_straight_lines() -> None:
    of = oscillator(stiffness_n_m=1e9, damping_n_s_m=10.0, mass_kg=inf)
    assert moved(of, carry(of, 3.0), 1.0, 2.0) == (7.0, 2.0)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"stiffness_n_m": -1.0}, "stiffness: got -1 N/m; allowed: a finite number of zero or more"),
        ({"stiffness_n_m": float("nan")}, "stiffness: got nan"),
        ({"damping_n_s_m": inf}, "damping: got inf N s/m"),
        ({"mass_kg": 0.0}, "mass: got 0 kg; allowed: a number above zero"),
        ({"mass_kg": float("nan")}, "mass: got nan"),
        ({"force_n": -inf}, "force: got -inf N"),
        ({"stiffness_n_m": 1e300, "mass_kg": 1e-10}, "allowed: a block that moves at a finite rate"),
    ],
)
def test_what_no_oscillator_is_made_of_is_refused(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(SynthesisError, match=words):
        oscillator(**{"stiffness_n_m": 1.0, "damping_n_s_m": 0.0, "mass_kg": 1.0, **wrong})


def test_roots_are_found_to_the_last_digit() -> None:
    assert falls_through_zero(lambda t: (2.0 - t * t, -2 * t), 0.0, 1e6) == pytest.approx(sqrt(2.0), rel=1e-15)
    assert parabola_rises(-1.0, 1e-9, 0.5) == pytest.approx(sqrt(2.0), rel=1e-8)
    assert parabola_rises(-1.0, 1e9, 1e-9) == pytest.approx(1e-9, rel=1e-15)
    assert parabola_rises(-1.0, -1.0, 0.0) == inf
