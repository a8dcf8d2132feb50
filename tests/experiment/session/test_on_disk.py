"""An answer is on disk when the experimenter is told so: at that moment the journal is read by another open file."""

from __future__ import annotations

from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.desk.questions import Answered, Event
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer
from tests.experiment.session.bench import ORDER, bench, header


def test_an_answer_is_in_the_journal_when_it_is_confirmed(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpn")
    tell, seen = one.console.tell, list[bool]()

    def told(event: Event) -> None:
        if isinstance(event, Answered):
            entry = journal.read(storage.journal_path(tmp_path, "01", "virtual")).entries[-1]
            seen.append(isinstance(entry, Answer) and (entry.trial, entry.answered) == (event.trial, event.answer))
        tell(event)

    one.console.tell = told  # type: ignore[method-assign]
    one.run(protocol, header("virtual"), tmp_path)
    assert seen == [True] * len(ORDER)
