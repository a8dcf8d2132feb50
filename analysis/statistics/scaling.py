"""Scales from paired comparisons: Bradley-Terry, Thurstone's case V, and Davidson's for answers with ties.

The first is chosen with probability F(s_first - s_second + order), F the logistic (Bradley and Terry 1952) or the
normal distribution (Thurstone 1927). With ties, the odds of first : tie : second are exp(d/2) : nu : exp(-d/2)
(Davidson 1970; the order effect as Davidson and Beaver 1977). Scale values add up to zero.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import log_softmax

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined

Law = Literal["bradley-terry", "thurstone", "davidson"]

SECOND, TIE, FIRST = 0, 1, 2
"""What was chosen."""

STEPS = 100
"""Newton's method ends within so many steps, or does not converge."""


@dataclass(frozen=True)
class Comparisons:
    """Comparisons of `items`, shape (comparisons,): items presented `first` and `second`, `chosen`, and `person`."""

    first: Integers
    second: Integers
    chosen: Integers
    person: Integers
    items: int


@dataclass(frozen=True)
class Scale:
    """A fitted scale.

    `values`, shape (items,), add up to zero; `order` is what being first adds, `tie` ln nu or None. `covariance`, of
    values, order and tie, is from sums of scores by person times n / (n - 1), NaN for one person. `deviance` is from
    the observed frequencies of ordered pairs, on `df`.
    """

    law: Law
    values: Floats
    order: float
    tie: float | None
    covariance: Floats
    log_likelihood: float
    deviance: float
    df: int

    def difference(self, one: int, other: int) -> tuple[float, float]:
        """Return how much further up the scale item `one` lies than `other`, and its standard error."""
        contrast = np.zeros(len(self.covariance))
        contrast[one] += 1
        contrast[other] -= 1
        return float(self.values[one] - self.values[other]), float(np.sqrt(contrast @ self.covariance @ contrast))


def fit(data: Comparisons, law: Law) -> Scale:
    """Return the scale of greatest likelihood.

    Raises `NotDefined` where there is none: some items were never chosen over the others (Ford 1957), items and order
    explain all choices, or ties and law do not match.
    """
    # Whoever simulates comparisons fits none by this.
    from statsmodels.genmod.families import Binomial, links
    from statsmodels.genmod.generalized_linear_model import GLM

    _check(data, law)
    design = _design(data)
    observed = np.eye(3)[data.chosen]
    if law == "davidson":
        beta, fitted, scores, information = _davidson(design, data.chosen)
    else:
        link = links.Logit() if law == "bradley-terry" else links.Probit()
        chosen = (data.chosen == FIRST).astype(np.float64)
        found = GLM(chosen, design, family=Binomial(link)).fit(tol=1e-13, maxiter=STEPS)
        beta, share = np.asarray(found.params), np.asarray(found.fittedvalues)
        slope = np.asarray(link.inverse_deriv(design @ beta))
        scores = design * ((chosen - share) * slope / (share * (1 - share)))[:, None]
        # Expected information: for the logistic law it is the observed one.
        information = design.T @ (design * (slope**2 / (share * (1 - share)))[:, None])
        fitted = np.column_stack([1 - share, np.zeros_like(share), share])
    likelihood = float(np.log(fitted[np.arange(len(fitted)), data.chosen]).sum())
    # The values of all items, which add up to zero, and the rest are `back` times the fitted coefficients.
    last = data.items - 1
    back = np.insert(np.eye(len(beta)), last, np.where(np.arange(len(beta)) < last, -1.0, 0.0), axis=0)
    inverse = np.linalg.inv(information)
    covariance = back @ inverse @ _meat(scores, data.person) @ inverse @ back.T
    deviance, cells = _deviance(data, observed, fitted)
    return Scale(
        law=law,
        values=(back @ beta)[: data.items],
        order=float(beta[data.items - 1]),
        tie=float(beta[-1]) if law == "davidson" else None,
        covariance=covariance,
        log_likelihood=likelihood,
        deviance=deviance,
        df=cells * (2 if law == "davidson" else 1) - len(beta),
    )


