"""What whole counts allow: means in steps (GRIM), and standard deviations that some counts have (GRIMMER).

A participant's value is a whole number of items over the number of items; a mean of n of them is a multiple of
1 / (n items) (Brown and Heathers 2017, Soc. Psychol. Personal. Sci. 8, 363-369). A sum of squares is a whole number as
well, odd where the sum is odd (Anaya 2016, PeerJ Preprints 4:e2400v1; Allard 2018, Analytic-GRIMMER). On a scale with
two ends the sums of squares that occur are found one by one, which no bound on them can better.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

from analysis.published.numbers import Scale
from analysis.published.printed import Interval, point

EXACT_STEPS = 500_000
"""Steps up to which sums of squares are found one by one; beyond, parity and bounds alone are asked."""


@dataclass(frozen=True)
class Moments:
    """A mean and a variance (n - 1) that n values can have together; points, or intervals where they have no steps.

    `total` and `squares` are the sums of counts and of squared counts behind them, where the values are counts.
    """

    n: int
    mean: Interval
    variance: Interval
    total: int | None = None
    squares: int | None = None


def totals(mean: Interval, n: int, items: int) -> range:
    """Whole sums over n participants whose mean lies in `mean`, which has finite ends."""
    steps = n * items
    low, high = math.ceil(mean.low * steps), math.floor(mean.high * steps)
    low += mean.open_low and low == mean.low * steps
    high -= mean.open_high and high == mean.high * steps
    return range(low, high + 1)


def on_scale(sums: range, n: int, scale: Scale) -> range:
    """Those of the sums that n values on the scale can have."""
    low = sums.start if scale.low is None else max(sums.start, n * scale.items * scale.low)
    return range(low, sums.stop if scale.high is None else min(sums.stop, n * scale.items * scale.high + 1))


def neighbours(mean: Fraction, n: int, scale: Scale) -> range:
    """The sums on either side of a mean, or the one that gives it; beyond the scale its end."""
    steps = mean * n * scale.items
    low = steps if scale.low is None else max(steps, Fraction(n * scale.items * scale.low))
    within = low if scale.high is None else min(low, Fraction(n * scale.items * scale.high))
    return range(math.floor(within), math.ceil(within) + 1)


def moments(total: int, n: int, scale: Scale, variance: Interval) -> Iterator[Moments]:
    """Every mean and variance of n values on `scale` with sum of counts `total` and variance within `variance`.

    `variance` may have no upper end where the scale has both ends.
    """
    if n < 2:
        return
    unit = scale.items**2
    shift = (scale.low if scale.low is not None else total // (n * scale.items)) * scale.items
    moved = total - n * shift
    centre = Fraction(moved * moved, n)
    least, most = (
        centre + variance.low * (n - 1) * unit,
        math.inf if variance.high == math.inf else centre + variance.high * (n - 1) * unit,
    )
    wanted = Interval(least, most, variance.open_low, variance.open_high)
    mean = point(Fraction(total, n * scale.items))
    for squares in _squares(moved, n, _counts(scale), wanted):
        spread = (squares - centre) / ((n - 1) * unit)
        whole = squares + 2 * shift * moved + n * shift * shift
        yield Moments(n, mean, point(spread), total, whole)


def _counts(scale: Scale) -> int | None:
    if scale.low is None or scale.high is None:
        return None
    return (scale.high - scale.low) * scale.items


def _squares(total: int, n: int, most: int | None, wanted: Interval) -> Iterator[int]:
    """Sums of squares within `wanted` of n counts with sum `total`, each from 0 to `most` (None: any whole numbers)."""
    bounds = _bounds(total, n, most)
    if bounds is None:
        return
    low = max(bounds[0], math.ceil(max(wanted.low, 0)))
    high = bounds[1] if wanted.high == math.inf else min(bounds[1], math.floor(wanted.high))
    # A sum of squares is odd where the sum is: every x² - x is even.
    low += (low - total) % 2
    found = None
    if most is not None and n * (min(total, n * most - total) + 1) * (most + 1) <= EXACT_STEPS:
        # Counts from the other end have the same spread: with many of n * most, few are left.
        flipped = 2 * total > n * most
        found = _attained(n * most - total if flipped else total, n, most), flipped
    for squares in range(low, int(high) + 1, 2):
        if not wanted.holds(Fraction(squares)):
            continue
        if found is not None and most is not None:
            bits, flipped = found
            at = squares - 2 * most * total + n * most * most if flipped else squares
            if not bits >> at & 1:
                continue
        yield squares


def _bounds(total: int, n: int, most: int | None) -> tuple[int, float] | None:
    """Smallest and largest sum of squares; None where the sum is out of reach."""
    each, rest = divmod(total, n)
    least = (n - rest) * each**2 + rest * (each + 1) ** 2
    if most is None:
        return least, math.inf
    if not 0 <= total <= n * most:
        return None
    if most == 0:
        return 0, 0
    full, left = divmod(total, most)
    return least, full * most**2 + left**2


@lru_cache(maxsize=256)
def _attained(total: int, n: int, most: int) -> int:
    """Bit q is set where n counts from 0 to `most` with sum `total` have sum of squares q."""
    reached = [1] + [0] * total
    for _ in range(n):
        reached = [_next(reached, sum_, most) for sum_ in range(total + 1)]
    return reached[total]


def _next(reached: list[int], total: int, most: int) -> int:
    bits = 0
    for count in range(min(most, total) + 1):
        bits |= reached[total - count] << count * count
    return bits
