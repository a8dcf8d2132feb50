"""Study -> what a model of single trials needs: right or wrong, who, which task and material, and what went with it.

A covariate is used where at least half of the trials have it; trials without it are then left out, and counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.dataset import Study
from analysis.exact import NotDefined

TRIAL, SPEED, RESPONSE, LATER = "10 trials on", "foot 100 mm/s faster", "response 1 s later", "second task"
COVARIATES = {"trial": (TRIAL, 10.0), "foot_speed_mm_s": (SPEED, 100.0), "response_time_s": (RESPONSE, 1.0)}
"""Column -> name of one step of it, and how many of its units that is."""


@dataclass(frozen=True)
class Design:
    """Trials as arrays, N of them.

    Args:
        correct: shape (N,), 0 or 1; a trial without an answer is not right.
        participants: index of the participant, shape (N,).
        names: of the parameters, intercept first.
        matrix: shape (N, parameters), covariates centred.
        terms: what is tested together -> its columns.
        absent: covariates that are not used, and why.
        left_out: trials without one of the covariates used.
    """

    correct: NDArray[np.float64]
    participants: NDArray[np.int64]
    names: tuple[str, ...]
    matrix: NDArray[np.float64]
    terms: Mapping[str, tuple[int, ...]]
    absent: Mapping[str, str]
    left_out: int


def design(study: Study) -> Design:
    """The design of a study's included trials.

    Raises:
        NotDefined: for a reconstruction, and where all answers to a material or in a task are right, or wrong.
    """
    if study.origin == "RECONSTRUCTION":
        raise NotDefined(
            "a reconstruction has no order of trials, no foot speed, no response time and no order of tasks, and which "
            "rows belong to one participant is arbitrary"
        )
    table = study.attempts.loc[study.attempts["included"]]
    columns, absent = _covariates(study, table)
    known = np.isfinite(np.column_stack([np.ones(len(table)), *columns.values()]))
    whole: NDArray[np.bool_] = np.asarray(known.all(axis=1))
    table = table.iloc[np.flatnonzero(whole)]
    correct = np.array(table["presented"].to_numpy() == table["answered"].to_numpy(), dtype=np.float64)
    parts: list[NDArray[np.float64]] = [np.ones(len(table))]
    names = ["intercept"]
    terms: dict[str, tuple[int, ...]] = {}
    factors = (("task", "task", tuple(task.id for task in study.tasks)), ("material", "presented", study.materials))
    for term, column, order in factors:
        labels = table[column].to_numpy()
        occurring = set(labels.tolist())
        levels = [level for level in order if level in occurring]
        for level in levels:
            if len(set(correct[labels == level].tolist())) < 2:
                kind = "right" if correct[labels == level].all() else "wrong"
                raise NotDefined(f"every answer to {term} {level} is {kind}: its odds have no limit")
        if len(levels) > 1:
            terms[term] = tuple(range(len(names), len(names) + len(levels) - 1))
            names += [f"{level} (against {levels[0]})" for level in levels[1:]]
            parts += [(labels == level).astype(np.float64) for level in levels[1:]]
    for name, values in columns.items():
        kept = values[whole]
        if np.ptp(kept) == 0:
            absent[name] = "the same in every trial"
            continue
        terms[name] = (len(names),)
        names.append(name)
        parts.append(kept - kept.mean())
    labels = table["participant"].to_numpy()
    people = {label: index for index, label in enumerate(dict.fromkeys(labels.tolist()))}
    return Design(
        correct,
        np.array([people[label] for label in labels.tolist()], dtype=np.int64),
        tuple(names),
        np.column_stack(parts),
        terms,
        absent,
        int(np.count_nonzero(~whole)),
    )


def _covariates(study: Study, table: pd.DataFrame) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """One value a trial of every covariate that is there, in steps; and why the others are not."""
    found: dict[str, NDArray[np.float64]] = {}
    absent: dict[str, str] = {}
    for column, (name, step) in COVARIATES.items():
        values = table[column].to_numpy(dtype=np.float64) / step
        known = np.count_nonzero(np.isfinite(values))
        if 2 * known >= len(values) and known:
            found[name] = values
        else:
            absent[name] = f"known of {known} of {len(values)} trials"
    pairs = zip(table["participant"].tolist(), table["task"].tolist(), strict=True)
    later = np.array(
        [float(study.first_tasks[who] != task) if who in study.first_tasks else np.nan for who, task in pairs]
    )
    if len(study.tasks) < 2:
        absent[LATER] = "there is one task"
    elif np.isfinite(later).all():
        found[LATER] = later
    else:
        absent[LATER] = "the order of the tasks is not known of everyone"
    return found, absent
