"""Export: the files say what the dataset says, their dictionary describes every column, and R's reader's rules hold."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.export import DICTIONARY, columns_of, export, files
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Exclusion
from palpate.experiment.dataset.bids import LABELS
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER
from tests.analysis.datasets import MATERIALS, balanced, trial, trials, write_dataset
from tests.approved import Refuses
from tests.conftest import Palpate


def _frame(content: bytes) -> pd.DataFrame:
    return pd.read_csv(io.BytesIO(content), keep_default_na=True)


@pytest.fixture(scope="module")
def okamoto(repository_root: Path) -> dict[str, bytes]:
    return files(read(repository_root / "participants" / "okamoto2012"))


def test_the_dictionary_describes_every_column_and_no_other(okamoto: dict[str, bytes]) -> None:
    described: dict[str, list[str]] = {}
    for row in csv.DictReader(io.StringIO(okamoto[DICTIONARY].decode())):
        described.setdefault(row["file"], []).append(row["column"])
        assert row["description"]
        assert row["unit"]
    headers = {name: content.decode().split("\n")[0].split(",") for name, content in okamoto.items()}
    assert described == {name: header for name, header in headers.items() if name != DICTIONARY}


def test_a_reason_that_a_spreadsheet_would_compute_is_quoted(repository_root: Path) -> None:
    study = read(repository_root / "participants" / "okamoto2012")
    rule = Exclusion("01", "all", None, None, "gone", "=HYPERLINK(A1)")
    found = _frame(files(replace(study, exclusions=(rule,)))["exclusions.csv"])
    assert list(found["reason"]) == ["'=HYPERLINK(A1)"]
    assert found["trial"].isna().all()


def test_a_task_has_no_column_and_no_row_of_a_material_that_it_does_not_present(tmp_path: Path) -> None:
    rows = trials([("sand", "snow"), ("glass", "glass")])
    sessions = {"1": {"virtual": rows, "real": balanced(1)}}
    root = write_dataset(tmp_path / "data", sessions, presented={"virtual": ("glass", "sand")})
    tables = {path.name: path.read_bytes() for path in export([root], tmp_path / "out")}
    wide = _frame(tables["wide.csv"])
    own = [name for name in wide.columns if name.startswith(("virtual_", "real_"))]
    assert own == ["virtual_glass", "virtual_sand", "real_glass", "real_sand", "real_snow"]
    assert wide["virtual_sand"].tolist() == [0.0]
    long = _frame(tables["long.csv"])
    assert set(long.loc[long["task"] == "virtual", "presented"]) == {"glass", "sand"}
    assert set(long.loc[long["task"] == "virtual", "answered"]) == {*MATERIALS, NO_ANSWER}


def test_every_row_is_labelled(okamoto: dict[str, bytes]) -> None:
    for name in (*columns_of("identification"), DICTIONARY):
        assert set(_frame(okamoto[name])["dataset"]) == {LABELS["RECONSTRUCTION"]}, name


def test_no_label_of_a_participant_is_a_number(okamoto: dict[str, bytes]) -> None:
    for name in ("trials.csv", "long.csv", "wide.csv", "psychopy.csv"):
        labels = pd.read_csv(io.BytesIO(okamoto[name]))["participant"]
        assert set(labels) <= {f"sub-{k:02}" for k in range(1, 16)}


def test_the_counts_are_those_of_the_dataset(okamoto: dict[str, bytes], repository_root: Path) -> None:
    """`sourcedata/` holds them as they were imported."""
    source = repository_root / "participants" / "okamoto2012" / "sourcedata" / "okamoto2012_counts_real.csv"
    wanted = pd.read_csv(source, dtype={"participant": str})
    found = _frame(okamoto["long.csv"])
    found = found[(found["task"] == "real") & (found["count"] > 0)]
    counts = found.groupby(["presented", "answered"])["count"].sum()
    assert counts.to_dict() == wanted[wanted["count"] > 0].groupby(["presented", "answered"])["count"].sum().to_dict()


def test_the_layouts_agree(okamoto: dict[str, bytes]) -> None:
    trials, long, wide = (_frame(okamoto[name]) for name in ("trials.csv", "long.csv", "wide.csv"))
    assert len(trials) == 1000
    assert long.groupby("task")["count"].sum().to_dict() == {"virtual": 600, "real": 400}
    right = long[long["presented"] == long["answered"]].set_index(["participant", "task", "presented"])["ratio"]
    assert wide.shape == (15, 11)
    for _, row in wide.iterrows():
        assert row["virtual_copy_paper"] == right[row["participant"], "virtual", "copy paper"]
    assert wide["real_copy_paper"].count() == 10
    assert trials["correct"].sum() == right.mul(10).sum()


def test_attempts_done_again_are_there_and_marked(tmp_path: Path) -> None:
    again = [trial(1, "sand", "n/a", counted=False, redo_reason="slipped"), trial(1, "sand", "(none)", attempt=2)]
    made = files(read(write_dataset(tmp_path, {"1": {"real": again}})))
    trials = _frame(made["trials.csv"])
    assert trials[["attempt", "counted", "included"]].to_numpy().tolist() == [[1, 0, 0], [2, 1, 1]]
    assert trials["correct"].isna().tolist() == [True, False]
    assert _frame(made["exclusions.csv"])["reason"].tolist() == ["attempt 1 was repeated: slipped"]
    assert pd.read_csv(io.BytesIO(made["psychopy.csv"]), keep_default_na=False)["key_resp.keys"].tolist() == ["None"]


def test_names_that_other_software_refuses_are_changed_and_stay_apart(tmp_path: Path) -> None:
    names = ("snow & ice", "snow/ice")
    made = files(read(write_dataset(tmp_path, {"1": {"real": balanced(1, 4, names)}}, materials=names)))
    columns = _frame(made["wide.csv"]).columns.tolist()
    assert all(name.isidentifier() for name in columns)
    assert len(set(columns)) == len(columns) == 5


def test_the_command_writes_outside_of_the_dataset(
    tmp_path: Path, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    root = write_dataset(tmp_path / "data", {"1": {"real": balanced(1)}})
    code, out, _ = palpate("export", root, "--out", tmp_path / "tables")
    assert code == 0
    assert {Path(line).name for line in out.splitlines()} == {path.name for path in (tmp_path / "tables").glob("*.csv")}
    code, _, error = palpate("export", root, "--out", root / "tables")
    assert code == 2
    assert error.replace(str(tmp_path), "FOLDER") == approved


def test_a_file_of_somebody_elses_is_left_alone(tmp_path: Path, refuses: Refuses) -> None:
    root = write_dataset(tmp_path / "data", {"1": {"real": balanced(1)}})
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "long.csv").write_text("mine")
    with refuses(DatasetError):
        export([root], tmp_path / "tables")
