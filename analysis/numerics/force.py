"""The budget of the force that a hand feels, beside the truth, which another simulation finds.

The truth shares no line with the budget: a hand that the force moves, by scipy's exact response of hand and device, in
steps of its own, and a filter whose gains come from a Riccati equation. All is SIMULATED.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from math import expm1, hypot, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete

from palpate.experiment.synthesis.contact.force import CAUSES, LIMIT, ForceBudget, Loop
from palpate.experiment.synthesis.contact.observer import CHANGES_M_S2, Observer

Floats = NDArray[np.float64]

STIFFNESS_N_M, DAMPING_N_S_M, LIMIT_N, RATE_HZ, FASTEST_MM_S = 2500.0, 100.0, 3.0, 2500, 175.0
"""The block of Wellman and Howe, and the largest force and the servo of the device that we ship."""

NOISE_M, COUNT_M, TOLD_KG = 5e-6, 1e-6, 0.05
"""SD of a sample, its rounding, and the mass that the observer is told."""

HAND = {"stiffness_n_m": 300.0, "damping_n_s_m": 2.0, "mass_kg": 0.01}


@dataclass(frozen=True)
class Device:
    """What a hand holds: mass and damping of its tip; how late its force is, in which band."""

    tip_kg: float
    tip_n_s_m: float
    delay_s: float = 0.0
    band_hz: float | None = None


DEVICES: Mapping[str, Device] = {
    "50 g": Device(0.05, 1.0),
    "100 g, a period late, 300 Hz": Device(0.1, 5.0, 1 / RATE_HZ, 300.0),
}

TRUE = 0.15
"""A budget claims to lie within this part of the truth."""

HANDS, FINE = 8, 10
"""Hands, each at a phase of the servo's cycle, and steps of a hand from sample to sample."""

INSIDE_M, FLIES_S, IN_S, RESTS_S = 5e-4, 0.02, 0.05, 0.25


