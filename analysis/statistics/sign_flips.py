"""The exact test by sign flips over participants, of one study or of many (Fisher 1935, section 21).

Sums of each half of the participants are enumerated, and those of both counted by binary search (Horowitz and Sahni
1974, J. ACM 21, 277-292); where they are too many, signs are drawn (Phipson and Smyth 2010, Stat. Appl. Genet. Mol. 9).
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Number, integers

MOST_SUMS = 2**22
"""Sums of half of the participants, of one more participant at a time, beyond which signs are drawn: some 2 x 20."""

GRID = 2**41
"""Steps of the grid on which sums beyond 62 bits are compared; with the place of a sum they fit in 63 bits."""

PLACE_BITS = 21
"""Bits of the place of a sum: half of the participants have at most so many sums."""

MOST_DOUBTFUL = 2**16
"""Pairs of sums too close to call on the grid beyond which signs are drawn."""

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
        raise NotDefined("this material was not presented")
    whole, _ = integers([Fraction(value) - Fraction(null) for value in values])
    common = math.gcd(*whole) or 1
    steps = sorted(abs(value) // common for value in whole if value)
    reached = abs(sum(whole)) // common
    least = 2.0 ** (1 - len(steps)) if steps else 1.0
    if not reached:
        return SignFlip(len(whole), 1.0, least)
    tail = _tail(steps, reached) if sum(steps) < 2**62 else _large_tail(steps, reached)
    if tail is None:
        p = _drawn(steps, reached, rng)
        return SignFlip(len(whole), p, least, math.sqrt(p * (1 - p) / DRAWS))
    return SignFlip(len(whole), min(1.0, 2 * tail), least)


def _tail(steps: Sequence[int], reached: int) -> float | None:
    """Return the share of signs whose sum is `reached` or more, or None for too many sums; a sum fits in 63 bits."""
    one = _sums(steps[1::2])
    other = one and _sums(steps[::2])
    if one is None or other is None:
        return None
    (first, shares), (second, others) = one, other
    return float(shares @ _reversed_sums(others)[np.searchsorted(second, reached - first)])


def _sums(steps: Sequence[int]) -> tuple[Integers, Floats] | None:
    """Return the sums of signed steps, in order, and the share of signs that give each; None for too many."""
    sums = np.zeros(1, dtype=np.int64)
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


def _reversed_sums(shares: Floats) -> Floats:
    return np.append(np.cumsum(shares[::-1])[::-1], 0.0)


def _large_tail(steps: Sequence[int], reached: int) -> float | None:
    """Return what `_tail` does, of steps of any size; None where sums, or those too close to call, are too many.

    Sums are compared on a grid of whole numbers, and those less than its error apart in Python's integers.
    """
    halves: tuple[list[tuple[int, int]], ...] = ([], [])
    sizes = [1, 1]
    for step, often in Counter(steps).most_common():
        place = sizes.index(min(sizes))
        halves[place].append((step, often))
        sizes[place] *= often + 1
    if max(sizes) > 2**PLACE_BITS:
        return None
    total = sum(steps)
    (first, rows, shares), (second, columns, others) = (_grid(half, total) for half in halves)
    first, rows, shares = first[::-1], rows[::-1], shares[::-1]
    error = len(steps) + 1
    goals = reached * GRID // total - first
    sure = np.searchsorted(second, goals + error)
    tail = float(shares @ _reversed_sums(others)[sure])
    doubtful = np.flatnonzero((sure > 0) & (second[sure - 1] >= goals - error))
    begins = np.searchsorted(second, goals[doubtful] - error)
    if int((sure[doubtful] - begins).sum()) > MOST_DOUBTFUL:
        return None
    for row, begin in zip(doubtful, begins, strict=True):
        missing = reached - _whole_sum(halves[0], int(rows[row]))
        near = [at for at in range(begin, sure[row]) if _whole_sum(halves[1], int(columns[at])) >= missing]
        tail += float(shares[row] * others[near].sum())
    return tail


def _grid(half: Sequence[tuple[int, int]], total: int) -> tuple[Integers, Integers, Floats]:
    """Return the signed sums of steps, each so often, in order and in units of total / GRID, their places and shares.

    A place says which signs gave a sum, a share how many of all signs did.
    """
    sums, shares = np.zeros(1, dtype=np.int64), np.ones(1)
    for step, often in half:
        turned = (2 * np.arange(often + 1) - often) * (step * GRID // total)
        sums = np.add.outer(turned, sums).ravel()
        shares = np.multiply.outer([math.comb(often, up) / 2**often for up in range(often + 1)], shares).ravel()
    # Sums that bring their places along are sorted in half the time that it takes to sort places by sums.
    both = np.sort((sums << PLACE_BITS) + np.arange(sums.size))
    places = both & (2**PLACE_BITS - 1)
    return both >> PLACE_BITS, places, shares[places]


def _whole_sum(half: Sequence[tuple[int, int]], place: int) -> int:
    """Return the sum at a place of `_grid`, in whole numbers."""
    found = 0
    for step, often in half:
        place, up = divmod(place, often + 1)
        found += (2 * up - often) * step
    return found


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
