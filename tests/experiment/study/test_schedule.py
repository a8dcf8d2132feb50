"""Orders are counted right, drawn evenly, and the same on every machine."""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from math import factorial, prod

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from palpate.experiment.errors import ScheduleError
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study.runs import constrained, count_orders, nth_order
from palpate.experiment.study.schedule import Draws, allocate, block_trials, schedule
from tests.approved import Refuses
from tests.experiment.protocol.small import changed, document, okamoto2012

COUNTS = st.lists(st.integers(0, 4), max_size=4).map(tuple).filter(lambda counts: sum(counts) <= 8)


def longest_run(order: Iterable[object]) -> int:
    return max((len(list(run)) for _, run in itertools.groupby(order)), default=0)


def every_order(counts: Sequence[int]) -> set[tuple[int, ...]]:
    return set(itertools.permutations([i for i, count in enumerate(counts) for _ in range(count)]))


def multinomial(counts: Sequence[int]) -> int:
    return factorial(sum(counts)) // prod(map(factorial, counts))


def with_order(kind: str, max_run: int | None = None, repetitions: int = 3, materials: int = 2) -> Protocol:
    """The small protocol with another order of task `one`, and its first materials copied."""
    study = changed(document(), ("tasks", 0, "repetitions"), repetitions)
    order = {"kind": kind} if max_run is None else {"kind": kind, "max_run": max_run}
    study = changed(study, ("tasks", 0, "order"), order)
    felt = study["materials"][0]
    names = "abcdeghi"[:materials]
    copies = tuple({**felt, "id": name, "key": name, "spoken": (name,)} for name in names)
    return ProtocolFile.model_validate({**study, "materials": copies, "exclusion": ()})


def drawn(protocol: Protocol, participant: str = "01", seed: int = 1) -> tuple[str, ...]:
    trials = schedule(protocol=protocol, participant=participant, task_id="one", seed=seed)
    assert [trial.trial for trial in trials] == list(range(1, len(trials) + 1))
    return tuple(material for trial in trials for material in trial.presented)


@settings(deadline=None)
@given(COUNTS, st.integers(1, 4))
def test_ranks_are_exactly_the_orders_that_satisfy_the_constraint(counts: tuple[int, ...], max_run: int) -> None:
    satisfying = {order for order in every_order(counts) if longest_run(order) <= max_run}
    total = count_orders(counts, max_run=max_run)
    assert total == len(satisfying)
    # All different, so a rank drawn evenly is an order drawn evenly.
    assert {nth_order(counts, max_run=max_run, rank=rank) for rank in range(total)} == satisfying


@settings(deadline=None)
@given(
    st.sets(st.sampled_from("abcdeg"), min_size=1),
    st.integers(1, 6),
    st.sampled_from(["full-random", "blocked-random", "max-run"]),
    st.integers(0, 2**32),
)
def test_each_material_that_a_task_presents_comes_as_often_as_planned_and_no_other(
    only: set[str], repetitions: int, kind: str, seed: int
) -> None:
    if kind == "max-run" and len(only) == 1:
        kind = "full-random"
    study = with_order(kind, 2 if kind == "max-run" else None, repetitions, materials=6)
    task = study.tasks[0].model_copy(update={"materials": tuple(sorted(only))})
    study = study.model_copy(update={"tasks": (task, *study.tasks[1:])})
    assert Counter(drawn(study, seed=seed)) == dict.fromkeys(only, repetitions)
    assert study.trials(task) == len(only) * repetitions
    assert block_trials(study, "one") == (len(only) if kind == "blocked-random" else len(only) * repetitions)


