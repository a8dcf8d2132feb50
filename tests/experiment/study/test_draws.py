"""Draws are even, independent of the machine, and named by their purpose."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from experiment.study.draws import Draws


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
