"""What is asked of printed numbers alone: rows as whole counts, ANOVA tables, and what percentages are shares of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

from analysis.denominators import common, counts, either, rounded, smallest, truncated
from analysis.from_print import FromPrint
from analysis.misreadings import read_print
from analysis.places import Place
from analysis.published import Printed, PrintedCell, PrintedChoices, PrintedTable, Published
from analysis.recomputed import effect
from analysis.rows import Row, Undecided, examine, row_sum
from analysis.source_lines import source_lines
from analysis.spans import Span, hull
from analysis.verdicts import Line, Verdict
from analysis.walk import Walk
from analysis.words import number_of

LISTED = 5
"""Numbers that a reason lists at most."""

UNDECIDED: Verdict = "cannot be decided"


def print_lines(published: Published) -> tuple[Line, ...]:
    """Every line of a study whose printed numbers are held against one another."""
    evidence = read_print(published)
    walk = Walk(published, evidence, diagnose=True)
    lines = list(walk.lines())
    for table in published.confusions:
        if table.complete:
            lines += [_row(published, walk, evidence, table, shown, cells) for shown, cells in table.rows()]
    for sources in published.sources:
        lines += source_lines(sources)
    for icc in published.icc:
        place = Place(icc.where, "both", "reliability of the two-way ANOVA", UNDECIDED)
        reason = "no formula is printed, and means and SDs do not tell how each participant answered in every cell"
        lines.append(place.text("ICC", icc.value.text, "-", UNDECIDED, reason))
    for choices in published.choices:
        lines += _choices(choices)
    return tuple(lines)


def _row(
    published: Published,
    walk: Walk,
    evidence: FromPrint,
    table: PrintedTable,
    presented: str,
    cells: Sequence[PrintedCell],
) -> Line:
    place = Place(table.where, table.task, f"row of {presented}", UNDECIDED)
    total = sum((cell.mean.exact for cell in cells), Fraction(0))
    printed = f"{' + '.join(cell.mean.text for cell in cells)} = {float(total):.4g}"
    task = published.task(table.task)
    sums = row_sum([cell.mean for cell in cells])
    if task is None or task.trials is None:
        verdict: Verdict = "agrees" if sums.holds(Fraction(1)) else "impossible"
        return place.text("row", printed, f"{float(sums.low):.4g} to {float(sums.high):.4g}", verdict)
    # An SD that is none says nothing about the row.
    cells = [replace(cell, sd=None) if evidence.misreading(cell) else cell for cell in cells]
    pinned = {i: found for i, cell in enumerate(cells) if (found := _pinned(published, walk, evidence, cell))}
    try:
        row = examine(cells, task.participants, task.trials, pinned)
    except Undecided as reason:
        return place.text("row", printed, "-", UNDECIDED, str(reason))
    return _judged(place, printed, cells, row, given=", given the printed t" if pinned else "")


def _pinned(published: Published, walk: Walk, evidence: FromPrint, cell: PrintedCell) -> Span | None:
    """The variances that agree with the cell's t, where there is one."""
    tests = [t for t in published.tests if (t.task, t.material, t.material) == cell.key]
    if not tests:
        return None
    pins = walk.effects(tests[0])
    held = [
        one.variance
        for one in evidence.sample(cell).moments
        if (size := effect(one, tests[0].null)) is not None and any(size.meets(pin) for pin in pins)
    ]
    return hull(held) if held else None


def _judged(place: Place, printed: str, cells: Sequence[PrintedCell], row: Row, *, given: str) -> Line:
    if row.stands:
        found = f"{row.trials} of {row.trials} trials"
        if not row.truncated:
            return place.text("row", printed, found, "agrees")
        names = " and ".join(f"-> {cells[i].answered}" for i in row.truncated)
        reason = f"whole counts give the row where {names} is truncated{given}"
        return place.text("row", printed, found, "agrees if truncated", reason)
    found = f"{row.fewest} to {row.most} of {row.trials} trials" if row.fewest != row.most else f"{row.most} trials"
    reasons = []
    if gaps := row.missing or row.missing_truncated:
        fewer = row.missing_truncated if row.missing_truncated != gaps else None
        less = f" ({fewer}, if means are truncated)" if fewer else ""
        reasons.append(f"{number_of(gaps, 'trial')} without an answer would explain it{less}")
    if row.misprinted:
        names = ", ".join(f"-> {cells[i].answered}" for i in row.misprinted)
        reasons.append(f"a misprint of one of: {names}")
    if row.fewest > row.trials or row.most < row.trials:
        reasons.insert(0, "the ratios cannot sum to 1")
        text = "; ".join(reasons)
    else:
        text = "; ".join([f"no whole counts give all means and SDs at once{given}", *reasons])
    return place.text("row", printed, found, "impossible", text)


