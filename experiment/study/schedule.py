"""Which tasks each participant does and the trials of a task, both in order, and the random choices behind them.

Those who enrol first do the tasks with fewer participants. Orders of tasks are allocated by permuted blocks: each block
holds every order once, shuffled, so the orders balance after every block.

A choice is a pure function of its purpose: its bits are SHA-256 in counter mode. Every pair of materials is presented
half of the time in either order, at shuffled places. Constrained orders are drawn uniformly: they are counted, a rank
is drawn, and the order of that rank is built (`experiment/decisions.md`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from math import comb
from typing import TypeVar

from palpate.experiment.errors import RosterError, ScheduleError
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import PlannedTrial

Item = TypeVar("Item")


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
            order = [(material,) for material in constrained(counts, max_run=task.order.max_run or 0, draws=draws)]
    if design_of(task.design).intervals == 2:
        order = _in_either_order(order, draws)
    return tuple(PlannedTrial(trial=place, presented=one) for place, one in enumerate(order, start=1))


def _in_either_order(pairs: Sequence[tuple[str, ...]], draws: Draws) -> list[tuple[str, ...]]:
    """Return the pairs, which come in even numbers, with half of each kind turned round at shuffled places."""
    turned: dict[tuple[str, ...], list[bool]] = {
        pair: draws.shuffled([False, True] * (pairs.count(pair) // 2)) for pair in dict.fromkeys(sorted(pairs))
    }
    return [pair[::-1] if turned[pair].pop() else pair for pair in pairs]


def block_trials(protocol: Protocol, task_id: str) -> int:
    """Return the trials in a block of a task: each material or pair once if the order is blocked, else the whole."""
    task = protocol.task(task_id)
    return len(protocol.presentations(task)) if task.order.kind == "blocked-random" else protocol.trials(task)


def constrained(counts: Mapping[str, int], *, max_run: int, draws: Draws) -> list[str]:
    """Return one of all orders without a run above `max_run`, each equally likely.

    `counts` are the presentations of each material. Raises `ScheduleError` if there is no such order.
    """
    total = count_orders(tuple(counts.values()), max_run=max_run)
    if total == 0:
        # Only a material that outnumbers the gaps between the others can make an order impossible.
        name, most = max(counts.items(), key=lambda item: item[1])
        others = sum(counts.values()) - most
        raise ScheduleError(
            f"{name} {most} times among {others} other{'s' if others != 1 else ''} with runs of at most {max_run}: at "
            f"most {max_run * (others + 1)} fit",
            remedy="present it less often, or allow longer runs",
        )
    names = list(counts)
    rank = draws.below(total)
    return [names[i] for i in nth_order(tuple(counts.values()), max_run=max_run, rank=rank)]


def count_orders(counts: Sequence[int], *, max_run: int) -> int:
    """Return how many orders of these `counts` have no run above `max_run`. Raises `ScheduleError` for bad numbers."""
    _check(counts, max_run)
    return _Orders(max_run).count(tuple(counts))


def nth_order(counts: Sequence[int], *, max_run: int, rank: int) -> tuple[int, ...]:
    """Return the order of this rank, from 0, as indices into `counts`; `ScheduleError` if there are not so many.

    Orders are ranked by their first run: its material, then its length, then what follows.
    """
    _check(counts, max_run)
    orders = _Orders(max_run)
    left = list(counts)
    if not 0 <= rank < orders.count(tuple(left)):
        raise ScheduleError(f"got rank {rank}", allowed=f"at least 0 and below {orders.count(tuple(left))}")
    order: list[int] = []
    while any(left):
        last = order[-1] if order else None
        material, length, rank = _first_run(orders, left, last, rank)
        left[material] -= length
        order += [material] * length
    return tuple(order)


def _first_run(orders: _Orders, left: Sequence[int], last: int | None, rank: int) -> tuple[int, int, int]:
    """Return material and length of the run with which the rest of rank `rank` begins, and the rank of what follows."""
    for material in range(len(left)):
        if material == last:
            continue
        after = orders.not_starting_with(left, material)
        for length in range(1, min(orders.max_run, left[material]) + 1):
            count = after[left[material] - length]
            if rank < count:
                return material, length, rank
            rank -= count
    raise AssertionError("the counts of the first runs do not add up to the count of all orders")


def _check(counts: Sequence[int], max_run: int) -> None:
    if max_run < 1:
        raise ScheduleError(f"got runs of at most {max_run} trials", remedy="correct max_run", allowed="at least 1")
    if any(count < 0 for count in counts):
        raise ScheduleError(f"got the numbers of trials {list(counts)}", allowed="none below 0")


class _Orders:
    """Counts of orders with runs of at most `max_run`; each count is kept for all arrangements of the same counts."""

    def __init__(self, max_run: int) -> None:
        self.max_run = max_run
        self._powers: list[list[int]] = [[1]]
        self._products: dict[tuple[int, ...], list[int]] = {(): [1]}
        self._counts: dict[tuple[tuple[int, ...], int], list[int]] = {}

    def count(self, counts: tuple[int, ...]) -> int:
        """Return how many orders of these counts there are."""
        return self._counts_up_to(counts[:-1], counts[-1])[-1] if counts else 1

    def not_starting_with(self, left: Sequence[int], material: int) -> list[int]:
        """Return, for n from 0 to `left[material]`, how many orders of n of it with all others begin with another."""
        others = (*left[:material], *left[material + 1 :])
        found: list[int] = []
        for count in self._counts_up_to(others, left[material]):
            found.append(count - sum(found[max(0, len(found) - self.max_run) :]))
        return found

    def _counts_up_to(self, others: tuple[int, ...], most: int) -> list[int]:
        """For n from 0 to `most`, return how many orders have `others` and n of one more material."""
        key = tuple(sorted(others)), most
        if key not in self._counts:
            product = self._product(key[0])
            # By the number k of chunks of the additional material: the orders of all chunks.
            with_chunks = [
                sum(weight * comb(placed + k, k) for placed, weight in enumerate(product) if weight)
                for k in range(most + 1)
            ]
            self._counts[key] = [
                sum(weight * with_chunks[k] for k, weight in enumerate(self._chunks(n)) if weight)
                for n in range(most + 1)
            ]
        return self._counts[key]

    def _product(self, counts: tuple[int, ...]) -> list[int]:
        """Return the weighted orders of the chunks of all these materials, by total number of chunks."""
        if counts not in self._products:
            before = self._product(counts[:-1])
            own = self._chunks(counts[-1])
            product = [0] * (len(before) + len(own) - 1)
            for i, weight in enumerate(before):
                for k, own_weight in enumerate(own):
                    if weight and own_weight:
                        product[i + k] += weight * own_weight * comb(i + k, k)
            self._products[counts] = product
        return self._products[counts]

    def _chunks(self, trials: int) -> list[int]:
        """Return the coefficients of z^trials in u(z)^k, the weighted ways to cut `trials` into k chunks, by k."""
        while len(self._powers) <= trials:
            n = len(self._powers)
            row = [0] * (n + 1)
            for length in range(1, n + 1):
                if weight := self._weight(length):
                    for k, ways in enumerate(self._powers[n - length]):
                        row[k + 1] += weight * ways
            self._powers.append(row)
        return self._powers[trials]

    def _weight(self, length: int) -> int:
        """Return u_length, where u = (z - z^(r+1)) / (1 - z^(r+1)) and r is the longest run."""
        match length % (self.max_run + 1):
            case 1:
                return 1
            case 0:
                return -1
        return 0


@dataclass(frozen=True)
class Allocation:
    """What one participant does: their label, and the ids of their tasks in the order in which they do them."""

    participant: str
    tasks: tuple[str, ...]


def labels(protocol: Protocol) -> tuple[str, ...]:
    """Return the labels of a study's participants, all equally wide, with at least two digits."""
    count = protocol.study.participants
    width = max(2, len(str(count)))
    return tuple(f"{number:0{width}d}" for number in range(1, count + 1))


