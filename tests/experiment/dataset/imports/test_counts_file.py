"""Counts files: read whole, or refused by line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.experiment.dataset.imports.reconstruction import COLUMNS, parse_task, read_counts, study_text
from palpate.experiment.errors import DatasetError

HEADER = ",".join(COLUMNS) + "\n"
MATERIALS = ("sand", "snow")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "line 1: got header ''; allowed: participant,presented,answered,count"),
        ("a,b\n", "line 1: got header 'a,b'"),
        (HEADER, "got no counts below the header; allowed: one line per cell"),
        (HEADER + "1,sand,snow\n", "line 2: got 3 fields; allowed: 4"),
        (HEADER + "1,sand,snow,2\n0,sand,sand,1\n", "line 3: participant: got '0'; allowed: a whole number from 1"),
        (HEADER + "x,sand,snow,2\n", "line 2: participant: got 'x'"),
        (HEADER + "00,sand,snow,2\n", "line 2: participant: got '00'"),
        (
            HEADER + "01,sand,snow,2\n1,snow,snow,3\n",
            "line 3: participant: got '1' here and '01' above; allowed: one",
        ),
        (HEADER + "1,ice,snow,2\n", "line 2: presented: got 'ice'; allowed: sand, snow"),
        (HEADER + "1,(none),snow,2\n", "line 2: presented: got '(none)'"),
        (HEADER + "1,sand,ice,2\n", "line 2: answered: got 'ice'; allowed: sand, snow, (none)"),
        (HEADER + "1,sand,snow,-1\n", "line 2: count: got '-1'; allowed: a whole number from 0"),
        (HEADER + "1,sand,snow,1.5\n", "line 2: count: got '1.5'"),
        (HEADER + '1,sand,snow,"1,000"\n', "line 2: count: got '1,000'"),
        ("participant,presented,sand,snow\n1,sand,3\n", "line 2: got 3 fields; allowed: 4"),
        (HEADER + "1,sand,snow,10001\n", "line 2: count: got '10001'"),
        (HEADER + f"1,sand,snow,{'9' * 5000}\n", "line 2: count: got '999"),
        (
            HEADER + "1,sand,snow,2\n1,sand,snow,2\n",
            "line 3: got participant 1, ('sand', 'snow') twice; remove one",
        ),
        (HEADER + '1,"sand,snow,2\n', "line 2: unexpected end of data"),
    ],
)
def test_a_bad_counts_file_is_refused_by_line(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "counts.csv"
    path.write_text(content)
    with pytest.raises(DatasetError, match=re.escape(message)) as error:
        read_counts(path, MATERIALS)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("name", "got"),
    [
        ("=sand", "'=sand'"),
        ("sa\x85nd", "'sa nd' with U+0085"),
        ("s\x1bnd", "'s<U+001B>nd' with U+001B"),
        ("\u202esand", "'<U+202E>sand' with U+202E"),
    ],
)
def test_a_material_of_a_counts_file_has_a_name_that_can_be_shown(tmp_path: Path, name: str, got: str) -> None:
    path = tmp_path / "counts.csv"
    path.write_text(f"{HEADER}1,{name},{name},2\n1,snow,snow,2\n", encoding="utf-8")
    with pytest.raises(DatasetError, match=re.escape(f"{path}: presented[0]: got {got}; allowed: one line")):
        study_text("lab", {"real": path}, "a paper")


def test_a_source_has_no_hidden_character() -> None:
    with pytest.raises(DatasetError, match=r"--source: source: got 'a<U\+202E>b' with U\+202E"):
        study_text("okamoto2012", {}, "a\u202eb")


@given(st.binary(max_size=200))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_counts_or_one_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "counts.csv"
    path.write_bytes(HEADER.encode() + content)
    error = ""
    try:
        counts = read_counts(path, MATERIALS)
    except DatasetError as refusal:
        error, counts = str(refusal), {}
    assert counts or str(path) in error


@pytest.mark.parametrize(
    "text",
    [
        f"{HEADER}1,sand,sand,8.0\n1,sand,snow,2.00\n1,snow,sand,0.0\n1,snow,snow,10\n",
        f"{HEADER}1,sand,sand,8\n1,sand,snow,2\n1,snow,sand,0\n1,snow,snow,10\n".replace(",", ";").replace(
            ";8", ";8,0"
        ),
        "participant,presented,sand,snow\n1,sand,8,2\n1,snow,0,10\n",
        'participant;presented;sand;snow\n1;sand;"8,0";"2,0"\n1;snow;"0,0";"10,0"\n',
    ],
    ids=["points", "a comma", "a matrix", "a matrix with commas"],
)
def test_matrices_and_whole_numbers_with_decimals_are_counts(tmp_path: Path, text: str) -> None:
    path = tmp_path / "counts.csv"
    path.write_text(text)
    expected = {("sand", "sand"): 8, ("sand", "snow"): 2, ("snow", "sand"): 0, ("snow", "snow"): 10}
    assert read_counts(path, MATERIALS) == {1: expected}
    assert set(study_text("lab", {"real": path}, "made").materials) == set(MATERIALS)


def test_a_missing_counts_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"nowhere\.csv: cannot be read"):
        read_counts(tmp_path / "nowhere.csv", MATERIALS)


def test_a_task_and_its_file_are_read_from_one_word() -> None:
    assert parse_task("virtual=a=b.csv") == ("virtual", Path("a=b.csv"))


@pytest.mark.parametrize("text", ["", "virtual", "virtual=", "=a.csv", "Task 1=a.csv"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(DatasetError, match="allowed: TASK=FILE"):
        parse_task(text)
