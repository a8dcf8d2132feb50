"""Sign flips: Fisher's own example, every sign one by one, sums in whole numbers, and drawn signs."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.sign_flips import DRAWS, sign_flip, sign_flip_tests
from tests.analysis.reference import printed

NOTHING = np.random.default_rng(0)
"""A generator from which no exact test draws."""


def test_sign_flips_of_darwins_maize_are_fishers() -> None:
    darwin = printed("darwin")
    found = sign_flip(darwin["differences"], 0, NOTHING)
    assert found.p == 2 * darwin["as_large"] / 2**15
    assert (found.n, found.least) == (15, 2 / 2**15)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 10), min_size=1, max_size=9), st.sampled_from([Fraction(1, 4), Fraction(1, 3)]))
def test_every_way_to_give_signs_is_counted(counts: list[int], chance: Fraction) -> None:
    distances = [Fraction(count, 10) - chance for count in counts]
    ways = itertools.product((1, -1), repeat=len(counts))
    sums = [sum((d * s for d, s in zip(distances, signs, strict=True)), Fraction(0)) for signs in ways]
    share = float(np.mean([abs(one) >= abs(sum(distances, Fraction(0))) for one in sums]))
    assert sign_flip([Fraction(count, 10) for count in counts], chance, NOTHING).p == pytest.approx(share, abs=1e-14)
    assert sign_flip_tests(np.array([counts]), 10, chance)[0] == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize(("people", "trials"), [(25, 10), (40, 12), (60, 7), (5, 200)])
def test_many_studies_are_tested_as_one(people: int, trials: int) -> None:
    counts = np.random.default_rng(3).binomial(trials, 0.3, size=(4, 5, people))
    found = sign_flip_tests(counts, trials, Fraction(1, 4))
    for study, p in zip(counts.reshape(-1, people), found.ravel(), strict=True):
        own = sign_flip([Fraction(int(count), trials) for count in study], Fraction(1, 4), NOTHING)
        assert p == pytest.approx(own.p, abs=1e-12)


def test_where_every_answer_is_right_there_is_a_p() -> None:
    """Two of 2^n signs, all of them and none, are as far from chance."""
    assert sign_flip([Fraction(1)] * 10, Fraction(1, 4), NOTHING).p == 2 / 2**10


def test_where_everybody_is_at_chance_p_is_1() -> None:
    assert sign_flip([Fraction(1, 4)] * 5, Fraction(1, 4), NOTHING).p == 1


def test_unequal_trials_are_weighed_exactly() -> None:
    """By hand: distances 1/4, 1/12 and -1/20 sum to 17/60; of 8 signs, those of all alike and of the last turned."""
    ratios = [Fraction(1, 2), Fraction(1, 3), Fraction(1, 5)]
    assert sign_flip(ratios, Fraction(1, 4), NOTHING).p == 4 / 8


def test_whole_numbers_of_any_size_are_enumerated() -> None:
    """The distances 1 / 9973 to 1 / 9931 differ by less than 1e-7 of their sum, which only all signs alike reach."""
    values = [Fraction(1, prime) for prime in (9973, 9967, 9949, 9941, 9931)]
    assert sign_flip(values, 0, NOTHING).p == 2 / 2**5
    values += [Fraction(1, 10**12 + 39), -Fraction(1, 10**12 + 61)]
    assert sign_flip(values, 0, NOTHING).p == 4 / 2**7
    with pytest.raises(NotDefined):
        sign_flip([], Fraction(1, 4), NOTHING)


def test_forty_participants_with_different_trials_are_enumerated() -> None:
    """Whole ways to each sum, by Pascal's rule over all participants, in Python's integers."""
    rng = np.random.default_rng(5)
    values = [Fraction(int(rng.binomial(n, 0.3)), int(n)) - Fraction(1, 4) for n in rng.choice((36, 40), size=40)]
    whole = [int(value * 360) for value in values]
    ways = Counter({0: 1})
    for step in whole:
        turned: Counter[int] = Counter()
        for total, often in ways.items():
            turned[total + step] += often
            turned[total - step] += often
        ways = turned
    reached = sum(often for total, often in ways.items() if abs(total) >= abs(sum(whole)))
    found = sign_flip(values, 0, NOTHING)
    assert found.error is None
    assert found.p == pytest.approx(reached / 2**40, rel=1e-12)


def test_forty_participants_whose_sums_all_differ_are_enumerated() -> None:
    values = [Fraction(3**k % 1_000_003) for k in range(40)]
    found = sign_flip(values, 0, NOTHING)
    assert (found.error, found.p) == (None, found.least)


def test_participants_whose_trials_have_no_common_multiple_of_62_bits_are_enumerated() -> None:
    """Every sign of 14 participants, in fractions; equal shares and a half that is two quarters tie some sums."""
    primes = (83, 89, 97, 101, 103, 107, 109, 113, 127, 131)
    values = [Fraction(prime // 3, prime) for prime in primes] + [Fraction(k, 8) for k in (1, 1, 2, 3)]
    whole = [int((value - Fraction(1, 4)) * math.lcm(8, *primes)) for value in values]
    sums = np.array([0], dtype=object)
    for step in whole:
        sums = np.concatenate([sums - step, sums + step])
    reached = sum(abs(one) >= abs(sum(whole)) for one in sums)
    assert sum(map(abs, whole)) > 2**62
    assert sign_flip(values, Fraction(1, 4), NOTHING).p == pytest.approx(reached / 2**14, rel=1e-12)


def test_more_participants_are_drawn_within_the_error_that_is_given() -> None:
    """Normal values: P is that of the normal distribution of their sum, to within 1e-3 of 0.05."""
    values = np.random.default_rng(6).normal(0, 10**6, size=80).round().tolist()
    found = sign_flip(values, 0, np.random.default_rng(7))
    expected = 2 * stats.norm.sf(abs(sum(values)) / math.hypot(*values))
    assert found.error == pytest.approx(math.sqrt(found.p * (1 - found.p) / DRAWS))
    assert found.p == pytest.approx(expected, abs=4 * (found.error or 0) + 1e-3)
    assert sign_flip([value + 10**7 for value in values], 0, NOTHING).p == 1 / (DRAWS + 1)


def test_the_least_p_counts_only_those_who_differ() -> None:
    found = sign_flip([Fraction(1, 4)] * 3 + [Fraction(1, 2)] * 5, Fraction(1, 4), NOTHING)
    assert (found.n, found.p, found.least) == (8, 2 / 2**5, 2 / 2**5)
    assert sign_flip([Fraction(1, 4)] * 5, Fraction(1, 4), NOTHING).least == 1
