"""The phase of virtual footsteps in a protocol: what a task with one breaks, and what its board reads.

`rules` and the page look this up for a study of which a task has a phase.
"""

from collections.abc import Iterator

from palpate.experiment.protocol.kinds import tables_at
from palpate.experiment.protocol.models import Task
from palpate.experiment.settings.load import Broken, Table

_WORDS = {
    "zero": "zero: all frequencies start in phase, so a vibration is a click at contact",
    "random": "random: phases are drawn once for all steps, so a vibration lasts as long as a recording",
    "recorded": (
        "recorded: a vibration rises and falls over time like the recordings (with a resolution of 5 ms). Between "
        "recorded speeds, the timing of its energy is interpolated from the next slower and the next faster speed"
    ),
}


def broken(table: Table) -> Iterator[Broken]:
    """Yield tasks with a phase that are no virtual footsteps."""
    for i, task in tables_at(table, "tasks"):
        if task.get("phase") is not None and (task.get("kind"), task.get("stimulus")) != ("footstep", "virtual"):
            yield Broken(("tasks", i, "phase"), "no value: only virtual footsteps are made from amplitudes and phases")


def fact(task: Task) -> tuple[str, str]:
    """Return what the board reads of the phase of a task that has one."""
    return "Phase", _WORDS[str(task.phase)]
