"""Study -> what a model of single trials needs: right or wrong, who, which task and material, and what went with it.

Covariates are used where at least half of the trials of every task, and of every material, have all of them; while they
do not, the one that is known of the fewest is dropped, never a task. Trials without one of those used are left out, and
counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.reading.study import Study
from analysis.statistics.exact import NotDefined

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
        absent: terms that are not used, and why.
        left_out: task -> trials without one of the covariates used, where there are any.
        gone: participants of whom no trial is left.
    """

    correct: NDArray[np.float64]
    participants: NDArray[np.int64]
    names: tuple[str, ...]
    matrix: NDArray[np.float64]
    terms: Mapping[str, tuple[int, ...]]
    absent: Mapping[str, str]
    left_out: Mapping[str, int]
    gone: tuple[str, ...]


def design(study: Study) -> Design:
    """The design of a study's included trials.

    Raises:
        NotDefined: for a reconstruction, without a trial, and where all answers to a material or in a task are right,
            or wrong.
    """
    if study.origin == "RECONSTRUCTION":
        raise NotDefined(
            "a reconstruction has no order of trials, no foot speed, no response time and no order of tasks, and which "
            "rows belong to one participant is arbitrary"
        )
    table = study.attempts.loc[study.attempts["included"]]
    if table.empty:
        raise NotDefined("no trial is left")
    columns, absent = _covariates(study, table)
    whole = _thinned(columns, absent, _groups(study, table))
    left_out = Counter(table["task"].to_numpy()[~whole].tolist())
    everyone = dict.fromkeys(table["participant"].tolist())
    table = table.iloc[np.flatnonzero(whole)]
    correct = np.array(table["presented"].to_numpy() == table["answered"].to_numpy(), dtype=np.float64)
    matrix = np.ones((len(table), 1))
    names = ["intercept"]
    terms: dict[str, tuple[int, ...]] = {}
    blocks: list[tuple[str, list[str], NDArray[np.float64]]] = []
    for term, column, order in _factors(study):
        labels = table[column].to_numpy()
        occurring = set(labels.tolist())
        levels = [level for level in order if level in occurring]
        for level in levels:
            if len(set(correct[labels == level].tolist())) < 2:
                kind = "right" if correct[labels == level].all() else "wrong"
                raise NotDefined(f"every answer to {term} {level} is {kind}: its odds have no limit")
        if len(levels) > 1:
            named = [f"{level} (against {levels[0]})" for level in levels[1:]]
            blocks.append((term, named, np.column_stack([labels == level for level in levels[1:]]).astype(np.float64)))
    for name, values in columns.items():
        kept = values[whole]
        if np.ptp(kept) == 0:
            absent[name] = "the same in every trial"
        else:
            blocks.append((name, [name], (kept - kept.mean())[:, None]))
    for term, named, block in blocks:
        wider = np.column_stack([matrix, block])
        if np.linalg.matrix_rank(wider) < wider.shape[1]:
            absent[term] = f"in these trials it cannot be told from {', '.join(terms)}"
            continue
        terms[term] = tuple(range(len(names), len(names) + len(named)))
        names += named
        matrix = wider
    labels = table["participant"].to_numpy()
    people = {label: index for index, label in enumerate(dict.fromkeys(labels.tolist()))}
    return Design(
        correct,
        np.array([people[label] for label in labels.tolist()], dtype=np.int64),
        tuple(names),
        matrix,
        terms,
        absent,
        left_out,
        tuple(label for label in everyone if label not in people),
    )


def _factors(study: Study) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    """Name, column and levels, in order, of each."""
    return ("task", "task", tuple(task.id for task in study.tasks)), ("material", "presented", study.materials)


def _groups(study: Study, table: pd.DataFrame) -> dict[str, NDArray[np.bool_]]:
    """Words for a part of the trials -> which they are: all, those of each task, and of each material."""
    found = {"trials": np.ones(len(table), dtype=np.bool_)}
    for term, column, order in _factors(study):
        labels = table[column].to_numpy()
        found |= {f"trials of {term} {level}": np.asarray(labels == level) for level in order}
    return found


def _thin(known: NDArray[np.bool_], groups: Mapping[str, NDArray[np.bool_]]) -> str | None:
    """The first group of whose trials less than half are `known`."""
    return next((name for name, inside in groups.items() if 2 * known[inside].sum() < inside.sum()), None)


def _thinned(
    columns: dict[str, NDArray[np.float64]], absent: dict[str, str], groups: Mapping[str, NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Trials with every covariate, after those were moved to `absent` that leave less than half of a group."""
    known = {name: np.asarray(np.isfinite(values)) for name, values in columns.items()}
    for name in list(known):
        if (thin := _thin(known[name], groups)) is not None:
            absent[name] = f"known of {known.pop(name)[groups[thin]].sum()} of {groups[thin].sum()} {thin}"
            del columns[name]
    while (thin := _thin(whole := _all(known, len(groups["trials"])), groups)) is not None:
        inside = groups[thin]
        counts = {name: int(part[inside].sum()) for name, part in reversed(known.items())}
        worst = min(counts, key=counts.__getitem__)
        others = " and ".join(name for name in known if name != worst and counts[name] < inside.sum())
        absent[worst] = (
            f"known of {counts[worst]} of {inside.sum()} {thin}, and together with {others} of {whole[inside].sum()}"
        )
        del known[worst], columns[worst]
    return whole


def _all(known: Mapping[str, NDArray[np.bool_]], count: int) -> NDArray[np.bool_]:
    return np.asarray(np.column_stack([np.ones(count, dtype=np.bool_), *known.values()]).all(axis=1))


def _covariates(study: Study, table: pd.DataFrame) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """One value a trial of every covariate, in steps, NaN where it is not known; and why one is not there."""
    absent: dict[str, str] = {}
    found = {name: table[column].to_numpy(dtype=np.float64) / step for column, (name, step) in COVARIATES.items()}
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
