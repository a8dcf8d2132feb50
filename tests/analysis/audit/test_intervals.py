"""Intervals: what they hold, checked against grids, and what a printed number can stand for."""

from __future__ import annotations

import math
from decimal import ROUND_DOWN, ROUND_HALF_DOWN, ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from fractions import Fraction
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.audit.intervals import (
    Interval,
    as_printed,
    either,
    hull,
    image,
    outward,
    point,
    rounded,
    sum_of,
    truncated,
)
from palpate.analysis.audit.mistakes import judge, shown
from palpate.analysis.published.printed import Printed

ENDS = st.integers(-18, 18).map(lambda sixths: Fraction(sixths, 6))
GRID = [Fraction(k, 12) for k in range(-48, 49)]


@st.composite
def spans(draw: st.DrawFn) -> Interval:
    low, high = sorted((draw(ENDS), draw(ENDS)))
    if low == high:
        return point(low)
    return Interval(low, high, draw(st.booleans()), draw(st.booleans()))


@settings(deadline=None)
@given(spans(), spans())
def test_intervals_meet_where_a_fine_grid_has_a_number_of_both(a: Interval, b: Interval) -> None:
    """Ends are sixths, so a common stretch holds a twelfth."""
    both = [value for value in GRID if a.holds(value) and b.holds(value)]
    assert a.meets(b) == b.meets(a) == bool(both)
    if both:
        assert [value for value in GRID if a.common(b).holds(value)] == both


@settings(deadline=None)
@given(spans(), spans(), st.fractions(-2, 2, max_denominator=4).filter(bool))
def test_arithmetic_holds_what_its_numbers_give(a: Interval, b: Interval, factor: Fraction) -> None:
    inside = [[value for value in GRID if one.holds(value)] for one in (a, b)]
    assert all(a.plus(b).holds(p + q) for p, q in product(*inside))
    assert all(a.times(factor).holds(p * factor) for p in inside[0])
    assert all(a.absolute().holds(abs(p)) for p in inside[0])
    if a.high > 0:
        assert all(a.squared().holds(p * p) for p in inside[0] if p >= 0)
    assert all(hull((a, b)).holds(p) for p in inside[0] + inside[1])


@settings(deadline=None)
@given(
    st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-300),
    st.floats(0, 10).filter(lambda x: x == 0 or x > 1e-300),
)
def test_images_hold_the_true_value(low: float, width: float) -> None:
    found = image(lambda x: -x / 3, Interval(Fraction(low), Fraction(low) + Fraction(width)))
    assert found.holds(-Fraction(low) / 3)
    assert found.holds(-(Fraction(low) + Fraction(width)) / 3)


@settings(deadline=None)
@given(spans())
def test_whole_numbers_are_found_from_end_to_end(span: Interval) -> None:
    low, high = span.whole()
    assert [k for k in range(-4, 5) if span.holds(Fraction(k))] == list(range(int(low), int(high) + 1))


def test_sums_of_printed_numbers_are_intervals() -> None:
    found = sum_of([either(Printed("0.3")), either(Printed("0.7"))])
    assert (found.low, found.high, found.open_high) == (Fraction("0.9"), Fraction("1.2"), True)


def test_infinite_ends_stay() -> None:
    everything = Interval(-math.inf, math.inf)
    assert outward(-math.inf, math.inf) == everything
    assert everything.whole() == (-math.inf, math.inf)


VALUES = st.decimals("-20", "20", places=6)
ROUNDINGS = (ROUND_HALF_UP, ROUND_HALF_EVEN, ROUND_HALF_DOWN)


@settings(deadline=None)
@given(VALUES, st.integers(1, 4), st.sampled_from(ROUNDINGS))
def test_a_rounded_number_can_stand_for_its_value(value: Decimal, digits: int, rounding: str) -> None:
    """Rounded by the decimal library, in each of the ways that software uses."""
    text = f"{value.quantize(Decimal(1).scaleb(-digits), rounding=rounding):f}"
    assert rounded(Printed(text)).holds(Fraction(value))
    assert either(Printed(text)).holds(Fraction(value))


@settings(deadline=None)
@given(VALUES, st.integers(1, 4))
def test_a_truncated_number_can_stand_for_its_value(value: Decimal, digits: int) -> None:
    text = f"{value.quantize(Decimal(1).scaleb(-digits), rounding=ROUND_DOWN):f}"
    assert truncated(Printed(text)).holds(Fraction(value))
    assert either(Printed(text)).holds(Fraction(value))


@settings(deadline=None)
@given(VALUES, st.integers(1, 3), VALUES)
def test_a_printed_number_stands_for_nothing_that_prints_otherwise(
    printed: Decimal, digits: int, value: Decimal
) -> None:
    unit = Decimal(1).scaleb(-digits)
    text = f"{printed.quantize(unit):f}"
    ways = {value.quantize(unit, rounding=way) for way in ROUNDINGS}
    assert rounded(Printed(text)).holds(Fraction(value)) == (Decimal(text) in ways)
    cut = value.quantize(unit, rounding=ROUND_DOWN) == Decimal(text)
    assert truncated(Printed(text)).holds(Fraction(value)) == cut


@settings(deadline=None)
@given(st.floats(1e-12, 1))
def test_p_can_stand_for_what_it_was_printed_from(p: float) -> None:
    assert rounded(Printed(f"{p:.2e}")).meets(outward(p, p))


@pytest.mark.parametrize(
    ("text", "inside", "outside"),
    [
        ("0", [0], ["0.001", "-0.001"]),
        ("<0.001", ["0", "0.0009"], ["0.001", "0.0011"]),
        ("0.00", ["0.0099", "-0.0099"], ["0.01", "-0.01"]),
        ("15%", ["0.145", "0.1599"], ["0.1449", "0.16"]),
    ],
)
def test_bounds_percentages_and_nothing(text: str, inside: list[str], outside: list[str]) -> None:
    found = either(Printed(text))
    assert all(found.holds(Fraction(value)) for value in inside)
    assert not any(found.holds(Fraction(value)) for value in outside)


@pytest.mark.parametrize(
    ("text", "value", "expected"),
    [
        ("0.048", "0.0488", "agrees if truncated"),
        ("0.049", "0.0481", "differs"),
        ("0.048", "0.0491", "differs"),
        ("0.21", "0.22", "differs"),
        ("0.21", "0.215", "agrees"),
        ("0", "0", "agrees"),
        ("15%", "0.15", "agrees"),
    ],
)
def test_verdicts(text: str, value: str, expected: str) -> None:
    exact = Fraction(value)
    assert judge(Printed(text), [point(exact)])[0] == expected
    assert judge(Printed(text), [point(exact**2)], squares=True)[0] == expected


def test_the_values_that_fit_are_shown_and_all_where_none_does() -> None:
    values = [point(Fraction(k, 100)) for k in (19, 20, 25)]
    assert judge(Printed("0.2"), values) == ("agrees", tuple(values))
    assert judge(Printed("0.20"), values) == ("agrees", (values[1],))
    assert judge(Printed("0.9"), values) == ("differs", tuple(values))
    assert shown(Printed("0.90"), values)[0] == "0.19 to 0.25"


@pytest.mark.parametrize(
    ("text", "value", "as_text"),
    [("0.047", 0.04667, "0.047"), ("5.02e-7", 5.0245e-7, "5.02e-7"), ("15%", 0.15, "15%"), ("0", 0.0, "0")],
)
def test_recomputed_numbers_are_shown_as_they_are_printed(text: str, value: float, as_text: str) -> None:
    assert as_printed(Printed(text), value) == as_text
