"""A study as read: facts, attempts, plans, and what the analysis leaves out and why.

Repeated attempts and withdrawn participants are left out; rules leave out trials (`exclude-trial`) and participants
(`exclude-participant`). Everything left out is reported, and so is what a rule could not judge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from importlib import import_module
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pandas as pd

from palpate.analysis.documents.tables import plural
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    from pathlib import Path

    from palpate.experiment.protocol.models import ExclusionRule, PlannedTest, Protocol

ALL_TASKS = "all"
PLACE = ("participant", "task", "trial", "attempt")
"""The columns that say which attempt a row is."""

AGAIN = "done again"
"""What is said, in place of a rule, of an attempt that was repeated."""


@dataclass(frozen=True)
class Exclusion:
    """An attempt that is left out, or a participant (`trial` is None), in `task` or in every task (`ALL_TASKS`)."""

    participant: str
    task: str
    trial: int | None
    attempt: int | None
    rule: str
    reason: str


@dataclass(frozen=True)
class Unasked:
    """A rule that could not be applied to `trials` of the `of` remaining trials of a session; these trials stay in."""

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
    """Set `included` of `attempts` to False wherever a rule says so; return why, and sessions no rule could judge.

    `withdrawn` says of every participant whether they withdrew; no stimulus is delivered in the tasks `with_objects`.
    Repeated attempts come first, then withdrawals, trials, and participants, who are left out of every task.
    """
    rules = tuple(rules)
    found = [
        _attempt(row, AGAIN, f"attempt {row['attempt']} was repeated: {row['redo_reason']}")
        for row in attempts.loc[~attempts["counted"], [*PLACE, "redo_reason"]].to_dict("records")
    ]
    present = set(attempts["participant"])
    found += [
        _whole_participant(label, "no data", "no events in the dataset") for label in withdrawn if label not in present
    ]
    gone = next((rule for rule in rules if rule.when == "withdrawn"), None)
    left = [label for label, withdrew in withdrawn.items() if withdrew and label in present]
    attempts.loc[attempts["participant"].isin(left), "included"] = False
    why = (gone.id, gone.reason) if gone else ("withdrawn", "withdrew")
    found += [_whole_participant(label, *why) for label in left]
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
    """Return the error for a dataset without a trial left: each rule, how often it acted, and a reason that it gave.

    Attempts that were done again come last: nobody can act on these.
    """
    by_rule: dict[str, list[str]] = {}
    for one in exclusions:
        by_rule.setdefault(one.rule, []).append(one.reason)
    told = "; ".join(
        f"{rule}, {plural(len(reasons), 'time')} ({'such as: ' if len(set(reasons)) > 1 else ''}{reasons[0]})"
        for rule, reasons in sorted(by_rule.items(), key=lambda item: item[0] == AGAIN)
    )
    return DatasetError(dataset, f"every trial is excluded: {told}", "check the exclusion rules of the protocol")


def _attempt(row: Mapping[Hashable, Any], rule: str, reason: str) -> Exclusion:
    return Exclusion(str(row["participant"]), str(row["task"]), int(row["trial"]), int(row["attempt"]), rule, reason)


def _whole_participant(label: str, rule: str, reason: str) -> Exclusion:
    return Exclusion(label, ALL_TASKS, None, None, rule, reason)


def _judged(rule: ExclusionRule) -> tuple[str, str]:
    """Return the column that a rule on trials judges, and words for it."""
    if rule.when == "undelivered":
        return "delivered", "whether the stimulus was delivered"
    return ("frames_lost", "frames lost") if rule.when == "frames-lost" else ("foot_speed_mm_s", "foot speed")


def _unasked(attempts: pd.DataFrame, rule: ExclusionRule, with_objects: Collection[str]) -> list[Unasked]:
    column, words = _judged(rule)
    left = attempts[attempts["included"]]
    if rule.when == "undelivered":
        left = left[~left["task"].isin(with_objects)]
    missing = left[column].isna().groupby([left["participant"], left["task"]], sort=False).agg(["sum", "size"])
    return [
        Unasked(str(participant), str(task), rule.id, words, int(unknown), int(of))
        for (participant, task), unknown, of in missing.itertuples(name=None)
        if unknown
    ]


def _trials(attempts: pd.DataFrame, rule: ExclusionRule) -> list[Exclusion]:
    column, _ = _judged(rule)
    unit = "frames lost" if rule.when == "frames-lost" else "mm/s"
    if rule.when == "undelivered":
        beyond = attempts[column] == 0
    else:
        beyond = attempts[column] < rule.limit if rule.when == "speed-below" else attempts[column] > rule.limit
    hit = attempts["included"] & beyond
    attempts.loc[hit, "included"] = False

    def reason(row: Mapping[Hashable, Any]) -> str:
        judged = "" if rule.when == "undelivered" else f" ({row[column]:.4g} {unit}, limit {rule.limit:g})"
        return rule.reason + judged

    rows = attempts.loc[hit, [*PLACE, column]].to_dict("records")
    return [_attempt(row, rule.id, reason(row)) for row in rows]


def _few_answers(attempts: pd.DataFrame, rule: ExclusionRule) -> list[Exclusion]:
    left = attempts[attempts["included"]]
    answered = left[left["answered"] != NO_ANSWER].groupby(["participant", "task"]).size().to_dict()
    sessions = dict.fromkeys(zip(attempts["participant"], attempts["task"], strict=True))
    found: dict[str, Exclusion] = {}
    present = set(left["participant"])
    for label, task in sessions:
        count = answered.get((label, task), 0)
        if label in present and label not in found and rule.limit is not None and count < rule.limit:
            reason = f"{rule.reason} ({plural(count, 'answered trial')} in {task}, limit {rule.limit:g})"
            found[label] = _whole_participant(label, rule.id, reason)
    attempts.loc[attempts["participant"].isin(list(found)), "included"] = False
    return list(found.values())


@dataclass(frozen=True)
class Task:
    """One task of the study, as its sidecars describe it; `presented` are the materials that it presents, in order."""

    id: str
    title: str
    instructions: str
    presented: tuple[str, ...]


@dataclass(frozen=True)
class TaskDesign:
    """What a task asks: the name of its design, the kind of its trials, the answers that it allows, and of how many
    materials at a time.
    """

    name: str
    kind: str
    answers: tuple[str, ...]
    intervals: int


@dataclass(frozen=True)
class Version:
    """A version of an amended protocol: its file, and its sessions, each a participant and a task."""

    file: str
    protocol: Protocol
    sessions: frozenset[tuple[str, str]]


@dataclass(frozen=True)
class Part:
    """One dataset of a study: folder's name, participants, tasks, its protocol, whether that is `sealed`, and anchors.

    `anchors` are the days and numbers of those in its log, as they stand in a lab book, oldest first. `protocol` is the
    version in force; `versions` has it and those before it, oldest first, where a board approved more than one.
    `incidents` are its adverse events and deviations, in words.
    """

    name: str
    participants: tuple[str, ...]
    tasks: tuple[str, ...]
    protocol: Protocol | None
    sealed: str = "no seal is stored with it"
    anchors: tuple[str, ...] = ()
    versions: tuple[Version, ...] = ()
    incidents: tuple[str, ...] = ()

    def plan(self, participant: str, task: str) -> Protocol | None:
        """Return the version of the protocol under which a participant did a task."""
        own = (one.protocol for one in self.versions if (participant, task) in one.sessions)
        return next(own, self.protocol)


@dataclass(frozen=True)
class Study:
    """A dataset as read, or several as one.

    `origin` is one of `dataset.ORIGINS`; `label` heads everything made from the study, and is empty for a study's
    own data. `first_tasks` gives participant -> task, `session_ids` participant and task -> id, where known,
    `forces` the tables of what a servo sent, `facts` participant and column -> the cell of participants.tsv,
    `touched` the keys Contactor and Touch of sidecars. `attempts` has a row for each attempt: participant, task,
    trial, attempt, counted, presented, answered, response_time_s, foot_speed_mm_s, frames_lost, delivered (1, 0 or
    NaN), onset_error_s, redo_reason, included, and the columns of `files.FURTHER`, sent_thirds and heard_thirds
    (dB, or None), heard_of (whose), and those that say what a design presented. `designs` are by task, and of one
    name. `ordered`: trials are numbered as they were done.
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
    designs: Mapping[str, TaskDesign]
    ordered: bool = True
    forces: Mapping[tuple[str, str], tuple[Path, ...]] = field(default_factory=dict)
    facts: Mapping[tuple[str, str], str] = field(default_factory=dict)
    touched: Mapping[tuple[str, str], Mapping[str, Any]] = field(default_factory=dict)

    def __repr__(self) -> str:
        counted, tasks = int(self.attempts["included"].sum()), ", ".join(task.id for task in self.tasks)
        people = plural(len(self.participants), "participant")
        return (
            f"<Study {self.id}, {self.origin}: {people}; {tasks}; {plural(counted, 'trial')}, "
            f"{len(self.attempts) - counted} left out>"
        )

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each trial that counts, with the columns of `attempts` but counted and included."""
        return self.attempts[self.attempts["included"]].drop(columns=["counted", "included"]).reset_index(drop=True)

    @property
    def title(self) -> str:
        """The name without the label before it."""
        return self.name.removeprefix(f"{self.label}: ")

    @property
    def design(self) -> str:
        """The name of the design of its tasks."""
        (found,) = {one.name for one in self.designs.values()}
        return found

    @property
    def factors(self) -> Mapping[str, Mapping[str, float]]:
        """The values of each material that is made of factors, by their ids; nothing where protocols differ in them."""
        crossed = import_module("palpate.experiment.protocol.designs.factors").crossed
        found = [crossed(part.protocol) for part in self.parts if part.protocol]
        return found[0] if found and all(one == found[0] for one in found) else {}

    def trials(self, task: str) -> pd.DataFrame:
        """Return the trials of one task that the analysis counts."""
        return self.attempts[self.attempts["included"] & (self.attempts["task"] == task)]

    def of_analysed(self) -> pd.DataFrame:
        """Return every attempt of the participants of whom one counts."""
        people = self.attempts.loc[self.attempts["included"], "participant"].unique()
        return self.attempts[self.attempts["participant"].isin(people)]

    def plans(self) -> Iterator[PlannedTest]:
        """Yield the planned tests of every part."""
        for part in self.parts:
            yield from part.protocol.analysis if part.protocol else ()

    def groups(self, plan: PlannedTest) -> tuple[str, ...]:
        """Return the groups that a planned test compares: what may be chosen of a fact about people, in their order."""
        asked: Any = import_module("palpate.experiment.protocol.asked")
        protocols = (part.protocol for part in self.parts if part.protocol)
        return tuple(dict.fromkeys(one for each in protocols for one in asked.values(each, plan.groups)))


def chance(study: Study, task: str) -> Fraction:
    """Return chance in a task, which is the same in every part of a study; see `check_chances`."""
    return next(_chance(part, task, len(study.materials)) for part in study.parts if task in part.tasks)


def correction(study: Study, task: str) -> str | None:
    """Return the family of Holm's method, in the first plan of a test against chance for the task, or None."""
    found = (plan.correction for plan in study.plans() if plan.chance is not None and task in plan.tasks)
    return next(found, None)


