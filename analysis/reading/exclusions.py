"""Which attempts and participants the analysis leaves out, and the reason for each.

Left out always: attempts that were done again, and participants who withdrew. Left out by the protocol's rules:
trials (`exclude-trial`) and participants (`exclude-participant`). Rules with `repeat-trial` were acted on in the
session. Nothing is left out in silence, and nothing kept in silence where a rule could not be asked.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from analysis.documents.tables import plural
from experiment.errors import DatasetError
from experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    from experiment.protocol.models import ExclusionRule

ALL_TASKS = "all"


@dataclass(frozen=True)
class Exclusion:
    """One attempt left out, or with `trial` None a participant, in `task` or in every one (`ALL_TASKS`)."""

    participant: str
    task: str
    trial: int | None
    attempt: int | None
    rule: str
    reason: str


@dataclass(frozen=True)
class Unasked:
    """A rule that could not be asked of `trials` of the `of` trials that a session had left, which stay in."""

    participant: str
    task: str
    rule: str
    missing: str
    trials: int
    of: int


def exclude(
    attempts: pd.DataFrame,
    withdrawn: Mapping[str, bool],
    rules: Iterable[ExclusionRule],
    *,
    with_objects: Collection[str] = (),
) -> tuple[tuple[Exclusion, ...], tuple[Unasked, ...]]:
    """Set the column `included` of `attempts` to False wherever a rule says so, and list why.

    Second come the sessions of which a rule could not be asked, for want of the value that it judges.

    The order is: attempts done again, withdrawals, rules on trials, rules on participants; the last count only
    what the others left. A participant left out by a rule is left out of every task.

    Args:
        attempts: one row an attempt, columns as in `analysis.reading.dataset.Study`; changed in place.
        withdrawn: every participant of the dataset, and whether they withdrew.
        rules: the protocol's exclusion rules.
        with_objects: tasks with real objects, of which nobody asks whether a stimulus was delivered.
    """
    rules = tuple(rules)
    found = [
        _attempt(row, "done again", f"attempt {row['attempt']} was done again: {row['redo_reason']}")
        for _, row in attempts[~attempts["counted"]].iterrows()
    ]
    present = set(attempts["participant"])
    found += [_participant(label, "no data", "no events in the dataset") for label in withdrawn if label not in present]
    gone = next((rule for rule in rules if rule.when == "withdrawn"), None)
    for label in (label for label, left in withdrawn.items() if left and label in present):
        attempts.loc[attempts["participant"] == label, "included"] = False
        found.append(_participant(label, *((gone.id, gone.reason) if gone else ("withdrawn", "withdrew"))))
    unasked: list[Unasked] = []
    for rule in rules:
        if rule.action == "exclude-trial":
            unasked += _unasked(attempts, rule, with_objects)
            found += _trials(attempts, rule)
    for rule in rules:
        if rule.when == "answers-below":
            found += _few_answers(attempts, rule)
    return tuple(found), tuple(unasked)


def nothing_left(dataset: str, exclusions: Iterable[Exclusion]) -> DatasetError:
    """The error for a dataset of which every trial is left out: each rule, how often, and a reason that it gave."""
    by_rule: dict[str, list[str]] = {}
    for one in exclusions:
        by_rule.setdefault(one.rule, []).append(one.reason)
    told = "; ".join(
        f"{rule}, {plural(len(reasons), 'time')} ({'such as: ' * (len(set(reasons)) > 1)}{reasons[0]})"
        for rule, reasons in by_rule.items()
    )
    return DatasetError(f"{dataset}: every trial is left out: {told}; check the exclusion rules of the protocol")


def _attempt(row: pd.Series[Any], rule: str, reason: str) -> Exclusion:
    return Exclusion(str(row["participant"]), str(row["task"]), int(row["trial"]), int(row["attempt"]), rule, reason)


def _participant(label: str, rule: str, reason: str) -> Exclusion:
    return Exclusion(label, ALL_TASKS, None, None, rule, reason)


def _judged(rule: ExclusionRule) -> tuple[str, str]:
    """The column that a rule on trials judges, and words for it."""
    if rule.when == "undelivered":
        return "delivered", "whether the stimulus was delivered"
    return ("frames_lost", "frames lost") if rule.when == "frames-lost" else ("foot_speed_mm_s", "the foot's speed")


def _unasked(attempts: pd.DataFrame, rule: ExclusionRule, with_objects: Collection[str]) -> list[Unasked]:
    column, words = _judged(rule)
    left = attempts[attempts["included"]]
    if rule.when == "undelivered":
        left = left[~left["task"].isin(with_objects)]
    missing = left[column].isna().groupby([left["participant"], left["task"]], sort=False)
    return [
        Unasked(str(participant), str(task), rule.id, words, int(unknown.sum()), len(unknown))
        for (participant, task), unknown in missing
        if unknown.any()
    ]


def _trials(attempts: pd.DataFrame, rule: ExclusionRule) -> list[Exclusion]:
    column, _ = _judged(rule)
    if rule.when == "undelivered":
        hit = attempts["included"] & (attempts[column] == 0)
        found = [_attempt(row, rule.id, rule.reason) for _, row in attempts[hit].iterrows()]
        attempts.loc[hit, "included"] = False
        return found
    unit = "frames lost" if rule.when == "frames-lost" else "mm/s"
    beyond = attempts[column] < rule.limit if rule.when == "speed-below" else attempts[column] > rule.limit
    hit = attempts["included"] & beyond
    found = [
        _attempt(row, rule.id, f"{rule.reason} ({row[column]:.4g} {unit}, limit {rule.limit:g})")
        for _, row in attempts[hit].iterrows()
    ]
    attempts.loc[hit, "included"] = False
    return found


def _few_answers(attempts: pd.DataFrame, rule: ExclusionRule) -> list[Exclusion]:
    left = attempts[attempts["included"]]
    answered = left[left["answered"] != NO_ANSWER].groupby(["participant", "task"]).size().to_dict()
    sessions = dict.fromkeys(zip(attempts["participant"], attempts["task"], strict=True))
    found: dict[str, Exclusion] = {}
    for label, task in sessions:
        count = answered.get((label, task), 0)
        if label in set(left["participant"]) and label not in found and rule.limit is not None and count < rule.limit:
            reason = f"{rule.reason} ({plural(count, 'answered trial')} in {task}, limit {rule.limit:g})"
            found[label] = _participant(label, rule.id, reason)
            attempts.loc[attempts["participant"] == label, "included"] = False
    return list(found.values())
