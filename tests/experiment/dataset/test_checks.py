"""What is not of a dataset never enters its tables: everything that `tests/faults/wrong.py` does is refused by name."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, register, tables
from palpate.experiment.dataset.checks import Dataset
from palpate.experiment.dataset.status import status
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, Finding, PalpateError, Remedy, RosterError
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Withdrawal
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.study import enrolment, roster, withdrawal
from palpate.experiment.study.people import enrolling
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.records.test_journal import chained
from tests.faults.wrong import ALONE, WRONG, Act, Wrong, base, copied


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    return base(tmp_path_factory.mktemp("made") / "study")


def test_a_study_whose_journals_are_its_own_is_believed(made: MadeStudy) -> None:
    found = tables.check_tables(made.root)
    assert (found.purpose, len(found.sessions)) == ("STUDY", 2)
    assert found.roster is not None
    assert list(found.roster.consent_on) == ["01", "02", "03"]
    assert checks.has_journals(made.root)


@pytest.mark.parametrize(("key", "other"), [("task_kind", "tapping"), ("design", "comparison")])
def test_a_header_of_another_kind_or_design_than_the_protocols_is_refused(
    made: MadeStudy, key: str, other: str, tmp_path: Path
) -> None:
    study = copied(made, tmp_path / "study")
    header = study.header("03", study.tasks[2].tasks[0]).model_copy(update={key: other})
    path = storage.journal_path(study.root, "03", header.task)
    # No entry of a trial follows: one of another kind than the header's cannot be read.
    with closing(journal.Journal(path, ManualClock(0), journal.read_if_begun(path))) as opened:
        opened.append(header)
    with pytest.raises(DatasetError) as refused:
        checks.load_sound(study.root)
    assert refused.value.finding.where == study.journal(2)
    assert f"{key} {other}" in refused.value.finding.what


def test_force_is_kept_before_the_first_attempt_of_a_session_that_has_begun(made: MadeStudy, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    header = study.header("03", study.tasks[2].tasks[0])
    path = storage.journal_path(study.root, "03", header.task)
    with closing(journal.Journal(path, ManualClock(0), journal.read_if_begun(path))) as opened:
        opened.append(header)
    storage.raw_path(path, "force.bin").write_bytes(b"x" * 55)
    assert path in dict(checks.load_sound(study.root).sessions)
    path.write_bytes(b"")
    chain.head_path(path).unlink()
    with pytest.raises(DatasetError) as refused:
        checks.load_sound(study.root)
    assert refused.value.finding.where == path


@pytest.mark.parametrize("wrong", WRONG, ids=[one.name for one in WRONG])
def test_what_is_wrong_is_refused_by_name(made: MadeStudy, wrong: Wrong, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    wrong.act(study, tmp_path)
    with pytest.raises(PalpateError, match=wrong.said) as refused:
        tables.check_tables(study.root)
    assert "/sourcedata/" in str(refused.value) or "/dataset/" in str(refused.value)
    if wrong.mended:
        build.build(study.root)
        tables.check_tables(study.root)
    else:
        with pytest.raises(PalpateError, match=wrong.said):
            build.build(study.root)


@pytest.mark.parametrize(
    ("check", "name"),
    {
        "anchors": "a session erased but for its anchor",
        "strays": "a journal copied beside itself",
        "journals": "a journal of another seed",
        "frames": "a session erased but for its frames",
        "copies": "a journal with the session_id of another",
        "tables": "a trace of no journal",
        "participants": "a session erased but for its participant's row",
        "withdrawals": "a roster that forgot a withdrawal",
    }.items(),
)
def test_each_check_finds_what_it_is_for(made: MadeStudy, tmp_path: Path, check: str, name: str) -> None:
    study = copied(made, tmp_path / "study")
    next(one for one in WRONG if one.name == name).act(study, tmp_path)
    found = [one.check for one in checks.findings(checks.load(study.root))]
    assert check in found
    assert found == sorted(found, key=list(checks.CHECKS).index)
    with pytest.raises(DatasetError) as refused:
        checks.load_sound(study.root)
    assert refused.value.finding.check == found[0]


def test_a_rig_file_is_the_one_that_the_journal_beside_it_names(made: MadeStudy, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    file = storage.rig_path(study.journal())
    file.write_bytes(file.read_bytes().replace(b'name = "rehearsal"', b'name = "another"'))
    (found,) = checks.findings(checks.load_sound(study.root), *checks.OF_FILES)
    assert (found.check, found.where, found.verdict) == ("rigs", file, "refuses")


@pytest.mark.parametrize(("check", "end", "suffices"), [("edits", "events.tsv", False), ("traces", "tsv.gz", True)])
def test_what_was_made_of_journals_is_compared_where_it_is_asked_for(
    made: MadeStudy, tmp_path: Path, check: str, end: str, suffices: bool
) -> None:
    study = copied(made, tmp_path / "study")
    if check == "edits":
        next(one for one in WRONG if one.name == "an answer edited in the events").act(study, tmp_path)
    else:
        next(study.root.glob("sub-*/beh/*.tsv.gz")).unlink()
    dataset = checks.load_sound(study.root)
    found = list(checks.findings(dataset, *checks.CHECKS))
    assert {one.check for one in found} == {check} <= set(checks.OF_TABLES)
    for read in (tables.check_tables, tables.check_analysed):
        with pytest.raises(DatasetError) as refused:
            read(study.root)
        assert refused.value.finding == found[0]
    remedy = next(one.remedy for one in found if str(one.where).endswith(end))
    assert isinstance(remedy, Remedy)
    assert (remedy.command, remedy.suffices) == (("palpate", "build", str(study.root)), suffices)
    shown = [(one.where, one.remedy) for one in verify(study.root).findings if one.verdict == "refuses"]
    assert shown == [(one.place(study.root), one.remedy) for one in found]


def test_a_check_may_warn_which_is_told_and_stops_nothing(
    made: MadeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: a check that warns of every session."""
    study = copied(made, tmp_path / "study")

    def short(dataset: Dataset) -> Iterator[Finding]:
        yield from (Finding("was short", path, verdict="warns") for path, _ in dataset.sessions)

    before = verify(study.root)
    monkeypatch.setitem(checks.CHECKS, "short", short)
    build.build(study.root)
    found, after = status(study.root, DAY), verify(study.root)
    assert not found.doubts
    assert [one.what for one in found.reminders].count("was short") == len(checks.load(study.root).sessions)
    assert after.refused == 0
    told = [one.what for one in after.findings]
    assert told.count("was short") == len(checks.load(study.root).sessions)
    assert [one for one in told if one != "was short"] == [one.what for one in before.findings]


