"""What the timing of a vibration adds to the quality that was compared, and which delay is just noticed.

Where the protocol states a delay after the touch of every surface, and they differ, a choice follows from them:
P(first) = F(g(first's delay) - g(second's) + order), F the logistic, where g has one slope for vibrations before the
touch and one for later ones, and is 0 at the touch. Participants are the units. That delay is just noticed which is
told from the touch in 75 % of pairs: ln 3 by the slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from palpate.analysis.designs.comparison.estimates import Estimate, estimate
from palpate.analysis.designs.comparison.factors import Numbers, one_of, whole_beyond, with_numbers
from palpate.analysis.statistics import scaling
from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.scaling import Comparisons

DELAY = "delay_ms"
"""The number of a stimulus that is its delay."""

STEP_MS = 10.0
"""What a slope is stated for, ms."""

JUST = log(3.0)
"""How far apart in logits two are that are told apart in 75 % of pairs."""


@dataclass(frozen=True)
class Side:
    """Vibrations before the touch (`early`) or after it: what `STEP_MS` further from the touch add, in logits.

    `noticed_ms` is the delay that is just noticed, with its 95 % interval; None where there is none.
    """

    early: bool
    slope: Estimate
    noticed_ms: float | None
    noticed_low_ms: float | None
    noticed_high_ms: float | None


@dataclass(frozen=True)
class Delayed:
    """What each delay adds to the one nearest the touch, and each side's slope; or a statement why there is none.

    `p` is that of the deviance of all delays' scale beyond both slopes, as if answers were independent: small where
    the quality is not straight in the delay.
    """

    delays_ms: tuple[float, ...]
    effects: tuple[Estimate, ...]
    sides: tuple[Side, ...]
    p: float | None
    reduced: bool
    statement: str = ""


def delayed(data: Comparisons, materials: Sequence[str], numbers: Numbers) -> Delayed | None:
    """Return what delays add; None where not every stimulus with numbers states one, or all are the same."""
    data, materials = with_numbers(data, materials, numbers)
    stated = [numbers.get(one, {}).get(DELAY) for one in materials]
    values = np.array([one for one in stated if one is not None], dtype=np.float64)
    if len(values) < len(materials) or len(set(values.tolist())) < 2:
        return None
    try:
        return _fitted(data, values)
    except NotDefined as error:
        return Delayed((), (), (), None, reduced=False, statement=str(error))


def _fitted(data: Comparisons, delays_ms: Floats) -> Delayed:
    levels = np.unique(delays_ms)
    nearest = levels[np.argmin(np.abs(levels))]
    others = levels[levels != nearest]
    by_level = scaling.fit_terms(data, (delays_ms[:, None] == others).astype(float))
    sides = {early: np.maximum(-delays_ms if early else delays_ms, 0.0) / STEP_MS for early in (True, False)}
    sides = {early: of for early, of in sides.items() if of.any()}
    by_side = scaling.fit_terms(data, np.column_stack(list(sides.values())))
    people = len(np.unique(data.person))
    effects = [estimate(*by_level.combined(one_of(len(others) + 1, place)), people) for place in range(len(others))]
    effects.insert(int(np.searchsorted(others, nearest)), Estimate(0.0, None, None, None))
    slopes = (by_side.combined(one_of(len(sides) + 1, place)) for place in range(len(sides)))
    return Delayed(
        tuple(levels.tolist()),
        tuple(effects),
        tuple(_side(early, estimate(*slope, people)) for early, slope in zip(sides, slopes, strict=True)),
        whole_beyond(data, by_side),
        by_side.reduced or by_level.reduced,
    )


def _side(early: bool, slope: Estimate) -> Side:
    limits = [] if slope.low is None or slope.high is None else [slope.low, slope.high]
    clear = bool(limits) and min(limits) * max(limits) > 0
    sizes = sorted(map(abs, limits))
    return Side(
        early,
        slope,
        noticed_ms=STEP_MS * JUST / abs(slope.value) if slope.value else None,
        noticed_low_ms=STEP_MS * JUST / sizes[-1] if limits else None,
        noticed_high_ms=STEP_MS * JUST / sizes[0] if clear else None,
    )
