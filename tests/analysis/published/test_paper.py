"""Tables of papers, as browsers save pages and spreadsheets save CSV."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit.audit import audit
from palpate.analysis.published import paper
from palpate.analysis.published.paper import Stated
from palpate.experiment.errors import PublishedError
from palpate.experiment.settings import delimited
from tests.approved import anywhere


def _told(tmp_path: Path, text: str, name: str) -> str:
    """Why a file is refused, or nothing where it is read."""
    try:
        _read(tmp_path, text, Stated((3,), 4), name)
    except PublishedError as error:
        return str(error)
    return ""


PAGE = """<!DOCTYPE html><html><head><style>td { color: red }</style></head><body><h1>Results</h1>
<table><caption>Table 1. Answer ratios</caption><thead><tr><th></th><th colspan="3">Answered</th></tr>
<tr><th>Presented</th><th>glass</th><th>sand</th><th>snow</th></tr></thead>
<tr><td>glass</td><td>0.70 &plusmn; 0.10***</td><td>.20 (.10)</td><td>0.10&nbsp;&#177;&nbsp;0.05</td></tr>
<tr><td>sand<td>0.20<td>0.50<td>0.30<tr><td>snow<td>0.1<td>0.2<td>0.7</table>
<table><caption>Table 2</caption><tr><th>Source</th><th>SS</th><th><i>df</i></th><th>MS</th><th>F</th><th>p</th></tr>
<tr><td>group<td>20.0<td>2<td>10.0<td>5.00<td>0.026</tr><tr><td>Error<td>24.0<td>12<td>2.4<td><td></tr>
<tr><td>Total<td>44<td>14</table>
<table><tr><th>material<th>t<th>df<th>p</tr><tr><td>a<td>2.05<td>27<td>&lt; .05
<tr><td>b<td>\u22128.71<td>14<td>5.02 \u00d7 10<sup>\u22127</sup></table>
<table><tr><td>weight<td>age<tr><td>70<td>24</table></body></html>"""


def _read(tmp_path: Path, text: str, stated: Stated, name: str = "paper.html") -> paper.Paper:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return paper.read(file, stated)


def test_the_tables_of_a_page(tmp_path: Path, approved: SnapshotAssertion) -> None:
    found = _read(tmp_path, PAGE, Stated((15,), 10))
    (table,) = found.printed.table
    assert (table.where, table.complete, len(table.cells)) == ("Table 1. Answer ratios", True, 9)
    first, second, third, *_ = table.cells
    assert [(one.mean.text, one.sd and one.sd.text) for one in (first, second, third)] == [
        ("0.70", "0.10"),
        (".20", ".10"),
        ("0.10", "0.05"),
    ]
    (sources,) = found.printed.anova
    assert [(line.name, line.df) for line in sources.lines] == [("group", 2), ("Error", 12)]
    (tests,) = found.printed.t
    assert [(one.of, one.df, one.t.text, one.p and one.p.text) for one in tests.tests] == [
        ("a", 27, "2.05", "<.05"),
        ("b", 14, "-8.71", "5.02e-7"),
    ]
    assert found.passed_over == approved


def test_an_audit_of_a_page_finds_what_stands_in_it(tmp_path: Path) -> None:
    """24 / 12 is 2, not 2.4, and 10 / 2.4 is 4.2 (by hand)."""
    file = tmp_path / "paper.html"
    file.write_text(PAGE, encoding="utf-8")
    lines = audit(str(file), stated=Stated((15,), 10)).comparison.lines
    assert {(line.subject, line.quantity) for line in lines if line.verdict == "differs"} == {
        ("Error", "MS"),
        ("group", "F"),
    }


@pytest.mark.parametrize(("t", "verdict"), [("7.75", "agrees"), ("5.77", "differs")])
def test_t_of_a_material_is_held_against_its_mean(
    tmp_path: Path, t: str, verdict: str, approved: SnapshotAssertion
) -> None:
    """(0.7 - 0.5) / (0.1 / sqrt(15)) is 7.746, and the digits of the mean and the SD leave 5.6 no room (by hand)."""
    rows = ["Table 1", ",a,b", "a,0.700 (0.100),0.300 (0.100)", "b,0.100 (0.050),0.900 (0.050)", ""]
    file = tmp_path / "p.csv"
    file.write_text("\n".join([*rows, "name,t,df", f"a,{t},14", "c,2.00,14", ""]), encoding="utf-8")
    found = paper.read(file, Stated((15,), None, "1/2"))
    assert [(one.task, one.material, str(one.null)) for one in found.printed.tests] == [
        ("task 1", "a", "1/2"),
        ("14 df", "c", "0"),
    ]
    lines = audit(str(file), stated=Stated((15,), None, "1/2")).comparison.lines
    assert [one.verdict for one in lines if one.quantity.startswith("t") and one.subject == "a"] == [verdict]
    assert found.passed_over == ()
    (said,) = paper.read(file, Stated((15,))).passed_over
    assert said == approved


def test_cells_that_cannot_be_read_are_told(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """An O for a 0 and an l for a 1, as a scanned page has them; an empty cell and a dash print nothing."""
    file = tmp_path / "p.csv"
    file.write_text(
        "Table 1\n,a,b,other\na,0.7O (0.10),0.30 (0.10),0.00\nb,\u2013,0.9l,\nsum,1,1,1\n\n"
        "name,t,df,p\na,4.2l,14,0.001\nb,3.0,13.6,n.s.\nc,2.0,14,\n\n"
        "source,SS,df,MS,F,P\ngroup,24,2,12,6.0,0.0l\nError,2.x,12,2.0,,\nTotal,26,14,,,\n",
        "utf-8",
    )
    found = paper.read(file, Stated((15,)))
    assert found.passed_over == approved
    assert found.unread == 2 + 1 + 3 + 3 + 2
    shown = " ".join(audit(str(file), stated=Stated((15,))).text().split())
    assert anywhere(shown, tmp_path) == approved
    many = "\n".join(f"x{k},n.s.,14" for k in range(14))
    file.write_text(f"name,t,df\n{many}\ny,2.0,14\n", "utf-8")
    (said,) = paper.read(file, Stated()).passed_over
    assert said.endswith(" and 2 more.")


def test_a_cell_that_was_not_read_is_no_agreement(tmp_path: Path, approved: SnapshotAssertion) -> None:
    file = tmp_path / "p.csv"
    file.write_text("Table 1\n,a,b\na,0.70,0.3O\nb,0.10,0.90\n", "utf-8")
    found = audit(str(file), stated=Stated((15,), 10))
    shown = " ".join(found.text().split())
    assert anywhere(shown, tmp_path) == approved
    assert found.as_dict()["unread"] == 1
    file.write_text(file.read_text("utf-8").replace("0.3O", "0.30"), "utf-8")
    shown = " ".join(audit(str(file), stated=Stated((15,), 10)).text().split())
    assert "not read" not in shown
    assert anywhere(shown, tmp_path) == approved


STARRED = (
    "0.767*** (0.156)",
    "0.767<sup>***</sup> (0.156)",
    "0.767 *** &plusmn; 0.156",
    "0.767 (0.156)***",
    "0.767\u2217\u2217 [SD = 0.156]",
    "0.767<sup>\u2020</sup> +- 0.156",
)


@pytest.mark.parametrize("text", STARRED)
def test_stars_stand_before_or_behind_the_sd(tmp_path: Path, text: str) -> None:
    page = f"<table><tr><th><th>a<th>b<tr><td>a<td>{text}<td>0.2<tr><td>b<td>0.1<td>0.9</table>"
    found = _read(tmp_path, page, Stated((15,)))
    first = found.printed.table[0].cells[0]
    assert (first.mean.text, first.sd and first.sd.text, found.unread) == ("0.767", "0.156", 0)


def test_the_only_cell_whose_misprint_explains_a_row_is_named_alone(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """No other mean beside 0.50 + 0.95 fills a row; 0.00 beside 0.50 + 0.50 does."""
    file = tmp_path / "p.csv"
    file.write_text(",a,b,c\na,0.95,0.50,0.50\nb,0.10,0.90,0.00\nc,0.00,0.60,0.50\n", "utf-8")
    lines = audit(str(file), stated=Stated((15,), 10)).comparison.lines
    alone, any_of = (one.reason for one in lines if one.verdict == "impossible")
    assert [alone, any_of] == approved


def test_a_df_that_no_table_has_is_named_as_wrong(tmp_path: Path, approved: SnapshotAssertion) -> None:
    """15 participants have 14 df; t of a is 7.746 and of b 30.98 (by hand)."""
    rows = ["Table 1", ",a,b", "a,0.700 (0.100),0.300 (0.100)", "b,0.100 (0.050),0.900 (0.050)", ""]
    file = tmp_path / "p.csv"
    file.write_text("\n".join([*rows, "name,t,df", "a,7.75,15", "b,30.98,14", ""]), encoding="utf-8")
    stated = Stated((15,), None, "1/2")
    lines = audit(str(file), stated=stated).comparison.lines
    assert [(one.subject, one.verdict) for one in lines if one.quantity == "df"] == [("a", "differs"), ("b", "agrees")]
    (cause,) = [one.reason for one in lines if one.quantity == "df" and one.verdict == "differs"]
    assert cause == approved
    file.write_text("\n".join([*rows, "name,t,df", "a,7.75,15", ""]), encoding="utf-8")
    assert paper.read(file, stated).passed_over == approved


def test_one_reason_for_many_cells_is_told_once(tmp_path: Path, approved: SnapshotAssertion) -> None:
    path = tmp_path / "paper.csv"
    path.write_text("presented,cork,felt\ncork,0.71 ± 0.20,0.29 ± 0.20\nfelt,0.45 ± 0.22,0.64 ± 0.22\n")
    told = " ".join(audit(str(path), stated=Stated(participants=(12,))).text().split())
    assert anywhere(told, tmp_path) == approved


def test_a_confusion_table_without_its_participants_is_passed_over(tmp_path: Path, approved: SnapshotAssertion) -> None:
    found = _read(tmp_path, PAGE, Stated())
    assert found.printed.table == ()
    assert found.passed_over == approved


def test_tables_of_a_csv_file_are_parted_by_lines_without_cells(tmp_path: Path) -> None:
    text = "Table 1\n,glass,sand\nglass,0.9,0.1\nsand,0.25,0.75\n\nname,t,df,p\nease,2.5,11,0.0296\n"
    found = _read(tmp_path, text, Stated((4,)), "tables.csv")
    assert [cell.mean.text for cell in found.printed.table[0].cells] == ["0.9", "0.1", "0.25", "0.75"]
    assert (found.printed.table[0].where, found.printed.t[0].where) == ("Table 1", "table 2")


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_a_csv_file_of_another_delimiter(tmp_path: Path, delimiter: str) -> None:
    text = "name,t,df,p\nease,2.5,11,0.0296\n".replace(",", delimiter)
    assert _read(tmp_path, text, Stated(), "tables.csv").printed.tests[0].df == 11


def test_decimal_commas_are_read(tmp_path: Path) -> None:
    text = "name;t;df;p\nease;2,50;11;0,0296\n"
    (test,) = _read(tmp_path, text, Stated(), "tables.csv").printed.tests
    assert (test.t.text, test.p.text if test.p else "") == ("2.50", "0.0296")


@pytest.mark.parametrize("decimal", ".,")
def test_decimal_commas_of_a_page_are_read(tmp_path: Path, decimal: str) -> None:
    page = "<table><tr><th>name<th>t<th>df<th>p<th>F(3,68)<tr><td>ease<td>2.50<td>11<td>0.0296</table>"
    (test,) = _read(tmp_path, page.replace(".", decimal), Stated()).printed.tests
    assert (test.t.text, test.p.text if test.p else "") == ("2.50", "0.0296")


def test_a_stated_decimal_comma_of_a_page_is_taken_where_it_may_part_thousands(tmp_path: Path) -> None:
    page = "<table><tr><th>name<th>t<th>df<th>p<tr><td>ease<td>2,512<td>11<td>1</table>"
    with pytest.raises(PublishedError):
        _read(tmp_path, page, Stated())
    (test,) = _read(tmp_path, page, Stated(file=delimited.Stated(decimal=","))).printed.tests
    assert (test.t.text, test.df) == ("2.512", 11)


@pytest.mark.parametrize("name", ["paper.html", "tables.csv"])
def test_a_point_among_decimal_commas_parts_thousands_only_behind_a_digit_above_0(tmp_path: Path, name: str) -> None:
    rows = [("t", "df", "p"), ("2,45", "13", "0.029"), ("3,12", "13", "0.008"), ("5,32", "13", "0,02"),
            ("1.234,5", "1.300", "0.001")]  # fmt: skip
    table = "<table>" + "".join(f"<tr><td>a<td>{'<td>'.join(row)}" for row in rows) + "</table>"
    text = table if name.endswith("html") else "".join(f"a;{';'.join(row)}\n" for row in rows)
    found = _read(tmp_path, text, Stated(), name)
    assert found.unread == 0
    assert [(one.t.text, one.df, one.p.text if one.p else "") for one in found.printed.tests] == [
        ("2.45", 13, "0.029"), ("3.12", 13, "0.008"), ("5.32", 13, "0.02"), ("1234.5", 1300, "0.001"),
    ]  # fmt: skip


def test_a_cell_over_several_rows_and_columns(tmp_path: Path) -> None:
    page = (
        '<table><tr><td rowspan="2">name<td colspan="2">test<td rowspan="2">p<tr><td>t<td>df'
        "<tr><td>ease<td>2.5<td>11<td>0.0296</table>"
    )
    assert _read(tmp_path, page, Stated()).printed.tests[0].p is not None


HOSTILE = {
    "comments": "<!--" * 250_000,
    "tags": "<a " * 250_000,
    "attributes": "<a " + "x=" * 250_000,
    "tables": "<table>" * 150_000,
    "cells": "<table><tr>" + "<td>" * 150_000,
    "spans": "<table>" + '<tr><td rowspan="9999" colspan="9999">1' * 50,
    "entities": "<table><tr><td>" + "&#" * 250_000,
    "names": f"<table><tr><th>{'x' * 9000}<th>t<th>df<tr><td>{chr(0x202E)}<td>2<td>3</table>",
    "nothing": "",
    "zeros": "\0" * 1000,
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("suffix", ["html", "csv"])
def test_hostile_files_end_in_one_line(tmp_path: Path, name: str, suffix: str) -> None:
    assert "\n" not in _told(tmp_path, HOSTILE[name], f"p.{suffix}")


def test_a_file_that_is_too_large_or_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PublishedError) as refused:
        paper.read(tmp_path / "none.html", Stated())
    assert refused.value.finding.where == tmp_path / "none.html"
    with pytest.raises(PublishedError, match="cannot be read"):
        _read(tmp_path, " " * (paper.LARGEST + 1), Stated())


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.lists(
            st.sampled_from(["t", "df", "p", "SS", "MS", "F", "a", "b", "0.5", "0.5 (0.1)", "3", "Error", "", "<"]),
            min_size=1,
            max_size=5,
        ),
        max_size=6,
    ),
    st.sampled_from(["html", "csv"]),
)
def test_any_table_is_read_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[str]], suffix: str
) -> None:
    cells = "".join("<tr>" + "".join(f"<td>{cell}" for cell in row) for row in rows)
    text = f"<table>{cells}</table>" if suffix == "html" else "\n".join(",".join(row) for row in rows)
    assert "\n" not in _told(tmp_path_factory.mktemp("any"), text, f"p.{suffix}")


def _percent(seed: int, cell: str) -> str:
    """A right table of whole counts of 15 participants and 10 trials, in percent, by numpy alone."""
    rng = np.random.default_rng(seed)
    lines = ["," + ",".join(NAMES)]
    for row in range(3):
        counts = rng.multinomial(10, np.where(np.arange(3) == row, 0.6, 0.2), 15)
        mean, sd = 10 * counts.mean(axis=0), 10 * counts.std(axis=0, ddof=1)
        lines.append(",".join([NAMES[row], *(cell.format(m, s) for m, s in zip(mean, sd, strict=True))]))
    return "\n".join(lines)


NAMES = ("glass", "sand", "snow")


@pytest.mark.parametrize("cell", ["{:.0f} ± {:.0f}%", "{:.0f}% ± {:.0f}%", "{:.0f} ± {:.0f}", "{:.1f} ({:.1f})"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_right_table_in_percent_is_not_accused(tmp_path: Path, seed: int, cell: str) -> None:
    found = _read(tmp_path, _percent(seed, cell), Stated((15,), 10), "paper.csv")
    (table,) = found.printed.table
    assert all(text.endswith("%") for one in table.cells for text in (one.mean.text, one.sd.text if one.sd else "%"))
    assert ("read as percent" in table.where) == ("%" not in cell)
    text = audit(str(tmp_path / "paper.csv"), stated=Stated((15,), 10)).text()
    assert "impossible" not in text
    assert "would fit" not in text


def test_one_bare_number_of_percent_among_ratios_stays_as_it_is(tmp_path: Path) -> None:
    text = ",glass,sand,snow\nglass,50 ± 0.1,0.2 ± 0.1,0.3 ± 0.1\nsand,0.2 ± 0.1,0.6 ± 0.1,0.2 ± 0.1\nsnow,0.1,0.1,0.8"
    (table,) = _read(tmp_path, text, Stated((15,), 10), "paper.csv").printed.table
    assert [one.mean.text for one in table.cells][:3] == ["50", "0.2", "0.3"]


def test_a_page_that_is_too_large_is_refused_without_a_number_of_the_system(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    with page.open("wb") as file:
        file.truncate(2**31)
    with pytest.raises(PublishedError) as caught:
        paper.read(page, Stated())
    assert str(page) in str(caught.value)
    assert "Errno" not in str(caught.value)


@pytest.mark.parametrize("whole", ["", "%"])
def test_answers_that_stand_in_rows_are_read_so_and_a_misprint_turns_no_table(tmp_path: Path, whole: str) -> None:
    shares = {"glass": (75, 10, 5), "sand": (15, 80, 10), "snow": (10, 10, 85)}

    def table(rows: Mapping[str, tuple[int, ...]]) -> tuple[str, dict[tuple[str, str], str]]:
        cells = {(name, other): f"{one}%" if whole else f"{one / 100:.2f}"
                 for name, row in rows.items() for other, one in zip(NAMES, row, strict=True)}  # fmt: skip
        lines = [",".join([name, *(cells[name, other] for other in NAMES)]) for name in NAMES]
        text = "\n".join([f",{','.join(NAMES)}", *lines])
        (found,) = _read(tmp_path, text, Stated((15,), 20), "paper.csv").printed.table
        return found.where, {(one.presented, one.answered): one.mean.text for one in found.cells}

    where, cells = table(shares)
    assert "answers in rows" in where
    assert cells["sand", "glass"] == ("10%" if whole else "0.10")
    across = {name: tuple(shares[other][at] for other in NAMES) for at, name in enumerate(NAMES)}
    assert "answers in rows" not in table(across)[0]
    across["snow"] = (5, 10, 58)
    where, cells = table(across)
    assert "answers in rows" not in where
    assert cells["sand", "glass"] == ("10%" if whole else "0.10")
