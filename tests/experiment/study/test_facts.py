"""What participants tell of themselves: how it is given, what stays of it, and that nothing does after a withdrawal."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment import storage
from palpate.experiment.cli import options
from palpate.experiment.dataset import build, checks
from palpate.experiment.dataset.outside import sharing
from palpate.experiment.dataset.status import status
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, PalpateError, Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.asked import Fact
from palpate.experiment.study import enrolment, privacy, withdrawal
from palpate.experiment.study.lines import Facts
from palpate.experiment.study.people import enrolling, facts
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.dataset.outside.test_sharing import licensed
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.protocol.asking import INCOME, PEOPLE, SHARING, asking

GIVEN = {"age": "34", "sex": "Female", "sport": "bog snorkelling"}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_study(tmp_path_factory.mktemp("facts") / "study", enrolled=3, further=asking(SHARING, PEOPLE))
    facts.record(made.file, "01", GIVEN, root=made.root)
    facts.record(made.file, "02", {"age": "61,5", "experience": "2"}, root=made.root)
    build.build(made.root)
    return made.file.parent


@pytest.fixture
def study(original: Path, tmp_path: Path) -> MadeStudy:
    folder = shutil.copytree(original, tmp_path / "study")
    return MadeStudy(folder / "study.toml", folder / "dataset")


def answers(study: MadeStudy, participant: str) -> dict[str, object]:
    return facts.answers(study.root, Roster.load(storage.roster_path(study.root)), participant)


def rows(root: Path) -> list[dict[str, str]]:
    return checks.table_rows(root / "participants.tsv")[:-1]


def files_with(root: Path, *words: str) -> list[str]:
    contents = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    return sorted(path.name for path, content in contents.items() if any(word.encode() in content for word in words))


def test_facts_are_columns_of_participants_with_units_and_levels(study: MadeStudy) -> None:
    own = ("age", "sex", "experience", "sport")
    assert [[row[name] for name in own] for row in rows(study.root)] == [
        ["34", "female", "n/a", "bog snorkelling"],
        ["61.5", "n/a", "2", "n/a"],
    ]
    described = json.loads((study.root / "participants.json").read_text("utf-8"))
    assert described["age"]["Units"] == "years"
    assert [*described["sex"]["Levels"]] == ["female", "male", "other"]
    assert verify(study.root).refused == 0


def test_status_tells_of_whom_nothing_is_on_record(study: MadeStudy) -> None:
    def wanted() -> list[tuple[str, ...]]:
        remedies = [one.remedy for one in status(study.root, DAY).reminders]
        return [one.command for one in remedies if isinstance(one, Remedy) and one.command[1] == "facts"]

    assert [command[command.index("--participant") + 1] for command in wanted()] == ["03"]
    facts.record(study.file, "03", {}, root=study.root)
    assert wanted() == []


def test_the_simulated_choose_each_value_in_turn_and_tell_nothing_else(study: MadeStudy) -> None:
    assert [facts.simulated(study.protocol, who) for who in ("01", "02", "04")] == [
        {"sex": "female"},
        {"sex": "male"},
        {"sex": "female"},
    ]


def test_the_roster_has_a_hash_that_nobody_can_guess_the_answers_from(study: MadeStudy) -> None:
    path, known = storage.facts_path(study.root, "01"), Roster.load(storage.roster_path(study.root)).facts
    content = json.loads(path.read_text("utf-8"))
    assert known["01"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert len(content["salt"]) == 32
    assert b"snorkelling" not in storage.roster_path(study.root).read_bytes()
    before = dict(known)
    facts.record(study.file, "01", GIVEN, root=study.root)
    assert Roster.load(storage.roster_path(study.root)).facts["01"] != before["01"]


@pytest.mark.parametrize("erase", [False, True])
def test_a_withdrawal_leaves_no_byte_of_them(study: MadeStudy, *, erase: bool) -> None:
    salt = json.loads(storage.facts_path(study.root, "01").read_text("utf-8"))["salt"]
    assert files_with(study.root, "snorkelling", salt) == ["participants.tsv", "sub-01_facts.json"]
    withdrawal.withdraw(study.file, "01", "asked to stop", root=study.root, rebuild=build.build, erase=erase)
    assert files_with(study.root, "snorkelling", salt) == []
    assert [row["age"] for row in rows(study.root)] == (["61.5"] if erase else ["n/a", "61.5"])
    assert verify(study.root).refused == 0
    with pytest.raises(RosterError):
        facts.record(study.file, "01", GIVEN, root=study.root)


def test_an_edited_file_a_lost_one_and_one_brought_back_show(study: MadeStudy) -> None:
    path, table = storage.facts_path(study.root, "01"), (study.root / "participants.tsv").read_bytes()
    kept = path.read_bytes()

    def refused() -> list[str]:
        found = [one for one in checks.findings(checks.load(study.root), "facts") if one.refuses]
        assert verify(study.root).refused >= len(found)
        return [one.check for one in found]

    for content in (kept.replace(b": 34", b": 43"), b"[]", b"{", b'{"answers": 4}'):
        path.write_bytes(content)
        assert refused() == ["facts"]
        with pytest.raises(DatasetError):
            build.build(study.root)
    path.unlink()
    assert refused() == ["facts"]
    path.write_bytes(kept.replace(b"\n", b"\r\n"))
    assert refused() == []
    withdrawal.withdraw(study.file, "01", "asked to stop", root=study.root, rebuild=build.build)
    path.write_bytes(kept)
    assert refused() == ["facts"]
    assert (study.root / "participants.tsv").read_bytes() != table


def test_what_was_edited_is_not_taken_over_and_nothing_is_lost_silently(study: MadeStudy) -> None:
    path = storage.facts_path(study.root, "01")
    path.write_bytes(edited := path.read_bytes().replace(b": 34", b": 43"))
    with pytest.raises(DatasetError):
        facts.record(study.file, "01", {"experience": "5"}, root=study.root)
    assert path.read_bytes() == edited
    facts.record(study.file, "01", {"age": "34", "sex": "", "sport": "", "experience": "5"}, root=study.root)
    assert answers(study, "01") == {"age": 34, "sex": None, "sport": None, "experience": 5}
    build.build(study.root)
    assert verify(study.root).refused == 0


class Killed(BaseException):
    """What ends a process at a place of a test's choice."""


