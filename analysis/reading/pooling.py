"""Several datasets as one study: the same materials and one origin, every participant under the dataset's name.

Nobody may stand in two of them: the same answers would count as those of two people, and every test be too sure. Each
session has an id of its own, which its copies keep under any name. A session without one (of printed counts, or from
before there were ids) is taken for a copy where the same participant has the same trials there, answers and times, with
a mistake among them: sessions without any are alike by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from analysis.reading.dataset import read
from analysis.reading.study import Study, Task, check_chances
from experiment.errors import DatasetError

NAMED = 5
"""Participants who are named where several stand in two datasets."""


def read_pooled(roots: Sequence[Path]) -> Study:
    """Read the datasets in these folders, and pool them where there are several.

    Raises:
        DatasetError: see `analysis.reading.dataset.read` and `pool`; also for a folder named twice.
        ProtocolError: for a broken copy of a protocol.
    """
    if len({root.resolve() for root in roots}) < len(roots):
        raise DatasetError(f"got a dataset twice among {', '.join(map(str, roots))}; name each once")
    studies = [read(root) for root in roots]
    return studies[0] if len(studies) == 1 else pool(studies, _names(roots))


def pool(studies: Sequence[Study], names: Sequence[str]) -> Study:
    """One study of several.

    The exclusions, plans and trials of each are those of its own protocol; `reading.study` says where protocols
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
    for index, study in enumerate(studies):
        for other in range(index):
            _check_apart(studies[other], study, (names[other], names[index]))
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
        session_ids={session: one for study in renamed for session, one in study.session_ids.items()},
        attempts=pd.concat([study.attempts for study in renamed], ignore_index=True),
        exclusions=tuple(exclusion for study in renamed for exclusion in study.exclusions),
        unasked=tuple(one for study in renamed for one in study.unasked),
        parts=parts,
    )


def _check_apart(first: Study, second: Study, names: tuple[str, str]) -> None:
    """Refuse two datasets that hold a session of one person."""
    there = {session_id: who for (who, _), session_id in second.session_ids.items()}
    copies = {who: there[one] for (who, _), one in first.session_ids.items() if one in there}
    people = [who if who == name else f"{who} (there {name})" for who, name in copies.items()]
    told = "by the ids of their sessions"
    if not people:
        old, new = _trials(first), _trials(second)
        alike = [key for key in old if key in new and not (key in first.session_ids and key in second.session_ids)]
        people = list(dict.fromkeys(who for who, task in alike if old[who, task] == new[who, task]))
        told = "every one of a session alike; no id tells these sessions apart"
    if people:
        more = f" and {len(people) - NAMED} more" if len(people) > NAMED else ""
        raise DatasetError(
            f"{names[0]} and {names[1]} hold the same trials of {', '.join(people[:NAMED])}{more} ({told}); give each "
            "participant once"
        )


def _trials(study: Study) -> dict[tuple[str, str], str]:
    """Participant and task -> the attempts of that session as text; sessions without a mistake are left out."""
    columns = ["trial", "attempt", "presented", "answered", "response_time_s", "foot_speed_mm_s"]
    return {
        (str(who), str(task)): held[columns].to_csv(index=False)
        for (who, task), held in study.attempts.groupby(["participant", "task"], sort=False)
        if (held["presented"] != held["answered"]).any()
    }


def _names(roots: Sequence[Path]) -> list[str]:
    """The folders' names, numbered where two are the same."""
    plain = [root.resolve().name for root in roots]
    return [name if plain.count(name) == 1 else f"{name}{index}" for index, name in enumerate(plain, start=1)]


def _renamed(study: Study, name: str) -> Study:
    return replace(
        study,
        participants=tuple(f"{name}-{label}" for label in study.participants),
        first_tasks={f"{name}-{label}": task for label, task in study.first_tasks.items()},
        session_ids={(f"{name}-{who}", task): one for (who, task), one in study.session_ids.items()},
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
