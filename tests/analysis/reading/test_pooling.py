"""Pooling: every trial of every dataset counts once, and what does not belong together is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.analyse import analyse
from palpate.analysis.identification.confusion import confusion
from palpate.analysis.identification.results import compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.pooled import read_pooled
from palpate.analysis.reading.study import Study
from palpate.analysis.report.sections import overview_section
from palpate.experiment.dataset.bids import Origin
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.files import shipped
from tests.analysis.datasets import MATERIALS, balanced, trial, write_dataset
from tests.approved import Refuses


def _lab(root: Path, first: int, *, study: str = "lab", origin: Origin = "PARTICIPANT", people: int = 4) -> Path:
    sessions = {
        f"{k:02d}": {"virtual": balanced(first + k), "real": balanced(first + 2 * k)} for k in range(1, people + 1)
    }
    return write_dataset(root, sessions, study=study, origin=origin)


def _counts(study: Study) -> int:
    trials = study.trials("real")
    participants, presented, answered = (trials[c].tolist() for c in ("participant", "presented", "answered"))
    return int(confusion(participants, presented, answered, study.materials).counts.sum())


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


def test_the_report_says_what_was_pooled(tmp_path: Path, approved: SnapshotAssertion) -> None:
    roots = [_lab(tmp_path / "north", 1, study="north"), _lab(tmp_path / "south", 20, study="south")]
    found = analyse(roots, tmp_path / "out", figures=False)
    assert found.study.id == "north+south"
    assert found.sections[2].paragraphs == approved


def test_several_datasets_need_a_place(tmp_path: Path, refuses: Refuses) -> None:
    roots = [_lab(tmp_path / "north", 1), _lab(tmp_path / "south", 20)]
    with pytest.raises(DatasetError, match="--out: got none"):
        analyse(roots, figures=False)
    with refuses(DatasetError):
        analyse(roots, roots[1] / "sub-01", figures=False)


def test_folders_of_one_name_are_numbered(tmp_path: Path) -> None:
    pooled = read_pooled([_lab(tmp_path / "a" / "data", 1), _lab(tmp_path / "b" / "data", 20)])
    assert {label.split("-")[0] for label in pooled.participants} == {"data1", "data2"}


OKAMOTO = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


def _planned(root: Path, first: int, *changes: tuple[str, str], people: int = 4, repetitions: int = 10) -> Path:
    """A dataset with a copy of the shipped protocol, changed by hand."""
    sessions = {f"{k:02d}": {"virtual": balanced(first + k, repetitions, OKAMOTO)} for k in range(1, people + 1)}
    write_dataset(root, sessions, study="okamoto2012", materials=OKAMOTO)
    text = shipped("okamoto2012.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    copy = root / "sourcedata" / "protocol.toml"
    copy.parent.mkdir()
    copy.write_text(text, encoding="utf-8")
    return root


HALF = ("chance = 0.25", "chance = 0.5")


def test_protocols_that_differ_keep_their_common_chance_and_are_named(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """Both labs plan a chance of 0.5, where one of four materials would be 0.25."""
    roots = [
        _planned(tmp_path / "north", 1, HALF),
        _planned(tmp_path / "south", 20, HALF, ("repetitions = 10", "repetitions = 11")),
    ]
    pooled = read_pooled(roots)
    found = compute(pooled, {})
    assert [task.chance for task in found.tasks] == [0.5]
    assert {test.result.chance for test in found.tasks[0].tests} == {0.5}
    section = overview_section(pooled, found)
    said = section.paragraphs
    assert said == approved
    tests = section.tables[1]
    assert (tests.title, tests.rows[0][:3]) == ("Planned tests", ("t against chance", "virtual, real", "0.05"))
    assert any(line.endswith(": " + ", ".join(f"south-0{k} in virtual (40 of 44)" for k in range(1, 5)) + ".")
               for line in said)  # fmt: skip


def test_plans_of_one_dataset_alone_say_of_which(tmp_path: Path, approved: SnapshotAssertion) -> None:
    roots = [
        _planned(tmp_path / "north", 1),
        _planned(tmp_path / "south", 20, ("alpha = 0.05", "alpha = 0.01")),
        write_dataset(
            tmp_path / "bare",
            {"1": {"virtual": balanced(40, 10, OKAMOTO)}},
            study="okamoto2012",
            materials=OKAMOTO,
        ),
    ]
    pooled = read_pooled(roots)
    section = overview_section(pooled, compute(pooled, {}))
    said = section.paragraphs
    assert said == approved
    assert [row[1:3] for row in section.tables[1].rows if row[0] == "t against chance"] == [
        ("virtual, real (north only)", "0.05"),
        ("virtual, real (south only)", "0.01"),
    ]


def test_different_chances_are_not_pooled(tmp_path: Path) -> None:
    plain = write_dataset(
        tmp_path / "bare", {"1": {"virtual": balanced(40, 10, OKAMOTO)}}, study="okamoto2012", materials=OKAMOTO
    )
    half = _planned(tmp_path / "half", 20, HALF)
    for other in (plain, _planned(tmp_path / "quarter", 1)):
        with pytest.raises(DatasetError, match=rf"task virtual: got the chances 0.25 \({other.name}\), 0.5 \(half\)"):
            read_pooled([other, half])


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    north = _lab(tmp_path / "north", 1)
    rehearsed = _lab(tmp_path / "rehearsed", 20, origin="REHEARSAL")
    other = write_dataset(tmp_path / "other", {"1": {"real": balanced(1, 4, MATERIALS[:2])}}, materials=MATERIALS[:2])
    copied = _lab(tmp_path / "copied", 1)
    for roots, why in (
        ([north, rehearsed], "allowed: datasets of one origin"),
        ([north, other], "got the materials glass, sand;"),
        ([north, copied], "north and copied contain the same trials of 01, 02, 03, 04 "),
        ([north, north], "the same dataset twice"),
    ):
        with pytest.raises(DatasetError, match=why):
            read_pooled(roots)