@pytest.mark.parametrize("recorded", [False, True])
def test_a_kill_before_or_after_the_line_of_the_roster_loses_no_answer(
    study: MadeStudy, monkeypatch: pytest.MonkeyPatch, recorded: bool
) -> None:
    append = Roster.append

    def append_and_die(self: Roster, kind: Any, /, **told: object) -> None:
        if recorded:
            append(self, kind, **told)
        raise Killed

    with monkeypatch.context() as dying:
        dying.setattr(Roster, "append", append_and_die)
        with pytest.raises(Killed):
            facts.record(study.file, "01", {"experience": "2"}, root=study.root)
    build.build(study.root)
    assert (rows(study.root)[0]["age"], rows(study.root)[0]["experience"]) == ("34", "2" if recorded else "n/a")
    assert verify(study.root).refused == 0
    facts.record(study.file, "01", {"experience": "3"}, root=study.root)
    assert answers(study, "01") == {"age": 34, "sex": "female", "sport": "bog snorkelling", "experience": 3}
    assert [path.name for path in storage.facts_path(study.root, "01").parent.glob("*facts*")] == ["sub-01_facts.json"]


def test_answers_are_to_a_version_on_record_and_unknown_ones_are_left_out_of_the_table(
    study: MadeStudy, palpate: Palpate
) -> None:
    asked = study.file.read_text("utf-8")
    study.file.write_text(asked.replace("[duration]", f"{INCOME}\n[duration]"), "utf-8")
    with pytest.raises(DatasetError):
        facts.record(study.file, "01", {"income": "a lot"}, root=study.root)
    study.file.write_text(asked, "utf-8")
    path = storage.facts_path(study.root, "01")
    content = storage.json_of(path.read_bytes())
    storage.write_json(path, {**content, "answers": {**content["answers"], "income": "a lot"}})
    Roster.continued(storage.roster_path(study.root)).append(
        Facts, participant="01", file_sha256=hashlib.sha256(path.read_bytes()).hexdigest()
    )
    build.build(study.root)
    assert "income" not in rows(study.root)[0]
    told = verify(study.root)
    assert told.refused == 0
    assert [one.where for one in told.findings if one.verdict == "warns" and one.check == "facts"] == [
        path.relative_to(study.root).as_posix()
    ]


