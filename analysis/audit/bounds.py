"""What print allows: means in steps (GRIM), SDs of whole counts (GRIMMER), whole rows, and statistics as intervals.

A mean of n participants is a multiple of 1 / (n items) (Brown and Heathers 2017, Soc. Psychol. Personal. Sci. 8,
363-369); a sum of squares is whole, and odd where the sum is (Anaya 2016, PeerJ Preprints 4:e2400v1; Allard 2018,
Analytic-GRIMMER). A row stands where whole answers of every participant give all its ratios: a small integer program
over ways to answer, solved by HiGHS (scipy). A table found is checked in whole numbers; that there is none rests on
HiGHS. Statistics come from means and variances known only as far as they are printed; each is monotone in its
arguments, or bounded by such a function, so that an interval contains the values of any data.
"""

import functools
import math
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, product
from operator import or_

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.audit.intervals import Interval, either, hull, image, outward, point, rounded, sum_of
from palpate.analysis.published.numbers import PrintedCell, Scale
from palpate.analysis.statistics.inference import p_two_tailed

EXACT_STEPS = 500_000
"""Steps up to which sums of squares are found one by one; beyond, only parity and bounds are checked."""

ANY = Interval(Fraction(0), math.inf)
"""Every variance or sum of squares."""

MANY = 20_000
"""Ways of spreading one participant's trials beyond which a row is left undecided."""

MOST_SUMS = 200
"""Ways in which the printed means can add up beyond which a row is left undecided."""

MOST_COLUMNS = 60_000
"""Columns of all linear programmes for the rows of a file together, beyond which a row is left undecided.

A programme has a column for each way. Counted and not timed, so that every machine finds the same: 5 to 30 s.
"""

EACH_COLUMNS = 500
"""Columns that an integer programme counts as besides its own, because a small one takes its time too."""

MOST_MISSING = 20
"""The most trials without an answer that are tried in one row."""

ROUNDED, SD_EITHER, EITHER = (False, False), (False, True), (True, True)
"""Whether the mean, and whether the SD of a cell may be truncated as well as rounded."""


@dataclass
class Work:
    """How much work of one kind is left for a file; `left` is below 0 once it was not enough."""

    left: int

    def spend(self, amount: int) -> bool:
        """Return whether there was enough left."""
        self.left -= amount
        return self.left >= 0


@dataclass(frozen=True)
class Moments:
    """A mean and a variance (n - 1) that n values can have together, and the sums of counts and their squares."""

    n: int
    mean: Interval
    variance: Interval
    total: int | None = None
    squares: int | None = None


def totals(mean: Interval, n: int, items: int) -> range:
    """Return the whole sums over n participants whose mean lies in `mean`, which has finite ends."""
    low, high = mean.times(Fraction(n * items)).whole()
    return range(int(low), int(high) + 1)


def on_scale(sums: range, n: int, scale: Scale) -> range:
    """Return those of the sums that n values on the scale can have."""
    low = sums.start if scale.low is None else max(sums.start, n * scale.items * scale.low)
    return range(low, sums.stop if scale.high is None else min(sums.stop, n * scale.items * scale.high + 1))


def neighbours(mean: Fraction, n: int, scale: Scale) -> range:
    """Return the sums on either side of a mean, or the one that gives it; beyond the scale, that of the scale's end."""
    steps = mean * n * scale.items
    low = steps if scale.low is None else max(steps, Fraction(n * scale.items * scale.low))
    within = low if scale.high is None else min(low, Fraction(n * scale.items * scale.high))
    return range(math.floor(within), math.ceil(within) + 1)