@dataclass(frozen=True, eq=False)
class Course:
    """What hands did at one speed, 0 at rest; rows are hands.

    `read_m` and `sent_n` are samples and forces, one a cycle; `pushed_n`, `m`, `m_s` the device's force, place and
    speed, at the end of each of `FINE` steps a cycle. `begun_s` is each hand's time before the touch.
    """

    speed_m_s: float
    begun_s: Floats
    read_m: Floats
    sent_n: Floats
    pushed_n: Floats
    m: Floats
    m_s: Floats

    def off(self, most_n: float) -> float:
        """Return the rms of the force less the law up to a limit, as a part of that law's; at rest when settled."""
        if self.speed_m_s:
            law = STIFFNESS_N_M * self.m + DAMPING_N_S_M * self.m_s
            law, pushed = np.where(self.m > 0, np.clip(law, 0.0, most_n), 0.0), self.pushed_n
        else:
            pushed = self.pushed_n[:, self.pushed_n.shape[1] // 2 :: FINE]
            law = np.full(pushed.shape, STIFFNESS_N_M * INSIDE_M)
        return sqrt(np.mean((pushed - law) ** 2) / np.mean(law**2))


def course(device: Device, *, speed_m_s: float, sees: bool = True) -> Course:
    """Simulate hands that see by samples, or truly; a period is 1 / `RATE_HZ`."""
    period_s, rng = 1 / RATE_HZ, np.random.default_rng(round(1e6 * speed_m_s) + 7)
    mass, damping = device.tip_kg + HAND["mass_kg"], device.tip_n_s_m + HAND["damping_n_s_m"]
    plant = np.array([[0.0, 1.0], [-HAND["stiffness_n_m"] / mass, -damping / mass]]), np.array([[0.0], [1 / mass]])
    moves, pulls, *_ = cont2discrete((*plant, np.eye(2), np.zeros((2, 1))), period_s / FINE)
    ahead, gains, push = _filter()
    late = round(device.delay_s * RATE_HZ * FINE)
    follows = 1.0 if device.band_hz is None else -expm1(-2 * pi * device.band_hz * period_s / FINE)
    begun_s = -FLIES_S - (np.arange(HANDS) + 0.25) / HANDS * period_s
    at = np.stack([speed_m_s * begun_s, np.full(HANDS, speed_m_s)])
    cycles = round((2 * (FLIES_S + IN_S) if speed_m_s else 2 * RESTS_S) * RATE_HZ)
    sent = np.zeros(HANDS)
    if not speed_m_s:
        at[0], sent = INSIDE_M, np.full(HANDS, STIFFNESS_N_M * INSIDE_M)
    seen, pushed, coming = np.stack([*at, sent / TOLD_KG]), sent, [sent] * late
    read_m, sent_n = np.empty((2, cycles, HANDS))
    made = np.empty((3, cycles * FINE, HANDS))
    for n in range(cycles):
        read_m[n] = COUNT_M * np.round((at[0] + rng.normal(0.0, NOISE_M, HANDS)) / COUNT_M)
        if n:
            seen = ahead @ seen - np.outer(push, sent)
            seen = seen + np.outer(gains, read_m[n] - seen[0])
        m, m_s = seen[:2] if sees else at
        sent = np.where(m > 0, np.clip(STIFFNESS_N_M * m + DAMPING_N_S_M * m_s, 0.0, LIMIT_N), 0.0)
        sent_n[n] = sent
        for i in range(n * FINE, (n + 1) * FINE):
            coming.append(sent)
            pushed = pushed + follows * (coming.pop(0) - pushed)
            goes = pulled_n(device, speed_m_s, begun_s + (i + 0.5) / FINE * period_s)
            at = moves @ at + pulls * (goes - pushed)
            made[:, i] = pushed, *at
    return Course(speed_m_s, begun_s, read_m.T, sent_n.T, *made.transpose(0, 2, 1))


def pulled_n(device: Device, speed_m_s: float, t_s: Floats) -> Floats:
    """Return the hand's pull at times from the touch on, N: its rest goes in and back at the speed, or stays inside."""
    if not speed_m_s:
        return np.full(t_s.shape, (HAND["stiffness_n_m"] + STIFFNESS_N_M) * INSIDE_M)
    goes_in = t_s <= IN_S
    rest_m = speed_m_s * np.where(goes_in, t_s, 2 * IN_S - t_s)
    turned = np.where(goes_in, speed_m_s, -speed_m_s)
    return HAND["stiffness_n_m"] * rest_m + HAND["damping_n_s_m"] * turned + device.tip_n_s_m * speed_m_s


def _filter() -> tuple[Floats, Floats, Floats]:
    """Return the steady Kalman filter of a changing acceleration: what a step does, its gains, what a force does."""
    t = 1 / RATE_HZ
    ahead = np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
    changed = CHANGES_M_S2 * np.array([t * t / 2, t, 1.0])
    noise = NOISE_M**2 + COUNT_M**2 / 12
    spread = solve_discrete_are(ahead.T, np.eye(3)[:, :1], np.outer(changed, changed), np.array([[noise]]))
    return ahead, spread[:, 0] / (spread[0, 0] + noise), np.array([t * t / 2, t, 0.0]) / TOLD_KG


@dataclass(frozen=True, eq=False)
class Pushed:
    """The budget of a device, and the truth at each of its speeds, as parts of the law: of what is held from true
    places and speeds (of taps), of all within the limit, and beside the whole law; what the hands then did.
    """

    name: str
    device: Device
    budget: ForceBudget
    truth: tuple[dict[str, float], ...]
    courses: tuple[Course, ...]

    @property
    def broken(self) -> tuple[str, ...]:
        """One line for each error that is not within `TRUE` of the truth."""
        return tuple(
            f"force, {self.name}, {felt.speed_mm_s:g} mm/s, {cause}: {felt.errors[cause]:.2%}, not {true:.2%}"
            for felt, truth in zip(self.budget.felt, self.truth, strict=True)
            for cause, true in truth.items()
            if abs(felt.errors[cause] - true) > TRUE * true
        )


def push(name: str) -> Pushed:
    """Return the budget of one of `DEVICES`, and the truth."""
    device = DEVICES[name]
    observer = Observer(1 / RATE_HZ, hypot(NOISE_M, COUNT_M / sqrt(12)), TOLD_KG)
    loop = Loop(
        STIFFNESS_N_M, DAMPING_N_S_M, LIMIT_N, observer, NOISE_M, COUNT_M, device.tip_kg, device.tip_n_s_m,
        device.delay_s, device.band_hz,
    )  # fmt: skip
    budget = loop.budget(FASTEST_MM_S)
    # Before the observer comes in, places and speeds are the true ones.
    [*_, true_places] = [cause for cause in CAUSES[:3] if cause in budget.felt[0].errors]
    truth, courses = list[dict[str, float]](), list[Course]()
    for felt in budget.felt:
        speed_m_s = 1e-3 * felt.speed_mm_s
        made = course(device, speed_m_s=speed_m_s)
        held = {true_places: course(device, speed_m_s=speed_m_s, sees=False).off(LIMIT_N)} if speed_m_s else {}
        truth.append(held | {CAUSES[-1]: made.off(LIMIT_N), LIMIT: made.off(np.inf)})
        courses.append(made)
    return Pushed(name, device, budget, tuple(truth), tuple(courses))


def arrays(results: tuple[Pushed, ...]) -> bytes:
    """Return the bytes of a .npz file with everything that it takes to find each truth by other means.

    It contains the constants above, and of each device `d` its `name`, `tip_kg`, `tip_n_s_m`, `delay_s`, `band_hz` (0:
    none) and at each of `speeds_m_s` (0: at rest) `budget`, `truth` (within the limit, and beside the whole law), and
    of speed `v` `d_v_read_m`, `d_v_sent_n` (hands, cycles), `d_v_pushed_n` (hands, cycles x fine), `d_v_begun_s`.
    """
    made: dict[str, object] = {
        "stiffness_n_m": STIFFNESS_N_M, "damping_n_s_m": DAMPING_N_S_M, "limit_n": LIMIT_N, "rate_hz": RATE_HZ,
        "noise_m": NOISE_M, "count_m": COUNT_M, "told_kg": TOLD_KG, "changes_m_s2": CHANGES_M_S2, "fine": FINE,
        "inside_m": INSIDE_M, "in_s": IN_S, **{f"hand_{name}": value for name, value in HAND.items()},
        "name": np.array([one.name for one in results]), "tip_kg": [one.device.tip_kg for one in results],
        "tip_n_s_m": [one.device.tip_n_s_m for one in results], "delay_s": [one.device.delay_s for one in results],
        "band_hz": [one.device.band_hz or 0.0 for one in results],
        "speeds_m_s": [each.speed_m_s for each in results[0].courses],
        "budget": [[[felt.errors[cause] for cause in (CAUSES[-1], LIMIT)] for felt in one.budget.felt]
                   for one in results],
        "truth": [[[true[cause] for cause in (CAUSES[-1], LIMIT)] for true in one.truth] for one in results],
    }  # fmt: skip
    for d, one in enumerate(results):
        for v, each in enumerate(one.courses):
            made |= {f"{d}_{v}_{of}": getattr(each, of) for of in ("read_m", "sent_n", "pushed_n", "begun_s")}
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **{name: np.asarray(value) for name, value in made.items()})
    return file.getvalue()
