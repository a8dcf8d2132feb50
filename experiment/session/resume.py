"""What a journal says is done and what remains; the same answer after any kill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from experiment.records import Answer, AnyEntry, Footer, FootStep, Header, PlannedTrial, Redo, Resumed
from experiment.session.journal import Contents


@dataclass(frozen=True)
class Progress:
    """Where a session stands.

    Attributes:
        answered: trials with an answer that counts, in the order they were answered.
        remaining: planned trials without one, in the realised order.
        attempts: attempts begun so far, by trial.
        unanswered: the trial and attempt whose step is on disk but whose answer is not, if any.
        footer: the last footer, if the session has ended since it was last resumed.
    """

    answered: tuple[int, ...]
    remaining: tuple[PlannedTrial, ...]
    attempts: dict[int, int]
    unanswered: tuple[int, int] | None
    footer: Footer | None


def progress(entries: Sequence[AnyEntry]) -> Progress:
    """Replay a journal's entries.

    Args:
        entries: all entries, the header first.
    """
    header = entries[0]
    if not isinstance(header, Header):
        raise TypeError("the first entry of a journal is its header")
    answered: dict[int, int] = {}
    attempts: dict[int, int] = {}
    unanswered: tuple[int, int] | None = None
    footer: Footer | None = None
    for entry in entries:
        footer = entry if isinstance(entry, Footer) else None
        if isinstance(entry, FootStep):
            attempts[entry.trial] = entry.attempt
            unanswered = (entry.trial, entry.attempt)
        elif isinstance(entry, Answer):
            answered[entry.trial] = entry.attempt
            unanswered = None
        elif isinstance(entry, Redo):
            answered.pop(entry.trial, None)
            unanswered = None
    remaining = tuple(planned for planned in header.order if planned.trial not in answered)
    return Progress(tuple(answered), remaining, attempts, unanswered, footer)


def spent_ns(contents: Contents) -> int:
    """How long the session has lasted so far, pauses between its runners left out, ns."""
    spent, begun = 0, contents.lines[0].t_ns if contents.lines else 0
    for before, line in pairwise(contents.lines):
        if isinstance(line.entry, Resumed):
            spent, begun = spent + before.t_ns - begun, line.t_ns
    return spent + (contents.lines[-1].t_ns - begun if contents.lines else 0)
