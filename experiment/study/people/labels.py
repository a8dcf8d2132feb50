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
            raise RosterError(f"the data of participant {who} are erased", remedy="nothing is left to correct")
    for who in (told.participant, told.person) if told.exchanged else (told.participant,):
        if not storage.journal_path(root, who, told.task).exists():
            what = f"got no session of task {told.task} under the label {who}"
            raise RosterError(what, remedy="give the label and the task that the session has, as in its file's name")
    under = [path.parent.name.removeprefix("sub-") for path in storage.journals(root) if _is_of(path, told.task)]
    known = roster.took_part | told.people
    twice = Counter(known.get((who, told.task), who) for who in under)
    if person := next((one for one, times in twice.items() if times > 1), None):
        what = f"participant {person} would have two sessions of task {told.task}"
        remedy = "if two participants took each other's place, give --exchanged; otherwise put the other session right"
        raise RosterError(what, remedy=f"{remedy} first")


def _is_of(path: Path, task: str) -> bool:
    return path == storage.journal_path(path.parents[2], path.parent.name.removeprefix("sub-"), task)
