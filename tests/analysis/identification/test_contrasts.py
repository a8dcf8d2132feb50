"""Marginal means and contrasts: emmeans on lme4, who lacks a task, cells without a limit, and the page."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents.drawing import png
from palpate.analysis.documents.tables import comma_separated, text
from palpate.analysis.identification.companion_tests import LINKED, MARGIN, equivalences, equivalent_gaps, marginal
from palpate.analysis.identification.confusion import Confusion
from palpate.analysis.identification.results import compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Study
from palpate.analysis.report.companion_tables import contrasts_section, equivalence_section
from palpate.analysis.report.figures import contrast_sheet
from palpate.analysis.statistics.exact import Integers, NotDefined
from palpate.analysis.statistics.participants import equivalence
from tests.analysis.datasets import balanced, trials, write_dataset
from tests.analysis.reference import printed

NAMES = ("a", "b", "c")


def _counts() -> Integers:
    """Right answers and trials of the reference, shape (2, 12 people, 2 tasks, 3 materials)."""
    table = np.array(printed("mixed_logit")["counts"])
    return table[:, 3:].T.reshape(2, 12, 2, 3)


def _tasks(counts: Integers) -> dict[str, Confusion]:
    found = {}
    for k, task in enumerate(("one", "two")):
        right, total = counts[:, :, k]
        answers = np.zeros((len(right), 3, 4), dtype=np.int64)
        answers[:, range(3), range(3)] = right
        answers[:, :, 3] = total - right
        found[task] = Confusion(NAMES, tuple(map(str, range(len(right)))), answers)
    return found


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    people = {str(k): {"virtual": balanced(k)} for k in range(1, 4)}
    return read(write_dataset(tmp_path_factory.mktemp("study"), people))


def test_means_and_contrasts_are_those_of_emmeans(study: Study) -> None:
    reference = printed("marginal_means")
    found = marginal(study, _tasks(_counts()))
    means = [[one.log_odds, one.error, one.low, one.high] for one in found.means]
    assert np.array(means) == pytest.approx(np.array(reference["means"]), abs=2e-6)  # limits are 2.2 SE
    for own, theirs in ((found.materials, reference["materials"]), (found.tasks, reference["tasks"])):
        shown = np.array([[one.log_odds, one.error, one.p, one.p_holm, one.t] for one in own])
        wanted = np.array(theirs)[:, [0, 1, 3, 4, 2]]
        assert shown[:, :4] == pytest.approx(wanted[:, :4], abs=1e-6)
        # lme4 takes the Hessian from differences of the deviance, so that its SE has seven digits.
        assert shown[:, 4] == pytest.approx(wanted[:, 4], rel=1e-5)
    assert list(found.sds.values()) == pytest.approx(reference["sds"], abs=1e-6)
    assert list(found.sds)[-1] == "participant by cell"
    assert {one.df for one in found.materials} == {22}
    assert {one.df for one in found.tasks} == {11}


def test_one_task_has_materials_alone(study: Study) -> None:
    tasks = _tasks(_counts())
    found = marginal(study, {"one": tasks["one"]})
    assert found.tasks == ()
    assert list(found.sds) == ["participant", "participant by material"]
    odds = [one.log_odds for one in found.means]
    assert odds[1] - odds[0] == pytest.approx(printed("mixed_logit")["one_task"][1], abs=1e-6)


def test_a_cell_without_a_limit_is_left_out_and_the_others_stay(study: Study) -> None:
    counts = _counts()
    counts[0, :, 1, 2] = counts[1, :, 1, 2]
    found = marginal(study, _tasks(counts))
    assert found.left_out == (("two", "c"),)
    assert len(found.means) == 5
    assert [(one.within, one.first, one.second) for one in found.materials if one.within == "two"] == [
        ("two", "a", "b")
    ]
    assert [one.within for one in found.tasks] == ["a", "b"]


def test_few_participants_and_reconstructions_have_none(study: Study) -> None:
    tasks = _tasks(_counts()[:, :5])
    with pytest.raises(NotDefined, match="needs 6 participants, got 5"):
        marginal(study, tasks)
    with pytest.raises(NotDefined, match="two cells"):
        marginal(study, _tasks(np.repeat(_counts()[1:], 2, axis=0)))
    with pytest.raises(NotDefined, match=LINKED):
        marginal(replace(study, origin="RECONSTRUCTION"), tasks)


def test_equivalence_is_of_participants_who_did_both_and_of_pairs(study: Study) -> None:
    tasks = _tasks(_counts())
    found = equivalences(study, tasks)
    right, total = _counts()
    gaps = right[:, 0] / total[:, 0] - right[:, 1] / total[:, 1]
    assert [one.subject for one in found.tasks] == ["all materials", *NAMES]
    assert found.tasks[0].result.mean == pytest.approx(gaps.mean())
    assert found.tasks[2].result.p == equivalence(gaps[:, 1], MARGIN).p
    assert [one.subject for one in found.pairs] == ["a and b", "a and c", "b and c"] * 2
    # No wrong answer named a material here, so that a pair is told apart as its right answers are frequent.
    assert found.pairs[0].result.mean == pytest.approx((right / total)[:, 0, :2].mean())


def test_what_does_not_vary_and_a_reconstruction_have_no_equivalence(study: Study, approved: SnapshotAssertion) -> None:
    counts = _counts()
    counts[0, :, :, 0] = counts[1, :, :, 0]
    found = equivalences(study, _tasks(counts))
    assert found.statements == approved
    rows = equivalences(replace(study, origin="RECONSTRUCTION"), _tasks(counts))
    assert (rows.tasks, rows.pairs) == ((), ())
    assert LINKED in rows.statements[0]


@pytest.mark.parametrize(("right", "lines"), [((8, 9), 1), ((9, 10), 0), ((1, 0), 0)])
def test_tasks_near_0_or_1_are_not_tested_for_equivalence(right: tuple[int, int], lines: int) -> None:
    counts = np.array([[[hits + k % 2 * (1 if hits < 9 else -1) for k in range(6)]] for hits in right])
    try:
        found = [equivalent_gaps(counts, np.full_like(counts, 10))]
    except NotDefined:
        found = []
    assert len(found) == lines


def test_the_page_has_tables_and_a_figure_of_ours(tmp_path: Path, approved: SnapshotAssertion) -> None:
    rng = np.random.default_rng(8)
    people = {
        str(k): {task: trials([(m, m if rng.random() < 0.6 else "sand") for m in ("glass", "sand", "snow") * 4])
                 for task in ("virtual", "real")}
        for k in range(7)
    }  # fmt: skip
    results = compute(read(write_dataset(tmp_path, people)), {})
    same = equivalence_section(results)
    assert len(same.tables) == 2
    assert "exploratory" in text(same)
    section = contrasts_section(results)
    assert text(section) == approved
    found = results.marginal[0]
    assert found is not None
    drawn = contrast_sheet(found, ["virtual", "real"], "REHEARSAL", [1 / 3], titles=True)
    assert drawn.section == section.slug
    assert png(drawn.figure)[:4] == b"\x89PNG"
    assert len({len(row) for row in csv.reader(io.StringIO(comma_separated(section, "")))}) == 1
