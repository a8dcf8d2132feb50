"""Verdicts on printed numbers, and the reasons found for those that do not stand."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.comparison import Comparison, Line, as_printed, compare, verdict
from analysis.dataset import read
from analysis.published import Printed, load
from analysis.results import compute
from tests.analysis.datasets import balanced, trials, write_dataset

OKAMOTO = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


@settings(deadline=None)
@given(st.floats(0, 1), st.integers(1, 4))
def test_a_number_agrees_with_its_own_rounding(value: float, digits: int) -> None:
    assert verdict(Printed(f"{value:.{digits}f}"), value, 0)[0] == "agrees"


@settings(deadline=None)
@given(st.floats(1e-12, 1))
def test_p_agrees_with_its_own_rounding(p: float) -> None:
    assert verdict(Printed(f"{p:.2e}"), p, 0)[0] == "agrees"


@pytest.mark.parametrize(
    ("text", "value", "units", "expected"),
    [
        ("0.048", 0.0488, 1, ("agrees within one unit", "fits truncation, not rounding")),
        ("0.049", 0.0481, 1, ("agrees within one unit", "one unit of the last digit")),
        ("0.048", 0.0488, 0, ("differs", "")),
        ("0.048", 0.0491, 1, ("differs", "")),
        ("0", 0.0, 0, ("agrees", "")),
        ("0", 0.001, 0, ("differs", "")),
        ("15%", 0.15, 0, ("agrees", "")),
    ],
)
def test_verdicts(text: str, value: float, units: float, expected: tuple[str, str]) -> None:
    assert verdict(Printed(text), value, units) == expected


@pytest.mark.parametrize(
    ("text", "value", "shown"),
    [("0.047", 0.04667, "0.047"), ("5.02e-7", 5.0245e-7, "5.02e-7"), ("15%", 0.15, "15%"), ("0", 0.0, "0")],
)
def test_recomputed_numbers_are_shown_as_they_are_printed(text: str, value: float, shown: str) -> None:
    assert as_printed(Printed(text), value) == shown


@pytest.fixture(scope="module")
def reconstructed(repository_root: Path) -> Comparison:
    return _compared(repository_root / "participants" / "okamoto2012", diagnose=True)


def _compared(root: Path, *, diagnose: bool) -> Comparison:
    printed = load("okamoto2012")
    assert printed is not None
    return compare(printed, compute(read(root), printed.pairs()), diagnose=diagnose)


def _lines(comparison: Comparison, **wanted: str) -> list[Line]:
    return [line for line in comparison.lines if all(getattr(line, key) == value for key, value in wanted.items())]


def test_all_32_cells_regenerate(reconstructed: Comparison) -> None:
    tables = [line for line in reconstructed.lines if line.where.startswith("Table")]
    means = [line for line in tables if line.quantity == "mean"]
    deviations = [line for line in tables if line.quantity == "SD"]
    assert len(means) == 32
    assert all(line.verdict == "agrees" for line in means)
    assert len(deviations) == 31
    assert all(line.agrees for line in deviations)
    assert sum(line.verdict == "agrees within one unit" for line in deviations) == 3


def test_the_virtual_task_agrees_with_print(reconstructed: Comparison) -> None:
    tests = [x for x in _lines(reconstructed, task="virtual") if x.quantity in ("t(14)", "P", "F(3,56)", "stars")]
    assert len(tests) == 14
    assert all(line.verdict == "agrees" for line in tests)


def test_the_real_tasks_t_is_told_to_be_cohens_d(reconstructed: Comparison) -> None:
    lines = _lines(reconstructed, task="real", quantity="t(9)")
    assert [(line.subject, line.printed, line.recomputed) for line in lines] == [
        ("copy paper", "10.67", "33.73"),
        ("polypropylene", "1.52", "4.81"),
        ("aluminum foil", "1.19", "3.77"),
        ("typing paper", "1.16", "3.66"),
    ]
    assert all(line.verdict == "differs" and "is Cohen's d = " + line.printed in line.reason for line in lines)


def test_the_real_tasks_p_is_told_to_be_that_of_15_participants(reconstructed: Comparison) -> None:
    lines = _lines(reconstructed, task="real", quantity="P")
    assert len(lines) == 4
    assert all("d * sqrt(15) at 14 df, where n is 10" in line.reason for line in lines)


def test_stars_that_follow_a_wrong_p_are_recomputed(reconstructed: Comparison) -> None:
    lines = [line for line in _lines(reconstructed, task="real", quantity="stars") if not line.agrees]
    assert [(line.subject.split(" -> ")[0], line.printed, line.recomputed) for line in lines] == [
        ("aluminum foil", "***", "**"),
        ("typing paper", "***", "**"),
    ]
    assert all("follow the printed P" in line.reason for line in lines)


def test_the_icc_is_named_and_never_called_right(reconstructed: Comparison) -> None:
    (line,) = _lines(reconstructed, quantity="ICC")
    assert (line.printed, line.recomputed, line.verdict) == ("0.97", "0.968", "cannot be decided")
    assert not line.agrees
    assert "variance-component ICC of the mean of 25" in line.reason


def test_the_printed_cells_correlate_with_themselves(reconstructed: Comparison) -> None:
    assert [(c.task, c.cells) for c in reconstructed.correlations] == [("virtual", 16), ("real", 16)]
    assert all(c.r is not None and c.r > 0.9999 for c in reconstructed.correlations)


def test_other_answers_are_not_explained_by_how_the_paper_prints(tmp_path: Path) -> None:
    sessions = {
        str(k): {"virtual": balanced(k, 10, OKAMOTO), "real": balanced(k + 2, 10, OKAMOTO)} for k in range(1, 6)
    }
    root = write_dataset(tmp_path, sessions, study="okamoto2012", origin="REHEARSAL", materials=OKAMOTO)
    lines = _compared(root, diagnose=False).lines
    assert not any("Cohen" in line.reason or "follow the printed" in line.reason for line in lines)
    assert any("at 4 df" in line.recomputed for line in lines)


def test_a_missing_task_is_said_to_be_missing(tmp_path: Path) -> None:
    sessions = {str(k): {"virtual": balanced(k, 10, OKAMOTO)} for k in range(1, 4)}
    root = write_dataset(tmp_path, sessions, study="okamoto2012", materials=OKAMOTO)
    comparison = _compared(root, diagnose=False)
    real = [line for line in comparison.lines if line.task in ("real", "both")]
    assert real
    assert all(line.verdict == "not in this dataset" for line in real)
    assert [c.task for c in comparison.correlations] == ["virtual"]


def test_constant_answers_have_no_correlation(tmp_path: Path) -> None:
    rows = [(shown, said) for shown in OKAMOTO for said in OKAMOTO]
    root = write_dataset(tmp_path, {"1": {"virtual": trials(rows)}}, study="okamoto2012", materials=OKAMOTO)
    (correlation,) = _compared(root, diagnose=False).correlations
    assert correlation.r is None
    assert "do not vary" in correlation.statement
