"""What `palpate verify` says of datasets that are sound, damaged, or made anew. All of them are SIMULATED."""

from __future__ import annotations

import json
import shlex
import shutil
from dataclasses import replace
from datetime import date
from hashlib import sha256
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import bids, build, checks, register, status
from palpate.experiment.dataset.outside import accidents
from palpate.experiment.dataset.outside.signatures import Signer
from palpate.experiment.dataset.verify import FOREIGN, MISTYPED, Report, verify
from palpate.experiment.errors import DatasetError, OtherFormat, Remedy
from palpate.experiment.protocol import approval
from palpate.experiment.records import chain
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Revealed, Roster
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.faults.anchors import forge

ANEW = "NOT PROVEN: anyone who can write to this folder could have forged journals, heads and tables"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    return make_study(tmp_path_factory.mktemp("study") / "made")


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    shutil.copytree(made.file.parent, tmp_path / "made")
    return MadeStudy(tmp_path / "made" / "study.toml", tmp_path / "made" / "dataset")


@pytest.fixture
def anchored(study: MadeStudy, tmp_path: Path) -> Path:
    """A register that has an anchor of the dataset."""
    register.enter(checks.anchor(study.root), study.root, tmp_path / "register", None)
    return tmp_path / "register"


def refused(report: Report) -> dict[str, str]:
    return {finding.place(): finding.clause() for finding in report.findings if finding.verdict == "refuses"}


def advises_commands(report: Report) -> bool:
    """Whether the verdict is to do what the findings say, and not to compare the folder with a backup."""
    return report.verdict[0].endswith("Follow the remedies above.")


def inside(study: MadeStudy, path: Path) -> str:
    return path.relative_to(study.root).as_posix()


def cut(path: Path, lines: int) -> None:
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:lines]))


def test_a_sound_dataset_holds_and_intent_is_not_excluded(study: MadeStudy) -> None:
    checks.keep_anchor(study.root)
    report = verify(study.root)
    assert {finding.verdict for finding in report.findings} == {"passes"}
    assert report.title == f"STUDY of okamoto2012: {study.root}"
    assert [sentence.startswith(ANEW) for sentence in report.verdict] == [False, True]
    told = {finding.place(): finding.clause() for finding in report.findings}
    assert told["approval"] == "from 2001-01-01 to 2099-01-01"
    assert (told["approval number"], told["board"]) == ("17", study.protocol.ethics.board)


def test_an_anchor_outside_proves_every_line(study: MadeStudy, anchored: Path) -> None:
    report = verify(study.root, [anchored])
    total = sum(len(file.read_bytes().splitlines()) for file in (study.root / "sourcedata").rglob("*.jsonl"))
    assert report.refused == 0
    assert f"PROVEN by {anchored}: {total} of {total} lines" in report.verdict[1]
    assert f" to write to {anchored}." in report.verdict[1]
    assert not any(sentence.startswith("NOT PROVEN") for sentence in report.verdict)


def test_what_came_after_the_anchor_is_told(study: MadeStudy, anchored: Path) -> None:
    one = study.tasks[0]
    study.run(study.header(one.participant, one.tasks[1]))
    Roster.load(storage.roster_path(study.root)).withdraw("02", "asked to stop")
    build.build(study.root)
    report = verify(study.root, [anchored])
    grown = len(study.journal(0, 1).read_bytes().splitlines()) + 1
    assert report.refused == 0
    assert report.verdict[-1].startswith("NOT PROVEN")
    assert f"forged {grown} lines " in report.verdict[-1]


def test_a_tail_that_was_cut_is_refused_by_the_head(study: MadeStudy) -> None:
    path = study.journal()
    lines = len(path.read_bytes().splitlines())
    cut(path, lines - 3)
    report = verify(study.root)
    assert f"now has {lines - 3}" in refused(report)[inside(study, path)]
    assert report.verdict[0].startswith("REFUSED: 1 finding ")


def test_a_head_that_was_deleted_is_refused(study: MadeStudy) -> None:
    path = study.journal()
    chain.head_path(path).unlink()
    cut(path, 9)
    assert "no " in refused(verify(study.root))[inside(study, path)]


