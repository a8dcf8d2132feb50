"""The printed numbers against the reference files, typed from the paper by others."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from palpate.analysis.published import load, read, shipped
from palpate.analysis.published.numbers import Published
from palpate.analysis.published.printed import Printed
from palpate.experiment.errors import PublishedError
from tests.approved import Refuses


@pytest.fixture(scope="module")
def printed() -> Published:
    found = load("okamoto2012")
    assert found is not None
    return found


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(("number", "task"), [(1, "virtual"), (2, "real")])
def test_tables_1_and_2_are_those_of_the_reference(reference: Path, printed: Published, number: int, task: str) -> None:
    expected = [
        (row["presented"], row["answered"], row["mean"], row["sd"], row["stars"])
        for row in _rows(reference / f"okamoto2012_table{number}.csv")
    ]
    got = [
        (cell.presented, cell.answered, cell.mean.text, cell.sd.text if cell.sd else "", cell.stars)
        for cell in printed.tables()
        if cell.where == f"Table {number}"
    ]
    assert got == expected
    assert {cell.task for cell in printed.cells if cell.where == f"Table {number}"} == {task}


def test_tests_are_those_of_the_reference(reference: Path, printed: Published) -> None:
    rows = _rows(reference / "okamoto2012_statistics.csv")
    assert [(t.task, t.material, str(t.df), t.t.text, t.p.text if t.p else "") for t in printed.tests] == [
        (row["task"], row["subject"], row["df"], row["printed_value"], row["printed_p"])
        for row in rows
        if row["test"] == "t against 0.25"
    ]
    others = {row["test"]: (row["df"], row["printed_value"], row["printed_p"]) for row in rows}
    for name, line in (("one-way ANOVA", printed.one_way[0]), ("two-way ANOVA", printed.two_way[0])):
        assert others[name] == (f"{line.df[0]},{line.df[1]}", line.f.text, line.p.text)
    assert others["ICC"] == ("", printed.icc[0].value.text, "")


def test_what_the_text_repeats_is_what_the_tables_say(printed: Published) -> None:
    tables = {(cell.task, cell.presented, cell.answered): cell for cell in printed.tables()}
    for cell in printed.cells:
        source = tables[cell.task, cell.presented, cell.answered]
        assert cell.mean.value == source.mean.value
        assert cell.sd is None or source.sd is None or cell.sd.value == source.sd.value


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [("0.047", 0.047, 0.001), ("0.20", 0.2, 0.01), ("5.02e-7", 5.02e-7, 1e-9), ("15%", 0.15, 0.01), ("0", 0.0, 0.0)],
)
def test_precision_is_read_from_the_digits(text: str, value: float, unit: float) -> None:
    assert Printed(text).value == pytest.approx(value, rel=1e-12)
    assert Printed(text).unit == pytest.approx(unit, rel=1e-12)


@pytest.mark.parametrize("study", ["nothing", "../okamoto2012", ""])
def test_an_unpublished_study_has_no_printed_numbers(study: str) -> None:
    assert load(study) is None


def test_a_cell_stands_once_in_its_table(tmp_path: Path, refuses: Refuses) -> None:
    text = shipped()["wellman1995"].read_text("utf-8")
    cell = '  { pair = ["2", "1"], correct = "43%" },\n'
    (tmp_path / "printed.toml").write_text(text.replace(cell, cell * 3, 1), "utf-8")
    with refuses(PublishedError):
        read(tmp_path / "printed.toml")
