"""The corpus of recordings as other programs write them: read right, or refused with a remedy that works."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.experiment.recordings.corpus import LAYOUTS, Layout, corpus, outcome, rearranged


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_file_of_a_layout_is_read_right_or_asked_about(name: str, tmp_path: Path) -> None:
    """A refusal counts only where the file does not say what is missing."""
    for file, layout in corpus():
        if file.startswith(f"{name}, "):
            silent = layout.encoding == "cp1252" or not layout.says_unit
            assert outcome(layout, tmp_path) in ("right", *(["refused"] if silent else [])), file


def test_the_corpus_is_large_and_nearly_all_of_it_is_read(tmp_path: Path) -> None:
    outcomes = [outcome(layout, tmp_path) for _, layout in corpus()]
    assert len(LAYOUTS) >= 25
    assert len(outcomes) >= 150
    assert outcomes.count("right") >= 200
    assert outcomes.count("wrong") == 0


def test_a_heading_behind_a_semicolon_stands_above_rows_that_end_in_one(tmp_path: Path) -> None:
    layout = Layout(";", comment="; ", trailing=True, clock_at=1, further=2)
    assert outcome(layout, tmp_path) == "right"


def test_no_rearrangement_of_the_same_data_is_read_as_something_else(tmp_path: Path) -> None:
    assert {outcome(rearranged(seed), tmp_path) for seed in range(200)} == {"right", "refused"}


def test_a_planted_fault_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that takes every comma for the sign of thousands reads something else."""
    monkeypatch.setattr("palpate.experiment.recordings.text.decimals.decimal_sign", lambda *_: ".")
    assert outcome(Layout(delimiter=";", decimal=","), tmp_path) == "wrong"
