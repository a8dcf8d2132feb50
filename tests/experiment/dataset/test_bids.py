"""Writing BIDS files: round trips, missing values, whole files or none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from palpate.experiment.dataset.bids import beh_path, table
from palpate.experiment.dataset.imports.reconstruction import new_dataset
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import columns_of
from palpate.experiment.storage import write_bytes
from tests.analysis.datasets import trial, write_dataset


def test_cells_of_a_table() -> None:
    row = {"a": None, "b": True, "c": 0.1, "d": float("nan"), "e": "x y"}
    assert table("abcdef", [row]) == b"a\tb\tc\td\te\tf\nn/a\t1\t0.1\tn/a\tx y\tn/a\n"


def test_a_further_column_stands_in_the_table_and_its_dictionary_where_some_row_has_it(tmp_path: Path) -> None:
    root = write_dataset(
        tmp_path, {"1": {"real": [trial(1, "sand", "sand"), trial(2, "sand", "snow", dead_time=0.01)]}}
    )
    path = beh_path(root, "1", "real", "events.tsv")
    header, *rows = [line.split("\t") for line in path.read_text().splitlines()]
    assert header == [*columns_of("footstep"), "dead_time"]
    assert [row[-1] for row in rows] == ["n/a", "0.01"]
    described = json.loads(path.with_suffix(".json").read_text())
    assert described["dead_time"] == columns_of("further")["dead_time"]
    assert not {"masker_level", "gate_to_scheduled"} & set(described)


@pytest.mark.parametrize("cell", ["", "a\tb", "a\nb", "a\rb"])
def test_a_cell_that_would_break_the_table_is_refused(cell: str) -> None:
    with pytest.raises(DatasetError, match="one line without tabs"):
        table("a", [{"a": cell}])


def test_an_unknown_column_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no such columns: \['b'\]"):
        table("a", [{"b": 1}])


@pytest.mark.parametrize("label", ["", "0 1", "../1", "a_b", "ü"])
def test_labels_are_those_of_bids(tmp_path: Path, label: str) -> None:
    with pytest.raises(DatasetError, match="letters and digits"):
        beh_path(tmp_path, label, "real", "events.tsv")


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    write_bytes(path, b"old")

    def fail(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(DatasetError, match=r"cannot write .*a\.json: No space left on device"):
        write_bytes(path, b"new")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.json", b"old")]


def test_a_dataset_that_fails_halfway_leaves_nothing(tmp_path: Path) -> None:
    def build() -> None:
        with new_dataset(tmp_path / "out") as root:
            write_bytes(root / "a" / "b", b"half")
            raise DatasetError("stop")

    with pytest.raises(DatasetError, match="stop"):
        build()
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_may_become_a_dataset(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with new_dataset(tmp_path / "out") as root:
        write_bytes(root / "a", b"whole")
    assert (tmp_path / "out" / "a").read_bytes() == b"whole"
