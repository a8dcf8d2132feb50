"""d' against R's psyphy 0.2.3 and printed tables."""

from __future__ import annotations

import pytest

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.psychophysics.sensitivity import Rule, d_prime, sensitivity


@pytest.mark.parametrize(
    ("rule", "hit", "alarm", "d"),
    [
        # R 4.2.2 with psyphy 0.2.3: dprime.SD(H, FA), and with method = "IO"; dprime.mAFC(0.8, 2).
        ("same or different, differences", 0.642, 0.3, 1.95060466974),
        ("same or different, independent", 0.642, 0.3, 1.6326670191),
        ("same or different, differences", 0.8, 0.2, 3.00095879406),
        ("same or different, independent", 0.8, 0.2, 2.42456985877),
        ("two intervals", 0.8, 0.2, 1.19020648805),
        ("yes or no", 0.8, 0.2, 1.19020648805 * 2**0.5),
    ],
)
def test_it_is_that_of_another_implementation(rule: Rule, hit: float, alarm: float, d: float) -> None:
    assert d_prime(hit, alarm, rule) == pytest.approx(d, abs=2e-4)


def test_shares_of_0_and_1_are_those_of_one_trial_more() -> None:
    """Hautus (1995): (20 + 0.5) / 21 hits and 0.5 / 21 false alarms; z by R's qnorm."""
    found = sensitivity(20, 20, 0, 20, "yes or no")
    assert [found.d, found.criterion] == pytest.approx([2 * 1.98075239665, 0.0], abs=1e-9)


def test_its_error_is_that_of_gourevitch_and_galanter() -> None:
    """R 4.2.2: sqrt(H * (1 - H) / (99 * dnorm(qnorm(H))^2) + ...), with H = 0.755 and F = 0.245."""
    found = sensitivity(75, 99, 24, 99, "yes or no")
    assert found.se == pytest.approx(0.194455494051, abs=1e-9)
    assert sensitivity(75, 99, 24, 99, "two intervals").se == pytest.approx((found.se or 0) / 2**0.5)


def test_without_trials_of_both_kinds_there_is_none() -> None:
    with pytest.raises(NotDefined):
        sensitivity(3, 5, 0, 0, "yes or no")
    rules: tuple[Rule, ...] = ("same or different, differences", "same or different, independent")
    assert d_prime(0.4, 0.4, rules[0]) == 0.0
    assert d_prime(0.3, 0.5, rules[1]) < 0.0
