"""A request to erase: what goes, what stays, and what every command says afterwards. All data are SIMULATED."""

from __future__ import annotations

import hashlib
import io
import re
import shlex
import shutil
from collections.abc import Callable
from datetime import date
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, register, tables
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.protocol import files
from palpate.experiment.records import chain
from palpate.experiment.study import people, privacy, withdrawal
from palpate.experiment.study.people import keeping
from palpate.experiment.study.roster import Revealed, Roster
from tests.approved import Refuses, anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.faults.wrong import copied


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """Two participants with a session each, anchored in the dataset."""
    study = make_study(tmp_path_factory.mktemp("made") / "study")
    checks.keep_anchor(study.root)
    return study


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def erase(study: MadeStudy, participant: str = "02", reason: str = "asked to erase") -> None:
    withdrawal.withdraw(study.file, participant, reason, root=study.root, rebuild=build.build, erase=True)


def of(study: MadeStudy, participant: str) -> list[str]:
    """Return every file of a participant but locks."""
    found = [*study.root.glob(f"**/sub-{participant}/**/*"), *study.root.glob(f"**/*sub-{participant}*")]
    return sorted({path.name for path in found if path.is_file() and path.suffix != ".lock"})


def erased(study: MadeStudy) -> bool:
    """Whether nothing but the withdrawal is left, and all commands know it."""
    tables.check_tables(study.root)
    table = (study.root / "participants.tsv").read_text("utf-8")
    return of(study, "02") == ["sub-02_withdrawn.json"] and "sub-02" not in table and verify(study.root).refused == 0


def test_all_of_the_participant_goes_and_nothing_of_the_other(study: MadeStudy) -> None:
    before = {path: path.read_bytes() for path in study.root.glob("**/sub-01_*") if path.is_file()}
    erase(study)
    assert erased(study)
    assert before == {path: path.read_bytes() for path in before}
    known = Roster.load(storage.roster_path(study.root))
    assert (list(known.consent_on), known.withdrawn, known.erased) == (["01", "02"], {"02": "asked to erase"}, {"02"})


