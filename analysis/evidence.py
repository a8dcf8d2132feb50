"""What a printed number is held against: the other numbers in print, or a dataset.

Both give the same things: the values that a mean, a standard deviation, a t or an F can have. From a dataset each is
one value; from print it is all that rounding or truncation, and counting in whole answers, leave open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from analysis.anova import TYPES
from analysis.granularity import Moments
from analysis.published import PrintedCell, PrintedF, PrintedT
from analysis.spans import Span
from analysis.verdicts import Verdict

Misreading = Literal["the population SD", "the standard error"]
"""What may be printed in the place of an SD."""

NO_STEPS = "the steps of the values are not known: any mean and SD can be"


@dataclass(frozen=True)
class Known:
    """The values that something can have; none of them where `statement` says why."""

    values: tuple[Span, ...] = ()
    statement: str = ""


@dataclass(frozen=True)
class Sample:
    """The means and variances that n participants can have; none where `statement` says why.

    `every` are those beside them that the cell's mean allows, for a standard deviation that does not fit.
    """

    n: int
    moments: tuple[Moments, ...] = ()
    every: tuple[Moments, ...] = ()
    statement: str = ""


@dataclass(frozen=True)
class Variances:
    """F of one effect, its degrees of freedom, and the number of values behind it.

    `f` are those of each way to share out what unequal numbers leave to more than one effect, by its name: one alone
    where all give the same.
    """

    f: Mapping[str, Span] = field(default_factory=dict)
    df: tuple[int, int] | None = None
    values: int = 0
    statement: str = ""


class Evidence(Protocol):
    """What printed numbers are held against."""

    missing: Verdict
    """Verdict on a number that this says nothing about."""
    refuted: Verdict
    """Verdict on a mean or SD that it does not allow."""

    sd_in_doubt: bool
    """Whether a printed SD that a test does not follow from may be what is wrong, not the test."""

    def misreading(self, cell: PrintedCell) -> Misreading | None:
        """What the cell's printed SD is read as, if not as an SD."""

    def sd_stands(self, cell: PrintedCell) -> bool:
        """Whether the cell can have its printed SD, all else aside."""

    def beyond(self, cell: PrintedCell) -> tuple[Moments, ...]:
        """What else the cell can be, if its printed SD is none."""

    def mean(self, cell: PrintedCell) -> Known:
        """What the cell's mean can be."""

    def sample(self, cell: PrintedCell) -> Sample:
        """What the cell's mean and variance can be."""

    def tested(self, test: PrintedT) -> Sample:
        """The same for what a t-test is of."""

    def variances(self, printed: PrintedF) -> Variances:
        """F, of the pair of materials or of the effect that it is printed for."""


def by_type(*found: Span) -> dict[str, Span]:
    """F of types I, II and III, those that are the same together."""
    kinds: dict[Span, list[str]] = {}
    for kind, f in zip(TYPES, found, strict=True):
        same = next((one for one in kinds if math.isclose(one.low, f.low) and math.isclose(one.high, f.high)), f)
        kinds.setdefault(same, []).append(kind)
    return {f"type{'s' * (len(same) > 1)} {' and '.join(same)}": f for f, same in kinds.items()}
