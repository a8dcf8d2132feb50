"""A session under another participant's label: who took part is on record, and the analysis takes them. SIMULATED."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import palpate as library
from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset import build, status, verify
from palpate.experiment.desk.messages import TakeNote
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Note, Withdrawal
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import exposure, remarks, run
from palpate.experiment.session.kind import Sitting
from palpate.experiment.session.laboratory import open_laboratory
from palpate.experiment.session.run import RealEnds
from palpate.experiment.study import admission, approvals, withdrawal
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.session.scripted import START_NS, ScriptedConsole
from tests.faults.wrong import copied

SAID = ("--deviation", "The wrong label was typed.", "--done", "The roster says whose session it is.")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 did a first task, 02 none."""
    return make_study(tmp_path_factory.mktemp("made") / "study", sessions=1)


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def tell(palpate: Palpate, study: MadeStudy, label: str, person: str, *more: str, position: int = 0) -> int:
    task = study.tasks[0].tasks[position]
    given = (*SAID, "-p", label, "--took-part", f"{task}={person}", *more, "--dataset", study.root)
    return palpate("incident", study.file, *given)[0]


def withdraw(study: MadeStudy, who: str, *, erase: bool = False) -> None:
    withdrawal.withdraw(study.file, who, "asked to stop", root=study.root, rebuild=build.build, erase=erase)


def test_the_session_keeps_its_label_and_the_analysis_takes_the_person(study: MadeStudy, palpate: Palpate) -> None:
    task = study.tasks[0].tasks[0]
    assert tell(palpate, study, "01", "02") == 0
    read = library.read(study.root)
    assert set(read.attempts["participant"]) == {"02"}
    assert read.first_tasks == {"02": task}
    assert len(read.parts[0].incidents) == 2
    assert study.journal().exists()
    assert verify.verify(study.root).refused == 0
    withdraw(study, "02")
    withdrawn = library.read(study.root)
    assert {(one.participant, one.rule) for one in withdrawn.exclusions if one.trial is None} >= {("02", "withdrawn")}
    assert not withdrawn.attempts["included"].any()
    assert verify.verify(study.root).refused == 0


def test_two_exchanged_labels_are_exchanged_at_once(study: MadeStudy, palpate: Palpate) -> None:
    task = study.tasks[0].tasks[0]
    study.run(study.header("02", task))
    build.build(study.root)
    before = library.read(study.root).attempts.groupby("participant").size().to_dict()
    assert tell(palpate, study, "01", "02") == 2
    assert Roster.load(storage.roster_path(study.root)).incidents == []
    assert tell(palpate, study, "01", "02", "--exchanged") == 0
    after = library.read(study.root).attempts.groupby("participant").size().to_dict()
    assert after == {"01": before["02"], "02": before["01"]}


def test_data_of_somebody_who_takes_part_are_not_erased_with_a_label(study: MadeStudy, palpate: Palpate) -> None:
    assert tell(palpate, study, "01", "02") == 0
    for who in ("01", "02"):
        with pytest.raises(RosterError):
            withdraw(study, who, erase=True)
    assert study.journal().exists()
    withdraw(study, "01")
    assert not any(isinstance(entry, Withdrawal) for entry in journal.read(study.journal()).entries)
    assert verify.verify(study.root).refused == 0
    assert library.read(study.root).attempts["included"].any()
    withdraw(study, "02")
    withdraw(study, "01", erase=True)
    assert not study.journal().exists()
    assert verify.verify(study.root).refused == 0


@pytest.mark.parametrize("given", [("03", "01"), ("01", "09"), ("02", "01")])
def test_a_label_or_a_session_that_is_not_there_is_refused(
    study: MadeStudy, palpate: Palpate, given: tuple[str, str]
) -> None:
    assert tell(palpate, study, *given) == 2
    assert Roster.load(storage.roster_path(study.root)).incidents == []


@pytest.mark.parametrize("told", [[], {"sub-01": {}}, {"sub-01_task-a": {"Person": 2, "Withdrew": False}}])
def test_a_list_of_persons_that_cannot_be_read_is_refused(study: MadeStudy, told: object) -> None:
    path = study.root / "dataset_description.json"
    known = storage.json_of(path.read_bytes())
    known["Palpate"]["TookPart"] = told
    storage.write_json(path, known)
    with pytest.raises(DatasetError):
        library.read(study.root)


