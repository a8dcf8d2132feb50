"""Sections of the report: an interval that cannot be computed is told of."""

from __future__ import annotations

from pathlib import Path

import pytest

from analysis import sections
from analysis.dataset import read
from analysis.identification_sections import confusions_section
from analysis.results import compute
from tests.analysis.datasets import balanced, write_dataset


def test_limits_of_effect_sizes(repository_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scipy.special.nctdtr", lambda *_: float("nan"))
    monkeypatch.setattr("scipy.special.ncfdtr", lambda *_: float("nan"))
    results = compute(read(repository_root / "participants" / "okamoto2012"), {})
    notes = [note for table in sections.tests_section(results).tables for note in table.notes]
    assert len(notes) == 8
    assert notes[0] == "copy paper: no interval of d, the noncentral t cannot be computed so far out."
    said = sections.anova_section(results).paragraphs
    assert sum("interval of partial η²" in one for one in said) == 2 + 9
    assert any(one.startswith("Not defined: two-way, type III, material: interval of partial η²;") for one in said)


def test_the_interval_of_the_information(tmp_path: Path) -> None:
    study = read(write_dataset(tmp_path, {"1": {"virtual": balanced(1)}, "2": {"virtual": balanced(2)}}))
    said = confusions_section(compute(study, {}), study.materials, ()).paragraphs
    assert "Not defined: virtual, interval of the information: a bootstrap needs 3 participants, got 2." in said
