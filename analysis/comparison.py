"""Every printed number beside the one from a dataset of the study: does it agree, and if not, why not?"""

from __future__ import annotations

import statistics
from dataclasses import dataclass

from analysis.from_results import FromResults
from analysis.places import Place
from analysis.published import PrintedIcc, Published
from analysis.results import Results, TaskResult
from analysis.verdicts import Line
from analysis.walk import Walk


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
    """Put every printed number beside the one from a dataset.

    Args:
        published: see `analysis.published.load`.
        results: of a dataset of the same study.
        diagnose: whether a difference may be explained by how the number was printed; true for a reconstruction
            alone, since new answers differ for reasons of their own.
    """
    lines = [*Walk(published, FromResults(results), diagnose=diagnose).lines()]
    lines += [_icc(one, results) for one in published.icc]
    tasks = dict.fromkeys(cell.task for cell in published.tables())
    correlations = [_correlation(published, result) for task in tasks if (result := results.task(task))]
    return Comparison(published.source, tuple(lines), tuple(correlations))


def _icc(icc: PrintedIcc, results: Results) -> Line:
    printed = icc.value
    place = Place(
        icc.where, "both", "reliability of the two-way ANOVA", "not in this dataset", results.two_way_statement
    )
    if results.components is None:
        return place.number("ICC", printed, ())
    k, _, value = results.components.by_k[0]
    forms = [form.value for table in results.reliabilities if table.icc for form in table.icc.forms]
    others = [form for form in forms if form is not None]
    spread = f"; the Shrout-Fleiss forms give {min(others):.2f} to {max(others):.2f}" if others else ""
    reason = f"no formula is printed; the variance-component ICC of the mean of {k} gives this{spread}"
    line = place.text("ICC", printed.text, "-" if value is None else f"{value:.3f}", "cannot be decided", reason)
    return Line(**{**vars(line), "low": value, "high": value})


def _correlation(published: Published, result: TaskResult) -> Correlation:
    printed, recomputed = [], []
    materials = result.confusion.materials
    for cell in published.tables():
        if cell.task != result.task.id or not {cell.presented, cell.answered} <= set(materials):
            continue
        mean = result.confusion.mean(materials.index(cell.presented), materials.index(cell.answered))
        if mean is not None:
            printed.append(cell.mean.value)
            recomputed.append(mean)
    if len(printed) < 3 or min(recomputed) == max(recomputed):
        return Correlation(result.task.id, len(printed), None, "the recomputed ratios do not vary: r is not defined")
    return Correlation(result.task.id, len(printed), statistics.correlation(printed, recomputed))
