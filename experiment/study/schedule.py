"""Which tasks each participant does and the trials of a task, both in order, and the random choices behind them.

Those who enrol first do the tasks with fewer participants. Orders of tasks are allocated by permuted blocks: each block
holds every order once, shuffled, so the orders balance after every block. So are groups, and orders within each group.

A choice is a pure function of its purpose: its bits are SHA-256 in counter mode. Every pair of materials is presented
half of the time in either order, at shuffled places of the task or, with some levels, of a few of its trials. `runs`
draws orders without long runs.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import permutations
from typing import Any, TypeVar

from palpate.experiment.errors import RosterError, ScheduleError
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.records.entries import PlannedTrial

Item = TypeVar("Item")

SHORT_RUN = 4
"""Of so many trials of a signal that follow each other it is first in half, where a track may end early; ours."""


class Draws:
    """A stream of random choices, named by its purpose."""

    def __init__(self, *purpose: str | int) -> None:
        """Begin the stream that `purpose` names; two streams are independent unless every part is equal."""
        self._key = hashlib.sha256(json.dumps(purpose, ensure_ascii=True).encode()).digest()
        self._counter = 0
        self._left = b""

    def below(self, bound: int) -> int:
        """Return a whole number from 0 to `bound` - 1, each equally likely. Raises `ValueError` for one below 1."""
        if bound < 1:
            raise ValueError(f"got bound {bound}; allowed: at least 1")
        bits = (bound - 1).bit_length()
        # Every draw of so many bits is equally likely, so those that fit are too; more than half fit.
        while (drawn := self._bits(bits)) >= bound:
            pass
        return drawn

    def shuffled(self, items: Sequence[Item]) -> list[Item]:
        """Return `items` in a random order, every order of their places equally likely (Fisher and Yates)."""
        order = list(items)
        for last in range(len(order) - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def _bits(self, count: int) -> int:
        whole_bytes = (count + 7) // 8
        while len(self._left) < whole_bytes:
            self._left += hashlib.sha256(self._key + self._counter.to_bytes(16, "big")).digest()
            self._counter += 1
        taken, self._left = self._left[:whole_bytes], self._left[whole_bytes:]
        return int.from_bytes(taken, "big") >> (8 * whole_bytes - count)


def schedule(*, protocol: Protocol, participant: str, task_id: str, seed: int) -> tuple[PlannedTrial, ...]:
    """Return a participant's trials in one task, drawn from seed, label and task alone. Raises `ScheduleError`."""
    known = {task.id: task for task in protocol.tasks}
    if task_id not in known:
        raise ScheduleError(
            f"no task '{task_id}' in study {protocol.study.id}", remedy=f"its tasks: {', '.join(known)}"
        )
    task = known[task_id]
    presented = protocol.presentations(task)
    draws = Draws("order of trials", seed, participant, task_id)
    match task.order.kind:
        case "full-random":
            order = draws.shuffled(presented * task.repetitions)
        case "blocked-random":
            order = [one for _ in range(task.repetitions) for one in draws.shuffled(presented)]
        case "max-run":
            # The protocol's rules give `max_run` a value with this kind, which is for single materials.
            counts = {material: task.repetitions for (material,) in presented}
            runs: Any = import_module("palpate.experiment.study.runs")
            order = [(material,) for material in runs.constrained(counts, max_run=task.order.max_run or 0, draws=draws)]
    if protocol.shown_together(task) == 2:
        order = _in_either_order(order, _run(protocol, task), draws)
    return tuple(PlannedTrial(trial=place, presented=one) for place, one in enumerate(order, start=1))


def _run(protocol: Protocol, task: Task) -> int:
    """Return in how many trials of each pair half are turned round; the tracks of a detection may end early."""
    if task.levels is not None and task.levels.method == "constant":
        return 2 * len(task.levels.grid)
    may_end = task.levels is not None and design_of(task.design).presentations is not None
    return SHORT_RUN if may_end else protocol.trials(task)


