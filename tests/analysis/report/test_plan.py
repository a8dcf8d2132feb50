"""Planned against done: a planned test says what was run of it, a rule what it left out, and a seal what it says."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents.page import ON_METHODS
from palpate.analysis.documents.tables import Section, Table
from palpate.analysis.identification.results import compute
from palpate.analysis.published import load
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Study
from palpate.analysis.report.answers import UNDEFINED
from palpate.analysis.report.plan import BESIDE, alpha, exclusions_section, marked, standing
from palpate.analysis.report.sections import overview_section, sections
from palpate.experiment.protocol import files
from palpate.experiment.protocol.approval import sealing
from tests.analysis.datasets import balanced, trial, write_dataset

MATERIALS = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


@pytest.fixture
def root(tmp_path: Path, repository_root: Path) -> Path:
    """A dataset of three who did both tasks under the protocol of the footstep study."""
    sessions = {
        str(k): {"virtual": balanced(k, 10, MATERIALS), "real": balanced(k + 1, 10, MATERIALS)} for k in (1, 2, 3)
    }
    made = write_dataset(tmp_path / "data", sessions, materials=MATERIALS)
    (made / "sourcedata").mkdir()
    (made / "sourcedata" / "protocol.toml").write_bytes(
        (repository_root / "protocols" / "okamoto2012.toml").read_bytes()
    )
    return made


def _rows(study: Study) -> dict[str, tuple[str, ...]]:
    _, tests = overview_section(study, compute(study, {})).tables
    return {row[0]: row for row in tests.rows}


def test_what_was_run_stands_beside_what_was_planned(root: Path) -> None:
    """15 and 10 participants with 40 trials each are planned (Okamoto et al., section 5.1)."""
    study = read(root)
    section = overview_section(study, compute(study, {}))
    people, tests = section.tables
    assert [row[2:4] for row in people.rows] == [("3 of 15", "120 of 600"), ("3 of 10", "120 of 400")]
    assert [row[0] for row in tests.rows] == ["t against chance", "one-way ANOVA", "two-way ANOVA", "ICC"]
    assert all("run" in row[4] for row in tests.rows)
    assert section.records[0]["participants_planned"] == 15
    assert all(len(row) == 5 for row in section.brief[1].rows)


def test_the_pair_that_the_plan_names_is_tested_beside_the_one_that_is_confused_most(root: Path) -> None:
    study = read(root)
    found = {frozenset(pair.pair): pair for pair in compute(study, {}).pairs if pair.task == "virtual"}
    foil = found.pop(frozenset({"aluminum foil", "typing paper"}))
    (other,) = found.values()
    stands = standing(study, None)
    assert [(pair.chosen, stands.of_pair(pair)) for pair in (foil, other)] == [
        ("planned", "planned"),
        ("most confused", "exploratory"),
    ]
    assert stands.of_pair(replace(foil, pair=("typing paper", "aluminum foil"))) == "planned"
    assert stands.of_pair(replace(foil, task="real")) == "exploratory"


def test_a_name_inside_of_another_name_plans_nothing(root: Path) -> None:
    """A question about copy paper and typing paper is none about a material called paper."""
    plan = root / "sourcedata" / "protocol.toml"
    text = plan.read_text("utf-8").replace('id = "polypropylene"', 'id = "paper"')
    plan.write_text(text, "utf-8")
    study = read(root)
    (foil, *_) = [pair for pair in compute(study, {}).pairs if pair.task == "virtual"]
    stands = standing(study, None)
    assert stands.of_pair(replace(foil, pair=("paper", "aluminum foil"))) == "exploratory"
    assert stands.of_pair(replace(foil, pair=("foil", "typing"))) == "exploratory"


def test_without_materials_in_the_plan_no_one_way_anova_is_planned(root: Path, approved: SnapshotAssertion) -> None:
    plan = root / "sourcedata" / "protocol.toml"
    plan.write_text(plan.read_text("utf-8").replace('materials = ["aluminum foil", "typing paper"]\n', ""), "utf-8")
    study = read(root)
    (pair,) = [pair for pair in compute(study, {}).pairs if pair.task == "virtual"]
    assert pair.chosen == "most confused"
    assert _rows(study)["one-way ANOVA"][4] == approved
    named = replace(pair, pair=("aluminum foil", "typing paper"))
    assert standing(study, None).of_pair(named) == "exploratory"


def test_what_is_planned_is_marked_and_a_new_study_is_no_published_one(root: Path) -> None:
    study = read(root)
    found = sections(study, compute(study, {}), load("okamoto2012"), None)
    marks = {section.slug: {table.standing for table in section.tables} for section in found}
    assert marks["tests"] == {"planned"}
    assert marks["icc"] == {"planned", "exploratory"}
    assert marks["beside"] == {"companion"}
    assert marks["trials"] <= {"exploratory"}
    assert {section.part for section in found} == {
        "",
        "Planned results",
        BESIDE,
        "Exploratory",
        "Excluded attempts",
        ON_METHODS,
    }


def test_every_planned_question_is_on_the_first_screen(root: Path) -> None:
    """Twice the same test at two levels, and a one-way ANOVA of which the plan names no materials."""
    path = root / "sourcedata" / "protocol.toml"
    text = path.read_text("utf-8").replace('materials = ["aluminum foil", "typing paper"]\n', "")
    again = '\n[[analysis]]\ntest = "t against chance"\ntasks = ["virtual"]\nchance = 0.25\nquestion = "Once more?"\n'
    path.write_text(text + again + again.replace("0.25", "0.25\nalpha = 0.01"), "utf-8")
    study = read(root)
    asked = sections(study, compute(study, {}), None, None)[0].asked
    assert len({one.question for one in asked}) == len({plan.question for plan in study.plans()})
    assert [one.question for one in asked].count("Once more?") == 2
    assert [one.answer for one in asked].count(UNDEFINED) == 1


def test_a_test_that_could_not_be_run_says_why(root: Path, approved: SnapshotAssertion) -> None:
    study = read(root)
    alone = replace(study, attempts=study.attempts[study.attempts["task"] == "virtual"])
    rows = _rows(alone)
    assert rows["t against chance"][4] == approved
    assert rows["two-way ANOVA"][4] == approved


def test_whether_the_plan_was_sealed_is_said(root: Path, approved: SnapshotAssertion) -> None:
    plan = root / "sourcedata" / "protocol.toml"
    said = overview_section(read(root), compute(read(root), {})).paragraphs
    assert said == approved
    protocol = files.load(plan)
    days: dict[str, Any] = {"approved_on": date(2026, 1, 2), "expires_on": date(2027, 1, 2)}
    sealing.write(plan, protocol, approval_number="7", board=protocol.ethics.board, **days)
    (part,) = read(root).parts
    assert part.sealed == f"sealed, approval 7 by {protocol.ethics.board}, valid from 2026-01-02"
    other = protocol.model_copy(update={"exclusion": ()})
    sealing.write(plan, other, approval_number="7", board=protocol.ethics.board, **days, replace=True)
    assert read(root).parts[0].sealed == approved


def test_rules_that_left_out_nothing_stand_there_too(root: Path, approved: SnapshotAssertion) -> None:
    section = exclusions_section(read(root))
    (rules,) = section.tables
    assert rules.standing == "planned"
    assert section.paragraphs == approved
    assert ("too few answers", "0", "participant", "fewer than 36 answers in a task") in rules.rows
    assert ("too slow", "-", "repeats the trial", "speed below 20 mm/s") in rules.rows


def test_single_exclusions_are_folded_below_their_rules(tmp_path: Path, approved: SnapshotAssertion) -> None:
    rows = [trial(1, "sand", "n/a", counted=False, redo_reason="slipped"), trial(1, "sand", "sand", attempt=2)]
    section = exclusions_section(read(write_dataset(tmp_path, {"1": {"real": rows}, "2": {"real": balanced(1)}})))
    assert section.folded
    assert section.brief[0].rows == approved
    assert [row[0] for row in section.tables[0].rows] == ["1"]


def test_without_a_plan_nothing_is_called_planned(tmp_path: Path, approved: SnapshotAssertion) -> None:
    study = read(write_dataset(tmp_path, {str(k): {"real": balanced(k)} for k in (1, 2)}))
    found = sections(study, compute(study, {}), None, None)
    assert found[2].paragraphs == approved
    assert {table.standing for section in found for table in section.tables} == {
        "exploratory", "descriptive", "companion, exploratory",
    }  # fmt: skip
    assert alpha(study, "t against chance", "real") == 0.05


def test_a_table_keeps_the_mark_that_it_has() -> None:
    tables = (Table("a", ("x",), (("1",),), standing="ours"), Table("b", ("x",), (("1",),)))
    assert [table.standing for table in marked(Section("s", "S", tables=tables), "planned").tables] == [
        "ours",
        "planned",
    ]