def _choices(choices: PrintedChoices) -> Iterator[Line]:
    percentages = [printed for _, printed in choices.cells]
    pairs = len(percentages)
    shares = [choices.trials * people // pairs for people in (choices.participants, 1)]
    for (first, second), printed in choices.cells:
        place = Place(choices.where, choices.task, f"{first} and {second}", UNDECIDED)
        yield _choice(place, printed, shares)
    place = Place(choices.where, choices.task, f"all {pairs} pairs", UNDECIDED)
    yield _common(place, choices, percentages, max(shares))
    yield _unequal(place, choices, percentages)


def _choice(place: Place, printed: Printed, shares: Sequence[int]) -> Line:
    """One percentage, were the trials shared equally among pairs: those of every participant, or of all together.

    Nothing printed says that they were, so a percentage that does not fit is no mistake by itself.
    """
    asked = [share for share in shares if share]
    found = {name: [(k, n) for n in asked for k in counts(printed, n, read)] for name, read in READINGS.items()}
    if fits := found["rounded"]:
        return place.text("correct", printed.text, " or ".join(f"{k} of {n}" for k, n in fits[:LISTED]), "agrees")
    near = [(round(printed.exact * share), share) for share in asked]
    shown = " or ".join(f"{k} of {n} = {100 * k / n:.1f}%" for k, n in found["truncated"] or near)
    cut = ", though one is cut off to it" if found["truncated"] else ""
    trials = f"{' or '.join(map(str, asked))} trials, equal for all pairs,"
    reason = f"no share of {trials} rounds to it{cut}; one of {smallest(printed, rounded)} does"
    return place.text("correct", printed.text, shown, UNDECIDED, reason)


def _common(place: Place, choices: PrintedChoices, percentages: Sequence[Printed], most: int) -> Line:
    """Whether one number of trials a pair gives every percentage."""
    pairs = len(percentages)
    fitting = {name: list(common(percentages, reading)) for name, reading in READINGS.items()}
    allowed = {name: [n for n in numbers if n <= most] for name, numbers in fitting.items()}
    quantity, total = "common number of trials", choices.trials * choices.participants
    printed = f"{choices.trials} trials, {choices.participants} participants"
    if allowed["rounded"]:
        return place.text(quantity, printed, _listed(allowed["rounded"]), "agrees")
    if allowed["truncated"]:
        return place.text(quantity, printed, _listed(allowed["truncated"]), "agrees if truncated")
    least = "; ".join(
        f"{name}, {numbers[0]} at least ({numbers[0] * pairs} trials)"
        for name, numbers in fitting.items()
        if numbers and name != "either"
    )
    reason = f"{least}; {choices.participants} x {choices.trials} = {total} trials allow {most}"
    none = f"none from 1 to {most}"
    if not allowed["either"]:
        return place.text(quantity, printed, none, "impossible", reason)
    reason += f"; some rounded and some truncated: {_listed(allowed['either'])}"
    return place.text(quantity, printed, f"{none}, all rounded or all truncated", "fits no one rounding", reason)


def _unequal(place: Place, choices: PrintedChoices, percentages: Sequence[Printed]) -> Line:
    """The fewest trials that the percentages take when pairs may differ in them."""
    all_of = choices.trials * choices.participants
    for verdict, reading in zip(FITS, READINGS.values(), strict=True):
        least = sum(smallest(printed, reading) for printed in percentages)
        for total, who in ((choices.trials, "all together"), (all_of, "every participant")):
            if least <= total:
                reason = f"if pairs were shown unequally often and {choices.trials} are those of {who}"
                return place.text("trials in all", str(choices.trials), f"at least {least}", verdict, reason)
    reason = f"more than {choices.participants} x {choices.trials}"
    return place.text("trials in all", str(choices.trials), f"at least {least}", "impossible", reason)


def _listed(numbers: Sequence[int]) -> str:
    """Numbers in words, runs as runs."""
    runs: list[list[int]] = [[numbers[0], numbers[0]]]
    for before, number in pairwise(numbers):
        if number == before + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    texts = [str(low) if low == high else f"{low} to {high}" for low, high in runs]
    return ", ".join(texts[:LISTED]) + (", ..." if len(texts) > LISTED else "")


READINGS = {"rounded": rounded, "truncated": truncated, "either": either}
FITS: tuple[Verdict, ...] = ("agrees", "agrees if truncated", "fits no one rounding")
"""The verdict on percentages that fit only from this reading on."""
