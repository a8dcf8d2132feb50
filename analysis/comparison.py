"""Every printed number beside the recomputed one: does it agree, and if not, why not.

Means must agree to the printed digit; standard deviations, F, t and P to one unit of the last one. Where a
printed test does not agree, the reasons that can be computed are tried: Cohen's d in the place of t, and its
P at the number of participants of another task.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from analysis.anova import Anova
from analysis.published import Printed, PrintedCell, PrintedF, PrintedT, Published
from analysis.results import MaterialTest, Results, TaskResult
from analysis.significance import p_two_tailed, stars

Verdict = Literal["agrees", "agrees within one unit", "differs", "cannot be decided", "not in this dataset"]
AGREES: tuple[Verdict, ...] = ("agrees", "agrees within one unit")


@dataclass(frozen=True)
class Line:
    """One printed number. `recomputed` is as text at the printed precision, `value` the number itself.

    Stars are compared as text and have no `value`.
    """

    where: str
    task: str
    subject: str
    quantity: str
    printed: str
    recomputed: str
    value: float | None
    verdict: Verdict
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the printed number stands."""
        return self.verdict in AGREES


@dataclass(frozen=True)
class Correlation:
    """Pearson's r between the printed and the recomputed mean ratios of one task's table, over `cells` cells."""

    task: str
    cells: int
    r: float | None
    statement: str = ""


@dataclass(frozen=True)
class Comparison:
    """Every printed number of one study against a dataset of it."""

    source: str
    lines: tuple[Line, ...]
    correlations: tuple[Correlation, ...]

    @property
    def agreeing(self) -> int:
        """How many printed numbers agree."""
        return sum(line.agrees for line in self.lines)


def compare(published: Published, results: Results, *, diagnose: bool) -> Comparison:
    """Put every printed number beside the recomputed one.

    Args:
        published: see `analysis.published.load`.
        results: of a dataset of the same study.
        diagnose: whether a difference may be explained by how the number was printed; true for a reconstruction
            alone, since new answers differ for reasons of their own.
    """
    lines = [*_cells(published, results, diagnose=diagnose), *_tests(published, results, diagnose=diagnose)]
    lines += [*_one_way(published.one_way, results), *_two_way(published.two_way, results), _icc(published, results)]
    tasks = dict.fromkeys(cell.task for cell in published.tables())
    correlations = [_correlation(published, result) for task in tasks if (result := results.task(task))]
    return Comparison(published.source, tuple(lines), tuple(correlations))


def verdict(printed: Printed, value: float, units: float) -> tuple[Verdict, str]:
    """Whether `value` agrees with a printed number, and a reason where that is not plain.

    Args:
        printed: the number in print.
        value: the recomputed number.
        units: units of the last digit by which the two may differ beyond rounding: 0 or 1.
    """
    distance = abs(value - printed.value)
    slack = 1e-9 * max(abs(value), printed.unit)
    if distance <= printed.unit / 2 + slack:
        return "agrees", ""
    if units and distance < units * printed.unit + slack:
        cut = math.floor(abs(value) / printed.unit + 1e-9) * printed.unit
        truncated = math.isclose(cut, abs(printed.value), rel_tol=1e-9)
        return "agrees within one unit", "fits truncation, not rounding" if truncated else "one unit of the last digit"
    return "differs", ""


def as_printed(printed: Printed, value: float) -> str:
    """`value` with as many digits as the printed number has."""
    if "e" in printed.text:
        digits = len(printed.text.partition("e")[0].partition(".")[2])
        mantissa, _, exponent = f"{value:.{digits}e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    if printed.text.endswith("%"):
        return f"{100 * value:.0f}%"
    return f"{value:.{len(printed.text.partition('.')[2])}f}"


@dataclass(frozen=True)
class _Place:
    """Where a printed number stands and what it is about; makes its lines."""

    where: str
    task: str
    subject: str
    missing: str = ""

    def number(self, quantity: str, printed: Printed, value: float | None, units: float, remark: str = "") -> Line:
        if value is None:
            absent: Verdict = "not in this dataset"
            return self.text(quantity, printed.text, "-", absent, self.missing)
        result, reason = verdict(printed, value, units)
        shown = as_printed(printed, value) + remark
        return Line(self.where, self.task, self.subject, quantity, printed.text, shown, value, result, reason)

    def text(self, quantity: str, printed: str, found: str, result: Verdict, reason: str = "") -> Line:
        return Line(self.where, self.task, self.subject, quantity, printed, found, None, result, reason)


def _cells(published: Published, results: Results, *, diagnose: bool) -> Iterator[Line]:
    for cell in published.cells:
        place = _Place(cell.where, cell.task, f"{cell.presented} -> {cell.answered}")
        result = results.task(cell.task)
        indices = _indices(cell, result)
        if result is None or indices is None:
            yield place.number("mean", cell.mean, None, 0)
            continue
        yield place.number("mean", cell.mean, result.confusion.mean(*indices), 0)
        if cell.sd is not None:
            yield place.number("SD", cell.sd, result.confusion.sd(*indices), 1)
        if cell.stars is not None and cell.presented == cell.answered:
            yield _stars(place, published, cell, result.test(cell.presented), diagnose=diagnose)


