"""The stars that printed numbers can earn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from analysis.evidence import Sample
from analysis.published import Printed, PrintedLevel
from analysis.recomputed import p_of_t, t_of
from analysis.significance import stars
from analysis.spans import Span


def marks_of(p: Printed, levels: Sequence[PrintedLevel]) -> str:
    """The stars that a printed P earns; an upper bound earns those of anything below it."""
    return _earned(math.nextafter(p.value, 0.0) if p.is_bound else p.value, levels) or "none"


def marks_reached(sample: Sample, effects: Sequence[Span], levels: Sequence[PrintedLevel]) -> tuple[str, ...]:
    """The stars that a mean can have, most first; "none" for none, as where there may be no variance."""
    found = {""} if effects and any(one.variance.low == 0 for one in sample.moments) else set()
    sides = (Span(_NULL, math.inf), levels), (Span(-math.inf, _NULL), [one for one in levels if not one.above])
    for side, given in sides:
        marks = ["", *(level.stars for level in reversed(given))]
        for one in effects:
            if side.meets(one):
                p = p_of_t(t_of(one.common(side), sample.n), sample.n - 1)
                reached = [marks.index(_earned(float(end), given)) for end in (p.low, p.high)]
                found |= set(marks[min(reached) : max(reached) + 1])
    return tuple(mark or "none" for mark in sorted(found, key=len, reverse=True))


def _earned(p: float, levels: Sequence[PrintedLevel]) -> str:
    return stars(p, [(level.p, level.stars) for level in levels])


_NULL = Fraction(0)
"""The effect of no difference."""
