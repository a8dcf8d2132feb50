"""What participants tell of themselves: how it is given, what stays of it, and that nothing does after a withdrawal."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks
from palpate.experiment.dataset.outside import sharing
from palpate.experiment.dataset.verify import verify
from palpate.experiment.errors import DatasetError, PalpateError, RosterError
from palpate.experiment.study import enrolment, withdrawal
from palpate.experiment.study.people import facts
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.dataset.outside.test_sharing import licensed
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.experiment.protocol.asking import PEOPLE, SHARING, asking

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


def test_what_was_edited_is_not_taken_over_by_an_answer_that_is_given_later(study: MadeStudy) -> None:
    path = storage.facts_path(study.root, "01")
    path.write_bytes(path.read_bytes().replace(b": 34", b": 43"))
    facts.record(study.file, "01", {"experience": "5"}, root=study.root)
    assert facts.answers(study.root, "01") == {"experience": 5}


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
        enrolment.sharing(study.file, label, True, root=study.root)
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
        enrolment.sharing(study.file, one.participant, True, root=study.root)
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
    assert facts.answers(study.root, "04") == {"age": 26, "sex": None}
    for wrong in (("--fact", "age"), ("--fact", "age=4"), ()):
        assert palpate("facts", study.file, "-p", "04", *wrong, *place)[0] == RosterError.exit_code
    assert palpate("enrol", study.file, "-p", "05", "--fact", "age=4", *place)[0] == RosterError.exit_code
    assert "05" not in Roster.load(storage.roster_path(study.root)).consent_on


def test_a_protocol_that_asks_nothing_takes_nothing(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", sessions=0)
    with pytest.raises(PalpateError):
        facts.record(study.file, "01", {"age": "34"}, root=study.root)