@pytest.mark.parametrize("later", [False, True])
def test_an_erasure_takes_the_persons_sessions_under_other_labels(
    study: MadeStudy, palpate: Palpate, later: bool
) -> None:
    """`later`: 01 had withdrawn when it was said whose session it is, and did another task of their own."""
    first, second = study.tasks[0].tasks
    sound = storage.voices_folder(study.root, "01") / f"task-{first}_trial-001_attempt-1.wav"
    if later:
        study.run(study.header("01", second))
        build.build(study.root)
        withdraw(study, "01")
        sound.parent.mkdir()
        sound.write_bytes(b"said")
    assert tell(palpate, study, "01", "02") == 0
    if not later:
        withdraw(study, "01")
    answers = 4
    assert withdrawal.count_recorded(study.file, "02", root=study.root) == (1, answers, 0)
    assert withdrawal.count_recorded(study.file, "01", root=study.root) == (1 + later, answers * (1 + later), 1)
    withdraw(study, "02", erase=True)
    assert Roster.load(storage.roster_path(study.root)).erased == {"02"}
    assert not list(study.root.rglob(f"*task-{first}_*"))
    assert bool(list(study.root.rglob(f"sub-01_task-{second}_*"))) == later
    assert verify.verify(study.root).refused == 0
    build.build(study.root)
    withdraw(study, "01", erase=True)
    assert verify.verify(study.root).refused == 0


def test_both_of_two_who_exchanged_labels_may_be_erased(study: MadeStudy, palpate: Palpate) -> None:
    task = study.tasks[0].tasks[0]
    study.run(study.header("02", task))
    build.build(study.root)
    assert tell(palpate, study, "01", "02", "--exchanged") == 0
    withdraw(study, "01")
    withdraw(study, "02", erase=True)
    assert not list(study.root.rglob("sub-0?_task-*"))
    withdraw(study, "01", erase=True)
    assert verify.verify(study.root).refused == 0


def test_what_a_backup_brings_back_of_an_erased_person_under_another_label_is_refused(
    made: MadeStudy, study: MadeStudy, palpate: Palpate
) -> None:
    assert tell(palpate, study, "01", "02") == 0
    withdraw(study, "01")
    withdraw(study, "02", erase=True)
    shutil.copy(made.journal(), study.journal())
    assert verify.verify(study.root).refused
    withdraw(study, "02", erase=True)
    assert not study.journal().exists()
    assert verify.verify(study.root).refused == 0


