"""The reader of delimited text: encodings, delimiters, decimal signs, and tables with a header."""

from __future__ import annotations

from math import isnan
from pathlib import Path

import pytest

from palpate.experiment.errors import PalpateError, Remedy
from palpate.experiment.settings.delimited import (
    Stated,
    decimal_sign,
    decoded,
    delimiter_of,
    number,
    read_table,
    records,
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_every_unicode_is_read_with_and_without_its_mark(encoding: str) -> None:
    assert decoded("who;said\n1;Löschpapier\n".encode(encoding), "x.csv")[0] == "who;said\n1;Löschpapier\n"


def test_a_code_page_is_refused_by_name_and_read_where_it_is_stated() -> None:
    data = "who;said\n1;Löschpapier\n".encode("cp1252")
    with pytest.raises(PalpateError) as refused:
        decoded(data, "x.csv", Stated(command=("palpate", "audit", "x.csv")))
    remedy = refused.value.finding.remedy
    assert refused.value.finding.line == 2
    assert isinstance(remedy, Remedy)
    assert remedy.command == ("palpate", "audit", "x.csv", "--encoding", "cp1252")
    assert decoded(data, "x.csv", Stated(encoding="cp1252"))[0].endswith("Löschpapier\n")


@pytest.mark.parametrize("encoding", ["latin-99", "ascii"])
def test_an_encoding_that_does_not_fit_is_refused(encoding: str) -> None:
    with pytest.raises(PalpateError):
        decoded("Löschpapier".encode(), "x.csv", Stated(encoding=encoding))


@pytest.mark.parametrize(
    ("cell", "decimal", "value"),
    [
        (".512", ".", 0.512),
        (",512", ",", 0.512),
        ("1.234,5", ",", 1234.5),
        ("1,234.5", ".", 1234.5),
        ("1\u202f234\u202f567,5", ",", 1_234_567.5),
        ("\u22121,5E+03", ",", -1500.0),
        ("1.5D-3", ".", 0.0015),
    ],
)
def test_numbers_as_programs_write_them(cell: str, decimal: str, value: float) -> None:
    assert number(cell, decimal) == value


@pytest.mark.parametrize(
    ("cell", "decimal"),
    [
        ("1,5", "."),
        ("1.5", ","),
        ("1_000", "."),
        ("nan", "."),
        ("", "."),
        ("1,23,456", "."),
        (".", "."),
        ("1,345,6", "."),
    ],
)
def test_what_is_no_number(cell: str, decimal: str) -> None:
    assert isnan(number(cell, decimal))


@pytest.mark.parametrize(
    ("cells", "delimiter", "sign"),
    [
        (["1", "2"], ",", ""),
        (["1,234", "0,5"], ";", ","),
        (["1.234", "2,345.5"], ";", "."),
        (["1.234", "5.678"], "\t", "."),
        (["1.234", "5.678"], ";", None),
        (["1,234", "5,678"], "\t", None),
        (["0.959", "0.512"], ";", "."),
        (["0.959", "2,385", "0.512"], ";", None),
        (["0,959", "2.385", "0,512"], ";", None),
        (["0.959", "2,385", "12,385.5"], ";", "."),
        (["0,959", "2.385", "1.234.567"], ";", ","),
    ],
)
def test_the_decimal_sign_is_that_of_many_cells_or_asked_for(cells: list[str], delimiter: str, sign: str) -> None:
    assert decimal_sign(cells, delimiter) == sign


def test_in_a_printed_table_three_digits_behind_the_other_sign_are_thousands() -> None:
    assert decimal_sign(["0.959", "2,385"], ";", printed=True) == "."


def test_a_comment_sign_counts_at_the_beginning_of_a_line_only() -> None:
    text = '# made in May\nch#1;duty %;F//N\n"1\n#2";3;4\n'
    assert [(one.line, one.cells) for one in records(text, ";") if not one.comment] == [
        (2, ["ch#1", "duty %", "F//N"]),
        (3, ["1\n#2", "3", "4"]),
    ]


def test_semicolons_part_cells_with_decimal_commas() -> None:
    assert delimiter_of("a;b;c\n1,5;2,5;3\n4;5,5;6,5\n") == ";"


def test_a_table_is_found_below_what_stands_above_it(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("Export of May\n\nwho;rt\n1;0,512\n2;,75\n", "utf-8")
    table = read_table(path, ["who", "rt"], ["rt"])
    assert table.understood.as_dict() == {
        "encoding": "UTF-8", "delimiter": ";", "decimal": ",", "heading_lines": [3], "names": ["who", "rt"],
        "units": [], "repeated": [], "first_line": 4, "rows": 2, "section": None,
    }  # fmt: skip
    assert [table.number(row.cells[1]) for row in table.rows] == [0.512, 0.75]


def test_an_unclear_decimal_sign_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("who;rt\n1;1,512\n2;1,750\n", "utf-8")
    with pytest.raises(PalpateError) as refused:
        read_table(path, ["who", "rt"], ["rt"])
    assert "--decimal" in str(refused.value.finding.remedy)
    table = read_table(path, ["who", "rt"], ["rt"], Stated(decimal=","))
    assert [table.number(row.cells[1]) for row in table.rows] == [1.512, 1.75]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_files_that_were_joined_keep_no_mark(encoding: str, end: str) -> None:
    """`cat a.csv b.csv` leaves the mark of the second within the text; elsewhere that sign is a letter."""
    part = f"t;a{end}0;\ufeffx{end}"
    assert decoded(part.encode(encoding) * 2, "joined.csv")[0] == part * 2
