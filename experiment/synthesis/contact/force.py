"""How far the force that a hand feels is from the block's law, cause by cause.

A SIMULATED hand (`HAND_N_M`, `HAND_N_S_M`, `HAND_KG`) holds the device's tip and is moved by the force. It rests inside
of the block, or taps: it touches at a speed, its rest goes in for `IN_S` more, and back. Causes come one after the
other, each beside those before it:

    hold       the force of the true place and speed is held from sample to sample
    delay      and comes late
    band       and the device follows it as a low-pass filter of first order
    observer   and place and speed are the observer's, of samples without noise
    noise      with noise in them, on the path that the hand took without it
    counts     and rounded to whole counts, on that path too
    trembling  all of it, on the path on which this moves the hand

An error is the rms of the force less the law within the limit, as a part of that law's rms, `PARTS` times a sample. At
rest the law is that of the place where the hand would rest, so the error is the force's SD. The limit is the last
cause: the same beside the law without it. Many hands are simulated at once, each at a moment of the servo's cycle of
its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import ceil, expm1, inf, pi

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.synthesis.contact.observer import Observer

HAND_N_M, HAND_N_S_M, HAND_KG = 300.0, 2.0, 0.01
"""Spring, damper and mass of the hand. Ours, as in `tests/benchmarks/force.py`."""

SPEEDS_MM_S = (20.0, 50.0, 100.0)
"""Speeds of taps, beside the fastest that the protocol has. Ours."""

INSIDE_M, FLIES_S, IN_S, SETTLES_S, RESTS_S = 5e-4, 0.02, 0.05, 0.25, 0.25
"""How deep a hand rests; how long it flies before a touch, goes on in, and settles and rests inside. Ours."""

HANDS, PARTS = 16, 8

SHOWN = 0.005
"""So large a part of the time without a force is shown."""

CAUSES = ("hold", "delay", "band", "observer", "noise", "counts", "trembling")
LIMIT = "limit"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Felt:
    """Errors of a hand at one speed, 0 at rest: parts (rms) of the law, by cause; what the law asks then, N: where it
    rests, or at the touch.

    `zero_part` is the part of the time at rest in which nothing is pushed.
    """

    speed_mm_s: float
    errors: dict[str, float]
    asked_n: float
    zero_part: float = 0.0

    @property
    def error(self) -> float:
        """All causes within the limit."""
        return self.errors[CAUSES[-1]]


@dataclass(frozen=True)
class ForceBudget:
    """The force's errors at rest, and at taps of rising speeds; `limit_n` is the largest force."""

    felt: tuple[Felt, ...]
    limit_n: float

    @property
    def worst(self) -> Felt:
        """Where the error within the limit is largest."""
        return max(self.felt, key=lambda one: one.error)

    def sentence(self) -> str:
        """Return in words what a hand feels."""
        still, *taps = self.felt
        taps_off = ", ".join(f"{one.error:.0%} at {one.speed_mm_s:g} mm/s" for one in taps)
        silent = f" and is zero {still.zero_part:.0%} of the time" if still.zero_part >= SHOWN else ""
        told = (
            f"For a SIMULATED hand at rest inside the block, the force has an SD of {still.error:.1%}{silent}. Taps "
            f"have an rms error of {taps_off}, relative to the rms of the law limited to {self.limit_n:g} N."
        )
        if (fastest := taps[-1]).asked_n > self.limit_n:
            told += f" The law requires {fastest.asked_n:.3g} N for a touch at {fastest.speed_mm_s:g} mm/s."
        return told

    def rows(self) -> list[dict[str, str | float]]:
        """Return a row for each cause: how far off the force is with it and those before, at rest and by speed."""
        names = ["rest", *(f"{one.speed_mm_s:g} mm/s" for one in self.felt[1:])]
        causes = self.felt[0].errors
        return [
            {"cause": cause, **{name: one.errors[cause] for name, one in zip(names, self.felt, strict=True)}}
            for cause in causes
        ]

    def lines(self) -> list[str]:
        """Return the rows as lines of text, in percent."""
        rows = self.rows()
        heads = [str(name) for name in rows[0]]
        shown = [heads] + [[str(row["cause"]), *(f"{row[name]:.1%}" for name in heads[1:])] for row in rows]
        return [f"{first:<10}" + "".join(f"{one:>12}" for one in others) for first, *others in shown]