@pytest.mark.parametrize("number", [1, 8, 17])
def test_a_chain_made_anew_passes_without_an_anchor_and_is_refused_with_one(
    study: MadeStudy, anchored: Path, number: int
) -> None:
    path = study.journal()
    forge(study.root, path, number)
    report = verify(study.root)
    assert (report.refused, report.verdict[1].startswith(ANEW)) == (0, True)
    report = verify(study.root, [anchored])
    assert list(refused(report)) == [inside(study, path)]
    assert "lines 1 to 17 " in refused(report)[inside(study, path)]


def test_anchors_of_a_paused_session_name_the_stretch_that_was_changed(study: MadeStudy, tmp_path: Path) -> None:
    one = study.tasks[0]
    asked = study.header(one.participant, one.tasks[1])
    study.run(asked, "cq")
    path = study.journal(0, 1)
    paused = len(path.read_bytes().splitlines())
    register.enter(checks.anchor(study.root), study.root, tmp_path / "register", None)
    study.run(asked, "apt")
    build.build(study.root)
    register.enter(checks.anchor(study.root), study.root, tmp_path / "register", None)
    whole = len(path.read_bytes().splitlines())
    assert verify(study.root, [tmp_path / "register"]).refused == 0
    forge(study.root, path, paused + 1)
    text = refused(verify(study.root, [tmp_path / "register"]))[inside(study, path)]
    assert f"one of the lines {paused + 1} to {whole} differs from" in text


def test_a_roster_line_that_was_cut_is_refused(study: MadeStudy, anchored: Path) -> None:
    path = storage.roster_path(study.root)
    cut(path, 1)
    assert inside(study, path) in refused(verify(study.root))
    chain.head_path(path).unlink()
    cut(path, 1)
    assert refused(verify(study.root))
    told = refused(verify(study.root, [anchored]))[inside(study, path)]
    assert "1 of the 2 lines" in told


def test_an_older_state_is_told_with_what_it_lacks(study: MadeStudy, made: MadeStudy, tmp_path: Path) -> None:
    one = study.tasks[0]
    study.run(study.header(one.participant, one.tasks[1]))
    build.build(study.root)
    register.enter(checks.anchor(study.root), study.root, tmp_path / "register", None)
    assert verify(made.root).refused == 0
    report = verify(made.root, [tmp_path / "register"])
    assert refused(report)[inside(study, study.journal(0, 1))].startswith("is missing")


def test_where_a_dataset_stands_does_not_matter(study: MadeStudy, anchored: Path, tmp_path: Path) -> None:
    shutil.copytree(study.root, tmp_path / "copy")
    study.root.rename(tmp_path / "elsewhere")
    for root in (tmp_path / "copy", tmp_path / "elsewhere"):
        assert verify(root, [anchored]).refused == 0


def test_a_number_in_a_lab_book_proves_what_the_log_of_the_dataset_has(study: MadeStudy) -> None:
    anchor, _ = checks.keep_anchor(study.root)
    for typed in (anchor.line.split()[-1], anchor.line, f"For the lab book: {anchor.line.upper()} "):
        report = verify(study.root, (), [typed])
        assert (report.refused, "change the lab" in report.verdict[1]) == (0, True)
    log = study.root / register.LOG
    log.write_text(log.read_text().replace(anchor.prefixes[1].sha256, "0" * 64))
    assert f"number {anchor.number}" in refused(verify(study.root, (), [anchor.number]))
    log.unlink()
    assert list(refused(verify(study.root, (), [anchor.number]))) == [f"number {anchor.number}"]
    with pytest.raises(DatasetError, match="allowed: 16 digits"):
        verify(study.root, (), ["17"])


def test_the_log_of_the_dataset_alone_refuses_but_proves_nothing(study: MadeStudy) -> None:
    checks.keep_anchor(study.root)
    assert verify(study.root).verdict[1].startswith(ANEW)
    forge(study.root, study.journal(), 5)
    assert list(refused(verify(study.root))) == [inside(study, study.journal())]


def test_a_log_of_anchors_that_is_gone_is_told_and_one_that_was_overwritten_is_refused(study: MadeStudy) -> None:
    checks.keep_anchor(study.root)
    log = study.root / register.LOG
    # A kill while the first anchor was written leaves a part of it.
    log.write_bytes(log.read_bytes()[:40])
    checks.load_sound(study.root)
    log.write_text("another text\n")
    with pytest.raises(DatasetError, match=r"anchors\.log: has no readable anchors; restore it from a backup"):
        checks.load_sound(study.root)
    log.unlink()
    notes = {
        finding.place(): finding.clause() for finding in verify(study.root).findings if finding.verdict == "unknown"
    }
    assert notes[register.LOG.as_posix()].startswith("is missing: ")


