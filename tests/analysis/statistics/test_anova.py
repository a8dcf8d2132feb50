"""ANOVA: against NIST's certified values, statsmodels and scipy, and what must hold for any data."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.stats
import statsmodels.formula.api as smf
from hypothesis import example, given, settings
from hypothesis import strategies as st
from statsmodels.stats.anova import anova_lm

from palpate.analysis.statistics.anova import BEFORE, TYPES, Cells, cells, crossed, one_way, two_way
from palpate.analysis.statistics.exact import NotDefined
from tests.approved import Refuses

NIST = Path(scipy.stats.__file__).parent / "tests" / "data" / "nist_anova"
NAMES = ["AtmWtAg", "SiRstv", "SmLs01", "SmLs02", "SmLs03", "SmLs04", "SmLs05", "SmLs06", "SmLs07", "SmLs08", "SmLs09"]
TERMS = {"task": "C(task, Sum)", "material": "C(material, Sum)", "task x material": "C(task, Sum):C(material, Sum)"}


@pytest.mark.parametrize("name", NAMES)
def test_certified_values_of_nist(name: str) -> None:
    """Statistical Reference Datasets, ANOVA; the files that scipy ships. Certified to 15 digits."""
    text = (NIST / f"{name}.dat").read_text()
    between = re.search(r"Between \w+\s+(\d+)\s+(\S+)\s+\S+\s+(\S+)", text)
    within = re.search(r"Within \w+\s+(\d+)\s+(\S+)", text)
    assert between is not None
    assert within is not None
    groups: dict[str, list[Fraction]] = {}
    for line in text[text.rindex("Data:") :].splitlines()[1:]:
        label, value = line.split()
        groups.setdefault(label, []).append(Fraction(Decimal(value)))
    table = one_way(list(groups.values()))
    effect = table.effects[0]
    assert (effect.df, table.residual.df) == (int(between[1]), int(within[1]))
    assert effect.ss == pytest.approx(float(between[2]), rel=1e-14)
    assert table.residual.ss == pytest.approx(float(within[2]), rel=1e-14)
    assert effect.f == pytest.approx(float(between[3]), rel=1e-14)


def _random(seed: int) -> tuple[Cells, pd.DataFrame]:
    random = np.random.default_rng(seed)
    rows: list[tuple[str, str, int]] = []
    for task in ("virtual", "real", "other")[: random.integers(2, 4)]:
        for material in "abcd"[: random.integers(2, 5)] if not rows else dict.fromkeys(row[1] for row in rows):
            rows += [(task, material, int(count)) for count in random.integers(0, 11, size=random.integers(2, 7))]
    frame = pd.DataFrame(rows, columns=["task", "material", "count"])
    ratios = [Fraction(count, 10) for count in frame["count"].tolist()]
    data = cells(ratios, frame["task"].tolist(), frame["material"].tolist(), names=("task", "material"))
    return data, frame.assign(ratio=frame["count"] / 10)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_all_three_types_are_those_of_statsmodels(seed: int) -> None:
    data, frame = _random(seed)
    model: Any = smf.ols("ratio ~ C(task, Sum) * C(material, Sum)", frame).fit()
    for number, kind in enumerate(TYPES, start=1):
        expected = anova_lm(model, typ=number)
        table = two_way(data, kind)
        for effect in table.effects:
            line = expected.loc[TERMS[effect.name]]
            assert effect.df == line["df"]
            assert effect.ss == pytest.approx(line["sum_sq"], rel=1e-8, abs=1e-10)
            assert effect.f == pytest.approx(line["F"], rel=1e-8, abs=1e-8)
            assert effect.p == pytest.approx(line["PR(>F)"], rel=1e-6)
        assert table.residual.df == expected.loc["Residual", "df"]
        assert table.residual.ss == pytest.approx(expected.loc["Residual", "sum_sq"])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sums_of_squares_are_those_of_weighted_least_squares(seed: int) -> None:
    """The fall of the residual when an effect's columns join those before it, by numpy's lstsq."""
    random = np.random.default_rng(seed)
    levels = int(random.integers(2, 4)), int(random.integers(2, 5))
    weights = random.integers(1, 9, size=levels[0] * levels[1])
    response = random.integers(0, 20, size=len(weights))
    a, b = (np.vstack([np.eye(n - 1), -np.ones(n - 1)]) for n in levels)
    ones = [np.ones((n, 1)) for n in levels]
    columns = {"": np.kron(*ones), "A": np.kron(a, ones[1]), "B": np.kron(ones[0], b), "X": np.kron(a, b)}

    def reduction(effects: str) -> float:
        part = np.hstack([columns[name] for name in ("", *effects)])
        root = np.sqrt(weights)
        fitted = part @ np.linalg.lstsq(part * root[:, None], response * root, rcond=None)[0]
        return float(np.sum(weights * fitted**2))

    design = crossed(tuple(weights.tolist()), levels)
    totals = (weights * response)[:, None]
    for kind in TYPES:
        for effect, before in zip("ABX", BEFORE[kind], strict=True):
            expected = pytest.approx(reduction(before + effect) - reduction(before), abs=1e-8)
            assert float(design.squares(effect, kind, totals.astype(object))[0]) == expected
            assert design.squares(effect, kind, totals.astype(np.float64))[0] == expected


def test_equal_numbers_make_the_types_equal_and_add_up() -> None:
    random = np.random.default_rng(3)
    values = [Fraction(int(k), 10) for k in random.integers(0, 11, size=24)]
    data = cells(values, ["v", "r"] * 12, [m for m in "abcd" for _ in range(6)], names=("task", "material"))
    tables = [two_way(data, kind) for kind in TYPES]
    assert len({tuple(effect.ss for effect in table.effects) for table in tables}) == 1
    total = sum((v - sum(values) / 24) ** 2 for v in values)
    assert sum(e.ss for e in tables[0].effects) + tables[0].residual.ss == pytest.approx(float(total), rel=1e-14)


def test_the_order_of_factors_matters_in_type_one_alone() -> None:
    random = np.random.default_rng(0)
    tasks = random.choice(["v", "r"], size=60).tolist()
    materials = random.choice(list("abc"), size=60).tolist()
    values = [Fraction(int(k), 10) for k in random.integers(0, 11, size=60)]
    one = cells(values, tasks, materials, names=("task", "material"))
    other = cells(values, materials, tasks, names=("material", "task"))
    for kind in TYPES:
        same = two_way(one, kind).effect("task").ss == two_way(other, kind).effect("task").ss
        assert same == (kind != "I")


@settings(deadline=None)
@given(st.lists(st.lists(st.integers(0, 10), min_size=2, max_size=8), min_size=2, max_size=5))
@example([[0, 0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 0, 1]])
def test_one_way_is_that_of_scipy(groups: list[list[int]]) -> None:
    table = one_way(groups)
    if table.residual.ss == 0:
        assert table.effects[0].f is None
        assert "no variance" in table.statement
        return
    expected = scipy.stats.f_oneway(*groups)
    assert table.effects[0].f == pytest.approx(expected.statistic, abs=1e-9)
    # scipy gives no P where F is zero, or rounded to just below it; it is one by definition.
    assert table.effects[0].p == pytest.approx(expected.pvalue if expected.statistic > 0 else 1.0, abs=1e-9)


@pytest.mark.parametrize("groups", [[[1, 2]], [[1, 2], []], [[1], [2]]])
def test_too_few_values_are_not_defined(groups: list[list[int]], refuses: Refuses) -> None:
    with refuses(NotDefined):
        one_way(groups)


def test_an_empty_cell_is_not_defined(refuses: Refuses) -> None:
    with refuses(NotDefined):
        cells([1, 2, 3], ["virtual", "virtual", "real"], ["a", "b", "a"], names=("task", "material"))


def test_one_task_is_not_defined(refuses: Refuses) -> None:
    with refuses(NotDefined):
        cells([1, 2], ["virtual"] * 2, ["a", "b"], names=("task", "material"))


def test_one_participant_is_not_defined(refuses: Refuses) -> None:
    with refuses(NotDefined):
        cells([1, 2, 3, 4], ["v", "v", "r", "r"], ["a", "b", "a", "b"], names=("task", "material"))


def test_constant_cells_are_stated_not_computed() -> None:
    data = cells([1, 1, 2, 2, 3, 3, 5, 5], list("vvvvrrrr"), list("aabbaabb"), names=("task", "material"))
    table = two_way(data, "III")
    assert all(effect.f is None and effect.p is None for effect in table.effects)
    assert "no variance" in table.statement
