"""Which tasks each participant does, in which order; the same on every machine.

Those who enrol first do the tasks with fewer participants. Orders are allocated by permuted blocks: each block holds
every order once, shuffled, so the orders balance after every block.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

from palpate.experiment.errors import RosterError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study.schedule import Draws


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


def find(allocations: Sequence[Allocation], participant: str) -> Allocation:
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
