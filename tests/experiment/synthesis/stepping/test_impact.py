"""One impact: against its closed form, and against extended precision under any force."""

from __future__ import annotations

import json
from dataclasses import replace
from math import acos, exp, pi, sin, sqrt
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.stepping.impact import Collision, answer, closed_form, condition, in_steps
from palpate.experiment.synthesis.stepping.steppers import STEPPERS
from tests.approved import Refuses
from tests.experiment.synthesis.collisions import Exact
from tests.experiment.synthesis.contact.test_oscillator import RATIOS

CLAIMED = 1e-11


@st.composite
def collisions(draw: st.DrawFn) -> Collision:
    k = draw(
        st.one_of(st.just(0.0), st.floats(-2.0, 9.0).map(lambda x: 10**x), st.floats(0.0, 9.0).map(lambda x: 10**x))
    )
    m, v = 10 ** draw(st.floats(-6.0, 0.0)), 10 ** draw(st.floats(-3.0, 0.5))
    c = 2 * draw(RATIOS) * sqrt(k * m) if k else draw(st.sampled_from([0.0, 1e-3, 0.1, 100.0]))
    size = v * (sqrt(k * m) + c + 1e-9)
    force = size * draw(st.sampled_from([0.0, 1.0, -1.0])) * 10 ** draw(st.floats(-6.0, 4.0))
    return Collision(k, c, m, v, force, draw(st.sampled_from(["clamped", "printed"])))


@given(of=collisions())
@settings(max_examples=60)
def test_an_impact_is_right_to_its_digits(of: Collision) -> None:
    made, exact = closed_form(of), Exact(of)
    if made.release_s is None:
        assert made.why
        slowest = of.frequency_rad_s or of.block.normal.decay_per_s or 1.0
        for n in range(1, 60):
            assert exact.falls(mp.mpf(20) / slowest * n / 60) > -(mp.mpf(10) ** -25)
        return
    for n in range(1, 40):
        assert exact.falls(mp.mpf(made.release_s) * n / 41) > 0
    number = max(1.0, condition(of))
    assume(number < 1e3)
    wanted = exact.release(made.release_s)
    assert wanted is not None
    x, u = exact.motion(wanted)
    assert abs(made.release_s / wanted - 1) <= CLAIMED * number
    if made.rebound_m_s is not None and abs(u) > 1e-30 * of.speed_m_s:
        assert abs(made.rebound_m_s / abs(u) - 1) <= CLAIMED * number
    assert made.penetration_m is not None
    assert made.peak_s is not None
    assert abs(made.penetration_m / exact.motion(mp.mpf(made.peak_s))[0] - 1) <= CLAIMED * number
    assert made.left_in_spring_j == pytest.approx(float(exact.k * x * x / 2 if not exact.printed else 0), rel=1e-9)


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.5, 0.95])
def test_the_closed_form_is_the_printed_one(ratio: float) -> None:
    """Release after 2 phi / (w sin phi) at v exp(-2 z phi / sin phi), by hand from dr/dt and K r + C dr/dt."""
    k, m, v = 4500.0, 0.1, 0.2
    made, phi = closed_form(Collision(k, 2 * ratio * sqrt(k * m), m, v)), acos(ratio)
    assert made.release_s == pytest.approx(2 * phi / (sqrt(k / m) * sin(phi)), rel=1e-14)
    assert made.rebound_m_s == pytest.approx(v * exp(-2 * ratio * phi / sin(phi)), rel=1e-14)


