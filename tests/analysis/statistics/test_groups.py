"""The difference of two groups: ways as R counts them, drawn ways, many studies at once, and what is not defined."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.groups import compared, difference, difference_tests


def test_ways_are_those_of_r() -> None:
    """Over combn of R 4.2.2, by Welch's t."""
    found = difference([5, 5, 5], [9, 4, 8, 2], np.random.default_rng(1))
    assert (found.n, found.value) == (7, -0.75)
    assert (found.p, found.least) == pytest.approx((25 / 35, 1 / 35))


def test_drawn_ways_have_the_p_of_all_within_their_error(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(2)
    one, other = random.integers(0, 10, 8).tolist(), random.integers(3, 13, 8).tolist()
    exact = difference(one, other, random)
    monkeypatch.setattr("palpate.analysis.statistics.groups.DRAWS", 9_999)
    drawn = difference(one, other, random)
    assert exact.error is None
    assert drawn.error is not None
    assert drawn.p == pytest.approx(exact.p, abs=4 * drawn.error)
    assert exact.least == pytest.approx(2 / 12870)


@pytest.mark.parametrize(
    ("one", "other", "loose"),
    [([0, 5, 9], [4, 5, 4, 5], True), ([4, 5, 4, 5], [0, 5, 9], True), ([4, 5, 5], [0, 9, 1, 8], False),
     ([0, 5, 9], [4, 5, 5], False)],
)  # fmt: skip
def test_a_smaller_group_that_varies_more_is_marked(one: list[int], other: list[int], loose: bool) -> None:
    """In the table of errors of planned tests such groups of equal means differ too often."""
    assert difference(one, other, np.random.default_rng(1)).loose is loose


def test_a_smaller_group_that_varies_more_has_no_less_p_than_on_its_own_df() -> None:
    """0, 4, 8 beside 8, 9, 9, 9, 9, 10: t is 5 / sqrt(16/3 + 0.4/6) = 2.152, and the two-sided P of t on 2 df is
    1 - t / sqrt(t^2 + 2); of all 84 ways 2 have such a t."""
    one, other = [0, 4, 8], [8, 9, 9, 9, 9, 10]
    t = 5 / (16 / 3 + 0.4 / 6) ** 0.5
    for pair in ((one, other), (other, one)):
        found = difference(*pair, np.random.default_rng(1))
        assert found.loose
        assert found.p == pytest.approx(1 - t / (t * t + 2) ** 0.5)
        (many,) = difference_tests(np.array([pair[0]]) / 10, np.array([pair[1]]) / 10)
        assert many == pytest.approx(found.p)


def test_many_studies_have_the_p_of_each() -> None:
    values = np.random.default_rng(3).integers(0, 5, (40, 9)) / 4
    values[0] = 0.5
    found = difference_tests(values[:, :4], values[:, 4:])
    assert np.isnan(found[0])
    each = [difference(one[:4].tolist(), one[4:].tolist(), np.random.default_rng(1)).p for one in values[1:]]
    assert found[1:] == pytest.approx(each, abs=1e-12)


def test_groups_without_spread_differ_without_end() -> None:
    assert difference([1, 1, 1], [0, 0, 0], np.random.default_rng(1)).p == pytest.approx(2 / 20)


@pytest.mark.parametrize(("one", "other"), [([1], [2, 3]), ([], [1, 2]), ([1, 1], [1, 1])])
def test_what_is_not_defined(one: list[int], other: list[int]) -> None:
    with pytest.raises(NotDefined):
        difference(one, other, np.random.default_rng(1))


def test_the_limits_of_two_shares_are_squared_and_added() -> None:
    """Never less than by Clopper and Pearson: 0.8 in 0.5634 to 0.9427, 0.2 in 0.0573 to 0.4366 (twenty trials)."""
    right, trials = np.array([[9, 7, 1, 3]]), np.full((1, 4), 10)
    members = ([True, True, False, False], [False, False, True, True])
    found = compared(right, trials, members, np.random.default_rng(1))
    assert found.value == pytest.approx(0.6)
    assert found.interval is not None
    assert found.interval.low is not None
    assert found.interval.low <= 0.6 - ((0.8 - 0.5634) ** 2 + (0.4366 - 0.2) ** 2) ** 0.5 + 1e-4
    assert found.interval.high is not None
    assert found.interval.high >= 0.6 + ((0.9427 - 0.8) ** 2 + (0.2 - 0.0573) ** 2) ** 0.5 - 1e-4
