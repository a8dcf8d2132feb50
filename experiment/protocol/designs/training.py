"""Training in a protocol: what a task with one breaks, and what its board reads.

`rules` and the page look this up for a study of which a task has a training.
"""

from collections.abc import Iterator

from palpate.experiment.protocol.blocks import Free, count
from palpate.experiment.protocol.designs import NAMES, design_of
from palpate.experiment.protocol.kinds import number_at, table_at, tables_at
from palpate.experiment.protocol.models import Task
from palpate.experiment.settings.load import Broken, Table

_KINDS = ("footstep", "presented")
"""The kinds of trial whose entries about a trial all go through its attempt."""

_UNMET = {
    "go on": "the session continues anyway",
    "end": "the session ends there and counts as complete, without any trials that count",
}


def broken(table: Table) -> Iterator[Broken]:
    """Yield trainings whose answers are not right or wrong, or whose criterion cannot be reached."""
    ordered = table_at(table, "comparison").get("ordered") is not False
    for i, task in tables_at(table, "tasks"):
        if task.get("training") is None:
            continue
        place, design = ("tasks", i, "training"), task.get("design")
        if design in NAMES and (design_of(design).right is None or not ordered):
            yield Broken(place, "no table: in this task, no answer is right or wrong")
        if task.get("kind") not in _KINDS:
            yield Broken(place, f"no table: only tasks of the kinds {' and '.join(_KINDS)} can have training")
        training = table_at(task, "training")
        criterion = table_at(training, "criterion")
        trials, newest, right = number_at(training, "trials"), number_at(criterion, "of"), number_at(criterion, "right")
        if trials is not None and newest is not None and newest > trials:
            yield Broken((*place, "criterion", "of"), f"at most trials ({trials})")
        if newest is not None and right is not None and right > newest:
            yield Broken((*place, "criterion", "right"), f"at most of ({newest})")


def facts(task: Task) -> Iterator[tuple[str, str | Free]]:
    """Yield what the board reads of the training of a task; nothing without one."""
    if (training := task.training) is None:
        return
    ends = f"{count(training.trials, 'trial')}"
    if (criterion := training.criterion) is not None:
        ends = (
            f"at most {ends}, until {criterion.right} of the last {criterion.of} answers are right. If this is never "
            f"reached, {_UNMET[criterion.unmet]}; the outcome is recorded"
        )
    yield (
        "Training",
        f"before the trials that count: {ends}. Training trials are randomized for each participant, who answers as "
        "in the trials that count. They are recorded but never analyzed",
    )
    if not training.feedback:
        yield "Told", "participants are not told whether a training answer was right"
        return
    yield "Told if right", Free(training.told_right)
    yield "if not", Free(training.told_wrong)
