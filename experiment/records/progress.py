"""What a journal says is done and what remains; the same answer while a session runs and after any kill.

A postponed trial comes again at the end of its block, after those postponed before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

from palpate.experiment.records import entries as entry_kinds
from palpate.experiment.records.entries import Entry

MEASURED = 100
"""So many answers and ends of attempts are at hand: about fifty trials."""


@dataclass(frozen=True)
class Progress:
    """Where a session stands.

    `said` are the answers that count, in order, each with its trial and None for no answer; `corrected` those trials
    whose answers were changed. `put_off` are the trials moved to the end of their blocks, in order. `attempts` counts
    the begun attempts by trial. `armed` has no end on disk, `unanswered` no answer, each as trial and attempt. `footer`
    is the last one if the session has ended since. `masker_db_a` is the latest level, dB(A). `visited` are steps beside
    the trials. `stimuli` were played in steps and probes, `vibration_s` together, s. `levels` are on record by trial,
    the newest each, and of tracks that `ended` no trial remains. `trained` says of each answer of the training whether
    it was right, and `training` how that ended. `measured` are the newest answers and ends of attempts, oldest first.
    """

    header: entry_kinds.Header
    said: tuple[tuple[int, str | None], ...] = ()
    corrected: frozenset[int] = frozenset()
    put_off: tuple[int, ...] = ()
    attempts: Mapping[int, int] = field(default_factory=dict)
    armed: tuple[int, int] | None = None
    unanswered: tuple[int, int] | None = None
    footer: entry_kinds.Footer | None = None
    masker_db_a: float | None = None
    visited: tuple[str, ...] = ()
    stimuli: int = 0
    vibration_s: float = 0.0
    levels: Mapping[int, float] = field(default_factory=dict)
    ended: frozenset[str] = frozenset()
    trained: tuple[bool, ...] = ()
    training: entry_kinds.TrainingEnded | None = None
    measured: tuple[Entry, ...] = ()

    @property
    def answered(self) -> tuple[int, ...]:
        """Trials with an answer that counts, in the order in which they were answered."""
        return tuple(trial for trial, _ in self.said)

    @property
    def complete(self) -> bool:
        """Whether the session has ended for good."""
        return self.footer is not None and self.footer.reason == "complete"

    @property
    def remaining(self) -> tuple[entry_kinds.PlannedTrial, ...]:
        """Planned trials without an answer, of tracks that have not ended, in the order in which they are run.

        None remain where the training ended the session.
        """
        if self.training is not None and self.training.ends:
            return ()
        order, size, answered = self.header.order, self.header.block_trials, frozenset(self.answered)
        answered |= {planned.trial for planned in order if self.ended and planned.track in self.ended}
        turns = {trial: turn for turn, trial in enumerate(self.put_off, start=1)}
        left: list[entry_kinds.PlannedTrial] = []
        for begin in range(0, len(order), size):
            block = [planned for planned in order[begin : begin + size] if planned.trial not in answered]
            left += sorted(block, key=lambda planned: turns.get(planned.trial, 0))
        return tuple(left)

    @property
    def trials(self) -> int:
        """How many trials have an answer or remain."""
        return len(self.said) + len(self.remaining)

    @property
    def training_words(self) -> str:
        """How far the training is, in words; nothing where none has begun."""
        if (ended := self.training) is None:
            return f"{len(self.trained)} training trials have been answered" if self.trained else ""
        reached = {None: "", True: ", criterion reached", False: ", criterion not reached"}[ended.reached]
        return f"The training is over after {ended.answered} answers{reached}"

    def after(self, entry: Entry) -> Progress:
        """Return where the session stands after one more entry."""
        if isinstance(entry, entry_kinds.Withdrawal | entry_kinds.Note | entry_kinds.Commanded | entry_kinds.Shown):
            return self
        footer = entry if isinstance(entry, entry_kinds.Footer) else None
        done = self if footer is self.footer else replace(self, footer=footer)
        for lasts_s in entry.felt_s:
            done = replace(done, stimuli=done.stimuli + 1, vibration_s=done.vibration_s + lasts_s)
        if isinstance(entry, entry_kinds.Answer | entry_kinds.Outcome):
            done = replace(done, measured=(*done.measured[1 - MEASURED :], entry))
        if isinstance(entry, entry_kinds.Armed):
            attempts = {**self.attempts, entry.trial: entry.attempt}
            return replace(done, attempts=attempts, armed=(entry.trial, entry.attempt), unanswered=None)
        if isinstance(entry, entry_kinds.Outcome):
            asked = (entry.trial, entry.attempt) if entry.asks else done.unanswered
            ended = replace(done, armed=None, unanswered=asked)
            return ended._later(entry.trial) if entry.put_off else ended
        if isinstance(entry, entry_kinds.Answer):
            kept = done._without_answer(entry.trial)
            return replace(kept, said=(*kept.said, (entry.trial, entry.answered)), unanswered=None)
        if isinstance(entry, entry_kinds.Correction):
            said = tuple((trial, entry.answered if trial == entry.trial else said) for trial, said in done.said)
            return replace(done, said=said, corrected=done.corrected | {entry.trial})
        if isinstance(entry, entry_kinds.Redo):
            redone = replace(done._without_answer(entry.trial), armed=None, unanswered=None)
            return redone._later(entry.trial) if entry.put_off else redone
        if isinstance(entry, entry_kinds.LevelChosen):
            return replace(done, levels={**done.levels, entry.trial: entry.level})
        if isinstance(entry, entry_kinds.TrackEnded):
            return replace(done, ended=done.ended | {entry.track})
        return done._after_other(entry)

    def _after_other(self, entry: Entry) -> Progress:
        """Return where the session stands after an entry that is of no trial that counts."""
        if isinstance(entry, entry_kinds.Trained) and entry.right is not None:
            return replace(self, trained=(*self.trained, entry.right))
        if isinstance(entry, entry_kinds.TrainingEnded):
            return replace(self, training=entry)
        if isinstance(entry, entry_kinds.Visited | entry_kinds.Questioned):
            return replace(self, visited=(*self.visited, entry.step))
        if isinstance(entry, entry_kinds.MaskerSet) and entry.level_db_a is not None:
            return replace(self, masker_db_a=entry.level_db_a)
        return self

    def _without_answer(self, trial: int) -> Progress:
        said = tuple(one for one in self.said if one[0] != trial)
        return replace(self, said=said, corrected=self.corrected - {trial})

    def _later(self, trial: int) -> Progress:
        return replace(self, put_off=(*(one for one in self.put_off if one != trial), trial))


def progress(entries: Sequence[Entry]) -> Progress:
    """Return where a session stands after all entries of its journal, the header first."""
    header = entries[0]
    if not isinstance(header, entry_kinds.Header):
        raise TypeError("the first entry of a journal is its header")
    return reduce(Progress.after, entries[1:], Progress(header))