@pytest.mark.parametrize(
    ("copies", "printed"),
    [
        # On-Line Encyclopedia of Integer Sequences: A114938, A193638, A321633, from n = 0.
        (2, (1, 0, 2, 30, 864, 39480, 2631600, 241133760, 29083420800, 4467125013120)),
        (3, (1, 0, 2, 174, 41304, 19606320, 16438575600, 22278418248240)),
        (4, (1, 0, 2, 1092, 2265024, 11804626080, 131402141197200)),
    ],
)
def test_counts_without_two_alike_in_a_row_are_those_printed(copies: int, printed: tuple[int, ...]) -> None:
    assert tuple(count_orders((copies,) * n, max_run=1) for n in range(len(printed))) == printed


@given(st.lists(st.integers(0, 12), max_size=5))
def test_a_constraint_that_binds_nothing_leaves_every_order(counts: list[int]) -> None:
    assert count_orders(counts, max_run=max([1, *counts])) == multinomial(counts)


@given(st.lists(st.integers(0, 9), min_size=1, max_size=4), st.integers(1, 5))
def test_longer_runs_allow_no_fewer_orders_and_names_do_not_matter(counts: list[int], max_run: int) -> None:
    total = count_orders(counts, max_run=max_run)
    assert total <= count_orders(counts, max_run=max_run + 1)
    assert total == count_orders(counts[::-1], max_run=max_run)


def test_counts_of_a_whole_task_agree_with_a_plain_recursion() -> None:
    @functools.cache
    def rest(left: tuple[int, ...], run: int) -> int:
        """Orders of what is left: the material placed last stands first, after `run` of it; the others are alike."""
        if not any(left):
            return 1
        total = 0
        for i, count in enumerate(left):
            if count and (i > 0 or run < 2):
                others = tuple(sorted(left[:i] + left[i + 1 :]))
                total += rest((count - 1, *others), run + 1 if i == 0 else 1)
        return total

    # A material with no trial stands for the one placed before the first trial.
    assert count_orders((10,) * 4, max_run=2) == rest((0, 10, 10, 10, 10), 0)


@pytest.mark.parametrize(("kind", "max_run"), [("full-random", None), ("max-run", 1), ("max-run", 2)])
def test_every_order_is_equally_likely(kind: str, max_run: int | None) -> None:
    study = with_order(kind, max_run, repetitions=2, materials=3)
    orders = sorted(order for order in every_order((2, 2, 2)) if longest_run(order) <= (max_run or 2))
    counts = Counter(drawn(study, seed=seed) for seed in range(20 * len(orders)))
    assert chisquare([counts[tuple("abc"[i] for i in order)] for order in orders]).pvalue > 1e-3
    assert counts.total() == 20 * len(orders)


def test_every_order_of_a_block_is_equally_likely_and_blocks_are_independent() -> None:
    study = with_order("blocked-random", repetitions=2, materials=3)
    blocks = list(itertools.permutations("abc"))
    counts = Counter(drawn(study, seed=seed) for seed in range(20 * 36))
    assert chisquare([counts[first + second] for first in blocks for second in blocks]).pvalue > 1e-3


@given(st.integers(), st.integers(1, 5), st.integers(2, 5))
def test_each_block_holds_each_material_once(seed: int, repetitions: int, materials: int) -> None:
    order = drawn(with_order("blocked-random", None, repetitions, materials), seed=seed)
    blocks = [order[i : i + materials] for i in range(0, len(order), materials)]
    assert len(blocks) == repetitions
    assert all(sorted(block) == sorted(blocks[0]) for block in blocks)
    assert len(set(blocks[0])) == materials


@given(st.integers(), st.sampled_from(["full-random", "max-run"]), st.integers(1, 8), st.integers(2, 5))
def test_every_material_comes_as_often_as_the_protocol_says(
    seed: int, kind: str, repetitions: int, materials: int
) -> None:
    max_run = 2 if kind == "max-run" else None
    order = drawn(with_order(kind, max_run, repetitions, materials), seed=seed)
    assert set(Counter(order).values()) == {repetitions}
    assert len(set(order)) == materials
    assert max_run is None or longest_run(order) <= max_run


