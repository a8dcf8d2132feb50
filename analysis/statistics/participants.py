"""Tests and intervals in which a participant is the unit: repeated measures, misfit, equivalence, the jackknife.

Repeated measures: orthonormal contrasts, with the epsilon of Huynh and Feldt (1976, J. Educ. Stat. 1, 69-82), from that
of Greenhouse and Geisser (1959, Psychometrika 24, 95-112).
Misfit: deviance beside the spread of participants (McCullagh and Nelder 1989, section 4.5).
Equivalence: two one-sided tests (Schuirmann 1987, J. Pharmacokinet. Biopharm. 15, 657-680). Jackknife: Tukey (1958,
Ann. Math. Stat. 29, 614). Order: the periods of a crossover (Hills and Armitage 1979, Br. J. Clin. Pharmacol. 8, 7-20),
by who had which order drawn (Pitman 1937, Suppl. J. R. Stat. Soc. 4, 119-130).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import helmert
from scipy.special import fdtrc, stdtr, stdtrit

from palpate.analysis.statistics.exact import Floats, Integers, NotDefined, Number, integers
from palpate.analysis.statistics.groups import regrouped
from palpate.analysis.statistics.inference import CONFIDENCE, log_bayes_factor
from palpate.analysis.statistics.sign_flips import DRAWS


@dataclass(frozen=True)
class Repeated:
    """An effect within participants: F, df, Huynh and Feldt's epsilon, and P with it and without, or None.

    `greenhouse_geisser` is the epsilon from which theirs is computed.
    """

    effect: str
    n: int
    f: float | None
    df1: int
    df2: int
    epsilon: float | None
    p: float | None
    p_uncorrected: float | None
    greenhouse_geisser: float | None


def repeated(values: Floats, names: Sequence[str]) -> tuple[Repeated, ...]:
    """Return the repeated-measures ANOVA of values, shape (participants, levels) or (participants, levels, levels).

    It has a line for each named factor and their interaction. Raises `NotDefined` below two participants or levels.
    """
    people, *levels = values.shape
    if people < 2:
        raise NotDefined(f"repeated measures need two participants with every value, got {people}")
    if min(levels) < 2:
        raise NotDefined(f"repeated measures need two levels of {names[levels.index(min(levels))]}, got {min(levels)}")
    means = [np.full((count, 1), 1 / math.sqrt(count)) for count in levels]
    apart = [helmert(count).T for count in levels]
    parts = {names[0]: apart[:1]} if len(levels) == 1 else {
        names[0]: [apart[0], means[1]], names[1]: [means[0], apart[1]], f"{names[0]} x {names[1]}": apart,
    }  # fmt: skip
    flat = values.reshape(people, -1)
    lines = []
    for name, (first, *second) in parts.items():
        projected = flat @ (np.kron(first, second[0]) if second else first)
        df1 = projected.shape[1]
        found = tuple(None if math.isnan(one) else float(one) for one in repeated_tests(projected))
        lines.append(Repeated(name, people, found[0], df1, df1 * (people - 1), *found[1:]))
    return tuple(lines)


def repeated_tests(projected: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return F, epsilon, P with and without it, and Greenhouse and Geisser's epsilon; NaN if all are alike.

    `projected` are contrasts, shape (..., participants, df1).
    """
    people, df1 = projected.shape[-2:]
    mean = projected.mean(axis=-2)
    gaps = projected - mean[..., None, :]
    spread = np.einsum("...pi,...pj->...ij", gaps, gaps)
    trace = np.trace(spread, axis1=-2, axis2=-1)
    varied = trace > 1e-12 * (projected**2).sum(axis=(-2, -1))
    trace = np.where(varied, trace, np.nan)
    f = people * (people - 1) * (mean**2).sum(axis=-1) / trace
    least = np.asarray(trace**2 / (df1 * (spread**2).sum(axis=(-2, -1))))
    # Where the participants are too few for the denominator, the quotient grows beyond all bounds; of two it is 0 / 0.
    above, below = people * df1 * least - 2, df1 * (people - 1 - df1 * least)
    bound = np.where(below > 1e-9, above / np.maximum(below, 1e-9), np.where(above > 1e-9, 1.0, least))
    epsilon = np.where(varied, np.clip(bound, least, 1.0), np.nan)
    df2 = df1 * (people - 1)
    return f, epsilon, fdtrc(epsilon * df1, epsilon * df2, f), fdtrc(df1, df2, f), least


