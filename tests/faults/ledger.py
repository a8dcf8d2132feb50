"""What the screen confirmed and the panel heard of one session, held against its journal and its table."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.errors import JournalError
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Armed, Entry, Redo
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep
from palpate.experiment.records.progress import progress
from tests.faults.live import KEYS


@dataclass(frozen=True)
class Wrong:
    """What does not hold; `lost` counts what was lost, doubled, invented or let in by it, 0 where nothing was."""

    text: str
    lost: int = 0


class Ledger:
    """One session, over all lives of its runner. Nothing in it comes from palpate's files."""

    def __init__(self, dataset: Path, participant: str, task: str) -> None:
        self.dataset, self.participant, self.task = dataset, participant, task
        self.journal = storage.journal_path(dataset, participant, task)
        self._typed: dict[int, str] = {}
        self._confirmed: dict[int, str] = {}
        self._screen: list[Wrong] = []
        self._known: Counter[str] = Counter()

    def asked(self, trial: int, key: str) -> None:
        """The screen asks for an answer, and `key` is typed."""
        if trial in self._confirmed:
            self._screen.append(Wrong(f"trial {trial} is asked for again although it was confirmed", 1))
        self._typed[trial] = KEYS[key]

    def confirmed(self, trial: int, answer: str) -> None:
        """The screen says that an answer is on disk."""
        if trial in self._confirmed or self._typed.get(trial) != answer:
            what = f"trial {trial}: {answer!r} was confirmed, {self._typed.get(trial)!r} was typed"
            self._screen.append(Wrong(what, 1))
        self._confirmed[trial] = answer

    @property
    def answered(self) -> int:
        return len(self._confirmed)

    def entries(self) -> tuple[Entry, ...]:
        return journal.read(self.journal).entries if self.journal.exists() else ()

    def wrong(self, heard: list[dict[str, Any]]) -> list[Wrong]:
        """Return what does not hold after a life in which the panel heard some stimuli.

        An answer that was on disk before it could be confirmed counts as confirmed from now on.
        """
        wrong, self._screen = self._screen, []
        try:
            entries = self.entries()
        except JournalError as error:
            return [*wrong, Wrong(f"the journal is refused: {error}", max(self.answered, 1))]
        if not entries:
            lost = self.answered + len(heard)
            gone = f"there is no journal of {self.answered} confirmed answers and {len(heard)} stimuli"
            return [*wrong, Wrong(gone, lost)] if lost else wrong
        answers = Counter(e.trial for e in entries if isinstance(e, Answer))
        wrong += [Wrong(f"trial {trial} has {count} answers", 1) for trial, count in answers.items() if count > 1]
        on_disk = {e.trial: e.answered or "no answer" for e in entries if isinstance(e, Answer)}
        counted = set(progress(entries).answered)
        wrong += [
            Wrong(f"trial {trial}: {answer!r} was confirmed, {on_disk.get(trial)!r} is in the journal", 1)
            for trial, answer in self._confirmed.items()
            if on_disk.get(trial) != answer or trial not in counted
        ]
        for trial, answer in on_disk.items():
            if self._confirmed.setdefault(trial, answer) == answer and self._typed.get(trial) != answer:
                what = f"trial {trial}: {answer!r} is in the journal, {self._typed.get(trial)!r} was typed"
                wrong.append(Wrong(what, 1))
        return wrong + self._unknown(entries, heard) + _attempts(entries)

    def _unknown(self, entries: tuple[Entry, ...], heard: list[dict[str, Any]]) -> list[Wrong]:
        """Return the stimuli that no entry knows: neither a step, nor an attempt that was armed and has no end yet."""
        steps = Counter(e.stimulus.handed_sha256 for e in entries if isinstance(e, FootStep) and e.stimulus)
        left = Counter(one["heard"] for one in heard) - (steps - self._known)
        broken = sum(isinstance(e, BrokenOff) and e.felt for e in entries) + (progress(entries).armed is not None)
        spare = broken - self._known["broken"]
        self._known = steps + Counter(broken=broken - (progress(entries).armed is not None))
        unknown = left.total() - spare
        return [Wrong(f"{unknown} stimuli were heard that the journal does not know", unknown)] if unknown > 0 else []

    def table(self) -> list[Wrong]:
        """Return what is wrong with the table of a session that is complete."""
        name = f"sub-{self.participant}_task-{self.task}_events.tsv"
        path = self.dataset / f"sub-{self.participant}" / "beh" / name
        if not path.exists():
            return [Wrong(f"{name} is missing", self.answered)]
        with path.open() as file:
            rows = [row for row in csv.DictReader(file, delimiter="\t") if row["counted"] == "1"]
        found = Counter((int(row["trial"]), row["answered"].replace(NO_ANSWER, "no answer")) for row in rows)
        wanted = Counter(self._confirmed.items())
        lost = max((wanted - found).total(), (found - wanted).total())
        return [Wrong(f"{name} has {sorted(found)}; the ledger has {sorted(wanted)}", lost)] if lost else []


def _attempts(entries: tuple[Entry, ...]) -> list[Wrong]:
    """Return which attempts were armed twice, and which have no end although another was armed after them."""
    armed = [(e.trial, e.attempt) for e in entries if isinstance(e, Armed)]
    wrong = [Wrong(f"attempt {one} was armed {count} times", 1) for one, count in Counter(armed).items() if count > 1]
    under_way: tuple[int, int] | None = None
    for entry in entries:
        if isinstance(entry, Armed):
            if under_way is not None:
                wrong.append(Wrong(f"attempt {under_way} has no end", 1))
            under_way = entry.trial, entry.attempt
        elif isinstance(entry, FootStep | BrokenOff | Redo):
            under_way = None
    return wrong
