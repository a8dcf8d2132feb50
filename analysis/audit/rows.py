"""Can the printed ratios of one row stand together: do whole answers of every participant give them all at once?

Participants whose answers are alike are interchangeable, so a table of counts is how many participants gave each way of
spreading their trials over the answers: a small integer programme, which HiGHS (scipy) solves. A table that is found is
checked in whole numbers; that there is none rests on HiGHS. Rows with more than `MANY` ways are not decided.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from analysis.audit.granularity import totals
from analysis.published.numbers import PrintedCell
from analysis.published.printed import Interval, Printed

MANY = 20_000
"""Ways of spreading one participant's trials beyond which a row is left undecided."""

MOST_SUMS = 200
"""Ways in which the printed means can add up beyond which a row is left undecided."""

MOST_S = 10.0
"""Time for one integer programme, s."""

MOST_MISSING = 20
"""Trials without an answer, in one row, that are tried."""


ROUNDED, SD_EITHER, EITHER = (False, False), (False, True), (True, True)
"""Whether mean and SD of a cell may be truncated as well as rounded."""


class Undecided(ValueError):
    """No verdict on a row; the text says why."""


@dataclass(frozen=True)
class Column:
    """One answer: each sum of counts that its mean can stand for, with the sums of squares that its SD can."""

    squares: Mapping[int, Interval]


@dataclass(frozen=True)
class Row:
    """What was found about a row.

    Args:
        trials: of all participants with the material.
        fewest, most: answers that the printed means can stand for.
        stands: whether whole counts give every cell, rounded or truncated.
        truncated: indices of cells without whose truncation it would not; empty where all may be rounded.
        missing: fewest trials without an answer that would explain a row that does not stand, its means rounded; None
            where none up to `MOST_MISSING` would.
        missing_truncated: the same, its means rounded or truncated.
        misprinted: indices of cells such that the row would stand with any other value of one of them.
    """

    trials: int
    fewest: int
    most: int
    stands: bool
    truncated: tuple[int, ...] = ()
    missing: int | None = None
    missing_truncated: int | None = None
    misprinted: tuple[int, ...] = ()


def row_sum(means: Sequence[Printed]) -> Interval:
    """Every sum that ratios can have which print like this."""
    total = means[0].either
    for mean in means[1:]:
        total = total.plus(mean.either)
    return total


def examine(cells: Sequence[PrintedCell], n: int, trials: int, pinned: Mapping[int, Interval]) -> Row:
    """Look for counts behind a complete row.

    Args:
        cells: one a possible answer.
        n: participants.
        trials: of each of them with this material.
        pinned: index of a cell -> its variances, where a test says more than the SD does.

    Raises:
        Undecided: when there are too many ways, or HiGHS gives no answer.
    """
    answers = range(len(cells))
    columns = {
        reading: [_column(cell, n, trials, *reading, pinned=pinned.get(i)) for i, cell in enumerate(cells)]
        for reading in (ROUNDED, SD_EITHER, EITHER)
    }
    sums = [totals(cell.mean.either, n, trials) for cell in cells]
    fewest, most = sum(min(s, default=0) for s in sums), sum(max(s, default=0) for s in sums)

    def stands(cut: Collection[int]) -> bool:
        chosen = [columns[EITHER if i in cut else ROUNDED][i] for i in answers]
        return solve(chosen, n, trials, missing=0) is not None

    if stands(()):
        return Row(n * trials, fewest, most, True)
    if stands(answers):
        cut = list(answers)
        for i in answers:
            if stands([k for k in cut if k != i]):
                cut.remove(i)
        return Row(n * trials, fewest, most, True, tuple(cut))
    tried = range(1, min(MOST_MISSING, n * trials) + 1)
    missing = [
        next((gaps for gaps in tried if _stands(columns[reading], n, trials, gaps)), None)
        for reading in (SD_EITHER, EITHER)
    ]
    misprinted = tuple(_misprinted(columns[EITHER], n, trials))
    return Row(n * trials, fewest, most, False, (), missing[0], missing[1], misprinted)


def solve(columns: Sequence[Column], n: int, trials: int, *, missing: int) -> NDArray[np.int64] | None:
    """Counts of n participants, shape (n, answers), that give every column; None when there are none.

    Args:
        columns: one an answer.
        n: participants.
        trials: of each of them.
        missing: trials without an answer, in all.

    Raises:
        Undecided: see `examine`.
    """
    ways = _ways(trials, len(columns), some_missing=missing > 0)
    for sums in _sums(columns, n * trials - missing):
        squares = [column.squares[total] for column, total in zip(columns, sums, strict=True)]
        found = _programme(ways, n, sums, squares)
        if found is not None:
            return found
    return None


