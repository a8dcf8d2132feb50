"""Results -> the first screen: each planned question with its one answer, its warnings, and how sure the data are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from palpate.analysis.documents.tables import Asked, Section, bounds, interval, joined, number, p_is
from palpate.analysis.report.plan import ICC, ONE_WAY, TWO_WAY, Standing, T, alpha, exclusions_section, first_question

if TYPE_CHECKING:
    from palpate.analysis.identification.identify import Cell
    from palpate.analysis.identification.results import MaterialTest, Results, TaskResult
    from palpate.analysis.reading.study import Study

QUESTIONS = {
    T: "Are answers right more often than by chance?",
    ONE_WAY: "Are the two materials told apart?",
    TWO_WAY: "Do the tasks differ?",
    ICC: "How reliable are the mean ratios?",
}
"""What a test asks where no protocol words it."""

TWO_WAY_ERRS = (
    "This ANOVA takes the ratios of one participant as independent. It rejects a true null in 0 to 31 % of SIMULATED "
    "studies, not in 5 %."
)
ONE_WAY_ERRS = "This ANOVA takes four ratios of each participant as independent, so its P is not exact."
BY_FLIPS = "Exact sign flips answer here; the t-tests and the ANOVA as published stand below, each under its own mark."
UNDEFINED = "No answer: this test is not defined for what was planned and done."


def answers_section(study: Study, results: Results, stands: Standing, limits: tuple[str, ...]) -> Section:
    """Return the questions with their answers, what `limits` them, what rules left out, and how sure this is."""
    asked = tuple(_answers(study, results, stands))
    return Section("answers", "Questions and answers", (*limits, left_and_sure(study)), asked=asked)


def left_and_sure(study: Study) -> str:
    """Return what was left out by rule, and how sure the data are."""
    return " ".join([*exclusions_section(study).paragraphs, how_sure(study)])


def how_sure(study: Study) -> str:
    """Return whether the plan was sealed, and how to check the data against their anchors."""
    known = [part for part in study.parts if part.protocol is not None]
    if not known:
        return "No protocol is in the dataset, so nothing shows what was planned."
    said = dict.fromkeys(f"Protocol: {part.sealed}." for part in known)
    return f"{' '.join(said)} `palpate verify` checks the data against their anchors."


def _questions(study: Study, results: Results, stands: Standing) -> list[tuple[str, tuple[str, ...], str]]:
    """Return each planned test with its tasks and question, or else the tests in print, or two others."""
    planned: list[tuple[str, tuple[str, ...], str]] = [
        (plan.test, plan.tasks, first_question(plan)) for plan in study.plans()
    ]
    if planned:
        return planned
    tasks = tuple(task.task.id for task in results.tasks)
    known = {test for test, _ in stands.printed} & set(QUESTIONS) or {T, TWO_WAY}
    return [(test, tasks, question) for test, question in QUESTIONS.items() if test in known]


def _answers(study: Study, results: Results, stands: Standing) -> Iterator[Asked]:
    for test, tasks, question in _questions(study, results, stands):
        mark = stands.of(test, *tasks)
        answered = tuple(_answered(test, tasks, question, mark, alpha(study, test, *tasks), results, stands))
        yield from answered or (Asked(question, UNDEFINED, mark),)


def _answered(
    test: str, tasks: tuple[str, ...], question: str, mark: str, level: float, results: Results, stands: Standing
) -> Iterator[Asked]:
    """Yield the answers to a question; none where the test is not defined."""
    match test:
        case "t against chance":
            if found := [one for one in map(results.task, tasks) if one is not None]:
                yield Asked(question, " ".join(_above(one, results, level) for one in found), mark, (BY_FLIPS,))
        case "one-way ANOVA":
            for answer in _told_apart(results, tasks, stands, level):
                yield Asked(question, answer, mark, (ONE_WAY_ERRS,))
        case "two-way ANOVA" if len(results.tasks) > 1:
            yield _tasks_differ(results, question, mark, level)
        case "ICC" if results.components and (value := results.components.by_k[0][2]) is not None:
            k = results.components.by_k[0][0]
            yield Asked(question, f"ICC = {number(value)}, variance components, mean of k = {k}.", mark)
        case "equivalence":
            yield from (Asked(question, answer, mark) for answer in _equivalent(results, tasks))


def _above(task: TaskResult, results: Results, level: float) -> str:
    """Return which materials sign flips, which hold, show above chance, with mean ratios and intervals."""
    one = next(one for one in results.identifications if one.task == task.task.id)
    cells = {cell.presented: cell for cell in one.cells if cell.presented == cell.answered}
    shown = [test for test in task.tests if task.above(test, task.flip(test), level)]
    others = [test for test in task.tests if test not in shown and test.result.mean is not None]
    parts = []
    if shown:
        most = max(p for test in shown if (p := task.flip(test)) is not None)
        parts.append(f"above chance ({task.chance:.3g}) for {_listed(shown, cells)} (sign flips, {p_is(most)} or less)")
    if others:
        parts.append(f"not shown above chance for {_listed(others, cells)}")
    return f"{task.task.id}: {'; '.join(parts) or 'no answers'}."


def _listed(tests: list[MaterialTest], cells: dict[str, Cell]) -> str:
    from palpate.analysis.report.found import limits_of

    return joined([
        f"{test.material} {number(test.result.mean, 2)} ({bounds(limits_of(cells[test.material]), 2)})"
        for test in tests
    ])  # fmt: skip


def _told_apart(results: Results, tasks: tuple[str, ...], stands: Standing, level: float) -> Iterator[str]:
    for pair in results.pairs:
        if pair.task not in tasks or stands.of_pair(pair) == "exploratory" or pair.anova is None:
            continue
        effect, residual = pair.anova.effects[0], pair.anova.residual
        if effect.f is not None and effect.p is not None:
            differ = "differ" if effect.p < level else "are not shown to differ"
            yield (
                f"{pair.task}: answers to {joined(pair.pair)} {differ} (F({effect.df}, {residual.df}) = "
                f"{effect.f:.2f}, {p_is(effect.p)})."
            )


def _tasks_differ(results: Results, question: str, mark: str, level: float) -> Asked:
    """Return the paired comparison of the participants who did both, or, without any, the two-way ANOVA."""
    paired = [
        f"{one.first} less {one.second}: {number(one.test.mean)} (95 % CI {interval(one.interval)}; exact sign flips, "
        f"{p_is(one.flip.p)}, n = {one.test.n}), {'shown' if one.flip.p < level else 'not shown'} to differ."
        for one in results.beside.paired
        if one.test.mean is not None
    ]
    if paired:
        return Asked(question, " ".join(paired), mark, (BY_FLIPS,))
    if not results.two_way or (effect := results.two_way[1].effects[0]).f is None or effect.p is None:
        return Asked(question, f"No test is defined: {results.two_way_statement or 'F is not defined'}.", mark)
    means = [
        f"{task.task.id} {sum(test.result.mean or 0.0 for test in task.tests) / len(task.tests):.2f}"
        for task in results.tasks
    ]
    differ = "differ" if effect.p < level else "are not shown to differ"
    df = f"{effect.df}, {results.two_way[1].residual.df}"
    said = f"Mean ratios ({joined(means)}) {differ} (two-way ANOVA, F({df}) = {effect.f:.2f}, {p_is(effect.p)})."
    return Asked(question, said, mark, (TWO_WAY_ERRS,))


def _equivalent(results: Results, tasks: tuple[str, ...]) -> Iterator[str]:
    for one in (*results.equivalences.tasks, *results.equivalences.pairs):
        if set(one.tasks) <= set(tasks) and one.planned:
            test = one.result
            same = "the same" if one.p_holm < 0.05 else "not shown to be the same"
            yield (
                f"{joined(one.tasks)}, {one.subject}: {same} within {test.margin:g} (mean {number(test.mean)}, 90 % CI "
                f"{interval(test)}; Holm, {p_is(one.p_holm)})."
            )
