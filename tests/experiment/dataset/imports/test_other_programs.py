"""What tables of trials lack or hold besides: labels in names, right or wrong, comparisons, rules, errors by kind."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from palpate.analysis.reading.dataset import read
from palpate.experiment.dataset.imports.imported import import_trials
from palpate.experiment.dataset.imports.layout import Layout
from palpate.experiment.dataset.imports.trial_files import read_trials
from palpate.experiment.errors import DatasetError, Remedy
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.settings.delimited import Stated

PLAIN = Layout("shown", "said", "who")
COMMAND = Stated(command=("palpate", "import-trials"))


def _file(tmp_path: Path, text: str, name: str = "trials.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, "utf-8", newline="")
    return path


@pytest.mark.parametrize("shape", ["list", "lines", "within"])
def test_jspsych_json_with_answers_in_objects(tmp_path: Path, shape: str) -> None:
    """A trial of survey-text and one of a keyboard, as jsPsych 7 writes them."""
    trials = [
        {"trial_type": "instructions", "rt": 3000, "view_history": [1]},
        {"who": 7, "shown": "cork", "response": {"Q0": "cork"}, "rt": 512.5},
        {"who": 7, "shown": "felt", "response": {"Q0": None}, "rt": None},
    ]
    text = {
        "list": json.dumps(trials), "lines": "\n".join(map(json.dumps, trials)), "within": json.dumps({"data": trials}),
    }[shape]  # fmt: skip
    path = _file(tmp_path, text, "trials.json")
    found = read_trials([path], Layout("shown", "response.Q0", "who", time_ms="rt"))
    assert [(row.line, row.participant, row.answered, row.response_time_s) for row in found.rows] == [
        (2, "7", "cork", 0.5125),
        (3, "7", NO_ANSWER, None),
    ]


def test_a_key_that_stands_twice_in_an_object_is_refused(tmp_path: Path) -> None:
    path = _file(tmp_path, '[{"who": 1, "shown": "felt", "shown": "cork", "said": "cork"}]', "trials.json")
    with pytest.raises(DatasetError, match="'shown' twice"):
        read_trials([path], PLAIN)


@pytest.mark.parametrize(
    ("head", "stated"),
    [
        ("RT [ms]", replace(PLAIN, time_s="RT [ms]")),
        ("rt_s", replace(PLAIN, time_ms="rt_s")),
        ("rt (min)", replace(PLAIN, time_s="rt (min)")),
    ],
)
def test_a_heading_that_says_another_unit_than_the_option_is_refused(tmp_path: Path, head: str, stated: Layout) -> None:
    path = _file(tmp_path, f"who,shown,said,{head}\n1,felt,cork,512\n1,cork,cork,480\n")
    with pytest.raises(DatasetError) as refused:
        read_trials([path], stated)
    assert refused.value.finding.field == f"column {head}"
    agreed = read_trials(
        [_file(tmp_path, path.read_text().replace(head, "rt_ms"), "ms.csv")], replace(PLAIN, time_ms="rt_ms")
    )
    assert [row.response_time_s for row in agreed.rows] == [0.512, 0.48]


def test_a_code_that_was_mapped_in_answers_alone_is_to_be_mapped_where_it_was_presented(tmp_path: Path) -> None:
    path = _file(tmp_path, "who,shown,said\n1,1,1\n1,2,1\n")
    with pytest.raises(DatasetError) as refused:
        read_trials([path], replace(PLAIN, answers={"1": "cork"}), stated=COMMAND)
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    assert remedy.command[-2:] == ("--map-presented", "1=cork")


def test_the_label_in_a_files_name(tmp_path: Path) -> None:
    paths = [_file(tmp_path, "shown,said\nfelt,cork\ncork,cork\n", f"P{n}_exp_2024-05-{n}.csv") for n in ("01", "12")]
    layout = Layout("shown", "said", None, in_name="{}_exp_*.csv")
    paths[1].write_text("shown,said\ncork,cork\n")
    assert [row.participant for row in read_trials(paths, layout).rows] == ["P01", "P01", "P12"]
    with pytest.raises(DatasetError) as refused:
        read_trials(paths, replace(layout, in_name="sub-{}.csv"))
    assert refused.value.finding.where == paths[0]


def test_right_and_wrong_of_two_materials(tmp_path: Path) -> None:
    path = _file(tmp_path, "who,shown,ok\n1,felt,True\n1,cork,false\n1,felt,0.0\n1,cork,\n")
    layout = Layout("shown", None, "who", correct="ok")
    assert [row.answered for row in read_trials([path], layout).rows] == ["felt", "felt", "cork", NO_ANSWER]
    with pytest.raises(DatasetError) as refused:
        read_trials([_file(tmp_path, "who,shown,ok\n1,felt,1\n1,cork,0\n1,silk,1\n")], layout)
    assert (refused.value.finding.field, refused.value.finding.line) == ("column ok", 3)


def test_comparisons_with_ties_become_a_study_of_comparisons(tmp_path: Path) -> None:
    """Columns as in R's BradleyTerry2 data CEMS."""
    path = _file(
        tmp_path,
        "student,school1,school2,choice\n1,London,Paris,London\n1,London,Milano,Milano\n2,Paris,Milano,tie\n2,Paris,London,NA\n",
    )
    layout = Layout("school1", "choice", "student", second="school2")
    made = import_trials([path], tmp_path / "out", layout, study="cems", source="made", materials=())
    study = read(made.root)
    assert study.materials == ("London", "Milano", "Paris")
    assert [(one.name, one.answers) for one in study.designs.values()] == [("comparison", ("first", "second", "tie"))]
    rows = study.attempts
    assert rows["first"].tolist() == ["London", "London", "Paris", "Paris"]
    assert rows["answered"].tolist() == ["first", "second", "tie", NO_ANSWER]


