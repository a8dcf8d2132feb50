"""What leaves the laboratory: of whom, with what in it, what is refused, and that it can be verified and analysed."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

import palpate
from palpate.experiment import storage
from palpate.experiment.dataset import bids, build, checks, tables
from palpate.experiment.dataset.outside import shared, sharing
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.messages import Repeat
from palpate.experiment.errors import DatasetError, PalpateError, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.records import chain, entries
from palpate.experiment.study import amendment, withdrawal
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses, anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.protocol.test_floor import named
from tests.experiment.session.kinds.presented.test_stimuli import recording

TABLE = '[sharing]\nstatement = "May your trials be shared?"\nsmallest_group = 1\nkeep_labels = true\n\n[duration]'


DATES = {
    "# approved_on = 2000-01-01": "approved_on = 2001-01-01",
    "# expires_on = 2001-01-01": "expires_on = 2099-01-01",
}


def allowed(least: int = 1) -> dict[str, str]:
    table = TABLE.replace("smallest_group = 1", f"smallest_group = {least}")
    return {"format = 4": "format = 7", "[duration]": table, **DATES}


def licensed(study: MadeStudy) -> None:
    path = study.root / shared.DESCRIPTION
    known = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps({**known, "License": "CC-BY-4.0", "Authors": ["A. Author"]}), "utf-8")


def agree(study: MadeStudy, *labels: str) -> None:
    for label in labels:
        enrolling.sharing(study.file, label, True, root=study.root)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_study(tmp_path_factory.mktemp("sharing") / "study", enrolled=5, sessions=4, further=allowed())
    licensed(made)
    agree(made, "01", "02", "03", "05")
    enrolling.sharing(made.file, "03", False, root=made.root)
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


def test_a_changed_and_a_lost_file_show(study: MadeStudy, tmp_path: Path, refuses: Refuses) -> None:
    out = sharing.share(study.root, tmp_path / "copy").root
    assert tables.check_analysed(out) == ()
    (table,) = out.glob("sub-01/beh/*_events.tsv")
    table.write_text(table.read_text("utf-8").replace("copy paper", "typing paper", 1), "utf-8")
    (out / "participants.json").unlink()
    known = facts(out)
    (out / shared.DESCRIPTION).write_text(json.dumps({**known, "DatasetDOI": "doi:10.5072/x"}), "utf-8")
    names = {Path(str(one.where)).name for one in verify(out).findings if one.refuses}
    assert names == {table.name, "participants.json"}
    with refuses(DatasetError):
        tables.check_analysed(out)


def test_a_foreign_file_is_told_and_refuses_only_where_it_could_be_read(study: MadeStudy, tmp_path: Path) -> None:
    out = sharing.share(study.root, tmp_path / "copy").root
    for theirs in ("LICENSE", "CHANGES", "README", ".bidsignore"):
        (out / theirs).write_text("A text.", "utf-8")
    foreign = {".DS_Store", ".gitmodules", "README.md", "sub-02/beh/notes.txt"}
    for name in foreign:
        (out / name).write_text("A text.", "utf-8")
    told = {str(one.where): one.verdict for one in verify(out).findings if one.verdict != "passes"}
    assert told == dict.fromkeys(foreign, "unknown")
    assert tables.check_analysed(out) == ()
    (table,) = out.glob("sub-01/beh/*_events.tsv")
    third = out / "sub-03" / "beh" / table.name.replace("sub-01", "sub-03")
    third.parent.mkdir(parents=True)
    shutil.copy(table, third)
    assert {str(one.where) for one in verify(out).findings if one.refuses} == {third.relative_to(out).as_posix()}


def test_a_laboratorys_own_recordings_and_the_order_of_the_sessions_stay(study: MadeStudy, tmp_path: Path) -> None:
    (table,) = study.root.glob("sub-01/beh/*_events.tsv")
    own = table.name.replace("events.tsv", "recording-ecg_physio")
    for suffix in ("tsv.gz", "json"):
        table.with_name(f"{own}.{suffix}").write_text('{"Columns": []}', "utf-8")
    out = sharing.share(study.root, tmp_path / "copy").root
    assert {path.name.split("_")[2] for path in out.rglob("*_physio.*")} == {"recording-foot"}
    assert len({path.stat().st_mtime_ns for path in (out, *out.rglob("*"))}) == 1


def test_protocols_of_a_copy_are_those_of_the_dataset_and_no_day_tells_who_came_late(
    study: MadeStudy, tmp_path: Path
) -> None:
    text = study.file.read_text("utf-8").replace("vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    study.file.write_text(text, "utf-8")
    approval.seal_path(study.file).unlink()
    sealing.write(
        study.file,
        study.protocol,
        approval_number="18",
        board=study.protocol.ethics.board,
        approved_on=date(2001, 1, 1),
        expires_on=date(2099, 1, 1),
    )
    planned = amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)
    amendment.record(study.file, planned, root=study.root)
    build.build(study.root)
    out = sharing.share(study.root, tmp_path / "copy").root
    for number in (1, 2):
        both = [approval.sha256(files.load(storage.protocol_path(root, number))) for root in (study.root, out)]
        assert both[0] == both[1]
    assert [sorted(one) for one in facts(out)["Palpate"]["Versions"]] == [["Protocol", "Sessions"]] * 2
    assert {one.verdict for one in verify(out).findings} == {"passes"}


def test_a_smallest_group_is_of_those_with_the_same_first_task_and_versions() -> None:
    rows = [{"participant_id": f"sub-0{place}", "first_task": task} for place, task in enumerate("aaab", 1)]
    assert sharing._smallest(rows[:3], []) == 3
    assert sharing._smallest(rows, []) == 1
    versions = [
        {"Protocol": "protocol.toml", "Sessions": ["sub-01_task-a", "sub-02_task-a", "sub-03_task-a"]},
        {"Protocol": "protocol-2.toml", "Sessions": ["sub-03_task-b"]},
    ]
    assert sharing._smallest(rows[:3], versions) == 1
    assert sharing._smallest(rows[:2], versions) == 2


def test_whose_only_session_has_not_ended_is_absent(study: MadeStudy, tmp_path: Path) -> None:
    place = study.tasks[4]
    study.run(study.header(place.participant, place.tasks[0]))
    path = study.journal(4)
    lines = path.read_bytes().splitlines(keepends=True)[:-2]
    path.write_bytes(b"".join(lines))
    last = hashlib.sha256(lines[-1].removesuffix(b"\n")).hexdigest()
    chain.head_path(path).write_text(f"{len(lines):012d} {last}\n", "utf-8")
    copy = sharing.share(study.root, tmp_path / "copy")
    assert (copy.participants, sum(copy.absent.values())) == (2, 3)
    rows = (copy.root / "participants.tsv").read_text("utf-8").splitlines()[1:]
    assert {row.partition("\t")[0] for row in rows} == {folder.name for folder in copy.root.glob("sub-*")}


def test_reasons_of_palpate_are_shared_and_typed_ones_are_not(study: MadeStudy, tmp_path: Path) -> None:
    enrolling.enrol(study.file, "06", DAY, root=study.root, seed=None)
    agree(study, "06")
    place = study.tasks[5]
    typed = Repeat(trial=2, reason="asked Ms Example")
    study.run(study.header(place.participant, place.tasks[0]), ["r", typed, *"capt"])
    build.build(study.root)
    out = sharing.share(study.root, tmp_path / "copy").root
    assert b"Example" not in b"".join(path.read_bytes() for path in out.rglob("*") if path.is_file())
    reasons = {*palpate.read(out).attempts["redo_reason"]} - {bids.MISSING}
    assert reasons == {entries.ASKED_FOR, sharing.NOT_SHARED}


@pytest.mark.parametrize("licensed", [True, False])
def test_a_recording_beside_the_protocol_is_shared_with_a_licence_alone(
    study: MadeStudy, tmp_path: Path, licensed: bool
) -> None:
    file = recording(tmp_path)
    dataset = replace(checks.load_sound(study.root), protocol=files.load(file), versions={}, approvals=None)
    assert list(sharing._stimuli(study.root, dataset)) == ["felt.wav"]
    written = sharing._protocols(tmp_path / "copy", dataset, licensed=licensed)
    kept = written.get(tmp_path / "copy" / "sourcedata" / "felt.wav")
    assert kept == ((tmp_path / "felt.wav").read_bytes() if licensed else None)


def test_thresholds_of_an_earlier_study_are_never_shared(study: MadeStudy, tmp_path: Path) -> None:
    dataset = replace(checks.load_sound(study.root), protocol=named(tmp_path, "everybody"), versions={}, approvals=None)
    written = sharing._protocols(tmp_path / "copy", dataset, licensed=True)
    assert {path.name for path in written} == {"protocol.toml", "protocol.seal.toml"}
    assert sharing._of_people(dataset.protocol) == {"thresholds.csv"}


@pytest.mark.parametrize("lacking", ["table", "licence", "agreement", "group"])
def test_what_may_not_be_shared_is_refused_and_nothing_is_written(tmp_path: Path, lacking: str) -> None:
    further = {} if lacking == "table" else allowed(2 if lacking == "group" else 1)
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
    assert enrolling.sharing(study.file, "01", False, root=study.root) == day
    withdrawal.withdraw(study.file, "02", "asked", root=study.root, rebuild=build.build, erase=True)
    second = sharing.share(study.root, tmp_path / "second")
    assert second.absent == {"declined": 1, "no session": 1, "withdrew": 1}
    assert not storage.shared_label_path(study.root, "02").exists()
    assert verify(study.root).refused == 0


def test_an_agreement_holds_for_the_table_that_was_agreed_to_and_is_of_an_approved_version(study: MadeStudy) -> None:
    dataset = tables.check_tables(study.root)
    assert dataset.protocol.sharing is not None
    rule = dataset.protocol.sharing.model_copy(update={"smallest_group": 2})
    other = replace(dataset, protocol=dataset.protocol.model_copy(update={"sharing": rule}))
    assert sharing._chosen(dataset, ["01", "02"])[0] == ["01", "02"]
    with pytest.raises(RosterError):
        sharing._chosen(other, ["01", "02"])
    draft = study.file.read_text("utf-8").replace("smallest_group = 1", "smallest_group = 2")
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