@dataclass(frozen=True)
class Loop:
    """Block (`k` N/m, `c` N s/m), servo, sensor and device of a hand.

    A force is held for so many samples; `noise_m` is the SD of a sample before it is rounded to counts of `count_m`.
    The device's tip has a mass and a damping, and its force comes late, in a band.
    """

    k: float
    c: float
    limit_n: float
    observer: Observer
    noise_m: float
    count_m: float
    tip_kg: float
    tip_n_s_m: float
    delay_s: float = 0.0
    band_hz: float | None = None
    samples: int = 1

    @property
    def late(self) -> int:
        """The delay, in parts of a sample."""
        return ceil(round(self.delay_s / self.observer.period_s * PARTS, 6))

    @property
    def follows(self) -> float:
        """How far the device's force comes to the one sent, in a part of a sample."""
        return 1.0 if self.band_hz is None else -expm1(-2 * pi * self.band_hz * self.observer.period_s / PARTS)

    def budget(self, fastest_mm_s: float) -> ForceBudget:
        """Return the force's errors at rest, and at taps of `SPEEDS_MM_S` up to the fastest."""
        speeds = [v for v in SPEEDS_MM_S if v < fastest_mm_s] + [fastest_mm_s]
        return ForceBudget((*self.at(np.zeros(1)), *self.at(1e-3 * np.array(speeds))), self.limit_n)

    def law(self, m: Floats, m_s: Floats, most_n: float) -> Floats:
        """Return the clamped law (4), N, up to a limit; shape as given."""
        return np.where(m > 0.0, np.clip(self.k * m + self.c * m_s, 0.0, most_n), 0.0)

    def at(self, speeds_m_s: Floats) -> tuple[Felt, ...]:
        """Return what hands feel at speeds, m/s, shape (n,); all at rest where one is zero."""
        still = not speeds_m_s.all()
        hands = HANDS * 4 if still else HANDS
        shape = (len(CAUSES), speeds_m_s.size, hands)
        period_s = self.observer.period_s
        # What each cause begins with, as columns of all hands.
        number = np.arange(len(CAUSES))[:, None, None]
        true, noisy, counted = number < 3, number >= 4, number >= 5
        late, lags = number >= 1, np.where(number >= 2, self.follows, 1.0)
        inside_m = min(INSIDE_M, self.limit_n / 2 / self.k) if self.k else INSIDE_M
        speeds = np.broadcast_to(speeds_m_s[:, None], shape[1:])
        rng = np.random.default_rng(1)
        begun_s = -FLIES_S - (np.arange(hands) + 0.5) / hands * period_s * self.samples
        goes = partial(_goes_n, speeds, self.tip_n_s_m * speeds)
        m, m_s = np.broadcast_to(speeds * begun_s, shape).copy(), np.broadcast_to(speeds, shape).copy()
        held = np.zeros(shape)
        if still:
            m[:], held[:] = inside_m, self.k * inside_m
        seen, seen_s, seen_s2 = m.copy(), m_s.copy(), held / self.observer.mass_kg
        sent, pushed, coming = held.copy(), held.copy(), [held.copy()] * self.late
        rested_n = HAND_N_M * inside_m + self.k * inside_m
        alpha, beta, gamma = self.observer.gains
        beta, gamma = beta / period_s, gamma / period_s**2
        (a, b, g), (d, e, f) = _moved(self.tip_kg + HAND_KG, self.tip_n_s_m + HAND_N_S_M, period_s / PARTS)
        sums = np.zeros((4, *shape[:2]))
        zero = cycles = 0.0
        lasts_s = SETTLES_S + RESTS_S if still else 2 * (FLIES_S + IN_S)
        for n in range(ceil(lasts_s / period_s)):
            counts = still and n * period_s < SETTLES_S
            # The path without noise is that of "observer".
            m[4:6], m_s[4:6] = m[3], m_s[3]
            read = m + np.where(noisy, self.noise_m * rng.standard_normal(shape[1:]), 0.0)
            read = np.where(counted, self.count_m * np.rint(read / self.count_m), read)
            told = sent.copy()
            told[4:6] = sent[3]
            if n:
                by = seen_s2 - told / self.observer.mass_kg
                ahead = seen + (seen_s + by * (period_s / 2)) * period_s
                off = read - ahead
                seen, seen_s, seen_s2 = ahead + alpha * off, seen_s + by * period_s + beta * off, seen_s2 + gamma * off
            if n % self.samples == 0:
                sent = self.law(np.where(true, m, seen), np.where(true, m_s, seen_s), self.limit_n)
            for part in range(PARTS):
                coming.append(sent)
                pushed = pushed + lags * (np.where(late, coming.pop(0), sent) - pushed)
                pull = rested_n if still else goes(begun_s + (n + (part + 0.5) / PARTS) * period_s)
                pull = pull - pushed
                m, m_s = a * m + b * m_s + g * pull, d * m + e * m_s + f * pull
                if counts or (still and part):
                    continue
                m[4:6], m_s[4:6] = m[3], m_s[3]
                all_of_it = np.full(shape, self.k * inside_m) if still else self.law(m, m_s, inf)
                wanted = np.minimum(all_of_it, self.limit_n)
                sums += [
                    ((pushed - wanted) ** 2).sum(axis=2),
                    (wanted**2).sum(axis=2),
                    ((pushed - all_of_it) ** 2).sum(axis=2),
                    (all_of_it**2).sum(axis=2),
                ]
                if still:
                    zero += float((pushed[-1] == 0.0).sum())
                    cycles += hands
        return self._errors(sums, speeds_m_s, inside_m, zero / cycles if still else 0.0)

    def _errors(self, sums: Floats, speeds_m_s: Floats, inside_m: float, zero_part: float) -> tuple[Felt, ...]:
        there = [True, self.late > 0, self.follows < 1.0, True, self.noise_m > 0, self.count_m > 0, True]
        off, beyond = np.sqrt(sums[0] / sums[1]), np.sqrt(sums[2, -1] / sums[3, -1])
        return tuple(
            Felt(
                round(1e3 * float(v), 9),
                {cause: float(off[n, i]) for n, cause in enumerate(CAUSES) if there[n]} | {LIMIT: float(beyond[i])},
                float(self.c * v) if v else self.k * inside_m,
                zero_part,
            )
            for i, v in enumerate(speeds_m_s)
        )


def _goes_n(speeds: Floats, ahead_n: Floats, t_s: Floats) -> Floats:
    """Return the pull of a tapping hand's rest, N: it goes in and back, ahead of a hand whose device takes force."""
    back = t_s > IN_S
    goes_m = speeds * np.where(back, 2 * IN_S - t_s, t_s)
    return HAND_N_M * goes_m + ahead_n + HAND_N_S_M * np.where(back, -speeds, speeds)


def _moved(kg: float, damping_n_s_m: float, step_s: float) -> list[list[float]]:
    """Return what a step does to place and speed under a pull, N, that stays: rows of their factors."""
    from scipy.linalg import expm

    plant = [[0.0, 1.0, 0.0], [-HAND_N_M / kg, -damping_n_s_m / kg, 1 / kg], [0.0, 0.0, 0.0]]
    moved: list[list[float]] = expm(np.array(plant) * step_s)[:2].tolist()
    return moved
