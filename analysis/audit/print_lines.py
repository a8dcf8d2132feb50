"""Checks without a dataset: cells and tests, rows as whole counts, ANOVA tables, percentages.

A standard error as SD makes t look like d; an SD is read as something else where that leaves fewer conflicts. An ANOVA
table is checked line by line, from itself alone. Percentages get the numbers that can stand behind them.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np

from palpate.analysis.audit import causes, mistakes
from palpate.analysis.audit.bounds import MOST_COLUMNS, Row, Undecided, Work, examine, p_of_f, quotient
from palpate.analysis.audit.causes import CONFLICTS
from palpate.analysis.audit.checks import Checks
from palpate.analysis.audit.evidence import MISREADINGS, FromPrint, Misreading
from palpate.analysis.audit.intervals import Interval, either, hull, rounded, sum_of, truncated
from palpate.analysis.documents.tables import plural
from palpate.analysis.published.numbers import (
    PrintedCell,
    PrintedChoices,
    PrintedSource,
    PrintedSources,
    PrintedTable,
    Published,
)
from palpate.analysis.published.printed import Printed


def read_print(published: Published) -> FromPrint:
    """Return the printed numbers, with an SD read as something else where that settles two conflicts or more."""
    evidence = FromPrint(published)
    tested = {test.key for test in published.tests}
    for cell in published.tables():
        if cell.sd is not None and cell.key in tested:
            evidence = _better(published, evidence, cell)
    for table in published.table:
        evidence = _throughout(published, evidence, table, tested)
    return evidence


def _better(published: Published, evidence: FromPrint, cell: PrintedCell) -> FromPrint:
    """Return the evidence with the reading of a cell that leaves the fewest conflicts and fits all of its tests."""
    own = _conflicts(published, evidence, cell)
    least = len(own) + _in_f(published, evidence, [cell])
    if not own or least < 2:
        return evidence
    for misreading in MISREADINGS:
        other = evidence.reading([cell], misreading)
        if other is None:
            continue
        own = _conflicts(published, other, cell)
        left = len(own) + _in_f(published, other, [cell])
        if left < least and all(line.quantity in ("mean", "SD") for line in own):
            evidence, least = other, left
    return evidence


def _throughout(
    published: Published, evidence: FromPrint, table: PrintedTable, tested: set[tuple[str, str, str]]
) -> FromPrint:
    """Return the evidence with untested cells read as all tested ones are, where fewer F are then in conflict."""
    cells = published.cells_of(table)
    kinds = {evidence.misreading(cell) for cell in cells if cell.key in tested and cell.sd is not None}
    rest = [cell for cell in cells if cell.key not in tested and cell.sd is not None and cell.sd.exact]
    misreading: Misreading | None = kinds.pop() if len(kinds) == 1 else None
    if misreading is None or not rest:
        return evidence
    other = evidence.reading(rest, misreading)
    before, after = (_in_f(published, one, rest) if one else 0 for one in (evidence, other))
    return other if other is not None and after < before else evidence


def _conflicts(published: Published, evidence: FromPrint, cell: PrintedCell) -> list[mistakes.Line]:
    """Return the lines of the cell and its test that are in conflict."""
    return [line for line in Checks(published, evidence, diagnose=False).about(cell) if line.verdict in CONFLICTS]


def _in_f(published: Published, evidence: FromPrint, cells: Sequence[PrintedCell]) -> int:
    lines = Checks(published, evidence, diagnose=False).ratios_of(cells)
    return sum(line.verdict in CONFLICTS for line in lines)


def source_lines(table: PrintedSources) -> Iterator[mistakes.Line]:
    """Yield the lines of MS = SS / df, F = MS / MS of the residual, and P of F."""
    residual = table.lines[-1]
    for line in table.lines:
        cited = mistakes.Citation(table.where, "both", line.name, "cannot be decided", "the line does not print enough")
        ms = _per_freedom(line.ss, line.df)
        if line.ms is not None:
            yield cited.number("MS", line.ms, [ms] if ms else [], _of_ms(line, table))
        own, rest = _mean_square(line), _mean_square(residual)
        f = quotient(own, rest) if own and rest and line is not residual else None
        if line.f is not None:
            yield cited.number("F", line.f, [f] if f else [], _of_f(line, f, table))
        if line.p is not None:
            ratio = either(line.f) if line.f else f
            ps = [p_of_f(ratio, (line.df, residual.df))] if ratio else []
            yield cited.number("P", line.p, ps, _of_p(line, f, ratio, table))


def _of_ms(line: PrintedSource, table: PrintedSources) -> Iterator[mistakes.Mistake]:
    if line.ss is None:
        return
    ss = either(line.ss)
    yield mistakes.Mistake("it is the sum of squares, not divided by df", (ss,))
    for df in _others(line, table):
        yield mistakes.Mistake(f"it was computed with {df} df, but df is {line.df}", (ss.times(Fraction(1, df)),))
    yield mistakes.Mistake("it is the square root of SS / df", (ss.times(Fraction(1, line.df)),), squares=True)


def _of_f(line: PrintedSource, f: Interval | None, table: PrintedSources) -> Iterator[mistakes.Mistake]:
    residual = table.lines[-1]
    if f is None:
        return
    above, below = (_per_freedom(one.ss, one.df) for one in (line, residual))
    if above and below and (_contradicts(line) or _contradicts(residual)):
        yield mistakes.Mistake("it matches SS / df, not the printed MS", (quotient(above, below),))
    yield from mistakes.of_any_f([f], (line.df, residual.df))
    for df in _others(line, table):
        yield mistakes.Mistake(f"it was computed with {df} df, but df is {line.df}", (f.times(Fraction(line.df, df)),))
    for df in _others(residual, table):
        text = f"its residual was divided by {df} df, but df is {residual.df}"
        yield mistakes.Mistake(text, (f.times(Fraction(df, residual.df)),))
    yield mistakes.Mistake("it is the ratio of the sums of squares", (f.times(Fraction(line.df, residual.df)),))
    own = _mean_square(line)
    for other in table.lines[:-1]:
        if other is not line and own and (rest := _mean_square(other)):
            yield mistakes.Mistake(f"it was computed with the MS of {other.name}", (quotient(own, rest),))


def _of_p(
    line: PrintedSource, f: Interval | None, ratio: Interval | None, table: PrintedSources
) -> Iterator[mistakes.Mistake]:
    residual = table.lines[-1]
    if ratio is None:
        return
    df = line.df, residual.df
    correct = p_of_f(ratio, df)
    if f is not None and line.f is not None and mistakes.judge(line.f, [f])[0] not in mistakes.AGREES:
        yield mistakes.Mistake("it matches MS / MS, not the printed F", (p_of_f(f, df),))
    yield mistakes.Mistake("it is one-tailed", (correct.times(Fraction(1, 2)),))
    yield mistakes.Mistake("it is doubled", (correct.times(Fraction(2)),))
    wrong = [(other, df[1]) for other in _others(line, table)] + [(df[0], other) for other in _others(residual, table)]
    for other in dict.fromkeys([*wrong, (df[1], df[0])]):
        if other != df:
            yield mistakes.Mistake(f"it was computed with {other[0]}, {other[1]} df", (p_of_f(ratio, other),))


def _others(line: PrintedSource, table: PrintedSources) -> list[int]:
    """Return what may have been taken for a line's df, the likeliest first."""
    whole = sum(one.df for one in table.lines)
    near = [line.df + 1, line.df - 1, whole, whole + 1]
    return [df for df in dict.fromkeys([*near, *(one.df for one in table.lines)]) if df > 0 and df != line.df]


