"""Figures of the course of a study: the bins of the onset errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from palpate.analysis.identification.time_course import OnsetErrors
from palpate.analysis.report.figures import BINS, onset_errors


def _edges(errors_ms: np.ndarray) -> np.ndarray:
    """Of the bins that are drawn."""
    axes = Figure().add_subplot()
    onset_errors(axes, {"real": OnsetErrors(tuple(errors_ms.tolist()), 0.0, 1.0, 1.0)})
    return np.unique(np.asarray(axes.patches[0].get_path().vertices)[:, 0])


@given(st.integers(0, 2**32 - 1), st.integers(2, 2000))
def test_bins_are_those_of_numpys_freedman_diaconis(seed: int, size: int) -> None:
    errors = np.random.default_rng(seed).normal(0, 0.3, size)
    expected = np.histogram_bin_edges(errors, bins="fd")
    expected = expected if expected.size <= BINS + 1 else np.linspace(errors.min(), errors.max(), BINS + 1)
    assert _edges(errors) == pytest.approx(expected)


@pytest.mark.parametrize("far", [2.5e5, 1e12])
def test_one_value_far_out_asks_for_no_more_bins(far: float) -> None:
    """Freedman and Diaconis would have millions for the first, and more than any memory holds for the second."""
    errors = np.append(np.random.default_rng(0).normal(0, 0.3, 600), far)
    assert _edges(errors) == pytest.approx(np.linspace(errors.min(), far, BINS + 1))


def test_where_nothing_varies_there_is_one_bin_and_where_little_does_there_are_all() -> None:
    assert _edges(np.full(9, 0.25)).size == 2
    assert _edges(np.append(np.full(99, 0.25), [-1.0, 4.0])).size == BINS + 1
