"""What was typed for the tests is what the reference files and the shipped tables hold."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from palpate.analysis.reading import dissimilarities
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from tests.reference.okamoto2012 import MATERIALS, TABLE_1, TABLE_2, TABLE_3


def rows(reference: Path, name: str) -> list[dict[str, str]]:
    with (reference / f"okamoto2012_{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(("name", "table"), [("table1", TABLE_1), ("table2", TABLE_2)])
def test_answer_ratios_are_those_of_the_reference_files(
    reference: Path, name: str, table: tuple[tuple[float, ...], ...]
) -> None:
    printed = {(row["presented"], row["answered"]): float(row["mean"]) for row in rows(reference, name)}
    assert {(a, b): table[i][j] for i, a in enumerate(MATERIALS) for j, b in enumerate(MATERIALS)} == printed


def test_dissimilarities_are_those_of_the_reference_file(reference: Path) -> None:
    printed = {(row["material_a"], row["material_b"]): float(row["dissimilarity"]) for row in rows(reference, "table3")}
    assert printed == TABLE_3


def test_both_packages_ship_table_3_as_printed() -> None:
    assert dict(recorded_takes.TABLE_3) == TABLE_3
    assert {pair: one.value for pair, one in dissimilarities.load().pairs.items()} == {
        frozenset(pair): value for pair, value in TABLE_3.items()
    }
