"""The power law against R."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.psychophysics.magnitude import power_law

MAGNITUDES = np.array([1.0, 1, 2, 2, 4, 4, 8, 8])
RATINGS = np.array([2.0, 3, 3, 5, 6, 7, 8, 12])

R = (0.674271341359, 0.390506530661, 0.998398216995)
"""R 4.2.2: g <- tapply(log10(ratings), magnitudes, mean); m <- lm(g ~ log10(c(1, 2, 4, 8))); coef(m)[2:1] and
summary(m)$r.squared."""


def test_it_is_what_r_fits_to_geometric_means() -> None:
    found = power_law(MAGNITUDES, RATINGS)
    assert (found.exponent, found.constant) == pytest.approx(R[:2], abs=1e-8)
    assert found.r_squared == pytest.approx(R[2], abs=1e-8)


def test_numbers_that_the_constant_alone_can_hold_do_not_move_the_exponent() -> None:
    once, twice = power_law(MAGNITUDES, RATINGS), power_law(MAGNITUDES, 2 * RATINGS)
    assert twice.exponent == pytest.approx(once.exponent)
    assert twice.constant - once.constant == pytest.approx(np.log10(2))


@pytest.mark.parametrize(("magnitudes", "ratings"), [((1.0, 1.0), (2.0, 3.0)), ((1.0, 2.0), (0.0, 3.0))])
def test_without_two_magnitudes_or_a_rating_above_0_there_is_none(
    magnitudes: tuple[float, ...], ratings: tuple[float, ...]
) -> None:
    with pytest.raises(NotDefined):
        power_law(np.array(magnitudes), np.array(ratings))
