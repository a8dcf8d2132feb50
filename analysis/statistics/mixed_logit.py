"""A logit of counts in which participants differ in level, by material and by task.

Log odds are x_c b + s_1 u_p1 + s_2 u_p2[material] + s_3 u_p3[task], u standard normal (Bates et al. 2015, J. Stat.
Softw. 67 (1)), by Laplace's approximation (Breslow and Clayton 1993, J. Am. Stat. Assoc. 88, 9-25), with its exact
gradient.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined

STEPS, MODE_TOLERANCE = 100, 1e-11
"""The most of Newton's steps to the modes of u, and the step at which they end."""

GRADIENT_TOLERANCE = 1e-6
"""The largest gradient of the mean log likelihood of a participant at its maximum."""

START_SD, DIFFERENCE = 0.5, 1e-4
"""The SDs at the start, and the step of the central differences of gradients that make the Hessian."""

LARGEST = 12.0
"""A log odds beyond this counts as one without limit."""


@dataclass(frozen=True)
class MixedLogit:
    """Maximum likelihood estimates: log odds ratios (K,), their covariance (K, K), and SDs of the random effects."""

    coefficients: Floats
    covariance: Floats
    sds: Floats
    log_likelihood: float


@dataclass(frozen=True)
class Layout:
    """Cells of counts: the fixed effects, shape (C, K), and the random effects by their SD, shapes (C, levels)."""

    fixed: Floats
    random: tuple[Floats, ...]


def layout(levels: Sequence[Sequence[int]]) -> Layout:
    """Return the layout of cells with these levels of each factor, (C,); a factor of one level has no effect."""
    cells = len(levels[0])
    fixed, random = [np.ones((cells, 1))], [np.ones((cells, 1))]
    for factor in levels:
        indicators = np.equal.outer(np.array(factor), np.unique(factor)).astype(np.float64)
        if indicators.shape[1] > 1:
            fixed.append(indicators[:, 1:])
            random.append(indicators)
    return Layout(np.hstack(fixed), tuple(random))


def log_likelihood(
    right: Integers, trials: Integers, cells: Layout, coefficients: Floats, sds: Floats
) -> tuple[float, Floats]:
    """Return Laplace's log likelihood, without the binomial coefficients, and its gradient by coefficients and SDs.

    Counts have the shape (participants, C); a participant without trials in a cell has 0 there.
    """
    start: Floats = np.zeros((len(right), sum(part.shape[1] for part in cells.random)))
    return _evaluated(right, trials, cells, (coefficients, sds), start)[:2]


def _evaluated(
    right: Integers, trials: Integers, cells: Layout, parameters: tuple[Floats, Floats], start: Floats
) -> tuple[float, Floats, Floats]:
    """Return what `log_likelihood` does, and the modes, which are sought from `start`, (participants, Q)."""
    coefficients, sds = parameters
    z = np.hstack(cells.random)
    owner = np.repeat(np.arange(len(cells.random)), [part.shape[1] for part in cells.random])
    scaled = z * sds[owner]
    fixed = cells.fixed @ coefficients
    u = _modes(right, trials, fixed, scaled, start)
    odds = fixed + u @ scaled.T
    share = 1 / (1 + np.exp(-odds))
    weight = trials * share * (1 - share)
    curvature = _curvature(scaled, weight)
    inverse = np.linalg.inv(curvature)
    left = right - trials * share
    value = float((right * odds - trials * np.logaddexp(0, odds)).sum() - (u * u).sum() / 2)
    value -= float(np.linalg.slogdet(curvature)[1].sum()) / 2
    # What the log determinant loses as the odds move, which the mode does not make up for.
    back = inverse @ scaled.T
    reach = np.einsum("ci,pic->pc", scaled, back)
    pull = -weight * (1 - 2 * share) * reach / 2
    turned = ((pull @ scaled)[:, None] @ back)[:, 0] * weight
    by_coefficient = ((left + pull - turned) @ cells.fixed).sum(axis=0)
    by_sd = np.empty(len(sds))
    for k in range(len(sds)):
        own = np.where(owner == k, z, 0.0)
        moved = u @ own.T
        shift = np.einsum("pij,pj->pi", inverse, left @ own - (weight * moved) @ scaled)
        straight = (left * moved).sum() - (np.einsum("pic,ci->pc", back, own) * weight).sum()
        by_sd[k] = straight + (pull * (moved + shift @ scaled.T)).sum()
    return value, np.append(by_coefficient, by_sd), u


