"""GRIM and GRIMMER: published examples, brute force over small samples, and no false accusation."""

from __future__ import annotations

import math
import statistics
from fractions import Fraction
from itertools import combinations_with_replacement

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.audit.bounds import Moments, moments, neighbours, on_scale, totals
from palpate.analysis.audit.intervals import Interval, rounded
from palpate.analysis.published.numbers import Scale
from palpate.analysis.published.printed import Printed

ENDLESS = Interval(Fraction(0), math.inf)
OPEN = Scale(1, None, None)


def _grim(text: str, n: int, items: int = 1) -> bool:
    return len(totals(rounded(Printed(text)), n, items)) > 0


def _grimmer(mean: str, sd: str, n: int) -> bool:
    spread = rounded(Printed(sd)).squared()
    return any(
        spread.meets(one.variance)
        for total in totals(rounded(Printed(mean)), n, 1)
        for one in moments(total, n, OPEN, spread)
    )


def _texts(first: int, count: int, digits: int) -> list[str]:
    return [f"{(first + k) / 10**digits:.{digits}f}" for k in range(count)]


@pytest.mark.parametrize(
    ("texts", "n", "items", "expected"),
    [
        # Brown and Heathers 2017 open with a mean of 5.19 of 28 participants. All of these: tests of the R package
        # scrutiny, tests/testthat/test-grim.R.
        (_texts(519, 12, 2), 28, 1, "FFTFFFTFFFTF"),
        (_texts(150, 10, 3), 120, 3, "TFFTFFTFTF"),
        (_texts(80, 10, 2), 28, 2, "TFTFTFTTTT"),
        ([f"{k}%" for k in range(6, 17)], 50, 1, "TFTFTFTFTFT"),
    ],
)
def test_grim_as_published(texts: list[str], n: int, items: int, expected: str) -> None:
    assert "".join("FT"[_grim(text, n, items)] for text in texts) == expected


@pytest.mark.parametrize(
    ("mean", "sd", "n", "expected"),
    [
        # Tests of the R packages rsprite2 and scrutiny (test-grimmer.R, test-grimmer-map.R: its data set pigs5).
        ("5.21", "1.60", 28, True),
        ("3.44", "2.47", 18, False),
        ("7.22", "5.30", 38, False),
        ("4.74", "6.55", 31, True),
        ("5.23", "2.55", 35, False),
        ("2.57", "2.57", 30, True),
        ("6.77", "2.18", 33, False),
        ("2.68", "2.59", 34, True),
        ("7.01", "6.68", 35, False),
        ("7.38", "3.65", 32, True),
        ("3.14", "5.32", 33, False),
        ("6.89", "4.18", 37, True),
        ("5.00", "2.18", 31, True),
        ("0.24", "6.43", 34, True),
    ],
)
def test_grimmer_as_published(mean: str, sd: str, n: int, expected: bool) -> None:
    assert _grimmer(mean, sd, n) == expected


def _by_hand(n: int, low: int, high: int) -> dict[int, set[Fraction]]:
    found: dict[int, set[Fraction]] = {}
    for values in combinations_with_replacement(range(low, high + 1), n):
        exact = [Fraction(value) for value in values]
        found.setdefault(sum(values), set()).add(statistics.variance(exact))
    return found


@pytest.mark.parametrize(("n", "low", "high"), [(2, 0, 6), (3, 0, 5), (5, 0, 4), (4, 1, 7), (6, 0, 2), (4, -2, 2)])
def test_moments_on_a_scale_are_those_of_every_sample(n: int, low: int, high: int) -> None:
    """Against every multiset of values, its variance from the statistics module."""
    by_hand = _by_hand(n, low, high)
    for total in range(n * low - 2, n * high + 3):
        found = {Fraction(one.variance.low) for one in moments(total, n, Scale(1, low, high), ENDLESS)}
        assert found == by_hand.get(total, set()), total


def test_items_divide_every_value() -> None:
    """Counts of 3 items from 0 to 1: values 0, 1/3, 2/3, 1 of four participants."""
    expected = {
        (Fraction(sum(v), 12), statistics.variance([Fraction(x, 3) for x in v]))
        for v in combinations_with_replacement(range(4), 4)
    }
    found = {
        (Fraction(one.mean.low), Fraction(one.variance.low))
        for total in range(13)
        for one in moments(total, 4, Scale(3), ENDLESS)
    }
    assert found == expected


@settings(deadline=None)
@given(st.lists(st.integers(-9, 9), min_size=2, max_size=9), st.integers(1, 4), st.booleans())
def test_true_moments_are_always_found(values: list[int], items: int, ended: bool) -> None:
    """The invariant: whatever the data, their own mean and variance are among those that counts allow."""
    exact = [Fraction(value, items) for value in values]
    scale = Scale(items, -9, 9) if ended else Scale(items, None, None)
    variance = statistics.variance(exact)
    around = Interval(max(variance - 1, Fraction(0)), variance + 1)
    found = list(moments(sum(values), len(values), scale, around))
    own = [one for one in found if one.variance.holds(variance)]
    assert len(own) == 1
    assert own[0].mean.holds(statistics.mean(exact))
    assert (own[0].total, own[0].squares) == (sum(values), sum(value**2 for value in values))


def test_large_samples_ask_parity_and_bounds_alone() -> None:
    """Over half a million steps are not taken, and the variance of half zeros and half ones is still found."""
    half = next(iter(moments(50_000, 1_000, Scale(100), Interval(Fraction(250, 999), Fraction(250, 999)))), None)
    assert half is not None
    assert half.squares == 500 * 100**2


def test_a_sum_beyond_the_scale_has_no_moments() -> None:
    assert list(moments(41, 4, Scale(10), ENDLESS)) == []
    assert list(moments(3, 1, Scale(10), ENDLESS)) == []
    assert [one.variance for one in moments(40, 4, Scale(10), ENDLESS)] == [Interval(Fraction(0), Fraction(0))]


def test_neighbours_of_an_impossible_mean() -> None:
    assert list(neighbours(Fraction("5.19"), 28, OPEN)) == [145, 146]
    assert list(neighbours(Fraction("0.5"), 28, OPEN)) == [14]
    assert list(neighbours(Fraction("1.2"), 5, Scale(10))) == [50]
    assert list(neighbours(Fraction("0.8"), 5, Scale(1, 1, 7))) == [5]


def test_sums_beyond_the_scale_are_left_out() -> None:
    assert list(on_scale(range(-3, 9), 2, Scale(3))) == list(range(7))
    assert list(on_scale(range(3, 9), 2, OPEN)) == list(range(3, 9))


def test_moments_without_steps_have_no_counts() -> None:
    box = Moments(5, Interval(Fraction(0), Fraction(1)), ENDLESS)
    assert (box.total, box.squares) == (None, None)
