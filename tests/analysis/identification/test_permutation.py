"""Mantel's test: against every order counted one by one, and what must hold."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from analysis.identification.maps import mantel
from analysis.statistics.exact import NotDefined


def _symmetric(seed: int, size: int) -> NDArray[np.float64]:
    table = np.random.default_rng(seed).integers(0, 6, size=(size, size)).astype(float)
    table = np.triu(table, 1)
    table[0, 1], table[0, 2] = 7, 0
    return np.asarray(table + table.T)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 10**6), st.sampled_from([3, 4, 5]))
def test_it_counts_every_order(one: int, other: int, size: int) -> None:
    first, second = _symmetric(one, size), _symmetric(other, size)
    upper = np.triu_indices(size, 1)
    all_r = []
    for order in permutations(range(size)):
        moved = second[np.ix_(order, order)]
        all_r.append(stats.pearsonr(first[upper], moved[upper]).statistic)
    observed = stats.pearsonr(first[upper], second[upper]).statistic
    found = mantel(first, second)
    assert found.orders == len(all_r)
    assert found.r == pytest.approx(observed)
    assert found.p_less == pytest.approx(np.mean([r <= observed + 1e-9 for r in all_r]))
    assert found.p_greater == pytest.approx(np.mean([r >= observed - 1e-9 for r in all_r]))
    assert found.p_two == pytest.approx(np.mean([abs(r) >= abs(observed) - 1e-9 for r in all_r]))


def test_a_table_with_itself() -> None:
    table = np.array([[0, 1, 5, 6], [1, 0, 2, 9], [5, 2, 0, 3], [6, 9, 3, 0.0]])
    found = mantel(table, table)
    assert found.r == pytest.approx(1)
    assert found.p_greater == pytest.approx(1 / 24)


@pytest.mark.parametrize("size", [2, 9])
def test_too_few_or_too_many_objects_are_not_defined(size: int) -> None:
    table = np.ones((size, size)) - np.eye(size)
    with pytest.raises(NotDefined, match="3 to 8 objects"):
        mantel(table, table)


def test_pairs_that_do_not_vary_are_not_defined() -> None:
    with pytest.raises(NotDefined, match="do not vary"):
        mantel(_symmetric(1, 4), np.ones((4, 4)))


def test_gaps_and_one_sided_tables_are_refused() -> None:
    table = _symmetric(2, 4)
    for broken in (np.where(table == 7, np.nan, table), np.triu(table)):
        with pytest.raises(ValueError, match="symmetric and finite"):
            mantel(table, broken)
