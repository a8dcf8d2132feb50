"""`palpate audit`, as the analyst calls it."""

from __future__ import annotations

import json
from pathlib import Path

from experiment.cli.analysis import commands
from tests.conftest import Palpate


def test_a_shipped_study_by_its_id(palpate: Palpate) -> None:
    code, out, err = palpate("audit", "okamoto2012")
    assert (code, err) == (0, "")
    assert "Cohen's d = 1.52" in out
    assert out.index("Table 1, virtual") < out.index("What does not agree as rounded")


def test_one_json_document_and_nothing_else(palpate: Palpate) -> None:
    code, out, _ = palpate("audit", "wellman1995", "--json")
    document = json.loads(out)
    assert (code, document["against"], document["label"]) == (0, "print", "")
    assert sum(line["verdict"] == "fits no one rounding" for line in document["lines"]) == 2


def test_a_dataset_and_its_label(palpate: Palpate, repository_root: Path) -> None:
    code, out, _ = palpate("audit", repository_root / "participants" / "okamoto2012", "--json")
    document = json.loads(out)
    assert (code, document["against"], document["origin"]) == (0, "dataset", "RECONSTRUCTION")
    assert document["label"].startswith("RECONSTRUCTION")


def test_a_file_in_any_place(palpate: Palpate, repository_root: Path, tmp_path: Path) -> None:
    shipped = repository_root / "analysis" / "published" / "okamoto2012.toml"
    copy = tmp_path / "ours.toml"
    copy.write_bytes(shipped.read_bytes())
    assert palpate("audit", copy, "--json")[1] == palpate("audit", "okamoto2012", "--json")[1]


def test_what_is_unknown_is_one_line_and_code_2(palpate: Palpate) -> None:
    code, out, err = palpate("audit", "okamoto1999")
    assert (code, out) == (2, "")
    assert err.startswith("palpate: okamoto1999: got no study, file or folder")
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
        "status",
    ]
    assert {call.__module__ for call in callbacks if call} == {"experiment.cli.analysis"}
