"""Zeroing: the offset of a foot at rest, and what is no zero."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment.apparatus import zeroing
from experiment.apparatus.samples import Samples
from experiment.errors import TrackerError


@given(st.floats(-2.5, 2.5), st.integers(0, 1000))
def test_the_offset_of_a_foot_at_rest_is_found(offset_mm: float, seed: int) -> None:
    rested_mm = 1.0 + offset_mm + np.random.default_rng(seed).normal(0, 0.1, zeroing.SAMPLES)
    found = zeroing.zero(rested_mm, contact_mm=1.0)
    # The median of n normal values has the standard error 1.25 sigma / sqrt(n), 0.0056 mm; six of them.
    assert found.offset_mm == pytest.approx(offset_mm, abs=0.034)
    assert found.spread_mm == pytest.approx(0.1, rel=0.2)
    assert found.samples == zeroing.SAMPLES


def test_heights_count_from_where_the_foot_rested() -> None:
    found = zeroing.zero(np.full(100, 0.75), contact_mm=0.0)
    samples = Samples(np.arange(2), np.array([0.75, 20.75]), b"ab", np.array([1, 2]), 7)
    applied = found.applied(samples)
    assert applied.height_mm.tolist() == [0.0, 20.0]
    assert (applied.raw, applied.arrived_ns) == (samples.raw, 7)


@pytest.mark.parametrize(
    ("heights_mm", "message"),
    [
        (np.linspace(0, 2, 500), r"heights that spread by 0.58 mm; allowed: at most 0.5 mm; rest the foot"),
        (np.full(500, 40.0), r"an offset of 40.00 mm; allowed: at most 3 mm either way; see that the foot rests"),
        (np.full(500, -3.5), r"an offset of -3.50 mm"),
        (np.zeros(1), r"got 1 samples; allowed: 2 or more"),
    ],
)
def test_what_is_no_zero_is_refused(heights_mm: np.ndarray, message: str) -> None:
    with pytest.raises(TrackerError, match=f"zeroing: got {message}|zeroing: {message}"):
        zeroing.zero(heights_mm, contact_mm=0.0)
