"""Scales by the factors of stimuli, against R, and where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from palpate.analysis.designs.comparison.factors import Factored, factored
from palpate.analysis.statistics.scaling import FIRST, SECOND, TIE, Comparisons
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.presented import Presented

AMPLITUDES, FREQUENCIES = np.tile([2.0, 4.0, 8.0], 3), np.repeat([60.0, 120.0, 240.0], 3)
MATERIALS = tuple(map(str, range(9)))
NUMBERS = {
    one: {"amplitude_m_s2": a, "frequency_hz": f, "decay_per_s": 100.0}
    for one, a, f in zip(MATERIALS, AMPLITUDES, FREQUENCIES, strict=True)
}


def simulated() -> Comparisons:
    """Each ordered pair once by six SIMULATED participants, drawn as R's data were for `SLOPES`."""
    rng, rows = np.random.default_rng(7), []
    scale = 0.8 * np.log2(AMPLITUDES) + 0.4 * np.log2(FREQUENCIES)
    for person in range(6):
        for i in range(9):
            for j in range(9):
                share = expit(scale[i] - scale[j] + 0.2 + rng.normal(0, 0.3))
                rows.append((i, j, FIRST if rng.random() < share else SECOND, person))
    first, second, chosen, persons = np.array(rows).T
    return Comparisons(first, second, chosen, persons, items=9)


SLOPES = ((0.634286431384, 0.0644720023789), (0.312625462895, 0.0821338417753))
APART = (0.321660968488, 0.127113106197)
EFFECTS = (
    ((0.407901343886, 0.167510211298), (1.283397284036, 0.126298505368)),
    ((0.574615266039, 0.0997428388), (0.632059148183, 0.167930032403)),
)
P, T = 0.124270094242, 2.57058183564
"""R 4.2.2: glm(chosen ~ a + f, binomial) of differences of log2, and of dummies of levels; errors by
solve(I) %*% crossprod(rowsum(X * (y - fitted), person)) * 6 / 5 %*% solve(I); P by pchisq of twice the difference of
logLik to a glm of eight items, on 4; t by qt(.975, 5). Data as `simulated` draws them, written by numpy."""


@pytest.fixture(scope="module")
def found() -> Factored:
    found = factored(simulated(), MATERIALS, NUMBERS)
    assert found is not None
    return found


def test_slopes_and_main_effects_are_rs(found: Factored) -> None:
    assert [one.name for one in found.factors] == ["amplitude_m_s2", "frequency_hz"]
    for one, slope, effects in zip(found.factors, SLOPES, EFFECTS, strict=True):
        assert one.doubling is not None
        assert (one.doubling.value, one.doubling.se) == pytest.approx(slope, rel=1e-7)
        # Two doublings from the lowest level to the highest.
        assert (one.across.value, one.across.se) == pytest.approx([2 * of for of in slope], rel=1e-7)
        assert [(of.value, of.se) for of in one.effects[1:]] == [pytest.approx(of, rel=1e-7) for of in effects]
        assert one.effects[0].value == 0


def test_the_first_beyond_the_second_is_rs(found: Factored) -> None:
    assert found.apart is not None
    assert (found.apart.value, found.apart.se) == pytest.approx(APART, rel=1e-7)
    assert found.apart.low == pytest.approx(APART[0] - T * APART[1], rel=1e-7)
    assert found.p == pytest.approx(P, rel=1e-6)


def test_one_number_that_varies_or_another_wave_has_no_factors() -> None:
    same = {one: {**of, "amplitude_m_s2": 2.0} for one, of in NUMBERS.items()}
    assert factored(simulated(), MATERIALS, same) is None
    assert factored(simulated(), MATERIALS, {**NUMBERS, "3": {"frequency_hz": 60.0}}) is None
    assert factored(simulated(), MATERIALS, {}) is None


