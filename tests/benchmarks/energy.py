"""How much energy SIMULATED hands get of a block that `check` calls passive: `python -m tests.benchmarks.energy N S`.

N manipulations of S seconds: taps, presses and hovering, of hands of 150 to 1000 N/m and 2 to 7 N s/m, on the devices
whose block `passivity.judged` lets pass; 2500 N/m, 100 N s/m, 2.5 kHz, 5 um of noise and counts of 1 um. Energy given
is the work of the force on what it moves, less what the device's own damping takes, at its largest over time. Then the
same for blocks with crossovers of `crossover.toml`, each on devices with just the damping that it needs. With
gaps the servo holds its force for the longest time between cycles that is no fault, and then reads all that came.
"""

from __future__ import annotations

import sys
from itertools import product
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from palpate.experiment.apparatus.servo import passivity
from palpate.experiment.apparatus.servo.observer import QUANTUM_SD, TOLD_KG
from palpate.experiment.protocol.files import load, shipped
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.synthesis.contact import lowpass, sampled
from palpate.experiment.synthesis.contact.observer import Observer
from tests.benchmarks.force import COUNT_M, DAMPING_N_S_M, HAND_KG, LIMIT_N, NOISE_M, STIFFNESS_N_M
from tests.experiment.apparatus.servo.test_passivity import PAPER, TRACKER, device

DAMPINGS_N_S_M, MASSES_KG = (0.1, 1.0, 5.0), (0.02, 0.05, 0.1, 0.2, 0.3)
RATE_HZ, PARTS = 2500, 4
GAP, EVERY = 5, 617
"""So many cycles are left out, of so many: `process.SILENT_NS`, 2 ms."""
MOST_J = 1e-4

Floats = NDArray[np.float64]


def shown(*, counted_n_s_m: float) -> list[tuple[float, float]]:
    """Return the devices, N s/m and kg, that are shown the block, where so much is counted on from a hand."""
    told = {} if not counted_n_s_m else {"hand_damping_n_s_m": counted_n_s_m, "hand_damping_source": "SIMULATED"}
    return [
        (b, kg)
        for b, kg in product(DAMPINGS_N_S_M, MASSES_KG)
        if passivity.judged(PAPER, device(damping_n_s_m=b, tip_mass_kg=kg, **told), TRACKER)[0]
    ]


class Rests:
    """Where n hands would be without a force, m inside: a third taps, a third presses, a third hovers at the face."""

    def __init__(self, n: int, rng: np.random.Generator) -> None:
        self._kind = np.arange(n) % 3
        self._begun = rng.uniform(0.0, 1.0, n)
        self._speed = rng.uniform(0.02, 0.3, n)
        self._deep, self._high = rng.uniform(1e-3, 1e-2, n), rng.uniform(2e-3, 5e-3, n)
        self._slow, self._fast = 2 * np.pi * rng.uniform(0.2, 2.0, n), 2 * np.pi * rng.uniform(6.0, 12.0, n)
        self._trembles = rng.uniform(5e-5, 1e-3, n)

    def at(self, t_s: float) -> Floats:
        way = self._deep + self._high
        there = (self._speed * t_s / way + self._begun) % 2.0
        tap = way * np.minimum(there, 2.0 - there) - self._high
        press = self._deep * (0.6 - np.cos(self._slow * t_s)) / 1.6
        hover = 5e-4 * np.sin(self._slow * t_s)
        rest = np.where(self._kind == 0, tap, np.where(self._kind == 1, press, hover))
        return rest + np.where(self._kind == 0, 0.0, self._trembles * np.sin(self._fast * t_s))


def given_j(devices: list[tuple[float, float]], n: int, lasts_s: float, *, gap: int = 0) -> tuple[Floats, Floats]:
    """Return the largest energy that each manipulation was given, and the most by which a gap of so many cycles gave
    more than the law would along the same path, J, each (n,). The devices take turns.
    """
    rng, period_s = np.random.default_rng(1), 1 / RATE_HZ
    b, kg = np.array([devices[i % len(devices)] for i in range(n)]).T
    moved_kg = kg + HAND_KG
    hand_n_m, hand_n_s_m = rng.uniform(150.0, 1000.0, n), rng.uniform(2.0, 7.0, n)
    plant = np.zeros((n, 3, 3))
    plant[:, 0, 1], plant[:, 1, 2] = 1.0, 1 / moved_kg
    plant[:, 1, 0], plant[:, 1, 1] = -hand_n_m / moved_kg, -(b + hand_n_s_m) / moved_kg
    moves = expm(plant * (period_s / PARTS))
    (mm, mu, mp), (um, uu, up) = moves[:, 0].T, moves[:, 1].T
    rests = Rests(n, rng)
    observer = Observer(period_s, float(np.hypot(NOISE_M, QUANTUM_SD * COUNT_M)), TOLD_KG)
    alpha, beta, gamma = observer.gains
    beta, gamma = beta / period_s, gamma / period_s**2
    before = rests.at(0.0)
    m, u = np.minimum(before, -1e-3), np.zeros(n)
    seen, seen_s, seen_s2, sent = m.copy(), np.zeros(n), np.zeros(n), np.zeros(n)
    energy, most, more, mostly = np.zeros(n), np.full(n, -inf), np.zeros(n), np.zeros(n)
    part_s = period_s / PARTS
    for cycle in range(round(lasts_s * RATE_HZ)):
        read = COUNT_M * np.rint((m + rng.normal(0.0, NOISE_M, n)) / COUNT_M)
        by = seen_s2 - sent / TOLD_KG
        ahead = seen + (seen_s + by * (period_s / 2)) * period_s
        off = read - ahead
        seen, seen_s, seen_s2 = ahead + alpha * off, seen_s + by * period_s + beta * off, seen_s2 + gamma * off
        place = cycle % EVERY
        law = np.where(seen > 0, np.clip(STIFFNESS_N_M * seen + DAMPING_N_S_M * seen_s, 0.0, LIMIT_N), 0.0)
        sent = sent if 0 < place <= gap else law
        more = more if place else np.zeros(n)
        now = rests.at((cycle + 1) * period_s)
        pull = hand_n_m * (before + now) / 2 + hand_n_s_m * (now - before) / period_s - sent
        before = now
        for _ in range(PARTS):
            gone, speed = mm * m + mu * u + mp * pull, um * m + uu * u + up * pull
            # The speed changes evenly from part to part.
            energy += -sent * (gone - m) - b * part_s * (u * u + u * speed + speed * speed) / 3
            more = more - (sent - law) * (gone - m)
            m, u = gone, speed
        most = np.maximum(most, energy)
        mostly = np.maximum(mostly, more) if place == gap else mostly
    return most, mostly


