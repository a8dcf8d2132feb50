"""Single trials: was the answer right, as a logit of task, material and what went with the trial.

Two ways of allowing for trials of one participant being alike, participants who did several tasks included. GEE
(Liang and Zeger 1986): odds in the population, one correlation within a participant, standard errors of Mancl and
DeRouen (2001) for few participants; statsmodels'. Mixed logit: odds for one participant, a random intercept each, by
maximum likelihood (`analysis.mixed_logit`: statsmodels has it by variational Bayes alone, whose standard deviations
are too small by construction, and which takes minutes and a gigabyte for a thousand participants).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.exact import NotDefined
from analysis.mixed_logit import fit
from analysis.trials import Design

LEAST = 6
"""Participants, below which standard errors by participant say nothing."""

LARGEST = 12.0
"""A log odds ratio beyond this is taken as one without limit; a standard error beyond it says nothing."""

SINGULAR = 1e-10
"""A covariance, in units of its variances, with an eigenvalue below this is taken as one without an inverse."""


@dataclass(frozen=True)
class Coefficient:
    """A log odds ratio with its standard error, 95 % interval and two-sided P."""

    name: str
    estimate: float
    error: float
    low: float
    high: float
    p: float


@dataclass(frozen=True)
class Term:
    """Wald's test that all coefficients of a term are zero."""

    name: str
    chi2: float
    df: int
    p: float


@dataclass(frozen=True)
class TrialModel:
    """A fitted model; `spread` is GEE's correlation within a participant, or the SD of the random intercepts.

    `warned` is what the software said on the way to a fit that converged.
    """

    trials: int
    participants: int
    coefficients: tuple[Coefficient, ...]
    terms: tuple[Term, ...]
    spread: float
    warned: tuple[str, ...] = ()


def gee(design: Design) -> TrialModel:
    """Population-averaged logit, exchangeable within participants.

    Raises:
        NotDefined: with too few participants for the parameters, where it does not converge, and where participants do
            not differ enough for standard errors.
    """
    people = _participants(design)

    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.families import Binomial
    from statsmodels.genmod.generalized_estimating_equations import GEE

    structure = Exchangeable()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        model = GEE(design.correct, design.matrix, groups=design.participants, family=Binomial(), cov_struct=structure)
        fitted = model.fit(cov_type="bias_reduced", maxiter=200)
        estimates, covariance = np.asarray(fitted.params), np.asarray(fitted.cov_params())
    warned = tuple(dict.fromkeys(str(one.message) for one in heard))
    if not fitted.converged:
        raise NotDefined(f"the GEE logit does not converge ({'; '.join(warned)})")
    _bounded(design, estimates)
    if not _positive(covariance):
        raise NotDefined(
            "standard errors by participant are not defined for the GEE logit: participants answered too much alike, "
            "or terms cannot be told apart"
        )
    coefficients = _coefficients(design, estimates, np.sqrt(np.diag(covariance)))
    terms = tuple(_wald(name, estimates, covariance, columns) for name, columns in design.terms.items())
    return TrialModel(len(design.correct), people, coefficients, terms, float(structure.dep_params), warned)


def mixed(design: Design) -> TrialModel:
    """Logit with a random intercept a participant.

    Raises:
        NotDefined: with too few participants for the parameters, or where it does not converge.
    """
    people = _participants(design)

    found = fit(correct=design.correct, matrix=design.matrix, participants=design.participants)
    coefficients = _coefficients(design, found.coefficients, np.sqrt(np.diag(found.covariance)))
    terms = tuple(_wald(name, found.coefficients, found.covariance, columns) for name, columns in design.terms.items())
    return TrialModel(len(design.correct), people, coefficients, terms, found.sd)


def _participants(design: Design) -> int:
    people = int(design.participants.max()) + 1
    least = max(LEAST, len(design.names) + 1)
    if people < least:
        raise NotDefined(
            f"a trial-level model of {len(design.names)} parameters needs {least} participants, got {people}"
        )
    return people


def _coefficients(
    design: Design, estimates: NDArray[np.float64], errors: NDArray[np.float64]
) -> tuple[Coefficient, ...]:
    from scipy.special import ndtr, ndtri

    _bounded(design, estimates)
    if not (np.isfinite(errors).all() and errors.max() < LARGEST):
        vague = ", ".join(
            name for name, error in zip(design.names, errors.tolist(), strict=True) if not error < LARGEST
        )
        raise NotDefined(f"standard errors beyond {LARGEST:g} say nothing: {vague}")
    reach = float(ndtri(0.975))
    return tuple(
        Coefficient(
            name, value, error, value - reach * error, value + reach * error, float(2 * ndtr(-abs(value) / error))
        )
        for name, value, error in zip(design.names, estimates.tolist(), errors.tolist(), strict=True)
    )


def _bounded(design: Design, estimates: NDArray[np.float64]) -> None:
    endless = [name for name, value in zip(design.names, estimates.tolist(), strict=True) if not abs(value) < LARGEST]
    if endless:
        raise NotDefined(
            f"the odds of {', '.join(endless)} have no limit, as where answers are all right, or all wrong"
        )


def _positive(covariance: NDArray[np.float64]) -> bool:
    """Whether it is positive definite beyond rounding."""
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variances > 0).all()):
        return False
    return bool(np.linalg.eigvalsh(covariance / np.sqrt(np.outer(variances, variances))).min() > SINGULAR)


def _wald(name: str, estimates: NDArray[np.float64], covariance: NDArray[np.float64], columns: tuple[int, ...]) -> Term:
    from scipy.special import chdtrc

    chosen = list(columns)
    part = estimates[chosen]
    chi2 = float(part @ np.linalg.solve(covariance[np.ix_(chosen, chosen)], part))
    return Term(name, chi2, len(chosen), float(chdtrc(len(chosen), chi2)))
