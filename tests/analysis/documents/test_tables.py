"""Tables as text, Markdown and CSV: no line too long, no cell lost."""

from __future__ import annotations

import csv
import io

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents.tables import (
    Section,
    Table,
    cell,
    comma_separated,
    latex,
    markdown,
    p_is,
    probability,
    table_text,
    text,
)

words = st.text("abcdefgh ", min_size=0, max_size=60).map(lambda cell: " ".join(cell.split()))


@st.composite
def tables(draw: st.DrawFn) -> Table:
    columns = draw(st.integers(1, 9))
    row = st.tuples(*[words] * columns)
    header = tuple(draw(st.text("ABCDEFGH", min_size=1, max_size=12)) for _ in range(columns))
    return Table(
        draw(words), header, tuple(draw(st.lists(row, max_size=5))), notes=(draw(words),), matrix=draw(st.booleans())
    )


def test_a_matrix_stays_in_one_piece_where_breaking_its_cells_is_enough() -> None:
    rows = (("felt", "0.787 ± 0.239***", "0.213 ± 0.239"), ("cork", "0.047 ± 0.074", "0.953 ± 0.074***"))
    table = Table("", ("presented", "felt", "cork"), rows, matrix=True)
    assert table_text(table, 33).split("\n") == [
        "presented        felt        cork",
        "---------  ----------  ----------",
        "felt            0.787       0.213",
        "           ± 0.239***     ± 0.239",
        "cork            0.047       0.953",
        "              ± 0.074  ± 0.074***",
    ]
    assert table_text(table, 60).count("\n") == 3
    assert max(map(len, table_text(table, 28).split("\n"))) <= 28


@settings(deadline=None)
@given(tables(), st.integers(90, 140))
def test_no_line_is_wider_than_asked(table: Table, width: int) -> None:
    assert all(len(line) <= width for line in table_text(table, width).split("\n"))


@settings(deadline=None)
@given(tables())
def test_no_letter_of_a_cell_is_lost(table: Table) -> None:
    shown = table_text(table, 100)
    for letter in "abcdefgh":
        cells = "".join(cell for row in table.rows for cell in row) + table.title + "".join(table.notes)
        assert shown.count(letter) >= cells.count(letter)


def test_columns_that_do_not_fit_stand_below_under_the_first_again() -> None:
    table = Table("", ("presented", *"ABCDEF"), (("sand", *["x" * 30] * 6),))
    lines = table_text(table, 100).split("\n")
    assert [line.split()[0] for line in lines if line and not line.startswith("-")] == ["presented", "sand"] * 3


def test_rows_that_take_two_names_have_both_in_every_part() -> None:
    header = ("way", "N", "a column of some width", "another of some width")
    rows = (("prepared", "250", "1", "2"), ("prepared", "2500", "3", "4"))
    lines = table_text(Table("", header, rows), 50).splitlines()
    assert [line.split() for line in lines if line.startswith("prepared")] == [
        ["prepared", "250", "1"],
        ["prepared", "2500", "3"],
        ["prepared", "250", "2"],
        ["prepared", "2500", "4"],
    ]


def test_names_wider_than_half_of_the_width_stand_in_every_part_and_are_wrapped_where_they_leave_no_room(
    approved: SnapshotAssertion,
) -> None:
    of = "aluminum foil, sign flips (ours)"
    rows = (("t against chance", of, "0.685", "24"), ("t against chance", "sand", "0.080", "more than 24"))
    table = Table("", ("test", "of", "power", "n for 0.8"), rows, left=frozenset({0, 1}))
    wide, narrow = (table_text(table, width).splitlines() for width in (65, 54))
    assert [line for line in wide if of in line] == [
        f"t against chance  {of}  0.685",
        f"t against chance  {of}            24",
    ]
    assert [line for line in narrow if "aluminum" in line or "flips" in line] == approved


def test_an_empty_column_is_no_trouble() -> None:
    assert table_text(Table("", ("a", ""), (("x", ""),))) == "a\n-  -\nx"


