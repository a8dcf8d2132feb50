"""Transmitted information: textbook tables, scipy's divergence, simulated bias, and what must hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.participants import Jackknife
from palpate.analysis.statistics.psychophysics.information import (
    information,
    information_limits,
    likely_answers,
    transmitted,
)
from tests.analysis.reference import printed

TEXTBOOK = np.array(printed("cover_thomas")["counts"])


def test_the_textbook_example() -> None:
    columns, rows, both = printed("cover_thomas")["bits"]
    assert (information(TEXTBOOK).presented, information(TEXTBOOK.T).presented) == (rows, columns)
    assert information(TEXTBOOK).transmitted == pytest.approx(both, abs=1e-14)


@pytest.mark.parametrize(("count", "bits"), [(2, 1.0), (4, 2.0), (8, 3.0)])
def test_perfect_answers_transmit_everything(count: int, bits: float) -> None:
    assert information(10 * np.eye(count, dtype=np.int64)).transmitted == pytest.approx(bits)


def test_answers_that_do_not_depend_on_the_material_transmit_nothing() -> None:
    assert information(np.array([[3, 6, 1], [3, 6, 1], [6, 12, 2]])).transmitted == pytest.approx(0, abs=1e-14)


tables = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).integers(0, 9, size=(3, 4)))


@settings(deadline=None)
@given(tables)
def test_it_is_the_divergence_from_independence(counts: NDArray[np.int64]) -> None:
    counts = counts + 1
    joint = counts / counts.sum()
    product = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0, keepdims=True)
    expected = stats.entropy(joint.ravel(), product.ravel(), base=2)
    assert information(counts).transmitted == pytest.approx(float(expected), abs=1e-12)
    assert transmitted(np.stack([counts, counts]))[1] == pytest.approx(float(expected), abs=1e-12)


def test_miller_madow_by_hand() -> None:
    """(3 + 3 + 3 + 0) - 3 answers too many, over 2 x 32 trials x ln 2."""
    assert information(TEXTBOOK).miller_madow == pytest.approx(0.375 - 6 / (64 * np.log(2)))


def test_corrections_remove_most_of_the_bias() -> None:
    """Answers of a known observer, 40 trials a table: the mean of 400 tables against the information of its shares."""
    rng = np.random.default_rng(4)
    shares = np.array([[0.7, 0.2, 0.1, 0], [0.2, 0.5, 0.3, 0], [0.1, 0.3, 0.5, 0.1], [0, 0.1, 0.2, 0.7]])
    true = float(transmitted((shares * 1_000_000).round().astype(np.int64)))
    found = [information(rng.multinomial(10, shares)) for _ in range(400)]
    plain = np.mean([one.transmitted for one in found]) - true
    assert plain > 0.05
    for name in ("miller_madow", "panzeri_treves"):
        assert abs(np.mean([getattr(one, name) for one in found]) - true) < plain / 2


def test_likely_answers_lie_between_those_that_occurred_and_all() -> None:
    assert likely_answers(np.array([10, 0, 0, 0])) == 1
    assert likely_answers(np.array([1, 1, 1, 0, 0, 0])) > 3
    assert likely_answers(np.array([5, 5, 5, 5])) == 4


@pytest.mark.parametrize("counts", [[[3, 1]], [[3, 1], [0, 0]], [[0, 0], [0, 0]]])
def test_fewer_than_two_materials_are_not_defined(counts: list[list[int]]) -> None:
    with pytest.raises(NotDefined, match="two presented"):
        information(np.array(counts))


def _limits(counts: NDArray[np.int64], right: tuple[float, float]) -> Jackknife:
    return information_limits(counts, information(counts.sum(axis=0)), right)


def test_the_interval_is_the_jackknifes_where_participants_differ() -> None:
    """Each of six leaves the others' table; Student's t on 5 df."""
    counts = np.array([(6 - k) * np.ones((3, 3), dtype=np.int64) + 3 * k * np.eye(3, dtype=np.int64) for k in range(6)])
    whole = information(counts.sum(axis=0)).transmitted
    apart = 6 * whole - 5 * np.array([transmitted(np.delete(counts, k, axis=0).sum(axis=0)) for k in range(6)])
    found = _limits(counts, (0.2, 0.5))
    reach = stats.t.ppf(0.975, 5) * stats.sem(apart)
    assert found.value == pytest.approx(max(apart.mean(), 0))
    assert (found.low, found.high) == pytest.approx((max(apart.mean() - reach, 0), apart.mean() + reach))


def test_participants_who_do_not_differ_have_the_error_of_trials() -> None:
    """Of two materials, shares of p and 1 - p have the logarithms log2 2p and log2 2(1 - p)."""
    counts = np.array([[[8, 2], [2, 8]]] * 5)
    spread = 0.8 * 0.2 * np.log2(0.8 / 0.2) ** 2 / 100 + 2 / (200 * np.log(2)) ** 2
    assert _limits(counts, (0.7, 0.9)).error == pytest.approx(np.sqrt(spread))


def test_near_perfect_answers_are_bounded_by_fano_and_nothing_leaves_0_to_the_bits_presented() -> None:
    counts = np.array([10 * np.eye(4, dtype=np.int64)] * 4)
    found = _limits(counts, (0.8, 1.0))
    wrong = stats.entropy([0.8, 0.2], base=2) + 0.2 * np.log2(3)
    assert (found.value, found.high) == (2, 2)
    assert found.low == pytest.approx(2 - wrong)
    alone = np.array([[[2, 1, 1, 0]] * 4, [[0, 1, 1, 2]] * 4])
    assert 0 <= _limits(alone, (0.1, 0.4)).low <= _limits(alone, (0.1, 0.4)).high <= 2
    with pytest.raises(NotDefined):
        _limits(counts[:1], (0.8, 1.0))