def test_the_published_study_has_forty_balanced_trials() -> None:
    study = ProtocolFile.model_validate(okamoto2012())
    for task in ("virtual", "real"):
        trials = schedule(protocol=study, participant="01", task_id=task, seed=1)
        # Section 5.1: each of four materials ten times.
        assert Counter(material for trial in trials for material in trial.presented) == dict.fromkeys(
            (m.id for m in study.materials), 10
        )


def test_an_amended_text_keeps_every_order() -> None:
    study = ProtocolFile.model_validate(okamoto2012())
    amended = study.model_copy(
        update={"consent": study.consent.model_copy(update={"statement": f"{study.consent.statement}."})}
    )
    assert amended != study
    assert [one.tasks for one in allocate(amended, 7)] == [one.tasks for one in allocate(study, 7)]
    for participant, task in ((who, task) for who in ("01", "02", "15") for task in ("virtual", "real")):
        both = [schedule(protocol=one, participant=participant, task_id=task, seed=7) for one in (study, amended)]
        assert both[0] == both[1]


def test_participant_task_and_seed_each_change_the_order() -> None:
    study = with_order("full-random", repetitions=20, materials=4)
    both = study.model_copy(update={"tasks": (study.tasks[0], study.tasks[0].model_copy(update={"id": "uno"}))})
    orders = [
        drawn(study),
        drawn(study, participant="02"),
        drawn(study, seed=2),
        *(
            tuple(t.presented for t in schedule(protocol=both, participant="01", task_id=task, seed=1))
            for task in ("one", "uno")
        ),
    ]
    assert len(set(orders)) == len(orders)
    assert drawn(study) == orders[0]


def test_a_large_task_is_drawn() -> None:
    counts = {str(i): 30 for i in range(6)}
    # 0.2 s, where counting by the multisets of what is left would take minutes; nothing here measures it.
    order = constrained(counts, max_run=2, draws=Draws("large"))
    assert Counter(order) == counts
    assert longest_run(order) <= 2


@pytest.mark.parametrize(
    ("counts", "max_run", "match"),
    [
        ({"copy paper": 10, "foil": 2}, 1, "copy paper 10 times among 2 others with runs of at most 1: at most 3 fit"),
        ({"foil": 1, "copy paper": 7}, 3, "copy paper 7 times among 1 other with runs of at most 3: at most 6 fit"),
        ({"copy paper": 2}, 1, "copy paper 2 times among 0 others with runs of at most 1: at most 1 fit; present it"),
    ],
)
def test_an_impossible_constraint_says_why(counts: dict[str, int], max_run: int, match: str) -> None:
    with pytest.raises(ScheduleError, match=match):
        constrained(counts, max_run=max_run, draws=Draws("impossible"))


@given(COUNTS.filter(any), st.integers(1, 3))
def test_orders_are_impossible_just_when_one_material_does_not_fit_between_the_others(
    counts: tuple[int, ...], max_run: int
) -> None:
    fits = max(counts) <= max_run * (sum(counts) - max(counts) + 1)
    assert (count_orders(counts, max_run=max_run) > 0) == fits


@pytest.mark.parametrize(
    ("counts", "max_run", "match"),
    [((2, 2), 0, "got runs of at most 0 trials; allowed: at least 1; correct max_run"), ((2, -1), 1, "none below 0")],
)
def test_no_counts_are_refused(counts: tuple[int, ...], max_run: int, match: str) -> None:
    with pytest.raises(ScheduleError, match=match):
        count_orders(counts, max_run=max_run)
    with pytest.raises(ScheduleError, match=match):
        nth_order(counts, max_run=max_run, rank=0)


@pytest.mark.parametrize("rank", [-1, 2])
def test_a_rank_beyond_the_last_order_is_refused(rank: int, refuses: Refuses) -> None:
    with refuses(ScheduleError):
        nth_order((2, 2), max_run=1, rank=rank)


def test_an_unknown_task_is_refused(refuses: Refuses) -> None:
    with refuses(ScheduleError):
        schedule(protocol=ProtocolFile.model_validate(document()), participant="01", task_id="three", seed=1)


