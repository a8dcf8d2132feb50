"""The best crossover, against R, and where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit, stdtrit

from palpate.analysis.designs.comparison.crossover import Crossed, crossed
from palpate.analysis.statistics import scaling
from palpate.analysis.statistics.exact import Floats
from palpate.analysis.statistics.scaling import FIRST, SECOND, Comparisons
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.tapping import Tapping

CROSSOVERS = np.array([10.0, 20.0, 40.0, 80.0, 160.0])
MATERIALS = tuple(map(str, range(5)))
NUMBERS = {one: {"crossover_hz": of} for one, of in zip(MATERIALS, CROSSOVERS.tolist(), strict=True)}


def simulated(bend: float = 0.3) -> Comparisons:
    """Each ordered pair three times by six SIMULATED participants, for whom about 30 Hz is best."""
    rng, rows = np.random.default_rng(5), []
    scale = -bend * (np.log2(CROSSOVERS / 30.0)) ** 2
    for person in range(6):
        for i in np.repeat(np.arange(5), 3):
            for j in range(5):
                share = expit(scale[i] - scale[j] + 0.1 + rng.normal(0, 0.3))
                rows.append((i, j, FIRST if rng.random() < share else SECOND, person))
    first, second, chosen, persons = np.array(rows).T
    return Comparisons(first, second, chosen, persons, items=5)


BEND, BEND_SE = 0.34856933878691, 0.05111697203974
BEST_HZ = (29.97812280386, 22.59376499696, 34.90184706572)
EFFECTS = (
    (0.7346376510347, 0.2635754003689),
    (0.7346376510347, 0.3125677582007),
    (0.2507093514451, 0.2459688546980),
    (-1.2267170821939, 0.3058176106419),
)
P = 0.7562678884112
"""R 4.2.2: glm(chosen ~ x + x2, binomial) of differences in log2(Hz / 40) and its square, and of dummies of crossovers;
errors by solve(I) %*% crossprod(rowsum(X * (y - fitted), person)) * 6 / 5 %*% solve(I); the ends by uniroot of (b + 2 c
x)^2 - qt(.975, 5)^2 (V11 + 4 x V12 + 4 x^2 V22); P by pchisq of twice the difference of logLik, on 2. Data as
`simulated` draws them, written by numpy."""


def found(data: Comparisons) -> Crossed:
    one = crossed(data, MATERIALS, NUMBERS)
    assert one is not None
    return one


def test_the_top_of_the_parabola_and_its_interval_are_rs() -> None:
    one = found(simulated())
    assert one.bend is not None
    assert (one.bend.value, one.bend.se) == pytest.approx((BEND, BEND_SE), rel=1e-7)
    assert (one.best_hz, one.best_low_hz, one.best_high_hz) == pytest.approx(BEST_HZ, rel=1e-7)
    assert one.p == pytest.approx(P, rel=1e-6)
    assert one.crossovers_hz == tuple(CROSSOVERS.tolist())
    assert [(of.value, of.se) for of in one.effects[1:]] == [pytest.approx(of, rel=1e-6) for of in EFFECTS]


def test_a_top_that_is_outside_or_may_be_none_is_not_stated() -> None:
    bottom = found(simulated(bend=-0.3))
    assert (bottom.best_hz, bottom.best_low_hz) == (None, None)
    data = simulated()
    drawn = np.where(np.random.default_rng(3).random(len(data.first)) < 0.5, FIRST, SECOND)
    unsure = found(Comparisons(data.first, data.second, drawn, data.person, items=5))
    assert unsure.best_low_hz is None


def test_crossovers_that_are_missing_or_too_few_have_no_best() -> None:
    assert crossed(simulated(), MATERIALS, {**NUMBERS, "3": {"delay_ms": 5.0}}) is None
    assert crossed(simulated(), MATERIALS, {one: {"crossover_hz": 5.0 + int(one) % 2} for one in MATERIALS}) is None


def test_a_blank_is_left_out_and_a_task_of_four_of_five_has_a_best() -> None:
    data = simulated()
    kept = (data.first < 4) & (data.second < 4)
    four = Comparisons(data.first[kept], data.second[kept], data.chosen[kept], data.person[kept], items=5)
    one = found(four)
    assert one.crossovers_hz == tuple(CROSSOVERS.tolist()[:4])
    assert one.bend is not None
    blank = crossed(data, MATERIALS, {**NUMBERS, "4": {}})
    assert repr(blank) == repr(one)


def choosing(scale: int) -> Comparisons:
    """Of four participants in either order: 2 of 3 times higher over lower, 4 of 5 over the lowest, a straight line."""
    rows = [
        (*pair, FIRST if (k < wins * scale) == (pair[0] > pair[1]) else SECOND, person)
        for person in range(4)
        for (low, high), (wins, of) in {(0, 1): (2, 3), (1, 2): (2, 3), (0, 2): (4, 5)}.items()
        for k in range(of * scale)
        for pair in ((low, high), (high, low))
    ]
    first, second, chosen, persons = np.array(rows).T
    return Comparisons(first, second, chosen, persons, items=3)


@pytest.mark.parametrize("scale", [1, 2, 3, 5])
@pytest.mark.parametrize("hz", [(10.0, 20.0, 40.0), (20.0, 40.0, 80.0), (10.0, 40.0, 160.0), (5.0, 50.0, 500.0)])
def test_a_straight_scale_has_no_best(hz: tuple[float, ...], scale: int) -> None:
    numbers = {one: {"crossover_hz": of} for one, of in zip("abc", hz, strict=True)}
    one = crossed(choosing(scale), "abc", numbers)
    assert one is not None
    assert one.bend is not None
    assert abs(one.bend.value) < 1e-12
    assert (one.best_hz, one.best_low_hz, one.best_high_hz) == (None, None, None)


def test_an_end_that_no_number_of_hz_reaches_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_terms = scaling.fit_terms

    def hardly_bent(data: Comparisons, terms: Floats) -> scaling.Terms:
        fitted = fit_terms(data, terms)
        if terms.shape[1] == 2:
            fitted.covariance[1, 1] = (fitted.values[1] / stdtrit(5, 0.975)) ** 2 * (1 - 1e-5)
        return fitted

    monkeypatch.setattr(scaling, "fit_terms", hardly_bent)
    one = found(simulated())
    ends = one.best_low_hz, one.best_high_hz
    assert one.best_hz == pytest.approx(BEST_HZ[0])
    assert ends.count(None) == 1


def test_the_shipped_study_varies_the_crossover_alone() -> None:
    file = shipped("crossover.toml")
    assert len(file.read_text("utf-8").splitlines()) <= 150
    virtual = files.load(file).table(Tapping)
    assert virtual.crossovers_hz == tuple(CROSSOVERS.tolist())
    assert len({(one.attack_hz, one.amplitude, one.delay_ms) for one in virtual.surfaces}) == 1
