"""Scales by the delay of a vibration, against R, and where there are none."""

from __future__ import annotations

from math import log

import numpy as np
import pytest
from scipy.special import expit

from palpate.analysis.designs.comparison.delays import Delayed, delayed
from palpate.analysis.statistics.scaling import FIRST, SECOND, Comparisons
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.tapping import Tapping

DELAYS = np.array([-20.0, -10.0, 0.0, 10.0, 20.0, 35.0, 50.0])
MATERIALS = tuple(map(str, range(7)))
NUMBERS = {one: {"delay_ms": of} for one, of in zip(MATERIALS, DELAYS.tolist(), strict=True)}


def simulated() -> Comparisons:
    """Each ordered pair three times by six SIMULATED participants: 0.2 a step earlier, -0.5 a step later."""
    rng, rows = np.random.default_rng(5), []
    scale = 0.2 * np.maximum(-DELAYS, 0.0) / 10 - 0.5 * np.maximum(DELAYS, 0.0) / 10
    for person in range(6):
        for i in np.repeat(np.arange(7), 3):
            for j in range(7):
                share = expit(scale[i] - scale[j] + 0.1 + rng.normal(0, 0.3))
                rows.append((i, j, FIRST if rng.random() < share else SECOND, person))
    first, second, chosen, persons = np.array(rows).T
    return Comparisons(first, second, chosen, persons, items=7)


SLOPES = ((True, 0.2497493341871, 0.0606958896663), (False, -0.4877651083400, 0.0491927580805))
EFFECTS = (
    (0.5208118917784, 0.1638438135029),
    (0.0617172359739, 0.1306341701029),
    (-0.5941492351497, 0.2345453045595),
    (-0.9282383403956, 0.2044982739903),
    (-1.7804583569973, 0.2081496374747),
    (-2.5267048195057, 0.1656069352599),
)
P, T = 0.745405823109, 2.57058183564
"""R 4.2.2: glm(chosen ~ early + late, binomial) of differences, and of dummies of delays; errors by solve(I) %*%
crossprod(rowsum(X * (y - fitted), person)) * 6 / 5 %*% solve(I); P by pchisq of twice the difference of logLik, on 4;
t by qt(.975, 5). Data as `simulated` draws them, written by numpy."""


@pytest.fixture(scope="module")
def found() -> Delayed:
    found = delayed(simulated(), MATERIALS, NUMBERS)
    assert found is not None
    return found


def test_slopes_on_either_side_of_the_touch_are_rs(found: Delayed) -> None:
    for side, (early, slope, error) in zip(found.sides, SLOPES, strict=True):
        assert side.early == early
        assert (side.slope.value, side.slope.se) == pytest.approx((slope, error), rel=1e-7)
        assert side.noticed_ms == pytest.approx(10 * log(3) / abs(slope), rel=1e-7)
        limits = (10 * log(3) / (abs(slope) + sign * T * error) for sign in (1, -1))
        assert (side.noticed_low_ms, side.noticed_high_ms) == pytest.approx(tuple(limits), rel=1e-7)
    assert found.p == pytest.approx(P, rel=1e-6)


def test_each_delay_is_beside_the_touch(found: Delayed) -> None:
    assert found.delays_ms == tuple(DELAYS.tolist())
    beside = [(one.value, one.se) for one in found.effects if one.se is not None]
    assert beside == [pytest.approx(one, rel=1e-7) for one in EFFECTS]
    assert found.effects[2].value == 0


def test_a_slope_that_may_be_nothing_has_no_delay_that_is_surely_noticed() -> None:
    data = simulated()
    drawn = np.where(np.random.default_rng(1).random(len(data.first)) < 0.5, FIRST, SECOND)
    found = delayed(Comparisons(data.first, data.second, drawn, data.person, items=7), MATERIALS, NUMBERS)
    assert found is not None
    assert [side.noticed_high_ms for side in found.sides] == [None, None]


def test_delays_that_are_missing_or_all_the_same_add_nothing() -> None:
    assert delayed(simulated(), MATERIALS, {}) is None
    assert delayed(simulated(), MATERIALS, {**NUMBERS, "3": {"crossover_hz": 5.0}}) is None
    assert delayed(simulated(), MATERIALS, {one: {"delay_ms": 5.0} for one in MATERIALS}) is None


def test_a_blank_is_left_out_and_a_task_of_six_of_seven_has_slopes() -> None:
    data = simulated()
    kept = (data.first < 6) & (data.second < 6)
    six = Comparisons(data.first[kept], data.second[kept], data.chosen[kept], data.person[kept], items=7)
    found = delayed(six, MATERIALS, NUMBERS)
    assert found is not None
    assert found.delays_ms == tuple(DELAYS.tolist()[:6])
    assert [side.early for side in found.sides] == [True, False]
    assert repr(delayed(data, MATERIALS, {**NUMBERS, "6": {}})) == repr(found)


@pytest.mark.parametrize("name", ["timing.toml", "late.toml"])
def test_the_shipped_studies_vary_the_delay_alone(name: str) -> None:
    file = shipped(name)
    assert len(file.read_text("utf-8").splitlines()) <= 150
    virtual = files.load(file).table(Tapping)
    assert sorted(one.delay_ms for one in virtual.surfaces if one.delay_ms is not None) == DELAYS.tolist()
    assert len({(one.attack_hz, one.amplitude) for one in virtual.surfaces}) == 1