def _contradicts(line: PrintedSource) -> bool:
    """Return whether the printed MS cannot be SS / df."""
    computed = _per_freedom(line.ss, line.df)
    return bool(computed and line.ms and not either(line.ms).meets(computed))


def _per_freedom(ss: Printed | None, df: int) -> Interval | None:
    return either(ss).times(Fraction(1, df)) if ss else None


def _mean_square(line: PrintedSource) -> Interval | None:
    """Return a mean square that is both as printed and SS / df; where it cannot be both, as printed."""
    computed = _per_freedom(line.ss, line.df)
    if line.ms is None or computed is None:
        return either(line.ms) if line.ms else computed
    return either(line.ms) if _contradicts(line) else either(line.ms).common(computed)


Reading = Callable[[Printed], Interval]
READINGS: Mapping[str, Reading] = {"rounded": rounded, "truncated": truncated, "either": either}
"""The shares that a percentage can stand for, by the way it was printed."""


def counts(printed: Printed, trials: int, reading: Reading) -> range:
    """Return the counts out of `trials` whose share prints like this."""
    least, most = reading(printed).times(Fraction(trials)).whole()
    return range(max(int(least), 0), min(int(most), trials) + 1)


def smallest(printed: Printed, reading: Reading) -> int:
    """Return the fewest trials of which some count prints like this."""
    return _simplest(reading(printed)).denominator


