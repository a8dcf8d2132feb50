"""The other numbers in print as what printed numbers are held against: what rounding, truncation and counting leave."""

from __future__ import annotations

import math
from fractions import Fraction

from analysis.evidence import NO_STEPS, Known, Sample, Variances, by_type
from analysis.granularity import Moments, Scale, moments, neighbours, on_scale, totals
from analysis.published import PrintedCell, PrintedF, PrintedT, Published
from analysis.recomputed import between, f_of, margin, together, unweighted, within
from analysis.spans import Span, point
from analysis.verdicts import Verdict

TOO_MANY = "so many counts give it that counting says nothing"
NO_CELL = "neither mean nor SD is printed"
NO_SD = "no SD is printed"
MANY = 20_000
"""Means and variances of one cell beyond which counting them says no more than the printed numbers do."""

AROUND = 10
"""Units of the last digit around a printed SD in which its alternatives are looked for."""


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
        return Variances(by_type(first, first, third), df, values)

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


def _around(cell: PrintedCell) -> Span:
    if cell.sd is None:
        return Span(Fraction(0), math.inf)
    width = AROUND * cell.sd.exact_unit
    return Span(max(cell.sd.exact - width, Fraction(0)) ** 2, (cell.sd.exact + width) ** 2)


def _sums(cell: PrintedCell, n: int, scale: Scale) -> range:
    return on_scale(totals(cell.mean.either, n, scale.items), n, scale)
