"""Dissimilarities from a file: what `palpate validate` writes is read, and a broken file is refused by its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.analysis.analyse import analyse
from palpate.analysis.reading.dissimilarities import from_file, printed_dissimilarities
from palpate.experiment.errors import DatasetError
from tests.analysis.datasets import MATERIALS, balanced, write_dataset

GOOD = "dataset,material_a,material_b,dissimilarity,printed\nSIMULATED,glass,sand,1,\nSIMULATED,glass,snow,0.4,\n"


def _file(folder: Path, text: str) -> Path:
    path = folder / "pairs.csv"
    path.write_text(text)
    return path


def test_pairs_become_a_symmetric_table_that_names_its_source(tmp_path: Path) -> None:
    found = from_file(_file(tmp_path, f"{GOOD}SIMULATED,snow,sand,0.25,\n"), MATERIALS)
    table = found.table(MATERIALS)
    assert table is not None
    assert table.tolist() == [[0, 1, 0.4], [1, 0, 0.25], [0.4, 0.25, 0]]
    assert found.source == "pairs.csv - SIMULATED"
    assert found.table(("glass", "wool")) is None


def test_the_paper_has_every_pair_of_its_materials() -> None:
    materials = ("copy paper", "aluminum foil", "polypropylene", "typing paper")
    table = printed_dissimilarities().table(materials)
    assert table is not None
    assert table.max() == 1


def test_the_report_compares_with_the_file(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "data", {str(k): {"real": balanced(k)} for k in range(1, 6)})
    path = _file(tmp_path, f"{GOOD}SIMULATED,snow,sand,0.25,\n")
    found = analyse([root], dissimilarities=path)
    assert found.results.identifications[0].mantel is not None
    assert "(pairs.csv - SIMULATED)" in " ".join(found.text(full=True).split())
    assert (found.out / "figures" / "dissimilarity.svg").is_file()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (GOOD, "no dissimilarity for sand and snow"),
        (f"{GOOD}x,sand,glass,0.3,\n", "line 4: got 'sand', 'glass', '0.3'; allowed: two materials, each pair once"),
        (f"{GOOD}x,sand,snow,nan,\n", "line 4"),
        (f"{GOOD}x,sand,snow,-1,\n", "line 4"),
        (f"{GOOD}x,sand\n", "line 4"),
        ("a,b\n1,2\n", "line 2: got None, None, None"),
        ("", "no dissimilarity for"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, text: str, why: str) -> None:
    with pytest.raises(DatasetError, match=why):
        from_file(_file(tmp_path, text), MATERIALS)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="cannot be read"):
        from_file(tmp_path / "none.csv", MATERIALS)
