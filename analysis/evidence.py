"""What a printed number is held against: the other numbers in print, or a dataset.

Both give the same things: the values that a mean, a standard deviation, a t or an F can have. From a dataset each is
one value; from print it is all that rounding or truncation, and counting in whole answers, leave open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Protocol

from analysis.anova import TYPES
from analysis.exact import mean, sum_of_squares
from analysis.granularity import Moments, Scale, moments, neighbours, on_scale, totals
from analysis.published import PrintedCell, PrintedF, PrintedT, Published
from analysis.recomputed import Margin, between, f_of, margin, together, unweighted, within
from analysis.results import Results
from analysis.spans import Span, point
from analysis.verdicts import Verdict

NO_STEPS = "the steps of the values are not known: any mean and SD can be"
TOO_MANY = "so many counts give it that counting says nothing"
NO_CELL = "neither mean nor SD is printed"
NO_SD = "no SD is printed"
MANY = 20_000
"""Means and variances of one cell beyond which counting them says no more than the printed numbers do."""

AROUND = 10
"""Units of the last digit around a printed SD in which its alternatives are looked for."""


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

    def mean(self, cell: PrintedCell) -> Known:
        """What the cell's mean can be."""

    def sample(self, cell: PrintedCell) -> Sample:
        """What the cell's mean and variance can be."""

    def tested(self, test: PrintedT) -> Sample:
        """The same for what a t-test is of."""

    def variances(self, printed: PrintedF) -> Variances:
        """F, of the pair of materials or of the effect that it is printed for."""


class FromResults:
    """A dataset: every number is one value."""

    missing: Verdict = "not in this dataset"
    refuted: Verdict = "differs"

    def __init__(self, results: Results) -> None:
        self._results = results

    def mean(self, cell: PrintedCell) -> Known:
        """The cell's mean ratio."""
        values = self._ratios(cell.task, cell.presented, cell.answered)
        return Known((point(mean(values)),)) if values else Known()

    def sample(self, cell: PrintedCell) -> Sample:
        """The cell's mean and variance."""
        return _measured(self._ratios(cell.task, cell.presented, cell.answered))

    def tested(self, test: PrintedT) -> Sample:
        """The material's correct answers, with the reason where t is not defined."""
        found = _measured(self._ratios(test.task, test.material, test.material))
        result = self._results.task(test.task)
        known = result is not None and test.material in result.confusion.materials
        if result is None or not known:
            return found
        statement = result.test(test.material).result.statement
        return Sample(found.n, statement=statement) if statement else found

    def variances(self, printed: PrintedF) -> Variances:
        """The ANOVA that was computed."""
        if printed.task is None:
            tables = self._results.two_way
            anova, statement = (tables[-1] if tables else None), self._results.two_way_statement
        else:
            fitting = [t for t in self._results.pairs if (t.task, set(t.pair)) == (printed.task, set(printed.subject))]
            anova, statement = (fitting[0].anova, fitting[0].statement) if fitting else (None, "")
        if anova is None:
            return Variances(statement=statement)
        line = anova.effects[0] if printed.task else anova.effect(printed.subject[0])
        everything = sum(one.df for one in anova.effects) + anova.residual.df + 1
        df = line.df, anova.residual.df
        if line.f is None:
            return Variances({}, df, everything, anova.statement)
        if printed.task:
            return Variances({"": point(Fraction(line.f))}, df, everything)
        _, second, third = (table.effect(printed.subject[0]).f or 0.0 for table in self._results.two_way)
        first = float(self._between(printed.subject[0]).low) / df[0] / anova.residual.ms
        return Variances(_by_type(*(point(Fraction(one)) for one in (first, second, third))), df, everything)

    def _between(self, effect: str) -> Span:
        """Sum of squares of the effect alone, the first to enter."""
        values: dict[str, list[Fraction]] = {}
        for task in self._results.tasks:
            for material in task.confusion.materials:
                level = task.task.id if effect == "task" else material
                values.setdefault(level, []).extend(self._ratios(task.task.id, material, material))
        return between([Margin(len(level), point(mean(level))) for level in values.values()])

    def _ratios(self, task: str, presented: str, answered: str) -> list[Fraction]:
        result = self._results.task(task)
        if result is None or not {presented, answered} <= set(result.confusion.materials):
            return []
        index = result.confusion.materials.index
        return list(result.confusion.ratios(index(presented), index(answered)).values())


