"""Orders without long runs, drawn uniformly: they are counted, a rank is drawn, and the order of that rank is built.

`schedule` looks this up for a task whose order is `max-run`. `experiment/decisions.md` has why none is rejected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import comb

from palpate.experiment.errors import ScheduleError
from palpate.experiment.study.schedule import Draws


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
    raise AssertionError("the counts for the first runs do not add up to the number of all orders")


def _check(counts: Sequence[int], max_run: int) -> None:
    if max_run < 1:
        raise ScheduleError(f"got runs of at most {max_run} trials", remedy="correct max_run", allowed="at least 1")
    if any(count < 0 for count in counts):
        raise ScheduleError(f"got {list(counts)} trials", allowed="none below 0")


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