def test_a_seal_that_was_edited_is_refused_by_an_anchor(study: MadeStudy, anchored: Path) -> None:
    seal = approval.seal_path(storage.protocol_path(study.root))
    text = seal.read_text("utf-8")
    seal.write_text(text.replace('"17"', '"99"'), "utf-8")
    assert seal.read_text("utf-8") != text
    report = verify(study.root)
    # Every journal names the seal under which it began.
    assert set(refused(report)) == {inside(study, path) for path in storage.journals(study.root)}
    report = verify(study.root, [anchored])
    told = refused(report)[inside(study, seal)]
    assert told.startswith("differs from the anchor of ")
    assert str(anchored) in told


def test_a_register_inside_the_dataset_proves_nothing_however_its_path_is_spelt(study: MadeStudy) -> None:
    register.enter(checks.anchor(study.root), study.root, study.root.parent / "register", None)
    inner = study.root / "sourcedata" / "sub-01" / ".." / "register"
    inner.write_bytes((study.root.parent / "register").read_bytes())
    with pytest.raises(DatasetError, match="is inside the dataset"):
        verify(study.root, [inner])


def test_a_signer_without_a_register_is_refused(study: MadeStudy, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="got --signer without --register"):
        verify(study.root, signer=Signer(tmp_path / "key.pub"))


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_a_number_that_was_mistyped_speaks_against_no_dataset(study: MadeStudy, digits: int, palpate: Palpate) -> None:
    number = checks.keep_anchor(study.root)[0].number
    typed = "".join(f"{(int(one, 16) + 1) % 16:x}" for one in number[:digits]) + number[digits:]
    code, out, err = palpate("verify", study.root, "--number", typed)
    if digits > MISTYPED:
        assert (code, f"REFUSED  number {typed}" in out) == (1, True)
    else:
        assert (code, out, err.count("\n"), "which is close to the number of the anchor" in err) == (2, "", 1, True)


def test_what_was_typed_in_the_place_of_a_register_speaks_against_no_dataset(
    study: MadeStudy, tmp_path: Path, palpate: Palpate
) -> None:
    for typed in (tmp_path / "absent", tmp_path, study.file):
        code, out, err = palpate("verify", study.root, "--register", typed)
        assert (code, out, err.count("\n"), str(typed) in err) == (2, "", 1, True)


def test_a_register_of_another_dataset_proves_nothing(study: MadeStudy, tmp_path: Path) -> None:
    other = make_study(tmp_path / "other", study="another", sessions=1)
    register.enter(checks.anchor(other.root), other.root, tmp_path / "register", None)
    report = verify(study.root, [tmp_path / "register"])
    assert list(refused(report)) == [str(tmp_path / "register")]


def test_a_register_of_a_dataset_of_the_same_study_is_told_once_and_accuses_no_file(
    study: MadeStudy, tmp_path: Path
) -> None:
    other = make_study(tmp_path / "other", seed=2)
    register.enter(checks.anchor(other.root), other.root, tmp_path / "register", None)
    found = refused(verify(study.root, [tmp_path / "register"]))
    assert list(found) == [str(tmp_path / "register")]
    assert found.popitem()[1] == FOREIGN


def test_what_was_derived_is_told_not_to_be_compared(study: MadeStudy) -> None:
    (study.root / "derivatives" / "palpate").mkdir(parents=True)
    told = {finding.place(): finding for finding in verify(study.root).findings}["derivatives"]
    assert told.verdict == "unknown"
    assert f"palpate analyse {study.root}" in told.clause()


@pytest.fixture
def visited(study: MadeStudy) -> Path:
    """The journal of a session that was paused, whose tables were made, and that goes on; no footer ends it yet."""
    one = study.tasks[0]
    asked = study.header(one.participant, one.tasks[1])
    study.run(asked, "cq")
    build.build(study.root)
    path = study.journal(0, 1)
    paused = len(path.read_bytes().splitlines())
    study.run(asked, "aptc")
    lines = path.read_bytes().splitlines(keepends=True)
    assert b'"kind":"footer"' in lines[-1]
    rechained(path, lines[:-1])
    assert len(lines) > paused + 1
    return path


