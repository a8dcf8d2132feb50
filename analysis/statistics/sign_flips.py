"""The exact test by sign flips over participants, of one study or of many (Fisher 1935, section 21).

Sums of each half of the participants are enumerated, and those of both counted by binary search (Horowitz and Sahni
1974, J. ACM 21, 277-292); where they are too many, signs are drawn (Phipson and Smyth 2010, Stat. Appl. Genet. Mol. 9).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Number, Values, integers

MOST_SUMS = 2**22
"""Sums of half of the participants, of one more participant at a time, beyond which signs are drawn: some 2 x 20."""

DRAWS = 99_999


@dataclass(frozen=True)
class SignFlip:
    """The two-sided P of the mean of `n` participants, and the `least` P that those who differ from the null allow.

    `error` is the Monte Carlo standard error of a P from `DRAWS` drawn signs, None of one that is exact.
    """

    n: int
    p: float
    least: float
    error: float | None = None


def sign_flip(values: Sequence[Number], null: Number, rng: np.random.Generator) -> SignFlip:
    """Return the test that values, shape (participants,), lie around `null`, by the signs of their distances.

    All signs count where their sums can be enumerated, as of any 40 participants; else they are drawn. Raises
    `NotDefined` without a participant.
    """
    if not values:
        raise NotDefined("nobody was presented this material")
    whole, _ = integers([Fraction(value) - Fraction(null) for value in values])
    common = math.gcd(*whole) or 1
    steps = sorted(abs(value) // common for value in whole if value)
    reached = abs(sum(whole)) // common
    least = 2.0 ** (1 - len(steps)) if steps else 1.0
    if not reached:
        return SignFlip(len(whole), 1.0, least)
    one = _sums(steps[1::2], sum(steps))
    other = one and _sums(steps[::2], sum(steps))
    if one is None or other is None:
        p = _drawn(steps, reached, rng)
        return SignFlip(len(whole), p, least, math.sqrt(p * (1 - p) / DRAWS))
    (first, shares), (second, others) = one, other
    above = np.append(np.cumsum(others[::-1])[::-1], 0.0)
    tail = float(shares @ above[np.searchsorted(second, reached - first)])
    return SignFlip(len(whole), min(1.0, 2 * tail), least)


def _sums(steps: Sequence[int], total: int) -> tuple[Values, Floats] | None:
    """Return the sums of signed steps, in order, and the share of signs that give each; None for too many."""
    sums = np.zeros(1, dtype=np.int64 if total < 2**62 else object)
    shares = np.ones(1)
    work = 0
    for step in steps:
        both = np.concatenate([sums - step, sums + step])
        order = np.argsort(both, kind="stable")
        both = both[order]
        starts = np.flatnonzero(np.append(True, both[1:] != both[:-1]))
        sums, shares = both[starts], np.add.reduceat(np.tile(shares / 2, 2)[order], starts)
        work += sums.size
        if work > MOST_SUMS:
            return None
    return sums, shares


def _drawn(steps: Sequence[int], reached: int, rng: np.random.Generator) -> float:
    """Return P from drawn signs, of which the observed ones are one."""
    sizes, often = np.unique(np.array(steps, dtype=object) / reached, return_counts=True)
    sums = np.zeros(DRAWS)
    for size, count in zip(sizes.astype(np.float64), often.tolist(), strict=True):
        # A single bit takes a tenth of the time of a binomial count.
        sums += size * (2 * (rng.binomial(count, 0.5, DRAWS) if count > 1 else rng.integers(2, size=DRAWS)) - count)
    return float((np.count_nonzero(np.abs(sums) >= 1 - 1e-12) + 1) / (DRAWS + 1))


def sign_flip_tests(counts: Integers, trials: int, chance: Fraction) -> Floats:
    """Return P of many studies from counts out of `trials`, shape (..., participants), to within 1e-12.

    The sum's characteristic function, a product of cosines, is added up with Dirichlet's kernel at as many points as
    steps.
    """
    distances = chance.denominator * np.arange(trials + 1) - chance.numerator * trials
    common = math.gcd(*distances.tolist()) or 1
    sizes, place = np.unique(abs(distances) // common, return_inverse=True)
    people = counts.shape[-1]
    points = people * int(sizes[-1]) + 1
    # Sums of one parity lie on half a circle, of which both halves are alike.
    angles = np.pi * np.arange(1, (points + 1) // 2) / points
    half = np.pi / 2 if points % 2 == 0 else None
    places = place[counts].reshape(-1, people)
    reached = abs((distances[counts] // common).sum(axis=-1)).ravel()
    every = np.append(angles, half) if half else angles
    weights = np.append(np.full(angles.size, 2.0), np.ones(every.size - angles.size)) / np.sin(every) / points
    cosines = np.cos(np.outer(sizes, every))
    base, kinds, back = people + 1, np.arange(len(places)), None
    if few := base ** len(sizes) * (int(reached.max(initial=0)) + 1) < 2**63:
        # Studies with as many participants at each distance, and one sum, share their P, which is found once.
        often = np.stack([(places == k).sum(axis=-1) for k in range(len(sizes))], axis=-1)
        names = often @ base ** np.arange(len(sizes)) + reached * base ** len(sizes)
        _, kinds, back = np.unique(names, return_index=True, return_inverse=True)
        powers = cosines[:, None, :] ** np.arange(base)[None, :, None]
    found = np.empty(len(kinds))
    rows = max(1, HELD // points)
    for first in range(0, len(kinds), rows):
        part = kinds[first : first + rows]
        wave = weights * np.sin(np.outer(reached[part] - 1, every))
        if few:
            factors = (powers[k][often[part, k]] for k in range(len(sizes)))
        else:
            factors = (cosines[one] for one in places[part].T)
        for factor in factors:
            wave *= factor
        found[first : first + rows] = 1 - (reached[part] - 1) / points - wave.sum(axis=1)
    found = found if back is None else found[back]
    return np.clip(np.where(reached > 0, found, 1.0), 0.0, 1.0).reshape(counts.shape[:-1])


HELD = 30_000
"""Values of characteristic functions that are held at a time, so that they stay in a processor's cache."""