@pytest.mark.parametrize(
    ("stiffness", "mass", "speed", "ratio"),
    [
        (1e300, 1e-3, 1e6, 0.3004),
        (1e300, 1e-3, 1e6, 0.05),
        (1e-300, 1e3, 1e-9, 0.999999999999),
        (1e-300, 1e3, 1e-9, 0.0),
        (1e308, 1e-300, 1e100, 0.5),
        (1e-200, 1e-250, 1e150, 0.9),
    ],
)
def test_the_ends_of_the_range_keep_their_digits(stiffness: float, mass: float, speed: float, ratio: float) -> None:
    """The printed closed form, in 60 digits, of the numbers as they came in."""
    damping = 2 * ratio * sqrt(stiffness) * sqrt(mass)
    made = answer(Collision(stiffness, damping, mass, speed), rate_hz=2500.0)
    with mp.workdps(60):
        w = mp.sqrt(mp.mpf(stiffness) / mp.mpf(mass))
        z = mp.mpf(damping) / (2 * mp.mpf(mass) * w)
        phi = mp.acos(z)
        release, rebound = 2 * phi / (w * mp.sin(phi)), speed * mp.exp(-2 * z * phi / mp.sin(phi))
        penetration = speed / w * mp.exp(-z * phi / mp.sin(phi))
        assert made.condition is not None
        assert made.condition < 4
        assert made.impact.release_s == pytest.approx(float(release), rel=1e-14, abs=0.0)
        assert made.impact.rebound_m_s == pytest.approx(float(rebound), rel=1e-14, abs=0.0)
        assert made.impact.penetration_m == pytest.approx(float(penetration), rel=1e-14, abs=0.0)


@pytest.mark.parametrize("excess", [1e-12, 1e-6, 0.5])
def test_a_clamped_block_releases_above_critical_damping_at_the_ends_of_the_range(excess: float) -> None:
    of = Collision(1e-300, 2 * (1 + excess) * sqrt(1e-297), 1e3, 1e-9)
    made = closed_form(of)
    assert made.why == ()
    assert made.release_s == pytest.approx(float(Exact(of).release(made.release_s or 1.0)), rel=1e-13, abs=0.0)


@given(of=collisions(), kg=st.integers(-200, 200), s=st.integers(-100, 100), m=st.integers(-100, 100))
@settings(max_examples=60)
def test_units_change_no_digit(of: Collision, kg: int, s: int, m: int) -> None:
    made = closed_form(of)
    scaled = closed_form(
        Collision(
            of.stiffness_n_m * 2.0 ** (kg - 2 * s),
            of.damping_n_s_m * 2.0 ** (kg - s),
            of.mass_kg * 2.0**kg,
            of.speed_m_s * 2.0 ** (m - s),
            of.force_n * 2.0 ** (kg + m - 2 * s),
            of.law,
        )
    )
    for name, power in (("release_s", s), ("rebound_m_s", m - s), ("penetration_m", m), ("peak_s", s)):
        was = getattr(made, name)
        assert getattr(scaled, name) == (None if was is None else was * 2.0**power), name


def test_a_result_that_no_number_holds_is_null_and_says_why(approved: SnapshotAssertion, refuses: Refuses) -> None:
    made = closed_form(Collision(1.0, 0.1, 1.0, 1e-170))
    assert (made.dissipated_j, made.left_in_spring_j) == (None, None)
    assert made.rebound_m_s is not None
    assert made.why == approved
    with refuses(SynthesisError):
        Collision(1e-300, 1e100, 1e-9, 1.0)


def test_a_step_of_any_length_is_taken_exactly_or_refused() -> None:
    of = Collision(1e300, 0.0, 1e-3, 1.0)
    made = in_steps(of, rate_hz=2500.0).impact
    assert made.release_s == pytest.approx(pi / (1e150 * sqrt(1000)), rel=1e-11, abs=0.0)
    with pytest.raises(SynthesisError, match="choose a lower rate"):
        in_steps(Collision(1e-300, 0.0, 1e3, 1.0), method="rk4", rate_hz=1e300)


@pytest.mark.parametrize("method", list(STEPPERS))
@pytest.mark.parametrize("stiffness", [1e300, 1e9, 1e-300])
def test_no_method_answers_with_what_is_no_number(method: str, stiffness: float) -> None:
    of = Collision(stiffness, 0.3 * sqrt(stiffness * 1e-3), 1e-3, 1e6)
    try:
        made = answer(of, method=method, rate_hz=2500.0)
    except SynthesisError as refused:
        assert "rate: got 2500 Hz" in str(refused)  # noqa: PT017
        return
    json.dumps(made.as_dict(), allow_nan=False)
    assert all(None is one or np.isfinite(one) for one in vars(made.impact).values() if one != made.impact.why)