def rechained(path: Path, lines: list[bytes]) -> None:
    """Leave these lines, with the head that says so."""
    path.write_bytes(b"".join(lines))
    last = sha256(lines[-1].removesuffix(b"\n")).hexdigest()
    chain.head_path(path).write_text(f"{len(lines):012d} {last}\n", "utf-8")


def test_in_the_middle_of_a_visit_no_table_is_accused(study: MadeStudy, visited: Path) -> None:
    report = verify(study.root)
    assert report.refused == 0
    told = {finding.place(): finding.clause() for finding in report.findings}
    assert told[inside(study, visited)] == checks.OPEN
    build.build(study.root)
    assert verify(study.root).refused == 0


def test_in_the_first_session_of_a_participant_no_table_is_missed(study: MadeStudy) -> None:
    one = study.tasks[0]
    study.run(study.header(one.participant, one.tasks[1]))
    path = study.journal(0, 1)
    rechained(path, path.read_bytes().splitlines(keepends=True)[:-2])
    assert verify(study.root).refused == 0
    ended = replace(checks.load_sound(study.root), under_way=frozenset())
    assert "is missing" in {one.what for one in checks.findings(ended, "edits")}


def test_an_open_session_is_told_as_open_and_not_accused(study: MadeStudy, visited: Path, palpate: Palpate) -> None:
    code, out, err = palpate("analyse", study.root, "--no-figures", "--out", study.root.parent / "tables")
    assert (code, f"palpate: {visited}: {checks.OPEN}" in err) == (0, True)
    assert "Questions and answers" in out
    one = study.tasks[1]
    study.run(study.header(one.participant, one.tasks[1]), "cq")
    told = {finding.place(): finding.clause() for finding in verify(study.root).findings}
    assert told[inside(study, study.journal(1, 1))].endswith("; its session is open: it was paused with 3 trials left")
    assert "open" not in told[inside(study, study.journal(1, 0))]


def test_tables_that_are_older_than_their_journals_are_made_again_by_a_command(study: MadeStudy) -> None:
    one = study.tasks[0]
    asked = study.header(one.participant, one.tasks[1])
    study.run(asked, "cq")
    build.build(study.root)
    study.run(asked, "aptc")
    enrolling.enrol(study.file, "03", DAY, root=study.root, seed=None)
    study.run(study.header("03", study.tasks[2].tasks[0]))
    report = verify(study.root)
    found = [one for one in report.findings if one.verdict == "refuses"]
    tables = [
        inside(study, bids.beh_path(study.root, one.participant, one.tasks[1], f"events.{kind}"))
        for kind in ("tsv", "json")
    ]
    assert {"participants.tsv", *tables} < {one.place() for one in found}
    assert {one.remedy.command for one in found if isinstance(one.remedy, Remedy)} == {
        ("palpate", "build", str(study.root))
    }
    assert advises_commands(report)
    table = study.root / tables[0]
    table.write_bytes(table.read_bytes().replace(b"PARTICIPANT", b"PARTICIPANt", 1))
    assert not advises_commands(verify(study.root))
    build.build(study.root)
    assert verify(study.root).refused == 0


def test_before_the_first_session_has_ended_there_is_no_table_that_is_missed(tmp_path: Path, palpate: Palpate) -> None:
    study = make_study(tmp_path / "new", sessions=0)
    one = study.tasks[0]
    study.run(study.header(one.participant, one.tasks[0]))
    path = study.journal()
    rechained(path, path.read_bytes().splitlines(keepends=True)[:-1])
    assert verify(study.root).refused == 0
    code, _, err = palpate("analyse", study.root, "--no-figures")
    assert (code, "no session has ended yet, so there are no tables; end a session, or" in err, err.count("\n")) == (
        2,
        True,
        1,
    )
    build.build(study.root)
    assert palpate("analyse", study.root, "--no-figures")[0] == 0


