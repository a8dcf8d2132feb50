"""The evidence for a printed number: values that a mean, SD, t or F can have, from a dataset or other print.

A dataset gives one value each; print gives all that rounding or truncation, and counting in whole answers, allow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from statistics import mean, variance
from typing import Literal

from palpate.analysis.audit.bounds import (
    ANY,
    Margin,
    Moments,
    Work,
    f_of,
    margin,
    moments,
    neighbours,
    on_scale,
    ss_between,
    ss_within,
    steps_to_find,
    together,
    totals,
    unweighted,
)
from palpate.analysis.audit.intervals import Interval, either, point
from palpate.analysis.audit.mistakes import Verdict
from palpate.analysis.identification.confusion import shared
from palpate.analysis.identification.results import Results
from palpate.analysis.published.numbers import PrintedCell, PrintedF, PrintedT, Published, Scale
from palpate.analysis.published.printed import Printed
from palpate.analysis.statistics.anova import TYPES
from palpate.experiment.errors import PublishedError

Misreading = Literal["the population SD", "the standard error"]
"""What may be printed in the place of an SD."""

NO_STEPS = "neither trials nor a scale restricts the values, so any mean and SD are possible"


@dataclass(frozen=True)
class Known:
    """The values that a mean can have; `statement` says why where there are none."""

    values: tuple[Interval, ...] = ()
    statement: str = ""


@dataclass(frozen=True)
class Sample:
    """The means and variances that n participants can have, and `every` one that the mean allows; or why none."""

    n: int
    moments: tuple[Moments, ...] = ()
    every: tuple[Moments, ...] = ()
    statement: str = ""


@dataclass(frozen=True)
class Variances:
    """F of one effect by the types of ANOVA (one entry if equal), its degrees of freedom, and number of values."""

    f: Mapping[str, Interval] = field(default_factory=dict)
    df: tuple[int, int] | None = None
    values: int = 0
    statement: str = ""


def by_type(*found: Interval) -> dict[str, Interval]:
    """Return F by type, from F of types I, II and III; types with the same F share one name."""
    kinds: dict[Interval, list[str]] = {}
    for kind, f in zip(TYPES, found, strict=True):
        same = next((one for one in kinds if math.isclose(one.low, f.low) and math.isclose(one.high, f.high)), f)
        kinds.setdefault(same, []).append(kind)
    return {f"{'types' if same[1:] else 'type'} {' and '.join(same)}": f for f, same in kinds.items()}


class FromResults:
    """A dataset, in which every number is one value."""

    missing: Verdict = "not in this dataset"
    """Verdict on a number that this says nothing about."""
    refuted: Verdict = "differs"
    """Verdict on a mean or SD that it does not allow."""
    sd_in_doubt = False
    """Whether a printed SD that a test does not follow from may be what is wrong, not the test."""

    def __init__(self, results: Results) -> None:
        self._results = results

    def misreading(self, cell: PrintedCell) -> None:
        """Return None, because a dataset tells what the SD is."""

    def sd_stands(self, cell: PrintedCell) -> bool:
        """Return whether the dataset gives the printed SD."""
        sd = cell.sd
        return sd is None or any(either(sd).squared().meets(one.variance) for one in self.sample(cell).moments)

    def beyond(self, cell: PrintedCell) -> tuple[Moments, ...]:  # noqa: ARG002
        """Return nothing: a dataset allows nothing else."""
        return ()

    def mean(self, cell: PrintedCell) -> Known:
        """Return the cell's mean ratio."""
        values = self._ratios(cell.task, cell.presented, cell.answered)
        return Known((point(mean(values)),)) if values else Known()

    def sample(self, cell: PrintedCell) -> Sample:
        """Return the cell's mean and variance."""
        return _measured(self._ratios(cell.task, cell.presented, cell.answered))

    def tested(self, test: PrintedT) -> Sample:
        """Return the sample of the material's correct answers, with the reason where t is not defined."""
        found = _measured(self._ratios(test.task, test.material, test.material))
        result = self._results.task(test.task)
        if result is None or test.material not in result.task.presented:
            return found
        statement = result.test(test.material).result.statement
        return Sample(found.n, statement=statement) if statement else found

    def variances(self, printed: PrintedF) -> Variances:
        """Return the ANOVA that was computed."""
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
        first = float(self._ss_effect(printed.subject[0]).low) / df[0] / anova.residual.ms
        return Variances(by_type(*(point(Fraction(one)) for one in (first, second, third))), df, everything)

    def _ss_effect(self, effect: str) -> Interval:
        """Return the sum of squares of the effect when it enters first, of the materials that every task presents."""
        values: dict[str, list[Fraction]] = {}
        tasks = self._results.tasks
        for task, place in product(tasks, shared(task.confusion for task in tasks)):
            level = task.task.id if effect == "task" else task.confusion.materials[place]
            values.setdefault(level, []).extend(task.confusion.ratios(place, place).values())
        return ss_between([Margin(len(level), point(mean(level))) for level in values.values()])

    def _ratios(self, task: str, presented: str, answered: str) -> list[Fraction]:
        result = self._results.task(task)
        if result is None or not {presented, answered} <= set(result.confusion.materials):
            return []
        index = result.confusion.materials.index
        return list(result.confusion.ratios(index(presented), index(answered)).values())


