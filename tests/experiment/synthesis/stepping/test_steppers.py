"""The other steppers: their orders on smooth ground, their first order through a switch, and scipy beside them."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.contact.block import FREE, RETURNING, Block, Motion
from palpate.experiment.synthesis.stepping.impact import Collision, closed_form, in_steps
from palpate.experiment.synthesis.stepping.steppers import STEPPERS, stepper
from tests.approved import Refuses

OF = Collision(4500.0, 8.0, 0.1, 0.2)


def smooth_error(method: str, steps: int) -> float:
    """Return how far a mass that is held in a block is from where it should be after 2 ms, without any switch."""
    block = Block((4500.0, 0.0), (8.0, 0.0), (0.1, 0.1), law="printed", force_n=(45.0, 0.0))
    at = wanted = Motion(RETURNING, 0.011, 0.0)
    for _ in range(steps):
        at, _ = STEPPERS[method](block, at, 2e-3 / steps)
    wanted, _ = STEPPERS["exact"](block, wanted, 2e-3)
    return abs(at.deep_m - wanted.deep_m) + abs(at.deep_m_s - wanted.deep_m_s) / sqrt(45_000)


@pytest.mark.parametrize(
    ("method", "order"),
    [("euler", 1), ("semi-implicit euler", 1), ("implicit midpoint", 2), ("rk4", 4), ("rk4 with events", 4)],
)
def test_without_a_switch_each_method_has_its_own_order(method: str, order: int) -> None:
    coarse, fine = smooth_error(method, 8), smooth_error(method, 16)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.25)


def test_without_a_switch_the_exponential_is_exact() -> None:
    assert smooth_error("exponential", 8) < 1e-16


def rebound_error(method: str, steps: int) -> float:
    exact = closed_form(OF)
    assert exact.release_s is not None
    assert exact.rebound_m_s is not None
    errors = []
    for phase in (0.0, 0.21, 0.43, 0.77):
        made = in_steps(OF, method=method, rate_hz=steps / exact.release_s, phase=phase).impact
        assert made.rebound_m_s is not None
        errors.append(abs(made.rebound_m_s / exact.rebound_m_s - 1))
    return max(errors)


@pytest.mark.parametrize("method", ["euler", "semi-implicit euler", "implicit midpoint", "rk4", "exponential"])
def test_through_touch_and_release_every_blind_method_is_of_first_order(method: str) -> None:
    steps = (32, 128, 512)
    slope = np.polyfit(np.log(steps), np.log([rebound_error(method, n) for n in steps]), 1)[0]
    assert -1.6 < slope < -0.6


def test_finding_the_events_gives_the_fourth_order_back() -> None:
    steps = (8, 16, 32)
    slope = np.polyfit(np.log(steps), np.log([rebound_error("rk4 with events", n) for n in steps]), 1)[0]
    assert slope == pytest.approx(-4, abs=0.5)


def test_the_exact_stepper_needs_no_order() -> None:
    assert max(rebound_error("exact", n) for n in (1, 2, 7, 300)) < 1e-13


@pytest.mark.parametrize(
    "of",
    [
        OF,
        Collision(4500.0, 8.0, 0.1, 0.2, -3.0),
        Collision(4500.0, 1.0, 0.1, 0.2, 2.0, "printed"),
        Collision(160e3, 60.0, 5e-3, 3.0),
    ],
)
def test_scipy_with_events_finds_the_same(of: Collision) -> None:
    """scipy.integrate.solve_ivp, DOP853 at 1e-12 with the release as a terminal event: a check of another make."""
    k, c, m = of.stiffness_n_m, of.damping_n_s_m, of.mass_kg

    def rates(_: float, y: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[float]:
        return [y[1], (of.force_n - k * y[0] - c * y[1]) / m]

    def released(t: float, y: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        return float(y[0] if of.law == "printed" else k * y[0] + c * y[1]) if t > 1e-9 else 1.0

    released.terminal = True  # type: ignore[attr-defined]
    released.direction = -1  # type: ignore[attr-defined]
    found = solve_ivp(rates, (0, 1), [0, of.speed_m_s], "DOP853", events=released, rtol=1e-12, atol=1e-16)
    made = closed_form(of)
    assert made.release_s == pytest.approx(float(found.t_events[0][0]), rel=1e-8)
    assert made.rebound_m_s == pytest.approx(abs(float(found.y_events[0][0][1])), rel=1e-8)


def test_the_spring_along_the_face_is_stepped_too() -> None:
    block = Block((4500.0, 900.0), (8.0, 2.0), (0.1, 0.1))
    ends = {}
    for name, once in STEPPERS.items():
        at = Motion(FREE, 0.0, 0.2, 0.0, 0.1)
        for _ in range(500):
            at, _seen = once(block, at, 1e-5)
        ends[name] = at.along_m
    assert ends == pytest.approx(dict.fromkeys(ends, ends["exact"]), rel=5e-3)


def test_an_unknown_method_is_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        stepper("leapfrog")
