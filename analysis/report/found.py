"""Results -> the first page of a report: what was asked, and what was found, in sentences and one table."""

from __future__ import annotations

from collections.abc import Iterator

from palpate.analysis.documents.tables import (
    Column,
    Record,
    Section,
    bounds,
    ends,
    interval,
    joined,
    p_at_most,
    plural,
    probability,
    tabulate,
)
from palpate.analysis.identification.identify import Identification
from palpate.analysis.identification.results import MaterialTest, Results, TaskResult, bracketed
from palpate.analysis.reading.study import Study
from palpate.analysis.report.answers import listed
from palpate.analysis.report.plan import CHANCE, FOUND, Standing, alpha, planned_questions
from palpate.analysis.statistics.shares import Limits

CORRECT = (
    Column("task", left=True), Column("of", "presented", left=True), Column("n"), Column("value", "correct"),
    Column(("low", "high"), "95 % CI", show=lambda *limits: bounds(Limits(*limits))),
    Column("p_of_stars", "P", show=probability), Column("p_sign_flip_of_stars", "sign flips: P", show=probability),
    Column("stars", "", left=True),
)  # fmt: skip
OF_STARS = ("p_of_stars", "p_sign_flip_of_stars")
"""The P that a task's stars follow, adjusted or not; both are in tests.csv by their own names."""


def found_section(study: Study, results: Results, remark: tuple[str, ...], stands: Standing) -> Section:
    """Return the questions that the protocol plans, the answers of this dataset, and the correct ratios behind them."""
    both = list(zip(results.tasks, results.identifications, strict=True))
    paragraphs = [*planned_questions(study)]
    paragraphs += [" ".join(_task(task, one, alpha(study, CHANCE, task.task.id))) for task, one in both]
    tested = [(task, test) for task in results.tasks for test in task.tests]
    adjusted = {task.correction is not None for task in results.tasks}
    how = {True: "Holm-adjusted", False: "not adjusted"}
    said = how[adjusted.pop()] if len(adjusted) == 1 else "Holm-adjusted if the protocol plans it"
    alone = any(test.result.n == 1 for _, test in tested)
    single = " With one participant, they are Clopper-Pearson intervals across trials." if alone else ""
    notes = (
        f"Correct answer ratios with intervals across participants.{single} P is from the t-test against chance, "
        f"{said}, and from exact sign-flip tests. Stars follow the t-test.{bracketed(results.tasks)}",
    )
    mark = ", ".join(dict.fromkeys(stands.of_any(CHANCE, task.task.id) for task in results.tasks))
    records = [_record(task, test) for task, test in tested]
    table = tabulate("Correct answers", CORRECT, records, notes, standing=mark, in_print=OF_STARS)
    return Section("found", FOUND, (*paragraphs, *remark), (table,))


def _record(task: TaskResult, test: MaterialTest) -> Record:
    return {
        "quantity": "correct answer ratio", "task": task.task.id, "of": test.material, "n": test.result.n,
        "value": test.result.mean, **ends(test.interval), "statistic": test.result.t, "p": test.result.p,
        "p_holm": test.p_holm, "p_sign_flip_ours": test.flip and test.flip.p, "stars": task.stars(test),
        "p_of_stars": test.p_holm if task.correction else test.result.p, "p_sign_flip_of_stars": task.flip(test),
        "also_in": "tests.csv",
    }  # fmt: skip


def _task(task: TaskResult, one: Identification, level: float) -> Iterator[str]:
    yield f"{task.task.title} ({plural(len(task.confusion.participants), 'participant')})."
    yield from _tested(task, level)
    yield from _untested(task, level)
    if (least := _least(task)) >= level:
        yield f"Sign flips cannot show this: so few participants differ from chance that P cannot be below {least:.3g}."
    if len(pairs := task.confusion.most_confused()) == 1:
        yield f"The most confused pair was {joined(pairs[0])}."
    elif pairs:
        yield f"{len(pairs)} pairs tie as the most often confused."
    if one.jackknife and one.information:
        bits, limits = one.jackknife, interval(one.jackknife, 2)
        yield f"Answers transmitted {bits.value:.2f} of {one.information.presented:.2f} bits per trial ({limits})."


def _tested(task: TaskResult, level: float) -> Iterator[str]:
    """Yield which materials are shown above chance by t and by sign flips, which by one of the two, and which not."""
    groups: dict[tuple[bool, bool | None], list[MaterialTest]] = {}
    for test in task.tests:
        if test.result.p is not None:
            by_t = task.shows_above(test, test.p_holm if task.correction else test.result.p, level)
            by_flips = task.shows_above(test, task.flip(test), level) if test.flip or not by_t else None
            groups.setdefault((by_t, by_flips), []).append(test)
    flips = "" if _least(task) >= level else "; exact sign-flip tests do not show this"
    said = {
        (True, True): ("Answers were {} for {}.", ""),
        (True, False): (f"According to the t-test alone, answers were {{}} for {{}}{flips}.",
                        f"According to the t-test alone, this was so for {{}}{flips}."),
        (True, None): ("According to the t-test, answers were {} for {}; exact sign-flip tests are not defined here.",
                       "According to the t-test, this was so for {}; exact sign-flip tests are not defined here."),
        (False, True): ("According to exact sign-flip tests (not the t-test), answers were {} for {}.",
                        "According to exact sign-flip tests (not the t-test), this was so for {}."),
        (False, False): ("Answers were not shown to be {}: {}.", "This was not shown for {}."),
    }  # fmt: skip
    first = True
    for which, (whole, short) in said.items():
        if which in groups:
            names = listed(groups[which])
            how = f"correct more often than expected by chance ({task.chance:.4g})"
            yield whole.format(how, names) if first or not short else short.format(names)
            first = False


def _least(task: TaskResult) -> float:
    """Return the least P of sign flips that any test of a task can have, or 0 where they are no test at all."""
    least = min((test.flip_least for test in task.tests if test.flip_least is not None), default=0.0)
    return least if least < 1 else 0.0


def _untested(task: TaskResult, level: float) -> Iterator[str]:
    """Yield of which materials t has no P, as where every answer was right, and what sign flips say of them."""
    found = [test for test in task.tests if test.result.p is None and test.result.mean is not None]
    if not found:
        return
    alone = all(test.result.n == 1 for test in found)
    why = "one participant gives no variance" if alone else "the ratios of all participants are the same"
    yield f"Correct answer ratios: {listed(found)}; chance is {task.chance:.4g}. The t-test has no P, because {why}."
    shown = [test for test in found if task.shows_above(test, task.flip(test), level)]
    if shown:
        most = max(p for test in shown if (p := task.flip(test)) is not None)
        names = "all of them" if len(shown) == len(found) > 1 else joined([test.material for test in shown])
        yield f"Exact sign-flip tests show answers above chance for {names} ({p_at_most(most)})."
