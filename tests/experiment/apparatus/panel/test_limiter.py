"""Nothing passes the limiter that it should not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from palpate.experiment.apparatus.panel.conditioning import limit
from palpate.experiment.errors import ActuatorError
from tests.approved import Refuses

ANY = arrays.arrays(np.float64, st.integers(0, 50), elements=st.floats(allow_nan=True, allow_infinity=True))


@given(ANY, st.floats(0, 1e300))
def test_it_holds_for_any_input(wanted: np.ndarray, peak: float) -> None:
    before = wanted.copy()
    bounded, changed = limit(wanted, peak)
    assert bounded.dtype == np.float64
    assert bounded.shape == wanted.shape
    assert np.all(np.abs(bounded) <= peak)
    inside = np.abs(wanted) <= peak
    assert np.array_equal(bounded[inside], wanted[inside])
    assert changed == np.count_nonzero(~inside)
    assert np.array_equal(wanted, before, equal_nan=True)


def test_what_each_bad_sample_becomes() -> None:
    bounded, changed = limit([np.nan, np.inf, -np.inf, 3.0, -3.0, 1.5, -0.0], 2.0)
    assert bounded.tolist() == [0.0, 2.0, -2.0, 2.0, -2.0, 1.5, 0.0]
    assert changed == 5


@pytest.mark.parametrize(
    ("wanted", "bounded", "changed"),
    [
        ([np.nan], [0.0], 1),
        ([np.nan, 1.0, -2.0], [0.0, 1.0, -2.0], 1),
        ([1.0, np.nan, 3.0], [1.0, 0.0, 2.0], 2),
        ([-3.0, np.nan, -np.inf, np.nan], [-2.0, 0.0, -2.0, 0.0], 4),
        ([np.inf, 2.0], [2.0, 2.0], 1),
    ],
    ids=["alone", "among values inside", "beside one above", "among values below", "no NaN"],
)
def test_nan_becomes_zero_whatever_stands_beside_it(wanted: list[float], bounded: list[float], changed: int) -> None:
    for order in (1, -1):
        made, count = limit(wanted[::order], 2.0)
        assert made.tolist() == bounded[::order]
        assert count == changed


@pytest.mark.parametrize("peak", [0.0, 2.0])
def test_nothing_stays_nothing(peak: float) -> None:
    made, changed = limit([], peak)
    assert (made.shape, changed) == ((0,), 0)
    assert made.dtype == np.float64


def test_any_shape_is_kept() -> None:
    made, changed = limit([[1.0, np.nan], [-5.0, 0.5]], 2.0)
    assert made.tolist() == [[1.0, 0.0], [-2.0, 0.5]]
    assert changed == 2


def test_other_number_types_are_bounded_as_well() -> None:
    assert limit(np.array([300, -300], dtype=np.int16), 20.0)[0].tolist() == [20.0, -20.0]
    assert limit(np.array([3e38, -1.0], dtype=np.float32), 20.0)[0].tolist() == [20.0, -1.0]


@pytest.mark.parametrize("peak", [np.nan, np.inf, -1.0])
def test_what_is_no_limit_is_refused(peak: float, refuses: Refuses) -> None:
    with refuses(ActuatorError):
        limit([1.0], peak)