def _curvature(scaled: Floats, weight: Floats) -> Floats:
    """Return the curvature by u of minus each participant's log likelihood, shape (participants, Q, Q)."""
    count = scaled.shape[1]
    squares = (scaled[:, :, None] * scaled[:, None]).reshape(-1, count * count)
    return np.asarray(np.eye(count) + (weight @ squares).reshape(-1, count, count))


def fit(right: Integers, trials: Integers, cells: Layout) -> MixedLogit:
    """Return the maximum of `log_likelihood`.

    Raises `NotDefined` where all answers of some part are right, or wrong, or without convergence.
    """
    from scipy.optimize import minimize

    people, count, effects = len(right), cells.fixed.shape[1], len(cells.random)
    u: Floats = np.zeros((people, sum(part.shape[1] for part in cells.random)))

    def lost(parameters: Floats) -> tuple[float, Floats]:
        # The modes of the step before are near these.
        nonlocal u
        value, gradient, u = _evaluated(right, trials, cells, (parameters[:count], parameters[count:]), u)
        return -value / people, -gradient / people

    start = np.append(np.zeros(count), np.full(effects, START_SD))
    found = minimize(lost, start, jac=True, method="BFGS", options={"gtol": GRADIENT_TOLERANCE})
    if not np.isfinite(found.x).all() or np.abs(found.jac).max() > 100 * GRADIENT_TOLERANCE:
        raise NotDefined("the mixed logit does not converge")
    if np.abs(found.x[:count]).max() > LARGEST:
        raise NotDefined("the odds of the mixed logit are infinite or zero, as if answers were all right or all wrong")
    steps = DIFFERENCE * np.eye(count + effects)
    rows = np.array([(lost(found.x + step)[1] - lost(found.x - step)[1]) / (2 * DIFFERENCE) for step in steps])
    information = people * (rows + rows.T) / 2
    if np.linalg.eigvalsh(information)[0] <= 0:
        raise NotDefined("the likelihood of the mixed logit is flat at its maximum")
    covariance = np.linalg.inv(information)[:count, :count]
    return MixedLogit(found.x[:count], covariance, np.abs(found.x[count:]), -float(found.fun) * people)


def _modes(right: Integers, trials: Integers, fixed: Floats, scaled: Floats, start: Floats) -> Floats:
    """Return each participant's mode of u given the answers, shape (participants, Q), by Newton's method, halved."""
    u = np.where(np.isfinite(start), start, 0.0)

    def height(at: Floats) -> Floats:
        odds = fixed + at @ scaled.T
        return np.asarray((right * odds - trials * np.logaddexp(0, odds)).sum(axis=1) - (at * at).sum(axis=1) / 2)

    best = height(u)
    for _ in range(STEPS):
        share = 1 / (1 + np.exp(-(fixed + u @ scaled.T)))
        slope = (right - trials * share) @ scaled - u
        weight = trials * share * (1 - share)
        step = np.linalg.solve(_curvature(scaled, weight), slope[..., None])[..., 0]
        tried = height(u + step)
        while (worse := tried < best - 1e-12 * (1 + np.abs(best))).any():
            step[worse] /= 2
            tried = height(u + step)
        u, best = u + step, tried
        if np.abs(step).max() < MODE_TOLERANCE:
            break
    return u