def test_a_section_shows_its_brief_tables_in_a_terminal() -> None:
    section = Section("s", "Title", ("A sentence.",), (Table("long", ("a",), ()),), brief=(Table("short", ("b",), ()),))
    assert text(section).startswith("Title\n=====\n\nA sentence.\n\nshort")
    assert text(section, full=True).endswith("long\na\n-")
    assert "### long" in markdown(section, "")


def test_what_is_said_aside_stands_below_the_tables_and_in_a_terminal_that_shows_all() -> None:
    section = Section("s", "Title", (), (Table("t", ("a",), (("1",),), standing="ours"),), aside=("Formula.",))
    assert text(section) == "Title\n=====\n\nt [ours]\na\n-\n1"
    assert text(section, full=True) == f"{text(section)}\n\nFormula."
    assert markdown(section, "").endswith("| 1 |\n\nFormula.\n")
    assert r"\caption{t (ours)}" in latex(section, "")


def test_a_matrix_is_broken_before_its_brackets_where_that_keeps_it_together() -> None:
    table = Table("", ("", "ab", "cd"), (("x", "50 (1 to 2)", "60 (3 to 4)"),), matrix=True)
    assert table_text(table, 22).split("\n")[2:] == ["x        50        60", "   (1 to 2)  (3 to 4)"]


def test_markdown_keeps_stars_and_bars() -> None:
    shown = markdown(Section("s", "T", (), (Table("", ("a", "b"), (("x|y", "0.5***"),)),)), "REHEARSAL - x")
    assert shown.startswith("**REHEARSAL - x**\n\n## T")
    assert r"| x\|y | 0.5\*\*\* |" in shown


def test_csv_keeps_every_digit_and_the_label() -> None:
    records = ({"a": 1 / 3, "b": None}, {"a": 5.0244768e-7, "c": 'say "x", y'})
    rows = list(csv.DictReader(io.StringIO(comma_separated(Section("s", "T", further=records), "REHEARSAL - x"))))
    assert [float(row["a"]) for row in rows] == [1 / 3, 5.0244768e-7]
    assert (rows[0]["b"], rows[1]["c"]) == ("", 'say "x", y')
    assert {row["dataset"] for row in rows} == {"REHEARSAL - x"}


@pytest.mark.parametrize(
    ("held", "written"),
    [
        ("=1+1", "'=1+1"),
        ("+cmd|' /C calc'!A0", "'+cmd|' /C calc'!A0"),
        ("-2 mm is too low", "'-2 mm is too low"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("\t=1", "'\t=1"),
        ("\n=1", "'\n=1"),
        ("\uff1d1", "'\uff1d1"),
        *((value, str(value)) for value in ("felt", "a=b", "-1.5", "+3", "-.5e-7", "-3%", -0.5, -3, "")),
    ],
)
def test_a_text_that_a_spreadsheet_would_compute_stands_behind_an_apostrophe(held: object, written: str) -> None:
    content = comma_separated(Section("s", "T", further=({"a": held},)), "=label")
    assert list(csv.reader(io.StringIO(content, newline="")))[1] == ["'=label", written]
    assert cell("\r=1") == "'\r=1"


def test_markdown_holds_no_tag_link_or_second_line_of_a_name() -> None:
    name = "a\n| b <script> [c](d) `e`"
    shown = markdown(Section("s", name, (name,), (Table(name, ("a",), ((name,),), notes=(name,)),)), "")
    wanted = r"a \| b &lt;script&gt; \[c\](d) \`e\`"
    assert shown == f"## {wanted}\n\n{wanted}\n\n### {wanted}\n\n| a |\n|:--|\n| {wanted} |\n\n{wanted}\n"


@pytest.mark.parametrize(
    ("p", "shown"),
    [(None, "-"), (0.346, "0.346"), (0.01, "0.010"), (0.0044446, "0.004"), (9.9e-4, "< 0.001"), (0.0, "< 0.001")],
)
def test_probabilities(p: float | None, shown: str) -> None:
    assert probability(p) == shown
    if p is not None:
        assert p_is(p) == f"P {shown}" if shown.startswith("<") else f"P = {shown}"


def test_a_probability_ends_where_the_digits_of_its_table_do() -> None:
    assert [probability(p, 4) for p in (1 / 24, 1 / 40320)] == ["0.0417", "< 0.0001"]