def moments(total: int, n: int, scale: Scale, variance: Interval) -> Iterator[Moments]:
    """Yield every mean and variance of n values on `scale` with the count `total` and variance within `variance`."""
    if n < 2:
        return
    unit = scale.items**2
    shift = (scale.low if scale.low is not None else total // (n * scale.items)) * scale.items
    moved = total - n * shift
    centre = Fraction(moved * moved, n)
    wanted = variance.times(Fraction((n - 1) * unit)).plus(point(centre))
    mean = point(Fraction(total, n * scale.items))
    most = None if scale.low is None or scale.high is None else (scale.high - scale.low) * scale.items
    for squares in _squares(moved, n, most, wanted):
        spread = (squares - centre) / ((n - 1) * unit)
        whole = squares + 2 * shift * moved + n * shift * shift
        yield Moments(n, mean, point(spread), total, whole)


def _squares(total: int, n: int, most: int | None, wanted: Interval) -> Iterator[int]:
    """Yield the sums of squares in `wanted` of n counts from 0 to `most` with sum `total`; None is no upper limit."""
    bounds = _bounds(total, n, most)
    if bounds is None:
        return
    least, greatest = wanted.whole()
    low, high = int(max(bounds[0], least)), int(min(bounds[1], greatest))
    # A sum of squares is odd where the sum is: every x² - x is even.
    low += (low - total) % 2
    every = range(low, high + 1, 2)
    if most is None or _steps(total, n, most) > EXACT_STEPS:
        yield from every
        return
    # Counts from the other end have the same spread: with many of n * most, few are left.
    flipped = 2 * total > n * most
    bits = _attained(n * most - total if flipped else total, n, most)
    moved = (n * most - 2 * total) * most if flipped else 0
    yield from (squares for squares in every if bits >> (squares + moved) & 1)


def steps_to_find(total: int, n: int, scale: Scale) -> int:
    """Return the steps in which the sums of squares of n values with sum of counts `total` are found; 0 if not so."""
    if scale.low is None or scale.high is None:
        return 0
    most = (scale.high - scale.low) * scale.items
    found = _steps(total - n * scale.low * scale.items, n, most)
    return found if 0 <= found <= EXACT_STEPS else 0


def _steps(total: int, n: int, most: int) -> int:
    return n * (min(total, n * most - total) + 1) * (most + 1)


def _bounds(total: int, n: int, most: int | None) -> tuple[int, float] | None:
    """Return the smallest and largest sum of squares; None where the sum is out of reach."""
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


@functools.lru_cache(maxsize=256)
def _attained(total: int, n: int, most: int) -> int:
    """Return the sums of squares of n counts from 0 to `most` with sum `total`: bit q is set where q occurs."""
    reached = [1] + [0] * total
    for _ in range(n):
        reached = [
            functools.reduce(or_, (reached[sum_ - count] << count * count for count in range(min(most, sum_) + 1)))
            for sum_ in range(total + 1)
        ]
    return reached[total]


class Undecided(ValueError):
    """A row has no verdict; the text says why."""


Column = Mapping[int, Interval]
"""For one answer: each sum of counts that its mean can stand for, with the sums of squares that its SD allows."""


@dataclass(frozen=True)
class Row:
    """A row of so many `trials`, for which the means give from `fewest` to `most` answers.

    It `stands` on whole counts, with the cells `truncated`. Or `missing` (`missing_truncated`) is the fewest trials
    without an answer that explain it, None beyond `MOST_MISSING`, and one of the cells `misprinted` may be wrong.
    """

    trials: int
    fewest: int
    most: int
    stands: bool
    truncated: tuple[int, ...] = ()
    missing: int | None = None
    missing_truncated: int | None = None
    misprinted: tuple[int, ...] = ()


def examine(cells: Sequence[PrintedCell], n: int, trials: int, pinned: Mapping[int, Interval], work: Work) -> Row:
    """Return what whole counts say about a complete row of `n` participants with `trials` each, one cell per answer.

    `pinned` has variances of cells by index, and `work` what is left of `MOST_COLUMNS`. Raises `Undecided`.
    """
    answers = range(len(cells))
    columns = {
        reading: [_column(cell, n, trials, *reading, pinned=pinned.get(i)) for i, cell in enumerate(cells)]
        for reading in (ROUNDED, SD_EITHER, EITHER)
    }
    sums = [totals(either(cell.mean), n, trials) for cell in cells]
    fewest, most = sum(min(s, default=0) for s in sums), sum(max(s, default=0) for s in sums)

    def explains(cut: Collection[int]) -> bool:
        chosen = [columns[EITHER if i in cut else ROUNDED][i] for i in answers]
        return solve(chosen, n, trials, missing=0, work=work) is not None

    if explains(()):
        return Row(n * trials, fewest, most, True)
    if explains(answers):
        cut = list(answers)
        for i in answers:
            if explains([k for k in cut if k != i]):
                cut.remove(i)
        return Row(n * trials, fewest, most, True, tuple(cut))
    tried = range(1, min(MOST_MISSING, n * trials) + 1)
    missing = [
        next((gaps for gaps in tried if _has_counts(columns[reading], n, trials, gaps, work)), None)
        for reading in (SD_EITHER, EITHER)
    ]
    misprinted = tuple(_misprinted(columns[EITHER], n, trials, work))
    return Row(n * trials, fewest, most, False, (), missing[0], missing[1], misprinted)


def solve(columns: Sequence[Column], n: int, trials: int, *, missing: int, work: Work) -> NDArray[np.int64] | None:
    """Return counts, shape (n, answers), that give every column with so many `missing` answers, or None.

    Raises `Undecided` for too many ways, no answer of the search, or no `work` left.
    """
    ways = _ways(trials, len(columns), some_missing=missing > 0)
    for sums in _sums(columns, n * trials - missing):
        squares = [column[total] for column, total in zip(columns, sums, strict=True)]
        found = _programme(ways, n, sums, squares, work)
        if found is not None:
            return found
    return None


def _sums(columns: Sequence[Column], wanted: int) -> list[tuple[int, ...]]:
    """Return the sums of counts, one for each column, that add up to `wanted`."""
    if math.prod(max(1, len(column)) for column in columns) > MANY:
        raise Undecided(f"the printed means can represent more than {MANY} sums")
    found = [sums for sums in product(*columns) if sum(sums) == wanted]
    if len(found) > MOST_SUMS:
        raise Undecided(f"the printed means can add up in more than {MOST_SUMS} ways")
    return found


def _misprinted(columns: Sequence[Column], n: int, trials: int, work: Work) -> Iterator[int]:
    """Yield the cells without which the row would stand: with any count that fills the row, and any spread."""
    for i in range(len(columns)):
        others = product(*(column for k, column in enumerate(columns) if k != i))
        left = {n * trials - sum(rest) for rest in others}
        free = {total: ANY for total in sorted(left) if 0 <= total <= n * trials}
        if _has_counts([free if k == i else column for k, column in enumerate(columns)], n, trials, 0, work):
            yield i


def _has_counts(columns: Sequence[Column], n: int, trials: int, missing: int, work: Work) -> bool:
    """Return whether counts are found; an explanation that cannot be tried is not given."""
    try:
        return solve(columns, n, trials, missing=missing, work=work) is not None
    except Undecided:
        return False


def _column(cell: PrintedCell, n: int, trials: int, mean_cut: bool, sd_cut: bool, *, pinned: Interval | None) -> Column:
    sums = totals(either(cell.mean) if mean_cut else rounded(cell.mean), n, trials)
    if cell.sd is None:
        return dict.fromkeys(sums, ANY)
    spread = (either(cell.sd) if sd_cut else rounded(cell.sd)).squared()
    if pinned is not None and pinned.meets(spread):
        spread = pinned.common(spread)
    counted = spread.times(Fraction((n - 1) * trials**2))
    return {total: counted.plus(point(Fraction(total**2, n))) for total in sums}


def _ways(trials: int, answers: int, *, some_missing: bool) -> NDArray[np.int64]:
    """Return every way to spread trials over answers, shape (ways, answers); the trials left over have no answer."""
    places = answers + some_missing
    if math.comb(trials + places - 1, places - 1) > MANY:
        raise Undecided(f"{trials} trials can be divided among {places} answers in more than {MANY} ways")
    # The trials between two of places - 1 bars have one answer.
    bars = np.array(list(combinations(range(trials + places - 1), places - 1)), dtype=np.int64)
    return np.diff(bars, prepend=-1, append=trials + places - 1)[:, :answers] - 1


def _programme(
    ways: NDArray[np.int64], n: int, sums: Sequence[int], squares: Sequence[Interval], work: Work
) -> NDArray[np.int64] | None:
    from scipy.optimize import Bounds, LinearConstraint, milp

    low, high = zip(*((float(least), float(most)) for least, most in map(Interval.whole, squares)), strict=True)
    if any(least > most for least, most in zip(low, high, strict=True)):
        return None
    columns = len(ways) + EACH_COLUMNS
    nodes = work.left // columns
    if nodes < 1:
        raise Undecided(f"undecided: the search reached its limit of {MOST_COLUMNS} columns for all rows in the file")
    rows = np.vstack([np.ones(len(ways)), ways.T, (ways**2).T])
    constraint = LinearConstraint(rows, [n, *sums, *low], [n, *sums, *high])
    whole, limit = np.ones(len(ways)), {"node_limit": nodes}
    result = milp(0 * whole, constraints=constraint, integrality=whole, bounds=Bounds(0, n), options=limit)
    work.spend(columns * max(1, result.mip_node_count or 0))
    if result.status == 2:
        return None
    if result.x is None:
        raise Undecided("the search for whole counts stopped before it found any or showed that none exist")
    counts = np.repeat(ways, np.rint(result.x).astype(np.int64), axis=0)
    right = len(counts) == n and tuple(counts.sum(axis=0)) == tuple(sums)
    spread = [int(value) for value in (counts**2).sum(axis=0)]
    if not (right and all(one.holds(Fraction(value)) for one, value in zip(squares, spread, strict=True))):
        raise Undecided(
            "the search for whole counts reached its numerical precision without finding any that give the row"
        )
    return counts


@dataclass(frozen=True)
class Margin:
    """The mean of one level of an effect, with the weight of a mean of `n` values."""

    n: int | Fraction
    mean: Interval


_Span = tuple[int | Fraction, Fraction, Fraction]
"""The weight of a mean, and the ends of its interval."""


def effect(moments: Moments, null: Fraction) -> Interval | None:
    """Return Cohen's d, (mean - null) / SD, or None where there is no spread at all."""
    if moments.variance.high == 0:
        return None
    distance = moments.mean.plus(point(-null))
    low_sd, high_sd = (math.sqrt(end) for end in (moments.variance.low, moments.variance.high))
    low = _extended_ratio(float(distance.low), low_sd if distance.low < 0 else high_sd)
    high = _extended_ratio(float(distance.high), low_sd if distance.high > 0 else high_sd)
    return outward(low, high)


@functools.lru_cache(maxsize=4096)
def t_of(effect_size: Interval, n: int) -> Interval:
    """Return Student's t of one sample, d sqrt(n)."""
    return image(lambda d: d * math.sqrt(n), effect_size)


@functools.lru_cache(maxsize=4096)
def p_of_t(t: Interval, df: int) -> Interval:
    """Return the two-tailed P of t."""
    return image(lambda distance: p_two_tailed(distance, df), t.absolute())


def p_of_f(f: Interval, df: tuple[int, int]) -> Interval:
    """Return the P of F."""
    from scipy.special import fdtrc

    # Intervals widened outward may reach just below 0, where there is no F.
    return image(lambda value: float(fdtrc(*df, max(value, 0.0))), f)


def margin(cells: Sequence[Moments]) -> Margin:
    """Return one level's mean over all values of its cells, which an effect that enters first compares."""
    n = sum(cell.n for cell in cells)
    return Margin(n, sum_of(cell.mean.times(Fraction(cell.n, n)) for cell in cells))


def unweighted(cells: Sequence[Moments]) -> Margin:
    """Return one level's mean of its cells' means (type III), with variance as Yates (1934, squares of means)."""
    variance = sum((Fraction(1, cell.n) for cell in cells), Fraction(0)) / len(cells) ** 2
    return Margin(1 / variance, sum_of(cell.mean.times(Fraction(1, len(cells))) for cell in cells))


def ss_between(margins: Sequence[Margin]) -> Interval:
    """Return Σ n (mean - grand mean)², exact below, and around the intervals' middles above."""
    weight = sum(margin.n for margin in margins)
    spans = [(margin.n, Fraction(margin.mean.low), Fraction(margin.mean.high)) for margin in margins]
    centre = sum((n * (low + high) / 2 for n, low, high in spans), Fraction(0)) / weight
    most = sum((n * max(abs(low - centre), abs(high - centre)) ** 2 for n, low, high in spans), Fraction(0))
    return Interval(_least(spans), most)


def ss_within(cells: Sequence[Moments]) -> Interval:
    """Return the sum of squares within cells, Σ (n - 1) variance."""
    low = sum(((cell.n - 1) * cell.variance.low for cell in cells), Fraction(0))
    return Interval(low, sum(((cell.n - 1) * cell.variance.high for cell in cells), Fraction(0)))


def f_of(effect_ss: Interval, residual_ss: Interval, df: tuple[int, int]) -> Interval:
    """Return the F of an effect's and the residual's sums of squares."""
    factor = df[1] / df[0]
    low = _extended_ratio(float(effect_ss.low), float(residual_ss.high))
    return outward(factor * low, factor * _extended_ratio(float(effect_ss.high), float(residual_ss.low)))


def quotient(above: Interval, below: Interval) -> Interval:
    """Return every ratio of two numbers that are not negative."""
    low = _extended_ratio(max(float(above.low), 0.0), float(below.high))
    return outward(low, _extended_ratio(float(above.high), max(float(below.low), 0.0)))


def together(moments: Sequence[Moments]) -> Moments:
    """Return one pair of intervals around all the means and variances that a cell can have."""
    return Moments(moments[0].n, hull(one.mean for one in moments), hull(one.variance for one in moments))


def _least(spans: Sequence[_Span]) -> Fraction:
    """Return the least sum of squares, convex in the common centre and quadratic between the intervals' ends."""
    ends = sorted({end for _, *both in spans for end in both})
    beyond = bisect_left(ends, Fraction(0), key=lambda at: -sum((n * off for n, off in _off(spans, at)), Fraction(0)))
    centre = (ends[max(beyond - 1, 0)] + ends[beyond]) / 2
    if pulls := _off(spans, centre):
        centre += sum((n * off for n, off in pulls), Fraction(0)) / sum(n for n, _ in pulls)
    return sum((n * off**2 for n, off in _off(spans, centre)), Fraction(0))


def _off(spans: Sequence[_Span], centre: Fraction) -> list[tuple[int | Fraction, Fraction]]:
    """Return how far each interval lies from a centre outside of it, with its weight."""
    return [(n, (low if centre < low else high) - centre) for n, low, high in spans if not low <= centre <= high]


def _extended_ratio(above: float, below: float) -> float:
    """Return a ratio that may be infinite; 0 / 0 is 0."""
    if below == 0:
        return math.copysign(math.inf, above) if above else 0.0
    return above / below