@dataclass(frozen=True)
class Misfit:
    """How far answers lie from a model: F, its deviance beside the spread of participants, on both df, and P."""

    f: float
    df1: int
    df2: int
    p: float


def misfit(counts: Integers, deviance: float, df: int) -> Misfit:
    """Return the test of a model of pooled counts, from counts of shape (participants, presented, answered).

    The spread is Pearson's chi-squared of participants about the pooled shares of answers, over its df, and at least 1:
    that of participants who are alike. Raises `NotDefined` below two participants, or where there is no df.
    """
    pooled = counts.sum(axis=0)
    df2 = (len(counts) - 1) * int((pooled > 0).sum() - (pooled.sum(axis=1) > 0).sum())
    if df < 1 or df2 < 1:
        raise NotDefined(f"a misfit needs degrees of freedom of model and participants, got {df} and {df2}")
    expected = counts.sum(axis=2, keepdims=True) * (pooled / np.maximum(pooled.sum(axis=1, keepdims=True), 1))
    squares = (counts - expected) ** 2 / np.where(expected > 0, expected, 1.0)
    f = deviance / df / max(float(squares.sum()) / df2, 1.0)
    return Misfit(f, df, df2, float(fdtrc(df, df2, f)))


@dataclass(frozen=True)
class Equivalence:
    """Two one-sided t-tests that the mean of `n` values lies within `margin` of 0, either way, on n - 1 df.

    `p` is the larger of both, below alpha exactly where the interval of 1 - 2 alpha, `low` to `high`, lies within the
    margin.
    `log_bf01` is the natural logarithm of the JZS Bayes factor for a mean of 0 over one that differs.
    """

    n: int
    mean: float
    sd: float
    margin: float
    p: float
    low: float
    high: float
    log_bf01: float


def equivalence(values: Floats, margin: float, alpha: float = 0.05) -> Equivalence:
    """Return the equivalence test at `alpha` of participants' values, shape (participants,), with a margin above 0.

    Raises `NotDefined`: with fewer than two participants, or where all have the same value.
    """
    if (people := values.size) < 2:
        raise NotDefined(f"it needs two participants, got {people}")
    mean, sd = float(values.mean()), float(values.std(ddof=1))
    if sd <= 1e-12 * max(1.0, abs(mean)):
        raise NotDefined("there is no variance across participants")
    error = sd / math.sqrt(people)
    reach = float(stdtrit(people - 1, 1 - alpha)) * error
    log_bf01 = -log_bayes_factor(mean / error, people)
    p = float(equivalence_tests(values, margin))
    return Equivalence(people, mean, sd, margin, p, mean - reach, mean + reach, log_bf01)


def equivalence_tests(values: Floats, margin: float) -> Floats:
    """Return P of `equivalence` of studies, from values of shape (..., participants); NaN if all are alike."""
    people = values.shape[-1]
    sd = values.std(axis=-1, ddof=1)
    error = np.where(sd > 1e-12, sd, np.nan) / math.sqrt(people)
    return np.asarray(stdtr(people - 1, (abs(values.mean(axis=-1)) - margin) / error))


@dataclass(frozen=True)
class Order:
    """What being done first adds: half of how far the differences of those with either order lie apart.

    `low` and `high` are Student's limits on n - 2 df. `p`, two-sided, is over all ways to give so many participants
    either order, of which none gives a P below `least`; `error` is its Monte Carlo standard error where these are
    drawn, else None.
    """

    n: int
    value: float
    low: float
    high: float
    p: float
    least: float
    error: float | None


