"""Identification: its parts meet, the generator decides the draws, and odd answers get statements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.identification.confusion import Confusion, proportion_correct
from palpate.analysis.identification.identify import Identification, identify
from palpate.analysis.statistics.shares import share_limits

MATERIALS = ("glass", "sand", "snow")


def _matrix(people: int = 6, *, seed: int = 1) -> Confusion:
    rng = np.random.default_rng(seed)
    shares = np.array([[0.7, 0.2, 0.1, 0], [0.2, 0.6, 0.2, 0], [0.1, 0.3, 0.5, 0.1]])
    counts = np.array([rng.multinomial(8, shares) for _ in range(people)], dtype=np.int64)
    return Confusion(MATERIALS, tuple(str(k) for k in range(people)), counts)


def _of(counts: Sequence[Sequence[Sequence[int]]]) -> Identification:
    table: NDArray[np.int64] = np.array(counts, dtype=np.int64)
    labels = tuple(str(k) for k in range(len(table)))
    return identify("real", Confusion(MATERIALS, labels, table), None, np.random.default_rng(1))


def test_the_same_generator_gives_the_same_intervals() -> None:
    first, again = (identify("real", _matrix(), None, np.random.default_rng(5)) for _ in range(2))
    other = identify("real", _matrix(), None, np.random.default_rng(6))
    assert first.cells == again.cells
    assert first.jackknife == again.jackknife
    assert first.choice is not None
    assert other.choice is not None
    assert (first.choice.similarities != other.choice.similarities).any()  # type: ignore[union-attr]


def test_every_interval_encloses_its_value() -> None:
    found = identify("real", _matrix(), None, np.random.default_rng(5))
    for cell in found.cells:
        for limits in (cell.wilson, cell.clopper_pearson, cell.interval):
            assert limits is not None
            assert (limits.low or 0) <= cell.count / cell.trials <= (limits.high or 1)
    assert found.detection is not None
    assert found.detection.interval is not None
    assert found.detection.d_prime is not None
    low, high = found.detection.interval.low, found.detection.interval.high
    assert low is not None
    assert high is not None
    assert low < found.detection.d_prime < high
    assert found.choice is not None
    assert found.choice.similarities is not None
    assert (found.choice.similarities[..., 0] <= found.choice.model.similarities + 1e-3).all()
    assert (found.choice.similarities[..., 1] >= found.choice.model.similarities - 1e-3).all()


def test_confusions_are_compared_with_dissimilarities() -> None:
    table = np.array([[0, 0.2, 0.9], [0.2, 0, 0.3], [0.9, 0.3, 0]])
    found = identify("real", _matrix(20), table, np.random.default_rng(5))
    assert found.mantel is not None
    assert found.mantel.r < 0
    assert found.mantel.orders == 6


def test_one_participant(approved: SnapshotAssertion) -> None:
    found = _of([[[5, 2, 1, 0], [1, 6, 1, 0], [0, 3, 5, 0]]])
    assert {cell.interval for cell in found.cells} == {None}
    assert {cell.statement for cell in found.cells} == approved
    assert found.information is not None
    assert found.jackknife is None
    assert list(found.statements) == ["information interval"]
    assert list(found.statements.values()) == approved
    assert found.choice is not None
    assert found.choice.similarities is None


def test_constant_answers(approved: SnapshotAssertion) -> None:
    """Everything is called glass: nothing is transmitted, and no similarity is defined."""
    found = _of([[[4, 0, 0, 0]] * 3] * 4)
    assert found.information is not None
    assert found.information.transmitted == pytest.approx(0)
    assert found.choice is None
    assert found.statements["choice"] == approved
    assert found.detection is not None
    assert found.detection.d_prime == pytest.approx(0, abs=1e-9)
    assert found.detection.statement == approved


def test_perfect_answers() -> None:
    found = _of([[[4, 0, 0, 0], [0, 4, 0, 0], [0, 0, 4, 0]]] * 4)
    assert found.detection is not None
    assert found.detection.d_prime is None
    assert "infinite" in found.detection.statement
    assert found.detection.moved == ("0", "1", "2", "3")
    assert found.choice is not None
    assert found.choice.model.biases is None
    assert found.jackknife is not None
    assert (found.jackknife.value, found.jackknife.high) == (np.log2(3), np.log2(3))
    assert 0 < found.jackknife.low < np.log2(3)
    assert found.detection.interval is not None
    assert found.detection.interval.high is None
    assert proportion_correct(found.detection.interval.low or 0, 3) == pytest.approx(
        share_limits(np.full(4, 12), np.full(4, 12)).low
    )


def test_a_material_that_was_never_presented(approved: SnapshotAssertion) -> None:
    found = _of([[[4, 0, 0, 0], [1, 3, 0, 0], [0, 0, 0, 0]]] * 4)
    assert found.cells[-1].statement == approved
    assert set(found.statements) == {"choice", "lapses", "scaling"}


def test_trials_without_an_answer_are_one_more_answer() -> None:
    with_gaps = _of([[[4, 0, 0, 4], [0, 4, 0, 4], [0, 0, 4, 4]]] * 3)
    assert with_gaps.information is not None
    assert with_gaps.information.transmitted == pytest.approx(np.log2(3) / 2)
