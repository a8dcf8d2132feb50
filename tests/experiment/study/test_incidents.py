"""Adverse events and deviations: on record from the console and by a command, and kept whoever goes. All SIMULATED."""

from __future__ import annotations

import json
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import pytest

import palpate as library
from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, status, tables, verify
from palpate.experiment.dataset.register import LOG
from palpate.experiment.desk.messages import TellIncident
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Note
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import remarks
from palpate.experiment.study import people, withdrawal
from palpate.experiment.study.people import incidents, keeping
from palpate.experiment.study.people.incidents import report
from palpate.experiment.study.roster import Roster
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.experiment.session.scripted import START_NS
from tests.faults.wrong import copied

FALL = TellIncident(sort="adverse event", text="Slipped off the panel.", done="The session was ended.", trial=2)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 did a first task, 02 none."""
    return make_study(tmp_path_factory.mktemp("made") / "study", sessions=1)


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def on_record(study: MadeStudy) -> list[tuple[int, str, str]]:
    known = Roster.load(storage.roster_path(study.root)).incidents
    return [(one.number, one.kind, one.what) for one in known]


def notes(path: Path) -> list[tuple[int | None, str]]:
    return [(one.trial, one.text.partition(" in ")[0]) for one in journal.read(path).entries if isinstance(one, Note)]


def test_an_event_is_told_in_a_session_and_in_a_pause(study: MadeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(study.root.parent / "home"))
    keeping.keep(study.protocol, study.root, "02", people.Person(name="Slipping Jimmy"))
    named = FALL.model_copy(update={"text": "Jimmy fell."})
    own = study.tasks[1]
    study.run(study.header("02", own.tasks[0]), remarks=(FALL, named))
    path = storage.journal_path(study.root, "02", own.tasks[0])
    paused = remarks.paused(study.root, "02", (), own.tasks[0], ManualClock(START_NS))
    assert paused is not None
    said = [paused.remark(one)[0] for one in (FALL.model_copy(update={"sort": "deviation", "trial": None}), named)]
    assert said == [True, False]
    assert on_record(study) == [(1, "adverse event", FALL.text), (2, "deviation", FALL.text)]
    assert notes(path) == [(2, "Adverse event 1"), (None, "Deviation 2")]
    build.build(study.root)
    assert verify.verify(study.root).refused == 0


def test_practice_keeps_an_event_in_its_journal_alone(study: MadeStudy) -> None:
    header = study.header("02", study.tasks[1].tasks[0]).model_copy(update={"purpose": "PRACTICE"})
    note, _ = remarks.record_incident(study.protocol, study.root, header, FALL)
    assert note is not None
    assert (note.trial, FALL.text in note.text, FALL.done in note.text) == (2, True, True)
    assert on_record(study) == []


def test_a_command_records_lists_and_tells_of_the_board(study: MadeStudy, palpate: Palpate) -> None:
    today, on = date.today(), ("--dataset", study.root)
    what = ("--deviation", "The door was open.", "--done", "It was closed.")
    assert palpate("incident", study.file, *what, "--on", "2001-09-10", "-p", "01", *on)[0] == 0
    assert palpate("incident", study.file, "--number", 1, "--informed-on", today, *on)[0] == 0
    assert palpate("incident", study.file, "--number", 1, "--informed-on", today, *on)[0] == 2
    (known,) = Roster.load(storage.roster_path(study.root)).incidents
    assert (known.happened_on, known.informed_on) == (date(2001, 9, 10), today)
    assert notes(study.journal()) == [(None, "Deviation 1 is")]
    assert known.sentence in palpate("incident", study.file, *on)[1]
    shown = status.status(study.root, today)
    assert shown.incidents == (known,)
    assert known.what in shown.text()
    assert library.read(study.root).parts[0].incidents == (known.sentence,)
    for given in (("--adverse", "A fall."), ("--done", "Nothing."), what[:2], (*what, "--adverse", "A fall.")):
        assert palpate("incident", study.file, *given, *on)[0] == 2


def test_a_session_that_takes_no_note_leaves_the_event_on_record_once(study: MadeStudy, palpate: Palpate) -> None:
    what = ("--deviation", "The door was open.", "--done", "It was closed.", "--dataset", study.root)
    with journal.locked(storage.participant_folder(study.root, "01"), "01"):
        assert palpate("incident", study.file, *what, "-p", "01")[0] == 0
    assert (on_record(study), notes(study.journal())) == ([(1, "deviation", what[1])], [])
    assert (study.root / LOG).exists()


def test_tables_that_lack_what_the_roster_tells_of_an_event_are_older(study: MadeStudy) -> None:
    def refused() -> set[tuple[str, object]]:
        return {(one.place(), one.remedy) for one in verify.verify(study.root).findings if one.refuses}

    again = checks.build_again(study.root, "make it again")
    report(study.protocol, study.root, "deviation", what="b", done="c")
    assert refused() == {("dataset_description.json", again)}
    build.build(study.root)
    incidents.inform(study.root, 1, date.today())
    assert refused() == {("dataset_description.json", again)}
    build.build(study.root)
    assert refused() == set()
    path = study.root / "dataset_description.json"
    known = storage.json_of(path.read_bytes())
    del known["Palpate"]["Incidents"]
    storage.write_json(path, known)
    with pytest.raises(DatasetError):
        tables.check_analysed(study.root)


def test_what_happened_stays_after_an_erasure_and_says_of_nobody(study: MadeStudy) -> None:
    report(study.protocol, study.root, "adverse event", what="Felt dizzy.", done="A chair was given.")
    withdrawal.withdraw(study.file, "01", "asked to stop", root=study.root, rebuild=build.build, erase=True)
    assert on_record(study) == [(1, "adverse event", "Felt dizzy.")]
    lines = storage.roster_path(study.root).read_text("utf-8").splitlines()
    (line,) = (json.loads(one)["entry"] for one in lines if "dizzy" in one)
    assert "participant" not in line
    assert verify.verify(study.root).refused == 0


def test_a_day_to_come_and_a_text_that_is_no_line_are_refused(study: MadeStudy) -> None:
    ahead = date.today() + timedelta(days=2)
    with pytest.raises(RosterError):
        report(study.protocol, study.root, "deviation", what="a\nb", done="c")
    wrong: tuple[dict[str, Any], ...] = (
        {"happened_on": ahead},
        {"informed_on": ahead},
        {"informed_on": date(2001, 1, 1)},
    )
    for days in wrong:
        with pytest.raises(RosterError):
            report(study.protocol, study.root, "deviation", what="b", done="c", **days)
    with pytest.raises(RosterError):
        incidents.inform(study.root, 1, date.today())
    assert on_record(study) == []
    report(study.protocol, study.root, "deviation", what="b", done="c")
    for day in (ahead, date.today() - timedelta(days=2)):
        with pytest.raises(RosterError):
            incidents.inform(study.root, 1, day)
    assert Roster.load(storage.roster_path(study.root)).incidents[0].informed_on is None