def crossed_j(hz: float, b: float, n: int, lasts_s: float, *, seed: int = 1) -> Floats:
    """Return the same with a crossover, Hz, on devices with a damping, N s/m, of `MASSES_KG` in turn."""
    block, rng, period_s = load(shipped("crossover.toml")).table(Tapping), np.random.default_rng(seed), 1 / RATE_HZ
    k, c = block.stiffness_n_m, block.damping_n_s_m
    stays, adds_n_s_m = lowpass.relaxing(k, c, hz, period_s)
    moved_kg = np.resize(MASSES_KG, n) + HAND_KG
    hand_n_m, hand_n_s_m = rng.uniform(150.0, 1000.0, n), rng.uniform(2.0, 7.0, n)
    plant = np.zeros((n, 3, 3))
    plant[:, 0, 1], plant[:, 1, 2] = 1.0, 1 / moved_kg
    plant[:, 1, 0], plant[:, 1, 1] = -hand_n_m / moved_kg, -(b + hand_n_s_m) / moved_kg
    moves = expm(plant * (period_s / PARTS))
    (mm, mu, mp), (um, uu, up) = moves[:, 0].T, moves[:, 1].T
    rests = Rests(n, rng)
    before = rests.at(0.0)
    m, u = np.minimum(before, -1e-3), np.zeros(n)
    read, relaxing = m.copy(), np.zeros(n)
    energy, most = np.zeros(n), np.full(n, -inf)
    part_s = period_s / PARTS
    for cycle in range(round(lasts_s * RATE_HZ)):
        was, read = read, COUNT_M * np.rint((m + rng.normal(0.0, NOISE_M, n)) / COUNT_M)
        spring = np.clip(k * read, 0.0, LIMIT_N)
        relaxing = stays * relaxing + adds_n_s_m * np.minimum(read - was, read) / period_s
        relaxing = np.where(read > 0, np.clip(relaxing, -spring, LIMIT_N - spring), 0.0)
        sent = spring + relaxing
        now = rests.at((cycle + 1) * period_s)
        pull = hand_n_m * (before + now) / 2 + hand_n_s_m * (now - before) / period_s - sent
        before = now
        for _ in range(PARTS):
            gone, speed = mm * m + mu * u + mp * pull, um * m + uu * u + up * pull
            energy += -sent * (gone - m) - b * part_s * (u * u + u * speed + speed * speed) / 3
            m, u = gone, speed
        most = np.maximum(most, energy)
    return most


def main() -> None:
    count, lasts_s = int(sys.argv[1]), float(sys.argv[2])
    of = len(DAMPINGS_N_S_M) * len(MASSES_KG)
    print("SIMULATED hands; K = 2500 N/m, C = 100 N s/m, limit 3 N, 2.5 kHz, told 0.05 kg")
    for counted in (0.0, 2.0):
        devices = shown(counted_n_s_m=counted)
        found, _ = given_j(devices, count, lasts_s)
        gaps, more = given_j(devices, count, lasts_s, gap=GAP)
        print(
            f"{counted:g} N s/m counted on from the hand: {len(devices)} of {of} devices are shown the block; "
            f"{np.sum(found > MOST_J)} of {count} manipulations of {lasts_s:g} s are given more than 0.1 mJ, most "
            f"{1e3 * found.max():.4f} mJ; with a gap of {1e3 * (GAP + 1) / RATE_HZ:g} ms in each {EVERY / RATE_HZ:.2g} "
            f"s {np.sum(gaps > MOST_J)}, most {1e3 * gaps.max():.4f} mJ; a gap gives {1e3 * more.max():.3f} mJ at most "
            f"above the law along the same path, in the middle {1e3 * np.quantile(more, 0.5):.3f} mJ"
        )
    block = load(shipped("crossover.toml")).table(Tapping)
    given = {"stiffness_n_m": block.stiffness_n_m, "damping_n_s_m": block.damping_n_s_m, "period_s": 1 / RATE_HZ}
    for hz in block.crossovers_hz:
        needed = sampled.needed_damping_n_s_m(**given, crossover_hz=hz)
        found = crossed_j(hz, needed, count, lasts_s)
        print(
            f"crossover at {hz:g} Hz, {needed:.2f} N s/m: {np.sum(found > MOST_J)} of {count} manipulations of "
            f"{lasts_s:g} s are given more than 0.1 mJ, most {1e3 * found.max():.4f} mJ"
        )


if __name__ == "__main__":
    main()