def _in_either_order(pairs: Sequence[tuple[str, ...]], run: int, draws: Draws) -> list[tuple[str, ...]]:
    """Return the pairs, which come in even numbers, with half of each run of a kind turned round at shuffled places."""
    turned: dict[tuple[str, ...], list[bool]] = {}
    for pair in dict.fromkeys(sorted(pairs)):
        count = pairs.count(pair)
        runs = [draws.shuffled([False, True] * (min(run, count - at) // 2)) for at in range(0, count, run)]
        turned[pair] = [one for each in runs[::-1] for one in each]
    return [pair[::-1] if turned[pair].pop() else pair for pair in pairs]


def block_trials(protocol: Protocol, task_id: str) -> int:
    """Return the trials in a block of a task: each material or pair once if the order is blocked, else the whole."""
    task = protocol.task(task_id)
    return len(protocol.presentations(task)) if task.order.kind == "blocked-random" else protocol.trials(task)


@dataclass(frozen=True)
class Allocation:
    """One participant's label, the ids of their tasks in order, and their group, empty in a study without groups."""

    participant: str
    tasks: tuple[str, ...]
    group: str = ""


def labels(protocol: Protocol) -> tuple[str, ...]:
    """Return the labels of a study's participants, all equally wide, with at least two digits."""
    count = protocol.study.participants
    width = max(2, len(str(count)))
    return tuple(f"{number:0{width}d}" for number in range(1, count + 1))


def allocate(protocol: Protocol, seed: int) -> tuple[Allocation, ...]:
    """Return what every participant does, in order of enrolment, from the seed and the ids of tasks and groups."""
    blocks: dict[tuple[str, ...], Iterator[tuple[str, ...]]] = {}
    groups = _groups([one.id for one in getattr(protocol, "groups", ())], seed)
    allocations = []
    for place, participant in enumerate(labels(protocol)):
        tasks = tuple(task.id for task in protocol.tasks if place < task.participants)
        group = next(groups, "")
        if protocol.task_order.kind == "counterbalanced":
            if (stratum := (group, *tasks)) not in blocks:
                draws = Draws("task orders in a group", seed, *stratum) if group else Draws("task orders", seed, *tasks)
                blocks[stratum] = _permuted_blocks(tasks, draws)
            tasks = next(blocks[stratum])
        allocations.append(Allocation(participant, tasks, group))
    return tuple(allocations)


def allocated(protocol: Protocol, seed: int, takes: Mapping[str, str]) -> tuple[Allocation, ...]:
    """Return what `allocate` returns, and what those do who took the places of others, as `Roster.takes` says."""
    found = {one.participant: one for one in allocate(protocol, seed)}
    for participant, place in takes.items():
        if place in found:
            found.setdefault(participant, replace(found[place], participant=participant))
    return tuple(found.values())


def _permuted_blocks(tasks: tuple[str, ...], draws: Draws) -> Iterator[tuple[str, ...]]:
    while True:
        yield from draws.shuffled(tuple(permutations(tasks)))


def _groups(names: Sequence[str], seed: int) -> Iterator[str]:
    """Yield the group of each participant, in order of enrolment; none in a study without groups."""
    draws = Draws("groups", seed)
    while names:
        yield from draws.shuffled(names)


def find_allocation(allocations: Sequence[Allocation], participant: str) -> Allocation:
    """Return the allocation of one participant. Raises `RosterError` if the study has no such participant."""
    for allocation in allocations:
        if allocation.participant == participant:
            return allocation
    raise stranger(participant, [allocation.participant for allocation in allocations])


def stranger(participant: str, known: Sequence[str]) -> RosterError:
    """Return what to tell of a label that is none of the `known` ones."""
    return RosterError(
        f"no participant '{participant}'", f"this study has '{known[0]}' to '{known[-1]}'", "give one of these"
    )