@pytest.mark.parametrize("began", [True, False], ids=["first sitting", "second sitting"])
def test_tables_that_were_made_in_mid_visit_are_those_of_that_moment(
    study: MadeStudy, visited: Path, *, began: bool
) -> None:
    lines = visited.read_bytes().splitlines(keepends=True)
    if began:
        lines = [line for line in lines[:8] if b'"kind":"footer"' not in line]
    for there in range(len(lines) - 4, len(lines)):
        rechained(visited, lines[:there])
        build.build(study.root)
        rechained(visited, lines)
        assert verify(study.root).refused == 0


def test_frames_that_no_line_names_are_refused_of_a_complete_session_and_noted_of_another(
    study: MadeStudy, visited: Path
) -> None:
    done = storage.foot_path(study.journal())
    with done.open("ab") as file:
        file.write(b"x" * 7)
    found = verify(study.root)
    assert list(refused(found)) == [inside(study, done)]
    assert "7 bytes " in refused(found)[inside(study, done)]
    done.write_bytes(done.read_bytes()[:-7])
    with storage.foot_path(visited).open("ab") as file:
        file.write(b"x" * 7)
    told = [finding.clause() for finding in verify(study.root).findings if finding.place() == inside(study, visited)]
    assert "7 bytes of frames" in told[0]
    assert verify(study.root).refused == 0


def test_an_older_state_of_every_file_is_no_other_dataset(study: MadeStudy, made: MadeStudy, tmp_path: Path) -> None:
    one = study.tasks[0]
    register.enter(checks.anchor(study.root), study.root, tmp_path / "register", None)
    for path in (storage.roster_path(study.root), study.journal(0), study.journal(1)):
        rechained(path, path.read_bytes().splitlines(keepends=True)[:-1])
    found = refused(verify(study.root, [tmp_path / "register"]))
    assert all("an older state" in found[inside(study, path)] for path in (study.journal(0), study.journal(1)))
    assert one.participant == "01"
    assert str(tmp_path / "register") not in found


def test_a_roster_that_was_cut_is_told_once(study: MadeStudy) -> None:
    path = storage.roster_path(study.root)
    rechained(path, path.read_bytes().splitlines(keepends=True)[:-1])
    found = [one for one in verify(study.root).findings if "is missing a line" in one.clause()]
    assert [one.place() for one in found] == [inside(study, path)]


def test_a_clock_that_went_back_is_told(study: MadeStudy) -> None:
    roster = Roster.load(storage.roster_path(study.root))
    roster.now_ns = lambda: 0
    roster.append(Revealed, participant="01", revealed_on=date(1970, 1, 1))
    told = {finding.place(): finding.clause() for finding in verify(study.root).findings}
    assert "a line has an earlier time than the line before it" in told["sourcedata/roster.jsonl"]


def test_lines_are_proven_for_the_day_on_which_each_was_anchored(study: MadeStudy, tmp_path: Path) -> None:
    made = checks.anchor(study.root)
    for day, prefixes in (("2001-10-01", made.prefixes), ("2001-10-03", made.prefixes[:1])):
        one = made.model_copy(update={"anchored_utc": day + made.anchored_utc[10:], "prefixes": prefixes})
        register.enter(one, study.root, tmp_path / day, None)
        register.enter(one, study.root, tmp_path / "both", None)
    verdicts = {name: verify(study.root, [tmp_path / name]).verdict[1] for name in ("2001-10-01", "2001-10-03", "both")}
    assert " on 2001-10-01." in verdicts["2001-10-01"]
    assert " on 2001-10-03." in verdicts["2001-10-03"]
    assert " from 2001-10-01 to 2001-10-03." in verdicts["both"]


def test_a_file_in_the_place_of_a_dataset_is_named(study: MadeStudy, palpate: Palpate) -> None:
    code, _, err = palpate("verify", study.root / "participants.tsv")
    assert (code, "is not a folder" in err) == (2, True)


@pytest.mark.parametrize("left", [5, 9, 13])
def test_a_tail_and_its_head_that_were_cut_are_no_session_under_way(study: MadeStudy, left: int) -> None:
    path = study.journal()
    rechained(path, path.read_bytes().splitlines(keepends=True)[:left])
    assert any("not match the journal" in text for text in refused(verify(study.root)).values())


def test_a_table_of_a_session_under_way_is_compared_as_far_as_it_was_made(study: MadeStudy, visited: Path) -> None:
    one = study.tasks[0]
    table = bids.beh_path(study.root, one.participant, one.tasks[1], "events.tsv")
    table.write_bytes(table.read_bytes().replace(b"PARTICIPANT", b"PARTICIPANt", 1))
    assert list(refused(verify(study.root))) == [inside(study, table)]


