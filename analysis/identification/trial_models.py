"""Models of single trials: was the answer right, as a logit of task, material and what went with the trial.

GEE (Liang and Zeger 1986; statsmodels) has one correlation within a participant, standard errors of Kauermann and
Carroll (2001), and Hotelling's F. The mixed logit has a normal random intercept for each participant, by maximum
likelihood and adaptive Gauss-Hermite quadrature (Liu and Pierce 1994, Biometrika 81, 624-629; Pinheiro and Bates 1995,
equation (2.12)). Covariates are used if half of the trials of every task and material have them; trials without are
left out and counted.
"""

import math
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from palpate.analysis.reading.study import Study
from palpate.analysis.statistics.exact import Floats, NotDefined, Statements, defined

TRIAL, FASTER, LATER = "10 trials on", "foot 100 mm/s faster", "a task after the first"
FORCE, HARDER = "foot_force_n", "foot 10 N harder"
COVARIATES = {"trial": (TRIAL, 10.0), "foot_speed_mm_s": (FASTER, 100.0), FORCE: (HARDER, 10.0)}
"""Column -> the name of one step, and how many units one step is.

The force of the foot is one where any was recorded. The response time is none: it comes after the stimulus, and what it
explains is taken from material and task.
"""


@dataclass(frozen=True)
class Design:
    """N trials: right (1) or not (0), index of the participant, and the matrix, shape (N, parameters).

    `names` are those of the parameters, intercept first; covariates are centered. `terms` gives columns tested
    together, `absent` why a term is not used; `left_out` counts trials without a covariate, `gone` names participants
    without a trial.
    """

    correct: NDArray[np.float64]
    participants: NDArray[np.int64]
    names: tuple[str, ...]
    matrix: NDArray[np.float64]
    terms: Mapping[str, tuple[int, ...]]
    absent: Mapping[str, str]
    left_out: Mapping[str, int]
    gone: tuple[str, ...]


def design(study: Study) -> Design:
    """Return the design of the included trials. Raises `NotDefined` without trials, or for answers all alike."""
    if study.origin == "RECONSTRUCTION":
        raise NotDefined(
            "a reconstruction has no trial order, foot speeds, response times or task order, and its assignment of "
            "rows to participants is arbitrary"
        )
    if not study.ordered:
        raise NotDefined("counts have no trial order, foot speeds or response times")
    table = study.attempts.loc[study.attempts["included"]]
    if table.empty:
        raise NotDefined("no trials remain")
    columns, absent = _covariates(study, table)
    whole = _thinned(columns, absent, _groups(study, table))
    left_out = Counter(table["task"].to_numpy()[~whole].tolist())
    everyone = dict.fromkeys(table["participant"].tolist())
    table = table.iloc[np.flatnonzero(whole)]
    correct = np.array(table["presented"].to_numpy() == table["answered"].to_numpy(), dtype=np.float64)
    matrix = np.ones((len(table), 1))
    names = ["intercept"]
    terms: dict[str, tuple[int, ...]] = {}
    blocks: list[tuple[str, list[str], NDArray[np.float64]]] = []
    for term, column, order in _factors(study):
        labels = table[column].to_numpy()
        occurring = set(labels.tolist())
        levels = [level for level in order if level in occurring]
        for level in levels:
            if len(set(correct[labels == level].tolist())) < 2:
                kind = "right" if correct[labels == level].all() else "wrong"
                raise NotDefined(f"every answer to {term} {level} is {kind}, so its odds are infinite or zero")
        if len(levels) > 1:
            named = [f"{level} (against {levels[0]})" for level in levels[1:]]
            blocks.append((term, named, np.column_stack([labels == level for level in levels[1:]]).astype(np.float64)))
    for name, values in columns.items():
        kept = values[whole]
        if np.ptp(kept) == 0:
            absent[name] = "it is the same in every trial"
        else:
            blocks.append((name, [name], (kept - kept.mean())[:, None]))
    for term, named, block in blocks:
        wider = np.column_stack([matrix, block])
        if np.linalg.matrix_rank(wider) < wider.shape[1]:
            absent[term] = f"these trials cannot separate it from {', '.join(terms)}"
            continue
        terms[term] = tuple(range(len(names), len(names) + len(named)))
        names += named
        matrix = wider
    places, people = pd.factorize(table["participant"])
    left = set(people)
    gone = tuple(label for label in everyone if label not in left)
    return Design(correct, places.astype(np.int64), tuple(names), matrix, terms, absent, left_out, gone)