def test_a_protocol_is_settled_once_a_fact_is_on_record(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", enrolled=1, sessions=0, further=asking(SHARING, PEOPLE))
    other = tmp_path / "other"
    enrolling.enrol(study.file, "01", None, root=other, seed=1)
    facts.record(study.file, "01", GIVEN, root=other)
    study.file.write_text(study.file.read_text("utf-8").replace('id = "sport"', 'id = "sports"'), "utf-8")
    approval.seal_path(study.file).unlink()
    with pytest.raises(DatasetError):
        enrolment.consent(study.file, "01", DAY, root=other)


@pytest.mark.parametrize("erase", [False, True])
def test_what_a_kill_left_goes_with_a_withdrawal_too(study: MadeStudy, *, erase: bool) -> None:
    folder = storage.facts_path(study.root, "01").parent
    left = folder / ".palpate-0123456789abcdef"
    left.write_bytes(b"bog snorkelling")
    (folder / "sub-01_facts.new.json").write_bytes(b"bog snorkelling")
    withdrawal.withdraw(study.file, "01", "asked to stop", root=study.root, rebuild=build.build, erase=erase)
    assert files_with(study.root, "snorkelling") == []
    left.write_bytes(b"bog snorkelling")
    assert [one.where for one in verify(study.root).findings if one.refuses] == [
        left.relative_to(study.root).as_posix()
    ]


def test_a_withdrawal_that_comes_between_leaves_no_answer(study: MadeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    check = Roster.check_enrolled

    def check_before_a_withdrawal(self: Roster, participant: str) -> None:
        check(self, participant)
        if participant == "03":
            monkeypatch.undo()
            withdrawal.withdraw(study.file, participant, "asked to stop", root=study.root, rebuild=build.build)

    monkeypatch.setattr(Roster, "check_enrolled", check_before_a_withdrawal)
    with pytest.raises(RosterError):
        facts.record(study.file, "03", GIVEN, root=study.root)
    assert [*storage.participant_folder(study.root, "03").glob("*facts*")] == []


def test_correcting_one_fact_asks_nothing_and_what_is_asked_shows_and_keeps_what_is_on_record(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("stdin", "stdout"):
        monkeypatch.setattr(f"sys.{name}.isatty", lambda: True, raising=False)
    asked: list[str] = []
    typed = {"sex": "female"}

    def ask(question: str) -> str:
        asked.append(question.split()[1])
        return typed.get(asked[-1], "")

    monkeypatch.setattr(options, "ask", ask)
    place = ("facts", study.file, "-p", "02", "--dataset", study.root)
    assert palpate(*place, "--fact", "age=35")[0] == 0
    assert asked == []
    assert answers(study, "02") == {"age": 35, "experience": 2}
    code, shown, _ = palpate(*place)
    assert code == 0
    assert asked == ["sex", "sport"]
    assert answers(study, "02") == {"age": 35, "experience": 2, "sex": "female"}
    assert "age=35" in shown


@pytest.mark.skipif(sys.platform == "win32", reason="has no modes")
def test_answers_are_for_their_owner_alone_or_are_named(tmp_path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        study = make_study(Path(folder) / "study", enrolled=1, sessions=0, further=asking(SHARING, PEOPLE))
        study.file.parent.chmod(0o755)
        study.root.chmod(0o755)
        facts.record(study.file, "01", GIVEN, root=study.root)
        assert study.root.stat().st_mode & 0o077 == 0
        tables = study.root / "participants.tsv", study.root / "phenotype" / "tired.tsv"
        for table in tables:
            storage.write(table, b"")
            table.chmod(0o644)
        assert privacy.readable_by_others(study.root) == ()
        study.root.chmod(0o755)
        assert privacy.readable_by_others(study.root) == tables


def test_an_agreement_is_to_the_groups_and_what_is_no_answer_today_is_not_shared(
    study: MadeStudy, tmp_path: Path
) -> None:
    licensed(study)
    for label in ("01", "02"):
        enrolling.sharing(study.file, label, True, root=study.root)
    dataset = checks.load_sound(study.root)
    single = study.file.read_text("utf-8").replace("group = 10", "group = 1")
    (tmp_path / "single.toml").write_text(single, "utf-8")
    changed = replace(dataset, protocol=files.load(tmp_path / "single.toml"))
    assert sharing._chosen(dataset, ["01", "02"])[0] == ["01", "02"]
    with pytest.raises(RosterError):
        sharing._chosen(changed, ["01", "02"])


NUMBER = {"id": "n", "question": "?", "answer": "number", "reason": "-"}
CHOICE = {**NUMBER, "answer": "choice", "values": ("left", "right")}


@pytest.mark.parametrize(
    ("fact", "cell", "shared"),
    [
        ({**NUMBER, "group": 10}, "some", "n/a"),
        ({**NUMBER, "group": 10, "most": 50}, "61", "n/a"),
        ({**NUMBER, "group": 10}, "61.5", "60 to below 70"),
        ({**NUMBER, "group": 0.1}, "1.2", "1.2 to below 1.3"),
        ({**NUMBER, "group": 0.1}, "-0.05", "-0.1 to below 0"),
        ({**NUMBER, "group": 10}, "n/a", "n/a"),
        (CHOICE, "2", "n/a"),
        (CHOICE, "right", "right"),
    ],
)
def test_a_cell_is_shared_in_its_group_if_it_is_an_answer(fact: dict[str, Any], cell: str, shared: str) -> None:
    assert facts.shared_cell(Fact.model_validate(fact), cell) == shared


@pytest.mark.parametrize("typed", ["1,500", "12,345", "-1,500", "1_0", "1 0", "١", "inf", "0x1"])
def test_what_may_be_two_numbers_or_none_is_refused(typed: str) -> None:
    with pytest.raises(ValueError, match="a number"):
        Fact.model_validate(NUMBER).read(typed)


@pytest.mark.parametrize(
    ("typed", "number"), [("1,5", 1.5), ("0,125", 0.125), ("1.500", 1.5), ("-2", -2), ("1e3", 1000)]
)
def test_a_number_may_have_a_decimal_comma(typed: str, number: float) -> None:
    assert Fact.model_validate(NUMBER).read(typed) == number


@pytest.mark.parametrize(
    ("given", "allowed"),
    [
        ({"age": "17"}, "a number from 18 to 89 years"),
        ({"age": "old"}, "a number from 18 to 89 years"),
        ({"age": "nan"}, "a number from 18 to 89 years"),
        ({"sex": "f"}, "one of: female, male, other"),
        ({"experience": "2.5"}, "a whole number from 1 to 5"),
        ({"sport": "x" * 401}, "one line of at most 400 characters"),
        ({"sport": "NA"}, "one line of at most 400 characters"),
        ({"sport": "tab\x07"}, "one line of at most 400 characters"),
        ({"income": "1"}, "age, sex, experience, sport"),
    ],
)
def test_what_is_not_allowed_is_refused(study: MadeStudy, given: dict[str, str], allowed: str) -> None:
    with pytest.raises(RosterError) as refused:
        facts.record(study.file, "03", given, root=study.root)
    assert refused.value.finding.allowed == allowed
    assert not storage.facts_path(study.root, "03").exists()


def test_a_copy_for_others_has_ages_in_groups_and_no_text(study: MadeStudy, tmp_path: Path) -> None:
    licensed(study)
    for label in ("01", "02"):
        enrolling.sharing(study.file, label, True, root=study.root)
    out = sharing.share(study.root, tmp_path / "copy").root
    shown = sorted((row["age_group"], row["sex"]) for row in rows(out))
    assert shown == [("30 to below 40", "female"), ("60 to below 70", "n/a")]
    assert files_with(out, "snorkelling", "61.5") == []
    assert verify(out).refused == 0


def test_who_is_alike_is_counted_with_what_is_shared_of_them(tmp_path: Path, refuses: Refuses) -> None:
    text = SHARING.replace("smallest_group = 1", "smallest_group = 2")
    study = make_study(
        tmp_path / "study", study="alike", further=asking(text, PEOPLE), keys="capt", enrolled=4, sessions=4
    )
    licensed(study)
    first = [one.tasks[0] for one in study.tasks[:4]]
    assert {first.count(task) for task in first} == {2}
    for one in study.tasks[:4]:
        facts.record(study.file, one.participant, {"age": "34" if one.tasks[0] == first[0] else "64"}, root=study.root)
        enrolling.sharing(study.file, one.participant, True, root=study.root)
    build.build(study.root)
    assert sharing.share(study.root, tmp_path / "copy").smallest_group == 2
    facts.record(study.file, "01", {"age": "44"}, root=study.root)
    build.build(study.root)
    with pytest.raises(DatasetError) as refused:
        sharing.share(study.root, tmp_path / "other")
    assert refused.value.finding.allowed.startswith("2 ")


def test_enrol_takes_them_and_facts_adds_and_corrects(study: MadeStudy, palpate: Palpate) -> None:
    place = ("--dataset", study.root)
    given = ("--fact", "age=25", "--fact", "sex=", "--consent-on", "2001-09-09")
    assert palpate("enrol", study.file, "-p", "04", *given, *place)[0] == 0
    assert palpate("facts", study.file, "-p", "04", "--fact", "age=26", *place)[0] == 0
    assert answers(study, "04") == {"age": 26, "sex": None}
    for wrong in (("--fact", "age"), ("--fact", "age=4"), ()):
        assert palpate("facts", study.file, "-p", "04", *wrong, *place)[0] == RosterError.exit_code
    assert palpate("enrol", study.file, "-p", "05", "--fact", "age=4", *place)[0] == RosterError.exit_code
    assert "05" not in Roster.load(storage.roster_path(study.root)).consent_on


def test_a_protocol_that_asks_nothing_takes_nothing(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", sessions=0)
    with pytest.raises(PalpateError):
        facts.record(study.file, "01", {"age": "34"}, root=study.root)