def check_chances(parts: Sequence[Part], materials: int) -> None:
    """Refuse to pool answers that are tested against different chances."""
    for task in dict.fromkeys(task for part in parts for task in part.tasks):
        found = {part.name: _chance(part, task, materials) for part in parts if task in part.tasks}
        if len(set(found.values())) > 1:
            got = ", ".join(f"{float(value):.4g} ({name})" for name, value in found.items())
            raise DatasetError(f"task {task}", f"got the chances {got}", "analyze each dataset alone", allowed="one")


def sentences(study: Study) -> tuple[str, ...]:
    """Return sentences on how the parts differ, on who did fewer trials than planned, and on what went wrong."""
    incidents = [one for part in study.parts for one in part.incidents]
    return (*_differences(study), *_incomplete(study), *incidents)


def _chance(part: Part, task: str, materials: int) -> Fraction:
    for plan in part.protocol.analysis if part.protocol else ():
        if plan.chance is not None and task in plan.tasks:
            return plan.exact_chance(materials)
    return Fraction(1, materials)


def _differences(study: Study) -> list[str]:
    known = [(part.name, part.protocol) for part in study.parts if part.protocol]
    if not known:
        return []
    name, first = known[0]
    said = [sentence for part in study.parts for sentence in _amendments(part)]
    for other, protocol in known[1:]:
        if keys := [key for key in type(first).model_fields if getattr(protocol, key) != getattr(first, key)]:
            said.append(f"The protocols of {name} and {other} differ in: {', '.join(keys)}.")
    said += [
        f"{part.name} has no copy of its protocol, so no exclusion rules apply to it and its plans are unknown."
        for part in study.parts
        if not part.protocol and len(study.parts) > 1
    ]
    if said:
        said.append("The exclusions of each dataset follow its own protocol.")
    return said


