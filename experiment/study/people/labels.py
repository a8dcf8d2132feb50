"""Whose a session under another participant's label may be."""

from collections import Counter
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import RosterError
from palpate.experiment.study.lines import TookPart
from palpate.experiment.study.roster import Roster


def check_took_part(roster: Roster, root: Path, told: TookPart) -> None:
    """Return when a session may be that of another person.

    Raises `RosterError` without such a session, for somebody who is not enrolled or was erased, and where a person
    would have two sessions of one task.
    """
    for who in (told.participant, told.person):
        roster.check_enrolled(who)
        if who in roster.erased:
            raise RosterError(f"the data of participant {who} have been erased", remedy="there is nothing to correct")
    for who in (told.participant, told.person) if told.exchanged else (told.participant,):
        if not storage.journal_path(root, who, told.task).exists():
            what = f"there is no session for task {told.task} under label {who}"
            raise RosterError(what, remedy="give the label and the task in the session's file name")
    under = [path.parent.name.removeprefix("sub-") for path in storage.journals(root) if _is_of(path, told.task)]
    known = roster.took_part | told.people
    twice = Counter(known.get((who, told.task), who) for who in under)
    if person := next((one for one, times in twice.items() if times > 1), None):
        what = f"participant {person} would have two sessions for task {told.task}"
        remedy = "if two participants exchanged labels, add --exchanged; otherwise correct the other session"
        raise RosterError(what, remedy=f"{remedy} first")


def _is_of(path: Path, task: str) -> bool:
    return path == storage.journal_path(path.parents[2], path.parent.name.removeprefix("sub-"), task)
