"""Whether a device bears a block (Colgate and Schenkel 1997), as the paper's block is judged."""

from __future__ import annotations

from math import hypot, inf
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.servo import passivity
from palpate.experiment.apparatus.servo.observer import QUANTUM_SD
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.files import load, shipped
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.synthesis.contact.observer import Observer
from tests.approved import Refuses

DEVICE: dict[str, Any] = {
    "driver": "force-tcp",
    "address": "127.0.0.1:4713",
    "full_scale_n": 3.0,
    "damping_n_s_m": 110.0,
    "delay_ms": 0.0,
    "answer_ms": 20.0,
}
PAPER = Tapping(
    switch_key="s",
    rate_hz=2500,
    stiffness_n_m=2500.0,
    damping_n_s_m=100.0,
    full_m_s2=50.0,
    decay_per_s=100.0,
    fastest_mm_s=175.0,
)
CROSSED = load(shipped("crossover.toml")).table(Tapping)
TRACKER = tracker_of(rig.load(shipped("rigs/tapping.toml")))
"""5 um of noise, counts of 1 um, 2.5 kHz."""

FINGER: dict[str, Any] = {"hand_damping_n_s_m": 2.0, "hand_damping_source": "measured in our laboratory, SIMULATED"}


def device(**changed: Any) -> ServoRig:
    return ServoRig.model_validate(DEVICE | changed)


def bears(block: Tapping = PAPER, **changed: Any) -> bool:
    return passivity.judged(block, device(**changed), TRACKER)[0]


def test_what_a_late_cycle_gives_is_told_of_a_block_that_fits() -> None:
    """3 N at 175 mm/s for 2 ms."""
    told = dict(passivity.judged(PAPER, device(damping_n_s_m=b), TRACKER) for b in (101, 100))
    assert ["1.05 mJ" in told[fits] for fits in (True, False)] == [True, False]


def test_the_papers_block_needs_100_5_n_s_m_where_no_mass_is_known(approved: SnapshotAssertion) -> None:
    """2500 N/m * 400 us / 2 + 100 N s/m."""
    assert bears(damping_n_s_m=100.51)
    fits, why = passivity.judged(PAPER, device(damping_n_s_m=100.49), TRACKER)
    assert not fits
    assert why == approved


def test_a_force_that_comes_late_asks_for_more() -> None:
    """A spring alone that comes n periods late asks for K T / 2 (2 n + 1), at low frequencies: 5 * 0.5 N s/m."""
    spring = PAPER.model_copy(update={"damping_n_s_m": 0.0})
    assert bears(spring, delay_ms=0.8, damping_n_s_m=2.51)
    assert not bears(spring, delay_ms=0.8, damping_n_s_m=2.49)


def test_of_several_crossovers_the_one_that_asks_for_most_counts() -> None:
    """4.764 N s/m at 160 Hz, and 0.3 at 10: by the closed form of `test_sampled`."""
    assert [bears(CROSSED, damping_n_s_m=n_s_m, tip_mass_kg=0.1) for n_s_m in (4.76, 4.77)] == [False, True]


