"""Files of trials with more or less than one header: Qualtrics, joined files, E-Prime's log; progress in reading."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from palpate.experiment.dataset.imports.imported import import_trials
from palpate.experiment.dataset.imports.layout import Layout, cells
from palpate.experiment.dataset.imports.trial_files import read_trials
from palpate.experiment.errors import DatasetError, Remedy
from palpate.experiment.settings.delimited import Stated

LAYOUT = Layout("shown", "said", "who", time_ms="rt")
HEAD = "who,shown,said,rt\n"
TRIALS = [
    ("1", "cork", "felt", 410),
    ("1", "felt", "felt", 420),
    ("2", "cork", "cork", 430),
    ("2", "felt", "cork", 440),
]


def _rows(who: str = "12") -> str:
    return "".join(f"{one},{a},{b},{t}\n" for one, a, b, t in TRIALS if one in who)


def _read(tmp_path: Path, text: str, encoding: str = "utf-8") -> list[tuple[str, str, str, int]]:
    path = tmp_path / "trials.txt"
    path.write_bytes(text.encode(encoding))
    found = read_trials([path], LAYOUT)
    assert found.materials == ("cork", "felt")
    return [
        (row.participant, row.presented, row.answered, round((row.response_time_s or 0) * 1000)) for row in found.rows
    ]


@pytest.mark.parametrize("question", ["who,shown,What was it?,rt\n", ""], ids=["three rows", "two rows"])
def test_rows_below_the_names_of_qualtrics_are_no_trials(tmp_path: Path, question: str) -> None:
    codes = ",".join('"{""ImportId"":""QID' + one + '""}"' for one in "1234")
    assert _read(tmp_path, f"{HEAD}{question}{codes}\n{_rows()}") == TRIALS
    (read_as,) = read_trials([tmp_path / "trials.txt"], LAYOUT).read_as
    assert (len(read_as.heading_lines), read_as.rows) == (3 if question else 2, 4)


def test_files_that_were_joined_have_their_header_again(tmp_path: Path) -> None:
    assert _read(tmp_path, f"{HEAD}{_rows('1')}{HEAD}{_rows('2')}") == TRIALS
    (read_as,) = read_trials([tmp_path / "trials.txt"], LAYOUT).read_as
    assert (read_as.heading_lines, read_as.rows) == ((1, 4), 4)


@pytest.mark.parametrize("head", [HEAD, ""], ids=["with its heading", "rows alone"])
@pytest.mark.parametrize("layout", [LAYOUT, Layout("shown", "said", "who")], ids=["times", "a column of trials"])
def test_trials_that_were_exported_twice_are_refused_with_what_takes_them_once(
    tmp_path: Path, layout: Layout, head: str
) -> None:
    names, again = HEAD.replace(",rt", ",rt,trial"), head.replace(",rt", ",rt,trial")
    rows = "".join(f"1,{'cork' if k % 3 else 'felt'},cork,{400 + k % 7},{k}\n" for k in range(30))
    path = tmp_path / "twice.csv"
    path.write_text(f"{names}{rows}{again}{rows}")
    with pytest.raises(DatasetError) as refused:
        read_trials([path], layout, (), Stated(command=("palpate",)))
    finding = refused.value.finding
    assert isinstance(finding.remedy, Remedy)
    assert finding.line == 32 + bool(head)
    once = read_trials([path], replace(layout, leave_out=cells([finding.remedy.command[-1]])))
    assert [row.line for row in once.rows] == list(range(2, 32))
    assert sum(once.left_out.values()) == 30


@pytest.mark.parametrize("block", ["", "block"])
def test_numbers_of_trials_that_occur_again_are_asked_about_unless_a_block_parts_them(
    tmp_path: Path, block: str
) -> None:
    rows = "".join(
        f"1,{'cork' if k % 3 else 'felt'},cork,{400 + k},{k % 10},{k // 10 if block else 0}\n" for k in range(20)
    )
    path = tmp_path / "blocks.csv"
    path.write_text(f"{HEAD.strip()},Trial Number,{block or 'trial_duration'}\n{rows}")
    doubts = read_trials([path], LAYOUT, (), Stated(command=("palpate",))).doubts
    assert [one.check for one in doubts] == ([] if block else ["numbers"])


def test_a_second_header_in_another_order_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as refused:
        _read(tmp_path, f"{HEAD}{_rows('1')}who,said,shown,rt\n{_rows('2')}")
    assert refused.value.finding.line == 4


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8"])
def test_the_frames_of_a_log_of_eprime_are_trials(tmp_path: Path, encoding: str) -> None:
    frames = "".join(
        f"\tLevel: 3\r\n\t*** LogFrame Start ***\r\n\tshown: {a}\r\n\tsaid: {b}\r\n\trt: {t}\r\n\tClock: 10:00:01\r\n"
        "\t*** LogFrame End ***\r\n"
        for one, a, b, t in TRIALS
        if one == "1"
    )
    head = "*** Header Start ***\r\nwho: 1\r\nSession: 1\r\n*** Header End ***\r\n"
    block = "Level: 2\r\n*** LogFrame Start ***\r\nList: 1\r\n*** LogFrame End ***\r\n"
    assert _read(tmp_path, f"{head}{frames}{block}", encoding) == TRIALS[:2]


def test_times_of_a_log_of_presentation_are_tenths_of_a_millisecond(tmp_path: Path) -> None:
    path = tmp_path / "sub1.log"
    rows = "".join(f"{a}\t{b}\t{t}0\n" for one, a, b, t in TRIALS if one == "1")
    path.write_text(f"Scenario - touch\nLogfile written - 11/29/2026 10:00:00\n\nshown\tsaid\trt\n\n{rows}")
    found = read_trials([path], Layout("shown", "said", None, in_name="sub{}.log", time_ms="rt"))
    assert [row.response_time_s for row in found.rows] == pytest.approx([0.41, 0.42])
    assert [doubt.check for doubt in found.doubts] == ["tenths"]


def test_further_trials_in_a_row_are_told(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    path.write_text("who,t1_shown,t1_said,t2_shown,t2_said\n1,cork,felt,felt,cork\n2,felt,felt,cork,cork\n")
    found = read_trials([path], Layout("t1_shown", "t1_said", "who"))
    assert [doubt.check for doubt in found.doubts] == ["wide"]


def test_progress_is_told_within_one_file_too(tmp_path: Path) -> None:
    path, shares = tmp_path / "trials.csv", list[float]()
    path.write_text(HEAD + "".join(f"{k % 300},{'cork' if k % 2 else 'felt'},cork,{400 + k}\n" for k in range(6000)))
    import_trials([path], tmp_path / "out", LAYOUT, study="lab", source="made", done=shares.append)
    assert shares == sorted(shares)
    assert len(shares) > 100
    assert (shares[0] < 0.2, shares[-1]) == (True, 1.0)
