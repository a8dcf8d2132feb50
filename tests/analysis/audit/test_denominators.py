"""Denominators of percentages: trying every count, and shares that were printed."""

from __future__ import annotations

from decimal import ROUND_DOWN, ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.audit.print_lines import READINGS, common, counts, smallest
from palpate.analysis.published.printed import Printed

WAYS = {"rounded": (ROUND_HALF_UP, ROUND_HALF_EVEN, "ROUND_HALF_DOWN"), "truncated": (ROUND_DOWN,)}
"""How the decimal library rounds, beside each reading."""


def _percent(share: Fraction, way: str) -> int:
    return int((Decimal(100 * share.numerator) / Decimal(share.denominator)).quantize(Decimal(1), rounding=way))


@settings(deadline=None)
@given(st.integers(0, 100), st.integers(1, 64), st.sampled_from(sorted(WAYS)))
def test_counts_are_those_that_print_so(percent: int, trials: int, reading: str) -> None:
    expected = [
        count
        for count in range(trials + 1)
        if percent in {_percent(Fraction(count, trials), way) for way in WAYS[reading]}
    ]
    assert list(counts(Printed(f"{percent}%"), trials, READINGS[reading])) == expected


@settings(deadline=None)
@given(st.integers(1, 60), st.data())
def test_the_true_number_of_trials_is_always_among_them(trials: int, data: st.DataObject) -> None:
    shares = data.draw(st.lists(st.integers(0, trials), min_size=1, max_size=8))
    printed = [Printed(f"{_percent(Fraction(count, trials), ROUND_HALF_EVEN)}%") for count in shares]
    rounded = READINGS["rounded"]
    assert trials in set(common(printed, rounded))
    assert set(common(printed, rounded)) <= set(common(printed, READINGS["either"]))
    assert all(smallest(one, rounded) <= trials for one in printed)


@pytest.mark.parametrize(("text", "expected"), [("50%", 2), ("33%", 3), ("100%", 1), ("0%", 1), ("51%", 35)])
def test_the_fewest_trials(text: str, expected: int) -> None:
    """By hand: 18/35 = 51.4 % is the first share that rounds to 51 %."""
    assert smallest(Printed(text), READINGS["rounded"]) == expected
