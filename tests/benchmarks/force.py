"""What force a SIMULATED hand feels that the force moves, beside what the law asks: `python -m tests.benchmarks.force`.

A hand (spring 300 N/m, damper 2 N s/m, 10 g) holds a device (mass and damping of its own) whose sensor has noise of
5 um and counts of 1 um; the servo is palpate's own `rendering.step`, with its observer. The hand is integrated exactly
between the servo's samples, apart from everything that renders. A tap is the hand's rest going in at a speed for 50 ms
and back; its error is the force held, against the law within the limit on the path that results, eight times a sample.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy.linalg import expm

from palpate.experiment.apparatus.servo import rendering
from palpate.experiment.apparatus.servo.observer import QUANTUM_SD, TOLD_KG
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, Rendered, bounded
from palpate.experiment.synthesis.contact.block import Block
from palpate.experiment.synthesis.contact.observer import Observer

STIFFNESS_N_M, DAMPING_N_S_M, LIMIT_N = 2500.0, 100.0, 3.0
NOISE_M, COUNT_M = 5e-6, 1e-6
HAND_N_M, HAND_N_S_M, HAND_KG = 300.0, 2.0, 0.01
INSIDE_M, STARTS_M, IN_S = 5e-4, 3e-3, 0.05
PARTS = 8
DEVICES_KG, RATES_HZ, SPEEDS_MM_S = (0.05, 0.1, 0.3), (2500, 5000, 10_000), (20, 50, 100, 175)
SETTLES_S = 1.0


@dataclass
class Hand:
    """A hand and its device, m inside of the block and m/s into it, under a force that is held."""

    moves_kg: float
    damping_n_s_m: float
    step_s: float
    at: tuple[float, float]

    def __post_init__(self) -> None:
        kg = self.moves_kg + HAND_KG
        plant = [[0, 1, 0], [-HAND_N_M / kg, -(HAND_N_S_M + self.damping_n_s_m) / kg, 1 / kg], [0, 0, 0]]
        self._steps = expm(np.array(plant) * self.step_s)[:2].tolist()

    def go_on(self, rest: tuple[float, float], force_n: float) -> None:
        pull = HAND_N_M * rest[0] + HAND_N_S_M * rest[1] - force_n
        (a, b, c), (d, e, f) = self._steps
        m, m_s = self.at
        self.at = a * m + b * m_s + c * pull, d * m + e * m_s + f * pull


def law_n(m: float, m_s: float) -> float:
    """Return the clamped law (4) within the limit, N."""
    return min(max(STIFFNESS_N_M * m + DAMPING_N_S_M * m_s, 0.0), LIMIT_N) if m > 0 else 0.0


@dataclass(frozen=True)
class Felt:
    """The force that was held, N, and the mean squares of its error and of the law, N^2."""

    held_n: np.ndarray
    error_n2: float
    law_n2: float


def felt(
    moves_kg: float,
    *,
    speed_m_s: float = 0.0,
    lasts_s: float = 0.0,
    rate_hz: int = 2500,
    damping_n_s_m: float = 0.1,
    late: int = 0,
    perfect: bool = False,
    seed: int = 0,
) -> Felt:
    """Return what a hand feels: of a tap at a speed, or of one that rests inside."""
    rng, period_us = np.random.default_rng(seed), 1_000_000 // rate_hz
    period_s = period_us * 1e-6
    noise_m = sqrt(NOISE_M**2 + (QUANTUM_SD * COUNT_M) ** 2)
    observer = Observer(period_s, noise_m, min(moves_kg, TOLD_KG))
    k, c = STIFFNESS_N_M, DAMPING_N_S_M
    block = Block((k, k), (c, c), (inf, inf), into=(-1.0, 0.0), nominal_s=period_s)
    begun_s = rng.uniform(0.0, period_s)
    turned_s = STARTS_M / speed_m_s + IN_S if speed_m_s else inf
    resting_m = INSIDE_M + k * INSIDE_M / HAND_N_M
    lasts_s = lasts_s + SETTLES_S if not speed_m_s else 2 * turned_s

    def rest(t_s: float) -> tuple[float, float]:
        """Where the hand would be without a force: it presses slowly first where it is to rest inside."""
        if speed_m_s:
            t_s = max(t_s - begun_s, 0.0)
            back = t_s > turned_s
            return speed_m_s * (min(t_s, 2 * turned_s - t_s)) - STARTS_M, -speed_m_s if back else speed_m_s
        pressing = (resting_m + STARTS_M) / (SETTLES_S / 2)
        return (pressing * t_s - STARTS_M, pressing) if t_s < SETTLES_S / 2 else (resting_m, 0.0)

    hand = Hand(moves_kg, damping_n_s_m, period_s / PARTS, (-STARTS_M, 0.0))
    at, sent_n, coming = Rendered(), NO_FORCE, [0.0] * late
    held_n, error_n2, law_n2 = [], 0.0, 0.0
    for n in range(round(lasts_s / period_s)):
        m, m_s = hand.at
        if perfect:
            force_n = law_n(m, m_s)
        else:
            place_mm = -1e3 * COUNT_M * round((m + rng.normal(0.0, NOISE_M)) / COUNT_M)
            at, _ = rendering.step(block, at, n * period_us, (place_mm, 0.0), observer, sent_n)
            sent_n = bounded(at.force_n, LIMIT_N)
            force_n = sent_n[0]
        coming.append(force_n)
        force_n = coming.pop(0)
        held_n.append(force_n)
        for part in range(PARTS):
            hand.go_on(rest((n + (part + 0.5) / PARTS) * period_s), force_n)
            asked_n = law_n(*hand.at)
            error_n2 += (force_n - asked_n) ** 2
            law_n2 += asked_n**2
    settled = 0 if speed_m_s else round(SETTLES_S / period_s)
    return Felt(np.array(held_n)[settled:], error_n2, law_n2)


def taps_off(moves_kg: float, speed_mm_s: float, taps: int, *, rate_hz: int = 2500, perfect: bool = False) -> float:
    """Return the rms error of taps over the rms of the law."""
    all_taps = [
        felt(moves_kg, speed_m_s=speed_mm_s * 1e-3, rate_hz=rate_hz, perfect=perfect, seed=seed) for seed in range(taps)
    ]
    return sqrt(sum(one.error_n2 for one in all_taps) / sum(one.law_n2 for one in all_taps))


def main() -> None:
    minutes, taps = (float(word) for word in (sys.argv[1:] + ["1", "20"][len(sys.argv) - 1 :]))
    print("SIMULATED hand that the force moves; K = 2500 N/m, C = 100 N s/m, limit 3 N, told 0.05 kg or its own mass")
    for kg in DEVICES_KG:
        for damping_n_s_m in (0.1, 5.0):
            still = felt(kg, lasts_s=60 * minutes, damping_n_s_m=damping_n_s_m).held_n
            late = felt(kg, lasts_s=6 * minutes, damping_n_s_m=damping_n_s_m, late=1).held_n
            print(
                f"{kg:g} kg, {damping_n_s_m:g} N s/m: rests inside {minutes:g} min: {still.mean():.3f} N, SD "
                f"{100 * still.std() / still.mean():.1f} %, {np.sum(still == 0)} zeros; a period late, SD "
                f"{100 * late.std() / late.mean():.1f} %, {np.sum(late == 0)} zeros"
            )
    for rate_hz in RATES_HZ:
        for kg in DEVICES_KG:
            offs = [taps_off(kg, speed, int(taps), rate_hz=rate_hz) for speed in SPEEDS_MM_S]
            best = [taps_off(kg, speed, int(taps), rate_hz=rate_hz, perfect=True) for speed in SPEEDS_MM_S]
            each = ", ".join(
                f"{speed} mm/s {100 * off:.0f} ({100 * least:.0f})"
                for speed, off, least in zip(SPEEDS_MM_S, offs, best, strict=True)
            )
            print(f"{rate_hz} Hz, {kg:g} kg: taps, % rms of the law (the perfect state held): {each}")


if __name__ == "__main__":
    main()
