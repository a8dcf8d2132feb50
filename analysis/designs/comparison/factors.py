"""What of a stimulus carries the quality that was compared: a scale of Bradley and Terry with the factors of stimuli.

Where a protocol has `[[factors]]`, or else states the same numbers of every stimulus, and at least two of them vary, a
choice follows from them: P(first) = F(sum over factors of (effect of the first's level - effect of the second's) +
order), F the logistic. The main effects have one effect a level, the lowest 0; the slopes one effect a doubling, or, of
a factor with a value of 0 or less, one from its lowest value to its highest. Participants are the units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from palpate.analysis.designs.comparison.estimates import Estimate, estimate
from palpate.analysis.statistics import scaling
from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.scaling import Comparisons

Numbers = Mapping[str, Mapping[str, float]]
"""The numbers of each material's stimulus, by their keys."""


@dataclass(frozen=True)
class Factor:
    """A number that varies: its levels, rising, what each adds to the lowest, and what a doubling adds, if it has one.

    `across` is what the slope adds from the lowest level to the highest.
    """

    name: str
    levels: tuple[float, ...]
    effects: tuple[Estimate, ...]
    doubling: Estimate | None
    across: Estimate


@dataclass(frozen=True)
class Factored:
    """The factors of a task, or why there is none: `apart` is what a doubling of the first adds beyond the second's.

    It is None where either has no doublings.

    `p` is that of the main effects' deviance beyond the scale of all materials, as if answers were independent: small
    where factors do not simply add up.
    """

    factors: tuple[Factor, ...]
    apart: Estimate | None
    p: float | None
    reduced: bool
    statement: str = ""


def factored(data: Comparisons, materials: Sequence[str], numbers: Numbers, least: int = 2) -> Factored | None:
    """Return what each factor of the stimuli adds; None where fewer than `least` numbers of every stimulus vary.

    Only materials of these trials count; who has no numbers, such as a blank, is left out with its pairs.
    """
    data, materials = with_numbers(data, materials, numbers)
    keys = [set(numbers.get(one, {})) for one in materials]
    shared = set.intersection(*keys) if keys else set()
    values = {key: np.array([numbers[one][key] for one in materials]) for key in sorted(shared)}
    varied = {key: of for key, of in values.items() if len(set(of.tolist())) > 1}
    if len(varied) < least or any(one != shared for one in keys):
        return None
    try:
        return _fitted(data, varied)
    except NotDefined as error:
        return Factored((), None, None, reduced=False, statement=str(error))


def with_numbers(data: Comparisons, materials: Sequence[str], numbers: Numbers) -> tuple[Comparisons, tuple[str, ...]]:
    """Return the trials of two materials with numbers, and those materials, by their new places."""
    kept = [place for place, one in enumerate(materials) if numbers.get(one)]
    trials = np.isin(data.first, kept) & np.isin(data.second, kept)
    used = np.unique([data.first[trials], data.second[trials]])
    return (
        Comparisons(
            np.searchsorted(used, data.first[trials]),
            np.searchsorted(used, data.second[trials]),
            data.chosen[trials],
            data.person[trials],
            items=len(used),
        ),
        tuple(materials[place] for place in used),
    )


def _fitted(data: Comparisons, varied: Mapping[str, Floats]) -> Factored:
    doubles = [bool((of > 0).all()) for of in varied.values()]
    slopes = np.column_stack(
        [np.log2(of) if double else of / np.ptp(of) for double, of in zip(doubles, varied.values(), strict=True)]
    )
    levels = {key: np.unique(of) for key, of in varied.items()}
    dummies = np.column_stack([(of[:, None] == levels[key][1:]).astype(float) for key, of in varied.items()])
    by_slope, by_level = (scaling.fit_terms(data, terms) for terms in (slopes, dummies))
    people, start, factors = len(np.unique(data.person)), 0, []
    for place, (key, of) in enumerate(levels.items()):
        effects = [by_level.combined(one_of(len(by_level.values), start + i)) for i in range(len(of) - 1)]
        along = one_of(len(by_slope.values), place)
        start += len(of) - 1
        factors.append(
            Factor(
                key,
                tuple(of.tolist()),
                (Estimate(0.0, None, None, None), *(estimate(*one, people) for one in effects)),
                estimate(*by_slope.combined(along), people) if doubles[place] else None,
                estimate(*by_slope.combined(along * np.ptp(slopes[:, place])), people),
            )
        )
    apart = None
    if len(doubles) > 1 and all(doubles[:2]):
        first_two = one_of(len(by_slope.values), 0) - one_of(len(by_slope.values), 1)
        apart = estimate(*by_slope.combined(first_two), people)
    return Factored(tuple(factors), apart, whole_beyond(data, by_level), by_level.reduced)


def one_of(size: int, place: int) -> Floats:
    """Return weights, shape (size,), of which the one at a place is 1 and the others 0."""
    return np.asarray(np.arange(size) == place, dtype=np.float64)


def whole_beyond(data: Comparisons, main: scaling.Terms) -> float | None:
    """Return the P of what the scale of all materials explains beyond terms; None where either is reduced."""
    try:
        whole = scaling.fit(data, "bradley-terry")
    except NotDefined:
        return None
    df = len(whole.values) - len(main.values)
    if whole.reduced or main.reduced or df < 1:
        return None
    return float(chdtrc(df, max(2 * (whole.log_likelihood - main.log_likelihood), 0.0)))
