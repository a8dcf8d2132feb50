"""This palpate reads what every release wrote, which is SIMULATED: its trials are what that release read."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path
from typing import Literal

import pandas as pd
import pytest

import palpate
from palpate.analysis.reading import files as reading
from palpate.experiment import storage
from palpate.experiment.dataset import bids, build, verify
from palpate.experiment.protocol import approval, files
from palpate.experiment.records import events
from tests.releases import APPROVED_ON, EXPIRES_ON, FOLDER, RELEASES, RIGS, TRIALS

ARCHIVED = sorted(path.parent for path in FOLDER.glob("*/*/*.seal.toml"))


def cells(path: Path) -> pd.DataFrame:
    """The cells of a table of events as they are written."""
    return pd.read_csv(path, sep="\t", dtype=str, keep_default_na=False)


def test_every_release_and_each_of_its_datasets_are_archived() -> None:
    assert palpate.__version__ in RELEASES
    assert {(path.parent.name, path.name) for path in ARCHIVED} == set(product(RELEASES, RIGS))


@pytest.mark.parametrize("archived", ARCHIVED, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_a_dataset_of_a_release_is_whole_and_has_the_trials_that_it_had(archived: Path) -> None:
    assert verify.verify(archived / "dataset").refused == 0
    had = (archived / TRIALS).read_text("utf-8")
    columns = had.splitlines()[0].split(",")
    assert palpate.read(archived / "dataset").attempts.to_csv(index=False, columns=columns) == had


@pytest.mark.parametrize("archived", ARCHIVED, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_its_tables_are_built_again_from_its_journals_alone(archived: Path, tmp_path: Path) -> None:
    root = shutil.copytree(archived / "dataset", tmp_path / "dataset")
    tables = sorted(root.glob("sub-*/beh/*_events.tsv"))
    had = [cells(path) for path in tables]
    for path in tables:
        path.unlink()
    build.build(root)
    assert len(had) > 0
    for path, was in zip(tables, had, strict=True):
        pd.testing.assert_frame_equal(cells(path)[was.columns.to_list()], was)


@pytest.mark.parametrize("archived", ARCHIVED, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_its_protocol_is_the_one_that_was_sealed(archived: Path) -> None:
    (sealed,) = archived.glob("*.seal.toml")
    file = sealed.with_name(sealed.name.replace(".seal", ""))
    seal = approval.verify(file, files.load(file), APPROVED_ON)
    assert (seal.approved_on, seal.expires_on) == (APPROVED_ON, EXPIRES_ON)


def test_the_next_format_of_datasets_with_a_further_column_refuses_none_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    root = ARCHIVED[0] / "dataset"
    known = events.columns_of

    def columns_of(kind: str, *intervals: int) -> events.Columns:
        return {
            **known(kind, *intervals),
            **({} if kind == "participants" else {"later": {"Description": "Came later."}}),
        }

    for module in (bids, reading):
        monkeypatch.setattr(module, "columns_of", columns_of)
    monkeypatch.setattr(storage, "DATASET_FORMAT", 3)
    monkeypatch.setattr(storage, "DatasetFormat", Literal[2, 3])
    assert verify.verify(root).refused == 0
    assert len(palpate.read(root).attempts) == len(pd.read_csv(ARCHIVED[0] / TRIALS))