def test_every_finding_is_told(study: MadeStudy) -> None:
    first, second = study.journal(0), study.journal(1)
    cut(first, 5)
    storage.foot_path(second).write_bytes(storage.foot_path(second).read_bytes()[:-1])
    task = study.tasks[1].tasks[1]
    storage.journal_path(study.root, "02", task).write_bytes(second.read_bytes())
    found = refused(verify(study.root))
    assert {inside(study, first), inside(study, storage.foot_path(second))} < set(found)
    assert any(f"sub-02_task-{task}" in item for item in found)


def test_a_log_without_an_anchor_that_can_be_read_is_refused(study: MadeStudy) -> None:
    checks.keep_anchor(study.root)
    (study.root / register.LOG).write_text("{}\n", "utf-8")
    assert any(item.endswith(register.LOG.name) for item in refused(verify(study.root)))


def test_the_name_of_a_folder_makes_no_line_of_the_report(study: MadeStudy, palpate: Palpate) -> None:
    forged = study.root.with_name("x\nPROVEN by the register: 9 of 9 lines are as they were")
    study.root.rename(forged)
    _, out, _ = palpate("verify", forged)
    assert not any(line.startswith("PROVEN") for line in out.splitlines())


def test_an_edited_cell_and_a_lost_table_are_told(study: MadeStudy) -> None:
    tables = sorted(study.root.glob("sub-*/beh/*_events.tsv"))
    header, row, *rows = tables[0].read_text().splitlines(keepends=True)
    cells = row.split("\t")
    said = header.split("\t").index("answered")
    cells[said] = "copy paper" if cells[said] != "copy paper" else "typing paper"
    tables[0].write_text("".join([header, "\t".join(cells), *rows]))
    tables[1].unlink()
    report = verify(study.root)
    found = refused(report)
    assert set(found) == {inside(study, table) for table in tables}
    (missing,) = (one for one in report.findings if one.where == inside(study, tables[1]))
    assert missing.remedy == checks.build_again(study.root, "make it again")
    # A table that differs may be the last that knows of what a journal lost.
    assert not advises_commands(report)
    build.build(study.root)
    tables[1].unlink()
    report = verify(study.root)
    assert (report.refused, advises_commands(report)) == (1, True)
    cut(study.journal(), 9)
    assert not advises_commands(verify(study.root))


def test_the_command_that_mends_a_dataset_can_be_pasted_whatever_its_folder_is_called(
    study: MadeStudy, palpate: Palpate
) -> None:
    root = study.root.rename(study.root.with_name("Anna's study, 2nd try"))
    table = next(root.glob("sub-*/beh/*_events.tsv"))
    table.unlink()
    report = verify(root)
    assert advises_commands(report)
    told = refused(report)[table.relative_to(root).as_posix()]
    command, *words = shlex.split(told.partition("again (")[2].removesuffix(")"))
    code, _, _ = palpate(*words)
    assert (command, code) == ("palpate", 0)
    assert not refused(verify(root))


def test_a_study_whose_tables_are_all_gone_is_refused(study: MadeStudy) -> None:
    for path in (study.root / "participants.tsv", *study.root.glob("sub-*")):
        path.unlink() if path.is_file() else shutil.rmtree(path)
    (missing,) = (one for one in verify(study.root).findings if one.where == "participants.tsv")
    assert missing.remedy == checks.build_again(study.root, "make it again")


def test_tables_are_made_again_only_where_the_journals_hold(study: MadeStudy, anchored: Path) -> None:
    """The tables may be the last that knows of what is gone."""
    path = study.journal()
    lines = path.read_bytes().splitlines(keepends=True)[:-3]
    path.write_bytes(b"".join(lines))
    chain.head_path(path).write_text(f"{len(lines):012d} {sha256(lines[-1][:-1]).hexdigest()}\n")
    assert any("palpate build" in text for text in refused(verify(study.root)).values())
    report = verify(study.root, [anchored])
    assert list(refused(report)) == [inside(study, path)]
    assert "palpate build" not in str(report)
    others = {one.place(): one.clause() for one in report.findings if one.verdict == "passes"}
    assert ("sound journal" in others["headers"], "not refused" in others["tables"]) == (True, True)
    assert {"seed", "seal"} < set(others)


