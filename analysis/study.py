"""A study as it was read: its facts, its tidy frame, and what the analysis leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from analysis.exclusions import Exclusion, Unasked

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
    attempts: pd.DataFrame
    exclusions: tuple[Exclusion, ...]
    unasked: tuple[Unasked, ...]
    parts: tuple[Part, ...]

    def trials(self, task: str) -> pd.DataFrame:
        """The trials of one task that the analysis counts."""
        return self.attempts[self.attempts["included"] & (self.attempts["task"] == task)]
