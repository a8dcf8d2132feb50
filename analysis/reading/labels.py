"""Who took part in the sessions that stand under another participant's label."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

from palpate.experiment.errors import DatasetError

People = Mapping[tuple[str, str], str]
"""Label and task of a session -> the label of the person who took part in it."""


def took_part(root: Path, facts: Mapping[str, Any], withdrawn: dict[str, bool]) -> dict[tuple[str, str], str]:
    """Return the person of each session under another's label; `withdrawn` gets those with no session under their own.

    Raises `DatasetError` for what is no such list.
    """
    people: dict[tuple[str, str], str] = {}
    try:
        for session, told in facts.get("TookPart", {}).items():
            parts = re.fullmatch(r"sub-([0-9A-Za-z]+)_task-([0-9A-Za-z]+)", session)
            own = re.fullmatch(r"sub-([0-9A-Za-z]+)", told["Person"])
            if parts is None or own is None:
                raise ValueError(session)
            people[parts[1], parts[2]] = own[1]
            withdrawn.setdefault(own[1], bool(told["Withdrew"]))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        where, allowed = root / "dataset_description.json", "sub-LABEL_task-TASK, with Person and Withdrew"
        what, remedy = f"got {facts['TookPart']!r:.60}", "rebuild the tables"
        raise DatasetError(where, what, remedy, field="Palpate.TookPart", allowed=allowed) from error
    return people


def sentences(people: People) -> tuple[str, ...]:
    """Return it in words, one for each session that is another person's."""
    return tuple(
        f"The session of task {task} labeled {label} is analyzed as the session of {person}, who took part."
        for (label, task), person in people.items()
        if label != person
    )


def check_once(root: Path, person: str, task: str, known: Container[tuple[str, str]]) -> None:
    """Raise `DatasetError` for a person with two sessions of a task."""
    if (person, task) in known:
        what = f"participant {person} took part in two sessions of task {task}"
        raise DatasetError(root / "dataset_description.json", what, "record whose session each is: palpate incident")


def first_tasks_of_people(first_tasks: Mapping[str, str], people: People) -> dict[str, str]:
    """Return the first task of each person; a person whose first session stands under no label has none."""
    return {people.get((who, task), who): task for who, task in first_tasks.items()}