def test_a_paused_session_under_a_wrong_label_goes_on_for_nobody(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = study.tasks[0].tasks[0]
    study.journal().unlink()
    study.journal().with_suffix(".head").unlink()
    study.run(study.header("01", first), ["c", "q"])
    assert not run._is_complete(study.root, "01", first)
    assert tell(palpate, study, "01", "02") == 0
    rig_file = shipped("rigs/rehearsal.toml")
    monkeypatch.setattr(run, "usable_rig", lambda *_: rigs.load(rig_file))
    for who in ("01", "02"):
        console = ScriptedConsole(ManualClock(START_NS), "")
        with pytest.raises(RosterError) as refused:
            run.prepare(study.file, rig_file, who, first, study.root, None, console, ())
        assert refused.value.finding.remedy


def test_the_break_and_the_dose_are_of_the_sessions_of_the_person(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = study.tasks[0].tasks[1]
    assert tell(palpate, study, "01", "02") == 0
    console, clock = ScriptedConsole(ManualClock(START_NS), ""), ManualClock(START_NS)
    asked: list[object] = []
    monkeypatch.setattr(console, "ask", asked.append)
    counted: dict[str, list[str]] = {}

    def dose_before(journals: list[journal.Contents], _: object) -> float:
        counted[who] = [one.header.participant for one in journals if one.lines]
        raise RosterError("nothing is opened")

    monkeypatch.setattr(exposure, "dose_before", dose_before)
    breaks = {}
    for one in study.tasks[:2]:
        who = one.participant
        asked.clear()
        run._wait_for_break(study.root, study.protocol, one, second, clock, console)
        breaks[who] = len(asked)
        rig_file = shipped("rigs/headless.toml")
        sitting = Sitting(study.protocol, rigs.load(rig_file), rig_file, who, second, study.root, None, clock, None)
        with pytest.raises(RosterError), open_laboratory(sitting, RealEnds(console)):
            pass
    assert breaks == {"01": 0, "02": 1}
    assert counted == {"01": [], "02": ["01"]}


def test_who_did_a_task_under_another_label_does_it_no_second_time(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = study.tasks[0].tasks
    assert study.tasks[1].tasks == (second, first)
    assert tell(palpate, study, "01", "02") == 0
    roster = Roster.load(storage.roster_path(study.root))
    assert [roster.label_of(who, first) for who in ("01", "02")] == [None, "01"]
    assert [roster.label_of(who, second) for who in ("01", "02")] == ["01", "02"]
    rig_file = shipped("rigs/rehearsal.toml")
    monkeypatch.setattr(run, "usable_rig", lambda *_: rigs.load(rig_file))
    console = ScriptedConsole(ManualClock(START_NS), "")
    with pytest.raises(RosterError) as refused:
        run.prepare(study.file, rig_file, "02", first, study.root, None, console, ())
    assert "01" in refused.value.sentence()


def test_progress_notes_and_approvals_are_of_the_person(study: MadeStudy, palpate: Palpate) -> None:
    first = study.tasks[0].tasks[0]
    assert tell(palpate, study, "01", "02") == 0
    shown = status.status(study.root, DAY)
    assert {one.participant: (one.state, one.position) for one in shown.people} == {
        "01": ("to begin", 1),
        "02": ("under way", 2),
    }
    roster = Roster.load(storage.roster_path(study.root))
    known = roster.approvals(approvals.read_first(study.root, study.file))
    begun = {one.participant: admission.sessions_begun(study.root, one, known) for one in study.tasks[:2]}
    assert begun == {"01": {}, "02": {first: 1}}
    clock = ManualClock(START_NS)
    paused = [remarks.paused(study.root, one.participant, one.tasks, first, clock) for one in study.tasks[:2]]
    assert paused[0] is None
    assert paused[1] is not None
    assert paused[1].remark(TakeNote(text="A cold foot."))[0]
    assert isinstance(journal.read(study.journal()).entries[-1], Note)


def test_whose_label_another_used_goes_on_under_a_new_one(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """01 had done their second task when it was said that their first was another's."""
    first, second = study.tasks[0].tasks
    study.run(study.header("01", second))
    build.build(study.root)
    assert tell(palpate, study, "01", "02") == 0
    monkeypatch.setattr(run, "usable_rig", lambda *_: rigs.load(shipped("rigs/rehearsal.toml")))
    console = ScriptedConsole(ManualClock(START_NS), "")
    with pytest.raises(RosterError) as refused:
        run.prepare(study.file, shipped("rigs/rehearsal.toml"), "01", first, study.root, None, console, ())
    assert "palpate withdraw" in refused.value.sentence()
    withdraw(study, "01")
    assert enrolling.free_place(study.root, study.protocol, Roster.load(storage.roster_path(study.root))) == "01"
    enrolling.enrol(study.file, "03", DAY, root=study.root, seed=None)
    assert tell(palpate, study, "01", "03", position=1) == 0
    study.run(study.header("03", first))
    build.build(study.root)
    assert verify.verify(study.root).refused == 0
    read = library.read(study.root)
    assert read.attempts["included"].all()
    assert {*read.attempts.groupby(["participant", "task"]).groups} == {("02", first), ("03", first), ("03", second)}
    shown = status.status(study.root, DAY)
    assert {one.participant: one.state for one in shown.people} == {"02": "under way", "03": "done"}
    assert shown.retired == {"01": ("03",)}


def test_sessions_under_a_label_that_was_given_up_may_be_of_two_persons(study: MadeStudy, palpate: Palpate) -> None:
    study.run(study.header("01", study.tasks[0].tasks[1]))
    build.build(study.root)
    withdraw(study, "01")
    for who in ("03", "04"):
        enrolling.enrol(study.file, who, DAY, root=study.root, seed=None)
    assert tell(palpate, study, "01", "04") == 0
    assert tell(palpate, study, "01", "03", position=1) == 0
    shown = status.status(study.root, DAY)
    assert shown.retired == {"01": ("03", "04")}
    assert [one.participant for one in shown.people] == ["02", "03", "04"]
    for who in ("03", "04"):
        withdraw(study, who)
    withdraw(study, "01", erase=True)
    assert verify.verify(study.root).refused == 0
    shown = status.status(study.root, DAY)
    assert [one.participant for one in shown.those("withdrawn")] == ["03", "04"]
    assert " erased)" not in shown.text()
