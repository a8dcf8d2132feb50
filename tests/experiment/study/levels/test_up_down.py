"""Transformed up-down against a naive reading of Levitt (1971), Table I, which knows no runs and no states."""

from __future__ import annotations

import re
from itertools import pairwise
from math import log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from palpate.experiment.protocol.models import Levels
from palpate.experiment.study.levels.up_down import State, UpDown

GRID = (0.1, 0.2, 0.3, 0.5, 0.8)


def settings(down: int, *, first: float = 0.3, reversals: int = 100, grid: tuple[float, ...] = GRID) -> Levels:
    return Levels(method="up-down", grid=grid, first=first, down=down, reversals=reversals)


def groups(answers: str, down: int) -> list[tuple[int, int]]:
    """Levitt's response groups in a row of answers: where each ends, and whether it lowers (-1) or raises (1)."""
    found = re.finditer(rf"\+{{{down}}}|\+{{0,{down - 1}}}-", answers)
    return [(one.end(), 1 if one.group().endswith("-") else -1) for one in found]


def naive_levels(answers: str, rule: Levels) -> list[float]:
    """The level of each trial, and of the next one after the last."""
    moved, place, levels = dict(groups(answers, rule.down or 0)), rule.grid.index(rule.first or 0.0), []
    for trial in range(len(answers) + 1):
        place = max(0, min(len(rule.grid) - 1, place + moved.get(trial, 0)))
        levels.append(rule.grid[place])
    return levels


def naive_reversals(answers: str, down: int) -> int:
    return sum(one != other for (_, one), (_, other) in pairwise(groups(answers, down)))


def played(answers: str, rule: Levels) -> tuple[list[float | None], int]:
    """The levels that the method gives, and its reversals."""
    method = UpDown(rule)
    state = method.init()
    levels = [method.level(state)]
    for one in answers:
        state = method.step(state, level=state.level, right=one == "+")
        levels.append(method.level(state))
    return levels, state.reversals


@pytest.mark.parametrize(
    ("answers", "levels", "reversals"),
    [
        # By hand, 2 down 1 up: from 0.3 down after "++", up after "-" and "+-".
        ("++", [0.3, 0.3, 0.2], 0),
        ("+-", [0.3, 0.3, 0.5], 0),
        ("++-", [0.3, 0.3, 0.2, 0.3], 1),
        ("++-++", [0.3, 0.3, 0.2, 0.3, 0.3, 0.2], 2),
        ("++++++", [0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.1], 0),
        # A direction that the grid cannot follow counts.
        ("++++++-", [0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.1, 0.2], 1),
        ("----", [0.3, 0.5, 0.8, 0.8, 0.8], 0),
    ],
)
def test_a_few_answers_by_hand(answers: str, levels: list[float], reversals: int) -> None:
    assert played(answers, settings(2)) == (levels, reversals)


@given(st.text("+-", max_size=60), st.integers(1, 5), st.sampled_from(GRID))
def test_levels_and_reversals_are_those_of_the_printed_rule(answers: str, down: int, first: float) -> None:
    rule = settings(down, first=first)
    assert played(answers, rule) == (naive_levels(answers, rule), naive_reversals(answers, down))


@given(st.text("+-", max_size=60), st.integers(1, 4), st.integers(1, 6))
def test_no_level_follows_the_last_reversal(answers: str, down: int, reversals: int) -> None:
    rule = settings(down, reversals=reversals)
    method, state = UpDown(rule), UpDown(rule).init()
    for count, one in enumerate(answers, start=1):
        state = method.step(state, level=state.level, right=one == "+")
        assert (method.level(state) is None) == (naive_reversals(answers[:count], down) >= reversals)


@pytest.mark.parametrize(("down", "percent"), [(1, 50.0), (2, 70.7), (3, 79.4), (4, 84.1)])
def test_it_converges_to_the_share_that_levitt_prints(down: int, percent: float) -> None:
    """Levels 0.5 dB apart, and an observer whose share of right answers rises from 0 to 1 with the logarithm."""
    grid = tuple(float(level) for level in 10 ** (np.arange(-40, 1) / 40))
    rule = settings(down, first=grid[20], grid=grid)
    method, rng = UpDown(rule), np.random.default_rng(down)
    state, right = method.init(), []
    for _ in range(20_000):
        chance = float(expit((log(state.level) - log(grid[20])) / 0.15))
        right.append(rng.random() < chance)
        state = method.step(state, level=state.level, right=right[-1])
    # An SD of 0.3 %, and what a step of 6 % adds.
    assert 100 * np.mean(right) == pytest.approx(percent, abs=1.5)


def test_steps_shrink_as_in_a_published_run() -> None:
    """PsychoPy's own test of its StairHandler, test_StairHandlerLinear, from its first reversal (trial 4) on.

    Before that PsychoPy lowers a level after each right answer, whatever `down` is (applyInitialRule).
    """
    grid = tuple(round(place / 1000, 3) for place in range(300, 501))
    rule = Levels(method="up-down", grid=grid, first=0.4, down=3, reversals=4, steps=(100, 10, 1))
    method, state = UpDown(rule), State(0.4, way=-1)
    levels, reversed_at = [], []
    for trial, right in enumerate("----++++----++++", start=4):
        before = state
        levels.append(before.level)
        state = method.step(before, level=before.level, right=right == "+")
        if state.reversals > before.reversals:
            reversed_at.append(trial)
    printed = [0.4, 0.41, 0.42, 0.43, 0.44, 0.44, 0.44, 0.439, 0.439, 0.44, 0.441, 0.442, 0.443, 0.443, 0.443, 0.442]
    assert levels == printed
    assert reversed_at == [4, 10, 12, 18]
    assert method.level(state) is None


def test_one_down_one_up_is_a_published_run() -> None:
    """PsychoPy's test_StairHandlerScalarStepSize: right, right, wrong, over and over."""
    rule = settings(1, first=0.8, grid=tuple(round(place / 10, 1) for place in range(1, 11)))
    assert played("++-++-++-", rule)[0] == [0.8, 0.7, 0.6, 0.7, 0.6, 0.5, 0.6, 0.5, 0.4, 0.5]


@pytest.mark.parametrize(("down", "up", "percent"), [(1, 3, 75.0), (1, 1, 50.0), (1, 4, 80.0), (2, 3, 86.6)])
def test_weighted_it_converges_to_the_share_that_kaernbach_prints(down: int, up: int, percent: float) -> None:
    """Levels 0.5 dB apart: 1/(1 + 1/up) for one down, and its square root for two."""
    grid = tuple(float(level) for level in 10 ** (np.arange(-80, 1) / 40))
    rule = Levels(method="up-down", grid=grid, first=grid[30], down=down, up=up, reversals=100)
    method, rng = UpDown(rule), np.random.default_rng(up)
    state, right = method.init(), []
    for _ in range(20_000):
        chance = float(expit((log(state.level) - log(grid[30])) / 0.4))
        right.append(rng.random() < chance)
        state = method.step(state, level=state.level, right=right[-1])
    assert 100 * np.mean(right) == pytest.approx(percent, abs=1.5)