def test_orders_are_pinned() -> None:
    # No oracle: a pin. It holds on every machine and version, or studies that have begun get another order.
    found = {
        kind: "".join(drawn(with_order(kind, 2 if kind == "max-run" else None, materials=4)))
        for kind in ("full-random", "blocked-random", "max-run")
    }
    assert found == {
        "full-random": "bcccdbaadbad",
        "blocked-random": "acdbdcbabcda",
        "max-run": "dabacbcbdadc",
    }


def test_bits_are_sha256_in_counter_mode() -> None:
    key = hashlib.sha256(json.dumps(["order", 3, "a"]).encode()).digest()
    stream = b"".join(hashlib.sha256(key + n.to_bytes(16, "big")).digest() for n in range(4))
    draws = Draws("order", 3, "a")
    # Bounds that are powers of 256 use whole bytes and reject nothing.
    drawn = [draws.below(256**size) for size in (1, 5, 40, 2, 32)]
    taken = [stream[0:1], stream[1:6], stream[6:46], stream[46:48], stream[48:80]]
    assert drawn == [int.from_bytes(part, "big") for part in taken]


def test_what_does_not_fit_is_passed_over() -> None:
    key = hashlib.sha256(json.dumps(["reject"]).encode()).digest()
    stream = b"".join(hashlib.sha256(key + n.to_bytes(16, "big")).digest() for n in range(100))
    fitting = [byte >> 4 for byte in stream if byte >> 4 < 9]
    draws = Draws("reject")
    assert [draws.below(9) for _ in range(500)] == fitting[:500]


@given(st.integers(1, 2**600), st.integers())
def test_every_draw_is_below_its_bound(bound: int, seed: int) -> None:
    draws = Draws("bound", seed)
    assert all(0 <= draws.below(bound) < bound for _ in range(5))


@pytest.mark.parametrize("bound", [2, 3, 5, 6, 24, 100])
def test_every_number_is_equally_likely(bound: int) -> None:
    draws = Draws("even", bound)
    counts = Counter(draws.below(bound) for _ in range(100 * bound))
    assert chisquare([counts[n] for n in range(bound)]).pvalue > 1e-3


def test_one_choice_is_no_draw() -> None:
    assert Draws("one").below(1) == 0


@pytest.mark.parametrize("bound", [0, -3])
def test_no_choice_is_refused(bound: int) -> None:
    with pytest.raises(ValueError, match=f"got bound {bound}; allowed: at least 1"):
        Draws("none").below(bound)


def test_every_shuffle_is_equally_likely() -> None:
    draws = Draws("shuffle")
    counts = Counter(tuple(draws.shuffled("abcd")) for _ in range(2400))
    assert chisquare([counts[order] for order in itertools.permutations("abcd")]).pvalue > 1e-3


@given(st.lists(st.integers()))
def test_a_shuffle_keeps_what_it_was_given(items: list[int]) -> None:
    before = list(items)
    assert sorted(Draws("kept").shuffled(items)) == sorted(items)
    assert items == before


@pytest.mark.parametrize(
    ("one", "other"), [(("a", "bc"), ("ab", "c")), ((1,), ("1",)), (("a",), ("a", "")), ((1, 2), (2, 1)), ((0,), (-1,))]
)
def test_purposes_that_differ_at_all_draw_apart(one: tuple[str | int, ...], other: tuple[str | int, ...]) -> None:
    assert Draws(*one).below(2**128) != Draws(*other).below(2**128)
    assert Draws(*one).below(2**128) == Draws(*one).below(2**128)


def test_stream_is_pinned() -> None:
    # No oracle: a pin. A change here would change the schedule of every study that has begun.
    draws = Draws("pinned", 7)
    assert [draws.below(40) for _ in range(12)] == [16, 11, 18, 39, 9, 29, 39, 29, 19, 4, 33, 16]
