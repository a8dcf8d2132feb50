"""Which numbers of trials can stand behind percentages that are printed without them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction

from analysis.published.printed import Printed
from analysis.spans import Span

Reading = Callable[[Printed], Span]


def rounded(printed: Printed) -> Span:
    """The shares that round to it."""
    return printed.rounded


def truncated(printed: Printed) -> Span:
    """The shares that are cut off to it."""
    return printed.truncated


def either(printed: Printed) -> Span:
    """Both."""
    return printed.either


def counts(printed: Printed, trials: int, reading: Reading) -> range:
    """The counts out of `trials` whose share prints like this."""
    share = reading(printed)
    low, high = max(Fraction(share.low), Fraction(0)) * trials, min(Fraction(share.high), Fraction(1)) * trials
    least, most = math.ceil(low), math.floor(high)
    least += not share.holds(Fraction(least, trials))
    most -= not share.holds(Fraction(most, trials))
    return range(least, most + 1)


def smallest(printed: Printed, reading: Reading) -> int:
    """The fewest trials of which some count prints like this."""
    return next(trials for trials in range(1, _enough(printed) + 1) if counts(printed, trials, reading))


def common(printed: Sequence[Printed], reading: Reading) -> Iterator[int]:
    """The numbers of trials, rising, that all of the percentages can be shares of."""
    for trials in range(1, max(map(_enough, printed)) + 1):
        if all(counts(one, trials, reading) for one in printed):
            yield trials


def _enough(printed: Printed) -> int:
    """So many trials have a share for every number printed like this."""
    return math.ceil(1 / printed.exact_unit) if printed.exact_unit else 1
