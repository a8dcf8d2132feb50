"""Statistics of many studies at once, in float64: each study's are those in fractions that `analyse` uses."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.identification.confusion import Confusion, most_confused
from palpate.analysis.statistics import anova, icc, inference
from palpate.analysis.statistics.anova import icc_of_mean, variance_components
from palpate.analysis.statistics.exact import NotDefined, of_counts
from tests.approved import Refuses

TRIALS = 6
EFFECTS = {"A": "task", "B": "material", "X": "task x material"}


def same(value: float, expected: float | None) -> None:
    if expected is None:
        assert math.isnan(value)
    else:
        assert value == pytest.approx(expected, rel=1e-10, abs=1e-10)


def counts(seed: int, materials: int, people: int, studies: int = 4) -> np.ndarray:
    """Counts of every answer; the first studies are degenerate: all alike, then all correct."""
    random = np.random.default_rng(seed)
    p = random.dirichlet(np.ones(materials + 1), size=(materials, studies, people))
    made = np.moveaxis(random.multinomial(TRIALS, p), -1, 1)
    made[:, :, 0] = made[:, :, 0, :1]
    made[:, :, 1] = TRIALS * np.eye(materials, materials + 1, dtype=int)[:, :, None]
    return made


def fractions(row: np.ndarray) -> list[Fraction]:
    return [Fraction(int(count), TRIALS) for count in row]


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 6))
def test_t_and_holm(seed: int, materials: int, people: int) -> None:
    made = counts(seed, materials, people)
    every = np.arange(materials)
    result = inference.t_tests(of_counts(made, TRIALS)[every, every], Fraction(1, 4))
    adjusted = inference.holm(result.p)
    for study in range(made.shape[2]):
        tests = [inference.t_against_chance(fractions(made[i, i, study]), Fraction(1, 4)) for i in every]
        family = inference.holm(np.array([1.0 if test.p is None else test.p for test in tests]))
        for i, test in enumerate(tests):
            same(result.statistic[i, study], test.t)
            same(result.p[i, study], test.p)
            same(adjusted[i, study], None if test.p is None else family[i])


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 6))
def test_the_most_confused_pair_and_its_one_way_anova(seed: int, materials: int, people: int) -> None:
    made = counts(seed, materials, people)
    answers = of_counts(made, TRIALS)[:, :materials]
    first, second = most_confused(answers.means)
    names = tuple("abcd"[:materials])
    for study in range(made.shape[2]):
        matrix = Confusion(names, tuple(map(str, range(people))), np.moveaxis(made[:, :, study], -1, 0))
        i, j = int(first[study]), int(second[study])
        pairs = matrix.most_confused()
        assert (len(pairs) == 1) == (i != j)
        if i == j:
            continue
        assert pairs == ((names[i], names[j]),)
        places = ((i, i), (j, j), (i, j), (j, i))
        groups = [fractions(made[a, b, study]) for a, b in places]
        rows, columns = (np.array(side) for side in zip(*places, strict=True))
        result = anova.one_way_tests(answers[rows, columns])
        try:
            effect = anova.one_way(groups).effects[0]
        except NotDefined:
            assert math.isnan(result.p[study])
            continue
        same(result.statistic[study], effect.f)
        same(result.p[study], effect.p)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.lists(st.integers(1, 6), min_size=2, max_size=3))
def test_two_way_anova_and_variance_components(seed: int, materials: int, people: list[int]) -> None:
    made = [counts(seed + i, materials, n) for i, n in enumerate(people)]
    every = np.arange(materials)
    correct = [of_counts(task, TRIALS)[every, every] for task in made]
    design, table_of_all = anova.tasks_by_materials(correct)
    k = sum(people)
    reliability = anova.variance_component_icc(design, table_of_all, k)
    for study in range(made[0].shape[2]):
        values: list[Fraction] = []
        tasks, shown = [], []
        for number, task in enumerate(made):
            for i in every:
                values += fractions(task[i, i, study])
                tasks += [number] * task.shape[-1]
                shown += [int(i)] * task.shape[-1]
        try:
            cells = anova.cells(values, tasks, shown, names=("task", "material"))
        except NotDefined:
            assert set(people) == {1}
            assert math.isnan(reliability[study])
            continue
        for kind in anova.TYPES:
            table = anova.two_way(cells, kind)
            for effect, name in EFFECTS.items():
                result = anova.two_way_tests(design, table_of_all, effect, kind)
                same(result.statistic[study], table.effect(name).f)
                same(result.p[study], table.effect(name).p)
        same(reliability[study], icc_of_mean(variance_components(cells), k))


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 6))
def test_every_icc_form(seed: int, materials: int, people: int) -> None:
    made = counts(seed, materials, people)
    every = np.arange(materials)
    for form in icc.NAMES:
        value, tested = icc.icc_tests(made[every, every], form)
        for study in range(made.shape[2]):
            try:
                expected = icc.icc([fractions(made[i, i, study]) for i in every]).form(form)
            except NotDefined:
                assert math.isnan(value[study])
                assert math.isnan(tested.p[study])
                continue
            same(value[study], expected.value)
            same(tested.statistic[study], expected.f)
            same(tested.p[study], expected.p)


def test_types_are_one_test_where_the_design_makes_them_so() -> None:
    """Numbers in proportion: I and II are one; equal numbers: all three are (Searle 1971, chapter 7)."""
    apart = anova.crossed((15,) * 4 + (10,) * 4, (2, 4))
    assert [apart.same[effect] for effect in "ABX"] == [
        [["I", "II", "III"]],
        [["I", "II"], ["III"]],
        [["I", "II", "III"]],
    ]
    equal = anova.crossed((8,) * 6, (2, 3))
    assert [len(equal.same[effect]) for effect in "ABX"] == [1, 1, 1]


@pytest.mark.parametrize(("weights", "levels"), [((5,) * 4, (1, 4)), ((5, 5), (2, 1))])
def test_a_design_that_crosses_nothing_is_refused(
    weights: tuple[int, ...], levels: tuple[int, int], refuses: Refuses
) -> None:
    with refuses(ValueError):
        anova.crossed(weights, levels)
