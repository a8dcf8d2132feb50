"""Classical scaling: distances of known points come back, and where there is no map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist, squareform

from palpate.analysis.identification.maps import classical, from_confusions
from palpate.analysis.statistics.exact import NotDefined


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 7))
def test_points_of_a_plane_keep_their_distances(seed: int, count: int) -> None:
    distances = squareform(pdist(np.random.default_rng(seed).normal(size=(count, 2))))
    found = classical(distances)
    assert squareform(pdist(found.points)) == pytest.approx(distances, abs=1e-7)
    assert found.explained == pytest.approx(1)
    assert found.negative == pytest.approx(0, abs=1e-9)


def test_a_third_dimension_is_told() -> None:
    found = classical(np.ones((4, 4)) - np.eye(4))
    assert found.explained == pytest.approx(2 / 3)


def test_what_is_no_distance_is_told() -> None:
    table = np.array([[0, 1, 9], [1, 0, 1], [9, 1, 0.0]])
    assert classical(table).negative > 0.1


def test_dissimilarity_of_confusions_by_hand() -> None:
    ratios = np.array([[0.6, 0.4, 0], [0.2, 0.8, 0], [0, 0, 1]])
    assert from_confusions(ratios) == pytest.approx(np.array([[0, 1 - 0.6 / 1.4, 1], [1 - 0.6 / 1.4, 0, 1], [1, 1, 0]]))


@pytest.mark.parametrize(
    ("table", "why"),
    [(np.zeros((2, 2)), "three objects"), (np.zeros((3, 3)), "at one point"), (np.full((3, 3), np.nan), "not defined")],
)
def test_no_map_is_stated(table: np.ndarray, why: str) -> None:
    with pytest.raises(NotDefined, match=why):
        classical(table)
