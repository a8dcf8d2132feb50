"""The phase of virtual footsteps in a protocol: what a task with one breaks, and what its board reads.

`rules` and the page look this up for a study of which a task has a phase.
"""

from collections.abc import Iterator

from palpate.experiment.protocol.kinds import tables_at
from palpate.experiment.protocol.models import Task
from palpate.experiment.settings.load import Broken, Table

_WORDS = {
    "zero": "zero: all frequencies begin together, so that a vibration is a click at contact",
    "random": "random: drawn once for all steps, so that a vibration is spread over the length of a recording",
    "recorded": (
        "recorded: a vibration rises and falls in time (5 ms) as the recordings did; between the speeds recorded, each "
        "part of its energy comes between the times at which it came at the next slower and the next faster speed"
    ),
}


def broken(table: Table) -> Iterator[Broken]:
    """Yield tasks with a phase that are no virtual footsteps."""
    for i, task in tables_at(table, "tasks"):
        if task.get("phase") is not None and (task.get("kind"), task.get("stimulus")) != ("footstep", "virtual"):
            yield Broken(("tasks", i, "phase"), "no value: only a virtual footstep is made of amplitudes and phases")


def fact(task: Task) -> tuple[str, str]:
    """Return what the board reads of the phase of a task that has one."""
    return "Phase", _WORDS[str(task.phase)]