def test_verify_tells_the_erasure_in_one_line_also_with_an_anchor_whose_journal_is_gone(
    study: MadeStudy, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    register.enter(checks.anchor(study.root), study.root, tmp_path / "register", None)
    erase(study)
    report = verify(study.root, [tmp_path / "register"])
    told = [one for one in report.findings if "02" in one.place()]
    assert [(one.verdict, one.place()) for one in told] == [("unknown", "sub-02")]
    assert [one.clause() for one in told] == approved
    assert any(sentence.startswith("PROVEN") for sentence in report.verdict)
    checks.keep_anchor(study.root)
    assert verify(study.root, [tmp_path / "register"]).refused == 0


def test_another_file_that_is_missing_is_still_missed(study: MadeStudy, refuses: Refuses) -> None:
    erase(study)
    for folder in (study.journal().parent, study.root / "sub-01"):
        shutil.rmtree(folder)
    with refuses(DatasetError):
        build.build(study.root)
    assert verify(study.root).refused


def test_all_may_be_erased_and_again_after_an_earlier_withdrawal(study: MadeStudy) -> None:
    withdrawal.withdraw(study.file, "02", "moved away", root=study.root, rebuild=build.build)
    erase(study)
    erase(study, "01")
    erase(study)
    assert erased(study)
    assert Roster.load(storage.roster_path(study.root)).withdrawn == {"02": "moved away", "01": "asked to erase"}
    assert len((study.root / "participants.tsv").read_text("utf-8").splitlines()) == 1


def test_what_a_backup_brings_back_is_refused_until_it_is_erased_again(made: MadeStudy, study: MadeStudy) -> None:
    erase(study)
    shutil.copytree(made.root / "sourcedata" / "sub-02", study.root / "sourcedata" / "sub-02", dirs_exist_ok=True)
    for check in (build.build, tables.check_tables):
        with pytest.raises(DatasetError, match="the roster records that the data of participant 02 were erased"):
            check(study.root)
    (found,) = [one for one in checks.findings(checks.load(study.root)) if one.check == "erased"]
    files = [one for one in (study.root / "sourcedata" / "sub-02").iterdir() if one.name[0] != "."]
    assert Path(found.where).name.endswith("_journal.jsonl")
    assert f"this and {len(files) - 2} of their other" in found.what
    assert verify(study.root).refused
    erase(study)
    assert erased(study)


def test_other_line_ends_of_the_roster_accuse_no_file_that_was_erased(study: MadeStudy) -> None:
    checks.keep_anchor(study.root)
    erase(study)
    path = storage.roster_path(study.root)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert [one.where for one in verify(study.root).findings if one.refuses] == ["sourcedata/roster.jsonl"]


def test_a_roster_that_forgot_the_erasure_is_refused(made: MadeStudy, study: MadeStudy, refuses: Refuses) -> None:
    erase(study)
    for name in ("roster.jsonl", "roster.head"):
        shutil.copy(made.root / "sourcedata" / name, study.root / "sourcedata" / name)
    with refuses(PalpateError):
        build.build(study.root)


@pytest.mark.parametrize("call", range(1, 9))
def test_an_erasure_that_was_killed_is_finished_by_the_command_that_verify_says(
    study: MadeStudy, monkeypatch: pytest.MonkeyPatch, palpate: Palpate, call: int
) -> None:
    """Killed before each file that is written whole, and each that is deleted."""
    left = call

    def killed(real: Callable[..., object]) -> Callable[..., object]:
        def act(*given: object) -> object:
            nonlocal left
            left -= 1
            if not left:
                raise KeyboardInterrupt
            return real(*given)

        return act

    with monkeypatch.context() as patch:
        patch.setattr(storage, "write", killed(storage.write))
        patch.setattr(storage, "remove", killed(storage.remove))
        with pytest.raises(KeyboardInterrupt):
            erase(study)
    report = verify(study.root)
    (told,) = (one.clause() for one in report.findings if one.verdict == "refuses")
    assert "to finish the withdrawal of participant 02, run the same command again" in told
    assert report.verdict == ("REFUSED: 1 finding speaks against this dataset. Follow the remedies above.",)
    assert not any("has no data" in one.clause() and storage.left_of(study.root, "02") for one in report.findings)
    command = told.partition("palpate ")[2]
    known = Roster.load(storage.roster_path(study.root)).erased
    assert command.endswith(" --erase") is bool(known)
    assert palpate(*shlex.split(command), *([] if known else ["--erase"]), "--yes")[0] == 0
    assert erased(study)


def test_a_withdrawal_whose_tables_were_never_made_is_told_so(study: MadeStudy) -> None:
    Roster.load(storage.roster_path(study.root)).withdraw("02", "asked 'to' stop")
    study.journal(0).write_bytes(study.journal(0).read_bytes()[:-40])
    beside = {one.place(): one.clause() for one in verify(study.root).findings if one.verdict == "unknown"}
    assert "-p 02 --reason 'asked '\"'\"'to'\"'\"' stop'" in beside["withdrawn"]


def test_a_folder_that_is_a_link_is_not_followed(study: MadeStudy, tmp_path: Path) -> None:
    folder = storage.participant_folder(study.root, "02")
    shutil.move(folder, tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DatasetError, match="is a link"):
        erase(study)
    assert len(list((tmp_path / "elsewhere").glob("*.jsonl"))) == 1


def test_the_command_says_what_it_cannot_reach(study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion) -> None:
    code, out, _ = palpate(*asked(study, "--erase", "--yes"))
    assert code == 0
    assert anywhere(out.replace(str(people.folder()), "PEOPLE"), study.root.parent) == approved
    assert erased(study)


COPIES = (
    "participants (conflicted copy 2026-01-02).tsv",
    ".stversions/sourcedata/sub-02/sub-02_task-real_journal~20260102.jsonl",
    "sourcedata/sub-02/.sub-02_task-real_journal.jsonl.swp",
    "sourcedata/sub-01/sub-02_task-real_rig (1).toml",
    "sub-02.zip",
    "notes/sub-02.txt",
    "notes/more/sub-02.txt",
)


def test_files_that_palpate_does_not_know_are_listed_after_an_erasure(study: MadeStudy, palpate: Palpate) -> None:
    assert privacy.unknown_files(study.root) == []
    for name in COPIES:
        (study.root / name).parent.mkdir(parents=True, exist_ok=True)
        (study.root / name).write_text("foil", "utf-8")
    code, out, _ = palpate(*asked(study, "--erase", "--yes"))
    # The tables are not made beside what looks like a journal; the data are gone.
    assert (code, storage.left_of(study.root, "02")) == (2, [])
    listed = privacy.unknown_files(study.root)
    assert listed == sorted(COPIES)
    assert all(f"  {name}\n" in out for name in listed)
    (study.root / COPIES[2]).unlink()
    code, out, _ = palpate(*asked(study, "--erase", "--yes"))
    assert (code, f"  {COPIES[4]}\n" in out) == (0, True)


def test_a_dataset_without_its_seed_names_the_other_files_of_names(
    study: MadeStudy, palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "mine"))
    protocol = files.load(study.file)
    path = keeping.keep(protocol, study.root, "02", people.Person(name="Zoë Quux"))
    path = path.rename(path.with_name(f"{protocol.study.id}-0123456789abcdef-people.json"))
    code, out, _ = palpate(*asked(study, "--erase", "--yes"))
    assert (code, f"  {path}\n" in out) == (0, True)


