"""Which crossover from force to vibration has most of the quality that was compared.

Where the protocol states a crossover of every surface, at least three of them, a choice follows from them: P(first) =
F(g(first's crossover) - g(second's) + order), F the logistic, where g is a parabola over octaves. Participants are the
units. The best crossover is the parabola's top; its interval has all at which the slope of g may be nothing (Fieller,
Supplement to the Journal of the Royal Statistical Society 7, 1940; Journal of the Royal Statistical Society B 16,
1954).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log2, sqrt

import numpy as np
from scipy.special import stdtrit

from palpate.analysis.designs.comparison.estimates import Estimate, estimate
from palpate.analysis.designs.comparison.factors import Numbers, one_of, whole_beyond, with_numbers
from palpate.analysis.statistics import scaling
from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.inference import CONFIDENCE
from palpate.analysis.statistics.scaling import Comparisons

CROSSOVER = "crossover_hz"
"""The number of a stimulus that is its crossover."""

STRAIGHT = 1e-9
"""A bend below this, in logits an octave squared, is rounding. Ours."""


@dataclass(frozen=True)
class Crossed:
    """What each crossover adds to the lowest, in logits, and where a parabola has its top; or a statement why not.

    `bend` is what lies between the top and one octave beside it, above 0 for a top. `best_hz` is None where there is
    none, or outside of what was compared; its interval where the bend may be nothing; an end of it that no number of Hz
    reaches is None too. `p` is that of the deviance of all crossovers' scale beyond the parabola, as if answers were
    independent.
    """

    crossovers_hz: tuple[float, ...]
    effects: tuple[Estimate, ...]
    bend: Estimate | None
    best_hz: float | None
    best_low_hz: float | None
    best_high_hz: float | None
    p: float | None
    reduced: bool
    statement: str = ""


def crossed(data: Comparisons, materials: Sequence[str], numbers: Numbers) -> Crossed | None:
    """Return where the best crossover lies; None where a stimulus with numbers has none, or under three differ."""
    data, materials = with_numbers(data, materials, numbers)
    stated = [numbers.get(one, {}).get(CROSSOVER) for one in materials]
    values = np.array([one for one in stated if one is not None], dtype=np.float64)
    if len(values) < len(materials) or len(set(values.tolist())) < 3:
        return None
    try:
        return _fitted(data, values)
    except NotDefined as error:
        return Crossed((), (), None, None, None, None, None, reduced=False, statement=str(error))


def _fitted(data: Comparisons, crossovers_hz: Floats) -> Crossed:
    levels, people = np.unique(crossovers_hz), len(np.unique(data.person))
    middle_hz = sqrt(levels[0] * levels[-1])
    octaves = np.log2(crossovers_hz / middle_hz)
    by_level = scaling.fit_terms(data, (crossovers_hz[:, None] == levels[1:]).astype(float))
    curve = scaling.fit_terms(data, np.column_stack([octaves, octaves**2]))
    effects = [estimate(*by_level.combined(one_of(len(levels), place)), people) for place in range(len(levels) - 1)]
    bend = estimate(*curve.combined(-one_of(3, 1)), people)
    top, low, high = _top(curve, people)
    if top is None or abs(top) > log2(levels[-1] / middle_hz):
        top = low = high = None
    return Crossed(
        tuple(levels.tolist()),
        (Estimate(0.0, None, None, None), *effects),
        bend,
        _hz(top, middle_hz),
        _hz(low, middle_hz),
        _hz(high, middle_hz),
        whole_beyond(data, curve),
        curve.reduced or by_level.reduced,
    )


def _hz(octaves: float | None, middle_hz: float) -> float | None:
    """Return what lies so many octaves from the middle; None for nothing, and beyond all numbers."""
    if octaves is None:
        return None
    with np.errstate(over="ignore", under="ignore"):
        hz = float(middle_hz * np.exp2(octaves))
    return hz if 0 < hz < inf else None


def _top(curve: scaling.Terms, people: int) -> tuple[float | None, float | None, float | None]:
    """Return the top of a parabola and where its interval ends, octaves; None where there is none."""
    slope, bend = curve.values[:2]
    if not bend < -STRAIGHT:
        return None, None, None
    top = float(-slope / (2 * bend))
    t = float(stdtrit(people - 1, (1 + CONFIDENCE) / 2)) if people > 1 else inf
    (of_slope, both), (_, of_bend) = curve.covariance[:2, :2]
    # (slope + 2 bend x)^2 = t^2 var(slope + 2 bend x) at its ends.
    a = 4 * (bend**2 - t**2 * of_bend)
    b, c = 4 * (slope * bend - t**2 * both), slope**2 - t**2 * of_slope
    if not a > 0:
        return top, None, None
    half = sqrt(max(b * b - 4 * a * c, 0.0))
    return top, float((-b - half) / (2 * a)), float((-b + half) / (2 * a))
