"""Verdicts on printed numbers, and the reasons found for those that do not stand."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
import statsmodels.formula.api as smf
from statsmodels.stats.anova import anova_lm
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit.audit import Comparison, compare
from palpate.analysis.audit.mistakes import Line
from palpate.analysis.identification.results import compute
from palpate.analysis.published import load
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.dataset import read
from tests.analysis.datasets import balanced, trials, write_dataset

OKAMOTO = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


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
    assert sum(line.verdict == "agrees if truncated" for line in deviations) == 3


def test_the_virtual_task_agrees_with_print(reconstructed: Comparison) -> None:
    tests = [x for x in _lines(reconstructed, task="virtual") if x.quantity in ("t(14)", "P", "F(3,56)", "stars")]
    assert len(tests) == 14
    assert all(line.verdict == "agrees" for line in tests)


def test_the_real_tasks_t_is_told_to_be_cohens_d(reconstructed: Comparison) -> None:
    """The recomputed t by scipy, with one more digit than is printed."""
    lines = _lines(reconstructed, task="real", quantity="t(9)")
    assert [(line.subject, line.printed, line.recomputed) for line in lines] == [
        ("copy paper", "10.67", "33.734"),
        ("polypropylene", "1.52", "4.813"),
        ("aluminum foil", "1.19", "3.766"),
        ("typing paper", "1.16", "3.657"),
    ]
    assert all(line.verdict == "differs" and "is Cohen's d = " + line.printed in line.reason for line in lines)


def test_the_real_tasks_p_is_told_to_be_that_of_15_participants(
    reconstructed: Comparison, approved: SnapshotAssertion
) -> None:
    lines = _lines(reconstructed, task="real", quantity="P")
    assert len(lines) == 4
    assert [line.reason for line in lines] == approved


def test_stars_that_follow_a_wrong_p_are_recomputed(reconstructed: Comparison) -> None:
    lines = [line for line in _lines(reconstructed, task="real", quantity="stars") if not line.agrees]
    assert [(line.subject.split(" -> ")[0], line.printed, line.recomputed) for line in lines] == [
        ("aluminum foil", "***", "**"),
        ("typing paper", "***", "**"),
    ]
    assert all("match the printed P" in line.reason for line in lines)


def test_the_icc_is_named_and_never_called_right(reconstructed: Comparison, approved: SnapshotAssertion) -> None:
    (line,) = _lines(reconstructed, quantity="ICC")
    assert (line.printed, line.recomputed, line.verdict) == ("0.97", "0.968", "cannot be decided")
    assert not line.agrees
    assert line.reason == approved


def test_the_printed_cells_correlate_with_themselves(reconstructed: Comparison) -> None:
    assert [(c.task, c.cells) for c in reconstructed.correlations] == [("virtual", 16), ("real", 16)]
    assert all(c.r is not None and c.r > 0.9999 for c in reconstructed.correlations)


def test_other_answers_are_not_explained_by_how_the_paper_prints(tmp_path: Path) -> None:
    sessions = {
        str(k): {"virtual": balanced(k, 10, OKAMOTO), "real": balanced(k + 2, 10, OKAMOTO)} for k in range(1, 6)
    }
    root = write_dataset(tmp_path, sessions, study="okamoto2012", origin="REHEARSAL", materials=OKAMOTO)
    lines = _compared(root, diagnose=False).lines
    assert not any("Cohen" in line.reason or "match the printed" in line.reason for line in lines)
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


@pytest.mark.parametrize("virtual", [("glass", "sand", "snow"), ("glass", "sand")])
@pytest.mark.parametrize(("kind", "effect"), list(product((1, 2, 3), ("task", "material"))))
def test_an_f_of_any_type_agrees_with_a_dataset(tmp_path: Path, kind: int, effect: str, virtual: Sequence[str]) -> None:
    """F by statsmodels, with the tested effect first, of the materials of both tasks; three participants met few."""
    shown = {k: [row for row in balanced(k, 6) if row["presented"] in virtual] for k in range(1, 5)}
    first = {str(k): {"virtual": rows, "real": balanced(k + 5, 6)} for k, rows in shown.items()}
    few = [("glass", "glass")], [("sand", "snow"), ("sand", "sand")], [("sand", "sand")]
    partly = {str(k): {"virtual": trials(answers)} for k, answers in enumerate(few, start=7)}
    study = read(write_dataset(tmp_path, {**first, **partly}, presented={"virtual": tuple(virtual)}))
    results = compute(study, {})
    rows = [
        (task.task.id, material, float(ratio))
        for task in results.tasks
        for k, material in enumerate(task.confusion.materials)
        if material in virtual
        for ratio in task.confusion.ratios(k, k).values()
    ]
    frame = pd.DataFrame(rows, columns=["task", "material", "ratio"])
    terms = sorted(("C(task, Sum)", "C(material, Sum)"), key=lambda term: effect not in term)
    table = anova_lm(smf.ols(f"ratio ~ {' * '.join(terms)}", frame).fit(), typ=kind)
    f, df = float(table.loc[terms[0], "F"]), int(table.loc[terms[0], "df"])
    p = float(table.loc[terms[0], "PR(>F)"])
    two_way = {
        "where": "Text",
        "effect": effect,
        "df": (df, len(rows) - 2 * len(virtual)),
        "f": f"{f:.4f}",
        "p": f"{p:.6f}",
    }
    document = {"study": "lab", "source": "We", "two_way": (two_way,)}
    lines = compare(Published.model_validate(document), results, diagnose=True).lines
    assert len(lines) == 4
    assert all(line.agrees for line in lines)
    assert lines[0].recomputed.endswith(f" by type {'I' * kind}")
