"""Cells of trials that hold more than a number or a name: lists, units, and both decimal signs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from palpate.experiment.dataset.imports.layout import Layout, cells
from palpate.experiment.dataset.imports.trial_files import read_trials
from palpate.experiment.errors import DatasetError, Remedy
from palpate.experiment.settings.delimited import Stated

IN_S = Layout("shown", "said", "who", time_s="rt")
IN_MS = Layout("shown", "said", "who", time_ms="rt")


def _file(tmp_path: Path, rows: list[str], delimiter: str = ";") -> Path:
    path = tmp_path / "trials.csv"
    lines = ["who;shown;said;rt", *(f"1;{'felt' if k % 2 else 'cork'};{row}" for k, row in enumerate(rows))]
    path.write_text("\n".join(lines).replace(";", delimiter) + "\n", "utf-8")
    return path


@pytest.mark.parametrize(
    ("layout", "rows"),
    [
        (IN_S, ["['cork'];[0.617]", '["felt"];[1.5]']),
        (IN_S, ["cork;0,617", "felt;1.5"]),
        (IN_S, ["cork;0,617 s", "felt;1,5 sec"]),
        (IN_MS, ["cork;617 ms", "felt;1500ms"]),
        (IN_MS, ["cork;617,0", "felt;1500 ms"]),
    ],
)
def test_a_list_of_one_a_unit_and_either_decimal_sign_are_read(tmp_path: Path, layout: Layout, rows: list[str]) -> None:
    made = read_trials([_file(tmp_path, rows)], layout)
    assert [(one.presented, one.answered) for one in made.rows[:2]] == [("cork", "cork"), ("felt", "felt")]
    assert [round(one.response_time_s or 0.0, 9) for one in made.rows[:2]] == [0.617, 1.5]
    assert [doubt.check for doubt in made.doubts] == (["decimal signs"] if rows == ["cork;0,617", "felt;1.5"] else [])


def test_times_in_another_unit_than_their_cells_say_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="--milliseconds"):
        read_trials([_file(tmp_path, ["cork;617 ms", "felt;900 ms"])], IN_S)


def test_where_no_cell_is_a_time_the_remedy_leaves_the_column_aside_and_no_trial(tmp_path: Path) -> None:
    path = _file(tmp_path, ["cork;fast", "felt;slow"])
    with pytest.raises(DatasetError) as refused:
        read_trials(
            [path], IN_S, stated=Stated(command=("palpate", "import-trials", "--seconds", "rt", "--study", "x"))
        )
    assert str(refused.value).endswith("import-trials --study x")
    assert len(read_trials([path], Layout("shown", "said", "who")).rows) == 2


@pytest.mark.parametrize("cell", ["['cork', 'felt'];0.5", "cork;[0.5, 1.25]", "['cork', 'felt'];[0.5, 1.25]"])
def test_lists_of_several_are_one_kind_of_error_and_its_remedy_leaves_them_out(tmp_path: Path, cell: str) -> None:
    path = _file(tmp_path, [cell, "felt;0.5", cell.replace("0.5", "0.75"), "cork;1.5", "cork;0.6"])
    with pytest.raises(DatasetError) as refused:
        read_trials([path], IN_S, stated=Stated(command=("palpate", "import-trials")))
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    left_out = cells([remedy.command[-1]])
    made = read_trials([path], replace(IN_S, leave_out=left_out))
    assert [one.answered for one in made.rows] == ["felt", "cork", "cork"]
    assert made.left_out == {left_out[0]: 2}


def test_rows_of_a_screen_without_any_answer_are_a_caution(tmp_path: Path) -> None:
    """As Gorilla writes a row for each fixation, and jsPsych for each cross."""
    path = tmp_path / "trials.csv"
    rows = [
        f"1,cross,{one},,\n1,button,{one},{said},0.5\n" for one in ("felt", "cork") for said in ("felt", "", "cork")
    ]
    path.write_text("who,kind,shown,said,rt\n" + "".join(rows), "utf-8")
    made = read_trials([path], IN_S, stated=Stated(command=("palpate", "import-trials")))
    (doubt,) = made.doubts
    assert isinstance(doubt.remedy, Remedy)
    assert (doubt.check, doubt.remedy.command[-2:]) == ("no answer", ("--leave-out", "kind=cross"))
    assert not read_trials([path], replace(IN_S, leave_out=cells(["kind=cross"]))).doubts


@pytest.mark.parametrize(("layout", "late", "code"), [(IN_S, "500", "500"), (IN_MS, "499999", "499999")])
def test_a_single_time_in_which_nobody_answers_is_doubted_and_its_remedy_takes_it_for_missing(
    tmp_path: Path, layout: Layout, late: str, code: str
) -> None:
    path = _file(tmp_path, [f"cork;{late}", *(["felt;1.5"] if layout is IN_S else ["felt;1500"]) * 6])
    (doubt,) = read_trials([path], layout, stated=Stated(command=("palpate", "import-trials"))).doubts
    assert isinstance(doubt.remedy, Remedy)
    assert (doubt.check, doubt.remedy.command[2:]) == ("response times", ("--missing-time", code))
    made = read_trials([path], replace(layout, missing_times=(code,)))
    assert (made.missing_times, made.doubts, len(made.rows)) == (1, (), 7)


def test_a_word_for_a_missing_time_keeps_the_answer(tmp_path: Path) -> None:
    path = _file(tmp_path, ["cork;0.5", "felt;timeout", "cork;0.6", "felt;never"])
    stated = Stated(command=("palpate",))
    with pytest.raises(DatasetError) as refused:
        read_trials([path], replace(IN_S, missing_times=("never",)), (), stated)
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    assert remedy.command[1:] == ("--missing-time", "timeout")
    made = read_trials([path], replace(IN_S, missing_times=("never", "timeout")))
    assert [(one.answered, one.response_time_s) for one in made.rows] == [
        ("cork", 0.5), ("felt", None), ("cork", 0.6), ("felt", None)
    ]  # fmt: skip
