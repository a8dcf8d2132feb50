"""The budget of the force, against simulations that were written apart from it: of a hand that the force moves."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete

from palpate.experiment.apparatus.servo import budget
from palpate.experiment.apparatus.servo.budget import force_budget
from palpate.experiment.errors import RigError
from tests.approved import Refuses
from tests.experiment.apparatus.servo.test_passivity import PAPER, TRACKER, device

K, C, LIMIT_N, T = 2500.0, 100.0, 3.0, 4e-4
NOISE_M, COUNT_M, TOLD_KG = 5e-6, 1e-6, 0.05
FINE = 16
"""So many steps of the hand from sample to sample; the budget takes eight."""

Matrix = np.ndarray


def filtered() -> tuple[Matrix, Matrix, Matrix]:
    """Steady Kalman filter of place, speed and acceleration by scipy's Riccati equation: moves, gains, push."""
    moves = np.array([[1.0, T, T * T / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    shaken = np.array([T * T / 2, T, 1.0]) * 0.1
    r = NOISE_M**2 + COUNT_M**2 / 12
    cov = solve_discrete_are(moves.T, np.eye(3)[:, :1], np.outer(shaken, shaken), np.array([[r]]))
    return moves, cov[:, 0] / (cov[0, 0] + r), np.array([T * T / 2, T, 0.0]) / TOLD_KG


def hand(kg: float, b: float, step_s: float) -> tuple[Matrix, Matrix]:
    """A hand of 10 g, 300 N/m and 2 N s/m with a device, under a pull that stays for a step."""
    m = kg + 0.01
    a = np.array([[0.0, 1.0], [-300.0 / m, -(2.0 + b) / m]])
    moves, pulls, *_ = cont2discrete((a, np.array([[0.0], [1 / m]]), np.eye(2), np.zeros((2, 1))), step_s)
    return moves, pulls[:, 0]


def law(m: float, m_s: float, most_n: float) -> float:
    return min(max(K * m + C * m_s, 0.0), most_n) if m > 0 else 0.0


def tapped(speed: float, *, kg: float, b: float, sees: bool, late: int, part: float) -> list[float]:
    """Return squares of a tap: error and law within the limit, then beside the whole law; `late` in steps of the hand.

    The hand comes at a speed, which its rest keeps up until 50 ms after the face, and goes back; it begins at a `part`
    of the servo's cycle, and `sees` by samples, or truly.
    """
    rng = np.random.default_rng(round(1000 * part))
    moves, gains, push = filtered()
    (((p, q), (r, s)), (x, y)) = (each.tolist() for each in hand(kg, b, T / FINE))
    begins = -0.02 - part * T
    m, u = speed * begins, speed
    seen = np.array([m, u, 0.0])
    sent, queue = 0.0, [0.0] * late
    sums = [0.0] * 4
    for n in range(round(0.14 / T)):
        if n and sees:
            read = COUNT_M * round((m + rng.normal(0.0, NOISE_M)) / COUNT_M)
            seen = moves @ seen - push * sent
            seen = seen + gains * (read - seen[0])
        sent = law(float(seen[0]), float(seen[1]), LIMIT_N) if sees else law(m, u, LIMIT_N)
        for i in range(FINE):
            queue.append(sent)
            force = queue.pop(0)
            t = begins + (n + (i + 0.5) / FINE) * T
            rest, rate = (speed * t, speed) if t < 0.05 else (speed * (0.1 - t), -speed)
            pull = 300.0 * rest + b * speed + 2.0 * rate - force
            m, u = p * m + q * u + x * pull, r * m + s * u + y * pull
            within, whole = law(m, u, LIMIT_N), law(m, u, inf)
            squares = (force - within) ** 2, within**2, (force - whole) ** 2, whole**2
            sums = [one + more for one, more in zip(sums, squares, strict=True)]
    return sums


def shaken(kg: float, b: float) -> float:
    """Return the SD of the force at rest, as a part of 1.25 N, by the covariance of the whole loop."""
    moves, gains, push = filtered()
    step, pull = hand(kg, b, T)
    held = np.array([K, C, 0.0])
    # The hand goes on under the force of what is believed now, then is sampled, and the filter corrects.
    loop = np.zeros((5, 5))
    loop[:2, :2], loop[:2, 2:] = step, -np.outer(pull, held)
    ahead = moves - np.outer(push, held)
    loop[2:, :2] = np.outer(gains, step[0])
    loop[2:, 2:] = ahead + np.outer(gains, loop[0, 2:] - ahead[0])
    noise = np.concatenate([[0.0, 0.0], gains]) * (NOISE_M**2 + COUNT_M**2 / 12) ** 0.5
    cov = np.outer(noise, noise)
    for _ in range(20):
        cov, loop = cov + loop @ cov @ loop.T, loop @ loop
    return float((held @ cov[2:, 2:] @ held) ** 0.5 / 1.25)


@pytest.mark.parametrize(("kg", "b"), [(0.05, 0.1), (0.3, 5.0)])
def test_the_tremor_at_rest_is_that_of_the_loops_covariance(kg: float, b: float) -> None:
    found = force_budget(PAPER, device(damping_n_s_m=b, tip_mass_kg=kg), TRACKER, limit_n=LIMIT_N)
    assert found is not None
    assert found.felt[0].error == pytest.approx(shaken(kg, b), rel=0.15)
    assert found.felt[0].zero_part == 0.0


@pytest.mark.parametrize(("kg", "b", "delay_ms"), [(0.1, 5.0, 0.0), (0.05, 0.1, 0.4)])
def test_taps_are_as_far_off_as_in_another_simulation(kg: float, b: float, delay_ms: float) -> None:
    found = force_budget(PAPER, device(damping_n_s_m=b, tip_mass_kg=kg, delay_ms=delay_ms), TRACKER, limit_n=LIMIT_N)
    assert found is not None
    for felt in (found.felt[2], found.felt[-1]):
        speed, late = felt.speed_mm_s * 1e-3, round(delay_ms * 1e-3 / T * FINE)
        for cause, sees in (("delay" if late else "hold", False), ("trembling", True)):
            taps = [tapped(speed, kg=kg, b=b, sees=sees, late=late, part=part) for part in (0.2, 0.5, 0.8)]
            off, within, beyond, whole = np.sum(taps, axis=0)
            assert felt.errors[cause] == pytest.approx((off / within) ** 0.5, rel=0.15)
        assert felt.errors["limit"] == pytest.approx((beyond / whole) ** 0.5, rel=0.15)


def test_each_cause_makes_its_own_difference() -> None:
    """Half a millimetre of noise, which is passive; a band of 100 Hz; a sensor without noise."""
    bad = force_budget(
        PAPER,
        device(damping_n_s_m=5.0, tip_mass_kg=0.1, band_hz=100.0),
        TRACKER.model_copy(update={"noise_mm": 0.5}),
        limit_n=LIMIT_N,
    )
    assert bad is not None
    assert list(bad.felt[0].errors) == ["hold", "band", "observer", "noise", "counts", "trembling", "limit"]
    assert bad.felt[0].errors["noise"] > 0.2
    assert bad.felt[0].error > 0.05
    assert all(fast.errors["band"] > 1.2 * fast.errors["hold"] for fast in bad.felt[1:])
    assert [one.asked_n >= 17.5 for one in bad.felt] == [False, False, False, False, True]
    still = [bad.felt[0].errors[cause] for cause in ("observer", "noise")]
    assert still[0] < 1e-6 < still[1]


def test_nothing_is_known_without_a_mass_or_of_a_block_that_asks_for_nothing_at_rest() -> None:
    assert force_budget(PAPER, device(), TRACKER, limit_n=LIMIT_N) is None
    damper = PAPER.model_copy(update={"stiffness_n_m": 0.0})
    assert force_budget(damper, device(tip_mass_kg=0.1), TRACKER, limit_n=LIMIT_N) is None
    assert budget.judged(PAPER, device(), TRACKER, limit_n=LIMIT_N) == (True, budget.UNKNOWN)


@pytest.mark.parametrize("weighed", [{"tip_mass_kg": 0.1}, {}])
def test_a_rig_whose_force_is_off_by_more_than_the_protocol_allows_is_refused(
    weighed: dict[str, float], refuses: Refuses
) -> None:
    wanted = PAPER.model_copy(update={"force_error_max": 0.5})
    with refuses(RigError):
        budget.refuse_beyond(wanted, device(damping_n_s_m=5.0, **weighed), TRACKER, limit_n=LIMIT_N, rig="ours")
    allowed = PAPER.model_copy(update={"force_error_max": 0.95})
    budget.refuse_beyond(allowed, device(damping_n_s_m=5.0, tip_mass_kg=0.1), TRACKER, limit_n=LIMIT_N, rig="ours")
