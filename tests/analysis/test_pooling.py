"""Pooling: every trial of every dataset counts once, and what does not belong together is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from analysis.analyse import analyse
from analysis.confusion import confusion
from analysis.dataset import Study, read
from analysis.pooling import read_pooled
from experiment.dataset_files import Origin
from experiment.errors import DatasetError
from tests.analysis.datasets import MATERIALS, balanced, trial, write_dataset


def _lab(root: Path, first: int, *, study: str = "lab", origin: Origin = "PARTICIPANT", people: int = 4) -> Path:
    sessions = {
        f"{k:02d}": {"virtual": balanced(first + k), "real": balanced(first + 2 * k)} for k in range(1, people + 1)
    }
    return write_dataset(root, sessions, study=study, origin=origin)


def _counts(study: Study) -> int:
    trials = study.trials("real")
    columns = (trials[column].tolist() for column in ("participant", "presented", "answered"))
    return int(confusion(*columns, study.materials).counts.sum())


def test_every_trial_counts_once(tmp_path: Path) -> None:
    roots = [_lab(tmp_path / "north", 1), _lab(tmp_path / "south", 20, people=3)]
    pooled = read_pooled(roots)
    assert pooled.participants[:5] == ("north-01", "north-02", "north-03", "north-04", "south-01")
    assert len(pooled.attempts) == sum(len(read(root).attempts) for root in roots)
    assert _counts(pooled) == sum(_counts(read(root)) for root in roots)
    assert pooled.id == "lab"


def test_one_dataset_is_read_as_it_is(tmp_path: Path) -> None:
    root = _lab(tmp_path / "north", 1)
    assert read_pooled([root]).participants == read(root).participants


def test_exclusions_keep_their_participants(tmp_path: Path) -> None:
    again = [trial(1, "sand", "n/a", counted=False, redo_reason="slipped"), trial(1, "sand", "sand", attempt=2)]
    roots = [_lab(tmp_path / "north", 1), write_dataset(tmp_path / "south", {"01": {"real": again}})]
    assert [one.participant for one in read_pooled(roots).exclusions] == ["south-01"]


def test_the_report_says_what_was_pooled(tmp_path: Path) -> None:
    roots = [_lab(tmp_path / "north", 1, study="north"), _lab(tmp_path / "south", 20, study="south")]
    found = analyse(roots, tmp_path / "out", figures=False)
    assert found.study.id == "north+south"
    assert "Pooled: A study (north); A study (south)" in found.text()


def test_several_datasets_need_a_place(tmp_path: Path) -> None:
    roots = [_lab(tmp_path / "north", 1), _lab(tmp_path / "south", 20)]
    with pytest.raises(DatasetError, match="--out: got none"):
        analyse(roots, figures=False)
    with pytest.raises(DatasetError, match="lies within the dataset"):
        analyse(roots, roots[1] / "sub-01", figures=False)


def test_folders_of_one_name_are_numbered(tmp_path: Path) -> None:
    pooled = read_pooled([_lab(tmp_path / "a" / "data", 1), _lab(tmp_path / "b" / "data", 20)])
    assert {label.split("-")[0] for label in pooled.participants} == {"data1", "data2"}


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    north = _lab(tmp_path / "north", 1)
    rehearsed = _lab(tmp_path / "rehearsed", 20, origin="REHEARSAL")
    other = write_dataset(tmp_path / "other", {"1": {"real": balanced(1, 4, MATERIALS[:2])}}, materials=MATERIALS[:2])
    copied = _lab(tmp_path / "copied", 1)
    for roots, why in (
        ([north, rehearsed], "allowed: those of one origin"),
        ([north, other], "got the materials glass, sand;"),
        ([north, copied], "north and copied hold the same answers"),
        ([north, north], "a dataset twice"),
    ):
        with pytest.raises(DatasetError, match=why):
            read_pooled(roots)
