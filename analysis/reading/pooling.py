"""Several datasets as one study: the same materials and one origin, every participant under the dataset's name.

Who stands in two datasets: pooled, the same answers would count as those of two people, and every test be too sure.

A measured attempt is told by its response time, written to the microsecond, and its foot speed, to 0.001 mm/s, whatever
the participant is called and however much of a session each dataset holds. Where no clock ran, only answers are left,
which people can share, and those of a session without a mistake most easily: there, sessions count as the same where
every one with a mistake, and at least two, has under the same label the same answers in both datasets.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from analysis.reading.dataset import read
from analysis.reading.study import Study, Task, check_chances
from experiment.errors import DatasetError

Session = tuple[str, str]
"""Participant and task."""

Attempt = tuple[object, ...]

SAME = 0.5
"""Share of the measured attempts of the shorter of two sessions from which on they are one: copies are sorted out, and
mended, and one value that two people share says nothing."""

LEAST = 2
"""Sessions of answers alone that must agree."""


@dataclass(frozen=True)
class Sessions:
    """The attempts of a dataset, by participant and task.

    Args:
        measured: trial, attempt, material, response time and foot speed.
        answers: trial, attempt, material and answer of sessions of which nothing was measured.
    """

    measured: Mapping[Session, frozenset[Attempt]]
    answers: Mapping[Session, frozenset[Attempt]]


def sessions(study: Study) -> Sessions:
    """Every session of a study, those that the analysis leaves out as well."""
    measured: dict[Session, set[Attempt]] = {}
    answers: dict[Session, set[Attempt]] = {}
    columns = ("participant", "task", "trial", "attempt", "presented", "answered", "response_time_s", "foot_speed_mm_s")
    for who, task, trial, attempt, presented, answered, response_s, speed_mm_s in zip(
        *(study.attempts[column].tolist() for column in columns), strict=True
    ):
        session = who, task
        answers.setdefault(session, set()).add((trial, attempt, presented, answered))
        times = tuple(None if math.isnan(value) else value for value in (response_s, speed_mm_s))
        if times != (None, None):
            measured.setdefault(session, set()).add((trial, attempt, presented, *times))
    return Sessions(
        {session: frozenset(held) for session, held in measured.items()},
        {session: frozenset(held) for session, held in answers.items() if session not in measured},
    )


def held_twice(first: Sessions, second: Sessions) -> dict[str, str]:
    """Participants of `first` who stand in `second` too -> what they are called there."""
    return {**_same_answers(first, second), **_same_measurements(first, second)}


def _same_measurements(first: Sessions, second: Sessions) -> dict[str, str]:
    holders = {(task, *one): who for (who, task), held in first.measured.items() for one in held}
    found: dict[str, str] = {}
    for (name, task), held in second.measured.items():
        shared = Counter(holders[task, *one] for one in held if (task, *one) in holders)
        for who, count in shared.items():
            if count >= SAME * min(len(held), len(first.measured[who, task])):
                found.setdefault(who, name)
    return found


def _same_answers(first: Sessions, second: Sessions) -> dict[str, str]:
    telling = {
        session: held <= second.answers[session] or held >= second.answers[session]
        for session, held in first.answers.items()
        if session in second.answers and _mistaken(held) and _mistaken(second.answers[session])
    }
    if len(telling) < LEAST or not all(telling.values()):
        return {}
    return {who: who for who, _ in telling}


def _mistaken(held: frozenset[Attempt]) -> bool:
    return any(presented != answered for _, _, presented, answered in held)


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
