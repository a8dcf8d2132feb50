"""Scales from paired comparisons: Bradley-Terry, Thurstone's case V, and Davidson's for answers with ties.

The first is chosen with probability F(s_first - s_second + order), F the logistic (Bradley and Terry 1952) or the
normal distribution (Thurstone 1927). With ties, the odds of first : tie : second are exp(d/2) : nu : exp(-d/2)
(Davidson 1970; the order effect as Davidson and Beaver 1977). Scale values add up to zero.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import expit, log_softmax, ndtr

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined

Law = Literal["bradley-terry", "thurstone", "davidson"]

SECOND, TIE, FIRST = 0, 1, 2
"""What was chosen."""

STEPS = 200
"""Newton's method ends within so many steps, or does not converge."""

CLOSE = 1e-12
"""The last step of a fit is smaller."""


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
    the observed frequencies of ordered pairs, on `df`. A scale that is `reduced` has no likelihood that is greatest:
    it is that of the bias-reduced scores, and its covariance is no smaller than that of independent answers.
    """

    law: Law
    values: Floats
    order: float
    tie: float | None
    covariance: Floats
    log_likelihood: float
    deviance: float
    df: int
    reduced: bool

    def difference(self, one: int, other: int) -> tuple[float, float]:
        """Return how much further up the scale item `one` lies than `other`, and its standard error."""
        contrast = np.zeros(len(self.covariance))
        contrast[one] += 1
        contrast[other] -= 1
        return float(self.values[one] - self.values[other]), float(np.sqrt(contrast @ self.covariance @ contrast))


@dataclass(frozen=True)
class Terms:
    """A scale of Bradley and Terry by terms of the items: `values`, shape (terms + 1,), the last what being first adds.

    `covariance` is as in `Scale`.
    """

    values: Floats
    covariance: Floats
    log_likelihood: float
    reduced: bool

    def combined(self, weights: Floats) -> tuple[float, float]:
        """Return a sum of values with these weights, shape (terms + 1,), and its standard error."""
        return float(weights @ self.values), float(np.sqrt(weights @ self.covariance @ weights))


def fit_terms(data: Comparisons, terms: Floats) -> Terms:
    """Return the scale on which an item lies at the sum of its `terms`, shape (items, terms), times their values.

    Raises `NotDefined` where some comparisons ended in a tie, or the terms cannot be separated.
    """
    if bool((data.chosen == TIE).any()):
        raise NotDefined("some comparisons ended in a tie, which this law does not allow")
    design = np.column_stack([terms[data.first] - terms[data.second], np.ones(len(data.first))])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        raise NotDefined("these comparisons cannot separate the factors from each other and from presentation order")
    reduced = _separated(data, design)
    beta, fitted, scores, information = _binomial(design, data.chosen, probit=False, reduced=reduced)
    likelihood = float(np.log(fitted[np.arange(len(fitted)), data.chosen]).sum())
    return Terms(beta, _spread(_meat(scores, data.person), information, reduced=reduced), likelihood, reduced)


def _spread(meat: Floats, information: Floats, *, reduced: bool) -> Floats:
    """Return the covariance of coefficients from the sums of scores and the information."""
    inverse = np.linalg.inv(information)
    return no_smaller(meat, information) if reduced and np.isfinite(meat).all() else inverse @ meat @ inverse


class NeverCompared(NotDefined):
    """Items of one `part`, by their places, were never compared with any of the others."""

    def __init__(self, part: tuple[int, ...]) -> None:
        super().__init__("some items were never compared with the others, so no scale includes them all")
        self.part = part


def fit(data: Comparisons, law: Law) -> Scale:
    """Return the scale of greatest likelihood, or, where no finite one has it, the bias-reduced one.

    None has it where some items were never chosen over the others (Ford 1957), or items and order explain all choices.
    Bias reduction: Firth (1993, Biometrika 80, 27-38); Kosmidis and Firth (2009, Biometrika 96, 793-804).

    Raises `NotDefined` where ties and law do not match, or the order cannot be separated from the items, and
    `NeverCompared`.
    """
    _check(data, law)
    design = _design(data)
    reduced = _separated(data, design)
    observed = np.eye(3)[data.chosen]
    law_fit = _davidson if law == "davidson" else partial(_binomial, probit=law == "thurstone")
    beta, fitted, scores, information = law_fit(design, data.chosen, reduced=reduced)
    likelihood = float(np.log(fitted[np.arange(len(fitted)), data.chosen]).sum())
    # The values of all items, which add up to zero, and the rest are `back` times the fitted coefficients.
    last = data.items - 1
    back = np.insert(np.eye(len(beta)), last, np.where(np.arange(len(beta)) < last, -1.0, 0.0), axis=0)
    spread = _spread(_meat(scores, data.person), information, reduced=reduced)
    deviance, cells = _deviance(data, observed, fitted)
    return Scale(
        law=law,
        values=(back @ beta)[: data.items],
        order=float(beta[data.items - 1]),
        tie=float(beta[-1]) if law == "davidson" else None,
        covariance=back @ spread @ back.T,
        log_likelihood=likelihood,
        deviance=deviance,
        df=cells * (2 if law == "davidson" else 1) - len(beta),
        reduced=reduced,
    )


def _check(data: Comparisons, law: Law) -> None:
    ties = bool((data.chosen == TIE).any())
    if ties != (law == "davidson"):
        said = (
            "some comparisons ended in a tie, which this law does not allow" if ties else "no comparison ended in a tie"
        )
        raise NotDefined(f"{said}, so the {law} scale is not defined")
    joined = coo_array((np.ones(len(data.first)), (data.first, data.second)), shape=(data.items, data.items))
    pieces, piece = connected_components(joined, directed=False)
    if pieces > 1:
        raise NeverCompared(tuple(np.flatnonzero(piece == piece[0]).tolist()))
    if np.linalg.matrix_rank(np.unique(_design(data), axis=0)) < data.items:
        raise NotDefined("pairs were presented in too few orders to separate the items from presentation order")


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


def _binomial(
    design: Floats, chosen: Integers, *, probit: bool, reduced: bool
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return coefficients, fitted shares, scores and expected information, of the logistic or the normal law."""
    beta = np.zeros(design.shape[1])
    for _ in range(STEPS):
        d = design @ beta
        share = ndtr(d) if probit else expit(d)
        slope = np.exp(-(d**2) / 2) / np.sqrt(2 * np.pi) if probit else share * (1 - share)
        weight = slope**2 / (share * (1 - share))
        information = design.T @ (design * weight[:, None])
        gap = (chosen == FIRST) - share
        scores = design * (gap * weight / slope)[:, None]
        total = scores.sum(axis=0)
        if reduced:
            leverage = weight * np.einsum("nk,kl,nl->n", design, np.linalg.inv(information), design)
            bend = -d if probit else 1 - 2 * share
            total = total + design.T @ (leverage * bend / 2)
        step = np.linalg.solve(information, total)
        beta = beta + step / max(1.0, float(np.abs(step).max()))
        if float(np.abs(step).max()) < CLOSE:
            return beta, np.column_stack([1 - share, np.zeros_like(share), share]), scores, information
    raise NotDefined(NOT_REACHED)