def _check(data: Comparisons, law: Law) -> None:
    ties = bool((data.chosen == TIE).any())
    if ties != (law == "davidson"):
        said = "some comparisons ended in a tie, which this law has not" if ties else "no comparison ended in a tie"
        raise NotDefined(f"{said}, so the {law} scale is not defined")
    # A tie counts as half a choice of each, so it joins both.
    joined = np.zeros((data.items, data.items), dtype=np.int64)
    np.add.at(joined, (data.first, data.second), data.chosen != SECOND)
    np.add.at(joined, (data.second, data.first), data.chosen != FIRST)
    pieces, _ = connected_components(coo_array(joined), directed=True, connection="strong")
    if pieces > 1:
        raise NotDefined("some items were chosen over all others every time, so that no finite scale fits best")
    if _separated(data, _design(data)):
        raise NotDefined("items and their order tell every choice of some kind, so that no finite scale fits best")


def _separated(data: Comparisons, design: Floats) -> bool:
    """Return whether going on and on in some direction fits ever better (Albert and Anderson 1984)."""
    from scipy.optimize import linprog

    signs: dict[int, tuple[tuple[float, float], ...]] = {FIRST: ((1.0, 0.0),), SECOND: ((-1.0, 0.0),)}
    if (data.chosen == TIE).any():
        signs = {FIRST: ((1.0, 0.0), (0.5, -1.0)), SECOND: ((-1.0, 0.0), (-0.5, -1.0)), TIE: ((-0.5, 1.0), (0.5, 1.0))}
    margins = np.concatenate(
        [
            np.column_stack([design[data.chosen == choice] * sign, np.full((data.chosen == choice).sum(), tie)])
            for choice, parts in signs.items()
            for sign, tie in parts
        ]
    )
    margins = np.unique(margins, axis=0)
    further = linprog(-margins.sum(axis=0), A_ub=-margins, b_ub=np.zeros(len(margins)), bounds=(-1, 1))
    return bool(-further.fun > 1e-9)


def _design(data: Comparisons) -> Floats:
    """Return d's design, shape (comparisons, items): items against the last one, then the order."""
    rows = np.arange(len(data.first))
    full = np.zeros((len(rows), data.items))
    np.add.at(full, (rows, data.first), 1.0)
    np.add.at(full, (rows, data.second), -1.0)
    return np.column_stack([full[:, :-1] - full[:, [-1]], np.ones(len(rows))])


def _davidson(design: Floats, chosen: Integers) -> tuple[Floats, Floats, Floats, Floats]:
    """Return coefficients, fitted shares, scores and information of Davidson's law, whose likelihood is concave."""
    count, terms = design.shape
    by_choice = np.zeros((3, count, terms + 1))
    by_choice[FIRST, :, :-1], by_choice[SECOND, :, :-1], by_choice[TIE, :, -1] = design / 2, -design / 2, 1.0
    beta = np.zeros(terms + 1)
    for _ in range(STEPS):
        shares = np.exp(log_softmax(by_choice @ beta, axis=0))
        mean = np.einsum("cn,cnk->nk", shares, by_choice)
        scores = by_choice[chosen, np.arange(count)] - mean
        information = np.einsum("cn,cnk,cnl->kl", shares, by_choice, by_choice) - mean.T @ mean
        step = np.linalg.solve(information, scores.sum(axis=0))
        beta = beta + step / max(1.0, float(np.abs(step).max()))
        if float(np.abs(step).max()) < 1e-12:
            return beta, shares.T, scores, information
    raise NotDefined("the likelihood has no greatest value within reach")


def _meat(scores: Floats, person: Integers) -> Floats:
    """Return the sum of the outer products of each person's score."""
    persons, place = np.unique(person, return_inverse=True)
    if len(persons) == 1:
        return np.full((scores.shape[1], scores.shape[1]), np.nan)
    sums = np.zeros((len(persons), scores.shape[1]))
    np.add.at(sums, place, scores)
    return np.asarray(sums.T @ sums * len(persons) / (len(persons) - 1))


def _deviance(data: Comparisons, observed: Floats, fitted: Floats) -> tuple[float, int]:
    """Return twice the logarithm of the likelihood ratio to the observed shares of each ordered pair, and the pairs."""
    pairs, place = np.unique(np.column_stack([data.first, data.second]), axis=0, return_inverse=True)
    counts, means = np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3))
    np.add.at(counts, place, observed)
    np.add.at(means, place, fitted)
    held = counts > 0
    return float(2 * (counts[held] * np.log(counts[held] / means[held])).sum()), len(pairs)
