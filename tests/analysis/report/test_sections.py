"""Sections of the report: an interval that cannot be computed is told of."""

from __future__ import annotations

from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.identification.results import compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.report import sections
from palpate.analysis.report.figures import sheets
from palpate.analysis.report.identification_sections import confusions_section
from palpate.analysis.report.plan import Standing
from palpate.experiment.records.events import NO_ANSWER
from tests.analysis.datasets import MATERIALS, balanced, trials, write_dataset

NONE = Standing(frozenset(), frozenset(), frozenset())


def test_limits_of_effect_sizes(
    repository_root: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.setattr("palpate.analysis.statistics.inference.nctdtr", lambda *_: float("nan"))
    monkeypatch.setattr("palpate.analysis.statistics.inference.ncfdtr", lambda *_: float("nan"))
    results = compute(read(repository_root / "participants" / "okamoto2012"), {})
    notes = [note for table in sections.tests_section(results).tables for note in table.notes]
    assert len(notes) == 8
    assert notes[0] == approved
    said = sections.anova_section(results, (), NONE).paragraphs
    assert sum("partial η² is not defined" in one for one in said) == 2 + 9
    assert said == approved


def test_corrections_beyond_what_can_be_transmitted(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """Perfect answers to three materials, 48 trials: log2 3 less (0 - 2) / (2 x 48 ln 2) is 1.615 bits of 1.585."""
    perfect = trials([(material, material) for material in MATERIALS for _ in range(4)])
    level = trials([(shown, said) for shown in MATERIALS for said in MATERIALS])
    sessions = {str(k): {"virtual": perfect, "real": level} for k in range(4)}
    study = read(write_dataset(tmp_path, sessions))
    found = confusions_section(compute(study, {}), study.materials).tables[0]
    assert found.rows[0][2] == "1.585"
    assert found.rows[0][4:6] == ("1.615", "1.615")
    assert found.notes[1:] == approved


def test_who_never_answered_a_material_is_named_beside_the_answers(tmp_path: Path, approved: SnapshotAssertion) -> None:
    usual = [(material, material) for material in MATERIALS]
    silent = [("glass", NO_ANSWER), ("sand", "sand"), ("snow", "glass"), ("snow", "snow")]
    unnamed = [("glass", "glass"), ("sand", "sand"), ("snow", "sand")]
    missing = [("glass", "glass"), ("sand", "sand")]
    made = [usual, silent, unnamed, missing, *[unnamed] * 12]
    sessions = {f"{k:02d}": {"real": trials(one)} for k, one in enumerate(made, start=1)}
    results = compute(read(write_dataset(tmp_path, sessions, tasks=("real",))), {})
    (section,) = (sections.confusion_section(results),)
    assert section.brief == ()
    assert section.tables[0].notes[1:] == approved


def test_the_interval_of_the_information(tmp_path: Path, approved: SnapshotAssertion) -> None:
    study = read(write_dataset(tmp_path, {"1": {"virtual": balanced(1)}}))
    said = confusions_section(compute(study, {}), study.materials).paragraphs
    assert said == approved


def test_two_participants_have_no_brackets_and_a_learning_curve_of_their_five_trials(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """A bootstrap needs three; a window of ten is longer than the session."""
    said = ("glass", "sand", "snow", "sand", "glass")
    rows = trials(zip(("glass", "sand", "snow", "glass", "sand"), said, strict=True))
    study = read(write_dataset(tmp_path, {str(who): {"real": rows} for who in (1, 2)}, tasks=("real",)))
    results = compute(study, {})
    tables = confusions_section(results, study.materials).tables
    (notes,) = [table.notes for table in tables if "similarity-choice" in table.title]
    assert not any("Brackets show" in note for note in notes)
    assert notes == approved
    (learning,) = [one for one in sheets(results, "") if one.name == "learning"]
    assert learning.caption == approved
