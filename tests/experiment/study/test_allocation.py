"""Which tasks participants do: the orders balance while they enrol."""

from __future__ import annotations

from collections import Counter
from itertools import permutations
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.errors import RosterError
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study.schedule import Allocation, allocate, find_allocation, labels
from tests.approved import Refuses
from tests.experiment.protocol.small import changed, document, okamoto2012, protocol


def study(participants: int, tasks: dict[str, int], kind: str = "counterbalanced") -> Protocol:
    """The small protocol with these participants in these tasks."""
    base: Any = document()
    one = {**base["tasks"][0], "repetitions": 3}
    base = changed(base, ("study", "participants"), participants)
    base = changed(base, ("task_order", "kind"), kind)
    first = next(iter(tasks))
    analysis = ({**base["analysis"][0], "tasks": (first,)},)
    made = tuple({**one, "id": task, "participants": count} for task, count in tasks.items())
    return ProtocolFile.model_validate({**base, "tasks": made, "analysis": analysis})


@given(st.integers())
def test_the_published_study_is_balanced_after_every_second_participant(seed: int) -> None:
    allocations = allocate(ProtocolFile.model_validate(okamoto2012()), seed)
    assert [allocation.participant for allocation in allocations] == [f"{n:02d}" for n in range(1, 16)]
    # Section 5.1: all 15 did Task 1, ten of them Task 2, half of these in either order.
    for enrolled in range(2, 11, 2):
        orders = Counter(allocation.tasks for allocation in allocations[:enrolled])
        assert orders == {("virtual", "real"): enrolled // 2, ("real", "virtual"): enrolled // 2}
    assert {allocation.tasks for allocation in allocations[10:]} == {("virtual",)}


@given(st.integers(), st.integers(1, 40))
def test_three_tasks_balance_after_every_sixth_participant(seed: int, participants: int) -> None:
    allocations = allocate(study(participants, {"a": participants, "b": participants, "c": participants}), seed)
    assert len(allocations) == participants
    for begin in range(0, participants - 5, 6):
        block = [allocation.tasks for allocation in allocations[begin : begin + 6]]
        assert sorted(block) == sorted(permutations("abc"))


def test_those_who_do_the_same_tasks_balance_among_themselves() -> None:
    allocations = allocate(study(12, {"a": 12, "b": 8, "c": 2}), 5)
    assert [sorted(allocation.tasks) for allocation in allocations] == [["a", "b", "c"]] * 2 + [["a", "b"]] * 6 + [
        ["a"]
    ] * 4
    assert Counter(allocation.tasks for allocation in allocations[2:8]) == {("a", "b"): 3, ("b", "a"): 3}


def test_either_order_comes_first_about_as_often() -> None:
    first = Counter(allocate(ProtocolFile.model_validate(okamoto2012()), seed)[0].tasks for seed in range(200))
    # Binomial, n = 200, p = 1/2: 4 standard deviations are 28.
    assert abs(first["virtual", "real"] - 100) < 28


def test_a_fixed_order_is_that_of_the_file() -> None:
    allocations = allocate(study(4, {"b": 4, "a": 3}, kind="fixed"), 1)
    assert [allocation.tasks for allocation in allocations] == [("b", "a")] * 3 + [("b",)]


def test_allocation_is_a_function_of_tasks_and_seed() -> None:
    small, renamed = study(40, {"a": 40, "b": 40}), study(40, {"a": 40, "c": 40})
    assert allocate(small, 1) == allocate(small, 1)
    assert allocate(small, 1) != allocate(small, 2)
    first = [[one.tasks[0] == "a" for one in allocate(each, 1)] for each in (small, renamed)]
    assert first[0] != first[1]


@pytest.mark.parametrize(
    ("participants", "first", "last"), [(1, "01", "01"), (99, "01", "99"), (100, "001", "100"), (1000, "0001", "1000")]
)
def test_labels_are_equally_wide(participants: int, first: str, last: str) -> None:
    found = labels(study(participants, {"a": participants}))
    assert (found[0], found[-1], len(found)) == (first, last, participants)
    assert len({len(label) for label in found}) == 1


def test_a_participant_is_found() -> None:
    assert find_allocation(allocate(protocol(), 1), "05") == Allocation("05", ("one",))


@pytest.mark.parametrize("stranger", ["00", "07", "5", "", "sub-05"])
def test_a_stranger_is_refused(stranger: str, refuses: Refuses) -> None:
    with refuses(RosterError):
        find_allocation(allocate(protocol(), 1), stranger)
