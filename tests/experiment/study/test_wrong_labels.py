"""A session under another participant's label: who took part is on record, and the analysis takes them. SIMULATED."""

from __future__ import annotations

from pathlib import Path

import pytest

import palpate as library
from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.clock import ManualClock
from palpate.experiment.dataset import build, verify
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Withdrawal
from palpate.experiment.session import run
from palpate.experiment.study import withdrawal
from palpate.experiment.study.roster import Roster
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study
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


def tell(palpate: Palpate, study: MadeStudy, label: str, person: str, *more: str) -> int:
    task = study.tasks[0].tasks[0]
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
        run.prepare(study.file, rig_file, "02", first, study.root, None, console)
    assert "01" in refused.value.sentence()
