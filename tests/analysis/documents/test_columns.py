"""Columns: one record, and what print, CSV and a short table make of its values."""

import csv
import io

import pytest

from palpate.analysis.documents.tables import Column, Record, Section, comma_separated, ends, probability, tabulate
from palpate.analysis.statistics.inference import ConfidenceInterval

COLUMNS = (
    Column("task", left=True),
    Column("mean", "mean ratio", decimals=2),
    Column(("share_low", "share_high"), "95 % CI"),
    Column(("right", "trials"), "right", show=lambda right, trials: f"{right} of {trials}", brief=False),
    Column("p", "P", show=probability),
    Column("speed", "speed (mm/s)"),
)
RECORD: Record = {
    "task": "real", "mean": 0.5, "share_low": 0.25, "share_high": 0.75, "right": 2, "trials": 4, "p": 0.0004,
    "speed": 50, "statement": None,
}  # fmt: skip


def test_a_cell_is_made_of_the_values_under_the_keys_of_its_column() -> None:
    table = tabulate("Ratios", COLUMNS, [RECORD], ["A note."], standing="ours", marked=frozenset({(0, 1)}))
    assert table.header == ("task", "mean ratio", "95 % CI", "right", "P", "speed (mm/s)")
    assert table.rows == (("real", "0.50", "0.250 to 0.750", "2 of 4", "< 0.001", "50"),)
    assert (table.left, table.notes, table.heading) == (frozenset({0}), ("A note.",), "Ratios [ours]")
    assert (table.marked, table.records) == (frozenset({(0, 1)}), (RECORD,))


def test_a_short_table_has_its_columns_in_order_and_flush_left_as_the_whole_one() -> None:
    columns = (Column("n", brief=False), *COLUMNS)
    record = {"n": 3, **RECORD}
    table = tabulate("", columns, [record], brief=True)
    assert table.header == ("task", "mean ratio", "95 % CI", "P", "speed (mm/s)")
    assert table.left == {0}
    assert tabulate("", columns, [record]).left == {1}


def test_what_is_not_defined_is_a_dash_and_what_does_not_apply_an_empty_cell() -> None:
    undefined: Record = {**dict.fromkeys(RECORD), "right": 0, "trials": 0}
    rows = tabulate("", COLUMNS, [undefined, {"task": "real"}]).rows
    assert rows == (("-", "-", "-", "0 of 0", "-", "-"), ("real", "", "", "", "", ""))


def test_a_column_without_any_value_is_left_out_but_not_from_a_table_without_rows() -> None:
    assert tabulate("", COLUMNS, [{"task": "real", "mean": None}]).header == ("task", "mean ratio")
    assert len(tabulate("", COLUMNS, []).header) == len(COLUMNS)


@pytest.mark.parametrize("name", ["", "share_"])
def test_an_interval_is_two_columns_of_a_csv_file_and_one_cell_in_print(name: str) -> None:
    keys = (f"{name}low", f"{name}high")
    records: list[Record] = [{"task": "real", **ends(one, name)} for one in (ConfidenceInterval(0.1, 0.9, 0.95), None)]
    table = tabulate("", [Column("task"), Column(keys, "95 % CI", decimals=1)], records)
    assert [row[1] for row in table.rows] == ["0.1 to 0.9", "-"]
    rows = list(csv.reader(io.StringIO(comma_separated(Section("s", "Title", tables=(table,)), "x"))))
    assert rows == [["dataset", "task", *keys], ["x", "real", "0.1", "0.9"], ["x", "real", "", ""]]


def test_names_are_joined_in_a_csv_file() -> None:
    section = Section("s", "T", further=({"tasks": ("virtual", "real")},))
    assert comma_separated(section, "x").splitlines()[1] == "x,virtual and real"


def test_a_section_has_the_records_of_its_tables_and_then_its_further_ones() -> None:
    tables = tuple(tabulate("", COLUMNS[:1], [{"task": task, "also": 1}]) for task in ("virtual", "real"))
    records = Section("s", "T", tables=tables, further=({"x": 1},)).records
    assert [record.get("task") for record in records] == ["virtual", "real", None]
