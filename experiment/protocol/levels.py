"""Levels in a protocol: what a task with them breaks, what its board reads, and what is odd about it.

`rules` and `page` look this up for a study of which a task has levels.
"""

from collections.abc import Iterator

from palpate.experiment.errors import Finding, mismatch
from palpate.experiment.protocol.blocks import count, number
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.kinds import table_at, tables_at
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.settings.load import Broken, Table, written


def broken(table: Table) -> Iterator[Broken]:
    """Yield what tasks with levels cannot have."""
    for i, task in tables_at(table, "tasks"):
        if task.get("levels") is None:
            continue
        if task.get("stimulus") == "real":
            yield Broken(("tasks", i, "levels"), "no table: nothing changes how strong a real object feels")
        if table_at(task, "order").get("kind") in ("full-random", "max-run"):
            allowed = "blocked-random: with levels each block has one trial of each track"
            yield Broken(("tasks", i, "order", "kind"), allowed)
    for i, rule in tables_at(table, "exclusion"):
        if rule.get("when") == "answers-below":
            allowed = "another rule: how many trials a task with levels has depends on the answers"
            yield Broken(("exclusion", i, "when"), allowed)


def facts(task: Task) -> list[tuple[str, str]]:
    """Return what the board reads of the levels of a task; nothing without any."""
    if (levels := task.levels) is None:
        return []
    grid = ", ".join(map(number, levels.grid))
    tracks = ("each material", "each two materials")[design_of(task.design).intervals - 1]
    return [
        (
            "Levels",
            f"every vibration of a trial is multiplied by a level: {grid}. None is stronger than one of "
            f"{number(levels.grid[-1])}, and this page states vibrations at level 1",
        ),
        (
            "Chosen",
            f"by the answers to the trials before: transformed up-down, for {tracks} alone. It begins at "
            f"{number(levels.first)}. {count(levels.down, 'right answer')} in a row lower the level by one, a wrong "
            f"one raises it, and no answer leaves it. After {count(levels.reversals, 'change')} of direction no trial "
            "follows. A trial that has an answer is not repeated",
        ),
    ]


def advice(protocol: Protocol) -> Iterator[Finding]:
    """Yield each planned test of a task with levels."""
    adaptive = {task.id for task in protocol.tasks if task.levels is not None}
    for place, test in enumerate(protocol.analysis):
        if of := adaptive.intersection(test.tasks):
            allowed = (
                "as a rule tasks without levels: levels that follow from answers settle how many of these are right"
            )
            yield mismatch(written(("analysis", place, "tasks")), None, ", ".join(sorted(of)), allowed)
