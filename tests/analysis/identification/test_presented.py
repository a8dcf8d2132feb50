"""A task that presents some of the materials: what is counted, compared and left out, by cases counted by hand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.analyse import Analysis, analyse
from palpate.analysis.identification.companion_tests import SHARED
from palpate.analysis.identification.confusion import in_every, shared
from palpate.analysis.identification.results import Results, TaskResult, compute
from palpate.analysis.reading.dataset import read
from tests.analysis.datasets import MATERIALS, trials, write_dataset

Right = dict[str, tuple[int, ...]]

PRESENTED: dict[str, tuple[str, ...]] = {"virtual": ("glass", "sand"), "real": ("sand", "snow")}
VIRTUAL: Right = {"glass": (3, 2, 4, 1, 3, 2, 4, 2), "sand": (2, 3, 1, 2, 4, 1, 2, 3)}
REAL: Right = {"sand": (1, 3, 2, 2, 3, 1, 3, 2), "snow": (4, 2, 3, 4, 1, 3, 2, 4)}
"""Right answers of each of eight participants in four trials with a material; others are wrong, as another material."""


def rows(right: Right, person: int) -> list[dict[str, object]]:
    answers: list[tuple[str, str]] = []
    for material, counts in right.items():
        wrong = MATERIALS[MATERIALS.index(material) - 1]
        answers += [(material, material if k < counts[person] else wrong) for k in range(4)]
    return trials(answers)


def made(root: Path, presented: dict[str, tuple[str, ...]] | None = None, people: int = 8, **of: Right) -> Path:
    sessions = {str(k): {task: rows(right, k) for task, right in of.items()} for k in range(people)}
    return write_dataset(root, sessions, presented=PRESENTED if presented is None else presented)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return compute(read(made(tmp_path_factory.mktemp("data"), virtual=VIRTUAL, real=REAL)), {})


def task(results: Results, name: str) -> TaskResult:
    one = results.task(name)
    assert one is not None
    return one


def test_a_matrix_has_the_rows_that_were_presented_and_every_answer(found: Results) -> None:
    matrix = task(found, "virtual").confusion
    assert (matrix.presented, matrix.absent, matrix.materials) == ((0, 1), ("snow",), MATERIALS)
    cells = list(matrix.cells())
    assert {shown for _, shown, *_ in cells} == {"glass", "sand"}
    assert {said for _, _, said, *_ in cells} == {*MATERIALS, ""}
    assert all(total == 4 for *_, total in cells)
    # Glass is taken for snow and sand for glass: 8 participants x 4 trials less the right ones.
    pooled = matrix.counts.sum(axis=0)
    assert pooled.tolist() == [[21, 0, 11, 0], [14, 18, 0, 0], [0, 0, 0, 0]]
    assert matrix.complete == list(map(str, range(8)))


def test_tests_and_intervals_are_of_what_was_presented_against_one_of_all_materials(found: Results) -> None:
    one = task(found, "virtual")
    assert [test.material for test in one.tests] == ["glass", "sand"]
    for test in one.tests:
        wanted = stats.ttest_1samp(np.array(VIRTUAL[test.material]) / 4, 1 / 3)
        assert test.result.t == pytest.approx(wanted.statistic)
        assert test.result.p == pytest.approx(wanted.pvalue)
    p = np.array([test.result.p for test in one.tests], dtype=np.float64)
    # Holm's method over two: the smaller P twice, the larger no less than that.
    held = [test.p_holm for test in one.tests]
    assert held == pytest.approx([min(1, max(2 * p.min(), value)) if value > p.min() else 2 * value for value in p])
    cells = found.identifications[0].cells
    assert {cell.presented for cell in cells} == {"glass", "sand"}
    assert len(cells) == 6


def test_tasks_are_compared_over_what_both_present(found: Results, approved: SnapshotAssertion) -> None:
    both = [task(found, name).confusion for name in ("virtual", "real")]
    assert (shared(both), in_every(both)) == ((1,), list(map(str, range(8))))
    (pair,) = found.beside.paired
    wanted = stats.ttest_rel(np.array(VIRTUAL["sand"]), np.array(REAL["sand"]))
    assert pair.test.n == 8
    assert pair.test.t == pytest.approx(wanted.statistic)
    assert [(one.subject, one.result.n) for one in found.equivalences.tasks] == [(SHARED, 8), ("sand", 8)]
    assert [one.subject for one in found.equivalences.pairs] == ["glass and sand", "sand and snow"]
    # One material is too few for two factors, and said so.
    assert (found.two_way, found.components) == ((), None)
    assert found.two_way_statement == approved
    assert found.beside.statements.items() == approved
    contrasts, _ = found.marginal
    assert contrasts is not None
    assert [(one.task, one.material) for one in contrasts.means] == [
        ("virtual", "glass"), ("virtual", "sand"), ("real", "sand"), ("real", "snow")
    ]  # fmt: skip
    assert contrasts.left_out == ()
    # One step between the two materials of a task, and between the two tasks of a material: n - 1 degrees of freedom.
    assert [(one.within, one.df) for one in (*contrasts.materials, *contrasts.tasks)] == [
        ("virtual", 7), ("real", 7), ("sand", 7)
    ]  # fmt: skip
    assert found.beside.logit is not None
    assert {term.name: term.df1 for term in found.beside.logit.terms} == {"task": 1, "material": 2}


def test_reliabilities_have_the_cells_that_were_presented(found: Results) -> None:
    assert [one.matrix.partition(" x 8")[0] for one in found.reliabilities] == [
        "virtual: 6 cells (presented x answered)",
        "virtual: 2 correct ratios",
        "real: 6 cells (presented x answered)",
        "real: 2 correct ratios",
        "4 correct ratios (material by task)",
    ]


def test_what_needs_every_row_is_left_out_in_words(found: Results) -> None:
    for one, absent in zip(found.identifications, ("snow", "glass"), strict=True):
        why = f"it needs every material, but {absent} is not presented in this task"
        assert {key: one.statements[key] for key in ("choice", "lapses", "scaling", "d'")} == dict.fromkeys(
            ("choice", "lapses", "scaling", "d'"), why
        )
        assert one.information is not None
        # Two materials were presented equally often.
        assert one.information.presented == pytest.approx(1.0)


def test_the_two_way_anova_is_that_of_the_shared_materials_alone(tmp_path: Path) -> None:
    real = {"glass": REAL["snow"], "sand": REAL["sand"], "snow": VIRTUAL["glass"]}
    some = compute(read(made(tmp_path / "some", {"virtual": ("glass", "sand")}, virtual=VIRTUAL, real=real)), {})
    alone = {name: real[name] for name in ("glass", "sand")}
    both: dict[str, tuple[str, ...]] = dict.fromkeys(("virtual", "real"), ("glass", "sand"))
    whole = compute(read(made(tmp_path / "whole", both, virtual=VIRTUAL, real=alone)), {})
    assert [[(one.name, one.f, one.df) for one in anova.effects] for anova in some.two_way] == [
        [(one.name, one.f, one.df) for one in anova.effects] for anova in whole.two_way
    ]
    assert len(some.two_way) == 3
    assert some.beside.both == whole.beside.both


def test_tasks_without_a_material_in_common_are_not_compared_and_nothing_fails(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    apart = {"virtual": ("glass",), "real": ("sand", "snow")}
    found = compute(read(made(tmp_path, apart, virtual={"glass": VIRTUAL["glass"]}, real=REAL)), {})
    assert found.two_way_statement == approved
    assert found.beside.paired == ()
    statements = [*found.beside.statements.items(), *found.equivalences.statements]
    assert statements == approved
    # One material cannot be taken for another of its task.
    assert {one.task for one in found.pairs} == {"real"}


def reported(root: Path) -> tuple[Analysis, str]:
    found = analyse([made(root, virtual=VIRTUAL, real=REAL)], pictures=True)
    return found, found.report.read_text("utf-8")


def test_report_and_tables_say_what_was_not_presented(tmp_path: Path, approved: SnapshotAssertion) -> None:
    found, page = reported(tmp_path / "data")
    # Below the matrix and below the tests, and of each of the four that need every row.
    both = page + (found.out / "methods.html").read_text("utf-8")
    sentences = [one for one in re.findall(r">([^<>]+\.)<", both) if "present" in one]
    assert page.count("snow is not") == 2 + 4
    assert sentences == approved
    tables = found.report.parent / "tables"
    tests = (tables / "tests.csv").read_text("utf-8").splitlines()
    (absent,) = (line for line in tests if ",virtual,snow," in line)
    assert absent.rpartition(",")[2] == approved
    for name in ("confusion.csv", "counts.csv", "intervals.csv"):
        lines = (tables / name).read_text("utf-8").splitlines()[1:]
        assert not [line for line in lines if ",virtual,snow," in line or ",virtual,sub-1,snow," in line], name
        assert [line for line in lines if ",real," in line and ",snow," in line], name
