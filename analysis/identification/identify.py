"""Identification of one task: intervals of every ratio, information, d', similarities and biases, and a map."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from statistics import mean

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.identification import confusion as confusions
from palpate.analysis.identification import maps
from palpate.analysis.identification.companion_tests import LINKED
from palpate.analysis.identification.maps import Choice, Mantel, Scaling
from palpate.analysis.statistics import inference, lapses
from palpate.analysis.statistics.exact import NotDefined, Statements, defined
from palpate.analysis.statistics.participants import Jackknife, Misfit, jackknife, misfit
from palpate.analysis.statistics.psychophysics import information as transmission
from palpate.analysis.statistics.shares import Limits, modelled, population_limits, share_limits

CHOICE_RESAMPLES = 999
CHOICE_TOLERANCE = 1e-3
"""Tolerance for resamples of the choice model, because an estimate on the edge converges slowly."""


@dataclass(frozen=True)
class Cell:
    """Intervals of one cell: of `count` in `trials`, pooled; of the mean ratio among participants, and of any such."""

    presented: str
    answered: str
    count: int
    trials: int
    wilson: inference.ConfidenceInterval | None
    clopper_pearson: inference.ConfidenceInterval | None
    interval: Limits | None
    any_population: Limits | None
    statement: str


@dataclass(frozen=True)
class Detection:
    """d' of the mean share of correct answers (`proportion`); `moved` had a share of 0 or 1 moved by half a trial.

    The interval is the share's, transformed, and not that of the mean d'.
    """

    alternatives: int
    proportion: float
    d_prime: float | None
    interval: Limits | None
    by_participant: Mapping[str, float]
    moved: tuple[str, ...]
    statement: str


@dataclass(frozen=True)
class ChoiceIntervals:
    """The choice model with percentile intervals of similarities (M, M, 2) and biases (M, 2) from `used` resamples."""

    model: Choice
    misfit: Misfit | None
    similarities: NDArray[np.float64] | None
    biases: NDArray[np.float64] | None
    used: int
    statement: str


@dataclass(frozen=True)
class BiasedLapses:
    """The lapse model with jackknives or None; the share each participant knew, and those not shown to know."""

    model: lapses.Lapses
    lapse: Jackknife | None
    lapses: tuple[Jackknife | None, ...]
    biases: tuple[Jackknife | None, ...]
    known: Mapping[str, float]
    guessing: tuple[str, ...]


@dataclass(frozen=True)
class Identification:
    """What the confusion matrix of one task says beyond its ratios; `statements` say why something is not defined."""

    task: str
    cells: tuple[Cell, ...]
    information: transmission.Information | None
    jackknife: Jackknife | None
    detection: Detection | None
    choice: ChoiceIntervals | None
    lapses: BiasedLapses | None
    scaling: Scaling | None
    mantel: Mantel | None
    statements: Mapping[str, str]


def identify(
    task: str, matrix: confusions.Confusion, dissimilarities: NDArray[np.float64] | None, rng: np.random.Generator
) -> Identification:
    """Return everything for one task; `dissimilarities` of its materials, shape (M, M), may be missing."""
    said = Statements()
    counts = matrix.counts if matrix.unanswered else matrix.counts[:, :, :-1]
    bits = said.compute("information", lambda: transmission.information(counts.sum(axis=0)))
    # In this order, for some of them draw.
    return Identification(
        task=task,
        information=bits,
        jackknife=said.compute("information interval", lambda: _information(matrix, counts, bits)) if bits else None,
        choice=said.compute("choice", lambda: _choice(_whole(matrix), rng)),
        lapses=said.compute("lapses", lambda: _lapses(_whole(matrix))),
        scaling=said.compute("scaling", lambda: maps.classical(maps.from_confusions(_whole(matrix).means()[:, :-1]))),
        mantel=said.compute("mantel", lambda: maps.mantel(dissimilarities, _confusing(_whole(matrix)), rng))
        if dissimilarities is not None
        else None,
        cells=tuple(_cells(matrix)),
        detection=said.compute("d'", lambda: _detection(_whole(matrix))),
        statements=said,
    )


def without_joining(found: Identification) -> Identification:
    """Return what no participant's rows need to be joined for, as in a reconstruction, where that is arbitrary."""
    choice, lapsed, detection = found.choice, found.lapses, found.detection
    none = (None,) * len(lapsed.lapses if lapsed else ())
    return replace(
        found,
        jackknife=None,
        choice=choice and replace(choice, similarities=None, biases=None, used=0, statement=""),
        lapses=lapsed and replace(lapsed, lapse=None, lapses=none, biases=none, known={}, guessing=()),
        detection=detection and replace(detection, interval=None, by_participant={}, moved=()),
        statements={**found.statements, "joined": LINKED},
    )


def _whole(matrix: confusions.Confusion) -> confusions.Confusion:
    """Return a matrix with every row: without one, a liking for an answer cannot be told from knowing its material."""
    if matrix.absent:
        raise NotDefined(f"it needs every material, but {', '.join(matrix.absent)} is not presented in this task")
    return matrix


