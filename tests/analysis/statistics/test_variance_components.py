"""Henderson's method III: against expectations from full projection matrices, and the balanced closed form."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from palpate.analysis.statistics.anova import (
    VarianceComponents,
    cells,
    icc_limits,
    icc_of_mean,
    two_way,
    variance_components,
)
from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.icc import icc

Matrix = NDArray[np.float64]


def _indicator(levels: list[str]) -> Matrix:
    names = sorted(set(levels))
    return np.array([[float(level == name) for name in names] for level in levels])


def _projection(*blocks: Matrix) -> Matrix:
    design = np.hstack(blocks)
    return np.asarray(design @ np.linalg.pinv(design), dtype=np.float64)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_expectations_by_traces_give_the_same_components(seed: int) -> None:
    """E[y'Qy] = sum over components of trace(Z'QZ) times the component (Searle, Casella, McCulloch 1992, ch. 5)."""
    random = np.random.default_rng(seed)
    first, second = [], []
    for one in "vrw"[: random.integers(2, 4)]:
        for other in "abcd"[:3]:
            size = int(random.integers(1, 6))
            first += [one] * (size + 1)
            second += [other] * (size + 1)
    y = random.integers(0, 11, size=len(first)) / 10
    a, b, ab = _indicator(first), _indicator(second), _indicator([f + s for f, s in zip(first, second, strict=True)])
    main, full = _projection(a, b), _projection(ab)
    forms = [main - _projection(b), main - _projection(a), full - main, np.eye(len(y)) - full]
    factors = [a, b, ab, np.eye(len(y))]
    expectations = np.array([[np.trace(z.T @ q @ z) for z in factors] for q in forms])
    expected = np.linalg.solve(expectations, [y @ q @ y for q in forms])
    got = variance_components(cells([Fraction(round(v * 10), 10) for v in y], first, second, names=("a", "b")))
    assert [got.first, got.second, got.interaction, got.residual] == pytest.approx(expected.tolist(), abs=1e-9)


def test_equal_numbers_give_the_closed_form() -> None:
    random = np.random.default_rng(5)
    data = cells(
        [Fraction(int(k), 10) for k in random.integers(0, 11, size=40)],
        ["v"] * 20 + ["r"] * 20,
        [m for m in "abcd" for _ in range(5)] * 2,
        names=("task", "material"),
    )
    table = two_way(data, "III")
    ms = {effect.name: effect.ms for effect in table.effects}
    got = variance_components(data)
    assert got.residual == pytest.approx(table.residual.ms)
    assert got.interaction == pytest.approx((ms["task x material"] - table.residual.ms) / 5)
    assert got.first == pytest.approx((ms["task"] - ms["task x material"]) / 20)
    assert got.second == pytest.approx((ms["material"] - ms["task x material"]) / 10)


def test_the_icc_of_a_mean_rises_with_its_size_to_one() -> None:
    components = VarianceComponents(("a", "b", "a x b"), 0.1, 0.2, -0.05, 0.4)
    assert components.negative == ("a x b",)
    values = [icc_of_mean(components, k) for k in (1, 5, 25, 10**9)]
    assert values[0] == pytest.approx(0.3 / 0.7)
    assert values == sorted(value for value in values if value is not None)
    assert values[-1] == pytest.approx(1)


def test_no_variance_at_all_has_no_icc() -> None:
    assert icc_of_mean(VarianceComponents(("a", "b", "a x b"), 0.0, 0.0, 0.0, 0.0), 5) is None


def test_limits_of_equal_cells_are_those_of_the_one_way_icc_of_shrout_and_fleiss() -> None:
    rows = [[0.1, 0.4, 0.3], [0.9, 0.8, 0.6], [0.2, 0.5, 0.5], [0.7, 0.9, 1.0]]
    first, second = ["a"] * 6 + ["b"] * 6, (["c"] * 3 + ["d"] * 3) * 2
    found = icc_limits(cells([value for row in rows for value in row], first, second, names=("a", "b")), 3)
    known = icc(rows).form("ICC(1,k)")
    assert (found.value, found.low, found.high) == pytest.approx((known.value, max(known.low or 0, 0), known.high))
    with pytest.raises(NotDefined):
        icc_limits(cells([0.5] * 8, ["a"] * 4 + ["b"] * 4, ["c", "c", "d", "d"] * 2, names=("a", "b")), 2)
