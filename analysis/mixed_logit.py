"""Logit with a normal random intercept a participant, by maximum likelihood.

The likelihood of one participant is the integral of its answers' probability over the intercept, log odds X b + s u
with u standard normal. It is taken by adaptive Gauss-Hermite quadrature, centred on the mode and scaled by the
curvature there (Liu and Pierce 1994, Biometrika 81, 624-629; Pinheiro and Bates 1995, equation (2.12)). Cost grows
with trials x nodes, memory too, so that a thousand participants are no trouble.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.exact import NotDefined

NODES = 15
"""Of the quadrature."""

NEWTON_STEPS = 50
MODE_TOLERANCE = 1e-10
GRADIENT_TOLERANCE = 1e-6
"""Of the mean log likelihood of a trial, at its maximum."""

DIFFERENCE = 1e-4
"""Step of the central differences that make the Hessian out of gradients."""

START_SD = 0.5

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MixedLogit:
    """Maximum likelihood estimates.

    Args:
        coefficients: log odds ratios, shape (K,).
        covariance: theirs, from the observed information, the intercepts' SD being estimated too; shape (K, K).
        sd: of the random intercepts.
        log_likelihood: at the maximum.
    """

    coefficients: Floats
    covariance: Floats
    sd: float
    log_likelihood: float


def log_likelihood(
    *, correct: Floats, matrix: Floats, participants: NDArray[np.int64], coefficients: Floats, sd: float
) -> tuple[float, Floats]:
    """The log likelihood, and its derivatives by the coefficients and then by `sd`, shape (K + 1,).

    Args:
        correct: 0 or 1, shape (N,).
        matrix: shape (N, K).
        participants: index of the participant, from 0, shape (N,).
        coefficients: log odds ratios, shape (K,).
        sd: of the random intercepts; its sign does not matter.
    """
    people = int(participants.max()) + 1
    fixed = matrix @ coefficients
    mode, width = _modes(correct, fixed, participants, people, sd)
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    at = mode + width * nodes[:, None]
    # log of each node's share: answers, standard normal, and what the change of variable leaves of the quadrature.
    shares = np.log(weights)[:, None] + nodes[:, None] ** 2 / 2 - at**2 / 2 + np.log(width) - math.log(2 * math.pi) / 2
    left = np.empty((NODES, correct.size))
    for k, u in enumerate(at):
        odds = fixed + sd * u[participants]
        unlikely = np.exp(-np.abs(odds))
        lost = np.log1p(unlikely) + np.where((odds > 0) == (correct > 0), 0.0, np.abs(odds))
        shares[k] -= np.bincount(participants, lost, minlength=people)
        left[k] = correct - np.where(odds > 0, 1.0, unlikely) / (1 + unlikely)
    top = shares.max(axis=0)
    posterior = np.exp(shares - top)
    total = posterior.sum(axis=0)
    posterior /= total
    by_trial, by_sd = np.zeros(correct.size), 0.0
    for k, share in enumerate(posterior):
        left[k] *= share[participants]
        by_trial += left[k]
        by_sd += float(left[k] @ at[k][participants])
    return float((top + np.log(total)).sum()), np.append(by_trial @ matrix, by_sd)


def fit(*, correct: Floats, matrix: Floats, participants: NDArray[np.int64]) -> MixedLogit:
    """The maximum of `log_likelihood`, from no effects and an SD of `START_SD`.

    The search runs on columns made orthogonal and of one size, where the curvature is nearly the same every way.

    Raises:
        NotDefined: where columns depend on one another, the search does not converge, or the likelihood is flat at its
            end.
    """
    from scipy.optimize import minimize

    count = matrix.shape[1]
    even, mixing = np.linalg.qr(matrix)
    size = np.abs(np.diag(mixing))
    if size.min() <= 1e-10 * size.max():
        raise NotDefined("some terms of the mixed logit cannot be told from the others")
    even, mixing = even * np.sqrt(len(even)), mixing / np.sqrt(len(even))

    def lost(parameters: Floats) -> tuple[float, Floats]:
        value, gradient = log_likelihood(
            correct=correct, matrix=even, participants=participants, coefficients=parameters[:-1], sd=parameters[-1]
        )
        return -value / correct.size, -gradient / correct.size

    start = np.append(np.zeros(count), START_SD)
    found = minimize(lost, start, jac=True, method="BFGS", options={"gtol": GRADIENT_TOLERANCE})
    if not np.isfinite(found.x).all() or np.abs(found.jac).max() > 10 * GRADIENT_TOLERANCE:
        raise NotDefined("the mixed logit does not converge")
    steps = DIFFERENCE * np.eye(count + 1)
    rows = [(lost(found.x + step)[1] - lost(found.x - step)[1]) / (2 * DIFFERENCE) for step in steps]
    information = correct.size * (np.array(rows) + np.array(rows).T) / 2
    if np.linalg.eigvalsh(information)[0] <= 0:
        raise NotDefined("the likelihood of the mixed logit is flat at its maximum")
    back = np.linalg.inv(mixing)
    covariance: Floats = (back @ np.linalg.inv(information)[:count, :count] @ back.T).astype(np.float64)
    return MixedLogit(back @ found.x[:count], covariance, abs(float(found.x[-1])), -float(found.fun) * correct.size)


def _modes(
    correct: Floats, fixed: Floats, participants: NDArray[np.int64], people: int, sd: float
) -> tuple[Floats, Floats]:
    """Mode of each participant's u given the answers, and 1 / sqrt of the curvature there, by Newton's method.

    The log density is concave with a curvature between 1 and 1 + sd^2 n / 4, so halved steps always get there.
    """
    u = np.zeros(people)
    for _ in range(NEWTON_STEPS):
        p = _expit(fixed + sd * u[participants])
        slope = sd * np.bincount(participants, correct - p, minlength=people) - u
        curvature = 1 + sd * sd * np.bincount(participants, p * (1 - p), minlength=people)
        step = np.clip(slope / curvature, -1.0, 1.0)
        u += step
        if np.abs(step).max() < MODE_TOLERANCE:
            break
    return u, 1 / np.sqrt(curvature)


def _expit(odds: Floats) -> Floats:
    from scipy.special import expit

    return np.asarray(expit(odds), dtype=np.float64)
