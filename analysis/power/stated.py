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
        raise PowerError(f"{file}: got a value in task {strange[0]}; allowed: {', '.join(tasks)}, or none; mend it")
    for task in tasks:
        given = [one for one in values if one.task in (None, task)]
        if sorted(one.material for one in given) != sorted(ids):
            raise PowerError(
                f"{file}, task {task}: got values of {', '.join(one.material for one in given) or 'no material'}; "
                f"allowed: each material of the protocol once: {', '.join(ids)}; mend it"
            )
        of = {one.material: one.value for one in given}
        yield task, np.array([of[name] for name in ids], dtype=np.float64)