def _amendments(part: Part) -> Iterator[str]:
    """Yield what each amendment changed, and how many sessions are of each version; all are analysed together."""
    for old, new in pairwise(part.versions):
        differing = [
            key for key in type(new.protocol).model_fields if getattr(old.protocol, key) != getattr(new.protocol, key)
        ]
        yield (
            f"The protocol of {part.name} was amended: {new.file} ({plural(len(new.sessions), 'session')}) differs "
            f"from {old.file} ({plural(len(old.sessions), 'session')}) in: {', '.join(differing)}. Sessions under "
            "both are analyzed together. The planned numbers are from the version in force."
        )


def _incomplete(study: Study) -> list[str]:
    """Return a sentence on sessions with fewer counted trials than their protocol plans, if there are any."""
    rows = study.attempts[study.attempts["counted"]]
    counted = Counter(zip(rows["participant"].tolist(), rows["task"].tolist(), strict=True))
    planned = {
        (participant, task.id): plan.trials(plan.task(task.id))
        for part in study.parts
        if part.protocol
        for task in part.protocol.tasks
        if task.levels is None
        for participant in part.participants
        if (plan := part.plan(participant, task.id))
    }
    short = [
        f"{participant} in {task} ({count} of {planned[participant, task]})"
        for (participant, task), count in counted.items()
        if count < planned.get((participant, task), 0)
    ]
    return [f"Fewer trials than planned were completed; ratios use only these: {', '.join(short)}."] if short else []