def test_rules_leave_out_rows_and_times_and_say_how_many(tmp_path: Path) -> None:
    path = _file(
        tmp_path,
        "who,shown,said,rt,block\n1,felt,cork,-1,a\n1,cork,cork,0.5,a\n1,cork,cork,0.6,practice\n,felt,felt,999,a\n",
    )
    layout = replace(
        PLAIN, time_s="rt", leave_out=(("block", "practice"), ("who", "")), missing_times=("negative", "999")
    )
    found = read_trials([path], layout)
    assert [row.response_time_s for row in found.rows] == [None, 0.5]
    assert (found.left_out, found.missing_times) == ({("block", "practice"): 1, ("who", ""): 1}, 1)
    made = import_trials([path], tmp_path / "out", layout, study="lab", source="made")
    stated = [sentence for sentence in made.sentences if "as requested" in sentence]
    assert len(stated) == 3
    assert all(sentence in " ".join((made.root / "README").read_text().split()) for sentence in stated)


def test_all_that_is_wrong_is_told_at_once_by_kind(tmp_path: Path) -> None:
    rows = "".join(f"{n % 3 or ''},felt,{'fx'[n % 2]},{(-1, n)[n % 2]}\n" for n in range(30))
    path = _file(tmp_path, f"who,shown,said,rt\n1,cork,cork,0.4\n{rows}")
    with pytest.raises(DatasetError) as refused:
        read_trials([path], replace(PLAIN, time_s="rt"), (), COMMAND)
    found = refused.value.findings
    assert [one.field for one in found] == ["column who", "column rt", "column said", ""]
    assert [int(one.what.split(" in ")[1].split()[0]) for one in found[:3]] == [10, 10, 10]
    (command,) = (one.remedy.command[2:] for one in found if isinstance(one.remedy, Remedy))
    assert command == ("--leave-out", "who=", "--missing-time", "negative", "--map", "x=MATERIAL")


@pytest.mark.parametrize(
    ("column", "times", "likely"), [("time_s", (480, 510), "--milliseconds"), ("time_ms", (0.5, 0.6), "--seconds")]
)
def test_response_times_in_another_unit_are_doubted(
    tmp_path: Path, column: str, times: tuple[float, float], likely: str
) -> None:
    path = _file(tmp_path, f"who,shown,said,rt\n1,felt,cork,{times[0]}\n1,cork,cork,{times[1]}\n")
    layout = replace(PLAIN, time_s="rt") if column == "time_s" else replace(PLAIN, time_ms="rt")
    told = "--seconds" if column == "time_s" else "--milliseconds"
    (doubt,) = read_trials([path], layout, (), Stated(command=("palpate", "import-trials", told, "rt"))).doubts
    assert isinstance(doubt.remedy, Remedy)
    assert (doubt.verdict, doubt.remedy.command[2:]) == ("warns", (likely, "rt"))


def test_what_runs_code_or_is_no_text_is_not_opened(tmp_path: Path) -> None:
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        path = tmp_path / "exp.psydat"
        path.write_bytes(pickle.dumps({"trial": 1}, protocol))
        with pytest.raises(DatasetError) as refused:
            read_trials([path], PLAIN)
        assert "a pickle" in refused.value.finding.what
    path.write_bytes(b"PK\x03\x04 a workbook")
    with pytest.raises(DatasetError) as refused:
        read_trials([path], PLAIN)
    assert "zip" in refused.value.finding.what


@pytest.mark.parametrize(
    "layout",
    [
        lambda: Layout("shown", None, "who"),
        lambda: Layout("shown", "said", "who", correct="ok"),
        lambda: Layout("shown", "said", None),
        lambda: Layout("shown", "said", "who", in_name="{}"),
        lambda: Layout("shown", "said", "who", missing_times=("",)),
        lambda: Layout("shown", None, "who", correct="ok", second="other"),
    ],
)
def test_what_cannot_hold_together_is_refused(layout: object) -> None:
    assert callable(layout)
    with pytest.raises(DatasetError):
        layout()
