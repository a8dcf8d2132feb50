"""Who stands in two datasets: pooled, the same answers would count as those of two people, and every test be too sure.

A measured attempt is told by its response time, written to the microsecond, and its foot speed, to 0.001 mm/s, whatever
the participant is called and however much of a session each dataset holds. Where no clock ran, only answers are left,
which people can share, and those of a session without a mistake most easily: there, sessions count as the same where
every one with a mistake, and at least two, has under the same label the same answers in both datasets.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from analysis.study import Study

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
