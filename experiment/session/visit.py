"""A participant's visit: their tasks one after the other, continued after each pause."""

from collections.abc import Callable, Sequence
from functools import partial

from palpate.experiment.desk.questions import DEBRIEFING, INTERRUPTED, STOP, Attended, Console, GoOn, Notice
from palpate.experiment.errors import ActuatorError, AudioError, PauseAsked, TrackerError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Footer
from palpate.experiment.study.schedule import Allocation

BETWEEN = "The visit is paused; no session is running."
"""What is said of a pause at a question before a session, or in the break."""

Noting = Callable[[str], Attended | None]
"""Gives what takes a note in a pause of a task: its session or, before that has begun, the one before."""


def walk(*, console: Console, tasks: Sequence[str], run: Callable[[str], Footer], noting: Noting) -> Footer:
    """Run a participant's tasks, one at least, and return the footer of the last one begun.

    In a pause the console attends what `noting` gives; the task continues when the experimenter wants it to. Raises
    `PalpateError` if it does not, `PauseAsked` without a session under way.
    """
    for task in tasks:
        footer = _task(console, task, run, partial(noting, task))
        if footer.reason != "complete":
            break
    return footer


def _task(console: Console, task: str, run: Callable[[str], Footer], noting: Callable[[], Attended | None]) -> Footer:
    while True:
        try:
            footer = run(task)
        except PauseAsked:
            if not _goes_on(console, BETWEEN, noting):
                raise
            continue
        except (TrackerError, ActuatorError, AudioError) as error:
            said = error.sentence()
            if not _goes_on(console, f"{said[:1].upper()}{said[1:]}.", noting):
                raise
            continue
        # Who ends the process by a signal waits for no key.
        if footer.reason != "paused" or footer.detail == INTERRUPTED:
            return footer
        if not _goes_on(console, ending_words(footer, onward=False), noting):
            return footer


def _goes_on(console: Console, why: str, noting: Callable[[], Attended | None]) -> bool:
    session = noting()
    console.attend(session)
    try:
        return console.ask(GoOn(why, begun=session is not None)).key != STOP
    finally:
        console.attend(None)


def tell_group(console: Console, protocol: Protocol, allocation: Allocation) -> None:
    """Tell of the group into which a participant was drawn, in a study with groups."""
    for group in getattr(protocol, "groups", ()):
        if group.id == allocation.group:
            console.tell(Notice(f"Group for {allocation.participant}: {group.id}. {group.description}"))


def ask_first(console: Console, ask: Callable[[], None]) -> None:
    """Ask something before the first session; a pause there goes on with the same question. Raises `PauseAsked`."""
    while True:
        try:
            return ask()
        except PauseAsked:
            if console.ask(GoOn(BETWEEN, begun=False)).key == STOP:
                raise


def visit_steps(tasks: Sequence[str]) -> tuple[str, ...]:
    """Return the steps of a visit with these tasks, in order."""
    return (*tasks, DEBRIEFING)


def ending_words(footer: Footer, *, onward: bool = True, last: bool = False) -> str:
    """Return in sentences how a session ended, and, if `onward`, how it goes on; it may be the `last` of a visit."""
    if footer.reason == "complete":
        return f"The session is complete: {footer.answered} answers.{' The visit is complete.' if last else ''}"
    how = f" {footer.detail}" if footer.detail.startswith("by ") else ""
    why = "" if how else f": {footer.detail.replace('interrupted', 'it was interrupted')}"
    kept = f"{footer.answered} answer{'' if footer.answered == 1 else 's'} on disk"
    # Nothing goes on where all of the protocol's minutes are used up.
    goes_on = onward and not footer.detail.endswith("session are over")
    again = " To continue it, run the same command." if goes_on else ""
    return f"The session is {footer.reason}{how}, with {kept}{why}.{again}"