def _davidson(design: Floats, chosen: Integers, *, reduced: bool) -> tuple[Floats, Floats, Floats, Floats]:
    """Return coefficients, fitted shares, scores and information of Davidson's law, whose likelihood is concave."""
    count, terms = design.shape
    by_choice = np.zeros((3, count, terms + 1))
    by_choice[FIRST, :, :-1], by_choice[SECOND, :, :-1], by_choice[TIE, :, -1] = design / 2, -design / 2, 1.0
    beta = np.zeros(terms + 1)
    for _ in range(STEPS):
        shares = np.exp(log_softmax(by_choice @ beta, axis=0))
        gaps = by_choice - np.einsum("cn,cnk->nk", shares, by_choice)
        scores = gaps[chosen, np.arange(count)]
        information = np.einsum("cn,cnk,cnl->kl", shares, gaps, gaps)
        total = scores.sum(axis=0)
        if reduced:
            leverage = np.einsum("cnk,kl,cnl->cn", gaps, np.linalg.inv(information), gaps)
            total = total + np.einsum("cn,cnk->k", shares * leverage / 2, gaps)
        step = np.linalg.solve(information, total)
        beta = beta + step / max(1.0, float(np.abs(step).max()))
        if float(np.abs(step).max()) < CLOSE:
            return beta, shares.T, scores, information
    raise NotDefined(NOT_REACHED)


NOT_REACHED = "no maximum of the likelihood was found"


def no_smaller(meat: Floats, information: Floats) -> Floats:
    """Return the sandwich, raised to the inverse of the information in each direction in which it is less."""
    ratios, directions = eigh(meat, information)
    return np.asarray(directions * np.maximum(ratios, 1.0) @ directions.T)


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
