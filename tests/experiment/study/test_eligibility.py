"""Criteria that are confirmed one by one before a first session, on record. All SIMULATED."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any, cast

import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import checks
from palpate.experiment.desk.questions import NO, YES, Console, Question, Reply
from palpate.experiment.errors import RosterError
from palpate.experiment.protocol import page
from palpate.experiment.session import run
from palpate.experiment.study.admission import Admission, admit
from palpate.experiment.study.roster import Roster
from tests.experiment.dataset.studies import MadeStudy, make_study

CONFIRMED = {"format = 4": "format = 7", "[eligibility]": "[eligibility]\nconfirmed = true"}


class Asked:
    """Implements `Console` as far as it is asked: gives these keys."""

    def __init__(self, *keys: str) -> None:
        self.keys = [*keys]
        self.texts: list[str] = []

    def ask(self, question: Question) -> Reply:
        self.texts.append(question.text)
        return Reply(self.keys.pop(0))


@pytest.fixture
def study(tmp_path: Path) -> MadeStudy:
    return make_study(tmp_path / "study", sessions=0, further=CONFIRMED)


def ask(study: MadeStudy, *keys: str, **changed: Any) -> list[str]:
    protocol = study.protocol
    eligibility = protocol.eligibility.model_copy(update=changed)
    console = Asked(*keys)
    run._ask_criteria(
        study.root, protocol.model_copy(update={"eligibility": eligibility}), "01", cast("Console", console)
    )
    return console.texts


def admitted(study: MadeStudy) -> Admission:
    own = study.tasks[0]
    return admit(study.root, study.file, study.protocol, own, own.tasks[0], (), date.today())


def test_nobody_is_run_before_each_criterion_is_confirmed(study: MadeStudy) -> None:
    criteria = study.protocol.eligibility.criteria
    with pytest.raises(RosterError):
        admitted(study)
    with pytest.raises(RosterError, match=f"criterion {len(criteria)};"):
        ask(study, *[YES] * (len(criteria) - 1), NO)
    assert Roster.load(storage.roster_path(study.root)).eligible == {}
    texts = ask(study, *[YES] * len(criteria))
    assert all(" ".join(criterion.split()) in text for criterion, text in zip(criteria, texts, strict=True))
    assert admitted(study).approved.number == 1
    assert ask(study) == []


def test_other_criteria_are_confirmed_anew(study: MadeStudy) -> None:
    ask(study, *[YES] * len(study.protocol.eligibility.criteria))
    assert len(ask(study, YES, criteria=("Two feet.",))) == 1
    assert ask(study, confirmed=False) == []


def test_a_session_of_somebody_who_was_not_confirmed_is_refused(study: MadeStudy) -> None:
    own = study.tasks[0]
    study.run(study.header(own.participant, own.tasks[0]))
    (found,) = checks.load(study.root).damage
    assert found.refuses


def test_the_board_reads_that_they_are_confirmed(study: MadeStudy) -> None:
    old = study.protocol.model_copy(
        update={"eligibility": study.protocol.eligibility.model_copy(update={"confirmed": False})}
    )
    told, before = (len(page.page(one, "f").splitlines()) for one in (study.protocol, old))
    assert told > before
