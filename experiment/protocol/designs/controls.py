"""What must hold of tasks that control another one's masking; `rules` looks this up for a protocol with one."""

from collections.abc import Iterator

from palpate.experiment.protocol.kinds import list_at, table_at, tables_at
from palpate.experiment.settings.load import Broken, Table


def broken(table: Table) -> Iterator[Broken]:
    """Yield controls that are no virtual identifications, or of something else, and planned tests that name one."""
    tasks = tables_at(table, "tasks")
    controls = [task.get("id") for _, task in tasks if task.get("control") is not None]
    virtual = [task.get("id") for _, task in tasks if task.get("stimulus") == "virtual"]
    allowed = [name for name in virtual if name not in controls]
    for i, task in tasks:
        if task.get("control") is None:
            continue
        if (
            task.get("design") != "identification"
            or task.get("stimulus") != "virtual"
            or task.get("levels") is not None
        ):
            yield Broken(
                ("tasks", i, "control"), "no table: only a virtual identification task without levels can be a control"
            )
        if table_at(task, "control").get("of") not in allowed:
            words = f"a virtual task that is not itself a control, one of: {', '.join(map(str, allowed)) or 'none'}"
            yield Broken(("tasks", i, "control", "of"), words)
    for i, test in tables_at(table, "analysis"):
        for j, name in enumerate(list_at(test, "tasks")):
            if name in controls:
                yield Broken(
                    ("analysis", i, "tasks", j),
                    "a task that is not a control: every report tests each control separately anyway",
                )
