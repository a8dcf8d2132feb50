"""Who agrees that the sound of their answers is kept: on the roster, taken back, and asked for by nobody else."""

from __future__ import annotations

from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.questions import NO, YES, Arm, Question, Reply
from palpate.experiment.desk.voice import ear
from palpate.experiment.errors import RosterError
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import run
from palpate.experiment.study import enrolment, withdrawal
from palpate.experiment.study.roster import Roster
from tests.approved import Refuses, anywhere
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.experiment.session.scripted import ScriptedConsole


@pytest.fixture
def study(tmp_path: Path) -> MadeStudy:
    return make_study(tmp_path / "study", enrolled=2, sessions=1, voices=True)


def known(study: MadeStudy) -> dict[str, bool]:
    return Roster.load(storage.roster_path(study.root)).voices


def test_the_last_word_of_a_participant_holds_and_no_deletes(
    study: MadeStudy, palpate: Palpate, approved: SnapshotAssertion
) -> None:
    assert known(study) == {}
    call = ("consent", study.file, "--participant", "01", "--dataset", study.root)
    code, out, _ = palpate(*call, "--voices")
    assert code == 0
    assert anywhere(out, study.root.parent) == approved
    sound = storage.voices_folder(study.root, "01") / "task-real_trial-001_attempt-1.wav"
    ear.keep(sound, b"sound")
    assert palpate(*call, "--no-voices")[0] == 0
    assert known(study) == {"01": False}
    assert not sound.parent.exists()
    assert verify(study.root).refused == 0


def test_nobody_is_asked_who_is_not_enrolled_or_has_withdrawn(study: MadeStudy, refuses: Refuses) -> None:
    with refuses(RosterError):
        enrolment.voices(study.file, "07", True, root=study.root)
    withdrawal.withdraw(study.file, "02", "asked to stop", root=study.root, rebuild=lambda root: None)
    with refuses(RosterError):
        enrolment.voices(study.file, "02", True, root=study.root)


def test_a_study_that_keeps_no_sound_asks_nobody(
    tmp_path: Path, palpate: Palpate, refuses: Refuses, approved: SnapshotAssertion
) -> None:
    study = make_study(tmp_path / "study", enrolled=1, sessions=0)
    with refuses(RosterError):
        enrolment.voices(study.file, "01", True, root=study.root)
    code, _, err = palpate("consent", study.file, "--participant", "01", "--dataset", study.root)
    assert code == 2
    assert err == approved


class Answers(ScriptedConsole):
    """Says yes or no, as scripted, and keeps what it was asked."""

    def __init__(self, *answers: bool) -> None:
        super().__init__(ManualClock(0), "")
        self.answers, self.asked = list(answers), list[str]()

    def ask(self, question: Question | Arm) -> Reply:
        self.asked.append(question.text)
        return Reply(YES if self.answers.pop(0) else NO)


def test_a_visit_asks_once_and_nobody_who_may_not_be_run(study: MadeStudy) -> None:
    console = Answers(True, False)
    for who in ("01", "02", "01", "02", "07"):
        run._ask_voices(study.root, study.file, study.protocol, who, console)
    assert known(study) == {"01": True, "02": False}
    assert ["participant 01's" in text for text in console.asked] == [True, False]
    assert ["participant 02's" in text for text in console.asked] == [False, True]