def test_what_a_backup_brought_back_is_the_finding_of_a_check(made: MadeStudy, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    withdrawal.withdraw(study.file, "02", "asked to erase", root=study.root, rebuild=build.build, erase=True)
    folder = Path("sourcedata", "sub-02")
    shutil.copytree(made.root / folder, study.root / folder, dirs_exist_ok=True)
    (finding,) = checks.findings(checks.load(study.root))
    assert (finding.check, isinstance(finding.remedy, Remedy)) == ("erased", True)


def test_a_roster_that_was_cut_is_found_once_and_its_sessions_are_not_accused(made: MadeStudy, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    next(one for one in WRONG if one.name == "a roster written anew").act(study, tmp_path)
    found = list(checks.findings(checks.load(study.root)))
    assert [(one.check, one.where) for one in found] == [("journals", storage.roster_path(study.root))]


def test_the_log_of_another_study_is_refused_and_accuses_no_file(made: MadeStudy, tmp_path: Path) -> None:
    study, log = copied(made, tmp_path / "study"), Path(register.LOG)
    other = make_study(tmp_path / "other", study="other")
    checks.keep_anchor(other.root)
    shutil.copy(other.root / log, study.root / log)
    (finding,) = checks.findings(checks.load(study.root))
    assert (finding.check, finding.where) == ("anchors", study.root / log)
    assert [one.where for one in verify(study.root).findings if one.verdict == "refuses"] == [log.as_posix()]


def test_where_the_roster_is_lost_the_data_of_nobody_who_may_be_erased_are_asked_for(
    made: MadeStudy, tmp_path: Path
) -> None:
    study = copied(made, tmp_path / "study")
    checks.keep_anchor(study.root)
    gone = study.journal(1).relative_to(study.root).as_posix()
    withdrawal.withdraw(study.file, "02", "asked to erase", root=study.root, rebuild=build.build, erase=True)
    roster_file = storage.roster_path(study.root)
    assert not [one for one in verify(study.root).findings if one.where == gone]
    roster_file.write_bytes(roster_file.read_bytes()[5:])
    (missing,) = (one for one in verify(study.root).findings if one.where == gone)
    assert "the roster first" in missing.what


def test_a_journal_presents_what_its_task_presents(tmp_path: Path) -> None:
    some = '["copy paper", "typing paper"]'
    further = {f'stimulus = "{kind}"': f'stimulus = "{kind}"\nmaterials = {some}' for kind in ("virtual", "real")} | {
        "limit = 4": "limit = 2",
        'materials = ["aluminum foil", "typing paper"]': f"materials = {some}",
    }
    study = make_study(tmp_path / "study", further=further, enrolled=3, sessions=1, keys="cp")
    assert len(checks.load_sound(study.root).sessions) == 1
    events = sorted((study.root / "sub-01").rglob("*_events.json"))
    told = json.loads(events[0].read_text("utf-8"))
    assert (told["Presented"], len(told["Materials"])) == (["copy paper", "typing paper"], 4)
    assert list(told["presented"]["Levels"]) == told["Presented"]
    assert list(told["answered"]["Levels"])[:4] == told["Materials"]
    assert "2 materials, 1 trials each" in told["TaskDescription"]
    asked = study.header("02", study.tasks[1].tasks[0])
    foreign = asked.order[0].model_copy(update={"presented": ("aluminum foil",)})
    study.run(asked.model_copy(update={"order": (foreign, *asked.order[1:])}), "ap")
    said = f"trials with aluminum foil; allowed: copy paper, typing paper, which task {asked.task} presents"
    with pytest.raises(PalpateError, match=said):
        checks.load_sound(study.root)


@pytest.mark.parametrize("command", ["build", "anchor"])
def test_what_is_no_dataset_is_named_as_it_was_typed(tmp_path: Path, palpate: Palpate, command: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    empty = "does not contain a study"
    for name, what in (("file", "is not a folder"), ("absent", "is not a folder"), ("empty", empty)):
        said = (
            f"palpate: {tmp_path / name}: {what}; allowed: the folder of a study's dataset, which contains sourcedata; "
        )
        code, out, err = palpate(command, tmp_path / name)
        assert (code, out, err.startswith(said), err.count("\n")) == (2, "", True, 1)


def test_every_command_that_reads_a_dataset_refuses_what_is_wrong_in_it(
    made: MadeStudy, tmp_path: Path, palpate: Palpate
) -> None:
    study = copied(made, tmp_path / "study")
    table = study.root / "sub-01" / "beh" / study.journal().name.replace("_journal.jsonl", "_events.tsv")
    table.write_text(table.read_text("utf-8").replace("copy paper", "typing paper"), "utf-8")
    out = ("--out", tmp_path / "out")
    for command in (
        ("analyse", study.root, *out),
        ("export", study.root, *out),
        ("audit", study.root),
        ("power", study.file, "--model", study.root),
    ):
        code, shown, err = palpate(*command)
        assert (code, shown) == (2, "")
        assert f"{table}: line " in err
        assert f"(palpate build {study.root})" in err
    assert palpate("build", study.root)[0] == 0
    assert palpate("export", study.root, *out)[0] == 0


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("header", {"started_utc": "garbage"}),
        ("step", {"contact_us": 1e300}),
    ],
)
def test_a_moment_that_no_clock_tells_is_refused_though_its_journal_was_chained_anew(
    made: MadeStudy, tmp_path: Path, palpate: Palpate, kind: str, wrong: dict[str, object]
) -> None:
    study = copied(made, tmp_path / "study")
    path = study.journal()
    links = chain.read(path, DatasetError).links
    path.unlink()
    chain.head_path(path).unlink()
    writer = chain.Writer(path, chain.START)
    for link in links:
        entry = {**link.entry, **(wrong if link.entry["kind"] == kind else {})}
        writer.append(writer.next_link(link.t_ns, entry))
    writer.close()
    for code, *command in ((1, "verify"), (2, "build"), (2, "analyse", "--out", tmp_path / "out")):
        got, shown, err = palpate(*command[:1], study.root, *command[1:])
        assert (got, "is not a journal entry that this version of palpate" in shown + err) == (code, True)


def test_an_entry_that_cannot_be_read_is_named_and_every_answer_beside_it_is_shown(
    made: MadeStudy, tmp_path: Path, palpate: Palpate
) -> None:
    study = copied(made, tmp_path / "study")
    path = study.journal()
    said = progress(journal.read(path).entries).said
    chained(path, 5, b'{"kind":"note","trial":%d,"text":"a door"}' % 2**63)
    for code, *command in ((1, "verify"), (2, "build"), (2, "analyse", "--out", tmp_path / "out")):
        got, shown, err = palpate(*command[:1], study.root, *command[1:])
        assert got == code
        assert "line 6 " in shown + err
        assert all(f"trial {trial} {answer}" in shown + err for trial, answer in said)
    got, shown, err = palpate("journal", path)
    assert (got, "line 6 CANNOT BE" in shown, f"{len(said)} of " in shown) == (1, True, True)
    got, shown, err = palpate("journal", path, "--json")
    document = json.loads(shown)
    assert (got, [one["line"] for one in document["unreadable"]]) == (1, [6])
    assert len(document["entries"]) == len(chain.read(path, DatasetError, strict=False).links) - 1


def test_a_first_task_that_was_edited_is_mended_as_the_error_says(made: MadeStudy, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    people = study.root / "participants.tsv"
    before = people.read_bytes()
    first, other = (task.encode() for task in study.tasks[0].tasks)
    people.write_bytes(before.replace(b"sub-01\t" + first, b"sub-01\t" + other))
    with pytest.raises(DatasetError, match=r"participants\.tsv was edited; delete it"):
        build.build(study.root)
    people.unlink()
    build.build(study.root)
    assert people.read_bytes() == before


@pytest.mark.parametrize("act", ALONE.values(), ids=ALONE)
def test_tables_with_nothing_behind_them_prove_nothing_and_are_analysed_with_a_note(
    made: MadeStudy, tmp_path: Path, palpate: Palpate, act: Act
) -> None:
    study = copied(made, tmp_path / "study")
    act(study, tmp_path)
    code, shown, err = palpate("verify", study.root)
    assert (code, err) == (1, "")
    told = "sourcedata: has no journals, although the tables are labeled PARTICIPANT; restore it from a backup"
    assert told in " ".join(shown.split())
    assert "REFUSED: 1 finding " in shown
    assert palpate("build", study.root)[0] == 2
    code, _, err = palpate("export", study.root, "--out", tmp_path / "out")
    assert code == 0
    assert f"{study.root}: these tables have no journals, so palpate cannot detect a changed cell\n" in err


def withdraw(study: MadeStudy, reason: str = "asked to stop") -> None:
    withdrawal.withdraw(study.file, "01", reason, root=study.root, rebuild=build.build)


def withdrawn(study: MadeStudy) -> bool:
    """Whether journal and tables say so."""
    entries = journal.read(study.journal()).entries
    assert sum(isinstance(entry, Withdrawal) for entry in entries) <= 1
    said = isinstance(entries[-1], Withdrawal)
    assert "sub-01\t" in (study.root / "participants.tsv").read_text("utf-8")
    return said and f"sub-01\t{study.tasks[0].tasks[0]}\t1" in (study.root / "participants.tsv").read_text("utf-8")


@pytest.mark.parametrize(
    "killed", ["palpate.experiment.records.journal.Journal.append", "palpate.experiment.storage.write_bytes"]
)
def test_a_withdrawal_that_was_killed_is_finished_by_the_same_command(
    made: MadeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: str
) -> None:
    study = copied(made, tmp_path / "study")

    def kill(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(killed, kill)
        with pytest.raises(KeyboardInterrupt):
            withdraw(study)
    assert not withdrawn(study)
    with pytest.raises(RosterError, match="give the reason on record: 'asked to stop'"):
        withdraw(study, "another reason")
    for _ in range(2):
        withdraw(study)
        assert withdrawn(study)
        tables.check_tables(study.root)
    done = progress(journal.read(study.journal()).entries)
    assert done.footer is not None
    assert done.footer.reason == "complete"


def test_a_torn_line_that_a_withdrawal_drops_is_on_record(made: MadeStudy, tmp_path: Path) -> None:
    study = copied(made, tmp_path / "study")
    with study.journal().open("ab") as file:
        file.write(b'{"n": 99')
    withdraw(study)
    last = journal.read(study.journal()).entries[-1]
    assert last == Withdrawal(reason="asked to stop", torn='{"n": 99')


def test_a_pilot_is_no_data_of_the_study_and_says_so_everywhere(tmp_path: Path) -> None:
    pilot = make_study(tmp_path / "pilot", pilot=True)
    assert checks.load_sound(pilot.root).purpose == "PILOT"
    tables = [path for path in pilot.root.rglob("*") if path.suffix in (".tsv", ".json") and path.parent != pilot.root]
    tables += [pilot.root / name for name in ("participants.tsv", "dataset_description.json", "README")]
    assert len(tables) > 5
    assert all("PILOT" in path.read_text("utf-8") for path in tables), tables
    enrolling.enrol(pilot.file, "03", DAY, root=pilot.root, seed=None)
    enrolling.enrol(pilot.file, "04", DAY, root=pilot.root, seed=None, pilot=True)
    assert enrolment.purpose_of(pilot.root) == "PILOT"
    study = make_study(tmp_path / "study", sessions=0)
    with pytest.raises(DatasetError, match="as a STUDY, not as a PILOT; give"):
        enrolling.enrol(study.file, "03", DAY, root=study.root, seed=None, pilot=True)
    assert list(roster.Roster.load(storage.roster_path(study.root)).consent_on) == ["01", "02"]


def test_a_pilot_stands_beside_its_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    study = make_study(tmp_path / "made", enrolled=1, sessions=0)
    paths = [enrolling.enrol(study.file, "01", DAY, root=None, seed=1, pilot=pilot) for pilot in (False, True)]
    assert [path.parents[1].name for path in paths] == ["okamoto2012", "okamoto2012-pilot"]
    shutil.copytree(paths[1].parents[1], paths[0].parents[1], dirs_exist_ok=True)
    with pytest.raises(DatasetError, match="as a PILOT, not as a STUDY"):
        enrolling.enrol(study.file, "02", DAY, root=None, seed=None)
