"""Values of materials as the TOML file of a model states them, in every task or in one."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from palpate.analysis.statistics.exact import Floats
from palpate.experiment.errors import PowerError
from palpate.experiment.settings.load import Confined, Label, Name


class StatedValue(Confined):
    """The value of one material, in one task or, where none is named, in all."""

    task: Label | None = None
    material: Name
    value: float


def by_task(
    file: Path, values: Sequence[StatedValue], tasks: Sequence[str], ids: Sequence[str]
) -> Iterator[tuple[str, Floats]]:
    """Yield each task with its materials' values, shape (M,). Raises `PowerError` unless each has one."""
    if strange := [one.task for one in values if one.task not in (None, *tasks)]:
        raise PowerError(
            file,
            f"got a value in task {strange[0]}",
            "correct the task of this value, or delete the task if the value applies to all tasks",
            allowed=f"{', '.join(tasks)}, or none",
        )
    for task in tasks:
        given = [one for one in values if one.task in (None, task)]
        named = [one.material for one in given]
        if sorted(named) != sorted(ids):
            raise PowerError(
                f"{file}, task {task}",
                f"got values for {', '.join(named) or 'no material'}",
                " and ".join(_changes(named, ids)),
                allowed=f"each material of the protocol once: {', '.join(ids)}",
            )
        of = {one.material: one.value for one in given}
        yield task, np.array([of[name] for name in ids], dtype=np.float64)


def _changes(named: Sequence[str], ids: Sequence[str]) -> Iterator[str]:
    """Yield what to add to, and what to delete from, the materials named, so that each of `ids` is there once."""
    if missing := [one for one in ids if one not in named]:
        yield f"add a value for {', '.join(missing)}"
    surplus = [one for place, one in enumerate(named) if one not in ids or one in named[:place]]
    if surplus:
        yield f"delete one of {', '.join(surplus)}"


def other_study(folder: Path, wanted: str, numbers: str) -> PowerError:
    """Return the error of a dataset whose answers or materials are not those of the protocol."""
    remedy = f"give --model the folder of such a study, a TOML file, or two numbers, {numbers}"
    return PowerError(folder, "got answers or materials that are not the protocol's", remedy, allowed=wanted)
