"""A dataset as what printed numbers are held against: every number is one value."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from analysis.evidence import Known, Sample, Variances, by_type
from analysis.exact import mean, sum_of_squares
from analysis.granularity import Moments
from analysis.published import PrintedCell, PrintedF, PrintedT
from analysis.recomputed import Margin, between
from analysis.results import Results
from analysis.spans import Span, point
from analysis.verdicts import Verdict


class FromResults:
    """A dataset: every number is one value."""

    missing: Verdict = "not in this dataset"
    refuted: Verdict = "differs"
    sd_in_doubt = False

    def __init__(self, results: Results) -> None:
        self._results = results

    def misreading(self, cell: PrintedCell) -> None:
        """None: the dataset tells what it is."""

    def sd_stands(self, cell: PrintedCell) -> bool:
        """Whether the dataset gives it."""
        sd = cell.sd
        return sd is None or any(sd.either.squared().meets(one.variance) for one in self.sample(cell).moments)

    def beyond(self, cell: PrintedCell) -> tuple[Moments, ...]:  # noqa: ARG002
        """Nothing beside the dataset."""
        return ()

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
        return Variances(by_type(*(point(Fraction(one)) for one in (first, second, third))), df, everything)

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


def _measured(values: Sequence[Fraction]) -> Sample:
    n = len(values)
    if n < 2:
        return Sample(n)
    only = (Moments(n, point(mean(values)), point(sum_of_squares(values) / (n - 1))),)
    return Sample(n, only, only)