def _lapses(matrix: confusions.Confusion) -> BiasedLapses:
    """Return the lapse model of named materials; a participant's knowledge takes the biases of everybody."""
    counts = matrix.counts[:, :, :-1]
    pooled = counts.sum(axis=0)
    model = lapses.fit(pooled)
    guessed, biases = lapses.fits(pooled - counts)
    trials = pooled.sum(axis=1) - counts.sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_material = guessed / trials
        whole = guessed.sum(axis=1) / trials.sum(axis=1)
    right = np.diagonal(counts, axis1=1, axis2=2)
    known, ratio = lapses.knowing(right, counts.sum(axis=2), model.biases)
    return BiasedLapses(
        model,
        _limits(model.lapse, whole),
        tuple(_limits(float(one), of) for one, of in zip(model.lapses, by_material.T, strict=True)),
        tuple(_limits(float(one), of) for one, of in zip(model.biases, biases.T, strict=True)),
        dict(zip(matrix.participants, known.tolist(), strict=True)),
        tuple(who for who, one in zip(matrix.participants, ratio, strict=True) if one < lapses.GUESSES),
    )


def _limits(observed: float, left_out: NDArray[np.float64]) -> Jackknife | None:
    try:
        found = jackknife(observed, left_out) if np.isfinite(left_out).all() else None
        return found and replace(found, low=max(found.low, 0.0))
    except NotDefined:
        return None


def _cells(matrix: confusions.Confusion) -> list[Cell]:
    pooled = matrix.counts.sum(axis=0)
    cells = []
    for i in matrix.presented:
        presented = matrix.materials[i]
        for j, answered in enumerate(matrix.materials):
            count, trials = int(pooled[i, j]), int(pooled[i].sum())
            if not trials:
                cells.append(Cell(presented, answered, 0, 0, None, None, None, None, "this material was not presented"))
                continue
            own = matrix.counts[:, i, j], matrix.trials[:, i]
            (limits, why), (anybody, _) = (
                defined(partial(share_limits, *own)),
                defined(partial(population_limits, *own)),
            )
            exact = inference.wilson(count, trials), inference.clopper_pearson(count, trials)
            cells.append(Cell(presented, answered, count, trials, *exact, limits, anybody, why))
    return cells


def _information(matrix: confusions.Confusion, counts: NDArray[np.int64], found: transmission.Information) -> Jackknife:
    right = np.trace(matrix.counts[:, :, :-1], axis1=1, axis2=2)
    return transmission.information_limits(counts, found, modelled(right, matrix.trials.sum(axis=1)))


def _detection(matrix: confusions.Confusion) -> Detection:
    trials = matrix.trials.sum(axis=1)
    right = np.trace(matrix.counts[:, :, :-1], axis1=1, axis2=2)
    count = len(matrix.materials)
    shares = [Fraction(n, total) for n, total in zip(right.tolist(), trials.tolist(), strict=True)]
    known = {
        label: confusions.corrected(n, total)
        for label, n, total in zip(matrix.participants, right.tolist(), trials.tolist(), strict=True)
        if total > 1
    }
    proportion = float(mean(shares))
    value, why = defined(partial(confusions.d_prime, proportion, count))
    limits, missing = defined(partial(share_limits, right, trials))
    values = {share: confusions.d_prime(share, count) for share in set(known.values())}
    by_participant = {label: values[share] for label, share in known.items()}
    moved = tuple(label for label, n, total in zip(matrix.participants, right, trials, strict=True) if n in (0, total))
    return Detection(
        count,
        proportion,
        value,
        limits and Limits(_transformed(limits.low, count), _transformed(limits.high, count)),
        by_participant,
        moved,
        "; ".join(filter(None, (why, missing))),
    )


def _transformed(share: float | None, count: int) -> float | None:
    return None if share is None else confusions.d_prime(share, count)


def _choice(matrix: confusions.Confusion, rng: np.random.Generator) -> ChoiceIntervals:
    counts = matrix.counts[:, :, :-1]
    model = maps.similarity_choice(counts.sum(axis=0), matrix.materials)
    astray, _ = defined(partial(misfit, counts, model.g2, model.df))
    weights, why = defined(lambda: inference.resamples(len(counts), CHOICE_RESAMPLES, rng))
    if weights is None:
        return ChoiceIntervals(model, astray, None, None, 0, why)
    drawn = np.tensordot(weights, counts, axes=1)
    drawn = drawn[(np.diagonal(drawn, axis1=1, axis2=2) > 0).all(axis=1)]
    similarities, biases, _, settled = maps.fit(drawn, CHOICE_TOLERANCE)
    ends = [(1 - inference.CONFIDENCE) / 2, (1 + inference.CONFIDENCE) / 2]
    used = int(settled.sum())
    lost = f"{CHOICE_RESAMPLES - used} of {CHOICE_RESAMPLES} resamples have no fit and are left out"
    statement = lost if used < CHOICE_RESAMPLES else ""
    if not used:
        return ChoiceIntervals(model, astray, None, None, 0, statement)
    limits = [np.moveaxis(np.quantile(part[settled], ends, axis=0), 0, -1) for part in (similarities, biases)]
    biased = limits[1] if model.biases is not None else None
    return ChoiceIntervals(model, astray, limits[0], biased, used, statement)


def _confusing(matrix: confusions.Confusion) -> NDArray[np.float64]:
    """Return the mean of both confusing ratios of every pair, shape (M, M)."""
    ratios = matrix.means()[:, :-1]
    if np.isnan(ratios).any():
        raise NotDefined("a material was never presented, so its confusions are not defined")
    return np.asarray((ratios + ratios.T) / 2)
