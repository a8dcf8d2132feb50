"""Mantel's test: against every order counted one by one, and what must hold."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from palpate.analysis.identification.maps import mantel
from palpate.analysis.statistics.exact import NotDefined

RNG = np.random.default_rng(1)


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
    found = mantel(first, second, RNG)
    assert found.orders == len(all_r)
    assert found.r == pytest.approx(observed)
    assert found.p_less == pytest.approx(np.mean([r <= observed + 1e-9 for r in all_r]))
    assert found.p_greater == pytest.approx(np.mean([r >= observed - 1e-9 for r in all_r]))
    assert found.p_two == pytest.approx(np.mean([abs(r) >= abs(observed) - 1e-9 for r in all_r]))


def test_a_table_with_itself() -> None:
    table = np.array([[0, 1, 5, 6], [1, 0, 2, 9], [5, 2, 0, 3], [6, 9, 3, 0.0]])
    found = mantel(table, table, RNG)
    assert found.r == pytest.approx(1)
    assert found.p_greater == pytest.approx(1 / 24)


def test_too_few_objects_are_not_defined() -> None:
    table = np.ones((2, 2)) - np.eye(2)
    with pytest.raises(NotDefined, match="needs 3 objects, got 2"):
        mantel(table, table, RNG)


def test_of_many_objects_orders_are_drawn() -> None:
    """9 objects have 362,880 orders. P of 9,999 drawn ones and the observed one is near scipy's from as many others."""
    rng = np.random.default_rng(4)
    first = rng.normal(size=(9, 9))
    first += first.T
    noise = rng.normal(size=(9, 9))
    second = first + 2.5 * (noise + noise.T)
    found = mantel(first, second, np.random.default_rng(5))
    assert (found.exact, found.orders) == (False, 10_000)
    upper = np.triu_indices(9, 1)

    def r(order: NDArray[np.int64]) -> NDArray[np.float64]:
        moved = second[np.ix_(order, order)]
        return np.asarray(np.corrcoef(first[upper], moved[upper])[0, 1])

    drawn = [r(rng.permutation(9)) for _ in range(4000)]
    assert found.r == pytest.approx(r(np.arange(9)))
    assert found.p_greater == pytest.approx(np.mean(np.array(drawn) >= found.r), abs=0.02)
    assert 0 < found.p_greater < 0.2
    # Of 362,880 orders the observed one is hardly drawn again.
    assert mantel(first, first, np.random.default_rng(5)).p_greater <= 3 / 10_000


def test_pairs_that_do_not_vary_are_not_defined() -> None:
    with pytest.raises(NotDefined, match="do not vary"):
        mantel(_symmetric(1, 4), np.ones((4, 4)), RNG)


def test_gaps_and_one_sided_tables_are_refused() -> None:
    table = _symmetric(2, 4)
    for broken in (np.where(table == 7, np.nan, table), np.triu(table)):
        with pytest.raises(ValueError, match="symmetric and finite"):
            mantel(table, broken, RNG)
