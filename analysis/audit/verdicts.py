"""Whether a printed number can stand for one of the values that were recomputed for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from analysis.published.printed import Interval, Printed, as_printed, hull

Verdict = Literal[
    "agrees",
    "agrees if truncated",
    "differs",
    "fits no one rounding",
    "impossible",
    "cannot be decided",
    "not in this dataset",
]
AGREES: tuple[Verdict, ...] = ("agrees", "agrees if truncated")


@dataclass(frozen=True)
class Line:
    """One printed number.

    `recomputed` is text at the printed precision; `low` and `high` bound the recomputed number, and `value` is it
    where it is one alone. What is no number has none of the three.
    """

    where: str
    task: str
    subject: str
    quantity: str
    printed: str
    recomputed: str
    low: float | None
    high: float | None
    verdict: Verdict
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the printed number stands."""
        return self.verdict in AGREES

    @property
    def value(self) -> float | None:
        """The recomputed number, where it is one alone."""
        if self.low is None or self.high is None or not math.isclose(self.low, self.high, rel_tol=1e-8):
            return None
        return (self.low + self.high) / 2


def judge(
    printed: Printed, values: Sequence[Interval], *, squares: bool = False
) -> tuple[Verdict, tuple[Interval, ...]]:
    """The verdict on a printed number, and those of the values that it can stand for: all of them where it cannot.

    Args:
        printed: the number in print.
        values: everything that the number can be.
        squares: whether `values` are squares of it (variances of a standard deviation).
    """
    readings: tuple[tuple[Verdict, Interval], ...] = (
        ("agrees", printed.rounded),
        ("agrees if truncated", printed.truncated),
    )
    for verdict, reading in readings:
        wanted = reading.squared() if squares else reading
        if fitting := tuple(value for value in values if wanted.meets(value)):
            return verdict, fitting
    return "differs", tuple(values)


def shown(
    printed: Printed, values: Sequence[Interval], *, squares: bool = False
) -> tuple[str, float | None, float | None]:
    """The values as text at the printed precision, and their ends; None for an end that is infinite."""
    both = hull(values)
    low, high = float(both.low), float(both.high)
    if squares:
        low, high = math.sqrt(max(low, 0.0)), math.sqrt(high)
    texts = ["" if math.isinf(end) else as_printed(printed, end) for end in (low, high)]
    if math.isinf(low) or math.isinf(high):
        words = [f"from {texts[0]}"] * bool(texts[0]) + [f"up to {texts[1]}"] * bool(texts[1])
        return " ".join(words) or "any", None if math.isinf(low) else low, None if math.isinf(high) else high
    if math.isclose(low, high, rel_tol=1e-8):
        return as_printed(printed, (low + high) / 2), low, high
    return texts[0] if texts[0] == texts[1] else " to ".join(texts), low, high
