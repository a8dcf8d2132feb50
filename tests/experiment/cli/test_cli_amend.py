"""`palpate amend`: what it shows, records and refuses; what `palpate run` then says to whom. All SIMULATED."""

from __future__ import annotations

import contextlib
import re
import shlex
import shutil
from datetime import date, timedelta
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

import palpate as library
from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset import status, verify
from palpate.experiment.errors import DatasetError, PalpateError, Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import chain
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import run
from palpate.experiment.study import amendment
from palpate.experiment.study.admission import admit
from palpate.experiment.study.roster import Roster
from tests.approved import anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.experiment.session.scripted import START_NS, ScriptedConsole
from tests.faults.wrong import copied

SEAL = ("--approval-number", "18", "--approved-on", "2020-01-01", "--expires-on", "2098-01-01", "--replace", "--yes")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 and 02 did their first tasks, 03 none."""
    return make_study(tmp_path_factory.mktemp("made") / "study", enrolled=3)


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def told(text: str, study: MadeStudy) -> str:
    """What was said, on any day, anywhere."""
    on_a_day = anywhere(text, study.root.parent).replace(str(date.today()), "TODAY")
    return re.sub(r"([0-9a-f]{4}-){3}[0-9a-f]{4}", "NUMBER", on_a_day)


def changed(study: MadeStudy, palpate: Palpate) -> tuple[object, ...]:
    """Seal another version, and return the command that amends."""
    text = study.file.read_text("utf-8")
    text = text.replace("vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0").replace(
        "Taking part", "Participation"
    )
    study.file.write_text(text, "utf-8")
    assert palpate("seal", study.file, *SEAL)[0] == 0
    return "amend", study.file, "--dataset", study.root


def to_consent(study: MadeStudy, today: date) -> list[str]:
    """Whom a reminder names who has to consent to an amendment."""
    reminders = status.status(study.root, today).reminders
    found = [one for one in reminders if isinstance(one.remedy, Remedy) and one.remedy.command[1] == "consent"]
    return [label for one in found for label in re.findall(r"\b\d\d\b", one.what)]


def test_a_study_is_amended_after_it_was_shown_what_differs(
    study: MadeStudy, palpate: Palpate, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    amend = changed(study, palpate)
    code, _, err = palpate(*amend)
    assert code == 2
    page = tmp_path / "changes.html"
    said = palpate(*amend, "--in-progress", "session", "--reconsent", "everybody", "--yes", "--html", page)
    assert said[0] == 0
    assert [told(err, study), told(said[1], study)] == approved
    assert page.read_text("utf-8").count("<tr>") == 3
    assert verify.verify(study.root).refused == 0
    assert to_consent(study, date.today()) == ["01", "02", "03"]
    (part,) = library.read(study.root).parts
    assert [(one.file, len(one.sessions)) for one in part.versions] == [("protocol.toml", 2), ("protocol-2.toml", 0)]
    assert part.protocol == part.versions[-1].protocol


def test_each_participant_is_refused_what_does_not_cover_them(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    amend = changed(study, palpate)
    assert palpate(*amend, "--in-progress", "old", "--reconsent", "everybody", "--yes")[0] == 0
    old = storage.protocol_path(study.root)
    own = study.tasks

    def refusal(file: Path, place: int) -> str:
        allocation = own[place]
        task = allocation.tasks[1 if place < 2 else 0]
        try:
            admit(study.root, file, files.load(file), allocation, task, ("--rig", "rig.toml"), date.today())
        except PalpateError as error:
            return told(error.sentence(), study)
        return "may be run"

    found = [refusal(old, 0), refusal(study.file, 0), refusal(old, 2), refusal(study.file, 2)]
    assert palpate("consent", study.file, "-p", "03", "--consent-on", date.today(), "--dataset", study.root)[0] == 0
    found.append(refusal(study.file, 2))
    assert palpate("seal", study.file, *SEAL)[0] == 0
    again = ("--suspended-on", date.today(), "--reason", "letter of the board")
    study.file.with_suffix(".seal.toml").write_text(
        study.file.with_suffix(".seal.toml").read_text("utf-8").replace('"18"', '"19"'), "utf-8"
    )
    found.append(refusal(study.file, 2))
    assert palpate("amend", study.file, "--dataset", study.root, *again)[0] == 0
    found += [refusal(study.file, 2), told(status.status(study.root, date.today()).seal, study)]
    assert found == approved


def test_the_command_that_a_session_proposes_has_all_that_was_given(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert palpate(*changed(study, palpate), "--in-progress", "old", "--reconsent", "nobody", "--yes")[0] == 0
    monkeypatch.setattr(run, "usable_rig", lambda *_: rigs.load(shipped("rigs/rehearsal.toml")))
    given = ["-p", "01", "--rig", "our rig.toml", "--recordings", "our takes", "--task", study.tasks[0].tasks[1]]
    given += ["--by", "desk-2", "--lines", "--dataset", str(study.root)]
    code, _, err = palpate("run", study.file, *given)
    assert code == 2
    proposed = shlex.split(err[err.index("palpate run") :])
    assert proposed[:3] == ["palpate", "run", str(storage.protocol_path(study.root))]
    assert sorted(proposed[3:]) == sorted(given)
    code, _, err = palpate(*proposed[1:])
    assert (code, "palpate run" in err) == (2, False)


def test_a_visit_stops_where_an_amendment_has_the_next_task_under_another_version(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, (_, second) = shipped("rigs/rehearsal.toml"), study.tasks[0].tasks
    monkeypatch.setattr(run, "usable_rig", lambda *_: rigs.load(rig))
    waited: list[object] = []
    monkeypatch.setattr(run, "_wait_for_break", lambda *given: waited.append(given))
    console = ScriptedConsole(ManualClock(START_NS), "")
    visit = run.prepare(study.file, rig, "01", second, study.root, None, console, ("--rig", "rig.toml"))
    assert palpate(*changed(study, palpate), "--in-progress", "session", "--reconsent", "nobody", "--yes")[0] == 0
    with pytest.raises(DatasetError) as refused:
        visit.session(second)
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    assert remedy.command[:3] == ("palpate", "run", str(storage.protocol_path(study.root, 2)))
    assert waited == []


def test_status_knows_a_session_that_was_run_where_the_amendment_began_a_day_earlier(
    study: MadeStudy, palpate: Palpate
) -> None:
    today = date.today()
    assert palpate(*changed(study, palpate), "--in-progress", "session", "--reconsent", "everybody", "--yes")[0] == 0
    assert palpate("consent", study.file, "-p", "03", "--consent-on", today, "--dataset", study.root)[0] == 0
    third = study.tasks[2]
    _, _, known = amendment.known_approvals(study.file, study.root)
    new = {"seal_sha256": known.approved[-1].seal_sha256, "consent_sha256": known.approved[-1].protocol_sha256}
    study.run(study.header(third.participant, third.tasks[0]).model_copy(update=new))
    assert to_consent(study, today - timedelta(days=1)) == ["01", "02"]
    roster = storage.roster_path(study.root)
    for path in (roster, chain.head_path(roster)):
        path.unlink()
    own = storage.journal_path(study.root, third.participant, third.tasks[0]).relative_to(study.root).as_posix()
    refused = {str(one.where): one.remedy for one in verify.verify(study.root).findings if one.refuses}
    assert refused[own] == verify.ROSTER_FIRST


@pytest.mark.parametrize("begins", [0, 7])
def test_status_of_a_file_under_which_nobody_is_run_says_so(study: MadeStudy, palpate: Palpate, begins: int) -> None:
    old = study.file.with_name("old.toml")
    today = date.today()
    for end in (".toml", ".seal.toml"):
        shutil.copy(study.file.with_suffix(end), old.with_suffix(end))
    amend = (*changed(study, palpate), "--from", today + timedelta(days=begins))
    assert palpate(*amend, "--in-progress", "session", "--reconsent", "nobody", "--yes")[0] == 0
    shutil.copytree(study.root, study.file.with_name("participants") / "okamoto2012")

    def warned(file: Path) -> bool:
        remedies = [one.remedy for one in status.status(file, today).reminders]
        return any(isinstance(one, Remedy) and one.command[1] == "amend" for one in remedies)

    with contextlib.chdir(study.file.parent):
        assert [warned(old), warned(study.file)] == [begins == 0, False]


def test_what_says_nothing_is_refused(study: MadeStudy, palpate: Palpate) -> None:
    amend = ("amend", study.file, "--dataset", study.root)
    roster = storage.roster_path(study.root).read_bytes()
    assert palpate(*amend)[0] == 2
    assert palpate(*amend, "--reason", "letter")[0] == 2
    assert palpate(*amend, "--suspended-on", "2026-01-01")[0] == 2
    assert palpate(*amend, "--suspended-on", "2026-01-01", "--ended-on", "2026-01-01", "--reason", "letter")[0] == 2
    assert storage.roster_path(study.root).read_bytes() == roster
    assert not amendment.known_approvals(study.file, study.root)[1].stopped


def test_an_end_is_asked_about_and_a_choice_beside_it_refused(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    end = ("amend", study.file, "--dataset", study.root, "--ended-on", "2090-12-31", "--reason", "letter")
    roster = storage.roster_path(study.root).read_bytes()
    monkeypatch.setattr("builtins.input", lambda _: "amend")
    assert palpate(*end)[0] == 2
    page = tmp_path / "page.html"
    for extra in (("--in-progress", "old"), ("--reconsent", "nobody"), ("--from", "2090-01-01"), ("--html", page)):
        assert palpate(*end, *extra, "--yes")[0] == 2
    assert storage.roster_path(study.root).read_bytes() == roster
    monkeypatch.setattr("builtins.input", lambda _: "end")
    assert palpate(*end)[0] == 0
    assert [one.kind for one in amendment.known_approvals(study.file, study.root)[1].stopped] == ["ended"]


def test_a_suspension_from_before_a_lift_on_record_says_that_it_is_over(study: MadeStudy, palpate: Palpate) -> None:
    today, earlier, letter = date.today(), date.today() - timedelta(days=1), ("--reason", "letter of the board")
    amend = ("amend", study.file, "--dataset", study.root)
    for option, day, over in (
        ("--suspended-on", today, False), ("--lifted-on", today, False), ("--suspended-on", earlier, True),
        ("--suspended-on", today, False),
    ):  # fmt: skip
        code, out, _ = palpate(*amend, option, day, *letter)
        assert (code, f"a lift from {today}" in out) == (0, over)
    assert amendment.known_approvals(study.file, study.root)[2].stop(today) is not None


def test_a_suspension_alone_is_recorded_of_a_dataset_that_is_damaged(study: MadeStudy, palpate: Palpate) -> None:
    amend, (path, *_) = changed(study, palpate), storage.journals(study.root)
    path.write_bytes(path.read_bytes().replace(b'"answered"', b'"answereD"', 1))
    roster = storage.roster_path(study.root)
    kept = roster.read_bytes()
    letter, today = ("--reason", "letter"), date.today()
    assert palpate(*amend, "--in-progress", "old", "--reconsent", "nobody", "--yes")[0] == 2
    assert palpate(*amend, "--ended-on", today, *letter, "--yes")[0] == 2
    assert roster.read_bytes() == kept
    assert palpate(*amend, "--suspended-on", today, *letter)[0] == 2
    assert [one.kind for one in Roster.load(roster).stopped] == ["suspended"]
    told = ("--deviation", "door open", "--done", "closed it", "--dataset", study.root)
    assert palpate("incident", study.file, *told)[0] == 2
    assert len(Roster.load(roster).incidents) == 1


def test_a_lost_approval_accuses_no_seal_of_another(study: MadeStudy, palpate: Palpate) -> None:
    assert palpate(*changed(study, palpate), "--in-progress", "old", "--reconsent", "nobody", "--yes")[0] == 0
    lost = storage.protocol_path(study.root, 2)
    for path in (lost, approval.seal_path(lost)):
        path.unlink()
    refused = {str(one.where) for one in verify.verify(study.root).findings if one.refuses}
    assert refused == {"sourcedata/protocol-2.toml", "seals"}


def test_a_seal_that_has_expired_renews_nothing(study: MadeStudy, palpate: Palpate) -> None:
    today = date.today()
    days = ("--approved-on", today - timedelta(9), "--expires-on", today - timedelta(1))
    assert palpate("seal", study.file, "--approval-number", "9", *days, "--replace", "--yes")[0] == 0
    with pytest.raises(RosterError) as refused:
        amendment.plan_approval(study.file, root=study.root)
    assert isinstance(refused.value.finding.remedy, Remedy)
    assert refused.value.finding.remedy.command[1] == "seal"
    code, _, err = palpate("enrol", study.file, "-p", "04", "--dataset", study.root)
    assert (code, str(today - timedelta(1)) in err) == (0, True)
