"""Biases and lapses: R's glm, Agresti's printed deviance, an observer that guesses, and what is left open."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.lapses import GUESSES, fit, fits, knowing
from tests.analysis.reference import printed
from tests.approved import Refuses


def test_lapses_and_biases_are_those_of_r() -> None:
    reference = printed("quasi_independence_vision")
    found = fit(np.array(printed("quasi_symmetry_vision")["counts"]))
    assert found.lapses == pytest.approx(reference["lapses"], abs=1e-9)
    assert found.biases == pytest.approx(reference["biases"], abs=1e-9)
    assert found.g2 == pytest.approx(reference["g2"], abs=1e-6)
    assert found.df == reference["df"]
    assert found.lapse == pytest.approx(reference["lapse"], abs=1e-9)


def test_the_deviance_is_as_printed() -> None:
    migration = printed("quasi_symmetry_migration")
    found = fit(np.array(migration["counts"]))
    assert [round(found.g2, 1), found.df] == migration["quasi_independence"]


@pytest.mark.parametrize(
    ("counts", "g2"),
    [
        ([[20, 0, 0, 0], [5, 12, 4, 3], [2, 6, 15, 4], [3, 1, 2, 18]], 3.30508852587),
        ([[20, 4, 1, 0], [5, 12, 4, 0], [2, 6, 15, 0], [3, 1, 2, 18]], 3.58404698472),
    ],
)
def test_a_material_that_is_never_wrong_or_never_a_wrong_answer_takes_its_degrees_of_freedom(
    counts: list[list[int]], g2: float
) -> None:
    """R 4.2: glm(n ~ factor(i) + factor(j), poisson) of the wrong cells without that row or column, which has 3 df."""
    found = fit(np.array(counts))
    assert found.g2 == pytest.approx(g2, abs=1e-7)
    assert found.df == 3


def test_counts_that_the_model_gives_give_it_back() -> None:
    lapses, biases = np.array([0.1, 0.5, 1.0, 0.25]), np.array([0.1, 0.2, 0.3, 0.4])
    counts = 10_000 * (np.diag(1 - lapses) + lapses[:, None] * biases)
    found = fit(counts.astype(np.int64))
    assert found.lapses == pytest.approx(lapses, abs=1e-3)
    assert found.biases == pytest.approx(biases, abs=1e-3)
    assert found.g2 < 0.01


def test_a_bias_is_no_knowledge() -> None:
    """Who always names the same two materials is right by it half of the time, and lapses in every trial."""
    everybody = np.tile([300, 500, 100, 100], (4, 1))
    found = fit(everybody)
    assert found.lapses == pytest.approx(np.ones(4))
    known, ratio = knowing(np.array([[3, 5, 1, 1], [9, 9, 9, 9]]), np.full((2, 4), 10), found.biases)
    assert known[0] == pytest.approx(0.0, abs=1e-9)
    assert (ratio > GUESSES).tolist() == [False, True]


def test_what_a_participant_knew_has_the_greatest_likelihood() -> None:
    right, trials, biases = np.array([[8, 4, 9]]), np.array([[10, 10, 10]]), np.array([0.5, 0.3, 0.2])

    def lost(k: float) -> float:
        return -float((right * np.log(k + (1 - k) * biases)).sum() + (trials - right).sum() * np.log(1 - k))

    expected = optimize.minimize_scalar(lost, bounds=(0, 0.999), method="bounded", options={"xatol": 1e-12})
    known, ratio = knowing(right, trials, biases)
    assert known[0] == pytest.approx(expected.x, abs=1e-7)
    assert ratio[0] == pytest.approx(2 * (lost(0.0) - expected.fun), abs=1e-9)
    assert knowing(trials, trials, biases)[0][0] == pytest.approx(1.0)


def test_many_tables_are_fitted_as_one() -> None:
    tables = np.random.default_rng(5).integers(1, 30, size=(6, 4, 4))
    guessed, biases = fits(tables)
    for table, a, b in zip(tables, guessed, biases, strict=True):
        own = fit(table)
        assert a / table.sum(axis=1) == pytest.approx(own.lapses)
        assert b == pytest.approx(own.biases)


def test_what_leaves_a_bias_open_is_not_defined() -> None:
    with pytest.raises(NotDefined, match="3 materials, got 2"):
        fit(np.array([[8, 2], [1, 9]]))
    with pytest.raises(NotDefined, match="not determined"):
        fit(np.diag([10, 10, 10]))
    with pytest.raises(NotDefined, match="never presented"):
        fit(np.array([[8, 1, 1], [0, 0, 0], [1, 1, 8]]))


@pytest.mark.parametrize(
    "counts", [[[5, 5, 0], [3, 5, 2], [0, 0, 10]], [[95, 5, 0], [6, 90, 4], [0, 0, 100]]], ids=["ten", "hundred"]
)
def test_a_bias_that_runs_to_one_is_open(counts: list[list[int]], refuses: Refuses) -> None:
    """R's glm of these warns of fitted rates that are numerically 0, and lets the bias of the first run to 1."""
    with refuses(NotDefined):
        fit(np.array(counts))
