"""An answer is on disk when the experimenter is told so: at that moment the journal is read by another open file."""

from __future__ import annotations

from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer
from tests.experiment.session.bench import ORDER, bench, header


def test_an_answer_is_in_the_journal_when_it_is_confirmed(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpn")
    confirmed, seen = one.console.confirmed, list[bool]()

    def confirms(*, trial: int, answer: str | None) -> None:
        entry = journal.read(storage.journal_path(tmp_path, "01", "virtual")).entries[-1]
        seen.append(isinstance(entry, Answer) and (entry.trial, entry.answered) == (trial, answer))
        confirmed(trial=trial, answer=answer)

    one.console.confirmed = confirms  # type: ignore[method-assign]
    one.run(protocol, header("virtual"), tmp_path)
    assert seen == [True] * len(ORDER)
