"""`palpate audit`, as the analyst calls it."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.cli import analysis, options
from palpate.experiment.cli.analysis import commands
from tests.conftest import Palpate


def test_a_shipped_study_by_its_id(palpate: Palpate) -> None:
    code, out, err = palpate("audit", "okamoto2012")
    assert (code, err) == (0, "")
    assert "Cohen's d = 1.52" in " ".join(out.split())
    assert out.index("Table 1, virtual") < out.index("Does not agree")


def test_one_json_document_and_nothing_else(palpate: Palpate) -> None:
    code, out, _ = palpate("audit", "wellman1995", "--json")
    document = json.loads(out)
    assert (code, document["against"], document["label"]) == (0, "print", "")
    assert sum(line["verdict"].startswith("fits no") for line in document["lines"]) == 2


def test_a_dataset_and_its_label(palpate: Palpate, repository_root: Path) -> None:
    code, out, _ = palpate("audit", repository_root / "participants" / "okamoto2012", "--json")
    document = json.loads(out)
    assert (code, document["against"], document["origin"]) == (0, "dataset", "RECONSTRUCTION")
    assert document["label"].startswith("RECONSTRUCTION")


def test_a_file_in_any_place(palpate: Palpate, repository_root: Path, tmp_path: Path) -> None:
    shipped = repository_root / "analysis" / "published" / "wellman1995.toml"
    copy = tmp_path / "ours.toml"
    copy.write_bytes(shipped.read_bytes())
    assert palpate("audit", copy, "--json")[1] == palpate("audit", "wellman1995", "--json")[1]


def test_what_is_unknown_is_one_line_and_code_2(palpate: Palpate, approved: SnapshotAssertion) -> None:
    code, out, err = palpate("audit", "okamoto1999")
    assert (code, out) == (2, "")
    assert err == approved
    assert err.count("\n") == 1


def test_the_desk_stands_in_one_module() -> None:
    callbacks = [command.callback for command in commands.registered_commands]
    assert [call.__name__ for call in callbacks if call] == [
        "analyse",
        "export",
        "audit",
        "power",
        "numerics",
        "import_counts",
        "import_trials",
        "status",
    ]
    assert {call.__module__ for call in callbacks if call} == {analysis.__name__}


def test_trials_of_another_program_are_imported_analysed_and_exported(palpate: Palpate, tmp_path: Path) -> None:
    file = tmp_path / "trials.csv"
    rows = [f"{who},{shown},{key},0.5" for who in range(1, 4) for shown in ("felt", "cork") for key in ("1", "2", "")]
    file.write_text("\n".join(["who,shown,key,rt", *rows]) + "\n")
    columns = ("--presented", "shown", "--answered", "key", "--participant", "who", "--seconds", "rt")
    keys = ("--map", "1=felt", "--map", "2=cork")
    code, out, err = palpate("import-trials", file, *columns, *keys, "--study", "lab", "--out", tmp_path / "lab")
    assert (code, err) == (0, "")
    assert "Trials: 18, including 6 " in out
    assert out.endswith(f"Dataset: {tmp_path / 'lab'}\n")
    code, out, err = palpate("analyse", tmp_path / "lab", "--no-figures")
    assert (code, err) == (0, "")
    assert out.startswith("IMPORTED - ")
    assert palpate("export", tmp_path / "lab", "--out", tmp_path / "tables")[0] == 0
    assert "IMPORTED" in (tmp_path / "tables" / "trials.csv").read_text()
    code, out, _ = palpate("verify", tmp_path / "lab")
    assert code == 0
    assert "imported answers" in out
    bad = palpate("import-trials", file, *columns, "--study", "lab", "--out", tmp_path / "other")
    assert (bad[0], bad[1]) == (2, "")
    assert f"line 2 of {file}" in bad[2]
    assert "cork, felt, (none)" in bad[2]


def test_measured_counts_say_imported_and_have_no_models_of_single_trials(
    palpate: Palpate, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    counts = tmp_path / "counts.csv"
    counts.write_text(
        "participant,presented,answered,count\n1,felt,felt,3\n1,cork,felt,2\n2,cork,cork,4\n2,felt,cork,1\n"
    )
    made = ("import-counts", "--task", f"one={counts}", "--study", "lab", "--source", "our sessions", "--measured")
    assert palpate(*made, "--out", tmp_path / "lab")[0] == 0
    code, out, _ = palpate("analyse", tmp_path / "lab", "--no-figures", "--json")
    document = json.loads(out)
    assert (code, document["origin"]) == (0, "IMPORTED")
    assert document["trials"]["gee"] is document["trials"]["mixed"] is None
    told = [one["statement"] for one in document["course"]["statements"]]
    assert [*document["trials"]["statements"].values(), *told] == approved


def test_the_tables_of_a_page(palpate: Palpate, tmp_path: Path) -> None:
    page = tmp_path / "paper.html"
    page.write_text("<table><tr><td>x<td>a<td>b<tr><td>a<td>0.9<td>0.2<tr><td>b<td>0.4<td>0.6</table>")
    code, out, err = palpate("audit", page, "--participants", "5", "--trials", "10")
    assert (code, err) == (0, "")
    assert "cannot sum to 1" in " ".join(out.split())
    code, _, err = palpate("audit", page)
    assert (code, err.count("\n")) == (2, 1)
    assert "give --participants" in err


def test_what_a_toml_file_says_itself_is_not_given_beside_it(palpate: Palpate, approved: SnapshotAssertion) -> None:
    code, _, err = palpate("audit", "okamoto2012", "--participants", "5")
    assert code == 2
    assert err == approved


@pytest.mark.parametrize("chance", ["3", "1/0", "0", "5/4", "a quarter"])
def test_a_chance_that_is_no_share_is_refused(palpate: Palpate, tmp_path: Path, chance: str) -> None:
    (tmp_path / "p.csv").write_text(",a,b\na,0.9,0.1\nb,0.2,0.8\n", encoding="utf-8")
    code, _, err = palpate("audit", tmp_path / "p.csv", "--participants", "5", "--chance", chance)
    assert (code, err.count("\n")) == (2, 1)
    assert f"--chance: got {chance}; " in err
    assert "1/4 or 0.25" in err


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_is_told_what_is_being_computed_and_a_pipe_is_not(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told = io.StringIO()
    monkeypatch.setattr(told, "isatty", lambda: terminal, raising=False)
    monkeypatch.setattr(sys, "__stderr__", told)
    with options.working("Reading the dataset") as say:
        say("Drawing figures")
        say("Reading", 50, 200)
    assert ("50/200" in told.getvalue()) == terminal
    assert capsys.readouterr() == ("", "")