def asked(study: MadeStudy, *more: str) -> tuple[object, ...]:
    return ("withdraw", study.file, "-p", "02", "--reason", "asked to erase", *more, "--dataset", study.root)


@pytest.mark.parametrize("typed", ["02", " 02 ", "01", "2", "y", "", None])
def test_an_erasure_is_asked_for_and_only_the_label_confirms_it(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch, typed: str | None
) -> None:
    """None stands for the end of the input."""
    before = {path: path.read_bytes() for path in study.root.rglob("*") if path.is_file()}
    monkeypatch.setattr("sys.stdin", io.StringIO("" if typed is None else f"{typed}\n"))
    code, out, err = palpate(*asked(study, "--erase"))
    question = "This permanently deletes 1 session with participant 02 and 4 answers. Type 02 to continue: "
    assert out.startswith(question)
    if typed and typed.strip() == "02":
        assert (code, erased(study)) == (0, True)
    else:
        assert (code, out, err.count("\n"), "nothing was erased" in err) == (2, question, 1, True)
        assert before == {path: path.read_bytes() for path in study.root.rglob("*") if path.is_file()}


def test_an_erasure_that_is_asked_for_again_counts_nothing_that_is_gone(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert palpate(*asked(study, "--erase", "--yes"))[0] == 0
    monkeypatch.setattr("sys.stdin", io.StringIO("02\n"))
    code, out, _ = palpate(*asked(study, "--erase"))
    question = (
        "This permanently deletes the remaining data of participant 02, who has no session here. Type 02 to continue: "
    )
    assert (code, out.startswith(question)) == (0, True)


def test_whose_journal_is_damaged_can_be_erased(study: MadeStudy, palpate: Palpate) -> None:
    study.journal(1).write_bytes(b"torn")
    assert palpate(*asked(study, "--erase", "--yes"))[0] == 0
    assert erased(study)


def test_nothing_is_asked_without_an_erasure_and_the_data_stay(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    code, out, _ = palpate(*asked(study))
    assert code == 0
    assert anywhere(out.replace(str(people.folder()), "PEOPLE"), study.root.parent) == approved
    assert study.journal(1).exists()
    assert palpate(*asked(study, "--yes"))[0] == 2


@pytest.mark.parametrize("more", [("--erase", "--yes"), ()], ids=["erased", "withdrawn"])
def test_an_anchor_after_it_refuses_an_older_backup(
    made: MadeStudy, study: MadeStudy, tmp_path: Path, palpate: Palpate, more: tuple[str, ...]
) -> None:
    _, out, _ = palpate(*asked(study, *more))
    number = re.findall(r"For the lab book: .* (\S+)\n", out)
    assert out.endswith(f"To enter it in the register as well: palpate anchor {study.root} --to REGISTER.\n")
    assert verify(study.root, numbers=number).refused == 0
    shutil.copy(study.root / register.LOG, tmp_path / "register")
    shutil.rmtree(study.root)
    shutil.copytree(made.root, study.root)
    found = [one.clause() for one in verify(study.root, [tmp_path / "register"]).findings if one.verdict == "refuses"]
    assert any("an older state" in text for text in found)
    assert verify(study.root, numbers=number).refused


def test_the_same_withdrawal_brings_up_a_head_that_a_kill_left_behind(study: MadeStudy) -> None:
    """Until then the line that tells the withdrawal could be cut off unseen."""
    (path,) = (one for one in storage.journals(study.root) if one.parent.name == "sub-01")
    before = chain.head_path(path).read_bytes()
    for _ in range(2):
        withdrawal.withdraw(study.file, "01", "asked to stop", root=study.root, rebuild=build.build)
        *lines, _ = path.read_bytes().split(b"\n")
        head = chain.head_path(path).read_bytes()
        assert head == f"{len(lines):012d} {hashlib.sha256(lines[-1]).hexdigest()}\n".encode()
        assert head != before
        chain.head_path(path).write_bytes(before)


@pytest.mark.parametrize("log", [True, False])
def test_nothing_is_added_to_a_roster_that_forgot_a_line(study: MadeStudy, palpate: Palpate, *, log: bool) -> None:
    """An older roster with its head: the anchors' log knows of more, and so does the mark of a withdrawal."""
    path = storage.roster_path(study.root)
    before = path.read_bytes(), chain.head_path(path).read_bytes()
    palpate("withdraw", study.file, "-p", "02", "--reason", "asked to stop", "--dataset", study.root)
    path.write_bytes(before[0])
    chain.head_path(path).write_bytes(before[1])
    if not log:
        (study.root / register.LOG).unlink()
    for command in (
        ("enrol", study.file, "-p", "03", "--consent-on", DAY),
        ("consent", study.file, "-p", "02", "--consent-on", DAY, "--correct", "--reason", "a wrong digit"),
        ("withdraw", study.file, "-p", "01", "--reason", "asked to stop"),
        ("schedule", study.file, "-p", "02", "--reveal"),
    ):
        code, _, err = palpate(*command, "--dataset", study.root)
        assert (code, err.startswith(f"palpate: {path}: "), err.count("\n")) == (2, True, 1), command
        assert path.read_bytes() == before[0]


def test_a_withdrawal_says_that_it_is_on_record_where_tables_cannot_be_made(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    (path,) = (one for one in storage.journals(study.root) if one.parent.name == "sub-02")
    kept = path.read_bytes()
    path.write_bytes(kept.replace(b'"answered"', b'"answereD"', 1))
    asked = ("withdraw", study.file, "-p", "01", "--reason", "asked to stop", "--dataset", study.root)
    code, _, err = palpate(*asked)
    assert code == 2
    assert anywhere(err, study.root.parent) == approved
    path.write_bytes(kept)
    assert palpate(*asked)[0] == 0
    assert verify(study.root).refused == 0


def test_nothing_is_added_to_a_roster_older_than_a_session(study: MadeStudy, palpate: Palpate) -> None:
    """Without a log of anchors, and without a withdrawal: only the journals know of the line."""
    (study.root / register.LOG).unlink()
    path = storage.roster_path(study.root)
    *lines, _ = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines))
    last = hashlib.sha256(lines[-1].removesuffix(b"\n")).hexdigest()
    chain.head_path(path).write_text(f"{len(lines):012d} {last}\n", "utf-8")
    before = path.read_bytes()
    for command in (
        ("enrol", study.file, "-p", "02", "--consent-on", DAY),
        ("consent", study.file, "-p", "01", "--consent-on", DAY, "--correct", "--reason", "a wrong digit"),
        ("withdraw", study.file, "-p", "01", "--reason", "asked to stop"),
        ("schedule", study.file, "-p", "01", "--reveal"),
    ):
        code, _, err = palpate(*command, "--dataset", study.root)
        assert (code, "is missing a line that a session depends on" in err) == (2, True), command
        assert path.read_bytes() == before


def test_the_same_withdrawal_has_the_same_number_for_the_lab_book(study: MadeStudy, palpate: Palpate) -> None:
    said = [re.findall(r"For the lab book: (.*)", palpate(*asked(study))[1]) for _ in range(2)]
    assert said[0] == said[1] != []


def test_a_clock_that_is_behind_the_roster_is_told_before_a_line_is_added(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    roster = Roster.load(storage.roster_path(study.root))
    roster.now_ns = lambda: 4_000_000_000 * 10**9
    roster.append(Revealed, participant="01", revealed_on=date(2096, 10, 2))
    code, _, err = palpate("enrol", study.file, "-p", "03", "--consent-on", DAY, "--dataset", study.root)
    assert code == 0
    assert "2096-10-02" in err
    assert anywhere(err, study.root.parent) == approved


def test_a_withdrawal_that_only_the_roster_knows_is_told_after_a_build_too(study: MadeStudy, palpate: Palpate) -> None:
    """The build brings the tables up to the roster; the journal, which holds against an older roster, says nothing."""
    Roster.load(storage.roster_path(study.root)).withdraw("02", "asked to stop")
    build.build(study.root)
    (told,) = (one.clause() for one in verify(study.root).findings if one.place() == "withdrawn")
    assert palpate(*shlex.split(told.partition("palpate ")[2]))[0] == 0
    assert not [one for one in verify(study.root).findings if one.place() == "withdrawn"]
