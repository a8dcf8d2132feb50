"""Trials of other software become a dataset that is analysed as answers of participants, and says IMPORTED."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

from palpate.analysis.audit.audit import audit
from palpate.analysis.reading.dataset import read
from palpate.experiment.dataset.bids import LABELS
from palpate.experiment.dataset.imports.imported import Imported, import_trials
from palpate.experiment.dataset.imports.layout import Layout, pairs
from palpate.experiment.dataset.imports.reconstruction import import_counts, study_text
from palpate.experiment.dataset.imports.trial_files import read_trials
from palpate.experiment.dataset.status import status
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER

LAYOUT = Layout("shown", "said", "who", task="task", trial="n", time_ms="rt")
HEADER = "who,task,n,shown,said,rt\n"
BODY = (
    "P02,Real ones,0,felt,felt,500\nP02,Real ones,2,cork,felt,250\nP02,Real ones,1,cork,,\nP10,Virtual,0,felt,cork,1\n"
)


def _made(tmp_path: Path, body: str = BODY, layout: Layout = LAYOUT, study: str = "lab") -> Imported:
    path = tmp_path / "Jane_Doe.csv"
    path.write_text(HEADER + body)
    return import_trials([path], tmp_path / "out", layout, study=study, source="PsychoPy, 2024")


def test_trials_as_analysis_reads_them(tmp_path: Path) -> None:
    study = read(_made(tmp_path).root)
    assert (study.origin, study.label, study.ordered) == ("IMPORTED", LABELS["IMPORTED"], True)
    assert (study.participants, study.materials) == (("02", "10"), ("cork", "felt"))
    assert [(task.id, task.title) for task in study.tasks] == [("realones", "Real ones"), ("virtual", "Virtual")]
    rows = study.trials("realones")
    assert rows["trial"].tolist() == [1, 2, 3]
    assert rows["presented"].tolist() == ["felt", "cork", "cork"]
    assert rows["answered"].tolist() == ["felt", NO_ANSWER, "felt"]
    assert rows["response_time_s"].tolist()[::2] == [0.5, 0.25]


def test_the_status_of_what_was_imported_says_that_it_is_and_which_command_makes_its_tables(tmp_path: Path) -> None:
    root = _made(tmp_path).root
    with pytest.raises(DatasetError) as refused:
        status(root, date(2026, 1, 1))
    said = f"it contains only imported answers; to make tables and a report: palpate analyse {root}"
    assert str(refused.value) == f"{root}: does not contain a study; allowed: the dataset of a study; {said}"


def test_every_file_says_what_it_is_and_none_who_took_part(tmp_path: Path) -> None:
    body = BODY.replace("P02", "Jane Doe").replace("P10", "John Roe")
    made = _made(tmp_path, body)
    assert any("numbered in the order of the files" in said for said in made.sentences)
    assert read(made.root).participants == ("01", "02")
    for path in (path for path in made.root.rglob("*") if path.is_file()):
        text = path.read_text()
        assert not any(word in text for word in ("Jane", "Doe", "RECONSTRUCTION", "foot 1")), path
        if path.suffix != ".csv":
            assert "IMPORTED" in text, path
    held = (made.root / "sourcedata" / "lab_trials.csv").read_text().splitlines()
    assert held[:4] == [
        "participant,task,trial,file,line,presented,answered,response_time_s",
        "01,realones,0,1,2,felt,felt,0.5",
        f"01,realones,1,1,4,cork,{NO_ANSWER},",
        "01,realones,2,1,3,cork,felt,0.25",
    ]


def test_a_run_that_stands_in_two_files_is_told(tmp_path: Path) -> None:
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    layout = Layout("shown", "said", "who")
    for path, said in zip(paths, ("felt", "cork"), strict=True):
        path.write_text(f"who,shown,said\n1,felt,{said}\n1,cork,{said}\n")
    made = import_trials(paths, tmp_path / "out", layout, study="lab", source="a lab")
    assert made.sentences[-1].startswith("Several files contain trials from the same task for: 01.")
    assert read(made.root).attempts["trial"].tolist() == [1, 2, 3, 4]
    paths[1].write_bytes(paths[0].read_bytes())
    with pytest.raises(DatasetError, match=r"b.csv: has the same content as .*a.csv; give each file once"):
        import_trials(paths, tmp_path / "again", layout, study="lab", source="a lab")


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("1,a,0,felt,felt,\n01,a,1,cork,felt,\n", r"line 3: column who: got '01' and '1'"),
        (
            "1,a b,0,felt,felt,\n1,ab,1,cork,felt,\n",
            r"line 3: column task: got the task 'ab', whose id would be 'ab'",
        ),
        ("1,a,0,fe\u202elt,felt,\n1,a,1,cork,felt,\n", r"U\+202E"),
    ],
)
def test_what_cannot_be_told_apart_makes_no_dataset(tmp_path: Path, body: str, told: str) -> None:
    with pytest.raises(DatasetError, match=told):
        _made(tmp_path, body.replace(",felt,\n", ",cork,\n"))
    assert not (tmp_path / "out").exists()


def test_answers_to_a_published_study_are_compared_with_its_paper(tmp_path: Path) -> None:
    body = "".join(
        f"{who},virtual,{n},{shown},{said},\n"
        for who in (1, 2, 3)
        for n, (shown, said) in enumerate([("copy paper", "copy paper"), ("aluminum foil", "typing paper")] * 2)
    )
    made = _made(tmp_path, body, study="okamoto2012")
    assert read(made.root).materials == ("copy paper", "aluminum foil", "polypropylene", "typing paper")
    found = audit(str(made.root))
    assert (found.origin, found.label) == ("IMPORTED", LABELS["IMPORTED"])
    assert "measured elsewhere" in found.text()
    assert "Does not agree" not in found.text()


def test_measured_counts_are_no_reconstruction(tmp_path: Path) -> None:
    counts = tmp_path / "counts.csv"
    counts.write_text("participant,presented,answered,count\n1,felt,felt,3\n1,cork,felt,2\n2,cork,cork,4\n")
    text = study_text("lab", {"one": counts}, "our sessions", measured=True)
    root = import_counts({"one": counts}, tmp_path / "out", study=text)
    study = read(root)
    assert (study.origin, study.label, study.ordered) == ("IMPORTED", LABELS["IMPORTED"], False)
    assert len(study.attempts) == 9
    for path in (path for path in root.rglob("*") if path.is_file()):
        assert "RECONSTRUCTION" not in path.read_text(), path
    assert "arbitrary" not in (root / "README").read_text()
    assert json.loads((root / "dataset_description.json").read_text())["Palpate"]["Ordered"] is False


def test_measured_counts_of_a_published_study_have_its_materials_and_not_its_text(tmp_path: Path) -> None:
    counts = tmp_path / "counts.csv"
    counts.write_text("participant,presented,answered,count\n1,typing paper,copy paper,3\n")
    text = study_text("okamoto2012", {"real": counts}, "our sessions", measured=True)
    assert list(text.materials) == ["copy paper", "aluminum foil", "polypropylene", "typing paper"]
    assert text.tasks["real"] == ("Task 2: real stimuli", "As in the source.")
    assert (text.source, text.origin) == ("our sessions", "IMPORTED")
    with pytest.raises(DatasetError, match="--source"):
        study_text("okamoto2012", {"real": counts}, measured=True)


def test_a_material_that_tables_read_as_missing_is_refused_and_a_row_with_it_is_told(tmp_path: Path) -> None:
    """pandas and R read NA as nothing, so that a material of that name would be lost to whoever reads the tables."""
    file = tmp_path / "data.csv"
    file.write_text("who,shown,said\n1,felt,felt\n1,cork,NA\n1,NA,felt\n1,,\n", "utf-8")
    layout = Layout("shown", "said", "who")
    made = import_trials([file], tmp_path / "one", layout, study="lab", source="here")
    assert (
        "Rows skipped because they are not trials: 2, 1 of them with 'NA', which counts as a missing value."
        in made.sentences[1]
    )
    with pytest.raises(DatasetError, match="got the material 'NA', which means a missing value in tables; rename it"):
        import_trials([file], tmp_path / "two", layout, study="lab", source="here", materials=("felt", "cork", "NA"))
    file.write_text("who,shown,said\n1,felt,felt\n1,nan,felt\n", "utf-8")
    with pytest.raises(DatasetError, match="got the material 'nan'"):
        import_trials([file], tmp_path / "two", layout, study="lab", source="here")
    file.write_text("participant,presented,answered,count\n1,NA,NA,3\n1,felt,felt,4\n", "utf-8")
    with pytest.raises(DatasetError, match="got the material 'NA'"):
        study_text("lab", {"one": file}, "here", measured=True)


@pytest.mark.parametrize("other", ["p01", "p1", "P001", "01", "P1.0", "\u04201"])
def test_two_spellings_that_look_like_one_person_are_asked_about(tmp_path: Path, other: str) -> None:
    """The remedy says that they are one, and works."""
    body = f"P01,a,1,felt,felt,1\nP01,a,2,cork,cork,1\n{other},a,3,felt,felt,1\n"
    if other == "\u04201":
        body = body.replace("P01", "P1")
    with pytest.raises(DatasetError) as refused:
        _made(tmp_path, body)
    option, mapping = str(refused.value.finding.remedy).split()[-2:]
    assert option == "--map-participant"
    made = _made(tmp_path, body, replace(LAYOUT, people=pairs(option, [mapping])))
    assert made.sentences[0].startswith("Participants: 1.")


def test_cells_of_any_length_and_response_times_with_commas(tmp_path: Path) -> None:
    text = "who;task;n;shown;said;rt;voice\n1;a;1;felt;felt;812,5;{0}\n1;a;2;cork;cork;,5;{0}\n".format("A" * 200_000)
    file = tmp_path / "trials.csv"
    file.write_bytes(text.encode("utf-16"))
    times = [row.response_time_s for row in read_trials([file], LAYOUT).rows]
    assert times == [0.8125, 0.0005]
