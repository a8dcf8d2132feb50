"""The logit with participants by material and task: against lme4, its own definition, and a plain logit."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm

from palpate.analysis.statistics.exact import Integers, NotDefined
from palpate.analysis.statistics.mixed_logit import fit, layout, log_likelihood
from tests.analysis.reference import printed
from tests.approved import Refuses

TASKS, MATERIALS = [0, 0, 0, 1, 1, 1], [0, 1, 2, 0, 1, 2]


def _counts() -> tuple[Integers, Integers]:
    table = np.array(printed("mixed_logit")["counts"])
    return table[:, 3].reshape(12, 6), table[:, 4].reshape(12, 6)


def test_estimates_are_those_of_lme4() -> None:
    reference = printed("mixed_logit")
    found = fit(*_counts(), layout([TASKS, MATERIALS]))
    assert found.coefficients == pytest.approx(np.array(reference["coefficients"]), abs=1e-6)
    # VarCorr lists the deviations by material, by task, and the intercept; here the intercept comes first.
    assert found.sds == pytest.approx(np.array(reference["sds"]), abs=1e-6)
    assert found.covariance == pytest.approx(np.array(reference["covariance"]), abs=1e-6)
    assert found.log_likelihood == pytest.approx(reference["log_likelihood"], abs=1e-6)


def test_one_task_has_no_deviations_by_task() -> None:
    reference = printed("mixed_logit")
    right, trials = _counts()
    found = fit(right[:, :3], trials[:, :3], layout([TASKS[:3], MATERIALS[:3]]))
    assert found.coefficients == pytest.approx(np.array(reference["one_task"]), abs=1e-6)
    assert found.sds == pytest.approx(np.array(reference["sds_of_one_task"]), abs=1e-6)
    assert found.log_likelihood == pytest.approx(reference["log_likelihood_of_one_task"], abs=1e-6)


def test_the_gradient_is_that_of_differences() -> None:
    right, trials = _counts()
    cells = layout([TASKS, MATERIALS])
    at = np.array([0.2, 0.5, -0.3, 0.6, 0.4, 0.5, 0.6])
    _, gradient = log_likelihood(right, trials, cells, at[:4], at[4:])
    for k, step in enumerate(1e-5 * np.eye(7)):
        high, low = (log_likelihood(right, trials, cells, one[:4], one[4:])[0] for one in (at + step, at - step))
        assert gradient[k] == pytest.approx((high - low) / 2e-5, rel=1e-6)


def test_participants_who_do_not_differ_give_a_plain_logit() -> None:
    """Laplace's approximation is exact without random effects; the coefficients are those of statsmodels."""
    right, trials = _counts()
    cells = layout([TASKS, MATERIALS])
    pooled = np.column_stack([right.sum(axis=0), (trials - right).sum(axis=0)])
    plain = sm.GLM(pooled, cells.fixed, family=sm.families.Binomial()).fit()
    value, gradient = log_likelihood(right, trials, cells, plain.params, np.zeros(3))
    odds = cells.fixed @ plain.params
    assert value == pytest.approx(float((right * odds - trials * np.log1p(np.exp(odds))).sum()))
    assert gradient[:4] == pytest.approx(np.zeros(4), abs=1e-6)


def test_who_lacks_a_task_counts_with_the_other() -> None:
    """Participants without a trial there change nothing beside those who are not in the table at all."""
    right, trials = _counts()
    cells = layout([TASKS, MATERIALS])
    nobody = np.zeros((1, 6), dtype=np.int64)
    own, wider = (
        log_likelihood(hits, total, cells, np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.5, 0.6, 0.7]))[0]
        for hits, total in ((right, trials), (np.vstack([right, nobody]), np.vstack([trials, nobody])))
    )
    assert own == pytest.approx(wider)


def test_odds_without_limit_are_refused(refuses: Refuses) -> None:
    right, trials = _counts()
    right = right.copy()
    right[:, 3:] = trials[:, 3:]
    with refuses(NotDefined):
        fit(right, trials, layout([TASKS, MATERIALS]))
