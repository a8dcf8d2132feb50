"""What a participant will do is told to nobody before their session, or on record. All data are SIMULATED."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.dataset import checks
from palpate.experiment.study.roster import Roster
from tests.approved import anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.faults.wrong import copied

CONCEALED = "concealed until the session begins (--reveal shows it, and the roster records that)"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 did their first task; 02 has not begun."""
    return make_study(tmp_path_factory.mktemp("made") / "study", sessions=1)


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def asked(study: MadeStudy, participant: str, *more: object) -> tuple[object, ...]:
    return ("schedule", study.file, "-p", participant, "--dataset", study.root, *more)


def test_a_task_is_shown_once_its_session_has_begun(study: MadeStudy, palpate: Palpate) -> None:
    code, out, _ = palpate(*asked(study, "01"))
    first, *trials, second = out.splitlines()
    assert code == 0
    assert first == f"Participant 01, task 1: {study.tasks[0].tasks[0]}"
    order = study.header("01", study.tasks[0].tasks[0]).order
    assert [line.split(maxsplit=1)[1] for line in trials] == [trial.presented[0] for trial in order]
    assert second == f"Participant 01, task 2: {CONCEALED}"
    _, out, _ = palpate(*asked(study, "02"))
    assert out.splitlines() == [f"Participant 02, task {n}: {CONCEALED}" for n in (1, 2)]
    _, out, _ = palpate(*asked(study, "02", "--json"))
    assert json.loads(out) == {"participant": "02", "seed": None, "example": False, "tasks": [None, None]}


def test_what_is_revealed_is_on_record_and_speaks_against_nothing(study: MadeStudy, palpate: Palpate) -> None:
    code, out, _ = palpate(*asked(study, "02", "--reveal", "--json"))
    assert code == 0
    assert [task["task"] for task in json.loads(out)["tasks"]] == list(study.tasks[1].tasks)
    assert palpate(*asked(study, "03", "--reveal"))[0] == 0, "not enrolled yet"
    known = Roster.load(storage.roster_path(study.root))
    assert list(known.revealed) == ["02", "03"]
    assert checks.load_sound(study.root).roster == known
    code, out, _ = palpate("status", study.root)
    assert code == 0
    assert f"  02, on {known.revealed['02']}." in out.splitlines()
    assert CONCEALED in palpate(*asked(study, "02"))[1], "revealed once, and not for ever"


def test_nothing_is_on_record_where_nothing_was_concealed(tmp_path: Path, palpate: Palpate) -> None:
    study = make_study(tmp_path / "study", enrolled=1, sessions=1, min_s=0)
    study.run(study.header("01", study.tasks[0].tasks[1]))
    before = storage.roster_path(study.root).read_bytes()
    assert palpate(*asked(study, "01", "--reveal"))[0] == 0
    assert storage.roster_path(study.root).read_bytes() == before


def test_the_default_folder_conceals_too_and_no_seed_goes_round_it(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.chdir(study.file.parent)
    code, out, _ = palpate("schedule", study.file, "-p", "02")
    assert code == 0
    assert out.startswith("Participant 02, task 1: ")
    assert out.splitlines()[0] == approved
    Path("participants").mkdir()
    study.root.rename("participants/okamoto2012")
    _, out, _ = palpate("schedule", study.file, "-p", "02")
    assert CONCEALED in out
    code, out, err = palpate("schedule", study.file, "-p", "02", "--seed", 1)
    assert (code, out) == (2, "")
    assert err == approved


@pytest.mark.parametrize("more", [("--reveal",), ("--dataset", "nowhere")])
def test_without_a_study_nothing_is_revealed_or_begun(
    tmp_path: Path,
    made: MadeStudy,
    palpate: Palpate,
    monkeypatch: pytest.MonkeyPatch,
    more: tuple[str, ...],
    approved: SnapshotAssertion,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = palpate("schedule", made.file, "-p", "02", *more)
    assert (code, out) == (2, "")
    assert anywhere(err, tmp_path) == approved
    assert list(tmp_path.iterdir()) == []


def test_another_version_of_the_protocol_shows_nothing(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    study.file.write_text(study.file.read_text("utf-8").replace("min_s = 180", "min_s = 181"), "utf-8")
    code, out, err = palpate(*asked(study, "01"))
    assert (code, out) == (2, "")
    assert anywhere(err, study.root.parent) == approved


def test_no_command_tells_the_seed_in_words(tmp_path: Path, palpate: Palpate, approved: SnapshotAssertion) -> None:
    study = make_study(tmp_path / "study", seed=987654321, enrolled=1, sessions=1)
    told = [
        palpate("enrol", study.file, "-p", "02", "--dataset", study.root, "--seed", 5),
        palpate("enrol", study.file, "-p", "02", "--dataset", study.root),
        palpate("journal", study.journal()),
        palpate("status", study.root, "--json"),
        palpate(*asked(study, "01")),
    ]
    assert [code for code, _, _ in told] == [2, 0, 0, 0, 0]
    assert anywhere(told[0][2], tmp_path) == approved
    assert not any("987654321" in out + err for _, out, err in told)
    assert storage.seed_path(study.root).stat().st_mode & 0o007 == 0