def _factors(study: Study) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    """Return the name, the column and the levels in order of each factor."""
    return ("task", "task", tuple(task.id for task in study.tasks)), ("material", "presented", study.materials)


def _groups(study: Study, table: pd.DataFrame) -> dict[str, NDArray[np.bool_]]:
    """Return words for a part of the trials and which they are: all, those of each task, and of each material."""
    found = {"trials": np.ones(len(table), dtype=np.bool_)}
    for term, column, order in _factors(study):
        labels = table[column].to_numpy()
        found |= {f"trials of {term} {level}": np.asarray(labels == level) for level in order}
    return found


def _thinned(
    columns: dict[str, NDArray[np.float64]], absent: dict[str, str], groups: Mapping[str, NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Return which trials have every covariate; those that leave less than half of a group move to `absent`."""
    for name in list(columns):
        known = np.asarray(np.isfinite(columns[name]))
        for group, inside in groups.items():
            if 2 * known[inside].sum() < inside.sum():
                absent[name] = f"it is known for {known[inside].sum()} of {inside.sum()} {group}"
                del columns[name]
                break
    return np.asarray(np.array([groups["trials"], *map(np.isfinite, columns.values())]).all(axis=0))


def _covariates(study: Study, table: pd.DataFrame) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """Return each covariate, one value a trial, in steps, NaN if it is not known; and why one is missing."""
    absent: dict[str, str] = {}
    found = {
        name: table[column].to_numpy(dtype=np.float64) / step
        for column, (name, step) in COVARIATES.items()
        if column != FORCE or table[column].notna().any()
    }
    pairs = zip(table["participant"].tolist(), table["task"].tolist(), strict=True)
    later = np.array(
        [float(study.first_tasks[who] != task) if who in study.first_tasks else np.nan for who, task in pairs]
    )
    if len(study.tasks) < 2:
        absent[LATER] = "the study has only one task"
    elif np.isfinite(later).all():
        found[LATER] = later
    else:
        absent[LATER] = "the task order is not known for every participant"
    return found, absent


NODES = 15
"""The nodes of the quadrature."""

NEWTON_STEPS = 50
MODE_TOLERANCE = 1e-10
GRADIENT_TOLERANCE = 1e-6
"""The largest gradient of the mean log likelihood of a trial at its maximum."""

DIFFERENCE = 1e-4
"""The step of the central differences of gradients that make the Hessian."""

START_SD = 0.5

HELD = 16_384
"""So many trials stay in a processor's cache while their likelihood is computed."""


def log_likelihood(
    *, correct: Floats, matrix: Floats, participants: NDArray[np.int64], coefficients: Floats, sd: float
) -> tuple[float, Floats]:
    """Return the log likelihood and its derivatives by coefficients and `sd`, (K + 1,); the matrix is (N, K)."""
    people = int(participants.max()) + 1
    fixed = matrix @ coefficients
    mode, width = _modes(correct, fixed, participants, people, sd)
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    at = mode + width * nodes[:, None]
    # log of each node's share: answers, standard normal, and what the change of variable leaves of the quadrature.
    shares = np.log(weights)[:, None] + nodes[:, None] ** 2 / 2 - at**2 / 2 + np.log(width) - math.log(2 * math.pi) / 2
    # Odds of the answer that was given.
    sign = np.where(correct > 0, 1.0, -1.0)
    given = sign * fixed
    left = np.empty((NODES, correct.size))
    for k, u in enumerate(sd * at):
        odds = given + sign * u[participants]
        unlikely = np.exp(-np.abs(odds))
        shares[k] -= np.bincount(participants, np.log1p(unlikely) - np.minimum(odds, 0.0), minlength=people)
        left[k] = np.where(odds > 0, unlikely, 1.0) / (1 + unlikely)
    top = shares.max(axis=0)
    posterior = np.exp(shares - top)
    total = posterior.sum(axis=0)
    posterior /= total
    by_trial, moved = np.zeros(correct.size), np.zeros(correct.size)
    for own, share, u in zip(left, posterior, at, strict=True):
        by_trial += own * share[participants]
        moved += own * (share * u)[participants]
    return float((top + np.log(total)).sum()), np.append((sign * by_trial) @ matrix, sign @ moved)


def _modes(
    correct: Floats, fixed: Floats, participants: NDArray[np.int64], people: int, sd: float
) -> tuple[Floats, Floats]:
    """Return each participant's mode of u given the answers, and 1 / sqrt of its curvature, by Newton's method."""
    from scipy.special import expit

    u = np.zeros(people)
    for _ in range(NEWTON_STEPS):
        p = expit(fixed + sd * u[participants])
        slope = sd * np.bincount(participants, correct - p, minlength=people) - u
        curvature = 1 + sd * sd * np.bincount(participants, p * (1 - p), minlength=people)
        step = np.clip(slope / curvature, -1.0, 1.0)
        u += step
        if np.abs(step).max() < MODE_TOLERANCE:
            break
    return u, 1 / np.sqrt(curvature)


LEAST = 6
"""The fewest participants whose standard errors say anything."""

LARGEST = 12.0
"""A log odds ratio beyond this counts as one without limit; a standard error beyond it says nothing."""

SINGULAR = 1e-10
"""A covariance in units of its variances has no inverse if an eigenvalue is below this."""

NO_ERRORS = (
    "participant-level standard errors are not defined for the GEE logit: participants answered too similarly, or "
    "terms cannot be separated"
)


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
    """Wald's test that all coefficients of a term are zero: chi-squared, or F where `df2` says on how many df."""

    name: str
    statistic: float
    df: int
    df2: int | None
    p: float


@dataclass(frozen=True)
class TrialModel:
    """A fitted model, GEE's correlation or the SD of random intercepts as `spread`, and warnings of the fit."""

    trials: int
    participants: int
    coefficients: tuple[Coefficient, ...]
    terms: tuple[Term, ...]
    spread: float
    warned: tuple[str, ...] = ()


def gee(design: Design) -> TrialModel:
    """Return the population-averaged logit, exchangeable within participants.

    Raises `NotDefined` for too few or too similar participants, or without convergence.
    """
    people = _participants(design)
    # Decided before the fit: what a fit says of a singular matrix depends on the processor.
    if np.linalg.matrix_rank(design.matrix) < design.matrix.shape[1]:
        raise NotDefined(NO_ERRORS)
    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.families import Binomial
    from statsmodels.genmod.generalized_estimating_equations import GEE

    structure = Exchangeable()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        model = GEE(design.correct, design.matrix, groups=design.participants, family=Binomial(), cov_struct=structure)
        fitted = model.fit(maxiter=200)
        estimates, alike = np.asarray(fitted.params), float(structure.dep_params)
    warned = tuple(dict.fromkeys(str(one.message) for one in heard))
    if not fitted.converged:
        raise NotDefined(f"the GEE logit does not converge ({'; '.join(warned)})")
    _bounded(design, estimates)
    covariance = _of_few(design, estimates, alike)
    if not _positive(covariance):
        raise NotDefined(NO_ERRORS)
    return _model(design, people, estimates, covariance, alike, warned, few=True)


def _of_few(design: Design, estimates: Floats, alike: float) -> Floats:
    """Return the covariance of Kauermann and Carroll (2001, J. Am. Stat. Assoc. 96, 1387-1396), trials `alike`."""
    share = 1 / (1 + np.exp(-design.matrix @ estimates))
    root = np.sqrt(share * (1 - share))[:, None]
    rows = np.column_stack([design.matrix * root, (design.correct[:, None] - share[:, None]) / root])
    rows = rows[np.argsort(design.participants, kind="stable")]
    own = np.split(rows, np.cumsum(np.bincount(design.participants))[:-1])
    sums = np.array([one.sum(axis=0) for one in own])
    common = alike / (1 + (np.array([len(one) for one in own]) - 1) * alike)
    grams = np.array([one.T @ one for one in own]) - common[:, None, None] * sums[:, :, None] * sums[:, None, :]
    slopes, scores = grams[:, :-1, :-1] / (1 - alike), grams[:, :-1, -1] / (1 - alike)
    naive = np.linalg.inv(slopes.sum(axis=0))
    if not _positive(naive):
        raise NotDefined(NO_ERRORS)
    lower = np.linalg.cholesky(naive)
    drawn, axes = np.linalg.eigh(lower.T @ slopes @ lower)
    if drawn.max() > 1 - SINGULAR:
        raise NotDefined(NO_ERRORS)
    turned = np.einsum("pij,pi->pj", axes, scores @ lower) / np.sqrt(1 - drawn)
    errors = np.einsum("pij,pj->pi", axes, turned) @ lower.T
    return np.asarray(errors.T @ errors)


def mixed(design: Design) -> TrialModel:
    """Return the logit with a random intercept for each participant, whose SD is estimated too.

    Raises `NotDefined` for too few participants, dependent columns, no convergence, or a flat maximum.
    """
    from scipy.optimize import minimize

    people, trials, count = _participants(design), design.correct.size, design.matrix.shape[1]
    even, mixing = np.linalg.qr(design.matrix)
    size = np.abs(np.diag(mixing))
    if size.min() <= 1e-10 * size.max():
        raise NotDefined("some terms of the mixed logit cannot be separated from the others")
    even, mixing = even * np.sqrt(len(even)), mixing / np.sqrt(len(even))

    parts = [
        {"correct": design.correct[part], "matrix": even[part], "participants": own - own.min()}
        for part in _parts(design.participants)
        for own in [design.participants[part]]
    ]

    def lost(parameters: Floats) -> tuple[float, Floats]:
        found = [log_likelihood(**part, coefficients=parameters[:-1], sd=parameters[-1]) for part in parts]
        values, gradients = zip(*found, strict=True)
        return -sum(values) / trials, -np.sum(gradients, axis=0) / trials

    start = np.append(np.zeros(count), START_SD)
    found = minimize(lost, start, jac=True, method="BFGS", options={"gtol": GRADIENT_TOLERANCE})
    if not np.isfinite(found.x).all() or np.abs(found.jac).max() > 10 * GRADIENT_TOLERANCE:
        raise NotDefined("the mixed logit does not converge")
    steps = DIFFERENCE * np.eye(count + 1)
    rows = [(lost(found.x + step)[1] - lost(found.x - step)[1]) / (2 * DIFFERENCE) for step in steps]
    information = trials * (np.array(rows) + np.array(rows).T) / 2
    if np.linalg.eigvalsh(information)[0] <= 0:
        raise NotDefined("the likelihood of the mixed logit is flat at its maximum")
    back = np.linalg.inv(mixing)
    covariance: Floats = (back @ np.linalg.inv(information)[:count, :count] @ back.T).astype(np.float64)
    return _model(design, people, back @ found.x[:count], covariance, abs(float(found.x[-1])))


def _parts(participants: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the places of the trials of participants one after another, in parts of some `HELD` trials."""
    order = np.argsort(participants, kind="stable")
    ends = np.cumsum(np.bincount(participants))
    cuts = ends[np.unique(np.searchsorted(ends, np.arange(HELD, participants.size, HELD)))]
    return [part for part in np.split(order, cuts) if part.size]


def _participants(design: Design) -> int:
    people = int(design.participants.max()) + 1
    least = max(LEAST, len(design.names) + 1)
    if people < least:
        raise NotDefined(
            f"a trial-level model of {len(design.names)} parameters needs {least} participants, got {people}"
        )
    return people


def _model(
    design: Design,
    people: int,
    estimates: Floats,
    covariance: Floats,
    spread: float,
    warned: tuple[str, ...] = (),
    *,
    few: bool = False,
) -> TrialModel:
    """Return the model of these estimates, with Wald's tests that all coefficients of a term are zero.

    With `few`, t has n - 1 df, and (n - q) / (q (n - 1)) of Hotelling's statistic of q coefficients is F on q and n - q
    df.
    """
    from scipy.special import chdtrc, fdtrc, ndtr, ndtri, stdtr, stdtrit

    _bounded(design, estimates)
    errors = np.sqrt(np.diag(covariance))
    if not (np.isfinite(errors).all() and errors.max() < LARGEST):
        vague = [name for name, error in zip(design.names, errors.tolist(), strict=True) if not error < LARGEST]
        raise NotDefined(f"standard errors above {LARGEST:g} are uninformative: {', '.join(vague)}")
    reach = float(stdtrit(people - 1, 0.975) if few else ndtri(0.975))
    coefficients = tuple(
        Coefficient(
            name,
            value,
            error,
            value - reach * error,
            value + reach * error,
            float(2 * (stdtr(people - 1, -abs(value) / error) if few else ndtr(-abs(value) / error))),
        )
        for name, value, error in zip(design.names, estimates.tolist(), errors.tolist(), strict=True)
    )
    terms = []
    for name, columns in design.terms.items():
        part = estimates[list(columns)]
        wald, df = float(part @ np.linalg.solve(covariance[np.ix_(columns, columns)], part)), len(columns)
        if few:
            f, df2 = wald * (people - df) / (df * (people - 1)), people - df
            terms.append(Term(name, f, df, df2, float(fdtrc(df, df2, f))))
        else:
            terms.append(Term(name, wald, df, None, float(chdtrc(df, wald))))
    return TrialModel(len(design.correct), people, coefficients, tuple(terms), spread, warned)


def _bounded(design: Design, estimates: Floats) -> None:
    endless = [name for name, value in zip(design.names, estimates.tolist(), strict=True) if not abs(value) < LARGEST]
    if endless:
        raise NotDefined(f"the odds of {', '.join(endless)} have no finite limit: answers are all right or all wrong")


def _positive(covariance: Floats) -> bool:
    """Return whether the covariance is positive definite beyond rounding."""
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variances > 0).all()):
        return False
    return bool(np.linalg.eigvalsh(covariance / np.sqrt(np.outer(variances, variances))).min() > SINGULAR)


@dataclass(frozen=True)
class TrialLevel:
    """Both models of single trials; `statements` say why one is None. The rest is that of `Design`."""

    gee: TrialModel | None
    mixed: TrialModel | None
    absent: Mapping[str, str]
    left_out: Mapping[str, int]
    gone: tuple[str, ...]
    statements: Mapping[str, str]


def trial_level(study: Study) -> TrialLevel:
    """Return both models of the included trials of a study."""
    trials, why = defined(lambda: design(study))
    if trials is None:
        return TrialLevel(None, None, {}, {}, (), {"GEE logit and mixed logit": why})
    said = Statements()
    models = said.compute("GEE logit", lambda: gee(trials)), said.compute("mixed logit", lambda: mixed(trials))
    return TrialLevel(*models, trials.absent, trials.left_out, trials.gone, said)
