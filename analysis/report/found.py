"""Results -> the first page of a report: what was asked, and what was found, in sentences and one table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from analysis.documents.tables import Section, Table, interval, number, p_is, plural, probability
from analysis.identification.identify import Cell, Identification
from analysis.identification.results import MaterialTest, Results, TaskResult
from analysis.reading.study import Study

ALPHA = 0.05


def found_section(study: Study, results: Results, remark: tuple[str, ...]) -> Section:
    """Return the questions that the protocol plans, the answers of this dataset, and the correct ratios behind them."""
    asked = dict.fromkeys(
        " ".join(plan.question.split()).split("? ")[0].rstrip("?") + "?"
        for part in study.parts
        for plan in (part.protocol.analysis if part.protocol else ())
        if plan.test != "ICC"
    )
    paragraphs = [f"Asked: {' '.join(asked)}"] * bool(asked)
    for task, one in zip(results.tasks, results.identifications, strict=True):
        paragraphs.append(" ".join(_task(task, one)))
    paragraphs += [" ".join(_between(results))] * bool(list(_between(results)))
    rows = tuple(
        (task.task.id, test.material, str(test.result.n), number(test.result.mean), interval(cell.bootstrap),
         probability(test.result.p), probability(test.flip.p if test.flip else None), test.stars)
        for task, one in zip(results.tasks, results.identifications, strict=True)
        for test, cell in zip(task.tests, _right(one), strict=True)
    )  # fmt: skip
    header = ("task", "presented", "n", "correct", "95 % CI", "P of t", "P of sign flips (ours)", "")
    notes = ("Correct answer ratios, their BCa intervals over participants, and tests against chance.",)
    table = Table("", header, rows, left=frozenset({0, 1, 7}), notes=notes)
    return Section("found", "What was found", (*paragraphs, *remark), (table,))


def _right(one: Identification) -> list[Cell]:
    return [cell for cell in one.cells if cell.presented == cell.answered]


def _task(task: TaskResult, one: Identification) -> Iterator[str]:
    cells = {cell.presented: cell for cell in _right(one)}
    people = plural(len(task.confusion.participants), "participant")
    above = [test for test in task.tests if test.stars]
    rest = [test for test in task.tests if not test.stars and test.result.mean is not None]
    by = "P adjusted by Holm" if task.correction else "P that is not adjusted"
    yield f"{task.task.title} ({people}, chance {task.chance:.4g}):"
    if above:
        yield f"by {by}, right answers were more frequent than by chance for {_listed(above, cells)}."
    else:
        yield f"by {by}, right answers were not shown to be more frequent than by chance for any material."
    if rest and above:
        yield f"It was not shown for {_listed(rest, cells)}."
    other = [test.material for test in task.tests if test.flip and bool(test.stars) != _flipped(test, task)]
    if other:
        yield f"Sign flips, which are ours, say otherwise of {' and '.join(other)}."
    if pair := task.confusion.most_confused():
        yield f"Most often taken for one another were {pair[0]} and {pair[1]}."
    if one.jackknife and one.information:
        bits, limits = one.jackknife, interval(one.jackknife, 2)
        yield f"Answers transmitted {bits.value:.2f} of {one.information.presented:.2f} bits a trial ({limits}; ours)."


def _flipped(test: MaterialTest, task: TaskResult) -> bool:
    """Return whether sign flips show a mean above chance, by the P that the stars follow."""
    p = test.flip_holm if task.correction else test.flip.p if test.flip else None
    return p is not None and p < ALPHA and test.result.mean is not None and test.result.mean > task.chance


def _listed(tests: Sequence[MaterialTest], cells: dict[str, Cell]) -> str:
    parts = []
    for test in tests:
        limits = interval(cells[test.material].bootstrap, 2)
        shown = f", {limits}" if limits != "-" else ""
        parts.append(f"{test.material} ({number(test.result.mean, 2)}{shown})")
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _between(results: Results) -> Iterator[str]:
    """Yield what the tests of tasks and materials say, the published ANOVA first, then ours."""
    if results.two_way and (effect := results.two_way[1].effects[0]).f is not None and effect.p is not None:
        df = f"{effect.df}, {results.two_way[1].residual.df}"
        differ = "differ" if effect.p < ALPHA else "are not shown to differ"
        yield f"The tasks {differ} in the two-way ANOVA (F({df}) = {effect.f:.2f}, {p_is(effect.p)})."
    for one in results.beside.paired:
        mean, p = one.test.mean, one.test.p
        if mean is not None and p is not None:
            yield (
                f"Ours, over the {one.test.n} who did both: {one.first} less {one.second} is {mean:.3f} "
                f"(t({one.test.df}) = {one.test.t:.2f}, {p_is(p)}; sign flips, {p_is(one.flip.p)})."
            )
    for task, lines in results.beside.materials.items():
        (line,) = lines
        if line.f is not None and line.p is not None:
            differ = "differ" if line.p < ALPHA else "are not shown to differ"
            test = f"F({line.df1}, {line.df2}) = {line.f:.2f}, {p_is(line.p)}"
            yield f"Ours, repeated measures: the materials of {task} {differ} ({test})."