def grows(observer: Observer, *, k: float, c: float, b: float, kg: float, n_m: float, samples: int) -> bool:
    """Whether a spring on a mass, with a damper b, ever more moves a servo of one axis: written out anew.

    A force is held for so many samples.
    """
    period = observer.period_s
    alpha, beta, gamma = observer.gains
    # The mass between two samples, under a force that is held.
    moved = expm(np.array([[0.0, 1.0, 0.0], [-n_m / kg, -b / kg, -1 / kg], [0.0, 0.0, 0.0]]) * period)
    # State: place, speed; believed place, speed, acceleration; the force that is held.
    loop = np.zeros((6, 6))
    loop[:2, :2], loop[:2, 5] = moved[:2, :2], moved[:2, 2]
    ahead = np.array([[1.0, period, period**2 / 2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    pushed = -np.array([period**2 / 2, period, 0.0]) / observer.mass_kg
    gains = np.array([alpha, beta / period, gamma / period**2])
    loop[2:5, 2:5], loop[2:5, 5] = ahead, pushed
    off = loop[0] - loop[2]
    loop[2:5] += np.outer(gains, off)
    holds = loop.copy()
    holds[5, 5] = 1.0
    loop[5] = k * loop[2] + c * loop[3]
    whole = loop @ np.linalg.matrix_power(holds, samples - 1)
    return bool(np.abs(np.linalg.eigvals(whole)).max() > 1.0 + 1e-9)


@pytest.mark.parametrize("samples", [1, 2])
def test_the_worst_spring_on_the_device_dies_out_at_the_bound_and_grows_below(samples: int) -> None:
    """A spring may be anything a hand is: of all, the worst is one that the bound just allows."""
    observer = Observer(4e-4 / samples, 5e-6, 0.05)
    needed = passivity.needed_damping_n_s_m(observer, stiffness_n_m=2500.0, damping_n_s_m=100.0, samples=samples)
    loads = [(kg, n_m) for kg in (0.05, 0.1, 0.3) for n_m in np.geomspace(1e2, 1e7, 60)]

    def any_grows(b: float) -> bool:
        return any(grows(observer, k=2500.0, c=100.0, b=b, kg=kg, n_m=n_m, samples=samples) for kg, n_m in loads)

    assert not any_grows(1.02 * needed)
    assert any_grows(0.8 * needed)


@pytest.mark.parametrize(
    ("rate_hz", "needed"), [(2500, (2.43, 5.72, 16.0)), (5000, (3.01, 7.10, 18.1)), (10_000, (4.05, 8.85, 20.4))]
)
def test_less_mass_told_and_a_slower_servo_ask_for_less(rate_hz: int, needed: tuple[float, ...]) -> None:
    """Told 0.05, 0.1 and 0.3 kg: 2.4, 5.7 and 16 N s/m, by another program's scan of the same condition."""
    for kg, n_s_m in zip((0.05, 0.1, 0.3), needed, strict=True):
        observer = Observer(1 / rate_hz, 5e-6, kg)
        found = passivity.needed_damping_n_s_m(observer, stiffness_n_m=2500.0, damping_n_s_m=100.0)
        assert found == pytest.approx(n_s_m, rel=4e-3)


def test_a_filter_that_believes_every_sample_is_the_difference_of_two() -> None:
    """Without noise the gains go to 1, 2 and 1, and told an endless mass it knows of no force."""
    blind = Observer(4e-4, 1e-15, inf)
    found = passivity.needed_damping_n_s_m(blind, stiffness_n_m=2500.0, damping_n_s_m=0.0)
    assert found == pytest.approx(2500 * 4e-4 / 2, rel=1e-3)


def test_a_device_of_five_bears_the_papers_block_alone_and_one_of_one_with_a_finger() -> None:
    assert bears(damping_n_s_m=5.0, tip_mass_kg=0.1)
    assert not bears(damping_n_s_m=1.0, tip_mass_kg=0.1)
    assert bears(damping_n_s_m=1.0, tip_mass_kg=0.1, **FINGER)
    assert not bears(damping_n_s_m=0.1, tip_mass_kg=0.1, **FINGER)


def test_a_block_with_little_damping_is_followed_by_differences_where_an_observers_lag_asks_for_more() -> None:
    """K T / 2 + C = 0.9 N s/m, and 3.7 behind the observer; that stays where it is passive too."""
    little = PAPER.model_copy(update={"damping_n_s_m": 0.4})
    weighed = [device(damping_n_s_m=n_s_m, tip_mass_kg=0.1) for n_s_m in (0.89, 0.91, 5.0)]
    assert [passivity.judged(little, one, TRACKER)[0] for one in weighed] == [False, True, True]
    assert [passivity.follower(little, one, TRACKER) is None for one in weighed] == [False, True, False]
    assert passivity.follower(PAPER, weighed[-1], TRACKER) is not None


def test_the_damping_that_a_device_bears_is_what_its_own_leaves_beside_the_spring() -> None:
    """With C lowered by the bound b - K T / 2, or K T / 2 and less."""
    found = [
        passivity.bearable_n_s_m(PAPER, device(damping_n_s_m=b, tip_mass_kg=kg), TRACKER)
        for b, kg in ((0.1, 0.1), (1.0, 0.1), (1.0, 0.02), (5.0, 0.02))
    ]
    assert found == pytest.approx([0.0, 0.5, 0.5, 4.5], abs=100 / 2**passivity.HALVINGS)


def test_a_tracker_that_is_faster_than_the_servo_asks_for_more_and_a_slower_one_too() -> None:
    """Each force is held for two samples of 5 kHz; at 1 kHz it is held for a whole ms: K T / 2 are 1.25 N s/m."""
    fast, slow = (TRACKER.model_copy(update={"rate_hz": rate_hz}) for rate_hz in (5000, 1000))
    told = {"damping_n_s_m": 4.0, "tip_mass_kg": 0.1}
    assert [passivity.judged(PAPER, device(**told), one)[0] for one in (TRACKER, fast)] == [True, False]
    untold = device(damping_n_s_m=101.0)
    assert [passivity.judged(PAPER, untold, one)[0] for one in (TRACKER, slow)] == [True, False]


def test_a_tracker_that_is_a_little_faster_counts_as_one_sample_a_force() -> None:
    """2600 and 2500 Hz meet again after 10 ms: the whole loop of 26 samples and 25 forces, by its eigenvalues."""
    little = TRACKER.model_copy(update={"rate_hz": 2600})
    assert [bears_at(little, n_s_m) for n_s_m in (4.2, 4.3)] == [False, True]
    observer = Observer(1 / 2600, hypot(5e-6, QUANTUM_SD * 1e-6), 0.05)
    loads = [(kg, n_m) for kg in (0.05, 0.1, 0.3) for n_m in np.geomspace(1e5, 3e6, 15)]
    assert not any(_grows_beside(observer, b=4.3, kg=kg, n_m=n_m) for kg, n_m in loads)
    assert any(_grows_beside(observer, b=3.5, kg=kg, n_m=n_m) for kg, n_m in loads)


def bears_at(tracker: TrackerRig, damping_n_s_m: float) -> bool:
    return passivity.judged(PAPER, device(damping_n_s_m=damping_n_s_m, tip_mass_kg=0.1), tracker)[0]


def _grows_beside(observer: Observer, *, b: float, kg: float, n_m: float) -> bool:
    """As `grows`, of a servo of 2500 Hz beside the observer's samples."""
    alpha, beta, gamma = observer.gains
    period = observer.period_s
    ahead = np.array([[1.0, period, period**2 / 2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    sampled = np.eye(6)
    sampled[2:5, 2:5], sampled[2:5, 5] = ahead, -np.array([period**2 / 2, period, 0.0]) / observer.mass_kg
    off = np.eye(6)[0] - sampled[2]
    sampled[2:5] += np.outer([alpha, beta / period, gamma / period**2], off)
    pushed = np.eye(6)
    pushed[5] = [0.0, 0.0, 2500.0, 100.0, 0.0, 0.0]
    events = sorted([(n / 2600, 0) for n in range(26)] + [((n + 0.5) / 2500, 1) for n in range(25)])
    gaps = np.diff([at for at, _ in events], append=[0.01 + events[0][0]])
    plant = np.array([[0.0, 1.0, 0.0], [-n_m / kg, -b / kg, -1 / kg], [0.0, 0.0, 0.0]])
    whole = np.eye(6)
    for (_, pushes), moved in zip(events, expm(plant * gaps[:, None, None]), strict=True):
        moves = np.eye(6)
        moves[:2, :2], moves[:2, 5] = moved[:2, :2], moved[:2, 2]
        whole = moves @ (pushed if pushes else sampled) @ whole
    return bool(np.abs(np.linalg.eigvals(whole)).max() > 1.0 + 1e-9)


def test_what_moves_too_little_is_refused_however_much_damping_it_has() -> None:
    """C T / m = 2 with 0.02 kg at 2.5 kHz."""
    assert not bears(damping_n_s_m=100.0, tip_mass_kg=0.02)


def test_participants_are_refused_beyond_it(refuses: Refuses) -> None:
    passivity.refuse_beyond(PAPER, device(), TRACKER, rig="ours")
    with refuses(RigError):
        passivity.refuse_beyond(PAPER, device(damping_n_s_m=5.0), TRACKER, rig="ours")


def test_a_rig_that_is_told_its_mass_is_refused_by_that_bound(refuses: Refuses) -> None:
    small = device(damping_n_s_m=0.2, tip_mass_kg=0.1, hand_damping_n_s_m=2.0, hand_damping_source="SIMULATED finger")
    with refuses(RigError):
        passivity.refuse_beyond(PAPER, small, TRACKER, rig="ours")
