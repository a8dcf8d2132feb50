"""Comparisons on disk: the rows of a session by hand, and a rehearsed dataset that builds and verifies."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from palpate.experiment.dataset import build, tables
from palpate.experiment.dataset.kinds.tapping import DATASET
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.messages import Correct
from palpate.experiment.errors import DatasetError, RigError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study
from tests.experiment.protocol.tapping import live_alone, protocol
from tests.experiment.session.kinds.tapping.bench import console, contents, run


def test_a_row_for_each_pair_that_was_laid_out(tmp_path: Path) -> None:
    run(protocol(tie_key="3"), console(["/", "1", "3", Correct(trial=2, key="2", reason="misheard"), "0"]), tmp_path)
    rows = build.event_rows(DATASET, tmp_path, contents(tmp_path), "PILOT")
    asked = "asked for by the experimenter"
    # 2 s of laying out after 100 s of familiarisation, 1 s until each key and each remark.
    assert rows == [
        {"onset": 102.0, "trial": 1, "attempt": 1, "counted": False, "first": "felt", "second": "tin",
         "answered": None, "response_time": None, "redo_reason": asked, "origin": "PILOT"},
        {"onset": 105.0, "trial": 2, "attempt": 1, "counted": True, "first": "cork", "second": "cork",
         "answered": "second", "response_time": 1.0, "redo_reason": None, "origin": "PILOT", "corrected_from": "first"},
        {"onset": 108.0, "trial": 3, "attempt": 1, "counted": True, "first": "tin", "second": "cork",
         "answered": "tie", "response_time": 1.0, "redo_reason": None, "origin": "PILOT"},
        {"onset": 111.0, "trial": 1, "attempt": 2, "counted": True, "first": "felt", "second": "tin",
         "answered": "(none)", "response_time": 2.0, "redo_reason": None, "origin": "PILOT"},
    ]  # fmt: skip


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    return study.rehearse(
        protocol_file=live_alone(folder),
        rig_file=shipped("rigs/rehearsal.toml"),
        out=folder / "rehearsed",
        participants=1,
        seed=1,
    )


def test_a_rehearsed_dataset_has_its_columns_and_says_what_they_hold(rehearsed: Path) -> None:
    events = rehearsed / "sub-01" / "beh" / "sub-01_task-live_events.tsv"
    header, *rows = events.read_text().splitlines()
    columns = "onset duration trial attempt counted first second answered response_time redo_reason origin"
    assert header.split("\t") == columns.split()
    assert len(rows) == 120
    sidecar = json.loads(events.with_suffix(".json").read_text())
    assert sidecar["Answers"] == ["first", "second"]
    assert sidecar["Materials"] == ["polystyrene", "silicone", "basswood", "plastic", "aluminum"]
    assert list(sidecar["answered"]["Levels"]) == ["first", "second", "(none)"]
    assert sidecar["TaskDescription"].endswith("15 pairs of 5 materials, compared in terms of hardness, 8 trials each.")
    assert "REHEARSAL" in (rehearsed / "README").read_text()
    assert not (rehearsed / "stimuli").exists()


def test_it_is_built_again_the_same_and_verified(rehearsed: Path) -> None:
    before = {path: path.read_bytes() for path in rehearsed.rglob("*") if path.is_file()}
    build.build(rehearsed)
    assert {path: path.read_bytes() for path in rehearsed.rglob("*") if path.is_file()} == before
    tables.check_tables(rehearsed)
    told = verify(rehearsed)
    assert told.refused == 0
    assert any("its rig matches it" in finding.clause() for finding in told.findings)


def test_nothing_is_silenced_where_nothing_is_played(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="wellman1995 does not play"):
        study.rehearse(
            protocol_file=live_alone(tmp_path),
            rig_file=shipped("rigs/rehearsal.toml"),
            out=tmp_path / "silent",
            participants=1,
            seed=1,
            control="silence",
        )
    assert not (tmp_path / "silent").exists()


def test_virtual_surfaces_are_not_rehearsed_on_a_rig_that_pushes_nothing(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"rig 'rehearsal': got no \[servo\] table"):
        study.rehearse(
            protocol_file=shipped("wellman1995.toml"),
            rig_file=shipped("rigs/rehearsal.toml"),
            out=tmp_path / "pushed",
            participants=1,
            seed=1,
        )
    assert not (tmp_path / "pushed").exists()
    rig = study.simulated_rig(files.load(shipped("wellman1995.toml")))
    assert rig == shipped("rigs/tapping.toml")


def test_an_answer_that_was_edited_is_found(rehearsed: Path, tmp_path: Path) -> None:
    events = rehearsed / "sub-01" / "beh" / "sub-01_task-live_events.tsv"
    kept = events.read_bytes()
    try:
        header, _, rows = kept.partition(b"\n")
        events.write_bytes(header + b"\n" + rows.replace(b"\tfirst\t", b"\tsecond\t", 1))
        with pytest.raises(DatasetError, match="not match the journal"):
            tables.check_tables(rehearsed)
    finally:
        events.write_bytes(kept)
