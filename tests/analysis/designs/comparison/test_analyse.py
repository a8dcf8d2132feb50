"""A whole analysis of comparisons: tables, figures and files, and what is refused in words."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.analyse import Analysis, analyse
from palpate.analysis.designs import check_design
from palpate.analysis.designs.comparison import results
from palpate.analysis.export import DICTIONARY, files
from palpate.analysis.identification.confusion import confusion_of
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.pooled import read_pooled
from palpate.experiment.errors import DatasetError
from palpate.experiment.records import software
from tests.analysis.datasets import compared, trials, write_dataset
from tests.approved import Refuses, anywhere

MATERIALS = ("felt", "cork", "tin")
SAID = [
    *[("felt", "cork", "second"), ("cork", "felt", "second"), ("cork", "tin", "second"), ("tin", "cork", "second")],
    *[("felt", "tin", "second"), ("tin", "felt", "first"), ("cork", "cork", "first"), ("felt", "felt", "second")],
    *[("felt", "cork", "second"), ("tin", "felt", "second"), ("tin", "tin", "first"), ("tin", "cork", "(none)")],
]


def dataset(
    root: Path, answers: tuple[str, ...] = ("first", "second"), said: list[tuple[str, str, str]] = SAID
) -> Path:
    sessions = {who: {"live": compared(said[n:] + said[:n])} for n, who in enumerate(("1", "2", "3"))}
    return write_dataset(root, sessions, materials=MATERIALS, tasks=("live",), answers=answers, origin="REHEARSAL")


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    place = tmp_path_factory.mktemp("pairs")
    return analyse([dataset(place / "study")], place / "out")


def test_the_matrix_is_in_the_papers_layout(analysed: Analysis, approved: SnapshotAssertion) -> None:
    text = analysed.text(full=True)
    row = next(line for line in text.splitlines() if line.startswith("tin ") and "(" in line)
    # Of felt and tin 6 of 9 were right; of cork and tin 3 of 6, of which 3 had no answer; of tin alone all were first.
    assert row.split()[1] == "67"
    assert anywhere(text, analysed.out.parent) == approved
    assert text.startswith("REHEARSAL")


def test_the_report_and_its_files_hold_everything(analysed: Analysis) -> None:
    names = {path.relative_to(analysed.out).as_posix() for path in analysed.files}
    assert {
        "report.html",
        "methods.html",
        "results.json",
        "tables/pairs.csv",
        "tables/scales.csv",
        "tables/bias.tex",
    } <= names
    assert {"figures/right-choices.svg", "figures/right-choices.png", "figures/scales.svg"} <= names
    report = analysed.report.read_text("utf-8")
    assert "The P of a deviance assumes independent answers" in report
    assert "Clopper and Pearson (1934)" in (analysed.out / "methods.html").read_text("utf-8")
    told = json.loads((analysed.out / "results.json").read_text("utf-8"))
    assert told["tasks"][0]["unanswered"] == 3
    assert len(told["tasks"][0]["pairs"]) == 6
    assert analysed.as_dict()["quality"] == "what was compared"


def test_answers_stand_first_and_at_the_end_of_the_terminal(analysed: Analysis, approved: SnapshotAssertion) -> None:
    """Of felt and cork 6 of 9 were right, and of cork and tin 3 of 6."""
    _, first, *_ = analysed.sections
    (said,) = first.paragraphs
    assert (first.slug, first.title) == ("found", "What was found")
    right = [record["right"] for record in first.records]
    assert [row[1] for row in first.tables[0].rows] == ["cork above felt", "tin above cork"]
    assert said == approved
    assert right == [6, 3]
    assert analysed.write_up(100).replace(software.this().version, "N") == approved
    text = analysed.text(80, full=True)
    assert text.index("Questions and answers") > text.index("Scales of")
    report = analysed.report.read_text("utf-8")
    assert report.index("Questions and answers</h2>") < report.index("<figure") < report.index("<details")
    assert "The live task (n = 3)" in report


def test_only_the_results_of_its_own_design_are_there(analysed: Analysis, refuses: Refuses) -> None:
    assert analysed.results.materials == MATERIALS
    with refuses(DatasetError):
        check_design(analysed.study, "identification")


def test_ties_have_davidsons_scale(tmp_path: Path, approved: SnapshotAssertion) -> None:
    said = [*SAID, ("felt", "cork", "tie"), ("cork", "tin", "tie"), ("cork", "cork", "tie")]
    found = analyse([dataset(tmp_path / "study", ("first", "second", "tie"), said)], tmp_path / "out", figures=False)
    assert [
        line for section in found.sections for line in (*(t.title for t in section.tables), *section.paragraphs)
    ] == approved


def test_tables_for_other_software_say_what_the_dataset_says(tmp_path: Path) -> None:
    made = files(read(dataset(tmp_path / "study")))
    rows = list(csv.DictReader(io.StringIO(made["trials.csv"].decode())))
    assert len(rows) == 36
    assert [row["right"] for row in rows[:8]] == ["1", "0", "1", "0", "1", "1", "NA", "NA"]
    pairs = {
        (row["first"], row["second"]): (row["first_named"], row["second_named"], row["ties"])
        for row in csv.DictReader(io.StringIO(made["pairs.csv"].decode()))
        if row["participant"] == "sub-1"
    }
    assert pairs["felt", "cork"] == ("0", "2", "0")
    assert pairs["tin", "felt"] == ("1", "1", "0")
    assert pairs["tin", "cork"] == ("0", "1", "0")
    described: dict[str, list[str]] = {}
    for row in csv.DictReader(io.StringIO(made[DICTIONARY].decode())):
        described.setdefault(row["file"], []).append(row["column"])
    headers = {name: content.decode().split("\n")[0].split(",") for name, content in made.items() if name != DICTIONARY}
    assert described == headers


def test_a_cell_that_no_comparison_has_is_refused_with_its_line(tmp_path: Path, refuses: Refuses) -> None:
    root = dataset(tmp_path / "study")
    table = root / "sub-1" / "beh" / "sub-1_task-live_events.tsv"
    table.write_text(table.read_text().replace("\tsecond\tn/a", "\tthird\tn/a", 1))
    with refuses(DatasetError):
        read(root)


def test_answers_that_nobody_may_give_are_refused(tmp_path: Path, refuses: Refuses) -> None:
    root = dataset(tmp_path / "study")
    for sidecar in root.glob("sub-*/beh/*_events.json"):
        told = json.loads(sidecar.read_text())
        sidecar.write_text(json.dumps({**told, "Answers": ["first", "second", "both"]}))
    with refuses(DatasetError):
        results.compute(read(root))


def test_comparisons_and_other_trials_are_not_pooled(tmp_path: Path, refuses: Refuses) -> None:
    pairs, named = dataset(tmp_path / "pairs"), tmp_path / "named"
    write_dataset(
        named, {"9": {"live": trials([("felt", "tin")])}}, materials=MATERIALS, tasks=("live",), origin="REHEARSAL"
    )
    with refuses(DatasetError):
        read_pooled([pairs, named])


def test_what_knows_no_comparisons_says_so(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(DatasetError):
        confusion_of(read(dataset(tmp_path / "study")), "live")
