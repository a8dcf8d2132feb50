"""Rows as whole counts: brute force over small tables, and rows that were printed without a mistake."""

from __future__ import annotations

import statistics
from fractions import Fraction
from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.audit.bounds import MOST_COLUMNS, Undecided, Work, examine, solve
from palpate.analysis.audit.intervals import Interval
from palpate.analysis.published.numbers import PrintedCell, Scale
from palpate.analysis.published.printed import Printed


def _cells(printed: list[tuple[str, str | None]], trials: int) -> list[PrintedCell]:
    return [
        PrintedCell("Table", "task", "a", str(k), Printed(mean), Printed(sd) if sd else None, "", Scale(trials))
        for k, (mean, sd) in enumerate(printed)
    ]


def _printed(counts: list[tuple[int, ...]], trials: int, digits: int) -> list[tuple[str, str | None]]:
    columns = [[Fraction(row[k], trials) for row in counts] for k in range(len(counts[0]))]
    return [
        (f"{float(statistics.mean(column)):.{digits}f}", f"{statistics.stdev(map(float, column)):.{digits}f}")
        for column in columns
    ]


def _ways(trials: int, answers: int) -> list[tuple[int, ...]]:
    if answers == 1:
        return [(trials,)]
    return [(first, *rest) for first in range(trials + 1) for rest in _ways(trials - first, answers - 1)]


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=3, max_size=3),
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 6)), min_size=3, max_size=3),
)
def test_solve_finds_counts_where_trying_all_of_them_does(
    sums: list[tuple[int, int]], squares: list[tuple[int, int]]
) -> None:
    """Three participants, three trials, three answers: every multiset of ways."""
    columns = [
        {total: Interval(Fraction(low), Fraction(low + width)) for total in {first, first + extra}}
        for (first, extra), (low, width) in zip(sums, squares, strict=True)
    ]
    found = solve(columns, 3, 3, missing=0, work=Work(MOST_COLUMNS))

    def fits(table: tuple[tuple[int, ...], ...]) -> bool:
        for column, values in zip(columns, zip(*table, strict=True), strict=True):
            wanted = column.get(sum(values))
            if wanted is None or not wanted.holds(Fraction(sum(value**2 for value in values))):
                return False
        return True

    assert (found is not None) == any(map(fits, combinations_with_replacement(_ways(3, 3), 3)))
    if found is not None:
        assert found.shape == (3, 3)
        assert fits(tuple(map(tuple, found.tolist())))


@settings(deadline=None, max_examples=25)
@given(st.integers(2, 4), st.integers(2, 8), st.integers(1, 10), st.integers(2, 3), st.integers(0, 2**32))
def test_a_row_of_true_counts_always_stands(answers: int, n: int, trials: int, digits: int, seed: int) -> None:
    """The invariant: no row of true counts is accused."""
    rng = np.random.default_rng(seed)
    counts = [tuple(map(int, rng.multinomial(trials, rng.dirichlet(np.ones(answers))))) for _ in range(n)]
    row = examine(_cells(_printed(counts, trials, digits), trials), n, trials, {}, Work(MOST_COLUMNS))
    assert row.stands
    assert row.truncated == ()
    assert row.fewest <= row.trials <= row.most


def test_a_row_with_trials_left_out_says_how_many() -> None:
    """Four participants, ten trials; two of the forty are dropped from the first answer's counts."""
    counts: list[tuple[int, ...]] = [(6, 4), (5, 5), (3, 5), (7, 3)]
    row = examine(_cells(_printed(counts, 10, 3), 10), 4, 10, {}, Work(MOST_COLUMNS))
    assert not row.stands
    assert (row.trials, row.fewest, row.most, row.missing) == (40, 38, 38, 2)
    # Any other value of one of the two cells would fill the row.
    assert row.misprinted == (0, 1)


def test_a_row_can_sum_and_still_have_no_counts() -> None:
    """Two answers to two trials: what one gains the other loses, so their SDs are the same."""
    printed: list[tuple[str, str | None]] = [("0.50", "0.41"), ("0.50", "0.00")]
    row = examine(_cells(printed, 2), 4, 2, {}, Work(MOST_COLUMNS))
    assert (row.stands, row.trials, row.fewest, row.most) == (False, 8, 8, 8)


def test_a_truncated_cell_is_named_and_no_other() -> None:
    """Three participants, 1, 1 and 2 of 3: mean 0.4444, SD 0.1925, cut to 0.192 where rounding gives 0.192 or 0.193."""
    printed = _printed([(1, 2), (1, 2), (2, 1)], 3, 4)
    cut: list[tuple[str, str | None]] = [("0.4444", "0.1924"), printed[1]]
    row = examine(_cells(cut, 3), 3, 3, {}, Work(MOST_COLUMNS))
    assert printed[0] == ("0.4444", "0.1925")
    assert (row.stands, row.truncated) == (True, (0,))


def test_what_a_test_pins_is_used() -> None:
    counts: list[tuple[int, ...]] = [(1, 2), (1, 2), (2, 1), (0, 3)]
    cells = _cells(_printed(counts, 3, 1), 3)
    variance = statistics.variance([Fraction(row[0], 3) for row in counts])
    assert examine(cells, 4, 3, {0: Interval(variance, variance)}, Work(MOST_COLUMNS)).stands
    other = Interval(variance + Fraction(1, 1000), variance + Fraction(2, 1000))
    assert not examine(cells, 4, 3, {0: other}, Work(MOST_COLUMNS)).stands


def test_a_row_with_too_many_ways_is_not_decided() -> None:
    printed: list[tuple[str, str | None]] = [("0.25", "0.10")] * 4
    with pytest.raises(Undecided, match="more than 20000 ways"):
        examine(_cells(printed, 100), 10, 100, {}, Work(MOST_COLUMNS))