def test_factors_that_go_together_cannot_be_separated() -> None:
    both = {one: {"amplitude_m_s2": a, "frequency_hz": 30 * a} for one, a in zip(MATERIALS, AMPLITUDES, strict=True)}
    found = factored(simulated(), MATERIALS, both)
    assert found is not None
    assert found.factors == ()
    assert found.statement


def test_a_task_of_some_materials_and_one_without_numbers_has_factors() -> None:
    data, some = simulated(), [0, 2, 6, 8, 3]
    # A blank is a material of the task, without numbers.
    kept = np.isin(data.first, some) & np.isin(data.second, some)
    part = replace(data, **{key: getattr(data, key)[kept] for key in ("first", "second", "chosen", "person")})
    found = factored(part, MATERIALS, {one: of for one, of in NUMBERS.items() if one != "3"})
    assert found is not None
    assert [(one.name, one.levels) for one in found.factors] == [
        ("amplitude_m_s2", (2.0, 8.0)),
        ("frequency_hz", (60.0, 240.0)),
    ]
    none = factored(
        replace(part, **{key: getattr(part, key)[:0] for key in ("first", "second", "chosen", "person")}),
        MATERIALS,
        NUMBERS,
    )
    assert none is None


def test_ties_have_no_such_scale() -> None:
    data = simulated()
    tied = replace(data, chosen=np.where(np.arange(len(data.chosen)) == 0, TIE, data.chosen))
    found = factored(tied, MATERIALS, NUMBERS)
    assert found is not None
    assert found.factors == ()


def test_choices_that_never_vary_have_a_reduced_scale() -> None:
    data = simulated()
    always = replace(data, chosen=np.where(AMPLITUDES[data.first] >= AMPLITUDES[data.second], FIRST, SECOND))
    found = factored(always, MATERIALS, NUMBERS)
    assert found is not None
    assert (found.reduced, found.p) == (True, None)


FROM_ZERO = ((0.62935829850554, 0.064950511078597), (0.51709361567249, 0.162583617141645))
"""R 4.2.2, as above, of chosen ~ a + x, x the delay by its range, 70."""


def test_a_factor_without_doublings_has_a_line_of_its_own_which_is_rs() -> None:
    delays = np.repeat([-20.0, 0.0, 50.0], 3)
    numbers = {one: {"amplitude": a, "delay": ms} for one, a, ms in zip(MATERIALS, AMPLITUDES, delays, strict=True)}
    found = factored(simulated(), MATERIALS, numbers)
    assert found is not None
    amplitude, delay = found.factors
    assert amplitude.doubling is not None
    assert (amplitude.doubling.value, amplitude.doubling.se) == pytest.approx(FROM_ZERO[0], rel=1e-7)
    assert (delay.doubling, found.apart) == (None, None)
    assert (delay.across.value, delay.across.se) == pytest.approx(FROM_ZERO[1], rel=1e-7)
    assert [one.value for one in delay.effects] == pytest.approx([0, *(of for of, _ in EFFECTS[1])], rel=1e-7)


def test_one_factor_that_is_planned_suffices() -> None:
    alone = {one: {"amplitude": a} for one, a in zip(MATERIALS, AMPLITUDES, strict=True)}
    assert factored(simulated(), MATERIALS, alone) is None
    found = factored(simulated(), MATERIALS, alone, 1)
    assert found is not None
    assert [one.levels for one in found.factors] == [(2.0, 4.0, 8.0)]


def test_the_shipped_study_varies_amplitude_apart_from_frequency() -> None:
    file = shipped("harder.toml")
    protocol = files.load(file)
    assert len(file.read_text("utf-8").splitlines()) <= 150
    numbers = protocol.table(Presented).numbers
    pairs = {(of["amplitude_m_s2"], of["frequency_hz"]) for of in numbers.values()}
    assert len(pairs) == len(protocol.materials) == 9
    assert {len({pair[place] for pair in pairs}) for place in (0, 1)} == {3}
