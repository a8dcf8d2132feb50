"""Which approval covers a session: the rules beside a naive model of them, and what no amendment may change."""

from __future__ import annotations

import hashlib
import random
import shutil
import time
from contextlib import closing
from datetime import date, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, register, verify
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Resumed
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.study import amendment, approvals, enrolment, roster
from palpate.experiment.study.admission import admit
from palpate.experiment.study.approvals import Approvals, Approved, InProgress, Stopped
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.experiment.session.scripted import START_NS
from tests.experiment.study.histories import BEGIN, Model, run_history
from tests.faults.wrong import copied

IN_PROGRESS: tuple[InProgress, ...] = ("old", "session", "new")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 and 02 did their first tasks."""
    return make_study(tmp_path_factory.mktemp("made") / "study")


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def change(study: MadeStudy, old: str, new: str) -> None:
    """Change the protocol, and seal it as approved on the first day of 2020."""
    text = study.file.read_text("utf-8")
    assert old in text
    study.file.write_text(text.replace(old, new), "utf-8")
    seal_again(study)


def seal_again(study: MadeStudy) -> None:
    protocol = study.protocol
    sealing.write(
        study.file,
        protocol,
        approval_number="18",
        board=protocol.ethics.board,
        replace=True,
        approved_on=date(2020, 1, 1),
        expires_on=date(2098, 1, 1),
    )


def drawn(draw: random.Random) -> tuple[Approvals, Model]:
    """A chain of renewals and amendments, as both sides have it."""
    days, version = [BEGIN], 0
    model, chain = Model(), list[Approved]()
    for number in range(1, draw.randint(2, 7)):
        version += number > 1 and draw.random() < 0.6
        own = version if draw.random() < 0.7 or version > max((one[0] for one in model.approvals), default=-1) else 0
        days.append(days[-1] + timedelta(days=draw.choice((0, 5))))
        in_progress: InProgress = draw.choice(IN_PROGRESS)
        model.approvals.append((own, f"{number:064d}", days[-1], date.max, in_progress, False))
        chain.append(
            Approved(
                number=number,
                protocol_sha256=f"{own:064d}",
                seal_sha256=f"{number:064d}",
                approved_on=days[-1],
                expires_on=date.max,
                from_on=days[-1],
                in_progress=in_progress,
                reconsent=False,
            )
        )
    return Approvals(tuple(chain)), model


def test_the_approval_of_a_session_is_that_of_a_naive_model() -> None:
    draw, compared = random.Random(1), 0
    for _ in range(300):
        known, model = drawn(draw)
        for _ in range(5):
            day = BEGIN + timedelta(days=draw.randint(0, 30))
            now = model.at(day)
            visit = draw.choice((None, draw.randint(0, now)))
            session = draw.choice((None, visit))
            model.sessions = {} if visit is None else {("01", "other"): (visit, True)}
            model.sessions |= {} if session is None else {("01", "task"): (session, False)}
            wanted = model.moved("01", "task", day)
            numbers = {
                "visit": None if visit is None else visit + 1,
                "session": None if session is None else session + 1,
            }
            found = known.covering(day, **numbers)
            assert (None if found is None else found.number - 1) == wanted
            compared += 1
    assert compared == 1500


@pytest.mark.parametrize("seed", [1, 5])
def test_a_history_stands_under_the_approvals_of_a_naive_model(seed: int, tmp_path: Path) -> None:
    assert run_history(tmp_path, seed, 15).total() > 0


def test_an_amendment_keeps_both_versions_and_their_sessions(study: MadeStudy) -> None:
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    planned = amendment.plan_approval(study.file, root=study.root, in_progress="session", reconsent=True)
    assert (planned.number, planned.in_progress, planned.reconsent) == (2, "session", True)
    kept = amendment.record(study.file, planned, root=study.root)
    assert kept == storage.protocol_path(study.root, 2)
    build.build(study.root)
    dataset = checks.load_sound(study.root)
    assert [version.exposure.vibration_peak_m_s2 for version in dataset.versions.values()] == [30.0, 25.0]
    _, roster, known = amendment.known_approvals(study.file, study.root)
    assert amendment.to_reconsent(study.root, known, roster, planned.from_on) == ("01", "02")
    with pytest.raises(RosterError, match="approval 2"):
        amendment.plan_approval(study.file, root=study.root)


def test_a_header_names_the_seal_and_one_that_is_gone_is_refused(study: MadeStudy) -> None:
    header = journal.read(study.journal()).header
    assert header.seal_sha256 == approvals.seal_sha256(storage.protocol_path(study.root))
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    planned = amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)
    amendment.record(study.file, planned, root=study.root)
    storage.protocol_path(study.root, 2).unlink()
    with pytest.raises(DatasetError, match=r"protocol-2\.toml"):
        checks.load(study.root)


def test_a_renewal_has_no_choices_and_a_seal_is_recorded_once(study: MadeStudy) -> None:
    seal_again(study)
    with pytest.raises(RosterError, match="--in-progress"):
        amendment.plan_approval(study.file, root=study.root, in_progress="old")
    planned = amendment.plan_approval(study.file, root=study.root)
    amendment.record(study.file, planned, root=study.root)
    assert len(checks.load_sound(study.root).versions) == 1
    with pytest.raises(RosterError, match="approval 2"):
        amendment.plan_approval(study.file, root=study.root)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ('id = "okamoto2012"', 'id = "another"', "study.id"),
        ('id = "typing paper"', 'id = "card"', "ids of materials"),
    ],
    ids=["study", "material"],
)
def test_another_study_is_no_amendment(study: MadeStudy, old: str, new: str, field: str) -> None:
    text = study.file.read_text("utf-8").replace('"typing paper"]', '"card"]' if "card" in new else '"typing paper"]')
    study.file.write_text(text, "utf-8")
    change(study, old, new)
    with pytest.raises(DatasetError, match=field):
        amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)


def test_nobody_changes_the_order_of_tasks_of_somebody_enrolled(study: MadeStudy) -> None:
    change(study, 'kind = "counterbalanced"', 'kind = "fixed"')
    with pytest.raises(DatasetError, match="participant 02"):
        amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)


def test_a_study_is_suspended_lifted_and_ended_in_this_order(study: MadeStudy) -> None:
    roster = Roster.load(storage.roster_path(study.root))
    with pytest.raises(RosterError, match="not suspended"):
        roster.append(Stopped, kind="lifted", from_on=BEGIN, reason="letter")
    for kind, day in (("suspended", 1), ("lifted", 3), ("ended", 9)):
        on = BEGIN + timedelta(days=day)
        amendment.stop(study.file, kind, on, "letter of the board", root=study.root)  # type: ignore[arg-type]
    _, _, known = amendment.known_approvals(study.file, study.root)
    stopped = [day for day in range(12) if known.stop(BEGIN + timedelta(days=day))]
    assert stopped == [1, 2, 9, 10, 11]
    with pytest.raises(RosterError, match="ended"):
        amendment.stop(study.file, "suspended", BEGIN + timedelta(days=20), "letter", root=study.root)


def test_stops_are_recorded_in_any_order(study: MadeStudy) -> None:
    for kind, day in (("ended", 9), ("suspended", 7), ("suspended", 2), ("lifted", 4), ("ended", 8)):
        on = BEGIN + timedelta(days=day)
        amendment.stop(study.file, kind, on, "letter of the board", root=study.root)  # type: ignore[arg-type]
    for kind, day in (("suspended", 3), ("lifted", 5), ("ended", 8)):
        with pytest.raises(RosterError):
            on = BEGIN + timedelta(days=day)
            amendment.stop(study.file, kind, on, "letter", root=study.root)  # type: ignore[arg-type]
    _, _, known = amendment.known_approvals(study.file, study.root)
    days = [BEGIN + timedelta(days=day) for day in range(10)]
    found = [stop.kind if (stop := known.stop(day)) else "-" for day in days]
    assert found == ["-", "-", "suspended", "suspended", "-", "-", "-", "suspended", "ended", "ended"]


def test_what_cannot_be_recorded_is_refused_before_anything_is_copied(study: MadeStudy) -> None:
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    planned = amendment.plan_approval(study.file, root=study.root, from_on=BEGIN, in_progress="old", reconsent=False)
    amendment.record(study.file, planned, root=study.root)
    change(study, "vibration_peak_m_s2 = 25.0", "vibration_peak_m_s2 = 24.0")
    with pytest.raises(RosterError, match=str(BEGIN)):
        earlier = BEGIN - timedelta(days=1)
        amendment.plan_approval(study.file, root=study.root, from_on=earlier, in_progress="old", reconsent=False)
    amendment.stop(study.file, "ended", date(2089, 1, 1), "letter", root=study.root)
    with pytest.raises(RosterError, match="2089-01-01"):
        amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)


def test_an_interrupted_amendment_is_not_anchored(study: MadeStudy) -> None:
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    orphan = storage.protocol_path(study.root, 2)
    shutil.copy(study.file, orphan)
    shutil.copy(approval.seal_path(study.file), approval.seal_path(orphan))
    assert checks.anchor(study.root).seal_sha256 == journal.read(study.journal()).header.seal_sha256


def test_an_interrupted_amendment_fixes_no_seal_before_the_first_session(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", sessions=0)
    orphan = storage.protocol_path(study.root, 2)
    shutil.copy(study.file, orphan)
    shutil.copy(approval.seal_path(study.file), approval.seal_path(orphan))
    own = study.tasks[0]
    beside = approval.seal_path(study.file)
    beside.write_text(beside.read_text("utf-8").replace('"17"', '"18"'), "utf-8")
    found = admit(study.root, study.file, study.protocol, own, own.tasks[0], (), date.today()).approved
    assert found.seal_sha256 == approvals.seal_sha256(study.file)
    told = {str(one.where): one.verdict for one in verify.verify(study.root).findings}
    assert told["sourcedata/protocol-2.toml"] == "unknown"


def test_a_seal_with_cr_lf_is_the_one_that_was_anchored_as_it_was(study: MadeStudy) -> None:
    checks.keep_anchor(study.root)
    seal, log = approval.seal_path(storage.protocol_path(study.root)), study.root / register.LOG
    as_made = seal.read_bytes()
    with_cr = as_made.replace(b"\n", b"\r\n")
    # palpate 0.2.0 anchored the hash of the file's bytes.
    old, new = (hashlib.sha256(data).hexdigest() for data in (as_made, with_cr))
    log.write_text(log.read_text("utf-8").replace(old, new), "utf-8")
    for data in (with_cr, as_made):
        seal.write_bytes(data)
        report = verify.verify(study.root)
        assert report.refused == 0
        assert {str(one.where): one.verdict for one in report.findings}["approval"] == "passes"
    log.write_text(log.read_text("utf-8").replace(new, "0" * 64), "utf-8")
    assert verify.verify(study.root).refused == 1


def test_a_session_that_went_on_without_an_approval_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: START_NS - 600_000_000_000)
    study = run_once(tmp_path / "study", date(2001, 9, 30))
    path = study.journal()
    for days in (1, 40):
        clock = ManualClock(START_NS + days * 86_400 * 10**9)
        with closing(journal.Journal(path, clock, journal.read(path))) as opened:
            opened.append(Resumed(torn="", remaining=()))
    dataset = checks.load(study.root)
    assert dataset.approvals is not None
    (found,) = verify._without_approval(dataset, dataset.approvals)
    assert found.verdict == "warns"
    assert "2001-10-19" in found.what


def test_nobody_is_enrolled_under_a_suspension(study: MadeStudy) -> None:
    amendment.stop(study.file, "suspended", date.today(), "letter", root=study.root)
    with pytest.raises(RosterError, match="suspended"):
        enrolling.enrol(study.file, "03", date.today(), root=study.root, seed=None)
    assert "03" not in Roster.load(storage.roster_path(study.root)).consent_on


@pytest.mark.parametrize(("place", "remedy"), [(0, "leave out --task"), (1, "this participant has no tasks left")])
def test_whose_session_was_ended_hears_what_is_left(study: MadeStudy, place: int, remedy: str) -> None:
    own = study.tasks[0]
    if place:
        study.run(study.header(own.participant, own.tasks[1]), keys="c")
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    planned = amendment.plan_approval(study.file, root=study.root, in_progress="new", reconsent=False)
    amendment.record(study.file, planned, root=study.root)
    with pytest.raises(RosterError, match=remedy):
        admit(study.root, study.file, study.protocol, own, own.tasks[place], (), date.today())


def run_once(folder: Path, expires_on: date) -> MadeStudy:
    """A study with one session, approved until a day."""
    study = make_study(folder, sessions=0)
    approval_number, board, approved_on = "17", study.protocol.ethics.board, date(2001, 1, 1)
    sealing.write(
        study.file,
        study.protocol,
        approval_number=approval_number,
        board=board,
        approved_on=approved_on,
        expires_on=expires_on,
        replace=True,
    )
    approvals.keep_first(study.root, study.file)
    first = study.tasks[0]
    study.run(study.header(first.participant, first.tasks[0]))
    build.build(study.root)
    return study


@pytest.mark.parametrize("zone", ["America/Los_Angeles", "Europe/Berlin", "Pacific/Kiritimati"])
def test_the_last_day_of_an_approval_ends_where_the_session_was_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, zone: str
) -> None:
    # The session begins at 01:46 UTC on 9 September, which is the evening of the 8th in Los Angeles.
    monkeypatch.setattr(time, "time_ns", lambda: START_NS - 600_000_000_000)
    monkeypatch.setattr(roster, "day", lambda ns: datetime.fromtimestamp(ns / 1e9, ZoneInfo(zone)).date())
    study = run_once(tmp_path / "study", date(2001, 9, 8))
    dataset = checks.load(study.root)
    assert ([one.what for one in dataset.damage], len(dataset.sessions)) == ([], 1)


def test_an_approval_may_end_on_the_last_day_that_there_is(tmp_path: Path) -> None:
    study = run_once(tmp_path / "study", date.max)
    assert verify.verify(study.root).refused == 0


def test_the_text_of_an_amendment_is_signed_before_its_first_day(study: MadeStudy) -> None:
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    planned = amendment.plan_approval(study.file, root=study.root, from_on=BEGIN, in_progress="session", reconsent=True)
    amendment.record(study.file, planned, root=study.root)
    before = Roster.load(storage.roster_path(study.root)).consents["01"]
    enrolment.consent(study.file, "01", date.today(), root=study.root)
    _, roster, known = amendment.known_approvals(study.file, study.root)
    assert (roster.consented["01"], roster.consents["01"]) == (2, [*before, date.today()])
    assert amendment.to_reconsent(study.root, known, roster, BEGIN) == ("02",)
    for file in (study.file, storage.protocol_path(study.root)):
        with pytest.raises(RosterError, match="already"):
            enrolment.consent(file, "01", date.today(), root=study.root)
    enrolment.consent(study.file, "01", date(2020, 5, 6), root=study.root, correction="a slip of the pen")
    assert Roster.load(storage.roster_path(study.root)).consented["01"] == 2
    study.file.write_text(study.file.read_text("utf-8").replace("= 25.0", "= 24.0"), "utf-8")
    with pytest.raises(DatasetError, match="a different version"):
        enrolment.consent(study.file, "02", date.today(), root=study.root)


def test_a_superseded_version_is_renewed_for_those_it_covers(study: MadeStudy) -> None:
    change(study, "vibration_peak_m_s2 = 30.0", "vibration_peak_m_s2 = 25.0")
    planned = amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=True)
    amendment.record(study.file, planned, root=study.root)
    change(study, "vibration_peak_m_s2 = 25.0", "vibration_peak_m_s2 = 30.0")
    renewed = amendment.plan_approval(study.file, root=study.root)
    amendment.record(study.file, renewed, root=study.root)
    dataset = checks.load_sound(study.root)
    assert dataset.protocol.exposure.vibration_peak_m_s2 == 25.0
    known, own, today = dataset.approvals, study.tasks[0], date.today()
    assert known is not None
    assert (known.version_on(today), known.consent_needed(3)) == (2, 1)
    admission = admit(study.root, study.file, study.protocol, own, own.tasks[1], (), today)
    assert admission.approved.number == 3
    with pytest.raises(DatasetError, match="approval 2"):
        enrolling.enrol(study.file, "03", today, root=study.root, seed=None)
    enrolling.enrol(storage.protocol_path(study.root, 2), "03", today, root=study.root, seed=None)
    assert Roster.load(storage.roster_path(study.root)).consented["03"] == 2
