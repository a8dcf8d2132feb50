"""Similarity-choice model: printed fits of quasi-symmetry, a Poisson regression, and what must hold."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.analysis.identification.maps import fit, similarity_choice
from palpate.analysis.statistics.exact import NotDefined
from tests.analysis.reference import printed

NAMES = ("a", "b", "c", "d")


@pytest.mark.parametrize("name", ["quasi_symmetry_vision", "quasi_symmetry_migration"])
def test_printed_fits(name: str) -> None:
    wanted = printed(name)
    found = similarity_choice(np.array(wanted["counts"]), NAMES)
    assert (round(found.g2, 2), found.df) == (wanted["g2"], wanted["df"])


def _counts(seed: int, size: int = 4) -> NDArray[np.int64]:
    rng = np.random.default_rng(seed)
    alike = rng.uniform(0.05, 0.6, size=(size, size))
    alike = np.maximum(alike, alike.T)
    np.fill_diagonal(alike, 1.0)
    weights = alike * rng.uniform(0.5, 2, size=size)
    counts = np.array([rng.multinomial(150, row / row.sum()) for row in weights])
    return counts + np.eye(size, dtype=np.int64)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_expected_counts_are_those_of_a_poisson_regression(seed: int) -> None:
    """Quasi-symmetry as a log-linear model in statsmodels: rows, columns, and one parameter an unordered pair."""
    counts = _counts(seed) + 1
    size = len(counts)
    i, j = np.indices(counts.shape).reshape(2, -1)
    pairs = [(np.minimum(i, j) == a) & (np.maximum(i, j) == b) for a in range(size) for b in range(a + 1, size)]
    design = np.column_stack([*(i == k for k in range(size)), *(j == k for k in range(1, size)), *pairs]).astype(float)
    expected = sm.GLM(counts.ravel(), design, family=sm.families.Poisson()).fit(tol=1e-12, maxiter=300)
    found = similarity_choice(counts, NAMES)
    assert found.fitted.ravel() == pytest.approx(expected.mu, rel=1e-5)
    assert found.g2 == pytest.approx(expected.deviance, abs=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_parameters_give_the_expected_counts_back(seed: int) -> None:
    counts = _counts(seed)
    found = similarity_choice(counts, NAMES)
    assert found.biases is not None
    weights = found.similarities * found.biases
    shares = weights / weights.sum(axis=1, keepdims=True)
    assert shares * counts.sum(axis=1, keepdims=True) == pytest.approx(found.fitted, rel=1e-6)
    assert found.similarities == pytest.approx(found.similarities.T)
    assert np.diag(found.similarities) == pytest.approx(np.ones(4))


def test_probabilities_of_the_model_give_its_parameters_back() -> None:
    alike = np.array([[1, 0.3, 0.1], [0.3, 1, 0.2], [0.1, 0.2, 1]])
    bias = np.array([0.5, 0.3, 0.2])
    weights = alike * bias
    shares = weights / weights.sum(axis=1, keepdims=True)
    similarities, biases, _, settled = fit(np.round(shares * 1e12).astype(np.int64)[None])
    assert settled.all()
    assert similarities[0] == pytest.approx(alike, rel=1e-6)
    assert biases[0] == pytest.approx(bias, rel=1e-6)


def test_never_confused_is_similarity_zero() -> None:
    counts = np.array([[9, 1, 0, 0], [2, 7, 1, 0], [0, 3, 6, 1], [0, 0, 2, 8]])
    found = similarity_choice(counts, NAMES)
    assert found.similarities[0, 3] == 0
    assert found.df == 0
    assert found.biases is not None


def test_perfect_answers() -> None:
    found = similarity_choice(10 * np.eye(4, dtype=np.int64), NAMES)
    assert found.g2 == 0
    assert found.biases is None


def test_a_material_never_recognised_is_not_defined() -> None:
    counts = np.array([[5, 5, 0], [4, 0, 6], [1, 1, 8]])
    with pytest.raises(NotDefined, match="b: never recognized"):
        similarity_choice(counts, NAMES[:3])


def test_two_materials_are_fitted_exactly() -> None:
    found = similarity_choice(np.array([[8, 2], [3, 7]]), NAMES[:2])
    assert found.df == 0
    assert found.g2 == pytest.approx(0, abs=1e-9)
