"""Files as PsychoPy, jsPsych, OpenSesame and Gorilla write them; what is no trial; and errors with line and column.

The files are transcribed from what the documentation of each program shows, cut to the columns that matter.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.experiment.dataset.imports.layout import ABSENT, Layout, pairs
from palpate.experiment.dataset.imports.trial_files import Row, read_trials
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER

PLAIN = Layout("shown", "said", "who")

PSYCHOPY = (
    "\ufeffmaterial,trials.thisN,key_resp.keys,key_resp.rt,participant,session,\r\n"
    ",,,,07,001,\r\n"
    "cork,0,2,0.5125,07,001,\r\n"
    "felt,1,None,,07,001,\r\n"
)
JSPSYCH = (
    '"rt","stimulus","response","trial_type","subject","material"\n'
    '"812","<p>Welcome,\nplease ""read""</p>","null","html-keyboard-response","a1","instructions"\n'
    '"512.5","<p>?</p>","1","html-button-response","a1","cork"\n'
    '"null","<p>?</p>","null","html-button-response","a1","felt"\n'
)
OPENSESAME = '"response","response_time","subject_nr","material"\n"2","512.5","7","cork"\n"None","3000","7","felt"\n'
GORILLA = (
    "Participant Public ID,Zone Type,Reaction Time,Response,material\n"
    "BEGIN,,,,\n"
    "x7y,fixation,250,,cork\n"
    "x7y,response_button_text,512.5,Cork,cork\n"
    "x7y,response_button_text,,,felt\n"
    "END OF FILE\n"
)
KEYS = {"1": "felt", "2": "cork"}


def _file(tmp_path: Path, text: str, name: str = "trials.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, "utf-8", newline="")
    return path


@pytest.mark.parametrize(
    ("text", "layout", "lines", "passed_over", "time_s"),
    [
        (
            PSYCHOPY,
            Layout("material", "key_resp.keys", "participant", time_s="key_resp.rt", answers=KEYS),
            (3, 4),
            1,
            (0.5125, None),
        ),
        (
            JSPSYCH,
            Layout(
                "material", "response", "subject", time_ms="rt", answers={"0": "felt", "1": "cork"},
                where={"trial_type": "html-button-response"},
            ),
            (4, 5),
            1,
            (0.5125, None),
        ),
        (
            OPENSESAME,
            Layout("material", "response", "subject_nr", time_ms="response_time", answers=KEYS),
            (2, 3),
            0,
            (0.5125, 3.0),
        ),
        (
            GORILLA,
            Layout(
                "material", "Response", "Participant Public ID", time_ms="Reaction Time", answers={"Cork": "cork"},
                where={"Zone Type": "response_button_text"},
            ),
            (4, 5),
            3,
            (0.5125, None),
        ),
    ],
    ids=["PsychoPy", "jsPsych", "OpenSesame", "Gorilla"],
)  # fmt: skip
def test_files_of_each_program(
    tmp_path: Path,
    text: str,
    layout: Layout,
    lines: tuple[int, int],
    passed_over: int,
    time_s: tuple[float, float | None],
) -> None:
    found = read_trials([_file(tmp_path, text)], layout)
    assert [(row.line, row.presented, row.answered, row.response_time_s) for row in found.rows] == [
        (lines[0], "cork", "cork", time_s[0]),
        (lines[1], "felt", NO_ANSWER, time_s[1]),
    ]
    assert (found.materials, len(found.passed_over)) == (("cork", "felt"), passed_over)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_what_a_spreadsheet_puts_between_cells(tmp_path: Path, delimiter: str) -> None:
    text = "who,shown,said\n1,felt,cork\n1,cork,cork\n".replace(",", delimiter)
    assert [row.answered for row in read_trials([_file(tmp_path, text)], PLAIN).rows] == ["cork", "cork"]


def test_materials_in_the_order_given_and_one_that_is_never_presented(tmp_path: Path) -> None:
    path = _file(tmp_path, "who,shown,said\n1,felt,sand\n1,cork,cork\n")
    assert read_trials([path], PLAIN, ("sand", "felt", "cork")).materials == ("sand", "felt", "cork")
    with pytest.raises(DatasetError, match=r"line 2: column said: got 'sand'; allowed: cork, felt, \(none\); map it"):
        read_trials([path], PLAIN)


def test_a_code_of_the_material_presented(tmp_path: Path) -> None:
    path = _file(tmp_path, "who,shown,said\n1,f.wav,felt\n1,c.wav,felt\n")
    layout = replace(PLAIN, materials={"f.wav": "felt", "c.wav": "cork"})
    assert [row.presented for row in read_trials([path], layout).rows] == ["felt", "cork"]


@pytest.mark.parametrize(
    ("text", "change", "told"),
    [
        ("who,shown,answer\n", {}, r"line 1: column said: got no such column; allowed: one of who, shown, answer"),
        ("who,said,shown,said\n", {}, r"line 1: column said: got 2 such columns"),
        ("who,shown,said_1,said_2\n", {}, r"column said: got no such column; .*pivot_longer"),
        ("", {}, r"got an empty file; allowed: a header, and one row per trial; give another file"),
        (
            "who,shown,said\n1,felt,felt\n",
            {"answered": "shown"},
            r"got the column shown, as for --presented; allowed: another",
        ),
        ("who,shown,said\n1,felt,f\n1,cork,cork\n", {}, r"line 2: column said: got 'f'; .*: --map f=MATERIAL"),
        ("who,shown,said\n,felt,felt\n", {}, r"line 2: column who: got ''; allowed: who took part"),
        ("who,shown,said\n1,,\n\n", {}, r"has no trials: shown is empty in every selected row"),
        ("who,shown,said\n1,felt,felt\n", {}, r"column shown: got 1 different materials \(felt\); allowed: 2 to 64"),
        ("who,shown,said\n1,felt,felt\n1,Felt,felt\n", {}, r"'Felt' and 'felt', which look the same"),
        ('who,shown,said\n"1\n2",felt,felt\n1,felt\n', {}, r"line 4: got 2 cells for 3 columns"),
        ("who,shown,said\n1,felt,felt,x\n", {}, r"line 2: got 4 cells for 3 columns"),
        ('who,shown,said\n1,"fe"lt,felt\n', {}, r"line 2: .*; write plain CSV"),
        ("who,shown,said,n\n1,felt,felt,2.5\n", {"trial": "n"}, r"line 2: column n: got '2.5'; allowed: a whole"),
        (
            "who,shown,said,n\n1,felt,felt,2\n2,felt,felt,2\n1,cork,felt,2.0\n",
            {"trial": "n"},
            r"line 4: column n: got trial 2 of participant '1' again, after .*, line 2",
        ),
        ("who,shown,said,rt\n1,felt,felt,-1\n", {"time_s": "rt"}, r"line 2: column rt: got '-1'; allowed: a number"),
        ("who,shown,said,rt\n1,felt,felt,inf\n", {"time_ms": "rt"}, r"line 2: column rt: got 'inf'"),
        ("who,shown,said,t\n1,felt,felt,\n", {"task": "t"}, r"line 2: column t: got ''; allowed: which task"),
        (
            "who,shown,said\n1,x,felt\n",
            {"materials": {"f": "felt"}},
            r"line 2: column shown: got 'x'; allowed: f, felt",
        ),
    ],
)
def test_an_error_names_line_and_column(tmp_path: Path, text: str, change: dict[str, Any], told: str) -> None:
    path = _file(tmp_path, text)
    with pytest.raises(DatasetError, match=told) as caught:
        read_trials([path], replace(PLAIN, **change))
    assert ("--answered" if change == {"answered": "shown"} else str(path)) in str(caught.value)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(
        DatasetError, match=r"none.csv: cannot be read \(No such file or directory\); allowed: a text file"
    ):
        read_trials([tmp_path / "none.csv"], PLAIN)
    (tmp_path / "old.csv").write_bytes("who,shown,said\n1,Löschpapier,Filz\n".encode("cp1252"))
    with pytest.raises(DatasetError) as refused:
        read_trials([tmp_path / "old.csv"], PLAIN)
    assert refused.value.finding.line == 2
    assert "--encoding cp1252" in str(refused.value.finding.remedy)


def test_pairs_of_an_option() -> None:
    assert pairs("--map", ["f=felt", '{"Q0":"a=b"} = cork']) == {"f": "felt", '{"Q0":"a=b"}': "cork"}
    for bad in ("felt", "f="):
        with pytest.raises(DatasetError, match=re.escape(f"--map: got '{bad}'; allowed: LEFT=RIGHT")):
            pairs("--map", [bad])
    with pytest.raises(DatasetError, match="a second time"):
        pairs("--map", ["f=felt", "f=cork"])


NOISE = st.text(st.sampled_from('ab,"\n;\t <>'), max_size=8)
TRIAL = st.tuples(st.sampled_from(["felt", "cork"]), st.sampled_from(["felt", "cork", *ABSENT]), st.integers(1, 9))
ROWS = st.lists(st.tuples(st.one_of(st.none(), TRIAL), NOISE), max_size=12)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ROWS, st.sampled_from([",", ";", "\t"]), st.sampled_from(["\n", "\r\n"]), st.booleans())
def test_every_trial_is_read_and_placed_whatever_stands_in_other_columns(
    tmp_path: Path, rows: list[tuple[tuple[str, str, int] | None, str]], delimiter: str, end: str, mark: bool
) -> None:
    """The writer is that of Python; lines are counted here by the line ends that it has written."""
    file = io.StringIO()
    writer = csv.writer(file, delimiter=delimiter, lineterminator=end)
    writer.writerow(["who", "html", "shown", "said"])
    expected = []
    for trial, noise in [*rows, (("felt", "felt", 1), ""), (("cork", "felt", 1), "")]:
        line = file.getvalue().count("\n") + 1
        if trial is None:
            writer.writerow(["", noise, "", ""])
        else:
            shown, said, who = trial
            writer.writerow([who, noise, shown, said])
            answer = NO_ANSWER if said in ABSENT else said
            expected.append(Row(1, line, str(who), "", None, shown, answer, None))
    path = _file(tmp_path, "\ufeff" * mark + file.getvalue())
    assert read_trials([path], PLAIN).rows == tuple(expected)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text(st.sampled_from('who,said"\n\r;\t1felt \ufeff\0'), max_size=80))
def test_any_text_is_read_or_refused_by_name(tmp_path: Path, text: str) -> None:
    path = _file(tmp_path, f"who,shown,said\n{text}")
    try:
        assert read_trials([path], PLAIN).rows
    except DatasetError as error:
        assert str(path) in str(error)  # noqa: PT017
