"""A study as it was read: its facts, its tidy frame, and what the analysis leaves out.

What the protocols of a study plan: chance, tests and trials; and in what those of pooled datasets differ.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import pandas as pd

from analysis.reading.exclusions import Exclusion, Unasked
from experiment.errors import DatasetError

if TYPE_CHECKING:
    from experiment.protocol.models import Protocol


@dataclass(frozen=True)
class Task:
    """One task of the study, as its sidecars describe it."""

    id: str
    title: str
    instructions: str


@dataclass(frozen=True)
class Part:
    """One dataset of a study: its folder's name, participants and tasks, and the protocol's copy that it may hold."""

    name: str
    participants: tuple[str, ...]
    tasks: tuple[str, ...]
    protocol: Protocol | None


@dataclass(frozen=True)
class Study:
    """A dataset as read, or several as one.

    Args:
        id: the study's id.
        name: the dataset's title.
        origin: PARTICIPANT, REHEARSAL or RECONSTRUCTION.
        label: what must stand at the head of everything made from it; empty for a study's own data.
        materials: in the order in which tables show them.
        tasks: in the order in which tables show them.
        participants: every participant of `participants.tsv`.
        first_tasks: the task that a participant did first, of those of whom it is known.
        session_ids: participant and task -> the id of the session, of those that have one.
        attempts: one row an attempt: participant, task, trial, attempt, counted, presented, answered,
            response_time_s, foot_speed_mm_s, frames_lost, delivered (1, 0 or NaN), onset_error_s, redo_reason,
            included; and of `event_columns.FURTHER_COLUMNS` masker_db_a, prediction_error_s, delivery_error_s,
            gate_to_scheduled_s, dead_time_s.
        exclusions: the reason for every row that is not included, and for participants without rows.
        unasked: sessions with trials of which a rule of exclusion could not be asked.
        parts: the datasets that it is of.
    """

    id: str
    name: str
    origin: str
    label: str
    materials: tuple[str, ...]
    tasks: tuple[Task, ...]
    participants: tuple[str, ...]
    first_tasks: Mapping[str, str]
    session_ids: Mapping[tuple[str, str], str]
    attempts: pd.DataFrame
    exclusions: tuple[Exclusion, ...]
    unasked: tuple[Unasked, ...]
    parts: tuple[Part, ...]

    def trials(self, task: str) -> pd.DataFrame:
        """The trials of one task that the analysis counts."""
        return self.attempts[self.attempts["included"] & (self.attempts["task"] == task)]


def chance(study: Study, task: str) -> Fraction:
    """Chance in a task: the same in every part of a study, see `check_chances`."""
    return next(_chance(part, task, len(study.materials)) for part in study.parts if task in part.tasks)


def check_chances(parts: Sequence[Part], materials: int) -> None:
    """Refuse to pool answers that are tested against different chances.

    Raises:
        DatasetError: naming the task, the chances and where each stands.
    """
    for task in dict.fromkeys(task for part in parts for task in part.tasks):
        found = {part.name: _chance(part, task, materials) for part in parts if task in part.tasks}
        if len(set(found.values())) > 1:
            got = ", ".join(f"{float(value):.4g} ({name})" for name, value in found.items())
            raise DatasetError(f"task {task}: got the chances {got}; allowed: one; analyse the datasets apart")


def sentences(study: Study) -> tuple[str, ...]:
    """In what the parts differ, the planned tests, and who did fewer trials than planned."""
    return (*_differences(study), *_planned(study), *_incomplete(study))


def _chance(part: Part, task: str, materials: int) -> Fraction:
    for plan in part.protocol.analysis if part.protocol else ():
        if plan.test == "t against chance" and task in plan.tasks and plan.chance is not None:
            return Fraction(repr(plan.chance))
    return Fraction(1, materials)


def _differences(study: Study) -> list[str]:
    known = [(part.name, part.protocol) for part in study.parts if part.protocol]
    if not known:
        return []
    name, first = known[0]
    said = []
    for other, protocol in known[1:]:
        if keys := [key for key in type(first).model_fields if getattr(protocol, key) != getattr(first, key)]:
            said.append(f"The protocols of {name} and {other} differ in: {', '.join(keys)}.")
    said += [
        f"{part.name} holds no copy of its protocol: no rule excludes anything there, and its plans are not known."
        for part in study.parts
        if not part.protocol and len(study.parts) > 1
    ]
    if said:
        said.append("The exclusions of each dataset are those of its own protocol.")
    return said


def _planned(study: Study) -> list[str]:
    found: dict[str, list[str]] = {}
    for part in study.parts:
        for plan in part.protocol.analysis if part.protocol else ():
            form = f" ({plan.form})" if plan.form else ""
            found.setdefault(f"{plan.test}{form}, {' and '.join(plan.tasks)}. {plan.question}", []).append(part.name)
    where = {text: f" in {', '.join(names)}" if len(names) < len(study.parts) else "" for text, names in found.items()}
    return [f"Planned{place}: {text}" for text, place in where.items()]


def _incomplete(study: Study) -> list[str]:
    """A sentence on sessions with fewer counted trials than their protocol plans."""
    rows = study.attempts[study.attempts["counted"]]
    counted = Counter(zip(rows["participant"].tolist(), rows["task"].tolist(), strict=True))
    planned = {
        (participant, task.id): task.repetitions * len(study.materials)
        for part in study.parts
        if part.protocol
        for task in part.protocol.tasks
        for participant in part.participants
    }
    short = [
        f"{participant} in {task} ({count} of {planned[participant, task]})"
        for (participant, task), count in counted.items()
        if count < planned.get((participant, task), 0)
    ]
    return [f"Fewer trials than planned, ratios taken over those there are: {', '.join(short)}."] if short else []