def _sums(columns: Sequence[Column], wanted: int) -> list[tuple[int, ...]]:
    """The sums of counts, one a column, that add up to `wanted`."""
    if math.prod(max(1, len(column.squares)) for column in columns) > MANY:
        raise Undecided(f"the printed means can stand for more than {MANY} sums")
    found = [sums for sums in product(*(column.squares for column in columns)) if sum(sums) == wanted]
    if len(found) > MOST_SUMS:
        raise Undecided(f"the printed means can add up in more than {MOST_SUMS} ways")
    return found


def _misprinted(columns: Sequence[Column], n: int, trials: int) -> Iterator[int]:
    """Cells that a row without gaps would do without: any count that fills it, with any spread."""
    for i in range(len(columns)):
        others = product(*(column.squares for k, column in enumerate(columns) if k != i))
        left = {n * trials - sum(rest) for rest in others}
        free = Column({total: Interval(Fraction(0), math.inf) for total in sorted(left) if 0 <= total <= n * trials})
        if _stands([free if k == i else column for k, column in enumerate(columns)], n, trials, 0):
            yield i


def _stands(columns: Sequence[Column], n: int, trials: int, missing: int) -> bool:
    """Whether there are counts, as far as can be decided: an explanation that cannot be tried is none."""
    try:
        return solve(columns, n, trials, missing=missing) is not None
    except Undecided:
        return False


def _column(cell: PrintedCell, n: int, trials: int, mean_cut: bool, sd_cut: bool, *, pinned: Interval | None) -> Column:
    sums = totals(cell.mean.either if mean_cut else cell.mean.rounded, n, trials)
    if cell.sd is None:
        return Column({total: Interval(Fraction(0), math.inf) for total in sums})
    spread = (cell.sd.either if sd_cut else cell.sd.rounded).squared()
    if pinned is not None and pinned.meets(spread):
        spread = pinned.common(spread)
    unit = (n - 1) * trials**2
    return Column(
        {
            total: Interval(
                spread.low * unit + Fraction(total**2, n),
                spread.high * unit + Fraction(total**2, n),
                spread.open_low,
                spread.open_high,
            )
            for total in sums
        }
    )


def _ways(trials: int, answers: int, *, some_missing: bool) -> NDArray[np.int64]:
    """Every way to spread trials over answers, shape (ways, answers); trials without an answer are left out."""
    places = answers + some_missing
    if math.comb(trials + places - 1, places - 1) > MANY:
        raise Undecided(f"{trials} trials spread over {places} answers in more than {MANY} ways")
    return np.array([way[:answers] for way in _compositions(trials, places)], dtype=np.int64)


def _compositions(total: int, places: int) -> Iterable[tuple[int, ...]]:
    if places == 1:
        yield (total,)
        return
    for first in range(total + 1):
        for rest in _compositions(total - first, places - 1):
            yield (first, *rest)


def _programme(
    ways: NDArray[np.int64], n: int, sums: Sequence[int], squares: Sequence[Interval]
) -> NDArray[np.int64] | None:
    from scipy.optimize import Bounds, LinearConstraint, milp

    low, high = [_whole(one, up=True) for one in squares], [_whole(one, up=False) for one in squares]
    if any(least > most for least, most in zip(low, high, strict=True)):
        return None
    rows = np.vstack([np.ones(len(ways)), ways.T, (ways**2).T])
    constraint = LinearConstraint(rows, [n, *sums, *low], [n, *sums, *high])
    result = milp(
        np.zeros(len(ways)),
        constraints=constraint,
        integrality=np.ones(len(ways)),
        bounds=Bounds(0, n),
        options={"time_limit": MOST_S},
    )
    if result.status == 2:
        return None
    if result.x is None:
        raise Undecided(f"HiGHS gives no answer ({result.message})")
    counts = np.repeat(ways, np.rint(result.x).astype(np.int64), axis=0)
    right = len(counts) == n and tuple(counts.sum(axis=0)) == tuple(sums)
    spread = [int(value) for value in (counts**2).sum(axis=0)]
    if not (right and all(one.holds(Fraction(value)) for one, value in zip(squares, spread, strict=True))):
        raise Undecided("HiGHS found counts that do not give the row")
    return counts


def _whole(interval: Interval, *, up: bool) -> float:
    """The first whole number from the low end, or from the high end."""
    end = interval.low if up else interval.high
    if end in (math.inf, -math.inf):
        return float(end)
    whole = math.ceil(end) if up else math.floor(end)
    opened = whole == end and (interval.open_low if up else interval.open_high)
    return float(whole + opened if up else whole - opened)