def order_effect(one: Sequence[Number], other: Sequence[Number], rng: np.random.Generator) -> Order:
    """Return what order does to differences of two tasks: of participants who began with `one`, and with the `other`.

    Raises `NotDefined` with fewer than two in either, or where all have the same difference.
    """
    sizes = len(one), len(other)
    if min(sizes) < 2:
        raise NotDefined(f"it needs two participants who began with each task, got {sizes[0]} and {sizes[1]}")
    whole, common = integers([*one, *other])
    values: Floats = np.array(whole, dtype=np.float64)
    gaps = values[: sizes[0]], values[sizes[0] :]
    if np.ptp(values) == 0:
        raise NotDefined("all participants have the same difference between the tasks")
    ways = math.comb(people := sum(sizes), sizes[0])
    if ways <= DRAWS:
        sums = values[np.array(list(combinations(range(people), sizes[0])))].sum(axis=1)
    else:
        sums, _ = regrouped(values, sizes[0], rng)
    apart = abs(people * sums - sizes[0] * values.sum())
    reached = abs(people * gaps[0].sum() - sizes[0] * values.sum())
    hits = int(np.count_nonzero(apart >= reached - 1e-9 * abs(values).max()))
    p = hits / ways if ways <= DRAWS else (hits + 1) / (DRAWS + 1)
    df = people - 2
    pooled = sum(float(((gap - gap.mean()) ** 2).sum()) for gap in gaps) / df
    reach = float(stdtrit(df, (1 + CONFIDENCE) / 2)) * math.sqrt(pooled * (1 / sizes[0] + 1 / sizes[1])) / 2 / common
    value = float(gaps[0].mean() - gaps[1].mean()) / 2 / common
    error = math.sqrt(p * (1 - p) / DRAWS) if ways > DRAWS else None
    return Order(people, value, value - reach, value + reach, p, (1 + (sizes[0] == sizes[1])) / ways, error)


ORDERS = 1999
"""So many orders are drawn for many studies at once, where there are more."""


def order_tests(one: Floats, other: Floats) -> Floats:
    """Return P of `order_effect` of studies, from differences of shape (studies, participants of either order).

    Where there are more than `ORDERS` ways to give the orders, the same `ORDERS` draws serve all studies. NaN if there
    are fewer than two in either, or all have the same difference.
    """
    values = np.concatenate([one, other], axis=1)
    people, first = values.shape[1], one.shape[1]
    if min(first, people - first) < 2:
        return np.full(len(values), np.nan)
    drawn = math.comb(people, first) > ORDERS
    if drawn:
        ranks = np.random.default_rng([people, first]).random((ORDERS, people)).argsort(axis=1)
        chosen = ranks < first
    else:
        chosen = np.array([np.isin(range(people), own) for own in combinations(range(people), first)])
    apart = abs(values @ chosen.T - values.sum(axis=1, keepdims=True) * (first / people))
    reached = abs(one.sum(axis=1) - values.sum(axis=1) * (first / people))
    hits = np.count_nonzero(apart >= reached[:, None] - 1e-9, axis=1)
    p = (hits + drawn) / (len(chosen) + drawn)
    return np.where(np.ptp(values, axis=1) > 1e-12, p, np.nan)


@dataclass(frozen=True)
class Jackknife:
    """An estimate corrected for its bias, with its standard error and the limits of Student's t at `confidence`."""

    value: float
    error: float
    low: float
    high: float
    confidence: float


def jackknife(observed: float, left_out: Floats) -> Jackknife:
    """Return the jackknife of a statistic from its values with each participant left out, shape (participants,).

    Raises `NotDefined`: with fewer than two participants, or where leaving out any of them changes nothing.
    """
    if (people := left_out.size) < 2:
        raise NotDefined(f"a jackknife needs 2 participants, got {people}")
    error = math.sqrt((people - 1) * float(left_out.var()))
    if error <= 1e-12 * max(1.0, abs(observed)):
        raise NotDefined("there is no variance across participants, so the jackknife has no interval")
    value = people * observed - (people - 1) * float(left_out.mean())
    reach = float(stdtrit(people - 1, (1 + CONFIDENCE) / 2)) * error
    return Jackknife(value, error, value - reach, value + reach, CONFIDENCE)


@dataclass(frozen=True)
class Mean:
    """The mean of a value of each participant, with its interval by Student's t; None for one participant."""

    n: int
    value: float
    sd: float | None
    low: float | None
    high: float | None


def mean(values: Floats) -> Mean:
    """Return the mean over participants, shape (n,), n at least 1."""
    n, centre = len(values), float(np.mean(values))
    if n < 2:
        return Mean(n, centre, None, None, None)
    sd = float(np.std(values, ddof=1))
    half = float(stdtrit(n - 1, (1 + CONFIDENCE) / 2)) * sd / n**0.5
    return Mean(n, centre, sd, centre - half, centre + half)
