"""What a servo believes of its hand, beside a Kalman filter by scipy, and beside motions in closed form."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.servo.observer import observer_of
from palpate.experiment.protocol.files import shipped
from palpate.experiment.synthesis.contact.observer import CHANGES_M_S2, Observer, Seen
from tests.experiment.apparatus.servo.test_passivity import CROSSED, PAPER, device

PERIOD_S, NOISE_M = 4e-4, 5e-6
OURS = Observer(PERIOD_S, NOISE_M, 0.05)


@pytest.mark.parametrize("period_s", [1e-4, 4e-4, 1e-3])
@pytest.mark.parametrize("noise_m", [1e-6, 5e-6, 1e-4])
def test_the_gains_are_those_of_the_steady_kalman_filter(period_s: float, noise_m: float) -> None:
    moves = np.array([[1, period_s, period_s**2 / 2], [0, 1, period_s], [0, 0, 1]])
    change = CHANGES_M_S2 * np.array([[period_s**2 / 2], [period_s], [1.0]])
    seen = np.array([[1.0, 0.0, 0.0]])
    spread = solve_discrete_are(moves.T, seen.T, change @ change.T, np.array([[noise_m**2]]))
    gains = (spread @ seen.T / (seen @ spread @ seen.T + noise_m**2)).ravel()
    assert Observer(period_s, noise_m, 0.05).gains == pytest.approx(gains * [1, period_s, period_s**2], rel=1e-5)


def followed(places_m: np.ndarray, force_n: float, observer: Observer = OURS) -> Seen:
    seen = Seen(*places_m[0])
    for place in places_m[1:]:
        seen = observer.step(seen, (place[0], place[1]), PERIOD_S, (force_n, -force_n / 2))
    return seen


def test_a_mass_under_the_force_that_is_told_is_followed_without_lag() -> None:
    """x = v t + F t^2 / (2 m), on both axes: nothing is left over for the hand."""
    t = PERIOD_S * np.arange(2000)
    along = 0.1 * t + 0.02 / 0.05 * t * t / 2
    seen = followed(np.column_stack([along, 0.2 * t - 0.01 / 0.05 * t * t / 2]), 0.02)
    assert seen == pytest.approx(
        (along[-1], 0.2 * t[-1] - 0.1 * t[-1] ** 2, 0.1 + 0.4 * t[-1], 0.2 - 0.2 * t[-1], 0.0, 0.0), abs=1e-9
    )


def test_a_hand_that_holds_against_the_force_comes_to_rest_in_what_is_believed() -> None:
    """At rest under 1 N the hand gives what 1 N takes: 1 / 0.05 m/s^2, into the block."""
    seen = followed(np.full((2000, 2), 3e-4), 1.0)
    assert seen == pytest.approx((3e-4, 3e-4, 0.0, 0.0, -20.0, 10.0), abs=1e-9)


def test_noise_leaves_what_the_filter_says_of_itself() -> None:
    """The steady spread of place and speed by the same equation of Riccati, from 40,000 samples of rest."""
    moves = np.array([[1, PERIOD_S, PERIOD_S**2 / 2], [0, 1, PERIOD_S], [0, 0, 1]])
    alpha, beta, gamma = OURS.gains
    gains = np.array([alpha, beta / PERIOD_S, gamma / PERIOD_S**2])
    kept = (np.eye(3) - np.outer(gains, [1, 0, 0])) @ moves
    spread = np.zeros((3, 3))
    for _ in range(4000):
        spread = kept @ spread @ kept.T + np.outer(gains, gains) * NOISE_M**2
    rng = np.random.default_rng(1)
    seen, speeds = Seen(0.0, 0.0), []
    for noise in rng.normal(0.0, NOISE_M, (40_000, 2)):
        seen = OURS.step(seen, (noise[0], noise[1]), PERIOD_S, (0.0, 0.0))
        speeds.append(seen.m_s)
    assert np.std(speeds[1000:]) == pytest.approx(sqrt(spread[1, 1]), rel=0.05)


def test_the_rig_says_what_is_told() -> None:
    """5 um of noise and counts of 1 um; 0.05 kg of a device of 0.1, its own of one of 0.03."""
    tracker = tracker_of(rig.load(shipped("rigs/tapping.toml")))
    observer = observer_of(PAPER, device(tip_mass_kg=0.1), tracker)
    assert observer is not None
    assert (observer.period_s, observer.mass_kg) == (4e-4, 0.05)
    assert observer.noise_m == pytest.approx(sqrt(25 + 1 / 12) * 1e-6)
    light = observer_of(PAPER, device(tip_mass_kg=0.03), tracker)
    assert light is not None
    assert light.mass_kg == 0.03
    assert observer_of(PAPER, device(), tracker) is None
    assert observer_of(CROSSED, device(tip_mass_kg=0.1), tracker) is None


def test_a_stronger_damper_is_told_the_mass_that_it_takes() -> None:
    """1.25 C T of 200 N s/m at 2.5 kHz are 0.1 kg, and no device is told more than it has."""
    tracker = tracker_of(rig.load(shipped("rigs/tapping.toml")))
    strong = PAPER.model_copy(update={"damping_n_s_m": 200.0})
    told = [observer_of(strong, device(tip_mass_kg=kg), tracker) for kg in (0.3, 0.08)]
    assert [one and one.mass_kg for one in told] == pytest.approx([0.1, 0.08])