def _simplest(span: Interval) -> Fraction:
    """Return the number in the interval with the smallest denominator, found as a continued fraction."""
    least, most = span.whole()
    if least <= most:
        return Fraction(least)
    whole = math.floor(span.low)
    low, high = span.low - whole, span.high - whole
    turned = Interval(1 / high, 1 / low if low else math.inf, span.open_high, span.open_low)
    return whole + 1 / _simplest(turned)


def common(printed: Sequence[Printed], reading: Reading) -> Iterator[int]:
    """Yield, rising, the numbers of trials of which all the percentages can be shares."""
    different = {one.text: one for one in printed}.values()
    # So many trials have a share for every number printed like these.
    enough = max(math.ceil(1 / one.exact_unit) if one.exact_unit else 1 for one in different)
    trials = np.arange(1, enough + 1)
    for one in different:
        span = reading(one)
        low, high = Fraction(span.low), Fraction(span.high)
        least, most = -(-low.numerator * trials // low.denominator), high.numerator * trials // high.denominator
        least += span.open_low & (least * low.denominator == low.numerator * trials)
        most -= span.open_high & (most * high.denominator == high.numerator * trials)
        trials = trials[np.maximum(least, 0) <= np.minimum(most, trials)]
    yield from map(int, trials)


LISTED = 5
"""The most numbers that a reason lists."""

UNDECIDED: mistakes.Verdict = "cannot be decided"
NO_ROW = "the ratios cannot sum to 1"


def print_lines(published: Published) -> tuple[mistakes.Line, ...]:
    """Return every line of a study whose printed numbers are compared with one another."""
    right, evidence, found = causes.find(published, read_print(published))
    return tuple(_unanswered(list(causes.accused(_lines(right, evidence), published, found))))


SEVERAL = 3
"""Means of one table that fit no whole counts from which on they are not told as one mistake each (ours)."""

UNANSWERED = (
    "it is one of {} such means in its table; ratios over answered trials only look like this, and for them, leave "
    "out `trials`"
)


def _unanswered(lines: Sequence[mistakes.Line]) -> Iterator[mistakes.Line]:
    """Yield the lines with what explains several means of a table that fit no whole counts."""
    often = Counter((line.where, line.task) for line in lines if _fits_no_counts(line))
    for line in lines:
        many = often[line.where, line.task]
        told = many >= SEVERAL and _fits_no_counts(line)
        yield replace(line, reason=f"{line.reason}; {UNANSWERED.format(many)}") if told else line


def _fits_no_counts(line: mistakes.Line) -> bool:
    return line.quantity == "mean" and line.verdict == "impossible"


def _lines(published: Published, evidence: FromPrint) -> tuple[mistakes.Line, ...]:
    checks = Checks(published, evidence, diagnose=True)
    lines = list(checks.lines())
    work = Work(MOST_COLUMNS)
    for table in published.table:
        if table.complete:
            rows = causes.by_row(published, table).values()
            lines += [_row(published, checks, evidence, row, work) for row in rows]
    for sources in published.anova:
        lines += source_lines(sources)
    for icc in published.icc:
        cited = mistakes.Citation(icc.where, "both", "reliability of the two-way ANOVA", UNDECIDED)
        reason = "no formula is printed, and means and SDs do not show each participant's answers in every cell"
        lines.append(cited.text("ICC", icc.value.text, "-", UNDECIDED, reason))
    for choices in published.choices:
        lines += _choices(choices)
    return tuple(lines)


def _row(
    published: Published, checks: Checks, evidence: FromPrint, cells: Sequence[PrintedCell], work: Work
) -> mistakes.Line:
    cited = mistakes.Citation(cells[0].where, cells[0].task, f"row of {cells[0].presented}", UNDECIDED)
    printed = causes.added(cells)
    task = published.task_named(cells[0].task)
    sums = sum_of(either(cell.mean) for cell in cells)
    if task is None or task.trials is None:
        allowed = f"{float(sums.low):.4g} to {float(sums.high):.4g}"
        if sums.holds(Fraction(1)):
            return cited.text("row", printed, allowed, "agrees")
        return cited.text("row", printed, allowed, "impossible", NO_ROW)
    # An SD that was misread says nothing about the row.
    cells = [replace(cell, sd=None) if evidence.misreading(cell) else cell for cell in cells]
    pinned = {i: hull(one.variance for one in held) for i, cell in enumerate(cells) if (held := checks.that_give(cell))}
    try:
        row = examine(cells, task.participants, task.trials, pinned, work)
    except Undecided as reason:
        return cited.text("row", printed, "-", UNDECIDED, str(reason))
    return _judged(published, cited, printed, cells, row, given=", given the printed t" if pinned else "")


def _judged(
    published: Published, cited: mistakes.Citation, printed: str, cells: Sequence[PrintedCell], row: Row, *, given: str
) -> mistakes.Line:
    if row.stands:
        found = f"{row.trials} of {row.trials} trials"
        if not row.truncated:
            return cited.text("row", printed, found, "agrees")
        names = " and ".join(f"-> {cells[i].answered}" for i in row.truncated)
        are = "is" if len(row.truncated) == 1 else "are"
        reason = f"whole counts give the row only if {names} {are} truncated{given}"
        return cited.text("row", printed, found, "agrees if truncated", reason)
    found = f"{row.fewest} to {row.most} of {row.trials} trials" if row.fewest != row.most else f"{row.most} trials"
    reasons = []
    if gaps := row.missing or row.missing_truncated:
        fewer = row.missing_truncated if row.missing_truncated != gaps else None
        less = f" ({fewer} would if means are truncated)" if fewer else ""
        reasons.append(f"{plural(gaps, 'trial')} without an answer would explain it{less}")
    if row.misprinted:
        names = ", ".join(f"-> {cells[i].answered}{_slip_in(published, cells, i)}" for i in row.misprinted)
        besides = "so would" if gaps else "a possible cause is"
        reasons.append(f"{besides} a misprint of {'one of ' if len(row.misprinted) > 1 else ''}{names}")
    possible = row.fewest <= row.trials <= row.most
    first = f"no whole counts give all means and SDs at once{given}" if possible else NO_ROW
    return cited.text("row", printed, found, "impossible", "; ".join([first, *reasons]))


def _slip_in(published: Published, cells: Sequence[PrintedCell], index: int) -> str:
    """Return the slip of a digit in a mean without which its row would add up, in brackets; or nothing."""
    left = causes.left_by(published, cells, cells[index].key)
    if left is None:
        return ""
    printed = cells[index].mean
    moved = [left.times(Fraction(10) ** power) for power in (-1, 1, 2)]
    found = [mistakes.TENFOLD] if printed.exact and any(one.meets(rounded(printed)) for one in moved) else []
    fitting = [(slip, text) for slip, text in mistakes.slips(printed.text) if left.meets(rounded(Printed(text)))]
    for slip, text in fitting[:1]:
        if not found or slip == mistakes.SWAPPED:
            found.append(f"{slip}: {text} would fit")
    return f" ({'; or '.join(found)})" if found else ""


def _choices(choices: PrintedChoices) -> Iterator[mistakes.Line]:
    percentages = [cell.correct for cell in choices.cells]
    pairs = len(percentages)
    shares = [choices.trials * people // pairs for people in (choices.participants, 1)]
    for cell in choices.cells:
        cited = mistakes.Citation(choices.where, choices.task, " and ".join(cell.pair), UNDECIDED)
        yield _choice(cited, cell.correct, shares)
    cited = mistakes.Citation(choices.where, choices.task, f"all {pairs} pairs", UNDECIDED)
    yield _common(cited, choices, percentages, max(shares))
    yield _unequal(cited, choices, percentages)


def _choice(cited: mistakes.Citation, printed: Printed, shares: Sequence[int]) -> mistakes.Line:
    """Return the line of one percentage, with trials shared equally among pairs, which nothing printed says."""
    asked = [share for share in shares if share]
    found = {name: [(k, n) for n in asked for k in counts(printed, n, read)] for name, read in READINGS.items()}
    if fits := found["rounded"]:
        return cited.text("correct", printed.text, " or ".join(f"{k} of {n}" for k, n in fits[:LISTED]), "agrees")
    near = [(round(printed.exact * share), share) for share in asked]
    shown = " or ".join(f"{k} of {n} = {100 * k / n:.1f}%" for k, n in found["truncated"] or near)
    trials = f"{' or '.join(map(str, asked))} trials, equal for all pairs,"
    cut = ", though one truncates to it" if found["truncated"] else ""
    fewest = smallest(printed, READINGS["rounded"])
    reason = f"no count out of {trials} rounds to it{cut}; the smallest number of trials that works is {fewest}"
    return cited.text("correct", printed.text, shown, UNDECIDED, reason)


def _common(
    cited: mistakes.Citation, choices: PrintedChoices, percentages: Sequence[Printed], most: int
) -> mistakes.Line:
    """Return the line that says whether one number of trials for each pair gives every percentage."""
    pairs = len(percentages)
    fitting = {name: list(common(percentages, reading)) for name, reading in READINGS.items()}
    allowed = {name: [n for n in numbers if n <= most] for name, numbers in fitting.items()}
    quantity, total = "common number of trials", choices.trials * choices.participants
    printed = f"{choices.trials} trials, {choices.participants} participants"
    if allowed["rounded"]:
        return cited.text(quantity, printed, _listed(allowed["rounded"]), "agrees")
    if allowed["truncated"]:
        return cited.text(quantity, printed, _listed(allowed["truncated"]), "agrees if truncated")
    least = "; ".join(
        f"if all are {name}, each pair needs at least {numbers[0]} trials ({numbers[0] * pairs} in all)"
        for name, numbers in fitting.items()
        if numbers and name != "either"
    )
    reason = f"{least}; {choices.participants} x {choices.trials} = {total} trials allow {most} for each"
    none = f"none from 1 to {most}"
    if not allowed["either"]:
        return cited.text(quantity, printed, none, "impossible", reason)
    reason += f"; numbers that fit with some rounded and some truncated: {_listed(allowed['either'])}"
    return cited.text(quantity, printed, f"{none}, all rounded or all truncated", "fits no one rounding", reason)


def _unequal(cited: mistakes.Citation, choices: PrintedChoices, percentages: Sequence[Printed]) -> mistakes.Line:
    """Return the line of the fewest trials that the percentages need when pairs may differ in them."""
    all_of = choices.trials * choices.participants
    often = Counter(printed.text for printed in percentages)
    for verdict, reading in zip(FITS, READINGS.values(), strict=True):
        least = sum(count * smallest(Printed(text), reading) for text, count in often.items())
        for total, who in ((choices.trials, "all participants together"), (all_of, "every participant")):
            if least <= total:
                reason = (
                    f"true if pairs were shown unequally often and {choices.trials} is the number of trials of {who}"
                )
                return cited.text("trials in all", str(choices.trials), f"at least {least}", verdict, reason)
    reason = f"this is more than {choices.participants} x {choices.trials}"
    return cited.text("trials in all", str(choices.trials), f"at least {least}", "impossible", reason)


def _listed(numbers: Sequence[int]) -> str:
    """Return numbers as text, neighbours as a run."""
    runs: list[list[int]] = [[numbers[0], numbers[0]]]
    for before, number in pairwise(numbers):
        if number == before + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    texts = [str(low) if low == high else f"{low} to {high}" for low, high in runs]
    return ", ".join(texts[:LISTED]) + (", ..." if len(texts) > LISTED else "")


FITS: tuple[mistakes.Verdict, ...] = ("agrees", "agrees if truncated", "fits no one rounding")
"""The verdict on percentages that fit only from this reading on."""