def _indices(cell: PrintedCell, result: TaskResult | None) -> tuple[int, int] | None:
    if result is None or not {cell.presented, cell.answered} <= set(result.confusion.materials):
        return None
    index = result.confusion.materials.index
    return index(cell.presented), index(cell.answered)


def _stars(place: _Place, published: Published, cell: PrintedCell, test: MaterialTest, *, diagnose: bool) -> Line:
    printed, found = cell.stars or "none", test.result.stars or "none"
    if printed == found:
        return place.text("stars", printed, found, "agrees")
    reason = ""
    source = next((t for t in published.tests if (t.task, t.material) == (cell.task, cell.presented)), None)
    if diagnose and source and test.result.p is not None and stars(source.p.value) == printed:
        reason = f"they follow the printed P = {source.p.text}; recomputed P = {test.result.p:.2g}"
    return place.text("stars", printed, found, "differs", reason)


def _tests(published: Published, results: Results, *, diagnose: bool) -> Iterator[Line]:
    sizes = sorted({test.df + 1 for test in published.tests})
    for printed in published.tests:
        result = results.task(printed.task)
        known = result is not None and printed.material in result.confusion.materials
        test = result.test(printed.material).result if result is not None and known else None
        place = _Place(printed.where, printed.task, printed.material, test.statement if test else "")
        remark = f" at {test.df} df" if test and test.df != printed.df else ""
        t = place.number(f"t({printed.df})", printed.t, test.t if test else None, 1, remark)
        p = place.number("P", printed.p, test.p if test else None, 1)
        if diagnose and test and test.d is not None:
            t, p = _explain_t(t, printed, test.d), _explain_p(p, printed, test.d, sizes)
        yield from (t, p)


def _explain_t(line: Line, printed: PrintedT, d: float) -> Line:
    if line.agrees or verdict(printed.t, d, 1)[0] not in AGREES:
        return line
    return replace(line, reason=f"what is printed as t is Cohen's d = {d:.2f}")


def _explain_p(line: Line, printed: PrintedT, d: float, sizes: list[int]) -> Line:
    if line.agrees:
        return line
    for size in sizes:
        if verdict(printed.p, p_two_tailed(d * math.sqrt(size), size - 1), 1)[0] in AGREES:
            reason = f"it is the P of d * sqrt({size}) at {size - 1} df, where n is {printed.df + 1}"
            return replace(line, reason=reason)
    return line


def _one_way(printed: PrintedF, results: Results) -> tuple[Line, Line]:
    fitting = (t for t in results.pairs if t.task == printed.task and set(t.pair) == set(printed.subject))
    test = next(fitting, None)
    subject = f"one-way ANOVA, {' and '.join(printed.subject)}"
    place = _Place(printed.where, printed.task or "", subject, test.statement if test else "")
    return _f(place, printed, test.anova if test else None)


def _two_way(printed: PrintedF, results: Results) -> tuple[Line, Line]:
    place = _Place(printed.where, "both", f"two-way ANOVA, {printed.subject[0]}", results.two_way_statement)
    return _f(place, printed, results.two_way[-1] if results.two_way else None)


def _f(place: _Place, printed: PrintedF, anova: Anova | None) -> tuple[Line, Line]:
    """F and P of the first effect, which is the task in a two-way table."""
    name = f"F({printed.df[0]},{printed.df[1]})"
    if anova is None:
        return place.number(name, printed.f, None, 1), place.number("P", printed.p, None, 1)
    effect = anova.effects[0]
    own = effect.df, anova.residual.df
    remark = f" at {own[0]}, {own[1]} df" if own != printed.df else ""
    return place.number(name, printed.f, effect.f, 1, remark), place.number("P", printed.p, effect.p, 1)


def _icc(published: Published, results: Results) -> Line:
    printed = published.icc.text
    place = _Place(published.icc_where, "both", "reliability of the two-way ANOVA", results.two_way_statement)
    if results.components is None:
        return place.text("ICC", printed, "-", "not in this dataset", results.two_way_statement)
    k, _, value = results.components.by_k[0]
    forms = [form.value for table in results.reliabilities if table.icc for form in table.icc.forms]
    others = [form for form in forms if form is not None]
    spread = f"; the Shrout-Fleiss forms give {min(others):.2f} to {max(others):.2f}" if others else ""
    reason = f"no formula is printed; the variance-component ICC of the mean of {k} gives this{spread}"
    shown = "-" if value is None else f"{value:.3f}"
    return replace(place.text("ICC", printed, shown, "cannot be decided", reason), value=value)


def _correlation(published: Published, result: TaskResult) -> Correlation:
    printed, recomputed = [], []
    for cell in published.tables():
        indices = _indices(cell, result) if cell.task == result.task.id else None
        mean = result.confusion.mean(*indices) if indices else None
        if mean is not None:
            printed.append(cell.mean.value)
            recomputed.append(mean)
    if len(printed) < 3 or min(recomputed) == max(recomputed):
        return Correlation(result.task.id, len(printed), None, "the recomputed ratios do not vary: r is not defined")
    return Correlation(result.task.id, len(printed), statistics.correlation(printed, recomputed))
