"""An ANOVA table as printed, line by line: MS, F and P, each from what stands beside it, and the mistakes behind it.

Nothing but the table is known, so a wrong df may stand in print as well as in the sum.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import partial

from analysis.mistakes import Mistake, of_any_f
from analysis.places import Place
from analysis.published import Printed, PrintedSource, PrintedSources
from analysis.recomputed import p_of_f, quotient
from analysis.spans import Span
from analysis.verdicts import AGREES, Line, judge


def source_lines(table: PrintedSources) -> Iterator[Line]:
    """MS = SS / df, F = MS / MS of the residual, P of F."""
    residual = table.lines[-1]
    for line in table.lines:
        place = Place(table.where, "both", line.name, "cannot be decided", "the line does not print enough")
        ms = _over(line.ss, line.df)
        if line.ms is not None:
            yield place.number("MS", line.ms, [ms] if ms else [], partial(_of_ms, line, table))
        own, rest = _mean_square(line), _mean_square(residual)
        f = quotient(own, rest) if own and rest and line is not residual else None
        if line.f is not None:
            yield place.number("F", line.f, [f] if f else [], partial(_of_f, line, f, table))
        if line.p is not None:
            ratio = line.f.either if line.f else f
            ps = [p_of_f(ratio, (line.df, residual.df))] if ratio else []
            yield place.number("P", line.p, ps, partial(_of_p, line, f, ratio, table))


def _of_ms(line: PrintedSource, table: PrintedSources) -> Iterator[Mistake]:
    """Mistakes in a mean square."""
    if line.ss is None:
        return
    ss = line.ss.either
    yield Mistake("it is the sum of squares, not divided by df", (ss,))
    for df in _others(line, table):
        yield Mistake(f"it is that of {df} df, where df is {line.df}", (ss.times(Fraction(1, df)),))
    yield Mistake("it is the root of SS / df", (ss.times(Fraction(1, line.df)),), squares=True)


def _of_f(line: PrintedSource, f: Span | None, table: PrintedSources) -> Iterator[Mistake]:
    """Mistakes in an F."""
    residual = table.lines[-1]
    if f is None:
        return
    above, below = (_over(one.ss, one.df) for one in (line, residual))
    if above and below and (_contradicts(line) or _contradicts(residual)):
        yield Mistake("it follows SS / df, not the printed MS", (quotient(above, below),))
    yield from of_any_f([f], (line.df, residual.df))
    for df in _others(line, table):
        yield Mistake(f"it is that of {df} df, where df is {line.df}", (f.times(Fraction(line.df, df)),))
    for df in _others(residual, table):
        yield Mistake(
            f"its residual was divided by {df} df, where df is {residual.df}", (f.times(Fraction(df, residual.df)),)
        )
    yield Mistake("it is the ratio of the sums of squares", (f.times(Fraction(line.df, residual.df)),))
    own = _mean_square(line)
    for other in table.lines[:-1]:
        if other is not line and own and (rest := _mean_square(other)):
            yield Mistake(f"it was formed with the MS of {other.name}", (quotient(own, rest),))


def _of_p(line: PrintedSource, f: Span | None, ratio: Span | None, table: PrintedSources) -> Iterator[Mistake]:
    """Mistakes in the P of an F."""
    residual = table.lines[-1]
    if ratio is None:
        return
    df = line.df, residual.df
    correct = p_of_f(ratio, df)
    if f is not None and line.f is not None and judge(line.f, [f])[0] not in AGREES:
        yield Mistake("it follows MS / MS, not the printed F", (p_of_f(f, df),))
    yield Mistake("it is one-tailed", (correct.times(Fraction(1, 2)),))
    yield Mistake("it is doubled", (correct.times(Fraction(2)),))
    wrong = [(other, df[1]) for other in _others(line, table)] + [(df[0], other) for other in _others(residual, table)]
    for other in dict.fromkeys([*wrong, (df[1], df[0])]):
        if other != df:
            yield Mistake(f"it was taken at {other[0]}, {other[1]} df", (p_of_f(ratio, other),))


def _others(line: PrintedSource, table: PrintedSources) -> list[int]:
    """What may have been taken for a line's df, the likeliest first."""
    whole = sum(one.df for one in table.lines)
    near = [line.df + 1, line.df - 1, whole, whole + 1]
    return [df for df in dict.fromkeys([*near, *(one.df for one in table.lines)]) if df > 0 and df != line.df]


def _contradicts(line: PrintedSource) -> bool:
    """Whether the printed MS cannot be SS / df."""
    computed = _over(line.ss, line.df)
    return bool(computed and line.ms and not line.ms.either.meets(computed))


def _over(ss: Printed | None, df: int) -> Span | None:
    return ss.either.times(Fraction(1, df)) if ss else None


def _mean_square(line: PrintedSource) -> Span | None:
    """A mean square as printed and as SS / df at once, where both can be."""
    computed = _over(line.ss, line.df)
    if line.ms is None:
        return computed
    both = line.ms.either
    return both.common(computed) if computed and both.meets(computed) else both
