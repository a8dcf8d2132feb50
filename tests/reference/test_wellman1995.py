"""What `participants/wellman1995` holds is what the paper prints: by its copy here, and by what the audit reads."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import pytest

HELD = "participants/wellman1995/sourcedata"


@pytest.mark.parametrize("table", ["table1_materials", "table2_live", "table3_virtual"])
def test_the_tables_are_those_of_the_paper(repository_root: Path, table: str) -> None:
    name = f"wellman1995_{table}.csv"
    assert (repository_root / HELD / name).read_text("utf-8") == (Path(__file__).parent / name).read_text("utf-8")


@pytest.mark.parametrize("table", ["table2_live", "table3_virtual"])
def test_the_audit_reads_the_same_percentages(repository_root: Path, table: str) -> None:
    with (repository_root / HELD / f"wellman1995_{table}.csv").open(encoding="utf-8", newline="") as file:
        held = {(row["material_a"], row["material_b"]): f"{row['percent_correct']}%" for row in csv.DictReader(file)}
    published = tomllib.loads((repository_root / "analysis/published/wellman1995.toml").read_text("utf-8"))
    (block,) = (block for block in published["choices"] if block["task"] == table.split("_")[1])
    assert {tuple(cell["pair"]): cell["correct"] for cell in block["cells"]} == held