class FromPrint:
    """The other numbers in print."""

    missing: Verdict = "cannot be decided"
    refuted: Verdict = "impossible"

    def __init__(self, published: Published) -> None:
        self._published = published
        self._tables = {cell.key: cell for cell in published.tables()}
        self._found: dict[tuple[str, str, str], Sample] = {}

    def mean(self, cell: PrintedCell) -> Known:
        """Of a cell that the text repeats, what its table leaves open; else the sums of counts that are near."""
        source, n = self._tables.get(cell.key), self._n(cell.task)
        if not cell.in_table and source is not None:
            return Known(tuple({one.mean: None for one in self.sample(source).moments}) or (source.mean.either,))
        if n is None or cell.scale is None:
            return Known(statement=NO_STEPS)
        sums = _sums(cell, n, cell.scale) or neighbours(cell.mean.exact, n, cell.scale)
        if len(sums) > MANY:
            return Known(statement=TOO_MANY)
        return Known(tuple(point(Fraction(total, n * cell.scale.items)) for total in sums))

    def sample(self, cell: PrintedCell) -> Sample:
        """What fits the printed mean and SD; where nothing does, or values have no steps, both as they stand."""
        source = self._tables.get(cell.key, cell)
        if source.key not in self._found:
            self._found[source.key] = self._fitting(source)
        return self._found[source.key]

    def tested(self, test: PrintedT) -> Sample:
        """The cell, or the score, that the test is of."""
        cell = self._tables.get((test.task, test.material, test.material))
        n = self._n(test.task) or test.df + 1
        return self.sample(cell) if cell else Sample(n, statement=NO_CELL)

    def variances(self, printed: PrintedF) -> Variances:
        """F from the means and SDs of the cells that it is of."""
        groups = self._groups(printed)
        samples = [[self.sample(cell) if cell else None for cell in group] for group in groups]
        held = [[together(one.moments) for one in group if one and one.moments] for group in samples]
        if not groups or any(len(group) != len(cells) for group, cells in zip(held, groups, strict=True)):
            return Variances(statement="the means and SDs that it is of are not all printed")
        cells = [one for group in held for one in group]
        values = sum(one.n for one in cells)
        df = len(groups) - 1, values - len(cells)
        if min(df) < 1:
            return Variances(statement="an ANOVA needs two levels, and more values than cells")
        first, third = (
            f_of(between([level(group) for group in held]), within(cells), df) for level in (margin, unweighted)
        )
        # The cells of a task have as many values each: an effect is the same whether it enters first or last but one.
        return Variances(_by_type(first, first, third), df, values)

    def _groups(self, printed: PrintedF) -> list[list[PrintedCell | None]]:
        if printed.task is not None:
            a, b = printed.subject
            return [[self._tables.get((printed.task, *key))] for key in ((a, a), (b, b), (a, b), (b, a))]
        correct = [cell for cell in self._tables.values() if cell.presented == cell.answered]
        tasks = dict.fromkeys(cell.task for cell in correct)
        materials = dict.fromkeys(cell.presented for cell in correct)
        by_task = [[self._tables.get((task, one, one)) for one in materials] for task in tasks]
        return by_task if printed.subject[0] == "task" else [list(group) for group in zip(*by_task, strict=True)]

    def _fitting(self, cell: PrintedCell) -> Sample:
        n = self._n(cell.task)
        if n is None or n < 2:
            return Sample(n or 0, statement="the number of participants is not printed, or below two")
        stands = self._as_printed(cell, n)
        if cell.scale is None:
            return stands
        sums, around = _sums(cell, n, cell.scale), _around(cell)
        if around.high == math.inf and (cell.scale.low is None or cell.scale.high is None):
            return stands
        widest = (
            Fraction((cell.scale.high or 0) - (cell.scale.low or 0)) ** 2 if around.high == math.inf else around.high
        )
        if len(sums) * (widest - around.low) * n * cell.scale.items**2 > MANY:
            return stands
        every = tuple(one for total in sums for one in moments(total, n, cell.scale, around))
        wanted = cell.sd.either.squared() if cell.sd else around
        fitting = tuple(one for one in every if wanted.meets(one.variance))
        return Sample(n, fitting or stands.moments, every, stands.statement)

    def _as_printed(self, cell: PrintedCell, n: int) -> Sample:
        if cell.sd is None:
            return Sample(n, statement=NO_SD)
        return Sample(n, (Moments(n, cell.mean.either, cell.sd.either.squared()),))

    def _n(self, task: str) -> int | None:
        found = self._published.task(task)
        return found.participants if found else None


def _measured(values: Sequence[Fraction]) -> Sample:
    n = len(values)
    if n < 2:
        return Sample(n)
    only = (Moments(n, point(mean(values)), point(sum_of_squares(values) / (n - 1))),)
    return Sample(n, only, only)


def _around(cell: PrintedCell) -> Span:
    if cell.sd is None:
        return Span(Fraction(0), math.inf)
    width = AROUND * cell.sd.exact_unit
    return Span(max(cell.sd.exact - width, Fraction(0)) ** 2, (cell.sd.exact + width) ** 2)


def _sums(cell: PrintedCell, n: int, scale: Scale) -> range:
    return on_scale(totals(cell.mean.either, n, scale.items), n, scale)


def _by_type(*found: Span) -> dict[str, Span]:
    """F of types I, II and III, those that are the same together."""
    kinds: dict[Span, list[str]] = {}
    for kind, f in zip(TYPES, found, strict=True):
        same = next((one for one in kinds if math.isclose(one.low, f.low) and math.isclose(one.high, f.high)), f)
        kinds.setdefault(same, []).append(kind)
    return {f"type{'s' * (len(same) > 1)} {' and '.join(same)}": f for f, same in kinds.items()}
