"""A measured response: what is one, and where it says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis.shaping import Response, not_rising
from tests.approved import Refuses


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ([[1.0, 2.0], [0.0, 0.0]], None),
        ([[1.0, 2.0], [2.0, 2.0]], (1, 1)),
        ([[1.0, 0.5], [1.0, 2.0]], (0, 1)),
        ([[0.0, 1.0], [1.0, 2.0]], (0, 0)),
        ([[1.0, 2.0], [-2.0, -1.0]], (1, 0)),
    ],
)
def test_where_a_response_does_not_rise(
    rows: list[list[float]], place: tuple[int, int] | None, refuses: Refuses
) -> None:
    assert not_rising(np.array(rows)) == place
    if place is not None:
        with refuses(SynthesisError):
            Response(np.array([1.0, 2.0]), np.array([1.0, 2.0]), np.array(rows))


@pytest.mark.parametrize(
    ("frequencies", "levels", "problem"),
    [
        ([], [1.0, 2.0], r"frequencies_hz of the response: got shape \(0,\)"),
        ([1.0], [1.0, 2.0], "allowed: two or more, strictly rising"),
        ([2.0, 1.0], [1.0, 2.0], r"got \[2\.0, 1\.0\]; allowed: two or more, strictly rising"),
        ([1.0, 1.0], [1.0, 2.0], "strictly rising"),
        ([-1.0, 1.0], [1.0, 2.0], "0 or above"),
        ([1.0, np.nan], [1.0, 2.0], "frequencies_hz of the response: got 1 NaN or infinite"),
        ([1.0, 2.0], [0.0, 2.0], "levels_v of the response: .*; allowed: strictly rising, above 0"),
        ([1.0, 2.0], [2.0, 1.0], "levels_v of the response: .*; allowed: strictly rising, above 0"),
        ([1.0, 2.0], [1.0, np.inf], "levels_v of the response: got 1 NaN or infinite"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], r"got shape \(2, 2\); allowed: \(3, 2\)"),
    ],
)
def test_a_response_that_is_none_is_refused(frequencies: list[float], levels: list[float], problem: str) -> None:
    with pytest.raises(SynthesisError, match=problem):
        Response(np.array(frequencies), np.array(levels), np.array([[1.0, 2.0], [1.0, 2.0]]))