def test_critical_damping_is_no_edge() -> None:
    made = closed_form(Collision(2500.0, 100.0, 1.0, 0.2))
    assert made.release_s == pytest.approx(2 / 50, rel=1e-15)
    assert made.rebound_m_s == pytest.approx(0.2 * exp(-2), rel=1e-15)
    beside = closed_form(Collision(2500.0, 100.0 * (1 + 2**-50), 1.0, 0.2))
    assert beside.release_s == pytest.approx(2 / 50, rel=1e-14)


def test_the_energy_is_all_there() -> None:
    for of in (
        Collision(4500.0, 1e-6, 0.1, 0.2),
        Collision(4500.0, 10.0, 0.1, 0.2),
        Collision(4500.0, 300.0, 0.1, 0.2),
        Collision(4500.0, 1.0, 0.1, 0.2, -5.0),
    ):
        made = closed_form(of)
        assert made.dissipated_j is not None
        assert made.left_in_spring_j is not None
        assert made.rebound_m_s is not None
        exact = Exact(of)
        lost = mp.mpf(of.damping_n_s_m) * mp.quad(
            lambda t, exact=exact: exact.motion(t)[1] ** 2, mp.linspace(0, mp.mpf(made.release_s), 9)
        )
        assert made.dissipated_j == pytest.approx(float(lost), rel=1e-12)


@pytest.mark.parametrize(
    ("of", "words", "penetration"),
    [
        (Collision(2500.0, 100.0, 1.0, 0.2, law="printed"), "critical or higher", 0.2 / 50 * exp(-1)),
        (Collision(0.0, 2.0, 1.0, 0.2), "nothing pushes the mass back", 0.1),
        (Collision(0.0, 0.0, 1.0, 0.2), "goes deeper without limit", None),
        (Collision(0.0, 2.0, 1.0, 0.2, 1.0), "pushes the mass deeper into the block", None),
        (Collision(2500.0, 100.0, 1.0, 0.2, 50.0), "comes to rest at F / K", None),
    ],
)
def test_what_is_never_released_is_null_and_says_why(of: Collision, words: str, penetration: float | None) -> None:
    made = closed_form(of)
    assert (made.release_s, made.rebound_m_s, made.dissipated_j, made.left_in_spring_j) == (None, None, None, None)
    assert words in " ".join(made.why)
    if penetration is not None:
        assert made.penetration_m == pytest.approx(penetration, rel=1e-14)


def test_nearly_critical_damping_under_the_printed_law_is_said_and_right() -> None:
    of = Collision(2500.0, 99.99, 1.0, 0.2, law="printed")
    made = closed_form(of)
    assert "ill-conditioned" in " ".join(made.why)
    assert made.release_s == pytest.approx(float(Exact(of).release(made.release_s or 0.0)), rel=1e-13)
    assert condition(of) > 1e5
    assert closed_form(replace(of, damping_n_s_m=100.0 * (1 - 1e-9))).rebound_m_s is None


@pytest.mark.parametrize("method", list(STEPPERS))
def test_every_method_comes_to_the_exact_outcome(method: str) -> None:
    of = Collision(4500.0, 8.0, 0.1, 0.2)
    exact, made = closed_form(of), in_steps(of, method=method, rate_hz=1e5, phase=0.3)
    for name in ("release_s", "rebound_m_s", "penetration_m", "peak_s", "dissipated_j"):
        assert getattr(made.impact, name) == pytest.approx(getattr(exact, name), rel=5e-3), name
    assert np.all(np.diff(made.times_s) > 0)
    assert made.force_n.max() < 8.0