def test_what_could_be_read_is_told_beside_what_is_refused(study: MadeStudy) -> None:
    """A journal is damaged, and then a table of the other one edited."""
    study.journal(1).write_bytes(study.journal(1).read_bytes()[:-40])
    told = {one.place(): one.verdict for one in verify(study.root).findings}
    assert [told[item] for item in ("headers", "seed", "seal", "tables")] == ["passes"] * 4
    table = bids.beh_path(study.root, "01", study.tasks[0].tasks[0], "events.tsv")
    table.write_text(table.read_text().replace("PARTICIPANT", "REHEARSAL", 1))
    report = verify(study.root)
    assert set(refused(report)) == {inside(study, study.journal(1)), inside(study, table)}
    assert "except those refused" in str(report.findings)


def test_a_roster_that_is_refused_shows_nothing_of_the_seed(study: MadeStudy, made: MadeStudy) -> None:
    """An older one, with its head, under which every session began."""
    enrolling.enrol(study.file, "03", date(2001, 9, 9), root=study.root, seed=None)
    checks.keep_anchor(study.root)
    for path in (storage.roster_path(made.root), chain.head_path(storage.roster_path(made.root))):
        shutil.copy(path, study.root / "sourcedata")
    report = verify(study.root)
    told = {one.place(): one.verdict for one in report.findings}
    assert list(refused(report)) == ["sourcedata/roster.jsonl"]
    assert [told[item] for item in ("headers", "seed", "tables")] == ["passes", "unknown", "passes"]


@pytest.mark.parametrize(
    ("gone", "remedy"),
    [
        (["sourcedata/sub-01"], "from a backup"),
        (["sourcedata/sub-01", "sub-01"], "from a backup"),
        (["sub-01"], "palpate build"),
    ],
)
def test_a_participants_folder_that_is_missing_is_one_finding(study: MadeStudy, gone: list[str], remedy: str) -> None:
    checks.keep_anchor(study.root)
    for folder in gone:
        shutil.rmtree(study.root / folder)
    found = refused(verify(study.root))
    assert list(found) == [gone[0]]
    assert remedy in found[gone[0]]


def test_a_table_that_alone_knows_of_a_journal_may_have_been_edited(study: MadeStudy) -> None:
    for folder in (study.journal().parent, study.root / "sub-01"):
        shutil.rmtree(folder)
    (found,) = refused(verify(study.root)).values()
    assert "if there was no such session" in found


def test_a_register_is_told_also_where_all_of_sourcedata_is_gone(study: MadeStudy, anchored: Path) -> None:
    path = inside(study, study.journal())
    shutil.rmtree(study.root / "sourcedata")
    found = refused(verify(study.root, [anchored]))
    assert "has no journals" in found["sourcedata"]
    assert found[path].startswith("is missing")


def test_recordings_are_held_against_the_journals_and_their_manifest(study: MadeStudy) -> None:
    folder = study.root / storage.RECORDINGS
    folder.mkdir(parents=True)
    take, second, manifest = folder / "a.wav", folder / "b.wav", folder / "manifest.toml"
    for path in (take, second):
        path.write_bytes(b"take")
    rows = [f'{{ file = "{path.name}", sha256 = "{sha256(b"take").hexdigest()}" }}' for path in (take, second)]
    named = f"takes = [{', '.join(rows)}]\n"
    manifest.write_text(named)
    one = study.tasks[0]
    asked = study.header(one.participant, one.tasks[1])
    study.run(asked.model_copy(update={"recordings_sha256": sha256(named.encode()).hexdigest()}))
    build.build(study.root)
    assert verify(study.root).refused == 0
    take.write_bytes(b"another")
    assert refused(verify(study.root)).keys() == {inside(study, take)}
    # A take that was not fetched explains no other one that was changed.
    second.write_text("version https://git-lfs.github.com/spec/v1\n", "utf-8")
    found = {one.where: one.check for one in verify(study.root).findings if one.refuses}
    assert found == {inside(study, take): "recordings", inside(study, second): accidents.CHECK}
    manifest.write_text("takes = []\n")
    assert "does not match the journals" in refused(verify(study.root))[inside(study, manifest)]
    manifest.unlink()
    assert "cannot be read" in refused(verify(study.root))[inside(study, manifest)]


