"""Several datasets as one `Study`. Nobody may be in two of them: sessions are compared by their ids, and without an id
by trials, answers and times of the same participant.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from palpate.analysis.reading.dataset import Say, read, silent
from palpate.analysis.reading.study import Study, Task, check_chances
from palpate.experiment.errors import DatasetError

LEAST = 2
"""Sessions of answers alone, without ids or times, that must agree before they count as copies."""

NAMED = 5
"""The most participants who are named where several are in two datasets."""


def read_pooled(roots: Sequence[Path], say: Say = silent) -> Study:
    """Read the datasets in these folders, and pool them where there are several; `say` gets progress.

    Participant 03 of dataset `lab` becomes `lab-03`. Exclusions, plans and trials of each are those of its own
    protocol. Raises `DatasetError` as `read`, and for a folder named twice, different origins, materials, titles or
    chances, or the same people's trials; and `ProtocolError`.
    """
    if len({root.resolve() for root in roots}) < len(roots):
        raise DatasetError(
            f"got the same dataset twice in {', '.join(map(str, roots))}", remedy="name each dataset once"
        )
    studies = [read(root, say) for root in roots]
    return studies[0] if len(studies) == 1 else _pool(studies, _names(roots))


def _pool(studies: Sequence[Study], names: Sequence[str]) -> Study:
    first = studies[0]
    _check_alike(studies, names)
    for index, study in enumerate(studies):
        for other in range(index):
            _check_apart(studies[other], study, (names[other], names[index]))
    ids = list(dict.fromkeys(study.id for study in studies))
    renamed = [_renamed(study, name) for study, name in zip(studies, names, strict=True)]
    parts = tuple(part for study in renamed for part in study.parts)
    check_chances(parts, len(first.materials))
    by_person: Any = {each: _union(getattr(study, each) for study in renamed) for each in BY_PERSON}
    return replace(
        first,
        id="+".join(ids),
        name=f"Pooled: {'; '.join(f'{s.name} ({name})' for s, name in zip(studies, names, strict=True))}",
        tasks=_tasks(studies),
        designs=_union(study.designs for study in studies),
        participants=tuple(label for study in renamed for label in study.participants),
        **by_person,
        attempts=pd.concat([study.attempts for study in renamed], ignore_index=True),
        exclusions=tuple(exclusion for study in renamed for exclusion in study.exclusions),
        unasked=tuple(one for study in renamed for one in study.unasked),
        parts=parts,
        ordered=all(study.ordered for study in studies),
    )


BY_PERSON = ("first_tasks", "session_ids", "forces", "facts", "touched")
"""What a study has by participant."""


def _union(mappings: Iterable[Mapping[Any, Any]]) -> dict[Any, Any]:
    return {key: value for mapping in mappings for key, value in mapping.items()}


def _check_alike(studies: Sequence[Study], names: Sequence[str]) -> None:
    first = studies[0]
    origins = {study.origin for study in studies}
    if len(origins) > 1:
        raise DatasetError(
            f"got datasets of {', '.join(sorted(origins))}",
            remedy="pool the datasets of each origin separately",
            allowed="datasets of one origin",
        )
    for study, name in zip(studies, names, strict=True):
        if study.materials != first.materials:
            raise DatasetError(
                name,
                f"got the materials {', '.join(study.materials)}",
                "analyze it separately",
                allowed=f"{', '.join(first.materials)}, as in {names[0]}",
            )
        if {*study.designs.values()} != {*first.designs.values()}:
            raise DatasetError(
                name, f"got answers unlike those in {names[0]}", "analyze it separately", allowed="the same"
            )


def _check_apart(first: Study, second: Study, names: tuple[str, str]) -> None:
    there = {session_id: who for (who, _), session_id in second.session_ids.items()}
    copies = {who: there[one] for (who, _), one in first.session_ids.items() if one in there}
    people = [who if who == name else f"{who} (there {name})" for who, name in copies.items()]
    told = "by the ids of their sessions"
    if not people:
        old, new = _trials(first), _trials(second)
        both = [key for key in old if key in new and not (key in first.session_ids and key in second.session_ids)]
        alike = [key for key in both if old[key] == new[key]]
        # Times hardly coincide, whatever the labels are. Answers alone may, but hardly those of several sessions and of
        # every one in both.
        people = _same_trials(first, second)
        if len(alike) >= LEAST and len(alike) == len(both):
            people += [who for who, _ in alike]
        people = list(dict.fromkeys(people))
        told = "all trials of the sessions are the same, and no id distinguishes them"
    if people:
        more = f" and {len(people) - NAMED} more" if len(people) > NAMED else ""
        raise DatasetError(
            f"{names[0]} and {names[1]} contain the same trials of {', '.join(people[:NAMED])}{more} ({told})",
            remedy="give each participant once",
        )


def _same_trials(first: Study, second: Study) -> list[str]:
    """Return who of the first has a session, with times, of the same trials in the second, where one has no id."""
    timed = first.attempts.dropna(subset="response_time_s").groupby(["participant", "task"]).groups
    old = {(key[1], trials): key for key, trials in _trials(first).items() if key in timed}
    both = ((old.get((key[1], trials)), key) for key, trials in _trials(second).items())
    return [one[0] for one, other in both if one and not (one in first.session_ids and other in second.session_ids)]


def _trials(study: Study) -> dict[tuple[str, str], str]:
    """Return participant and task -> the attempts of the session as text, of sessions with a mistake."""
    columns = ["trial", "attempt", "presented", "answered", "response_time_s", "foot_speed_mm_s"]
    return {
        (str(who), str(task)): held[columns].to_csv(index=False)
        for (who, task), held in study.attempts.groupby(["participant", "task"], sort=False)
        if (held["presented"] != held["answered"]).any()
    }


def _names(roots: Sequence[Path]) -> list[str]:
    plain = [root.resolve().name for root in roots]
    return [name if plain.count(name) == 1 else f"{name}{index}" for index, name in enumerate(plain, start=1)]


def _renamed(study: Study, name: str) -> Study:
    return replace(
        study,
        participants=tuple(f"{name}-{label}" for label in study.participants),
        first_tasks={f"{name}-{label}": task for label, task in study.first_tasks.items()},
        facts={(f"{name}-{who}", column): cell for (who, column), cell in study.facts.items()},
        session_ids={(f"{name}-{who}", task): one for (who, task), one in study.session_ids.items()},
        forces={(f"{name}-{who}", task): one for (who, task), one in study.forces.items()},
        touched={(f"{name}-{who}", task): one for (who, task), one in study.touched.items()},
        attempts=study.attempts.assign(participant=[f"{name}-{who}" for who in study.attempts["participant"]]),
        exclusions=tuple(replace(one, participant=f"{name}-{one.participant}") for one in study.exclusions),
        unasked=tuple(replace(one, participant=f"{name}-{one.participant}") for one in study.unasked),
        parts=tuple(
            replace(
                part,
                name=name,
                participants=tuple(f"{name}-{label}" for label in part.participants),
                versions=tuple(
                    replace(one, sessions=frozenset((f"{name}-{who}", task) for who, task in one.sessions))
                    for one in part.versions
                ),
            )
            for part in study.parts
        ),
    )


def _tasks(studies: Sequence[Study]) -> tuple[Task, ...]:
    found: dict[str, Task] = {}
    for study in studies:
        for task in study.tasks:
            known = found.setdefault(task.id, task)
            if (known.title, known.presented) != (task.title, task.presented):
                one, other = (f"'{each.title}' with {', '.join(each.presented)}" for each in (known, task))
                raise DatasetError(
                    f"task {task.id}", f"got {one}, and {other}", "analyze the datasets separately", allowed="one"
                )
    return tuple(found.values())
