"""The other numbers in print as what printed numbers are held against: what rounding, truncation and counting leave."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction

from analysis.evidence import NO_STEPS, Known, Misreading, Sample, Variances, by_type
from analysis.granularity import Moments, Scale, moments, neighbours, on_scale, totals
from analysis.published import Printed, PrintedCell, PrintedF, PrintedT, Published
from analysis.recomputed import between, f_of, margin, together, unweighted, within
from analysis.spans import Span, point
from analysis.verdicts import Verdict

TOO_MANY = "so many counts give it that counting says nothing"
NO_CELL = "neither mean nor SD is printed"
NO_SD = "no SD is printed"
MANY = 20_000
"""Means and variances of one cell beyond which counting them says no more than the printed numbers do."""

AROUND = 10
"""Units of the last digit around a printed SD in which its alternatives are looked for first."""


MISREADINGS: Mapping[Misreading, Callable[[int], Fraction]] = {
    "the population SD": lambda n: Fraction(n, n - 1),
    "the standard error": lambda n: Fraction(n),
}
"""By what its square is multiplied to give the variance of n values."""

Key = tuple[str, str, str]
"""Task, material presented, answer."""


class FromPrint:
    """The other numbers in print.

    `misread` are the cells whose printed SD is read as something else.
    """

    missing: Verdict = "cannot be decided"
    refuted: Verdict = "impossible"
    sd_in_doubt = True

    def __init__(self, published: Published, misread: Mapping[Key, Misreading] | None = None) -> None:
        self._published = published
        self._misread = dict(misread or {})
        self._tables = {cell.key: cell for cell in published.tables()}
        self._found: dict[Key, Sample] = {}

    def misreading(self, cell: PrintedCell) -> Misreading | None:
        """What the cell's printed SD is read as, if not as an SD."""
        return self._misread.get(cell.key)

    def sd_stands(self, cell: PrintedCell) -> bool:
        """Whether whole counts give the printed SD, or are not known."""
        n = self._n(cell.task)
        if n is None or n < 2 or cell.sd is None or cell.scale is None:
            return True
        return self._counted(cell, n, cell.scale, cell.sd.either.squared()) != ()

    def reading(self, cells: Iterable[PrintedCell], misreading: Misreading) -> FromPrint | None:
        """The same with the SDs of cells read as something else; None where no values have such means and SDs."""
        found = FromPrint(self._published, self._misread | {cell.key: misreading for cell in cells})
        return found if all(found.sample(cell).every for cell in cells) else None

    def mean(self, cell: PrintedCell) -> Known:
        """Of a cell that the text repeats, what its table leaves open; else the sums of counts that are near."""
        source, n = self._tables.get(cell.key), self._n(cell.task)
        if not cell.in_table and source is not None:
            return Known(tuple({one.mean: None for one in self.sample(source).moments}) or (source.mean.either,))
        if n is None or cell.scale is None:
            return Known(statement=NO_STEPS)
        sums = on_scale(totals(cell.mean.either, n, cell.scale.items), n, cell.scale)
        sums = sums or neighbours(cell.mean.exact, n, cell.scale)
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

    def beyond(self, cell: PrintedCell) -> tuple[Moments, ...]:
        """What the cell can be if its printed SD is none: the standard error, or divided by another number."""
        n = self._n(cell.task)
        if n is None or n < 2 or cell.sd is None or cell.scale is None:
            return ()
        printed = cell.sd.either
        windows = [*(printed.squared().times(factor(n)) for factor in MISREADINGS.values()), printed]
        counted = (self._counted(cell, n, cell.scale, window) for window in windows)
        return tuple(one for found in counted if found for one in found)

    def _groups(self, printed: PrintedF) -> list[list[PrintedCell | None]]:
        if printed.task is not None:
            a, b = printed.subject
            return [[self._tables.get((printed.task, *key))] for key in ((a, a), (b, b), (a, b), (b, a))]
        correct = [one for one in self._tables.values() if one.presented == one.answered and not one.is_score]
        tasks = dict.fromkeys(cell.task for cell in correct)
        materials = dict.fromkeys(cell.presented for cell in correct)
        by_task = [[self._tables.get((task, one, one)) for one in materials] for task in tasks]
        return by_task if printed.subject[0] == "task" else [list(group) for group in zip(*by_task, strict=True)]

    def _fitting(self, cell: PrintedCell) -> Sample:
        n = self._n(cell.task)
        if n is None or n < 2:
            return Sample(n or 0, statement="the number of participants is not printed, or below two")
        if cell.sd is None:
            return self._without_sd(cell, n)
        misreading = self.misreading(cell)
        wanted = cell.sd.either.squared().times(MISREADINGS[misreading](n) if misreading else Fraction(1))
        stands = (Moments(n, cell.mean.either, wanted),)
        if cell.scale is None:
            return Sample(n, stands, stands if misreading else ())
        every = self._counted(cell, n, cell.scale, wanted) if misreading else self._near(cell, cell.sd, cell.scale, n)
        if every is None:
            return Sample(n, stands, stands) if misreading else Sample(n, stands, statement=TOO_MANY)
        return Sample(n, tuple(one for one in every if wanted.meets(one.variance)) or stands, every)

    def _near(self, cell: PrintedCell, sd: Printed, scale: Scale, n: int) -> tuple[Moments, ...] | None:
        """What whole counts give at a printed SD, or else around it; None where it is too many.

        Further off until there is some, nearer again where that is too many. A mean that has whole counts has some with
        an SD below 1, so none that far says that it has none.
        """
        found = self._counted(cell, n, scale, sd.either.squared())
        unit = sd.exact_unit or Fraction(1)
        width, none_within = AROUND * unit, Fraction(0)
        too_many: Fraction | None = None
        while found == () and none_within < sd.exact + 1:
            around = Span(max(sd.exact - width, Fraction(0)) ** 2, (sd.exact + width) ** 2)
            found = self._counted(cell, n, scale, around)
            if found is None and width - none_within > unit:
                found, too_many = (), width
            elif found == ():
                none_within = width
            width = (none_within + too_many) / 2 if too_many else 4 * none_within
        return found

    def _without_sd(self, cell: PrintedCell, n: int) -> Sample:
        every = self._counted(cell, n, cell.scale, Span(Fraction(0), math.inf)) if cell.scale else None
        return Sample(n, every or (), every or (), NO_SD)

    def _counted(self, cell: PrintedCell, n: int, scale: Scale, variance: Span) -> tuple[Moments, ...] | None:
        """The means and variances that whole counts give; None where they are too many."""
        high = variance.high
        if scale.low is not None and scale.high is not None:
            # Half the values at either end spread the most.
            high = min(high, Fraction((scale.high - scale.low) ** 2 * n, 4 * (n - 1)))
        sums = on_scale(totals(cell.mean.either, n, scale.items), n, scale)
        if len(sums) * (high - variance.low) * n * scale.items**2 > MANY:
            return None
        return tuple(one for total in sums for one in moments(total, n, scale, variance))

    def _n(self, task: str) -> int | None:
        found = self._published.task(task)
        return found.participants if found else None
