"""Simulated counts: their distribution against scipy's and against moments in closed form, and what always holds."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.analysis.power.choice_models import GUIDE, Answers, Guided, Inverse, distribution, draw


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 25),
    st.floats(0.001, 1),
    st.floats(0.001, 1),
    st.one_of(st.just(0.0), st.floats(0.001, 0.999)),
)
def test_the_distribution_is_that_of_scipy(trials: int, share: float, rest: float, spread: float) -> None:
    """scipy.stats.betabinom and binom, every number of remaining trials."""
    table = distribution(trials, share, rest, spread).reshape(trials + 1, trials + 1)
    for left in range(trials + 1):
        count = np.arange(trials + 1)
        if spread:
            expected = scipy.stats.betabinom.cdf(count, left, share * (1 / spread - 1), rest * (1 / spread - 1))
        else:
            expected = scipy.stats.binom.cdf(count, left, share / (share + rest))
        assert table[left] - left == pytest.approx(expected, abs=1e-9)
    assert np.all(np.diff(table.ravel()) >= 0)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 40),
    st.floats(1e-6, 1),
    st.floats(1e-6, 1),
    st.one_of(st.just(0.0), st.floats(0.001, 0.999)),
    st.integers(0, 2**32 - 1),
)
def test_the_guide_finds_what_the_search_finds(
    trials: int, share: float, rest: float, spread: float, seed: int
) -> None:
    """The search is the oracle: at the ends of every cell, beside every step of the distribution, and in between."""
    table = distribution(trials, share, rest, spread).reshape(trials + 1, trials + 1) - np.arange(trials + 1)[:, None]
    cells = np.arange(GUIDE) / GUIDE
    uniform = np.concatenate([cells, table.ravel(), np.random.default_rng(seed).random(500)])
    uniform = np.concatenate([np.nextafter(uniform, 0), uniform, np.nextafter(uniform, 1)])
    uniform = np.clip(uniform, 0.0, np.nextafter(1.0, 0.0))[None, :]
    left, uniform = (np.array(one) for one in np.broadcast_arrays(np.arange(trials + 1)[:, None], uniform))
    asked = trials, share, rest, spread
    assert np.array_equal(Guided(*asked).counts(left, uniform), Inverse(*asked).counts(left, uniform))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 25),
    st.lists(st.sampled_from([0.0, 0.001, 0.2, 1.0]), min_size=3, max_size=6).filter(any),
    st.sampled_from([0.0, 0.01, 0.3, 0.999]),
    st.integers(0, 2**32 - 1),
)
def test_counts_add_up_and_an_answer_without_share_never_comes(
    trials: int, weights: list[float], spread: float, seed: int
) -> None:
    shares = np.tile(np.array(weights) / sum(weights), (len(weights) - 1, 1))
    answers = Answers("task", shares, np.full(len(shares), spread))
    counts = draw(answers, trials=trials, participants=3, studies=7, random=np.random.default_rng(seed))
    assert counts.shape == (len(shares), len(shares) + 1, 7, 3)
    assert np.all(counts.sum(axis=1) == trials)
    assert np.all(counts >= 0)
    assert not counts[:, shares[0] == 0].any()


@pytest.mark.parametrize("spread", [0.0, 0.05, 0.4])
def test_means_and_covariances_are_those_of_the_dirichlet_multinomial(spread: float) -> None:
    """Mosimann (1962): covariance of two counts is n (diag p - p p') (1 + (n - 1) rho)."""
    p, trials = np.array([0.5, 0.3, 0.15, 0.05]), 10
    answers = Answers("task", np.tile(p, (3, 1)), np.full(3, spread))
    counts = draw(answers, trials=trials, participants=1, studies=200_000, random=np.random.default_rng(5))[0, :, :, 0]
    assert counts.mean(axis=1) == pytest.approx(trials * p, abs=0.03)
    expected = trials * (np.diag(p) - np.outer(p, p)) * (1 + (trials - 1) * spread)
    assert np.cov(counts) == pytest.approx(expected, abs=0.12)


def test_nobody_named_the_last_place() -> None:
    answers = Answers("task", np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), np.array([0.5, 0.0]))
    counts = draw(answers, trials=4, participants=2, studies=3, random=np.random.default_rng(1))
    assert np.all(counts[0, 2] == 4)
    assert np.all(counts[1, 0] == 4)


def test_a_uniform_number_just_below_one_stays_within_the_trials() -> None:
    class Highest:
        def random(self, shape: tuple[int, ...]) -> np.ndarray:
            return np.full(shape, np.nextafter(1.0, 0.0))

    answers = Answers("task", np.array([[0.5, 0.3, 0.2], [0.2, 0.2, 0.6]]), np.array([0.2, 0.0]))
    counts = draw(answers, trials=1000, participants=2, studies=2, random=Highest())  # type: ignore[arg-type]
    assert np.all(counts.sum(axis=1) == 1000)
    assert np.all(counts >= 0)
