"""Training before the trials of a task: trials by the same lines, on record on their own, and told right or wrong.

Its trials are drawn under a name of their own, so that those that count are the same without it. Every entry about one
goes into the journal as a `Trained`, which nothing takes for an entry of a trial that counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from palpate.experiment.desk.questions import Console, Instructed, Notice
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.protocol.models import Training as Planned
from palpate.experiment.records.entries import (
    Answer,
    Entry,
    Header,
    PlannedTrial,
    Redo,
    Trace,
    Trained,
    TrainingEnded,
    TrainingTrial,
)
from palpate.experiment.records.progress import Progress
from palpate.experiment.session.kind import Log
from palpate.experiment.study.schedule import Draws

if TYPE_CHECKING:
    from palpate.experiment.session.attempt import Attempts


def drawn(protocol: Protocol, planned: Planned, header: Header) -> tuple[TrainingTrial, ...]:
    """Return a participant's trials of a training: shuffled blocks of what has a right answer, in either order."""
    task = protocol.task(header.task)
    draws = Draws("training", header.seed, header.participant, task.id)
    answers = [one.answer for one in design_of(task.design).answers(protocol, ()).values()]
    block = [
        one for one in protocol.presentations(task) if any(is_right(protocol, task, one, answer) for answer in answers)
    ]
    order: list[tuple[str, ...]] = []
    while len(order) < planned.trials:
        order += [one[::-1] if draws.below(2) else one for one in draws.shuffled(block)]
    shown = enumerate(order[: planned.trials], start=1)
    return tuple(TrainingTrial(trial=number, presented=one, of=planned.trials) for number, one in shown)


def is_right(protocol: Protocol, task: Task, presented: tuple[str, ...], answered: str | None) -> bool:
    """Return whether an answer is right; none is not."""
    right = design_of(task.design).right
    return right is not None and answered is not None and right(protocol, presented, answered)


class Training(Log):
    """Implements `Log` for the training of one session: `done` is where that stands, whose entries go to `log`."""

    def __init__(self, protocol: Protocol, planned: Planned, log: Log, console: Console) -> None:
        header = log.done.header
        order = drawn(protocol, planned, header)
        self._protocol, self._planned, self._log, self._console = protocol, planned, log, console
        self._task = protocol.task(header.task)
        self._done = Progress(header.model_copy(update={"order": order, "block_trials": len(order)}))
        self._told = len(log.done.trained)
        self._announced = 0

    @property
    def done(self) -> Progress:
        return self._done

    def write(self, entry: Entry) -> None:
        right = None
        if isinstance(entry, Answer):
            right = is_right(self._protocol, self._task, entry.presented, entry.answered)
        self._log.write(Trained(entry=entry, right=right))
        self._done = self.done.after(entry)

    @property
    def waiting_s(self) -> float:
        return self._log.waiting_s

    def free_bytes(self) -> int:
        return self._log.free_bytes()

    def keep(self, raw: bytes) -> Trace:
        return self._log.keep(raw)

    @contextmanager
    def led(self, attempts: Attempts, recorded: Iterable[Entry]) -> Iterator[None]:
        """Have attempts be of the training, from where `recorded` entries leave it; no microphone listens."""
        for entry in recorded:
            if isinstance(entry, Trained):
                self._done = self.done.after(entry.entry)
        log, ear = attempts.log, attempts.ear
        attempts.log, attempts.ear, attempts.remarks.training = self, None, True
        try:
            for cut in filter(None, (self.done.unanswered, self.done.armed)):
                self.write(Redo(trial=cut[0], attempt=cut[1], reason="the session was interrupted", put_off=True))
            yield
        finally:
            attempts.log, attempts.ear, attempts.remarks.training = log, ear, False
            attempts.remarks.trial = None

    def next_trial(self) -> PlannedTrial | None:
        """Return the next trial, once the answer before is told right or wrong; None where the training is over."""
        answers = self._log.done.trained
        if len(answers) > self._told and self._planned.feedback:
            told = self._planned.told_right if answers[-1] else self._planned.told_wrong
            self._console.tell(Instructed(told, self._protocol.question(self._task)))
        self._told = len(answers)
        if self._log.done.training is not None:
            return None
        reached = self._reached(answers)
        if reached or not self.done.remaining:
            criterion = self._planned.criterion
            ends = criterion is not None and criterion.unmet == "end" and not reached
            entry = TrainingEnded(answered=len(answers), right=sum(answers), reached=reached, ends=ends)
            self._log.write(entry)
            self._console.tell(Notice(f"{self._log.done.training_words}."))
            if not ends:
                asks, names = self._protocol.question(self._task), self._task.picture_files
                self._console.tell(Instructed(self._task.instruction, asks, names))
            return None
        planned = self.done.remaining[0]
        if planned.trial != self._announced:
            self._announced = planned.trial
            told = f"Training, trial {planned.trial} of at most {self._planned.trials} (does not count)."
            self._console.tell(Notice(told))
        return planned

    def _reached(self, answers: tuple[bool, ...]) -> bool | None:
        criterion = self._planned.criterion
        return None if criterion is None else sum(answers[-criterion.of :]) >= criterion.right
