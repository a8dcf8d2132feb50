"""What leaves the laboratory: of whom, with what in it, what is refused, and that it can be verified and analysed."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

import palpate
from palpate.experiment import storage
from palpate.experiment.dataset import build, tables
from palpate.experiment.dataset.outside import shared, sharing
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, PalpateError, RosterError
from palpate.experiment.study import enrolment, withdrawal
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses, anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study

TABLE = '[sharing]\nstatement = "May your trials be shared?"\nsmallest_group = 2\nkeep_labels = true\n\n[duration]'


def allowed(least: int = 2) -> dict[str, str]:
    table = TABLE.replace("smallest_group = 2", f"smallest_group = {least}")
    return {"format = 4": "format = 7", "[duration]": table}


def licensed(study: MadeStudy) -> None:
    path = study.root / shared.DESCRIPTION
    known = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps({**known, "License": "CC-BY-4.0", "Authors": ["A. Author"]}), "utf-8")


def agree(study: MadeStudy, *labels: str) -> None:
    for label in labels:
        enrolment.sharing(study.file, label, True, root=study.root)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_study(tmp_path_factory.mktemp("sharing") / "study", enrolled=5, sessions=4, further=allowed())
    licensed(made)
    agree(made, "01", "02", "03", "05")
    enrolment.sharing(made.file, "03", False, root=made.root)
    return made.file.parent


@pytest.fixture
def study(original: Path, tmp_path: Path) -> MadeStudy:
    folder = shutil.copytree(original, tmp_path / "study")
    return MadeStudy(folder / "study.toml", folder / "dataset")


def facts(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((root / shared.DESCRIPTION).read_text("utf-8"))
    return found


def trials(root: Path) -> list[str]:
    """The trials of each participant, whoever they are."""
    rows = palpate.read(root).attempts.drop(columns="redo_reason")
    return sorted(own.drop(columns="participant").to_csv(index=False) for _, own in rows.groupby("participant"))


def test_who_agreed_is_there_under_another_label_and_all_others_are_counted(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion, tmp_path: Path
) -> None:
    out = tmp_path / "copy"
    code, said, _ = palpate("share", study.root, out)
    assert code == 0
    assert anywhere(said.rpartition("For the lab")[0], tmp_path) == approved
    known = facts(out)
    assert known["DatasetType"] == "derivative"
    assert known["Authors"] == ["A. Author"]
    assert known["Palpate"]["Shared"]["Absent"] == {"declined": 1, "no session": 1, "not asked": 1}
    assert {path.name for path in out.glob("sub-*")} == {"sub-01", "sub-02"}
    assert set(trials(out)) < set(trials(study.root))
    roster = Roster.load(storage.roster_path(study.root))
    assert set(roster.shared) == {"01", "02"}
    kept = [json.loads(storage.shared_label_path(study.root, one).read_text("utf-8")) for one in roster.shared]
    assert {label for one in kept for label in one.values()} == {"01", "02"}
    assert [verify(root).refused for root in (study.root, out)] == [0, 0]


def test_no_day_no_id_of_a_session_and_no_journal_is_in_a_copy(study: MadeStudy, tmp_path: Path) -> None:
    out = sharing.share(study.root, tmp_path / "copy").root
    told = b"".join(path.read_bytes() for path in out.rglob("*") if path.is_file())
    assert b"2001-09-09" not in told
    assert b"SessionId" not in told
    assert {path.name for path in (out / "sourcedata").iterdir()} == {
        "protocol.seal.toml",
        "protocol.toml",
        "shared.json",
    }


def test_a_changed_a_lost_and_a_foreign_file_show(study: MadeStudy, tmp_path: Path, refuses: Refuses) -> None:
    out = sharing.share(study.root, tmp_path / "copy").root
    assert tables.check_analysed(out) == ()
    (table,) = out.glob("sub-01/beh/*_events.tsv")
    table.write_text(table.read_text("utf-8").replace("copy paper", "typing paper", 1), "utf-8")
    (out / "sub-02" / "beh" / "notes.txt").write_text("A note.", "utf-8")
    (out / "participants.json").unlink()
    known = facts(out)
    (out / shared.DESCRIPTION).write_text(json.dumps({**known, "DatasetDOI": "doi:10.5072/x"}), "utf-8")
    names = {Path(str(one.where)).name for one in verify(out).findings if one.refuses}
    assert names == {table.name, "notes.txt", "participants.json"}
    with refuses(DatasetError):
        tables.check_analysed(out)


@pytest.mark.parametrize("lacking", ["table", "licence", "agreement", "group"])
def test_what_may_not_be_shared_is_refused_and_nothing_is_written(tmp_path: Path, lacking: str) -> None:
    further = {} if lacking == "table" else allowed(3 if lacking == "group" else 2)
    study = make_study(tmp_path / "study", enrolled=2, sessions=2, further=further)
    if lacking != "licence":
        licensed(study)
    if lacking in ("licence", "group"):
        agree(study, "01", "02")
    with pytest.raises(RosterError if lacking == "agreement" else DatasetError) as refused:
        sharing.share(study.root, tmp_path / "copy")
    assert {"licence": "License", "group": "", "table": "", "agreement": ""}[lacking] == refused.value.finding.field
    assert not (tmp_path / "copy").exists()
    assert Roster.load(storage.roster_path(study.root)).shared == {}


def test_whoever_withdraws_or_takes_it_back_is_in_no_later_copy(study: MadeStudy, tmp_path: Path) -> None:
    agree(study, "03", "04")
    assert sharing.share(study.root, tmp_path / "first").participants == 4
    day = Roster.load(storage.roster_path(study.root)).shared["01"]
    assert enrolment.sharing(study.file, "01", False, root=study.root) == day
    withdrawal.withdraw(study.file, "02", "asked", root=study.root, rebuild=build.build, erase=True)
    second = sharing.share(study.root, tmp_path / "second")
    assert second.absent == {"declined": 1, "no session": 1, "withdrew": 1}
    assert not storage.shared_label_path(study.root, "02").exists()
    assert verify(study.root).refused == 0


def test_an_agreement_holds_for_the_table_that_was_agreed_to_and_is_of_an_approved_version(study: MadeStudy) -> None:
    dataset = tables.check_tables(study.root)
    assert dataset.protocol.sharing is not None
    rule = dataset.protocol.sharing.model_copy(update={"smallest_group": 1})
    wider = replace(dataset, protocol=dataset.protocol.model_copy(update={"sharing": rule}))
    assert sharing._chosen(dataset, ["01", "02"])[0] == ["01", "02"]
    with pytest.raises(RosterError):
        sharing._chosen(wider, ["01", "02"])
    draft = study.file.read_text("utf-8").replace("smallest_group = 2", "smallest_group = 1")
    study.file.write_text(draft, "utf-8")
    with pytest.raises(DatasetError):
        agree(study, "04")
    assert "04" not in Roster.load(storage.roster_path(study.root)).sharing


def test_a_copy_of_everybody_has_the_same_trials_and_is_not_pooled_with_the_original(
    study: MadeStudy, tmp_path: Path
) -> None:
    agree(study, "03", "04")
    out = sharing.share(study.root, tmp_path / "copy").root
    assert trials(out) == trials(study.root)
    with pytest.raises(PalpateError):
        palpate.read(study.root, out)


def test_numbers_about_people_are_grouped_and_free_text_is_left_out() -> None:
    rows = [
        {"participant_id": f"sub-0{place}", "age": age, "hand": "right", "work": work}
        for place, (age, work) in enumerate([("20", "a baker"), ("29", "retired"), ("n/a", "n/a"), ("30.5", "none")], 1)
    ]
    described: dict[str, Any] = {
        "age": {"Description": "Age.", "Units": "year"},
        "hand": {"Description": "Hand.", "Levels": {"right": "right", "left": "left"}},
        "work": {"Description": "Work."},
    }
    kept, left_out = sharing._personal(rows, described, ())
    assert kept == ("age", "hand")
    assert [row["age"] for row in rows] == ["20 to 29", "20 to 29", "n/a", "30 to 39"]
    assert list(left_out) == ["work"]
    assert sharing._personal(rows, described, ["age"])[0] == ("hand",)
