"""Participants as the unit: R's car, one-sided tests, and closed forms of the jackknife."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy import stats
from scipy.linalg import helmert

from palpate.analysis.statistics.exact import NotDefined
from palpate.analysis.statistics.participants import (
    equivalence,
    equivalence_tests,
    jackknife,
    mean,
    misfit,
    repeated,
    repeated_tests,
)
from tests.analysis.reference import printed
from tests.approved import Refuses


def test_repeated_measures_are_those_of_r() -> None:
    reference = printed("obrien_kaiser")
    values = np.array(reference["values"], dtype=float)
    lines = repeated(values.reshape(16, 3, 5), ["phase", "hour"])
    assert [line.effect for line in lines] == ["phase", "hour", "phase x hour"]
    (first,) = repeated(values[:, :5], ["hour"])
    wanted = [*(reference[line.effect] for line in lines), reference["hour_of_the_first_phase"]]
    for line, expected in zip((*lines, first), wanted, strict=True):
        found = (line.f, line.df1, line.df2, line.p_uncorrected, line.greenhouse_geisser, line.epsilon, line.p)
        *plain, _, epsilon, p = expected
        assert found == pytest.approx((*plain, epsilon, p), rel=1e-9)


@pytest.mark.parametrize("people", [2, 3, 4])
def test_epsilon_lies_between_that_of_greenhouse_and_geisser_and_1(people: int) -> None:
    values = np.random.default_rng(people).normal(size=(50, people, 4))
    _, epsilon, _, _, least = repeated_tests(values @ helmert(4).T)
    assert (epsilon >= least).all()
    assert (epsilon <= 1).all()
    if people == 2:
        assert epsilon == pytest.approx(1 / 3)


def test_two_levels_are_a_paired_t() -> None:
    values = np.random.default_rng(1).normal(size=(9, 2))
    (line,) = repeated(values, ["task"])
    expected = stats.ttest_rel(values[:, 0], values[:, 1])
    assert (line.f, line.p, line.epsilon) == pytest.approx((expected.statistic**2, expected.pvalue, 1.0))


def test_participants_who_do_not_differ_have_no_f(refuses: Refuses) -> None:
    (line,) = repeated(np.tile([0.1, 0.4, 0.7], (5, 1)), ["material"])
    assert (line.f, line.epsilon, line.p, line.p_uncorrected) == (None, None, None, None)
    with pytest.raises(NotDefined, match="two participants"):
        repeated(np.ones((1, 3)), ["material"])
    with refuses(NotDefined):
        repeated(np.ones((4, 1)), ["material"])


def test_many_studies_of_repeated_measures_are_those_of_one() -> None:
    values = np.random.default_rng(2).normal(size=(6, 8, 4))
    f, epsilon, p, *_ = repeated_tests(values @ helmert(4).T)
    for k, study in enumerate(values):
        (line,) = repeated(study, ["material"])
        assert (line.f, line.epsilon, line.p) == pytest.approx((f[k], epsilon[k], p[k]))


def test_equivalence_is_that_of_two_one_sided_tests_in_r() -> None:
    darwin = printed("darwin")
    values = np.array(darwin["differences"], dtype=float)
    for margin, low, high in darwin["one_sided"]:
        found = equivalence(values, margin)
        assert found.p == pytest.approx(max(low, high), rel=1e-10)
        assert equivalence(-values, margin).p == pytest.approx(found.p)
    assert (found.low, found.high) == pytest.approx(tuple(darwin["interval_of_90"]), rel=1e-10)
    many = equivalence_tests(np.stack([values, values / 2]), 15)
    assert many == pytest.approx([equivalence(values, 15).p, equivalence(values / 2, 15).p])


def test_the_bayes_factor_for_none_is_the_integral_over_the_prior() -> None:
    """Rouder et al. (2009), equation (1), by mpmath, with a scale of sqrt(2) / 2."""
    values = np.array([0.1, -0.2, 0.05, 0.15, -0.1, 0.02])
    n, nu = mpmath.mpf(6), mpmath.mpf(5)
    t = mpmath.mpf(float(values.mean() / (values.std(ddof=1) / np.sqrt(6))))

    def weight(g: mpmath.mpf) -> mpmath.mpf:
        scaled = 1 + n * g / 2
        prior = mpmath.exp(-1 / (2 * g)) / (mpmath.sqrt(2 * mpmath.pi) * g ** mpmath.mpf(1.5))
        return prior / mpmath.sqrt(scaled) * (1 + t**2 / (scaled * nu)) ** (-(nu + 1) / 2)

    some = mpmath.quad(weight, [0, 0.1, 1, 10, 1000, mpmath.inf])
    expected = mpmath.log((1 + t**2 / nu) ** (-(nu + 1) / 2) / some)
    assert equivalence(values, 0.1).log_bf01 == pytest.approx(float(expected), abs=1e-6)


def test_equivalence_of_those_who_do_not_differ_is_not_defined() -> None:
    with pytest.raises(NotDefined, match="no variance"):
        equivalence(np.full(5, 0.02), 0.1)
    with pytest.raises(NotDefined, match="two participants, got 1"):
        equivalence(np.array([0.02]), 0.1)
    assert np.isnan(equivalence_tests(np.full((1, 5), 0.02), 0.1)).all()


def test_the_jackknife_of_a_mean_is_students_interval() -> None:
    values = np.random.default_rng(3).normal(size=12)
    found = jackknife(float(values.mean()), (values.sum() - values) / 11)
    expected = stats.t.interval(0.95, 11, values.mean(), stats.sem(values))
    assert (found.value, found.error) == pytest.approx((values.mean(), stats.sem(values)))
    assert (found.low, found.high) == pytest.approx(expected)


def test_the_jackknife_takes_the_bias_from_a_variance_divided_by_n() -> None:
    """It gives exactly the variance divided by n - 1 (Quenouille 1956)."""
    values = np.random.default_rng(4).normal(size=9)
    left_out = np.array([np.delete(values, k).var() for k in range(9)])
    assert jackknife(float(values.var()), left_out).value == pytest.approx(values.var(ddof=1))


def test_a_jackknife_without_variance_is_not_defined() -> None:
    with pytest.raises(NotDefined, match="needs 2 participants, got 1"):
        jackknife(0.3, np.array([0.3]))
    with pytest.raises(NotDefined, match="no variance"):
        jackknife(0.3, np.full(4, 0.3))


def test_a_misfit_is_the_deviance_beside_the_spread_of_participants() -> None:
    """Two participants, two presented: chi-squared about the pooled shares by scipy, in each row of answers."""
    counts = np.array([[[8, 2, 0], [1, 9, 0]], [[2, 8, 0], [3, 5, 2]]])
    spread = sum(stats.chi2_contingency(counts[:, row, : 2 + row], correction=False).statistic for row in (0, 1))
    found = misfit(counts, 12.0, 2)
    assert (found.df1, found.df2) == (2, 3)
    assert found.f == pytest.approx(12 / 2 / (spread / 3))
    assert found.p == pytest.approx(stats.f.sf(found.f, 2, 3))
    assert misfit(np.array([counts[0]] * 2), 12.0, 2).f == 6.0
    for few, df in ((counts[:1], 2), (counts, 0)):
        with pytest.raises(NotDefined):
            misfit(few, 1.0, df)


def test_the_mean_over_participants_has_students_interval() -> None:
    """R 4.2.2: t.test(c(-15.5, -14, -17.25, -16))."""
    found = mean(np.array([-15.5, -14.0, -17.25, -16.0]))
    assert found.n == 4
    assert (found.value, found.low, found.high) == pytest.approx((-15.6875, -17.82667, -13.54833), abs=1e-5)
    assert mean(np.array([3.0])).low is None