@given(rate=st.floats(0.0, 5.0), phase=st.floats(0.0, 0.999), ratio=st.floats(0.0, 5.0))
@settings(max_examples=40)
def test_the_exact_stepper_does_not_depend_on_its_steps(rate: float, phase: float, ratio: float) -> None:
    of = Collision(4500.0, 2 * ratio * sqrt(450.0), 0.1, 0.2)
    exact, made = closed_form(of), in_steps(of, rate_hz=10**rate, phase=phase).impact
    for name in ("release_s", "rebound_m_s", "penetration_m"):
        assert getattr(made, name) == pytest.approx(getattr(exact, name), rel=CLAIMED), name


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass_kg": -1.0}, "mass: got -1 kg"),
        ({"speed_m_s": 0.0}, "speed: got 0 m/s"),
        ({"stiffness_n_m": float("nan")}, "stiffness: got nan N/m"),
        ({"force_n": float("inf")}, "force: got inf N"),
    ],
)
def test_what_is_no_impact_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(SynthesisError, match=words):
        replace(Collision(4500.0, 8.0, 0.1, 0.2), **change)


def test_everything_that_is_wrong_is_told_at_once() -> None:
    with pytest.raises(SynthesisError) as refused:
        Collision(-5.0, -1.0, 0.0, 0.0, float("nan"))
    assert [line.split(":")[0] for line in (str(refused.value), *refused.value.__notes__)] == [
        *("stiffness", "damping", "force", "mass", "speed")
    ]


def test_a_rate_or_method_that_is_none_is_refused(refuses: Refuses) -> None:
    of = Collision(4500.0, 8.0, 0.1, 0.2)
    with pytest.raises(SynthesisError, match="rate: got 0 Hz"):
        answer(of, rate_hz=0.0)
    with refuses(SynthesisError):
        answer(of, method="rk5", rate_hz=2500.0)
    with pytest.raises(SynthesisError, match="choose a lower rate"):
        answer(of, method="rk4", rate_hz=1e9)


def test_an_answer_says_whether_its_method_is_stable(approved: SnapshotAssertion) -> None:
    of = Collision(1e9, 0.0, 1e-6, 0.2)
    assert not answer(of, method="euler", rate_hz=2500.0).stable
    made = answer(of, rate_hz=2500.0)
    assert made.stable
    assert made.limit_h_w is None
    assert made.impact.release_s == pytest.approx(pi * sqrt(1e-6 / 1e9), rel=1e-15)
    assert made.as_dict()["why"] is None
    assert made.text() == approved


@pytest.mark.parametrize(("method", "rate_hz"), [("exponential", 2500.0), ("implicit midpoint", 2500.0)])
def test_a_step_that_is_longer_than_the_contact_says_so(
    method: str, rate_hz: float, approved: SnapshotAssertion
) -> None:
    """1e9 N/m and 1e-6 kg touch for pi sqrt(1e-15) s without a damper."""
    made = answer(Collision(1e9, 0.0, 1e-6, 1e-3), method=method, rate_hz=rate_hz)
    assert made.stable
    assert made.step_in_contacts == pytest.approx(1 / rate_hz / (pi * sqrt(1e-15)), rel=1e-14)
    (long,) = (line for line in made.text().splitlines() if "as long as" in line)
    assert long == approved
    assert "as long as" not in answer(made.of, rate_hz=rate_hz).text()


def test_what_a_method_does_not_see_is_null_and_says_why(approved: SnapshotAssertion) -> None:
    of = Collision(1.0, 0.0, 1.0, 1.0)
    made = answer(of, method="rk4 with events", rate_hz=0.1)
    assert made.impact.penetration_m is None
    assert [line for line in made.text().splitlines() if "no step of" in line] == approved


def test_an_impact_of_which_nothing_is_defined_has_no_condition_number(approved: SnapshotAssertion) -> None:
    made = answer(Collision(0.0, 0.0, 1.0, 0.2), rate_hz=2500.0)
    assert made.text() == approved
