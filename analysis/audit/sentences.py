"""Tests in a paper's sentences: is P that of the statistic and df beside it, and does the interval say the same?

Each P is recomputed as the interval that rounding or truncation of the statistic and df allows. A P that is half of it
stands where the paper says that tests are one-tailed. statcheck asks the same (Nuijten et al. 2016).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from math import atanh, sqrt, tanh

from scipy import stats

from palpate.analysis.audit import mistakes
from palpate.analysis.audit.intervals import Interval, either, outward
from palpate.analysis.audit.mistakes import Citation, Line, Mistake, judge
from palpate.analysis.published.printed import Printed
from palpate.analysis.published.prose import Reported

ALPHA = 0.05
"""A P on the other side of this changes what a paper concludes."""

WHERE = "Sentences"

_SF: Mapping[str, Callable[..., float]] = {
    "t": lambda t, df: 2 * float(stats.t.sf(abs(t), df)),
    "F": lambda f, above, below: float(stats.f.sf(f, above, below)),
    "chi2": lambda chi2, df: float(stats.chi2.sf(chi2, df)),
    "r": lambda r, df: 2 * float(stats.t.sf(abs(r) * sqrt(df / max(1 - r * r, 1e-300)), df)),
    "z": lambda z: 2 * float(stats.norm.sf(abs(z))),
}
"""Two-tailed P of each statistic and its df; of F and chi-squared the upper tail."""


def sentence_lines(tests: Sequence[Reported], *, one_tailed: bool) -> Iterator[Line]:
    """Yield the lines of tests in sentences; `one_tailed`: the paper says that some are."""
    for test in tests:
        cited = Citation(WHERE, "text", test.head, "cannot be decided")
        if (impossible := _impossible(cited, test)) is not None:
            yield impossible
            continue
        yield _p_line(cited, test, one_tailed=one_tailed)
        if test.interval is not None and (line := _interval_line(cited, test, test.interval)) is not None:
            yield line


def _impossible(cited: Citation, test: Reported) -> Line | None:
    """Return the line of a statistic or P that no data give."""
    value, p = test.value, test.p
    if test.statistic == "r" and abs(value.exact) > 1:
        return cited.text("r", value.text, "-1 to 1", "impossible", "a correlation cannot exceed 1")
    if test.statistic in ("F", "chi2") and value.exact < 0:
        return cited.text(test.statistic, value.text, "at least 0", "impossible", "it is never negative")
    if not 0 <= p.value <= 1:
        return cited.text("P", p.text, "0 to 1", "impossible", "a probability is between 0 and 1")
    return None


def p_values(test: Reported) -> Interval:
    """Return every P that the printed statistic and df allow."""
    value = either(test.value).absolute()
    low, high = value.low, value.high
    if test.sign in ("<", "≤"):
        low, high = Fraction(0), test.value.exact
    elif test.sign in (">", "≥"):
        low, high = test.value.exact, Fraction(10**9)
    if test.statistic == "r":
        low, high = min(low, Fraction(1)), min(high, Fraction(1))
    corners: list[tuple[float, ...]] = [()]
    for df in test.df:
        ends = (df.exact,) if df.exact.denominator == 1 else (either(df).low, either(df).high)
        corners = [(*corner, float(end)) for corner in corners for end in ends]
    found = [_SF[test.statistic](float(end), *corner) for end in (low, high) for corner in corners]
    return outward(min(found), max(found))


def _p_line(cited: Citation, test: Reported, *, one_tailed: bool) -> Line:
    whole = p_values(test)
    halves = whole.times(Fraction(1, 2))
    if test.p_sign == ">":
        stands = float(whole.high) > test.p.value
        text, low, high = mistakes.shown(Printed("0.000"), [whole], further=1)
        reason = "" if stands else _conclusion(test, whole)
        verdict: mistakes.Verdict = "agrees" if stands else "differs"
        return Line(cited.where, cited.task, cited.subject, "P", f">{test.p.text}", text, low, high, verdict, reason)
    told = test.statistic in ("t", "r", "z")
    if told and one_tailed and not _fits(test.p, whole) and _fits(test.p, halves):
        return cited.number("P", test.p, [halves], remark=" (one-tailed, as the paper states)")
    why = [Mistake("it is one-tailed", (halves,)), Mistake("it is doubled", (whole.times(Fraction(2)),))]
    line = cited.number("P", test.p, [whole], why)
    if line.agrees or not (conclusion := _conclusion(test, whole)):
        return line
    return replace(line, reason="; ".join(filter(None, (line.reason, conclusion))))


def _fits(p: Printed, values: Interval) -> bool:
    return judge(p, [values])[0] in mistakes.AGREES


def _conclusion(test: Reported, whole: Interval) -> str:
    """Return that a wrong P changes what is significant, where it does."""
    if test.p_sign == ">":
        printed_significant = False
    else:
        printed_significant = test.p.value < ALPHA or (test.p.is_bound and test.p.value <= ALPHA)
    low, high = float(whole.low), float(whole.high)
    changed = low > ALPHA if printed_significant else high < ALPHA
    return f"this changes the conclusion at {ALPHA:g}" if changed else ""


def _interval_line(cited: Citation, test: Reported, ends: tuple[Printed, Printed]) -> Line | None:
    """Return the line of an interval beside a t, r or z: it leaves out 0 where P is below 1 less its level.

    That of r is recomputed by Fisher's z; of others the unit is not known.
    """
    low, high = ends
    printed = f"{low.text} to {high.text}"
    quantity = f"{test.level:.0%} CI"
    if high.exact < low.exact:
        return cited.text(quantity, printed, "lower limit first", "impossible", "its limits are swapped")
    if test.statistic == "r":
        found = _fisher(test)
        stands = all(_fits(end, one) for end, one in zip(ends, found, strict=True))
        shown = " to ".join(mistakes.shown(end, [one])[0] for end, one in zip(ends, found, strict=True))
        return None if stands else cited.text(quantity, printed, shown, "cannot be decided", "Fisher's z differs")
    if test.statistic not in ("t", "z"):
        return None
    excludes = low.exact > 0 or high.exact < 0
    whole, level = p_values(test), 1 - test.level
    if excludes and float(whole.low) > level:
        return cited.text(quantity, printed, "0 within it", "differs", f"P is above {level:.2g}")
    if not excludes and low.exact < 0 < high.exact and float(whole.high) < level:
        return cited.text(quantity, printed, "0 outside it", "differs", f"P is below {level:.2g}")
    return cited.text(quantity, printed, "0 outside it" if excludes else "0 within it", "agrees")


def _fisher(test: Reported) -> tuple[Interval, Interval]:
    """Return the ends of the interval of r by Fisher's z, with df + 2 pairs, as far as r is printed."""
    n = float(test.df[0].exact) + 2
    half = float(stats.norm.ppf((1 + test.level) / 2)) / sqrt(max(n - 3, 1e-9))
    span = either(test.value)
    rs = [max(-1 + 1e-12, min(1 - 1e-12, float(end))) for end in (span.low, span.high)]
    lows, highs = ([tanh(atanh(r) + sign * half) for r in rs] for sign in (-1, 1))
    return outward(min(lows), max(lows)), outward(min(highs), max(highs))