def test_before_the_first_session_nothing_is_missed(tmp_path: Path) -> None:
    report = verify(make_study(tmp_path / "new", sessions=0).root)
    assert report.refused == 0
    assert {finding.place(): finding.verdict for finding in report.findings} == {
        "sourcedata/roster.jsonl": "passes",
        "sessions": "unknown",
        "roster": "unknown",
    }


def test_who_is_enrolled_and_has_no_session_is_told(study: MadeStudy, palpate: Palpate) -> None:
    """A session that was deleted with tables and anchors leaves nothing else."""
    for folder in (study.journal(1).parent, study.root / "sub-02"):
        shutil.rmtree(folder)
    (study.root / "participants.tsv").unlink()
    build.build(study.root)

    def told() -> list[str]:
        return [
            one.clause() for one in verify(study.root).findings if (one.verdict, one.place()) == ("unknown", "roster")
        ]

    why = "here: either none has begun, or they were deleted together with the anchor log"
    assert (verify(study.root).refused, told()) == (0, [f"there are no sessions with participant 02 {why}"])
    enrolling.enrol(study.file, "03", None, root=study.root, seed=None)
    assert told() == [f"there are no sessions with participants 02, 03 {why}"]
    for who in ("02", "03"):
        Roster.load(storage.roster_path(study.root)).withdraw(who, "asked to stop")
    assert told() == []


def test_what_is_no_data_of_a_study_says_so_first(tmp_path: Path) -> None:
    assert verify(make_study(tmp_path / "pilot", pilot=True).root).title.startswith("PILOT of okamoto2012: ")


def test_a_reconstruction_proves_nothing(repository_root: Path) -> None:
    report = verify(repository_root / "participants" / "okamoto2012")
    assert [(one.verdict, one.place()) for one in report.findings] == [("unknown", "RECONSTRUCTION")]
    assert report.verdict[0].startswith("NOT PROVEN: ")


def test_a_folder_that_is_no_dataset_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is not a palpate dataset"):
        verify(tmp_path)


def test_the_command_says_the_same_in_words_and_in_json(study: MadeStudy, anchored: Path, palpate: Palpate) -> None:
    report = verify(study.root, [anchored])
    code, out, _ = palpate("verify", study.root, "--register", anchored)
    assert code == 0
    assert all(sentence in out.splitlines() for sentence in (report.title, *report.verdict))
    forge(study.root, study.journal(), 3)
    code, out, _ = palpate("verify", study.root, "--register", anchored, "--json")
    found = json.loads(out)
    assert (code, [one["word"] for one in found["findings"]].count("refused")) == (1, 1)
    code, out, _ = palpate("verify", study.root, "--register", anchored)
    assert (code, f"  REFUSED  {inside(study, study.journal())}: " in out) == (1, True)


@pytest.mark.parametrize("number", [None, 0, 3])
@pytest.mark.parametrize("name", ["sourcedata/seed.json", "dataset_description.json"])
def test_a_dataset_of_another_format_is_no_damaged_one(study: MadeStudy, name: str, number: int | None) -> None:
    path = study.root / name
    content = json.loads(path.read_text("utf-8"))
    if "Palpate" in content:
        content["Palpate"]["Format"] = number
    else:
        content["format"] = number
    path.write_text(json.dumps(content), "utf-8")
    report = verify(study.root)
    (finding,) = report.findings
    assert finding.place() == name
    assert f"made by {'a newer' if number == 3 else 'an unreleased'} version of palpate" in finding.clause()
    assert report.verdict[0].startswith("NOT CHECKED")
    with pytest.raises(OtherFormat):
        status.status(study.root, date(2020, 6, 1))
    with pytest.raises(OtherFormat):
        build.build(study.root)


def test_a_roster_of_another_format_is_no_damaged_one(study: MadeStudy) -> None:
    path = storage.roster_path(study.root)
    lines = path.read_bytes().splitlines(keepends=True)
    first = json.loads(lines[0])
    del first["entry"]["format"]
    rechained(path, [json.dumps(first, separators=(",", ":"), ensure_ascii=False).encode() + b"\n"])
    found = refused(verify(study.root))
    assert "unreleased" in found[inside(study, path)]
