"""Several datasets as one study: the same materials and one origin, every participant under the dataset's name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from analysis.dataset import read
from analysis.held_twice import Sessions, held_twice, sessions
from analysis.plans import check_chances
from analysis.study import Study, Task
from experiment.errors import DatasetError

NAMED = 5
"""Participants who are named where several stand in two datasets."""


def read_pooled(roots: Sequence[Path]) -> Study:
    """Read the datasets in these folders, and pool them where there are several.

    Raises:
        DatasetError: see `analysis.dataset.read` and `pool`; also for a folder named twice.
        ProtocolError: for a broken copy of a protocol.
    """
    if len({root.resolve() for root in roots}) < len(roots):
        raise DatasetError(f"got a dataset twice among {', '.join(map(str, roots))}; name each once")
    studies = [read(root) for root in roots]
    return studies[0] if len(studies) == 1 else pool(studies, _names(roots))


def pool(studies: Sequence[Study], names: Sequence[str]) -> Study:
    """One study of several.

    The exclusions, plans and trials of each are those of its own protocol; `analysis.plans` says where protocols
    differ. The study's id is kept where it is the same.

    Args:
        studies: two or more.
        names: what to call each, all different; participant 03 of dataset `lab` becomes `lab-03`.

    Raises:
        DatasetError: for studies of different origins or materials, with tasks of one id and unlike titles or chances,
            or with the same trials of the same people.
    """
    first = studies[0]
    origins = {study.origin for study in studies}
    if len(origins) > 1:
        raise DatasetError(
            f"got datasets of {', '.join(sorted(origins))}; allowed: those of one origin; pool them apart"
        )
    for study, name in zip(studies, names, strict=True):
        if study.materials != first.materials:
            raise DatasetError(
                f"{name}: got the materials {', '.join(study.materials)}; allowed: {', '.join(first.materials)}, as in "
                f"{names[0]}; analyse it apart"
            )
    held = [sessions(study) for study in studies]
    for index, study in enumerate(studies):
        for other in range(index):
            if twice := _twice(studies[other], study, held[other], held[index]):
                raise DatasetError(
                    f"{names[other]} and {names[index]} hold the same trials of {twice}; give each participant once"
                )
    ids = list(dict.fromkeys(study.id for study in studies))
    renamed = [_renamed(study, name) for study, name in zip(studies, names, strict=True)]
    parts = tuple(part for study in renamed for part in study.parts)
    check_chances(parts, len(first.materials))
    return Study(
        id="+".join(ids),
        name=f"Pooled: {'; '.join(f'{s.name} ({name})' for s, name in zip(studies, names, strict=True))}",
        origin=first.origin,
        label=first.label,
        materials=first.materials,
        tasks=_tasks(studies),
        participants=tuple(label for study in renamed for label in study.participants),
        first_tasks={label: task for study in renamed for label, task in study.first_tasks.items()},
        attempts=pd.concat([study.attempts for study in renamed], ignore_index=True),
        exclusions=tuple(exclusion for study in renamed for exclusion in study.exclusions),
        unasked=tuple(one for study in renamed for one in study.unasked),
        parts=parts,
    )


def _twice(first: Study, second: Study, of_first: Sessions, of_second: Sessions) -> str:
    """Whoever stands in both, in words; empty for nobody."""
    if first.attempts.equals(second.attempts):
        return "everybody"
    found = held_twice(of_first, of_second)
    people = [who if who == name else f"{who} (there {name})" for who, name in found.items()]
    more = f" and {len(people) - NAMED} more" if len(people) > NAMED else ""
    return ", ".join(people[:NAMED]) + more


def _names(roots: Sequence[Path]) -> list[str]:
    """The folders' names, numbered where two are the same."""
    plain = [root.resolve().name for root in roots]
    return [name if plain.count(name) == 1 else f"{name}{index}" for index, name in enumerate(plain, start=1)]


def _renamed(study: Study, name: str) -> Study:
    return replace(
        study,
        participants=tuple(f"{name}-{label}" for label in study.participants),
        first_tasks={f"{name}-{label}": task for label, task in study.first_tasks.items()},
        attempts=study.attempts.assign(participant=[f"{name}-{who}" for who in study.attempts["participant"]]),
        exclusions=tuple(replace(one, participant=f"{name}-{one.participant}") for one in study.exclusions),
        unasked=tuple(replace(one, participant=f"{name}-{one.participant}") for one in study.unasked),
        parts=tuple(
            replace(part, name=name, participants=tuple(f"{name}-{label}" for label in part.participants))
            for part in study.parts
        ),
    )


def _tasks(studies: Sequence[Study]) -> tuple[Task, ...]:
    found: dict[str, Task] = {}
    for study in studies:
        for task in study.tasks:
            if found.setdefault(task.id, task).title != task.title:
                raise DatasetError(
                    f"task {task.id}: got the titles '{found[task.id].title}' and '{task.title}'; allowed: one; "
                    "analyse the datasets apart"
                )
    return tuple(found.values())