def _measured(values: Sequence[Fraction]) -> Sample:
    n = len(values)
    if n < 2:
        return Sample(n)
    only = (Moments(n, point(mean(values)), point(variance(values))),)
    return Sample(n, only, only)


TOO_MANY = "so many counts give it that counting cannot decide"
NO_CELL = "neither mean nor SD is printed"
NO_SD = "no SD is printed"
MANY = 20_000
"""Means and variances of one cell beyond which counting them says no more than the printed numbers do."""

AROUND = 10
"""Alternatives to a printed SD are first looked for within this many units of its last digit."""

MISREADINGS: Mapping[Misreading, Callable[[int], Fraction]] = {
    "the population SD": lambda n: Fraction(n, n - 1),
    "the standard error": lambda n: Fraction(n),
}
"""The factor by which the square of each is multiplied to give the variance of n values."""


MOST_WORK = 1_000_000
"""Means and variances that are tried for all printed numbers of a file but its rows, about 10 s of processor time.

Counted and not timed, so that every machine finds the same.
"""

STEPS = 20
"""Steps to the sums of squares that occur that take as long as trying one mean and variance."""


class FromPrint:
    """The other numbers in print; `misread` holds, by key, the cells whose printed SD is read as something else."""

    missing: Verdict = "cannot be decided"
    refuted: Verdict = "impossible"
    sd_in_doubt = True

    def __init__(self, published: Published, misread: Mapping[tuple[str, str, str], Misreading] | None = None) -> None:
        self._published = published
        self._misread = dict(misread or {})
        self._tables = {cell.key: cell for cell in published.tables()}
        self._found: dict[tuple[str, str, str], Sample] = {}
        self.work = Work(MOST_WORK)

    def misreading(self, cell: PrintedCell) -> Misreading | None:
        """Return what the cell's printed SD is read as, or None where it is read as an SD."""
        return self._misread.get(cell.key)

    def sd_stands(self, cell: PrintedCell) -> bool:
        """Return whether whole counts give the printed SD, or nothing is known of the counts."""
        n = self._n(cell.task)
        if n is None or n < 2 or cell.sd is None or cell.scale is None:
            return True
        return self._counted(cell, n, cell.scale, either(cell.sd).squared()) != ()

    def reading(self, cells: Iterable[PrintedCell], misreading: Misreading) -> FromPrint | None:
        """Return this evidence with the SDs of `cells` read as `misreading`; None where no values have such moments."""
        changed = {cell.key: misreading for cell in cells}
        found = self.working_with(self._published, changed)
        found._misread |= changed
        return found if all(found.sample(cell).every for cell in cells) else None

    def working_with(
        self,
        published: Published,
        changed: Iterable[tuple[str, str, str]] = (),
        tasks: Sequence[str] = (),
        work: Work | None = None,
    ) -> FromPrint:
        """Return this evidence of other printed numbers, which differ in the cells with the keys `changed` or in tasks.

        What is tried is taken off `work`, or else off what is left for the file.
        """
        found = FromPrint(published, self._misread)
        found.work = work or self.work
        gone = set(changed)
        found._found = {key: one for key, one in self._found.items() if key not in gone and key[0] not in tasks}
        return found

    def mean(self, cell: PrintedCell) -> Known:
        """Return the means near the printed one that whole counts give; in the text, those that the table allows."""
        source, n = self._tables.get(cell.key), self._n(cell.task)
        if not cell.in_table and source is not None:
            return Known(tuple({one.mean: None for one in self.sample(source).moments}) or (either(source.mean),))
        if n is None or cell.scale is None:
            return Known(statement=NO_STEPS)
        sums = on_scale(totals(either(cell.mean), n, cell.scale.items), n, cell.scale)
        sums = sums or neighbours(cell.mean.exact, n, cell.scale)
        if len(sums) > MANY:
            return Known(statement=TOO_MANY)
        return Known(tuple(point(Fraction(total, n * cell.scale.items)) for total in sums))

    def sample(self, cell: PrintedCell) -> Sample:
        """Return what fits the printed mean and SD; where nothing fits or values have no steps, both as they stand."""
        source = self._tables.get(cell.key, cell)
        if source.key not in self._found:
            self._found[source.key] = self._fitting(source)
        return self._found[source.key]

    def tested(self, test: PrintedT) -> Sample:
        """Return the sample of the cell that is tested."""
        cell = self._tables.get(test.key)
        n = self._n(test.task) or test.df + 1
        return self.sample(cell) if cell else Sample(n, statement=NO_CELL)

    def variances(self, printed: PrintedF) -> Variances:
        """Return F from the means and SDs of its cells."""
        groups = self._groups(printed)
        self._spend(sum(map(len, groups)))
        samples = [[self.sample(cell) if cell else None for cell in group] for group in groups]
        held = [[together(one.moments) for one in group if one and one.moments] for group in samples]
        if not groups or any(len(group) != len(cells) for group, cells in zip(held, groups, strict=True)):
            return Variances(statement="not all of its means and SDs are printed")
        cells = [one for group in held for one in group]
        values = sum(one.n for one in cells)
        df = len(groups) - 1, values - len(cells)
        if min(df) < 1:
            return Variances(statement="an ANOVA needs two levels, and more values than cells")
        # Of equally many values each, the mean of all values is the mean of the cells' means.
        alike = all(len({one.n for one in group}) == 1 for group in held)
        levels, residual = (margin,) if alike else (margin, unweighted), ss_within(cells)
        found = [f_of(ss_between([level(group) for group in held]), residual, df) for level in levels]
        # The cells of a task have as many values each: an effect is the same whether it enters first or last but one.
        return Variances(by_type(found[0], found[0], found[-1]), df, values)

    def beyond(self, cell: PrintedCell) -> tuple[Moments, ...]:
        """Return what the cell can be if its printed SD is a standard error, a population SD or the variance."""
        n = self._n(cell.task)
        if n is None or n < 2 or cell.sd is None or cell.scale is None:
            return ()
        printed = either(cell.sd)
        windows = [*(printed.squared().times(factor(n)) for factor in MISREADINGS.values()), printed]
        return tuple(one for window in windows for one in self._counted(cell, n, cell.scale, window) or ())

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
            return Sample(n or 0, statement="the number of participants is not printed, or is below two")
        if cell.sd is None:
            any_sd = (self._counted(cell, n, cell.scale, ANY) if cell.scale else None) or ()
            return Sample(n, any_sd, any_sd, NO_SD)
        misreading = self.misreading(cell)
        wanted = either(cell.sd).squared().times(MISREADINGS[misreading](n) if misreading else Fraction(1))
        stands = (Moments(n, either(cell.mean), wanted),)
        if cell.scale is None:
            return Sample(n, stands, stands if misreading else ())
        every = (
            self._counted(cell, n, cell.scale, wanted)
            if misreading
            else self._counts_near(cell, cell.sd, cell.scale, n)
        )
        if every is None:
            return Sample(n, stands, stands) if misreading else Sample(n, stands, statement=TOO_MANY)
        return Sample(n, tuple(one for one in every if wanted.meets(one.variance)) or stands, every)

    def _counts_near(self, cell: PrintedCell, sd: Printed, scale: Scale, n: int) -> tuple[Moments, ...] | None:
        """Return what whole counts give at a printed SD, or else around it; None where they give too many.

        The search widens up to an SD of 1, and narrows again.
        """
        found = self._counted(cell, n, scale, either(sd).squared())
        unit = sd.exact_unit or Fraction(1)
        width, none_within = AROUND * unit, Fraction(0)
        too_many: Fraction | None = None
        while found == () and none_within < sd.exact + 1:
            around = Interval(max(sd.exact - width, Fraction(0)) ** 2, (sd.exact + width) ** 2)
            found = self._counted(cell, n, scale, around)
            if found is None and width - none_within > unit:
                found, too_many = (), width
            elif found == ():
                none_within = width
            width = (none_within + too_many) / 2 if too_many else 4 * none_within
        return found

    def _counted(self, cell: PrintedCell, n: int, scale: Scale, variance: Interval) -> tuple[Moments, ...] | None:
        """Return the means and variances that whole counts give; None where there are too many."""
        high = variance.high
        if scale.low is not None and scale.high is not None:
            # The spread is greatest with half the values at either end.
            high = min(high, Fraction((scale.high - scale.low) ** 2 * n, 4 * (n - 1)))
        sums = on_scale(totals(either(cell.mean), n, scale.items), n, scale)
        if len(sums) * (high - variance.low) * n * scale.items**2 > MANY:
            return None
        self._spend(1 + sum(steps_to_find(total, n, scale) for total in sums) // STEPS)
        found = tuple(one for total in sums for one in moments(total, n, scale, variance))
        self._spend(len(found))
        return found

    def _spend(self, amount: int) -> None:
        if not self.work.spend(amount):
            raise PublishedError(
                self._published.study,
                f"got printed numbers that take more than {MOST_WORK} means and variances to check",
                "split it into one file for each table and its tests",
            )

    def _n(self, task: str) -> int | None:
        found = self._published.task_named(task)
        return found.participants if found else None


Evidence = FromResults | FromPrint
"""What a printed number is checked by."""