def allocate(protocol: Protocol, seed: int) -> tuple[Allocation, ...]:
    """Return what every participant does, in order of enrolment; drawn from the seed and the tasks' ids alone."""
    blocks: dict[tuple[str, ...], Iterator[tuple[str, ...]]] = {}
    allocations = []
    for place, participant in enumerate(labels(protocol)):
        tasks = tuple(task.id for task in protocol.tasks if place < task.participants)
        if protocol.task_order.kind == "counterbalanced":
            if tasks not in blocks:
                blocks[tasks] = _permuted_blocks(tasks, seed)
            tasks = next(blocks[tasks])
        allocations.append(Allocation(participant, tasks))
    return tuple(allocations)


def allocated(protocol: Protocol, seed: int, takes: Mapping[str, str]) -> tuple[Allocation, ...]:
    """Return what `allocate` returns, and what those do who took the places of others, as `Roster.takes` says."""
    tasks = {one.participant: one.tasks for one in allocate(protocol, seed)}
    for participant, place in takes.items():
        if place in tasks:
            tasks.setdefault(participant, tasks[place])
    return tuple(Allocation(participant, its) for participant, its in tasks.items())


def _permuted_blocks(tasks: tuple[str, ...], seed: int) -> Iterator[tuple[str, ...]]:
    draws = Draws("task orders", seed, *tasks)
    while True:
        yield from draws.shuffled(tuple(permutations(tasks)))


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
