"""The order of comparisons: every pair as often as planned, half of the time in either order, drawn by the seed."""

from __future__ import annotations

from collections import Counter
from itertools import combinations_with_replacement

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment.study.schedule import block_trials, schedule
from tests.experiment.protocol.tapping import protocol

NAMES = ("felt", "cork", "tin")
ORDERS = st.sampled_from(["full-random", "blocked-random"])


def presented(repetitions: int, order: str, seed: int, participant: str = "1") -> list[tuple[str, ...]]:
    study = protocol(repetitions=repetitions, order=order)
    planned = schedule(protocol=study, participant=participant, task_id="live", seed=seed)
    assert [one.trial for one in planned] == list(range(1, len(planned) + 1))
    return [one.presented for one in planned]


@settings(max_examples=60, deadline=None)
@given(repetitions=st.integers(1, 6).map(lambda n: 2 * n), order=ORDERS, seed=st.integers(0, 2**32))
def test_every_pair_comes_as_often_as_planned_and_half_of_the_time_in_either_order(
    repetitions: int, order: str, seed: int
) -> None:
    counts = Counter(presented(repetitions, order, seed))
    for first, second in combinations_with_replacement(NAMES, 2):
        if first == second:
            assert counts[first, second] == repetitions
        else:
            assert counts[first, second] == counts[second, first] == repetitions // 2
    assert counts.total() == 6 * repetitions


@settings(max_examples=30, deadline=None)
@given(repetitions=st.sampled_from([2, 4, 8]), seed=st.integers(0, 2**32))
def test_a_block_of_a_blocked_order_has_every_pair_once(repetitions: int, seed: int) -> None:
    order = presented(repetitions, "blocked-random", seed)
    assert block_trials(protocol(repetitions=repetitions, order="blocked-random"), "live") == 6
    for begin in range(0, len(order), 6):
        block = {tuple(sorted(pair)) for pair in order[begin : begin + 6]}
        assert block == {tuple(sorted(pair)) for pair in combinations_with_replacement(NAMES, 2)}


@given(order=ORDERS, seed=st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_the_same_seed_gives_the_same_order(order: str, seed: int) -> None:
    assert presented(4, order, seed) == presented(4, order, seed)


@pytest.mark.parametrize("order", ["full-random", "blocked-random"])
def test_which_comes_first_is_even_at_every_place_of_a_pair(order: str) -> None:
    """Over 400 seeds, the first trial with felt and cork has felt first in about half: 200 with an SD of 10."""
    ahead = 0
    for seed in range(400):
        ahead += next(pair for pair in presented(2, order, seed) if set(pair) == {"felt", "cork"}) == ("felt", "cork")
    assert 160 < ahead < 240


def test_a_material_stands_first_as_often_as_second() -> None:
    order = presented(8, "full-random", 3)
    assert Counter(first for first, _ in order) == Counter(second for _, second in order) == dict.fromkeys(NAMES, 16)


def test_one_block_is_the_whole_task_without_blocks() -> None:
    assert block_trials(protocol(repetitions=8), "live") == 48
