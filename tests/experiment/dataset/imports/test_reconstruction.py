"""Counts to dataset: the committed reconstruction is rebuilt byte by byte, and bad counts are refused by line."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.analysis.export import files
from palpate.analysis.reading.dataset import read
from palpate.experiment.dataset.bids import LABELS
from palpate.experiment.dataset.imports.reconstruction import COLUMNS, OKAMOTO2012, StudyText, import_counts, study_text
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.software import Software

BOTH = "1,sand,sand,3\n1,sand,snow,1\n1,snow,snow,4\n2,sand,(none),1\n2,snow,sand,2\n"
HEADER = "participant,presented,answered,count\n"
STUDY = StudyText(
    id="lab",
    name="A study",
    source="a paper",
    materials={"sand": "dry", "snow": "fresh"},
    tasks={"one": ("Task one", "Say."), "two": ("Task two", "Say.")},
    license="CC0-1.0",
    authors=("Somebody",),
    notes="Nothing to note.",
)


def _files(root: Path) -> dict[str, bytes]:
    """Every file below `root` but the results of an analysis."""
    paths = (path for path in root.rglob("*") if path.is_file())
    relative = {str(path.relative_to(root)): path.read_bytes() for path in paths}
    return {name: content for name, content in relative.items() if not name.startswith("derivatives/")}


def _made_by(root: Path) -> Software:
    (by,) = json.loads((root / "dataset_description.json").read_text())["GeneratedBy"]
    return Software(by["Version"], by["SourceSha256"])


def test_the_committed_dataset_is_rebuilt_from_the_reference(
    reference: Path, repository_root: Path, tmp_path: Path
) -> None:
    committed = repository_root / "participants" / "okamoto2012"
    counts = {task: reference / f"okamoto2012_counts_{task}.csv" for task in ("virtual", "real")}
    import_counts(counts, tmp_path / "again", study=OKAMOTO2012, software=_made_by(committed))
    assert _files(tmp_path / "again") == _files(committed)


def test_the_committed_dataset_is_rebuilt_from_its_own_sources(repository_root: Path, tmp_path: Path) -> None:
    committed = repository_root / "participants" / "okamoto2012"
    counts = {task: committed / "sourcedata" / f"okamoto2012_counts_{task}.csv" for task in ("virtual", "real")}
    import_counts(counts, tmp_path / "again", study=OKAMOTO2012, software=_made_by(committed))
    assert _files(tmp_path / "again") == _files(committed)


def test_the_committed_dataset_says_what_it_is(repository_root: Path) -> None:
    committed = repository_root / "participants" / "okamoto2012"
    label = LABELS["RECONSTRUCTION"]
    for name in ("README", "dataset_description.json", "participants.json", "sourcedata/README"):
        assert label in (committed / name).read_text(), name
    for path in committed.glob("sub-*/beh/*.json"):
        assert label in path.read_text(), path
        assert "matching of participants" in path.read_text(), path
    study = read(committed)
    assert (study.origin, len(study.participants)) == ("RECONSTRUCTION", 15)
    assert study.materials == ("copy paper", "aluminum foil", "polypropylene", "typing paper")
    assert [task.id for task in study.tasks] == ["virtual", "real"]
    assert [len(study.trials(task)) for task in ("virtual", "real")] == [600, 400]
    assert study.attempts["response_time_s"].isna().all()


def _counts(tmp_path: Path, body: str, name: str = "counts.csv") -> Path:
    path = tmp_path / name
    path.write_text(HEADER + body)
    return path


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.dictionaries(
        st.tuples(st.integers(1, 12), st.sampled_from(["sand", "snow"]), st.sampled_from(["sand", "snow", NO_ANSWER])),
        st.integers(0, 5),
        min_size=1,
    ).filter(lambda counts: any(counts.values()))
)
def test_every_count_becomes_as_many_trials(
    tmp_path_factory: pytest.TempPathFactory, counts: dict[tuple[int, str, str], int]
) -> None:
    folder = tmp_path_factory.mktemp("counts")
    path = _counts(folder, "".join(f"{p},{shown},{said},{n}\n" for (p, shown, said), n in counts.items()))
    import_counts({"one": path}, folder / "out", study=STUDY)
    study = read(folder / "out")
    found = study.attempts.groupby(["participant", "presented", "answered"]).size().to_dict()
    assert found == {(f"{p:02d}", shown, said): n for (p, shown, said), n in counts.items() if n}
    for _, rows in study.attempts.groupby("participant"):
        assert rows["trial"].tolist() == list(range(1, len(rows) + 1))


@pytest.mark.parametrize("written", ["7", "07", "007"])
def test_a_participant_may_be_written_as_a_dataset_labels_them(tmp_path: Path, written: str) -> None:
    counts = _counts(tmp_path, f"{written},sand,snow,1\n12,sand,sand,1\n")
    assert read(import_counts({"one": counts}, tmp_path / "out", study=STUDY)).participants == ("07", "12")


def test_counts_that_were_exported_are_imported_again(tmp_path: Path) -> None:
    """The long layout holds the columns of a counts file among others."""
    first = import_counts({"one": _counts(tmp_path, BOTH)}, tmp_path / "out", study=STUDY)
    frame = pd.read_csv(io.BytesIO(files(read(first))["long.csv"]), dtype=str)
    again = tmp_path / "again.csv"
    frame[list(COLUMNS)].to_csv(again, index=False)
    second = import_counts({"one": again}, tmp_path / "second", study=STUDY)
    pd.testing.assert_frame_equal(read(second).attempts, read(first).attempts)


def test_a_bad_counts_file_leaves_no_dataset(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="line 2: presented: got 'ice'"):
        import_counts({"one": _counts(tmp_path, "1,ice,snow,2\n")}, tmp_path / "out", study=STUDY)
    assert not (tmp_path / "out").exists()


def test_of_one_material_no_dataset_is_made(tmp_path: Path) -> None:
    """A reader refuses it: nothing is identified."""
    counts = {"one": _counts(tmp_path, "1,sand,sand,5\n2,sand,(none),1\n")}
    with pytest.raises(
        DatasetError, match="other: got only one material, sand; allowed: two or more; give the counts of"
    ):
        import_counts(counts, tmp_path / "out", study=study_text("other", counts, "a table"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("name", "told"), [('"a\tb"', r"with U\+0009"), (f'"{"a" * 200_000}"', "1 to 40 characters")])
def test_a_material_that_no_table_holds_is_refused(tmp_path: Path, name: str, told: str) -> None:
    with pytest.raises(DatasetError, match=told):
        counts = {"one": _counts(tmp_path, f"1,sand,sand,5\n1,{name},sand,5\n")}
        import_counts(counts, tmp_path / "out", study=study_text("other", counts, "a table"))
    assert not (tmp_path / "out").exists()


def test_an_unknown_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no such tasks in lab: \['three'\]; allowed: \['one', 'two'\]"):
        import_counts({"three": _counts(tmp_path, "1,sand,sand,1\n")}, tmp_path / "out", study=STUDY)


def test_counts_files_of_one_name_are_refused(tmp_path: Path) -> None:
    path = _counts(tmp_path, "1,sand,sand,1\n")
    with pytest.raises(DatasetError, match="need different names"):
        import_counts({"one": path, "two": path}, tmp_path / "out", study=STUDY)


def test_a_dataset_is_never_overwritten(tmp_path: Path) -> None:
    path = _counts(tmp_path, "1,sand,sand,1\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    with pytest.raises(DatasetError, match="never overwrites"):
        import_counts({"one": path}, tmp_path / "out", study=STUDY)
    assert _files(tmp_path / "out") == {"mine": b"mine"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["counts.csv", "out"]


def test_a_study_without_texts_takes_them_from_its_counts(tmp_path: Path) -> None:
    counts = {"one": _counts(tmp_path, "1,snow,sand,1\n1,sand,sand,2\n")}
    out = import_counts(counts, tmp_path / "out", study=study_text("lab", counts, "a table"))
    study = read(out)
    assert (study.id, study.materials, len(study.attempts)) == ("lab", ("snow", "sand"), 3)
    assert "a table" in (out / "README").read_text()


def test_texts_that_are_held_are_used() -> None:
    assert study_text("okamoto2012", {}) == OKAMOTO2012
    assert study_text("okamoto2012", {}, "elsewhere").source == "elsewhere"


@pytest.mark.parametrize(("study", "message"), [("lab", "with --source"), ("../lab", "allowed: lowercase")])
def test_a_study_that_cannot_be_described_is_refused(study: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        study_text(study, {})
